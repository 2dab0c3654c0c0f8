"""The commands by name, and the one place where errors become messages and exit codes."""

import errno
import re
import sys
from typing import Annotated, Any, NoReturn

import typer
from typer.core import TyperGroup
from typer.exceptions import TyperException

from hybrid_id import __version__
from hybrid_id.cli.ablate import ablate
from hybrid_id.cli.blind import blind
from hybrid_id.cli.check import check
from hybrid_id.cli.console import terminated_as_interrupted
from hybrid_id.cli.demo import demo
from hybrid_id.cli.diagnose import diagnose
from hybrid_id.cli.doctor import doctor
from hybrid_id.cli.excite import excite
from hybrid_id.cli.export import export
from hybrid_id.cli.identify import identify
from hybrid_id.cli.init import init
from hybrid_id.cli.lists import components, effects
from hybrid_id.cli.replay import compare, simulate
from hybrid_id.cli.reproduce import reproduce
from hybrid_id.cli.schema import schema
from hybrid_id.cli.train import train
from hybrid_id.errors import CONTROL, InputError, has_control, shortened, shown
from hybrid_id.reading import reading_and_writing_apart

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS)
"""The disk is full, the user's share of it is, a file may not be that large, or nobody may write there."""
NAMED = (errno.EACCES, errno.EPERM, errno.ENAMETOOLONG, errno.ENOTDIR, errno.ELOOP)
"""A name that the user gave leads nowhere: no right to go there, too long, below a file, in a circle."""

LONGEST_WORD = 400
"""Characters of one word of a message; paths are shorter."""
THEIRS = {
    r"Value error, ": "",
    r"Input should be a valid (\w+)[^;]*": r"it must be of type \1",
    r"Input should be": "it must be",
}
"""Wordings of the library that reads command lines, and how this program says the same."""


class Commands(TyperGroup):
    """Wrong input ends with one sentence and exit code 2; a fault of the program keeps its traceback."""

    def invoke(self, ctx: typer.Context) -> Any:  # type: ignore[override]
        """Run a command; Ctrl-C says what is kept, and so does SIGTERM."""
        try:
            with terminated_as_interrupted(), reading_and_writing_apart():
                return super().invoke(ctx)  # type: ignore[arg-type]
        except KeyboardInterrupt as stop:
            raise typer.Exit(_refuse(str(stop) or "stopped; no results were written", 130)) from None

    def main(self, args: Any = None, prog_name: str | None = None, **extra: Any) -> NoReturn:
        """Run a command line and leave with its exit code."""
        extra["standalone_mode"] = False
        args = list(sys.argv[1:] if args is None else args)
        try:
            _refuse_control(args)
            code = super().main(args=args or ["--help"], prog_name="hybrid-id", **extra)
        except InputError as error:
            code = _refuse(str(error))
        except TyperException as error:  # an option or argument that does not exist, or has a wrong value
            path = getattr(getattr(error, "ctx", None), "command_path", "hybrid-id")
            code = _refuse(f"{_plain(error.format_message())}; see '{path} --help'")
        except OSError as error:
            where = f" ({error.filename})" if error.filename else ""
            if error.errno in FULL:
                said = f"the results cannot be written: {error.strerror}{where}; make room or give another folder"
            elif error.errno in NAMED and error.filename:
                said = f"{error.filename}: {error.strerror}; give another name or the right to use it"
            else:
                raise
            code = _refuse(said)
        except typer.Abort:
            code = _refuse("stopped", 130)
        sys.exit(code if isinstance(code, int) else 0)


def _plain(message: str) -> str:
    """A message of the library that reads command lines, in the words of this program."""
    for theirs, ours in THEIRS.items():
        message = re.sub(theirs, ours, message)
    return message.rstrip(".")


def _refuse_control(args: list[str]) -> None:
    """Raise InputError for a word that could be neither shown nor written: a path is both, after all the work."""
    if odd := next((word for word in args if has_control(word, lines=True)), None):
        raise InputError(f"'{shown(odd)}' on the command line {CONTROL}; rename the file, or type it anew")


def _refuse(message: str, code: int = 2) -> int:
    sentence = shown(" ".join(shortened(word, LONGEST_WORD) for word in message.split()))
    print(f"Error: {sentence}{'' if sentence.endswith(('.', '?')) else '.'}", file=sys.stderr)
    return code


app = typer.Typer(
    cls=Commands,
    name="hybrid-id",
    add_completion=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)


def _version(wanted: bool) -> None:
    if wanted:
        print(f"hybrid_id {__version__}")
        raise typer.Exit


@app.callback()
def _hybrid_id(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version and leave.", callback=_version, is_eager=True)
    ] = False,
) -> None:
    """Physical parameters of robot drives from records of voltage and angle, with statistics that say what to trust."""


for command in (
    init, check, excite, identify, train, ablate, diagnose, simulate, compare, export, reproduce, demo, components,
    effects, schema, doctor,
):  # fmt: skip
    app.command()(command)
app.add_typer(blind, name="blind")
