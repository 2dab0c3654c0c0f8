"""`excite`: an excitation that moves a drive, or all joints of a robot, as much as their limits allow."""

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import typer

from hybrid_id.cli.console import show
from hybrid_id.cli.folder import files_to_write, write_files
from hybrid_id.cli.options import ABOVE, ForceFilesOption, JsonOption
from hybrid_id.config.sections import MOST_SEED
from hybrid_id.errors import InputError, close_match

if TYPE_CHECKING:
    from hybrid_id.systems.chain import System

MAX_SAMPLES = 1_000_000


def excite(
    file: Annotated[
        Path,
        typer.Option(
            "--out",
            "-o",
            help=f"CSV file to write: columns t (s) and u1, of a robot goal1, goal2 ... {ABOVE}",
        ),
    ],
    band: Annotated[
        tuple[float, float] | None,
        typer.Option(help="Lowest and highest frequency in Hz.", show_default="0.3 8, of a robot 0.1 2"),
    ] = None,
    duration: Annotated[float, typer.Option(help="Length in s.")] = 10.0,
    sample_time: Annotated[float, typer.Option(help="Sample time in s.")] = 0.002,
    amplitude: Annotated[
        float | None, typer.Option(help="Peak, in the unit of the input (V).", show_default="10")
    ] = None,
    tones: Annotated[
        int | None,
        typer.Option(
            help="Number of tones, spread evenly over the band.",
            min=1,
            max=10_000,
            show_default="20, or as many as the duration allows",
        ),
    ] = None,
    gear: Annotated[
        Literal["most", "least"] | None,
        typer.Option(
            help="With --model: the part of the band in which play and flexibility of its gear act most, or least."
        ),
    ] = None,
    model: Annotated[
        Path | None,
        typer.Option("--model", "-m", help="Model whose gear has them, or a robot's."),
    ] = None,
    speed: Annotated[
        list[str] | None,
        typer.Option(help="Largest speed of a robot's joint: NAME=VALUE, or VALUE for all."),
    ] = None,
    torque: Annotated[
        list[str] | None,
        typer.Option(help="Largest torque of a joint's motor, at the joint; as --speed."),
    ] = None,
    share: Annotated[
        float | None, typer.Option(help="Share of a robot's limits that is used.", show_default="0.9")
    ] = None,
    rest: Annotated[
        float, typer.Option(help="Rest at zero before the signal in s, so that the start is known.")
    ] = 0.1,
    starts: Annotated[
        int | None,
        typer.Option(
            help="Phase sets to start the search from.",
            min=1,
            max=10_000,
            show_default="150, of a robot 20 a joint",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of those phase sets.", min=0, max=MOST_SEED)] = 0,
    force: ForceFilesOption = False,
    as_json: JsonOption = False,
) -> None:
    """Design a multisine of least crest factor and write it as CSV, and beside it as JSON how it was made."""
    from hybrid_id.systems.model_file import load_model

    system = None if model is None else load_model(model)
    robot = system is not None and gear is None and system.tree is not None
    if not robot:
        if speed or torque or share is not None:
            raise InputError("--speed, --torque and --share belong to a robot's joints; give its --model")
        if (gear is None) != (model is None):
            raise InputError("--gear and --model go together; give both or none, or the model of a robot")
    elif amplitude is not None:
        raise InputError(
            "--amplitude belongs to one drive; a robot's joints have --speed, --torque and --share"
        )
    band = band or ((0.1, 2.0) if robot else (0.3, 8.0))
    amplitude = 10.0 if amplitude is None else amplitude
    if not 0 <= rest < math.inf:
        raise InputError(f"--rest is {rest:g} s; give 0 or more")
    if not 0 < sample_time < math.inf:
        raise InputError(f"--sample-time is {sample_time:g} s; give a number above 0")
    if not 2 <= duration / sample_time <= MAX_SAMPLES:
        raise InputError(
            f"--duration {duration:g} s holds no 2 to {MAX_SAMPLES:,} samples of {sample_time:g} s; change one of them"
        )
    if not rest / sample_time <= MAX_SAMPLES:
        raise InputError(
            f"--rest {rest:g} s holds over {MAX_SAMPLES:,} samples of {sample_time:g} s; shorten it"
        )
    if not 0 <= band[0] <= band[1] < math.inf:
        raise InputError(
            f"--band is {band[0]:g} {band[1]:g}; give the lowest frequency first, none below 0 Hz"
        )
    if not 0 < amplitude < math.inf:
        raise InputError(f"--amplitude is {amplitude:g}; give a number above 0")
    if file.is_dir():
        raise InputError(f"--out {file} is a folder; give the name of a file, multisine.csv say")
    files = files_to_write(file, ".json", force=force)
    from hybrid_id.records.excitation import STARTS, usual_tones
    from hybrid_id.reporting.results import as_json as as_json_text
    from hybrid_id.study.excitation import STARTS_A_JOINT

    starts = starts or (STARTS_A_JOINT if robot else STARTS)
    tones = tones or usual_tones(band, duration)
    asked = {
        "sample_time": sample_time, "duration": duration, "tones": tones, "starts": starts, "seed": seed,
    }  # fmt: skip
    if system is not None and robot:
        limits = (speed or [], torque or [], 0.9 if share is None else share)
        design = _of_robot(system, band, *limits, rest=rest, **asked)
    else:
        design = _of_drive(system, band, amplitude=amplitude, gear=gear, rest=rest, **asked)
    columns, rows = design.table
    lines = (",".join(f"{value:.9g}" for value in row) for row in rows)
    named = {"file": str(file), "model": model and str(model)}
    text = as_json_text("excite", design.described | asked | named)
    write_files({file: "\n".join([",".join(columns), *lines]) + "\n", files[1]: f"{text}\n"})
    if as_json:
        return show(text)
    *lines, size = design.lines
    show(*lines, f"{size}, in {file}")


class Designed(NamedTuple):
    """What is written of a design, a robot's or one drive's.

    Attributes:
        table: names of the columns, and the rows of the CSV.
        described: for the JSON, beside what the command was asked for.
        lines: for the screen; the last one goes on with the file's name.
    """

    table: tuple[Sequence[str], Iterable[Iterable[float]]]
    described: dict[str, Any]
    lines: list[str]


def _of_drive(
    system: "System | None",
    band: tuple[float, float],
    *,
    amplitude: float,
    gear: Literal["most", "least"] | None,
    rest: float,
    **asked: Any,
) -> Designed:
    """Design the multisine of one drive."""
    import numpy as np

    from hybrid_id.records.excitation import design_multisine

    parts, lines = [], list[str]()
    if gear is not None and system is not None:
        from hybrid_id.study.excitation import bands_by_gear

        motion = {key: asked[key] for key in ("sample_time", "duration", "tones")}
        parts = bands_by_gear(system, band, gear, amplitude=amplitude, **motion)
        band = parts[0].band
        (low, high), (least, most) = band, sorted((parts[0].share, parts[-1].share))
        lines = [
            f"Between {low:.3g} and {high:.3g} Hz the gear's deflection is {100 * parts[0].share:.2g} % of the motor's "
            f"motion, the {'largest' if gear == 'most' else 'smallest'} of {len(parts)} parts of the band "
            f"({100 * least:.2g} to {100 * most:.2g} %)."
        ]
    design = design_multisine(band, amplitude_limits=amplitude, **asked)
    sample_time = asked["sample_time"]
    quiet = round(rest / sample_time)
    signal = np.concatenate([np.zeros(quiet), design.signal])
    described = {
        "crest_factor": design.crest_factor, "samples": len(signal),
        "rest": sample_time * quiet, "band": band, "amplitude": amplitude, "gear": gear,
        "gear_shares": [{"band": one.band, "share": one.share, "motion": one.motion} for one in parts],
    }  # fmt: skip
    lines += [
        f"{design.message}.",
        f"{len(signal)} samples, {sample_time * len(signal):.6g} s with {sample_time * quiet:.3g} s of rest",
    ]
    rows = zip(sample_time * np.arange(len(signal)), signal, strict=True)
    return Designed((("t", "u1"), rows), described, lines)


def _of_robot(
    system: "System",
    band: tuple[float, float],
    speeds: Sequence[str],
    torques: Sequence[str],
    share: float,
    **asked: Any,
) -> Designed:
    """Design the motion of a robot's joints."""
    from hybrid_id.study.excitation import design_arm_motion, joint_limits

    if not 0.0 < share <= 1.0:
        raise InputError(f"--share is {share:g}; give a number above 0, 1 at most")
    names = system.tree.names if system.tree is not None else ()
    limits = joint_limits(system, _by_joint(speeds, names, "--speed"), _by_joint(torques, names, "--torque"))
    design = design_arm_motion(system, tuple(one.within(share) for one in limits), band, **asked)
    peaks = abs(design.speed).max(0), abs(design.torque).max(0)
    joints = [
        {
            "joint": one.name, "column": f"goal{k + 1}", "position_limits": one.position,
            "speed_limit": one.speed, "torque_limit": one.torque,
            "position": (design.position[:, k].min(), design.position[:, k].max()),
            "peak_speed": peaks[0][k], "peak_torque": peaks[1][k],
            "crest_factor": design.designs[k].crest_factor,
        }
        for k, one in enumerate(design.limits)
    ]  # fmt: skip
    described = {
        "samples": len(design.time), "rest": asked["rest"], "band": band, "share": share, "joints": joints,
        "scale": design.scale, "condition_number": design.condition_number, "std_ratio": design.std_ratio,
    }  # fmt: skip
    tones = design.designs[0].frequencies
    lines = [
        f"{len(tones)} tones from {tones[0]:.4g} to {tones[-1]:.4g} Hz at each joint, positions at the joint:"
    ]
    width = max(len(one["joint"]) for one in joints)
    for one in joints:
        (low, high), (least, most) = one["position"], one["position_limits"]
        lines.append(
            f"  {one['column']} {one['joint']:{width}}  {low:8.3f} to {high:.3f} of {least:.3f} to {most:.3f}; "
            f"speed {one['peak_speed']:.3g} of {one['speed_limit']:.3g}, torque {one['peak_torque']:.3g} of "
            f"{one['torque_limit']:.3g}"
        )
    if design.scale < 1.0:
        lines.append(
            f"The torques leave {100 * design.scale:.0f} % of the amplitude that position and speed allow."
        )
    lines += [
        f"Base parameters and friction: condition number {design.condition_number:.3g}; shifts and signs bring the "
        f"predicted standard errors to {100 * design.std_ratio:.0f} % of those at random.",
        "Collisions are not checked. Bring the robot to the first position before it starts.",
        f"{len(design.time)} samples, {design.time[-1]:.6g} s",
    ]
    columns = ["t", *(one["column"] for one in joints)]
    rows = ((t, *row) for t, row in zip(design.time, design.position, strict=True))
    return Designed((columns, rows), described, lines)


def _by_joint(given: Sequence[str], names: Sequence[str], option: str) -> dict[str, float]:
    """Limits by joint, from ``NAME=VALUE`` and from a ``VALUE`` for all others."""
    found: dict[str, float] = {}
    for words in given:
        name, _, value = words.rpartition("=")
        if name and name not in names:
            raise InputError(
                f"{option} {words}: the robot has no joint '{name}'{close_match(name, names)}; it has "
                f"{', '.join(names)}."
            )
        if name in found:
            raise InputError(f"{option} is given twice for {name or 'all joints'}; keep one of them")
        try:
            found[name] = float(value)
        except ValueError:
            found[name] = 0.0
        if not 0.0 < found[name] < float("inf"):
            raise InputError(f"{option} {words}: '{value}' is no number above 0")
    return dict.fromkeys(names, found[""]) | found if "" in found else found
