"""`export`: what was found, in the formats of others."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from hybrid_id.cli.console import doing, remark, show
from hybrid_id.cli.folder import DIAGNOSIS, RESULT, files_to_write, write_files
from hybrid_id.cli.inputs import load_records, read_model, records_to_replay
from hybrid_id.cli.options import ABOVE, ForceFilesOption, JsonOption
from hybrid_id.config import StudyConfig, load_config
from hybrid_id.errors import InputError
from hybrid_id.reading import as_written

if TYPE_CHECKING:
    from rich.console import RenderableType

    from hybrid_id.export.target import TargetErrors
    from hybrid_id.reporting.page import Page
    from hybrid_id.study import Horizon
    from hybrid_id.systems.chain import System

REFIT, PHYSICS = "refit.yaml", "physics.yaml"
"""The nominal model, re-fitted: beside the corrected one, and beside one with networks."""
AGAIN = "bring the folder of results again, as it was written"
SAMPLE_TIME, WIDTH = 0.002, 0.5
"""Defaults of the torch program: its step [s], and the speed over which it smooths dry friction [rad/s]."""


@dataclass(frozen=True)
class Made:
    """What a format comes to.

    Attributes:
        described: what is said of it, as plain data.
        words: what the screen says of it.
        content: of its file; None where that is the description itself.
        page: beside it; None where there is none.
    """

    described: dict[str, Any]
    words: "Sequence[RenderableType]" = ()
    content: bytes | None = None
    page: "Page | None" = None


def export(
    model: Annotated[
        Path,
        typer.Argument(metavar="MODEL", help="Model file, or a folder of results with model.yaml."),
    ],
    to: Annotated[
        Literal["mjcf", "ranges", "torch"],
        typer.Option(
            help="mjcf: a MuJoCo model; ranges: for domain randomisation; torch: one step as a program."
        ),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help=f"File to write. {ABOVE}")],
    check: Annotated[
        Path | None,
        typer.Option(help="Dataset to replay in MuJoCo and here; by default the run's test records."),
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
    force: ForceFilesOption = False,
    worse: Annotated[
        bool,
        typer.Option(
            "--worse", help="Write a corrected model that is worse in MuJoCo than the re-fitted one."
        ),
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Write a model for MuJoCo, parameter ranges for domain randomisation, or one step as a torch program.

    What the format cannot carry is said in one sentence an effect, here and in the file (beside a torch program: in the
    JSON of the same name). A model in its folder of results is replayed in MuJoCo on the run's test records, or on
    those of --check, beside the nominal and the re-fitted model; what it loses there is fitted anew in MuJoCo, and a
    corrected model that stays worse than the re-fitted one is refused.
    """
    if check is not None and to != "mjcf":
        raise InputError("--check replays records in MuJoCo; give it with --to mjcf, or leave it out")
    if worse and to != "mjcf":
        raise InputError(
            "--worse writes a model that is worse in MuJoCo; leave it out, --force replaces files that exist"
        )
    if to != "torch" and (sample_time, width) != (None, None):
        raise InputError(
            "--sample-time and --width are of the torch program; leave them out, or take --to torch"
        )
    if to == "mjcf" and out.suffix.lower() == ".urdf":
        raise InputError(
            f"{out}: MJCF is written, which no reader of URDF takes; give a file that ends in .xml"
        )
    # the file, then its description and its page; ranges are JSON themselves
    endings = {"ranges": (), "mjcf": (".json", ".html"), "torch": (".json",)}[to]
    files = files_to_write(out, *endings, force=force)
    from hybrid_id.reporting.results import as_json as to_json

    file = model / "model.yaml" if model.is_dir() else model
    system = read_model(file)
    if to == "ranges":
        made = _ranges(system, file, out)
    elif to == "mjcf":
        made = _mjcf(system, file, check, out, worse=worse)
    else:
        made = _program(system, out, sample_time or SAMPLE_TIME, width or WIDTH)
    about = {"model": str(model), "format": to}
    if made.content is not None:
        about |= {"model": str(file), "file": out.name}
    text = to_json("export", about | made.described)
    if made.content is None:
        write_files({out: f"{text}\n"})
    else:
        pages = {} if made.page is None else {files[2]: made.page.html()}
        write_files({out: made.content} | pages | {files[1]: f"{text}\n"})  # the description comes in last
        for stale in (
            files[2:] if made.page is None else ()
        ):  # that of an earlier model shows the errors of another one
            stale.unlink(missing_ok=True)
    if as_json:
        return show(text)
    left_out = made.described.get("left_out", [])
    for note in left_out:
        remark(f"{note}.")
    show(*made.words)
    if made.content is not None:
        show(
            f"the model is in {out}, {f'what it leaves out in {files[1]}' if left_out else 'nothing is left out'}"
        )


def _mjcf(system: "System", file: Path, check: Path | None, out: Path, *, worse: bool) -> Made:
    from hybrid_id.export.mjcf import to_mjcf
    from hybrid_id.export.target import with_comment
    from hybrid_id.reporting import target

    errors = _in_mujoco(system, file, check)
    exported = to_mjcf(system) if errors is None else errors.exported.exported
    if exported.home is not None and out.parent.resolve() != exported.home:
        remark(
            f"meshes and includes are named as seen from {exported.home}: MuJoCo finds them where {out.name} lies there"
        )
    described: dict[str, Any] = {"left_out": list(exported.notes), "check": None, "in_mujoco": None}
    if errors is None:
        words = ["give --check DATASET to see how closely MuJoCo replays your records"]
        return Made(described, words, exported.text.encode())
    if errors.worse and not worse:
        raise InputError(
            f"{file}: {target.worse_words(errors)}; nothing is written: export {_refitted_beside(file)}, or give "
            "--worse to write it all the same"
        )
    if errors.worse:
        remark(f"{target.worse_words(errors)}; it is written all the same")
    if (missed := errors.exported.summary.strange) is not None:
        remark(
            f"this model misses these records by {missed:.2g} of their spread; are they of the same robot?"
        )
    described |= {
        "check": [vars(row) for row in errors.exported.rows],
        "in_mujoco": target.target_result(errors),
    }
    content = with_comment(exported, target.error_lines(errors)).text.encode()
    page = target.target_page(errors, out.name)
    return Made(described, [page.screen()], content, page)


def _in_mujoco(system: "System", file: Path, check: Path | None) -> "TargetErrors | None":
    """The model in MuJoCo, behind those that it is to be better than; None where there are no records.

    The records of --check judge, else those of the run that the model comes from; that run's own train records fit.
    """
    from hybrid_id.export.replay import left_out
    from hybrid_id.export.target import NOMINAL, REFITTED, target_errors

    run = _run_of(file)
    own = None
    if run is not None and run[0].dataset.exists():
        own = load_records(run[0].dataset, run[0])
    elif run is not None:
        remark(
            f"{run[0].dataset}, the records of this run, is not there: nothing is fitted anew in MuJoCo's terms"
        )
    if check is not None:
        judges = records_to_replay(check)
    elif own is None:
        return None
    elif find_spec("mujoco") is None:
        remark(
            "MuJoCo is not installed: how this model errs there is not known; pip install 'hybrid-id[blind]'"
        )
        return None
    else:
        judges = left_out(own)
    if run is None:
        return target_errors({"exported": system}, judges)
    (config, horizon), label = run, _label(file, system)
    models = {NOMINAL: read_model(config.model)} if config.model.exists() else {}
    refit = _refitted_beside(file)
    if label != REFITTED and refit.exists():
        models[REFITTED] = read_model(refit)
    remark("replaying in MuJoCo; what it cannot carry is fitted there to the train records")
    train = replace(own, records=own.train) if own is not None and own.train else None
    with doing("MuJoCo: ") as progress:
        return target_errors(
            models | {label: system}, judges, train=train, horizon=horizon, progress=progress
        )


def _run_of(file: Path) -> "tuple[StudyConfig, Horizon] | None":
    """Settings and horizon of the run whose folder a model lies in; None where it lies in none."""
    from hybrid_id.study import Horizon

    settings, result = file.with_name("config.yaml"), _result_of(file)
    if result is None or not settings.exists():
        remark(
            f"{file} lies in no folder of results: it is neither compared with a re-fitted model nor fitted anew to "
            "what MuJoCo can carry"
        )
        return None
    with as_written(file, AGAIN):
        horizon = result.get("horizon") or {}
        return load_config(settings), Horizon(horizon.get("kind", "whole"), horizon.get("seconds") or 0.0)


def _result_of(file: Path) -> dict[str, Any] | None:
    """What the run says in whose folder a model lies (of a joint, in a joint's folder); None elsewhere."""
    from hybrid_id.cli.diagnose import joint_folders
    from hybrid_id.export.ranges import read_result

    if own := next((one for name in (DIAGNOSIS, RESULT) if (one := file.with_name(name)).exists()), None):
        return read_result(own)
    folder = file.resolve().parent
    if not (robot := folder.with_name(DIAGNOSIS)).exists():
        return None
    joints = read_result(robot).get("joints", {})
    return next((joints[j] for j, name in joint_folders(joints).items() if name == folder.name), None)


def _refitted_beside(file: Path) -> Path:
    """The re-fitted model of the run in whose folder a model lies."""
    return next(
        (one for name in (REFIT, PHYSICS) if (one := file.with_name(name)).exists()), file.with_name(REFIT)
    )


def _label(file: Path, system: "System") -> str:
    """What the model of a run is called; a diagnosis that asserts no effect and no gear has corrected none."""
    from hybrid_id.export.target import CORRECTED, HYBRID, REFITTED

    if file.name in (REFIT, PHYSICS):
        return REFITTED
    if system.learned:
        return HYBRID
    result = _result_of(file) or {}
    if "effects" in result:
        with as_written(file, AGAIN):
            more = any(one["selected"] for one in result["effects"]) or result.get("coupled_gears")
            return CORRECTED if more else REFITTED
    if file.with_name(PHYSICS).exists():  # no network has stayed
        return REFITTED
    return "trained" if result.get("command") == "train" else "identified"


def _program(system: "System", out: Path, sample_time: float, width: float) -> Made:
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
    differs = f"{out}, read back, differs from the model's own step by {program.difference:.1e} of the largest state"
    return Made(about, [differs], program.content)


def _ranges(system: "System", file: Path, out: Path) -> Made:
    from hybrid_id.export.ranges import read_result, to_ranges

    if file.with_name(DIAGNOSIS).is_file() or "verdict" in (_result_of(file) or {}):
        raise InputError(
            f"{file.parent} holds a diagnosis, whose one parameter set says nothing of how records differ; "
            f"fit it to them by 'hybrid-id identify DATASET --model {file} --out DIR', and export DIR"
        )
    result = file.with_name(RESULT)
    if not result.is_file():
        remark(
            "there is no result of an identification beside this model: only its priors say how far it may be off, and "
            "of what has none nothing does"
        )
    found = to_ranges(system, read_result(result) if result.is_file() else None)
    if lost := [name for name, one in found["parameters"].items() if one["from"] == "unknown"]:
        remark(f"nothing says how far {', '.join(lost)} may be off: their ranges are one value; give priors")
    return Made(found, [f"a range for each parameter is in {out}"])
