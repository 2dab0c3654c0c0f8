"""Compiled steps are kept for later runs, and nothing depends on what is kept."""

import ctypes
import os
import shutil
from pathlib import Path

import pytest

from hybrid_id.errors import InputError
from hybrid_id.simulation.c_code import library

SOURCE = "double twice(double x) { return 2.0 * x; }\n"
pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="needs a C compiler")


def twice(code: ctypes.CDLL) -> float:
    code.twice.restype, code.twice.argtypes = ctypes.c_double, [ctypes.c_double]
    return code.twice(1.5)


@pytest.fixture
def shelf(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    library.cache_clear()
    return tmp_path / "hybrid_id"


def test_what_was_compiled_is_kept_and_used_again(shelf: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert twice(library(SOURCE)) == 3.0
    assert [path.suffix for path in shelf.iterdir()] == [".so"]
    library.cache_clear()
    monkeypatch.setattr("subprocess.run", lambda *_, **__: pytest.fail("compiled again"))
    assert twice(library(SOURCE)) == 3.0


def test_other_flags_are_another_library(shelf: Path) -> None:
    library(SOURCE, ("-O0", "-fPIC"))
    library(SOURCE, ("-O1", "-fPIC"))
    assert len(list(shelf.iterdir())) == 2


def test_a_full_shelf_loses_its_older_half(shelf: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hybrid_id.simulation.c_code.MOST_KEPT", 4)
    shelf.mkdir()
    for k in range(4):
        (shelf / f"{k}.so").write_bytes(b"")
        os.utime(shelf / f"{k}.so", (k, k))
    assert twice(library(SOURCE)) == 3.0
    left = {path.name for path in shelf.iterdir()}
    assert {"2.so", "3.so"} < left
    assert len(left) == 3


def test_damaged_library_is_built_again(shelf: Path) -> None:
    library(SOURCE, ("-O2", "-fPIC"))
    (kept,) = shelf.iterdir()
    kept.unlink()  # a library in use keeps its file: another takes its name
    kept.write_bytes(b"cut off")
    library.cache_clear()
    assert twice(library(SOURCE, ("-O2", "-fPIC"))) == 3.0


def test_shelf_that_cannot_be_written_is_done_without(
    shelf: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert twice(library(SOURCE)) == 3.0
    assert not shelf.exists()


def test_where_nothing_may_be_run_it_is_said(shelf: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(_: str) -> None:
        raise OSError("failed to map segment from shared object")

    monkeypatch.setattr(ctypes, "CDLL", refused)
    with pytest.raises(InputError, match="TMPDIR"):
        library(SOURCE)


def test_a_user_without_a_home_has_no_shelf(shelf: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def homeless() -> None:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr(Path, "home", homeless)
    assert twice(library(SOURCE)) == 3.0
