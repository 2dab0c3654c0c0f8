"""`excite` with the model of a robot: goals for all of its joints, within their limits."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from hybrid_id.errors import InputError, close_match

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hybrid_id.study.arm_excitation import ArmExcitation
    from hybrid_id.systems.chain import System

EVERY = ""
"""Name of a limit that holds for all joints that have none of their own."""


class Designed(NamedTuple):
    """What `excite` writes of a design, a robot's or one drive's.

    Attributes:
        table: the CSV.
        described: for the JSON, beside what the command was asked for.
        lines: for the screen; the last one goes on with the file's name.
        figure: draws the picture.
    """

    table: str
    described: dict[str, Any]
    lines: list[str]
    figure: "Callable[[], Figure]"


def robot_of(model: Path) -> "System | None":
    """The system of a model file that names a robot's description; None for a drive."""
    from hybrid_id.systems.model_file import load_model

    system = load_model(model)
    return None if system.tree is None else system


def excite_robot(
    system: "System",
    band: tuple[float, float],
    *,
    speeds: Sequence[str],
    torques: Sequence[str],
    share: float,
    sample_time: float,
    duration: float,
    tones: int,
    rest: float,
    starts: int,
    seed: int,
) -> Designed:
    """Design the motion of a robot's joints."""
    from hybrid_id.study.arm_excitation import design_arm_motion, joint_limits

    if not 0.0 < share <= 1.0:
        raise InputError(f"--share is {share:g}; give a number above 0, 1 at most")
    names = system.tree.names if system.tree is not None else ()
    limits = joint_limits(system, _by_joint(speeds, names, "--speed"), _by_joint(torques, names, "--torque"))
    design = design_arm_motion(
        system, tuple(one.within(share) for one in limits), band, sample_time=sample_time, duration=duration,
        tones=tones, rest=rest, starts=starts, seed=seed,
    )  # fmt: skip
    joints = _described(design)
    described = {
        "samples": len(design.time), "rest": rest, "band": band, "share": share, "joints": joints,
        "scale": design.scale, "condition_number": design.condition_number, "std_ratio": design.std_ratio,
    }  # fmt: skip
    size = f"{len(design.time)} samples, {design.time[-1]:.6g} s"
    lines = [*_summary(design, joints), size]

    def figure() -> "Figure":
        from hybrid_id.reporting.study_figures import arm_excitation_figure

        return arm_excitation_figure(design)

    return Designed(_table(design), described, lines, figure)


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
    return dict.fromkeys(names, found[EVERY]) | found if EVERY in found else found


def _table(design: "ArmExcitation") -> str:
    head = ",".join(["t", *(f"goal{k}" for k in range(1, design.position.shape[1] + 1))])
    rows = zip(design.time, design.position, strict=True)
    lines = (",".join(f"{value:.9g}" for value in (t, *row)) for t, row in rows)
    return "\n".join([head, *lines]) + "\n"


def _described(design: "ArmExcitation") -> list[dict[str, Any]]:
    """Limits and peaks of each joint, for JSON and screen."""
    peaks = abs(design.speed).max(0), abs(design.torque).max(0)
    return [
        {
            "joint": one.name, "column": f"goal{k + 1}", "position_limits": one.position,
            "speed_limit": one.speed, "torque_limit": one.torque,
            "position": (design.position[:, k].min(), design.position[:, k].max()),
            "peak_speed": peaks[0][k], "peak_torque": peaks[1][k],
            "crest_factor": design.designs[k].crest_factor,
        }
        for k, one in enumerate(design.limits)
    ]  # fmt: skip


def _summary(design: "ArmExcitation", joints: list[dict[str, Any]]) -> list[str]:
    """What the screen says of a design."""
    tones = design.designs[0].frequencies
    words = [
        f"{len(tones)} tones from {tones[0]:.4g} to {tones[-1]:.4g} Hz at each joint, positions at the joint:"
    ]
    width = max(len(one["joint"]) for one in joints)
    for one in joints:
        (low, high), (least, most) = one["position"], one["position_limits"]
        words.append(
            f"  {one['column']} {one['joint']:{width}}  {low:8.3f} to {high:.3f} of {least:.3f} to {most:.3f}; "
            f"speed {one['peak_speed']:.3g} of {one['speed_limit']:.3g}, torque {one['peak_torque']:.3g} of "
            f"{one['torque_limit']:.3g}"
        )
    if design.scale < 1.0:
        words.append(
            f"The torques leave {100 * design.scale:.0f} % of the amplitude that position and speed allow."
        )
    return [
        *words,
        f"Base parameters and friction: condition number {design.condition_number:.3g}; shifts and signs bring the "
        f"predicted standard errors to {100 * design.std_ratio:.0f} % of those at random.",
        "Collisions are not checked. Bring the robot to the first position before it starts.",
    ]  # fmt: skip
