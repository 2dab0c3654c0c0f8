"""The commands by name, and the one place where errors become messages and exit codes."""

import errno
import itertools
import re
import sys
from importlib import import_module
from typing import Annotated, Any, NoReturn

import typer
from typer.core import TyperCommand, TyperGroup
from typer.exceptions import TyperException

from hybrid_id import __version__
from hybrid_id.cli.console import terminated_as_interrupted
from hybrid_id.errors import CONTROL, InputError, has_control, shortened, shown
from hybrid_id.reading import reading_and_writing_apart

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS)
"""The disk is full, the user's share of it is, a file may not be that large, or nobody may write there."""
NAMED = (errno.EACCES, errno.EPERM, errno.ENAMETOOLONG, errno.ENOTDIR, errno.ELOOP)
"""A name that the user gave leads nowhere: no right to go there, too long, below a file, in a circle."""

COMMANDS = {
    "init": "init", "check": "check", "excite": "excite", "identify": "identify", "train": "train", "ablate": "ablate",
    "diagnose": "diagnose", "simulate": "replay", "compare": "replay", "fleet": "fleet", "export": "export",
    "reproduce": "reproduce", "demo": "demo", "components": "lists", "effects": "lists", "schema": "schema",
    "doctor": "doctor", "blind": "blind",
}  # fmt: skip
"""Module of each command, which is imported when its command is asked for."""
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

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands.update({name: TyperCommand(name) for name in COMMANDS})  # until they are asked for

    def get_command(self, ctx: typer.Context | None, cmd_name: str) -> Any:  # type: ignore[override]
        """The command of a name, imported now; None without one."""
        if cmd_name in COMMANDS and getattr(self.commands[cmd_name], "callback", None) is None:
            work = getattr(import_module(f"hybrid_id.cli.{COMMANDS[cmd_name]}"), cmd_name)
            if not isinstance(work, typer.Typer):
                single, work = work, typer.Typer(add_completion=False, rich_markup_mode="rich")
                work.command(cmd_name)(single)
            self.commands[cmd_name] = typer.main.get_command(work)
            self.commands[cmd_name].name = cmd_name
        return self.commands.get(cmd_name)

    def resolve_command(self, ctx: typer.Context, args: list[str]) -> Any:  # type: ignore[override]
        """The command that a line names, and what is left of the line; options that count once may stand once."""
        name, command, rest = super().resolve_command(ctx, args)  # type: ignore[arg-type]
        inner = getattr(command, "commands", {}).get(rest[0]) if rest else None
        # raise InputError for an option that is given twice and of which all but the last would be passed over
        params = getattr(inner or command, "params", ())
        given = [word.partition("=")[0] for word in itertools.takewhile(lambda word: word != "--", rest)]
        for one in (one for one in params if one.param_type_name == "option"):
            sides = [
                next((name for name in names if name in given), "")
                for names in (one.opts, one.secondary_opts)
            ]
            if all(sides):
                raise InputError(f"{' and '.join(sides)} contradict each other; leave one of them out")
            times = sum(word in one.opts or word[:2] in one.opts for word in given)  # -oOUT as well
            if times > 1 and not (one.multiple or one.is_flag):
                raise InputError(f"{one.opts[0]} is given twice, and one counts; leave the other out")
        return name, command, rest

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
            # raise InputError for a word that could be neither shown nor written: a path is both, after all the work
            if odd := next((word for word in args if has_control(word, lines=True)), None):
                raise InputError(
                    f"'{shown(odd)}' on the command line {CONTROL}; rename the file, or type it anew"
                )
            code = super().main(args=args or ["--help"], prog_name="hybrid-id", **extra)
        except InputError as error:
            code = _refuse(str(error))
        except TyperException as error:  # an option or argument that does not exist, or has a wrong value
            named = ["hybrid-id", *(word for word in args[:1] if word in COMMANDS)]
            path = getattr(getattr(error, "ctx", None), "command_path", " ".join(named))
            values = getattr(getattr(error, "param", None), "nargs", 1)
            apart = f" ({values} values, a space between them)" if values > 1 else ""
            code = _refuse(f"{_plain(error.format_message())}{apart}; see '{path} --help'")
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
