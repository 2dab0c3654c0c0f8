"""The commands by name, and the one place where errors become messages and exit codes."""

import errno
import itertools
import re
import sys
from collections.abc import Sequence
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
    "init": (
        "init",
        "Write dataset.yaml and model.yaml for logs: columns, units, signs, sampling and roles, each with its "
        "evidence.",
    ),
    "check": (
        "check",
        "Check records: quality, sampling, excitation, and with a model which of its parameters they identify.",
    ),
    "excite": (
        "excite",
        "Design a multisine of least crest factor and write it as CSV, and beside it as JSON how it was made.",
    ),
    "identify": (
        "identify",
        "Identify one parameter set for each train record (or one over all): variation, cross-validation, reliability.",
    ),
    "train": (
        "train",
        "Train through the differential equation by the adjoint method; the same results as identify, and TensorBoard.",
    ),
    "ablate": (
        "ablate",
        "Physics only or hybrid? Arms on the same records and seeds, paired differences, and the answer in words.",
    ),
    "diagnose": (
        "diagnose",
        "Find out why records and the nominal model disagree: which effects explain how much of the gap, and what "
        "remains.",
    ),
    "simulate": (
        "replay",
        "Replay records through a model: report.html, one CSV a record with measured and simulated outputs, pictures.",
    ),
    "compare": (
        "replay",
        "Put models side by side on the same records: report.html, comparison.csv (fit, normalised RMSE), pictures.",
    ),
    "fleet": (
        "fleet",
        "Identify many robots of one kind: the fleet's mean and spread, and which robot stands out and why.",
    ),
    "export": (
        "export",
        "Write a model for MuJoCo, parameter ranges for domain randomisation, or one step as a torch program.",
    ),
    "reproduce": (
        "reproduce",
        "Reproduce the paper on digital twins: every table and figure, printed values beside ours, on one page.",
    ),
    "demo": (
        "demo",
        "Identify a drive, or an arm, from simulated records whose truth is known, and show estimates beside the "
        "truth.",
    ),
    "components": (
        "lists",
        "List every kind of component with its places, parameters and units, and its law.",
    ),
    "effects": (
        "lists",
        "List the effects that `diagnose` can name, what each is mistaken for, and what distinguishes the two.",
    ),
    "schema": (
        "schema",
        "Write the JSON schema of a settings file, for editors: they complete keys, say what they mean and mark "
        "faults.",
    ),
    "doctor": (
        "doctor",
        "Show versions, device, threads and compiler, and identify a small drive whose truth is known.",
    ),
    "blind": (
        "blind",
        "Cases whose unmodelled effect is withheld: make them, diagnose them, score the diagnoses.",
    ),
}
"""Module and first sentence of each command. A module is imported when its command is run: the list of all imports
none. A test keeps the sentences equal to those that the commands have themselves."""
LONGEST_WORD = 400
"""Characters of one word of a message; paths are shorter."""
THEIRS = {
    r"Value error, ": "",
    r"Input should be a valid (\w+)[^;]*": r"it must be of type \1",
    r"Input should be": "it must be",
}
"""Wordings of the library that reads command lines, and how this program says the same."""


class Listed(TyperCommand):
    """A command whose module has not been imported."""


class Commands(TyperGroup):
    """Wrong input ends with one sentence and exit code 2; a fault of the program keeps its traceback."""

    listing = False
    """Whether only names and first sentences are asked for."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands.update({name: Listed(name, help=sentence) for name, (_, sentence) in COMMANDS.items()})

    def get_command(self, ctx: typer.Context | None, cmd_name: str) -> Any:  # type: ignore[override]
        """The command of a name, None without one; in the list of all it knows its first sentence alone."""
        found = self.commands.get(cmd_name)
        if self.listing or not isinstance(found, Listed):
            return found
        work = getattr(import_module(f"hybrid_id.cli.{COMMANDS[cmd_name][0]}"), cmd_name)
        if not isinstance(work, typer.Typer):
            single, work = work, typer.Typer(add_completion=False, rich_markup_mode="rich")
            work.command(cmd_name)(single)
        self.commands[cmd_name] = typer.main.get_command(work)
        self.commands[cmd_name].name = cmd_name
        return self.commands[cmd_name]

    def format_help(self, ctx: typer.Context, formatter: Any) -> None:  # type: ignore[override]
        """Write the list of all commands."""
        self.listing = True
        try:
            super().format_help(ctx, formatter)  # type: ignore[arg-type]
        finally:
            self.listing = False

    def resolve_command(self, ctx: typer.Context, args: list[str]) -> Any:  # type: ignore[override]
        """The command that a line names, and what is left of the line; options that count once may stand once."""
        name, command, rest = super().resolve_command(ctx, args)  # type: ignore[arg-type]
        inner = getattr(command, "commands", {}).get(rest[0]) if rest else None
        _refuse_twice(getattr(inner or command, "params", ()), rest)
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
            _refuse_control(args)
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


def _refuse_control(args: list[str]) -> None:
    """Raise InputError for a word that could be neither shown nor written: a path is both, after all the work."""
    if odd := next((word for word in args if has_control(word, lines=True)), None):
        raise InputError(f"'{shown(odd)}' on the command line {CONTROL}; rename the file, or type it anew")


def _refuse_twice(params: Sequence[Any], words: list[str]) -> None:
    """Raise InputError for an option that is given twice and of which all but the last would be passed over."""
    given = [word.partition("=")[0] for word in itertools.takewhile(lambda word: word != "--", words)]
    for one in (one for one in params if one.param_type_name == "option"):
        sides = [
            next((name for name in names if name in given), "") for names in (one.opts, one.secondary_opts)
        ]
        if all(sides):
            raise InputError(f"{' and '.join(sides)} contradict each other; leave one of them out")
        times = sum(word in one.opts or word[:2] in one.opts for word in given)  # -oOUT as well
        if times > 1 and not (one.multiple or one.is_flag):
            raise InputError(f"{one.opts[0]} is given twice, and one counts; leave the other out")


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
