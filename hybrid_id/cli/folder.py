"""The folder of results: complete under its name, or not there at all."""

import fcntl
import json
import os
import shutil
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
BEGUN = ".begun"
"""Marks a training that is not complete; says whether it has put earlier results aside."""
RESULTS = (RESULT, DIAGNOSIS)
ASIDE = "earlier results are aside"


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
    _remove(make_parents(path))  # a trial: rights and names are known only by it
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
        unfinished = (path / CHECKPOINT).exists() and not (path / RESULT).exists()
        advice = "give another folder" + ("" if force is None else ", or --force to replace what is in it")
        if (path / CHECKPOINT).exists():
            advice = f"{go_on(path)}{'' if unfinished else ' where it was stopped'}, or {advice}"
        raise InputError(
            f"{path} {'holds an unfinished training' if unfinished else 'is not empty'}; {advice}"
        )
    if not (_only_begun(path) or (path / CHECKPOINT).exists() or any(_is_ours(path / n) for n in RESULTS)):
        raise InputError(f"{path} holds files that are no results of hybrid-id; give another folder")


def _only_begun(path: Path) -> bool:
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
            if path.exists():
                with sole_writer(path):  # nobody's folder is taken under his hands
                    path.replace(Path(temporary) / "old")
            new.replace(path)
            complete = True
    finally:
        _remove([] if complete else made)


@contextmanager
def resumable(path: Path) -> Iterator[None]:
    """Let Ctrl-C say how a training goes on whose checkpoint is in the folder."""
    try:
        yield
    except KeyboardInterrupt:
        if (path / CHECKPOINT).exists():
            raise KeyboardInterrupt(f"stopped; {go_on(path)} from its last checkpoint") from None
        raise


def go_on(path: Path) -> str:
    """How a stopped training goes on, as words for the user: with the settings that stand beside its checkpoint."""
    return f"'hybrid-id train {path / 'config.yaml'} --out {path} --resume' goes on"


def page_and_pictures(config: StudyConfig) -> tuple[str, str]:
    """The page and the pictures, as far as the config asks for them, for a list of what was written."""
    return "report.html, " if config.output.report else "", "pictures, " if config.output.figures else ""


def stopped(path: Path) -> str:
    """What to say of a training that Ctrl-C has ended with results."""
    return f"stopped by Ctrl-C; {go_on(path)} from here"


def leave_without_checkpoint(path: Path, *, interrupted: bool) -> None:
    """End a training that Ctrl-C has stopped before anything was kept, before it shows what nobody could go on from."""
    if interrupted and not (path / CHECKPOINT).exists():
        raise KeyboardInterrupt("stopped before the first checkpoint; no results were written")


def refuse_training(path: Path, config: StudyConfig, *, force: bool, resume: bool) -> None:
    """Raise InputError where a training can neither begin nor go on, before anything is computed."""
    if resume and not (path / CHECKPOINT).exists():
        raise InputError(f"{path} holds no {CHECKPOINT} to go on from; leave out --resume to start anew")
    refuse_taken(path, force=force or resume, reads=[] if resume else config.reads)


@contextmanager
def live_folder(path: Path, config: StudyConfig, *, force: bool, resume: bool) -> Iterator[None]:
    """Make the folder itself for a long run, so that others can look on; `result.json` comes in last.

    What an earlier run left is put aside as `path.old` (unless this one resumes it), comes back when the new run fails
    before its first checkpoint, and goes when it is complete. A new run saves its settings first; those that the
    checkpoint of a resumed one belongs to stay until this one is known to fit it.
    """
    refuse_training(path, config, force=force, resume=resume)
    made = make_parents(path)
    aside = path.with_name(f"{path.name}.old")
    replaced = path.exists() and any(path.iterdir()) and not resume
    if replaced:
        with sole_writer(path):  # nobody's folder is put aside under his hands
            pass
    ours = (path / BEGUN).exists() and (path / BEGUN).read_text() == ASIDE and aside.exists()
    if _only_begun(path) and not resume:  # what it had put aside stays there
        shutil.rmtree(path)
    elif replaced:
        if aside.exists():
            raise InputError(f"{aside} is in the way, the place for the results that are replaced; remove it")
        path.replace(aside)
        ours = True
    path.mkdir(exist_ok=True)
    with sole_writer(path), _until_complete(path, aside if ours else None, made):
        if not resume:
            (path / BEGUN).write_text(ASIDE if ours else "")
            config.save(path / "config.yaml")
        yield


@contextmanager
def _until_complete(path: Path, aside: Path | None, made: list[Path]) -> Iterator[None]:
    """Bring back what was put aside when a run ends before its first checkpoint, remove it when one is complete."""
    try:
        yield
    except BaseException:
        if not (path / CHECKPOINT).exists():
            shutil.rmtree(path)
            if aside:
                aside.replace(path)
            _remove(made)
        raise
    (path / BEGUN).unlink(missing_ok=True)
    if aside:
        shutil.rmtree(aside)


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


@contextmanager
def added_results(path: Path) -> Iterator[Path]:
    """Yield an empty folder whose files go into the folder `path` when all are written, `result.json` last."""
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as temporary:
        new = Path(temporary) / "new"
        new.mkdir()
        yield new
        (path / RESULT).unlink(missing_ok=True)
        last = new / RESULT
        last.replace(Path(temporary) / RESULT)
        shutil.copytree(new, path, dirs_exist_ok=True)
        (Path(temporary) / RESULT).replace(path / RESULT)


def make_parents(path: Path) -> list[Path]:
    """Make the folders above a path, and try one beside it; returns those that were not there, innermost first."""
    missing: list[Path] = []
    try:
        missing = [folder for folder in path.absolute().parents if not folder.exists()]
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}."):
            return missing
    except OSError as error:
        _remove(missing)
        below_file = isinstance(error, FileExistsError | NotADirectoryError)
        why = "a folder above it is a file" if below_file else error.strerror
        raise InputError(f"{path} cannot be made ({why}); give another place") from None


def _remove(folders: list[Path]) -> None:
    """Remove folders that are empty, innermost first."""
    for folder in folders:
        with suppress(OSError):
            folder.rmdir()
