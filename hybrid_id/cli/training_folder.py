"""The folder of a training: others look on while it is filled, and one that was stopped goes on in it."""

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hybrid_id.cli.folder import (
    ASIDE,
    BEGUN,
    CHECKPOINT,
    RESULT,
    go_on,
    make_parents,
    only_begun,
    refuse_taken,
    remove_empty,
    sole_writer,
)
from hybrid_id.config import StudyConfig
from hybrid_id.errors import InputError


@contextmanager
def resumable(path: Path) -> Iterator[None]:
    """Let Ctrl-C say how a training goes on whose checkpoint is in the folder."""
    try:
        yield
    except KeyboardInterrupt:
        if (path / CHECKPOINT).exists():
            raise KeyboardInterrupt(f"stopped; {go_on(path)} from its last checkpoint") from None
        raise


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
    # what was killed before its first checkpoint has nothing to lose
    refuse_taken(path, force=force or resume or only_begun(path), reads=[] if resume else config.reads)


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
    if only_begun(path) and not resume:  # what it had put aside stays there
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
            remove_empty(made)
        raise
    (path / BEGUN).unlink(missing_ok=True)
    if aside:
        shutil.rmtree(aside)


@contextmanager
def added_results(path: Path) -> Iterator[Path]:
    """Yield an empty folder whose files go into the folder `path` when all are written, `result.json` last."""
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as temporary:
        new = Path(temporary) / "new"
        new.mkdir()
        yield new
        (path / RESULT).unlink(missing_ok=True)
        for old in (*path.glob("*.png"), *path.glob("models/*")):  # an earlier end may have drawn more
            old.unlink()
        last = new / RESULT
        last.replace(Path(temporary) / RESULT)
        for file in (p for p in new.rglob("*") if p.is_file()):  # a move needs no room
            place = path / file.relative_to(new)
            place.parent.mkdir(parents=True, exist_ok=True)
            file.replace(place)
        (Path(temporary) / RESULT).replace(path / RESULT)
