"""Compiled steps are kept for later runs, and nothing depends on what is kept."""

import ctypes
import os
import shutil
from pathlib import Path

import pytest

from hybrid_id.errors import InputError
from hybrid_id.simulation.c_code import kept_ahead, library

SOURCE = "double twice(double x) { return 2.0 * x; }\n"
NAMES = ("twice",)
pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="needs a C compiler")


def twice(code: ctypes.CDLL) -> float:
    code.twice.restype, code.twice.argtypes = ctypes.c_double, [ctypes.c_double]
    return code.twice(1.5)


@pytest.fixture
def shelf(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr("hybrid_id.simulation.c_code.AHEAD", tmp_path / "environment/share/hybrid_id")
    library.cache_clear()
    return tmp_path / "hybrid_id"


def test_what_was_compiled_is_kept_and_used_again(shelf: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert twice(library(SOURCE, NAMES)) == 3.0
    assert sorted(path.suffix for path in shelf.iterdir()) == [".sha256", ".so"]
    library.cache_clear()
    monkeypatch.setattr("subprocess.run", lambda *_, **__: pytest.fail("compiled again"))
    assert twice(library(SOURCE, NAMES)) == 3.0


def test_a_full_shelf_loses_its_older_half(shelf: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hybrid_id.simulation.c_code.MOST_KEPT", 2)
    shelf.mkdir()
    for k in range(4):
        (shelf / f"{k}.so").write_bytes(b"")
        os.utime(shelf / f"{k}.so", (k, k))
    assert twice(library(SOURCE, NAMES)) == 3.0
    left = {path.name for path in shelf.iterdir()}
    assert {"2.so", "3.so"} < left
    assert len(left) == 4


DAMAGE = {
    "cut short": lambda code: code[: len(code) // 2],
    "one byte changed": lambda code: code[:-7000] + bytes([code[-7000] ^ 1]) + code[-6999:],
    "nothing in it": lambda _: b"",
    "another program": lambda _: Path(shutil.which("gcc") or "").read_bytes(),
}


@pytest.mark.parametrize("name", DAMAGE)
def test_damaged_library_is_built_again(shelf: Path, name: str) -> None:
    """Loaded as it is, the first two end the process by SIGBUS or SIGSEGV."""
    flags = ("-O2", "-fPIC")
    library(SOURCE, NAMES, flags)
    (kept,) = shelf.glob("*.so")
    sound = kept.read_bytes()
    kept.unlink()  # a library in use keeps its file: another takes its name
    kept.write_bytes(DAMAGE[name](sound))
    library.cache_clear()
    assert twice(library(SOURCE, NAMES, flags)) == 3.0
    assert kept.read_bytes() == sound


def test_a_kept_library_without_the_function_is_built_again(shelf: Path) -> None:
    library(SOURCE, NAMES)
    (kept,) = shelf.glob("*.so")
    library(SOURCE.replace("twice", "thrice"), ("thrice",))
    (other,) = set(shelf.glob("*.so")) - {kept}
    for suffix in (".so", ".sha256"):  # a digest that fits
        os.replace(other.with_suffix(suffix), kept.with_suffix(suffix))
    library.cache_clear()
    assert twice(library(SOURCE, NAMES)) == 3.0


@pytest.mark.parametrize("why", ["others may write", "another's", "a link", "a file in its place", "no home"])
def test_a_shelf_that_is_not_the_users_own_is_done_without(
    shelf: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, why: str
) -> None:
    if why == "others may write":
        shelf.mkdir()
        shelf.chmod(0o770)
    elif why == "another's":
        shelf.mkdir()
        monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    elif why == "a link":
        (tmp_path / "elsewhere").mkdir()
        shelf.symlink_to(tmp_path / "elsewhere")
    elif why == "a file in its place":
        shelf.write_text("")
    else:
        monkeypatch.delenv("XDG_CACHE_HOME")
        monkeypatch.setattr(Path, "home", lambda: (_ for _ in ()).throw(RuntimeError("no home")))
    assert twice(library(SOURCE, NAMES)) == 3.0
    assert not list(tmp_path.rglob("*.so"))


def test_a_relative_shelf_is_not_used(shelf: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", "here")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert twice(library(SOURCE, NAMES)) == 3.0
    assert not (tmp_path / "here").exists()
    assert list((tmp_path / "home/.cache/hybrid_id").glob("*.so"))


def test_where_nothing_may_be_run_it_is_said(shelf: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(_: str) -> None:
        raise OSError("failed to map segment from shared object")

    monkeypatch.setattr(ctypes, "CDLL", refused)
    with pytest.raises(InputError, match="TMPDIR"):
        library(SOURCE, NAMES)


def test_what_was_compiled_ahead_is_found_by_who_has_no_cache(
    shelf: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with kept_ahead() as folder:
        assert twice(library(SOURCE, NAMES)) == 3.0
    assert sorted(path.suffix for path in folder.iterdir()) == [".sha256", ".so"] and not shelf.exists()
    monkeypatch.setattr("subprocess.run", lambda *_, **__: pytest.fail("compiled again"))
    assert twice(library(SOURCE, NAMES)) == 3.0
    assert not list(shelf.iterdir())


def test_where_others_may_write_nothing_is_taken_from_nor_kept(shelf: Path) -> None:
    with kept_ahead() as folder:
        library(SOURCE, NAMES)
    folder.chmod(0o777)
    assert twice(library(SOURCE, NAMES)) == 3.0
    assert list(shelf.glob("*.so"))  # compiled anew
    with pytest.raises(InputError, match="others"), kept_ahead():
        pass


def test_a_file_in_the_place_of_the_environments_folder_is_said(shelf: Path, tmp_path: Path) -> None:
    (tmp_path / "environment").write_text("")
    with pytest.raises(InputError, match="Nothing can be kept"), kept_ahead():
        pass
