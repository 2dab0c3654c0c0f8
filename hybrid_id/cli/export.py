"""`export`: what was found, in the formats of others."""

from collections.abc import Sequence
from contextlib import ExitStack
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hybrid_id.cli.console import remark, show
from hybrid_id.cli.folder import RESULT, refuse_file, result_file
from hybrid_id.cli.inputs import read_model, records_to_replay
from hybrid_id.cli.options import JsonOption, use_threads
from hybrid_id.cli.results import write_last
from hybrid_id.errors import InputError

if TYPE_CHECKING:
    from hybrid_id.export.replay import Agreement
    from hybrid_id.systems.chain import System

SAMPLE_TIME, WIDTH = 0.002, 0.5
"""Defaults of the torch program: its step [s], and the speed over which it smooths dry friction [rad/s]."""


class Format(StrEnum):
    """What to write."""

    mjcf = "mjcf"
    ranges = "ranges"
    torch = "torch"


def export(
    model: Annotated[
        Path,
        typer.Argument(
            metavar="MODEL", help="Model file, or a folder of results with model.yaml.", show_default=False
        ),
    ],
    to: Annotated[
        Format,
        typer.Option(
            help="mjcf: a MuJoCo model; ranges: for domain randomisation; torch: one step as a program."
        ),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="File to write.", show_default=False)],
    check: Annotated[
        Path | None,
        typer.Option(help="Dataset to replay in MuJoCo and here, side by side.", show_default=False),
    ] = None,
    sample_time: Annotated[
        float | None,
        typer.Option(
            help="Step of the torch program in s.", min=1e-6, max=1.0, show_default=str(SAMPLE_TIME)
        ),
    ] = None,
    width: Annotated[
        float | None,
        typer.Option(
            help="Speed in rad/s over which the torch program smooths dry friction.",
            min=1e-9,
            show_default=str(WIDTH),
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace the file.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Write a model for MuJoCo, parameter ranges for domain randomisation, or one step as a torch program.

    What the format cannot carry is said in one sentence an effect, here and in the file (beside a torch program: in the
    JSON of the same name). With --check, records are replayed through the exported MuJoCo model and through ours, and
    the difference is stated as normalised RMSE.
    """
    _refuse_foreign_options(to, check, sample_time, width)
    refuse_file(out, force=force)
    beside = _description_beside(out, to)
    if beside is not None:
        refuse_file(beside, force=force)
    use_threads(1)
    from hybrid_id.reporting.results import as_json as to_json

    file = model / "model.yaml" if model.is_dir() else model
    system = read_model(file)
    rows: list[Agreement] = []
    if to is Format.ranges:
        described, content = _ranges(system, model), b""
    elif to is Format.mjcf:
        content, described, rows = _mjcf(system, check, out)
    else:
        content, described = _program(system, sample_time or SAMPLE_TIME, width or WIDTH)
    about = {"model": str(model), "format": to.value}
    if beside is not None:
        about |= {"model": str(file), "file": out.name}
    text = to_json("export", about | described)
    _write(out, beside, content, text, force=force)
    if as_json:
        return show(text)
    for note in described.get("left_out", []):
        remark(f"{note}.")
    if beside is None:
        return show(f"a range for each parameter is in {out}")
    if to is Format.torch:
        words = f"{described['difference']:.1e} of the largest state"
        show(f"{out}, read back, differs from the model's own step by {words}")
    elif rows:
        _show_agreement(rows)
    else:
        show("give --check DATASET to see how closely MuJoCo replays your records")
    left_out = f"what it leaves out in {beside}" if described["left_out"] else "nothing is left out"
    show(f"the model is in {out}, {left_out}")


def _refuse_foreign_options(
    to: Format, check: Path | None, sample_time: float | None, width: float | None
) -> None:
    """Refuse an option of another format than the one asked for."""
    if check is not None and to is not Format.mjcf:
        raise InputError("--check replays records in MuJoCo; give it with --to mjcf, or leave it out")
    if to is not Format.torch and (sample_time, width) != (None, None):
        raise InputError(
            "--sample-time and --width are of the torch program; leave them out, or take --to torch"
        )


def _description_beside(out: Path, to: Format) -> Path | None:
    """The JSON file beside an exported model; None for ranges, which are JSON themselves."""
    if to is Format.ranges:
        return None
    beside = out.with_suffix(".json")
    if beside == out:
        raise InputError(f"{out} would also be the name of the description beside it; take another ending")
    return beside


def _write(out: Path, beside: Path | None, content: bytes, text: str, *, force: bool) -> None:
    """Write the model and its description beside it, both or none; without a second file the description alone."""
    with ExitStack() as files:
        main = files.enter_context(result_file(out, force=force))
        if beside is None:
            write_last(main, text)
        else:
            main.write_bytes(content)
            write_last(files.enter_context(result_file(beside, force=force)), text)


def _mjcf(system: "System", check: Path | None, out: Path) -> "tuple[bytes, dict[str, Any], list[Agreement]]":
    from hybrid_id.export.mjcf import to_mjcf
    from hybrid_id.export.replay import agreement

    exported = to_mjcf(system)
    if exported.home is not None and out.parent.resolve() != exported.home:
        remark(
            f"meshes and includes are named as seen from {exported.home}: MuJoCo finds them where {out.name} lies there"
        )
    rows = [] if check is None else agreement(system, exported, records_to_replay(check))
    checked = None if check is None else [vars(row) for row in rows]
    return exported.text.encode(), {"left_out": list(exported.notes), "check": checked}, rows


def _program(system: "System", sample_time: float, width: float) -> tuple[bytes, dict[str, Any]]:
    from hybrid_id.export.program import to_program

    program = to_program(system, sample_time=sample_time, width=width)
    left_out = []
    if any(system.dry):
        left_out.append(
            f"dry friction is smoothed over ±{width:g} rad/s of the side where it acts, for a program has no events"
        )
    if any(joint.drive.encoders or joint.gear.errors for joint in system.joints):
        left_out.append("what encoders read (offset, dead time, error of a gear): the states are true angles")
    about = {"interface": program.interface, "difference": program.difference, "left_out": left_out}
    return program.content, about


def _ranges(system: "System", model: Path) -> dict[str, Any]:
    from hybrid_id.export.ranges import read_result, to_ranges

    file = (model if model.is_dir() else model.parent) / RESULT
    if not file.is_file():
        remark(
            "there is no result of an identification beside this model: only its priors say how far it may be off"
        )
    found = to_ranges(system, read_result(file) if file.is_file() else None)
    if lost := [name for name, one in found["parameters"].items() if one["from"] == "unknown"]:
        remark(f"nothing says how far {', '.join(lost)} may be off: their ranges are one value; give priors")
    return found


def _show_agreement(rows: "Sequence[Agreement]") -> None:
    """How closely MuJoCo replays the records, and whether they may be of another robot."""
    from hybrid_id.export.replay import summarise
    from hybrid_id.reporting.tables import table

    heads = ("record", "role", "output", "MuJoCo - ours>", "measured - ours>", "measured - MuJoCo>")
    cells = (
        (r.record, r.role, r.output, *(f"{value:.5f}" for value in (r.apart, r.here, r.there))) for r in rows
    )
    found = summarise(rows)
    show("normalised RMSE, over the same records:", table(heads, cells))
    show(
        f"MuJoCo replays these records within {found.worst:.2g} of ours (normalised RMSE)",
        f"measured against MuJoCo {found.there:.3g}, against ours {found.here:.3g} (mean over the "
        f"{f'{found.role} records'.strip()})",
    )
    if found.strange is not None:
        remark(
            f"this model misses these records by {found.strange:.2g} of their spread; are they of the same robot?"
        )
