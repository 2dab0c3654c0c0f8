"""Folders and files of results: complete under their names, or not there at all; filled bit by bit, or resumed."""

import json
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from hybrid_id import __version__
from hybrid_id.cli.console import remark
from hybrid_id.config import StudyConfig
from hybrid_id.errors import CONTROL, InputError, has_control, shown
from hybrid_id.reading import announce, read_below, read_object
from hybrid_id.records.files import HIDDEN, hidden_beside, locked, write_together, write_whole

if TYPE_CHECKING:
    from hybrid_id.study import Kept

RESULT = "result.json"
DIAGNOSIS = "diagnosis.json"
CHECKPOINT = "checkpoint.pt"
SETTINGS = "config.yaml"
EVENTS = "tensorboard"
FITS = "fits"
"""Folder of the fits that an unfinished diagnosis or identification keeps."""
ABOUT = "about.json"
"""Says in that folder who has made it."""
BEGUN = ".begun"
"""Marks a training that is not complete; says whether it has put earlier results aside."""
RESULTS = (RESULT, DIAGNOSIS)
MADE = {"identification": ("identify", RESULT), "diagnosis": ("diagnose", DIAGNOSIS)}
"""Commands whose fits are kept, and the file that says that all is written."""
ASIDE = "earlier results are aside"
WRITTEN = ".written"
"""Names the files that complete results consist of; others in their folder are the user's, which nothing replaces."""
FOREIGN = "files that are no results of hybrid-id; give another folder"


def required(path: Path | None) -> Path:
    """The folder that was asked for, by option or config."""
    if path is None:
        raise InputError(
            "there is no folder for the results; give --out DIR, or 'output: {folder: DIR}' in the config"
        )
    return path


def refuse_taken(path: Path, *, force: bool | None = None, reads: Iterable[Path] | None = ()) -> None:
    """Raise InputError where results cannot go, before anything is computed.

    Args:
        path: Folder of the results.
        force: Whether results of an earlier run may be replaced; other files never are. None for a command that never
            replaces any, and so has no --force to advise.
        reads: Files and folders that the command is going to read; a folder that holds one of them, or a file that
            has been read, is not replaced. None for a folder that is filled further.
    """
    remove_empty(make_parents(path))  # a trial: rights and names are known only by it
    if Path.cwd().is_relative_to(path.resolve()):
        raise InputError(
            f"{path} is the folder that you are in, or above it; give the name of another for the results"
        )
    if path.is_symlink() or (path.exists() and not path.is_dir()):
        what = "a link" if path.is_symlink() else "no folder"
        raise InputError(f"{path} is {what}; give another name for the results")
    if not path.exists() or not any(path.iterdir()):
        return
    below = [file for file in reads or () if file.resolve().is_relative_to(path.resolve())]
    below += [] if reads is None else read_below(path)
    settings = path.resolve() / SETTINGS  # of an earlier run, which this one may follow, and writes again
    if held := next((file for file in below if file != settings), None):
        same = held.resolve() == path.resolve()
        what = "is what this command reads" if same else f"holds {held}, which this command reads"
        raise InputError(f"{path} {what}; give another folder for the results")
    ours = (*(path / name for name in RESULTS), path / FITS / ABOUT)
    if force is not None and not (path / BEGUN).exists() and not any(map(_is_ours, ours)):
        raise InputError(f"{path} holds {FOREIGN}")
    if not force:
        training = (path / CHECKPOINT).exists()
        unfinished = training and not (path / RESULT).exists()
        advice = "give another folder" + ("" if force is None else ", or --force to replace what is in it")
        if training:
            advice = f"{go_on(path)}{'' if unfinished else ' where it was stopped'}, or {advice}"
        raise InputError(
            f"{path} {'holds an unfinished training' if unfinished else 'is not empty'}; {advice}"
        )
    below = (file for name in RESULTS for file in path.rglob(name) if file.parent != path)
    if nested := next(filter(_is_ours, below), None):
        raise InputError(f"{path} holds other results, in {nested.parent}; move them, or give another folder")
    if reads is not None and (own := _added(path)):
        raise InputError(
            f"{own[0]} is none of the results that would be replaced; move it, or give another folder"
        )


def refuse_foreign(path: Path, parts: str, pattern: str) -> None:
    """Raise InputError where a run that keeps its parts can neither begin nor go on.

    Args:
        path: folder of the results.
        parts: name of the folder of parts in it.
        pattern: files in that folder that say who has written them.
    """
    if not (path / parts).is_dir():
        refuse_taken(path)
    elif visible(path / parts) and not any(_is_ours(file) for file in (path / parts).glob(pattern)):
        raise InputError(f"{path / parts} holds {FOREIGN}")


def visible(path: Path) -> list[Path]:
    """What is in a folder, if it is one, but for what a killed run was writing under a temporary name."""
    return [file for file in path.iterdir() if not file.name.startswith(".")] if path.is_dir() else []


def only_begun(path: Path) -> bool:
    """Whether a folder holds a training that was killed before its first checkpoint."""
    return (path / BEGUN).exists() and not any((path / name).exists() for name in (CHECKPOINT, *RESULTS))


def _name_files(path: Path, but: Iterable[Path] = ()) -> None:
    """Write down which files results consist of, as they are complete: all but those that were somebody's before."""
    files = sorted({file for file in path.rglob("*") if file.is_file()} - {path / WRITTEN, *but})
    write_whole(path / WRITTEN, "".join(f"{file.relative_to(path)}\n" for file in files))


def _added(path: Path) -> list[Path]:
    """Files in a folder of complete results that none of these are; what goes on with a run is left out."""
    if not (path / WRITTEN).is_file():
        return []
    known = {*(path / WRITTEN).read_text(encoding="utf-8").splitlines(), WRITTEN, CHECKPOINT, BEGUN}
    files = [file.relative_to(path) for file in sorted(path.rglob("*")) if file.is_file()]
    return [path / f for f in files if str(f) not in known and f.parts[0] not in (FITS, EVENTS)]


def _is_ours(file: Path) -> bool:
    try:
        return str(read_object(file, "result").get("program")).startswith("hybrid_id ")
    except (OSError, InputError):
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
        with hidden_beside(path) as temporary:
            new, old = temporary / "new", temporary / "old"
            new.mkdir()
            yield new
            _name_files(new)
            refuse_taken(path, force=force)  # a long run: somebody may have written there meanwhile
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
    return f"'hybrid-id train {path / SETTINGS} --out {path} --resume' goes on"


@contextmanager
def sole_writer(path: Path) -> Iterator[None]:
    """Let no other run write into a folder that is filled bit by bit; a lock that a killed run leaves is none."""
    with ExitStack() as stack:
        try:
            stack.enter_context(locked(path))
        except BlockingIOError:
            raise InputError(
                f"another run is writing into {path}; wait for it, or give another folder"
            ) from None
        yield


def make_parents(path: Path) -> list[Path]:
    """Make the folders above a path, and try one beside it; returns those that were not there, innermost first."""
    missing: list[Path] = []
    if has_control(str(path.absolute())):  # results hold paths
        raise InputError(f"the path {shown(str(path.absolute()))} {CONTROL}; work in another folder")
    try:
        missing = [folder for folder in path.absolute().parents if not folder.exists()]
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.{HIDDEN}"):
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


def files_to_write(out: Path, *endings: str, force: bool) -> list[Path]:
    """The file that the user has named, and those of its name that go with it, by their endings.

    Raises:
        InputError: one of them cannot be made, exists, or belongs to a folder of results, to a dataset or to the user.
    """
    _refuse_file(out, out, force)
    remove_empty(make_parents(out))  # a place that cannot be written is said before anything is computed
    files = [out, *(out.with_suffix(ending) for ending in endings)]
    if out in files[1:]:
        raise InputError(
            f"{out} would also be the name of the {_kind_of(out)} beside it; take another ending"
        )
    for file in files[1:]:
        _refuse_file(file, out, force)
    return files


def write_files(contents: Mapping[Path, str | bytes]) -> None:
    """Write files that belong together, all or none, and the folders above them."""
    made = [folder for file in contents for folder in make_parents(file)]
    try:
        write_together(contents)
    except BaseException:
        remove_empty(made)
        raise


def _refuse_file(path: Path, named: Path, force: bool) -> None:
    alone = path == named
    which = f"{path}" if alone else f"{path}, the {_kind_of(path)} that goes with {named.name},"
    if path.is_dir():
        raise InputError(f"{which} is a folder; give {'the name of a file' if alone else 'another name'}")
    if path.exists() and not force:
        both = "" if alone else " to replace both"
        raise InputError(f"{which} exists; give another name than {named.name}, or --force{both}")
    if path.name in (*RESULTS, "model.yaml", "dataset.yaml") and path.exists():
        raise InputError(
            f"{path} belongs to a dataset or to earlier results, which nothing replaces; give another name"
        )
    announce(path)
    if path.is_symlink() or (path.exists() and not path.is_file()):
        raise InputError(f"{which} is a link or no regular file; give the name of a file of its own")
    from hybrid_id.records.dataset_file import FILE_NAME
    from hybrid_id.records.yaml_file import read_yaml

    dataset, records = path.with_name(FILE_NAME), None
    if path.exists() and dataset.is_file():
        with suppress(InputError):  # a fault of the dataset file concerns those alone who use it
            records = read_yaml(dataset).get("records")
    entries = records if isinstance(records, list) else []
    patterns = [entry.get("file") for entry in entries if isinstance(entry, dict)]
    if any(isinstance(pattern, str) and path.match(pattern) for pattern in patterns):
        raise InputError(
            f"{path} is a record of the dataset beside it, which nothing replaces; give another name"
        )


def _kind_of(path: Path) -> str:
    return "page" if path.suffix == ".html" else "description"


def _refuse_resume_and_force(resume: bool, force: bool) -> None:
    if resume and force:
        raise InputError("--resume goes on with what is kept, --force begins anew; leave one of them out")


@contextmanager
def kept_fits(
    home: Path, noun: str, *, force: bool, resume: bool, reads: Iterable[Path] = ()
) -> Iterator["Kept"]:
    """Yield where the fits of a long run are kept, in the folder of its results.

    The folder of fits goes with the earlier results when new ones take their place. It stays where a run is stopped,
    unless nothing has been fitted. Going on with a run that is complete ends the command, and is no fault.

    Args:
        home: folder of the results.
        noun: diagnosis or identification.
        force: whether results of an earlier run may be replaced.
        resume: whether to go on with fits that an earlier run has kept.
        reads: files and folders that the command reads.

    Raises:
        InputError: the results cannot go there, or --resume is missing.
        typer.Exit: the run to resume is complete.
    """
    from hybrid_id.reporting.provenance import program
    from hybrid_id.study import Kept

    _refuse_resume_and_force(resume, force)
    fits, kind, (command, file) = home / FITS, "", MADE[noun]
    with suppress(OSError, InputError):  # what has kept fits there
        kind = str(read_object(fits / ABOUT, "list of fits").get("kind", "diagnosis"))
    if resume and fits.is_dir():
        refuse_foreign(home, FITS, ABOUT)
        if kind not in (noun, ""):
            raise InputError(f"{home} holds an unfinished {kind}; give another folder")
    else:
        if kind and not force:
            raise InputError(
                f"{home} holds an unfinished {kind}; --resume goes on with it, or give another folder, or --force to "
                "replace what is in it"
            )
        complete = resume and not force and _is_ours(home / file)
        if complete and read_object(home / file, "result").get("command") == command:
            remark(
                f"{home} holds a complete {noun} ({file}), by the settings in its config.yaml: nothing is left to "
                "resume; --force makes it anew"
            )
            raise typer.Exit
        refuse_taken(home, force=force, reads=reads)
    made = [home, *make_parents(home)]
    fits.mkdir(parents=True, exist_ok=True)
    with sole_writer(fits):
        if not resume:
            for file in fits.glob("*.npz"):
                file.unlink()
        kept = Kept(fits, program())
        if resume and not kept.count:
            remark(f"no fit is kept in {home}, so this {noun} starts anew")
        try:
            (fits / ABOUT).write_text(
                json.dumps({"program": f"hybrid_id {__version__}", "kind": noun}) + "\n", encoding="utf-8"
            )
            yield kept
        except KeyboardInterrupt:
            if not kept.count:
                raise
            raise KeyboardInterrupt(
                f"stopped; {kept.count} fits are kept in {fits}, and the same command with --resume goes on"
            ) from None
        finally:
            if not kept.count:
                shutil.rmtree(fits, ignore_errors=True)
                remove_empty(made)


def keep_after(home: Path, folder: Path, kept: "Kept") -> str:
    """Move the fits to results that are not complete, so that --resume goes on with them; returns words that say so."""
    count = kept.count
    if not count:
        return ""
    (home / FITS).rename(folder / FITS)
    return f"; {count} fits are kept, and the same command with --resume goes on"


@contextmanager
def live_folder(path: Path, config: StudyConfig, *, force: bool, resume: bool) -> Iterator[None]:
    """Make the folder itself for a long run, so that others can look on; `result.json` comes in last.

    What an earlier run left is put aside as `path.old` (unless this one resumes it), comes back when the new run fails
    before its first checkpoint, and goes when it is complete. A new run saves its settings first; those that the
    checkpoint of a resumed one belongs to stay until this one is known to fit it. Ctrl-C says how to go on.

    Raises:
        InputError: the training can neither begin nor go on there.
    """
    _refuse_resume_and_force(resume, force)
    if resume and not (path / CHECKPOINT).exists():
        raise InputError(f"{path} holds no {CHECKPOINT} to go on from; leave out --resume to start anew")
    # what was killed before its first checkpoint has nothing to lose
    refuse_taken(path, force=force or resume or only_begun(path), reads=None if resume else config.reads)
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
    with sole_writer(path):
        own = _added(path)
        try:
            if not resume:
                (path / BEGUN).write_text(ASIDE if ours else "")
                config.save(path / SETTINGS)
            yield
        except BaseException as error:
            if not (path / CHECKPOINT).exists():
                shutil.rmtree(path)
                if ours:
                    aside.replace(path)
                remove_empty(made)
            elif isinstance(error, KeyboardInterrupt):
                raise KeyboardInterrupt(f"stopped; {go_on(path)} from its last checkpoint") from None
            raise
        (path / BEGUN).unlink(missing_ok=True)
        _name_files(path, but=own)
        if ours:
            shutil.rmtree(aside)


@contextmanager
def added_results(
    path: Path, last: str = RESULT, stale: Iterable[str] = ("*.png", "report.html", "models/*")
) -> Iterator[Path]:
    """Yield an empty folder whose files go into the folder `path` when all are written.

    Args:
        path: the folder, which is there.
        last: file that comes in last and says that all others are complete.
        stale: patterns of what an earlier end may have left.
    """
    with hidden_beside(path) as temporary:
        new = temporary / "new"
        new.mkdir()
        yield new
        (path / last).unlink(missing_ok=True)
        for old in (file for pattern in stale for file in path.glob(pattern)):
            old.unlink()
        (new / last).replace(temporary / last)
        for file in (p for p in new.rglob("*") if p.is_file()):  # a move needs no room
            place = path / file.relative_to(new)
            place.parent.mkdir(parents=True, exist_ok=True)
            file.replace(place)
        (temporary / last).replace(path / last)
