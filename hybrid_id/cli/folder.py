"""The folder of results: complete under its name, or not there at all."""

import fcntl
import json
import os
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from hybrid_id.config import StudyConfig
from hybrid_id.errors import InputError

RESULT = "result.json"
DIAGNOSIS = "diagnosis.json"
CHECKPOINT = "checkpoint.pt"
EVENTS = "tensorboard"
FITS = "fits"
"""Folder of the fits that an unfinished diagnosis keeps."""
BEGUN = ".begun"
"""Marks a training that is not complete; says whether it has put earlier results aside."""
RESULTS = (RESULT, DIAGNOSIS)
ASIDE = "earlier results are aside"
FOREIGN = "files that are no results of hybrid-id; give another folder"


def required(path: Path | None) -> Path:
    """The folder that was asked for, by option or config."""
    if path is None:
        raise InputError(
            "there is no folder for the results; give --out DIR, or 'output: {folder: DIR}' in the config"
        )
    return path


def refuse_taken(path: Path, *, force: bool | None = None, reads: Iterable[Path] = ()) -> None:
    """Raise InputError where results cannot go, before anything is computed.

    Args:
        path: Folder of the results.
        force: Whether results of an earlier run may be replaced; other files never are. None for a command that never
            replaces any, and so has no --force to advise.
        reads: Files and folders that the command reads; a folder that holds one of them is not replaced.
    """
    remove_empty(make_parents(path))  # a trial: rights and names are known only by it
    if Path.cwd().is_relative_to(path.resolve()):
        raise InputError(
            f"{path} is the folder that you are in, or above it; give the name of another for the results"
        )
    if path.is_symlink() or (path.exists() and not path.is_dir()):
        raise InputError(f"{path} is no folder; give another name for the results")
    if not path.exists() or not any(path.iterdir()):
        return
    if held := next((file for file in reads if file.resolve().is_relative_to(path.resolve())), None):
        raise InputError(
            f"{path} holds {held}, which this command reads; give another folder for the results"
        )
    if not force:
        training = (path / CHECKPOINT).exists() and _holds_ours(path)
        unfinished = training and not (path / RESULT).exists()
        advice = "give another folder" + ("" if force is None else ", or --force to replace what is in it")
        if training:
            advice = f"{go_on(path)}{'' if unfinished else ' where it was stopped'}, or {advice}"
        raise InputError(
            f"{path} {'holds an unfinished training' if unfinished else 'is not empty'}; {advice}"
        )
    if not _holds_ours(path):
        raise InputError(f"{path} holds {FOREIGN}")
    below = (file for name in RESULTS for file in path.rglob(name) if file.parent != path)
    if nested := next(filter(_is_ours, below), None):
        raise InputError(f"{path} holds other results, in {nested.parent}; move them, or give another folder")


def refuse_foreign(path: Path, parts: str, pattern: str) -> None:
    """Raise InputError where a run that keeps its parts can neither begin nor go on.

    Args:
        path: folder of the results.
        parts: name of the folder of parts in it.
        pattern: files in that folder that tell who has written them.
    """
    if not (path / parts).is_dir():
        refuse_taken(path)
    elif visible(path / parts) and not any(_is_ours(file) for file in (path / parts).glob(pattern)):
        raise InputError(f"{path / parts} holds {FOREIGN}")


def visible(path: Path) -> list[Path]:
    """What is in a folder, if it is one, but for what a killed run was writing under a temporary name."""
    return [file for file in path.iterdir() if not file.name.startswith(".")] if path.is_dir() else []


def _holds_ours(path: Path) -> bool:
    """Whether a folder holds results, or a training that has begun."""
    ours = (*(path / name for name in RESULTS), path / FITS / "about.json")
    return (path / BEGUN).exists() or any(_is_ours(file) for file in ours)


def only_begun(path: Path) -> bool:
    """Whether a folder holds a training that was killed before its first checkpoint."""
    return (path / BEGUN).exists() and not any((path / name).exists() for name in (CHECKPOINT, *RESULTS))


def _is_ours(file: Path) -> bool:
    try:
        return str(json.loads(file.read_text(encoding="utf-8"))["program"]).startswith("hybrid_id ")
    except (OSError, ValueError, KeyError, TypeError):
        return False


@contextmanager
def results_folder(path: Path, *, force: bool) -> Iterator[Path]:
    """Yield an empty folder that takes the name `path` when everything in it is written.

    Results of an earlier run stay until then, and for good when something fails.
    """
    refuse_taken(path, force=force)
    made = make_parents(path)
    complete = False
    try:
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as temporary:
            new = Path(temporary) / "new"
            new.mkdir()
            yield new
            refuse_taken(path, force=force)  # a long run: somebody may have written there meanwhile
            old = Path(temporary) / "old"
            try:
                if path.exists():
                    with sole_writer(path):  # nobody's folder is taken under his hands
                        path.replace(old)
                new.replace(path)
                complete = True
            except BaseException:
                if old.exists() and not path.exists():
                    old.replace(path)
                raise
    finally:
        remove_empty([] if complete else made)


def go_on(path: Path) -> str:
    """How a stopped training goes on, as words for the user: with the settings that stand beside its checkpoint."""
    return f"'hybrid-id train {path / 'config.yaml'} --out {path} --resume' goes on"


def page_and_pictures(config: StudyConfig) -> tuple[str, str]:
    """The page and the pictures, as far as the config asks for them, for a list of what was written."""
    return "report.html, " if config.output.report else "", "pictures, " if config.output.figures else ""


@contextmanager
def sole_writer(path: Path) -> Iterator[None]:
    """Let no other run write into a folder that is filled bit by bit; a lock that a killed run leaves is none."""
    folder = os.open(path, os.O_RDONLY)
    try:
        fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    except BlockingIOError:
        raise InputError(f"another run is writing into {path}; wait for it, or give another folder") from None
    finally:
        os.close(folder)


def make_parents(path: Path) -> list[Path]:
    """Make the folders above a path, and try one beside it; returns those that were not there, innermost first."""
    missing: list[Path] = []
    try:
        missing = [folder for folder in path.absolute().parents if not folder.exists()]
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}."):
            return missing
    except OSError as error:
        remove_empty(missing)
        below_file = isinstance(error, FileExistsError | NotADirectoryError)
        why = "a folder above it is a file" if below_file else error.strerror
        raise InputError(f"{path} cannot be made ({why}); give another place") from None


def remove_empty(folders: list[Path]) -> None:
    """Remove folders that are empty, innermost first."""
    for folder in folders:
        with suppress(OSError):
            folder.rmdir()
