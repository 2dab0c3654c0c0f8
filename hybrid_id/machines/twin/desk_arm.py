"""A twin of a six-joint desktop arm: its maker's description, one arm that differs from it, and that arm's records.

The elbow's gear gives way, which the description does not show: there the model adds a spring. The servo's encoder sits
behind it, at the joint.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hybrid_id.errors import InputError
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.record import Record

DESCRIPTION = Path(__file__).with_name("desk_arm.xml")
"""Nominal values of such arms."""
SPREAD = 0.3
"""Half of the range in which one arm's values differ from the nominal ones, as a share."""
RECORDS, LENGTH, STEP = 5, 6.0, 0.01
"""Records, the last of which is for the test; their length and their sample time [s]."""
COUNT = 2.0 * np.pi / 4096
"""Angle of one count of the encoders [rad]."""
NOISE = 0.5 * COUNT
"""Standard deviation of an encoder's noise before it counts [rad]: that of a magnetic one, AS5600 say, in its fastest
mode. An encoder without any repeats one error as long as a joint rests, which no interval can know."""
SPRING = {"joint": "elbow_pitch", "k": 10.0, "d": 0.04}
"""Joint whose gear is flexible, its nominal stiffness [N m/rad] and damping [N m s/rad]."""
TWIST = "twist"
"""Name of its deflection in MuJoCo."""
FLEXIBLE = """robot: {{file: {file}}}
components:
  - {{place: {joint}/transmission, kind: linear_spring, parameters: {{k: {k}, d: {d}}}}}
"""
MOVES = 5
"""Moves from pose to pose in a record."""


def write_arm(folder: Path, seed: int = 0) -> tuple[Dataset, dict[str, float]]:
    """Draw an arm, move it in MuJoCo, and write description, nominal model and records into a folder.

    Args:
        folder: is made.
        seed: of the arm's values and its motions.

    Returns:
        The records, and the arm's true values under the names of the model's parameters.

    Raises:
        InputError: MuJoCo is not installed.
    """
    try:
        import mujoco
    except ImportError:
        raise InputError(
            "a robot's description needs MuJoCo; pip install 'hybrid_id[robots]' brings it"
        ) from None
    rng = np.random.default_rng(seed)
    names, model = _flexible(mujoco)
    truth = _drawn(names, model, rng)
    joints = range(1, len(names) + 1)
    records = tuple(
        Record(
            f"run_{k}",
            STEP * np.arange(round(LENGTH / STEP)),
            *_moved(mujoco, names, model, rng),
            role="test" if k == RECORDS - 1 else "train",
        )
        for k in range(RECORDS)
    )
    dataset = Dataset(
        "desk_arm",
        tuple(Channel(f"goal{k}", "rad") for k in joints),
        tuple(
            Channel(name, "rad", float(np.hypot(NOISE, COUNT / np.sqrt(12.0)))) for name in _encoders(names)
        ),
        records,
        STEP,
    )
    dataset.save(folder)
    shutil.copy(DESCRIPTION, folder)
    (folder / "model.yaml").write_text(FLEXIBLE.format(file=DESCRIPTION.name, **SPRING))
    return dataset, truth


def _flexible(mujoco: Any) -> tuple[list[str], Any]:
    """Names of the description's joints, and MuJoCo's model of it with a second hinge as the spring behind a servo."""
    spec = mujoco.MjSpec.from_file(str(DESCRIPTION))
    names = [joint.name for joint in spec.joints]
    servo = spec.joint(SPRING["joint"])
    servo.parent.add_joint(name=TWIST, pos=servo.pos, axis=servo.axis)
    return names, spec.compile()


def _encoders(names: Sequence[str]) -> list[str]:
    """Channels of the encoders: of the motor where the gear is rigid, of the joint where it is not."""
    return [f"q_{'a' if name == SPRING['joint'] else 'm'}{k}" for k, name in enumerate(names, 1)]


def _drawn(names: Sequence[str], model: Any, rng: np.random.Generator) -> dict[str, float]:
    """Give a model one arm's values; returns them by parameter name."""

    def one_of(nominal: np.ndarray) -> np.ndarray:
        return nominal * (1.0 + SPREAD * rng.uniform(-1.0, 1.0, np.shape(nominal)))

    servos, twist = [model.joint(name).dofadr[0] for name in names], model.joint(TWIST)
    own = {
        "J_m": one_of(model.dof_armature[servos]),
        "F_v": one_of(np.reshape(model.dof_damping, (model.nv, -1))[servos, 0]),
        "F_c": one_of(model.dof_frictionloss[servos]),
        "k_p": one_of(model.actuator_gainprm[:, 0]),
    }
    model.dof_armature[servos], model.dof_frictionloss[servos] = own["J_m"], own["F_c"]
    np.reshape(model.dof_damping, (model.nv, -1))[servos, 0] = own["F_v"]
    model.actuator_gainprm[:, 0], model.actuator_biasprm[:, 1] = own["k_p"], -own["k_p"]
    spring = {symbol: float(one_of(np.array(SPRING[symbol]))) for symbol in ("k", "d")}
    np.reshape(model.jnt_stiffness, (model.njnt, -1))[twist.id, 0] = spring["k"]
    np.reshape(model.dof_damping, (model.nv, -1))[twist.dofadr[0], 0] = spring["d"]
    truth = {
        f"{symbol}_{name}": float(v)
        for symbol, all_ in own.items()
        for name, v in zip(names, all_, strict=True)
    }
    return truth | {f"{symbol}_{SPRING['joint']}": value for symbol, value in spring.items()}


def _moved(
    mujoco: Any, names: Sequence[str], model: Any, rng: np.random.Generator
) -> tuple[Mapping[str, np.ndarray], Mapping[str, np.ndarray]]:
    """Goals and encoder readings of one record: moves from pose to pose within the joints' limits."""
    samples = round(LENGTH / STEP)
    low, high = np.array([model.joint(name).range for name in names]).T
    at_servo = [model.joint(name).qposadr[0] for name in names]
    poses = low + (high - low) * rng.uniform(0.15, 0.85, (MOVES + 1, len(names)))
    at = MOVES * np.arange(samples) / samples
    move, phase = np.divmod(at, 1.0)
    share = np.clip(phase / rng.uniform(0.35, 0.8, (MOVES,))[move.astype(int)], 0.0, 1.0)
    smooth = (share**3 * (10.0 - 15.0 * share + 6.0 * share**2))[:, None]
    goals = poses[move.astype(int)] * (1.0 - smooth) + poses[move.astype(int) + 1] * smooth
    data, goal = mujoco.MjData(model), goals[0]
    elbow, twist = names.index(SPRING["joint"]), model.joint(TWIST).qposadr[0]

    def follow(_: Any, now: Any) -> None:
        """Give the servos their goals; one behind a flexible gear compares its own with the joint's angle."""
        now.ctrl[:] = goal
        now.ctrl[elbow] -= now.qpos[twist]

    data.qpos[at_servo] = goal
    angles = np.empty_like(goals)
    mujoco.set_mjcb_control(follow)
    try:
        mujoco.mj_step(model, data, round(2.0 / model.opt.timestep))  # it hangs into its gains
        for k in range(samples):
            goal = goals[k]
            angles[k] = data.qpos[at_servo]
            angles[k, elbow] += data.qpos[twist]
            mujoco.mj_step(model, data, round(STEP / model.opt.timestep))
    finally:
        mujoco.set_mjcb_control(None)
    counts = COUNT * np.round((angles + rng.normal(0.0, NOISE, angles.shape)) / COUNT)
    return {f"goal{k + 1}": goals[:, k] for k in range(len(names))}, dict(
        zip(_encoders(names), counts.T, strict=True)
    )
