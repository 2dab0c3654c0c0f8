"""A disk that is full, or that nobody may write to: one sentence, and what was there before stays."""

import errno
from pathlib import Path

import pytest

from hybrid_id.reporting import style


def test_full_disk(run, drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(path: Path, *_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    out = tmp_path / "out"
    assert run("simulate", drive, "--out", out).code == 0
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    monkeypatch.setattr(style, "imsave", full)
    done = run("simulate", drive, "--out", out, "--force")
    assert done.code == 2
    assert "cannot be written: No space left on device" in done.err and "Traceback" not in done.err
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

    monkeypatch.setattr(style, "imsave", broken)
    with pytest.raises(OSError, match="Input/output"):
        run("simulate", drive, "--out", tmp_path / "out")
