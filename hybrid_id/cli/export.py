"""`export`: what was found, in the formats of others."""

from contextlib import ExitStack
from dataclasses import replace
from enum import StrEnum
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hybrid_id.cli.console import remark, show
from hybrid_id.cli.folder import DIAGNOSIS, RESULT, refuse_file, result_file
from hybrid_id.cli.inputs import load_records, read_model, records_to_replay
from hybrid_id.cli.options import JsonOption, use_threads
from hybrid_id.cli.results import write_last
from hybrid_id.config import StudyConfig, load_config
from hybrid_id.errors import InputError

if TYPE_CHECKING:
    from hybrid_id.reporting.target import Models
    from hybrid_id.study import Horizon
    from hybrid_id.systems.chain import System

REFIT = "refit.yaml"
"""The nominal model, re-fitted, beside the corrected one."""
PAGE = ".html"
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
        typer.Option(
            help="Dataset to replay in MuJoCo and here; by default the run's test records.",
            show_default=False,
        ),
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
    force: Annotated[
        bool, typer.Option("--force", help="Replace the file; write a model that is worse in MuJoCo.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Write a model for MuJoCo, parameter ranges for domain randomisation, or one step as a torch program.

    What the format cannot carry is said in one sentence an effect, here and in the file (beside a torch program: in the
    JSON of the same name). A model of an identification or a diagnosis is replayed in MuJoCo on its test records, or on
    those of --check, beside the nominal and the re-fitted model; what it loses there is fitted anew in MuJoCo, and a
    corrected model that stays worse than the re-fitted one is refused.
    """
    _refuse_foreign_options(to, check, sample_time, width)
    refuse_file(out, force=force)
    beside = _description_beside(out, to)
    if beside is not None:
        refuse_file(beside, force=force)
    if to is Format.mjcf:
        refuse_file(out.with_suffix(PAGE), force=force)
    use_threads(1)
    from hybrid_id.reporting.results import as_json as to_json

    file = model / "model.yaml" if model.is_dir() else model
    system = read_model(file)
    models: Models = {}
    if to is Format.ranges:
        described, content = _ranges(system, model), b""
    elif to is Format.mjcf:
        content, described, models = _mjcf(system, file, check, out, force=force)
    else:
        content, described = _program(system, sample_time or SAMPLE_TIME, width or WIDTH)
    about = {"model": str(model), "format": to.value}
    if beside is not None:
        about |= {"model": str(file), "file": out.name}
    text = to_json("export", about | described)
    _write(out, content, beside, text, models, force=force)
    if as_json:
        return show(text)
    for note in described.get("left_out", []):
        remark(f"{note}.")
    if beside is None:
        return show(f"a range for each parameter is in {out}")
    if to is Format.torch:
        words = f"{described['difference']:.1e} of the largest state"
        show(f"{out}, read back, differs from the model's own step by {words}")
    elif models:
        _show_errors(models)
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


def _write(
    out: Path, content: bytes, beside: Path | None, text: str, models: "Models", *, force: bool
) -> None:
    """Write the model, its page and its description beside it, all or none; without a description that alone."""
    with ExitStack() as files:
        main = files.enter_context(result_file(out, force=force))
        if beside is None:
            return write_last(main, text)
        main.write_bytes(content)
        if models:
            from hybrid_id.reporting.target import target_page

            page = files.enter_context(result_file(out.with_suffix(PAGE), force=force))
            target_page(models, out.name).write(page)
        write_last(files.enter_context(result_file(beside, force=force)), text)


def _mjcf(
    system: "System", file: Path, check: Path | None, out: Path, *, force: bool
) -> "tuple[bytes, dict[str, Any], Models]":
    from hybrid_id.export.mjcf import to_mjcf
    from hybrid_id.export.target import with_comment
    from hybrid_id.reporting.target import error_lines, target_result

    models = _in_mujoco(system, file, check)
    exported = to_mjcf(system)
    described: dict[str, Any] = {"left_out": list(exported.notes), "check": None, "in_mujoco": None}
    if models:
        _refuse_worse(models, file, force=force)
        asked = list(models.values())[-1]
        exported = with_comment(asked.exported, error_lines(models))
        described = {
            "left_out": list(exported.notes),
            "check": [vars(row) for row in asked.rows],
            "in_mujoco": target_result(models),
        }
    if exported.home is not None and out.parent.resolve() != exported.home:
        remark(
            f"meshes and includes are named as seen from {exported.home}: MuJoCo finds them where {out.name} lies there"
        )
    return exported.text.encode(), described, models


def _in_mujoco(system: "System", file: Path, check: Path | None) -> "Models":
    """The model in MuJoCo, behind those that it is to be better than; none where there are no records.

    The records of --check judge, else those of the run that the model comes from; that run's own train records fit.
    """
    from hybrid_id.export.replay import judging_role
    from hybrid_id.export.target import in_mujoco
    from hybrid_id.study import Horizon

    made = _run_of(file)
    own = None if made is None else load_records(made[0].dataset, made[0])
    judges = own if check is None else records_to_replay(check)
    if judges is None:
        return {}
    if check is None and find_spec("mujoco") is None:
        remark(
            "MuJoCo is not installed: how this model errs there is not known; 'hybrid-id doctor' says what to install"
        )
        return {}
    horizon = Horizon() if made is None else made[1]
    role = judging_role(record.role for record in judges)
    left_out = replace(judges, records=tuple(record for record in judges if role in ("", record.role)))
    train = None if own is None or not own.train else replace(own, records=own.train)
    asked = judges if check else left_out
    if made is None:
        return {"exported": in_mujoco(system, asked)}
    label, found = _label(file), {}
    nominal, refit = made[0].model, file.with_name(REFIT)
    if nominal.exists():
        found["nominal"] = in_mujoco(read_model(nominal), left_out, horizon=horizon)
    starts = [read_model(refit)] if label == "corrected" and refit.exists() else []
    remark(
        "replaying in MuJoCo; what it cannot carry is fitted there to the train records, which may take minutes"
    )
    for one in starts:
        found["re-fitted"] = in_mujoco(one, left_out, train=train, horizon=horizon)
    return found | {label: in_mujoco(system, asked, train=train, horizon=horizon, starts=starts)}


def _run_of(file: Path) -> "tuple[StudyConfig, Horizon] | None":
    """Settings and horizon of the run whose folder a model lies in; None without one, or where its records are gone."""
    from hybrid_id.export.ranges import read_result
    from hybrid_id.study import Horizon

    settings, result = file.with_name("config.yaml"), file.with_name(DIAGNOSIS)
    if not result.exists():
        result = file.with_name(RESULT)
    if not (result.exists() and settings.exists()):
        return None
    config = load_config(settings)
    if not config.dataset.exists():
        remark(
            f"{config.dataset}, the records of this run, is not there: nothing is fitted anew in MuJoCo's terms"
        )
        return None
    horizon = read_result(result).get("horizon") or {}
    return config, Horizon(horizon.get("kind", "whole"), horizon.get("seconds") or 0.0)


def _label(file: Path) -> str:
    """What the model of a run is called."""
    if file.name == REFIT:
        return "re-fitted"
    return "corrected" if file.with_name(DIAGNOSIS).exists() else "identified"


def _refuse_worse(models: "Models", file: Path, *, force: bool) -> None:
    """Refuse a corrected model that is worse in MuJoCo than the re-fitted one."""
    from hybrid_id.reporting.target import judged_on

    corrected, refitted = models.get("corrected"), models.get("re-fitted")
    if corrected is None or refitted is None or not corrected.worse_than(refitted):
        return
    words = (
        f"in MuJoCo the corrected model errs by {corrected.summary.there:.3g}, the re-fitted one by "
        f"{refitted.summary.there:.3g} (normalised RMSE, mean over {judged_on(models)})"
    )
    if not force:
        raise InputError(
            f"{file}: {words}; nothing is written: export {file.with_name(REFIT)}, or give --force to write it all "
            "the same"
        )
    remark(f"{words}; it is written all the same")


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


def _show_errors(models: "Models") -> None:
    """How closely MuJoCo replays the records, and whether they may be of another robot."""
    from hybrid_id.export.replay import summarise
    from hybrid_id.reporting.target import error_lines, errors_table, judged_on, replays_table

    rows = list(models.values())[-1].rows
    found = summarise(rows)
    show("normalised RMSE, over the same records:", replays_table(rows))
    show(f"MuJoCo replays these records within {found.worst:.2g} of ours (normalised RMSE)")
    if len(models) > 1:
        show(
            f"normalised RMSE, mean over {judged_on(models)}:", errors_table(models), *error_lines(models)[1:]
        )
    else:
        show(
            f"measured against MuJoCo {found.there:.3g}, against ours {found.here:.3g} (mean over the "
            f"{f'{found.role} records'.strip()})"
        )
    if found.strange is not None:
        remark(
            f"this model misses these records by {found.strange:.2g} of their spread; are they of the same robot?"
        )
