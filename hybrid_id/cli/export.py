"""`export`: what was found, in the formats of others."""

import math
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hybrid_id.cli.console import out as stdout
from hybrid_id.cli.console import remark, show
from hybrid_id.cli.file import refuse_file, result_file
from hybrid_id.cli.folder import RESULT
from hybrid_id.cli.inputs import load_records
from hybrid_id.cli.options import JsonOption, use_threads
from hybrid_id.errors import InputError

if TYPE_CHECKING:
    from hybrid_id.systems.chain import System

SAMPLE_TIME, WIDTH = 0.002, 0.5
"""Defaults of the torch program: its step [s], and the speed over which it smooths dry friction [rad/s]."""

STRANGE = 0.5
"""Normalised RMSE of our own replay above which the records may be of another robot."""


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
    if check is not None and to is not Format.mjcf:
        raise InputError("--check replays records in MuJoCo; give it with --to mjcf, or leave it out")
    if to is not Format.torch and (sample_time, width) != (None, None):
        raise InputError(
            "--sample-time and --width are of the torch program; leave them out, or take --to torch"
        )
    refuse_file(out, force=force)
    beside = out.with_suffix(".json")
    if to is not Format.ranges:
        if beside == out:
            raise InputError(
                f"{out} would also be the name of the description beside it; take another ending"
            )
        refuse_file(beside, force=force)
    use_threads(1)
    from hybrid_id.systems.model_file import load_model

    file = model / "model.yaml" if model.is_dir() else model
    system = load_model(file)
    if to is Format.ranges:
        text = _ranges(system, model)
        content, told = text.encode(), {}
    else:
        content, told = (
            _mjcf(system, check)
            if to is Format.mjcf
            else _program(system, sample_time or SAMPLE_TIME, width or WIDTH)
        )
        text = _as_json({"model": str(file), "format": to.value, "file": out.name} | told)
    with result_file(out, force=force) as temporary:
        temporary.write_bytes(content)
    if to is not Format.ranges:
        with result_file(beside, force=force) as temporary:
            temporary.write_text(text, encoding="utf-8")
    if as_json:
        stdout().print(text.rstrip(), markup=False, soft_wrap=True)
        return
    for note in told.get("left_out", []):
        remark(f"{note}.")
    _say(to, told, out, beside)


def _as_json(result: dict[str, Any]) -> str:
    from hybrid_id.reporting.results import as_json

    return as_json("export", result) + "\n"


def _mjcf(system: "System", check: Path | None) -> tuple[bytes, dict[str, Any]]:
    from hybrid_id.export.mjcf import to_mjcf

    exported = to_mjcf(system)
    told: dict[str, Any] = {"left_out": list(exported.notes), "check": None}
    if check is not None:
        from hybrid_id.export.replay import agreement

        told["check"] = [vars(row) for row in agreement(system, exported, load_records(check))]
    return exported.text.encode(), told


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
    return program.content, {
        "interface": program.interface,
        "difference": program.difference,
        "left_out": left_out,
    }


def _ranges(system: "System", model: Path) -> str:
    from hybrid_id.export.ranges import read_result, to_ranges

    file = (model if model.is_dir() else model.parent) / RESULT
    if not file.is_file():
        remark(
            "there is no result of an identification beside this model: only its priors tell how far it may be off"
        )
    found = to_ranges(system, read_result(file) if file.is_file() else None)
    if lost := [name for name, one in found["parameters"].items() if one["from"] == "unknown"]:
        remark(f"nothing tells how far {', '.join(lost)} may be off: their ranges are one value; give priors")
    return _as_json({"model": str(model), "format": "ranges"} | found)


def _say(to: Format, told: dict[str, Any], out: Path, beside: Path) -> None:
    """What was written and how well it agrees, for a reader."""
    if to is Format.ranges:
        show(f"a range for each parameter is in {out}")
        return
    if to is Format.torch:
        show(
            f"{out}, read back, differs from the model's own step by {told['difference']:.1e} of the largest state"
        )
    elif told["check"]:
        from hybrid_id.reporting.tables import open_table
        from hybrid_id.statistics.fit import known_mean

        table = open_table(
            "record", "role", "output", "MuJoCo - ours>", "measured - ours>", "measured - MuJoCo>"
        )
        for row in told["check"]:
            cells = (f"{row[name]:.5f}" for name in ("apart", "here", "there"))
            table.add_row(row["record"], row["role"], row["output"], *cells)
        # a record that stands still has no spread to hold an error against
        known = (row["apart"] for row in told["check"] if not math.isnan(row["apart"]))
        worst, judges = max(known, default=math.nan), _judges(told["check"])
        show("normalised RMSE, over the same records:", table)
        show(f"MuJoCo replays these records within {worst:.2g} of ours (normalised RMSE)", judges)
        missed = known_mean(row["here"] for row in told["check"])
        if missed > STRANGE:
            remark(
                f"this model misses these records by {missed:.2g} of their spread; are they of the same robot?"
            )
    elif to is Format.mjcf:
        show("give --check DATASET to see how closely MuJoCo replays your records")
    show(
        f"the model is in {out}, "
        + (f"what it leaves out in {beside}" if told["left_out"] else "nothing is left out")
    )


def _judges(rows: list[dict[str, Any]]) -> str:
    """The gap to what was measured, over the test records where there are any."""
    test = [row for row in rows if row["role"] == "test"]
    from hybrid_id.statistics.fit import known_mean

    means = (known_mean(row[name] for row in test or rows) for name in ("there", "here"))
    what = "test records" if test else "records"
    return "measured against MuJoCo {:.3g}, against ours {:.3g} (mean over the {})".format(*means, what)
