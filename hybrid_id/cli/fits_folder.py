"""Fits that a diagnosis keeps beside its results, so that a run which was stopped goes on with --resume."""

import json
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from hybrid_id import __version__
from hybrid_id.cli.folder import (
    DIAGNOSIS,
    FITS,
    make_parents,
    refuse_foreign,
    refuse_taken,
    remove_empty,
    sole_writer,
)
from hybrid_id.errors import InputError

if TYPE_CHECKING:
    from hybrid_id.diagnosis.keep import Kept

ABOUT = "about.json"


@contextmanager
def kept_fits(home: Path, *, force: bool, resume: bool, reads: Iterable[Path] = ()) -> Iterator["Kept"]:
    """Yield where the fits of a search are kept, in the folder of its results.

    The folder of fits goes with the earlier results when new ones take their place. It stays where a run is stopped,
    unless nothing has been fitted.

    Args:
        home: folder of the results.
        force: whether results of an earlier run may be replaced.
        resume: whether to go on with fits that an earlier run has kept.
        reads: files and folders that the command reads.

    Raises:
        InputError: the results cannot go there, or --resume is missing.
    """
    from hybrid_id.diagnosis.keep import Kept
    from hybrid_id.reporting.provenance import program

    fits = home / FITS
    if resume and fits.is_dir():
        refuse_foreign(home, FITS, ABOUT)
    else:
        if (fits / ABOUT).exists() and not force:
            raise InputError(
                f"{home} holds an unfinished diagnosis; --resume goes on with it, or give another folder, or --force "
                "to replace what is in it"
            )
        if resume and not force and (home / DIAGNOSIS).exists():
            raise InputError(f"{home} holds a complete diagnosis; there is nothing to resume")
        refuse_taken(home, force=force, reads=reads)
    made = [home, *make_parents(home)]
    fits.mkdir(parents=True, exist_ok=True)
    with sole_writer(fits):
        if not resume:
            for file in fits.glob("*.npz"):
                file.unlink()
        (fits / ABOUT).write_text(
            json.dumps({"program": f"hybrid_id {__version__}"}) + "\n", encoding="utf-8"
        )
        kept = Kept(fits, program())
        try:
            yield kept
        except InputError:
            shutil.rmtree(fits)  # the same command would end alike
            raise
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


def keep_after(home: Path, folder: Path) -> None:
    """Move the fits to results that are not complete, so that --resume goes on with them."""
    (home / FITS).rename(folder / FITS)
