"""Hidden folders beside results: none stays behind, not even that of a process that was killed (class 10)."""

import subprocess
import sys
from pathlib import Path

import pytest

from hybrid_id.records.files import HIDDEN, hidden_beside, locked

KILLED_INSIDE = """
import os, pathlib, signal, sys
from hybrid_id.records.files import hidden_beside
place = pathlib.Path(sys.argv[1])
with hidden_beside(place) as folder:
    (folder / "new").mkdir()
    if sys.argv[2] == "True":
        place.replace(folder / "old")
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.parametrize("replacing", [False, True])
def test_what_a_killed_process_has_left_goes_and_earlier_results_come_back(
    tmp_path: Path, replacing: bool
) -> None:
    place = tmp_path / "out"
    place.mkdir()
    (place / "result.json").write_text("{}")
    (tmp_path / ".out.of the user").mkdir()
    subprocess.run([sys.executable, "-c", KILLED_INSIDE, str(place), str(replacing)], check=False)
    (left,) = tmp_path.glob(f".out.{HIDDEN}*")
    assert place.exists() is not replacing
    with hidden_beside(place) as mine:
        assert not left.exists() and mine.is_dir()
        with hidden_beside(place) as other:  # what is in use stays
            assert mine.is_dir() and other != mine
    assert {path.name for path in tmp_path.iterdir()} == {"out", ".out.of the user"}
    assert (place / "result.json").read_text() == "{}"


def test_nobody_else_gets_into_a_locked_folder(tmp_path: Path) -> None:
    with locked(tmp_path), pytest.raises(BlockingIOError), locked(tmp_path):
        pass
    with locked(tmp_path):
        pass
