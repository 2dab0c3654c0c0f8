"""A disk that is full, or that nobody may write to: one sentence, and what was there before stays."""

import errno
import resource
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import joblib  # noqa: F401 (it writes a file when it is first imported)
import pytest

from hybrid_id.reporting import style

COMMANDS = {
    "simulate": ("simulate", "data", "--out"),
    "compare": ("compare", "data", "--model", "data/model.yaml", "--out"),
    "identify": ("identify", "study.yaml", "--out"),
    "train": ("train", "study.yaml", "--out"),
    "excite": ("excite", "--band", "0.3", "8", "--duration", "10", "--sample-time", "0.002", "--out"),
    "export": ("export", "data", "--to", "mjcf", "--out"),
    "step": ("export", "data", "--to", "torch", "--out"),
    "demo": ("demo", "--out"),
}
STUDY = "dataset: data\nidentification: {max_iterations: 1}\ntraining: {max_iterations: 1}\n"


@contextmanager
def full_after(size: int) -> Iterator[None]:
    """No file may grow beyond a size [bytes], whoever writes it: what a full disk is like, for every library."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize("size", [0, 200])
@pytest.mark.parametrize("command", COMMANDS)
def test_full_disk(
    run, drive: Path, tmp_path: Path, command: str, size: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(drive, tmp_path / "data")
    (tmp_path / "study.yaml").write_text(STUDY)
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    with full_after(size):
        done = run(*COMMANDS[command], "out")
    assert done.code == 2, done.out
    assert "cannot be written: File too large" in done.err and "Traceback" not in done.err
    assert sorted(tmp_path.rglob("*")) == before


def test_earlier_results_stay(run, drive: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert run("simulate", drive, "--out", out).code == 0
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    with full_after(1500):
        done = run("simulate", drive, "--out", out, "--force")
    assert done.code == 2 and "make room" in done.err
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_place_that_is_read_only(run, drive: Path) -> None:
    done = run("simulate", drive, "--out", "/proc/out")
    assert done.code == 2
    assert "/proc/out cannot be made" in done.err


def test_other_faults_keep_their_traceback(
    run, drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(style, "png", broken)
    with pytest.raises(OSError, match="Input/output"):
        run("simulate", drive, "--out", tmp_path / "out")
