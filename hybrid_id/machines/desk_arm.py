"""A twin of a six-joint desktop arm: its maker's description, one arm that differs from it, and that arm's records.

The elbow's gear gives way, which the description does not show: there the model adds a spring. The servo's encoder sits
behind it, at the joint.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any, cast

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
MOVES = 5
"""Moves from pose to pose in a record."""
COUNT = 2.0 * np.pi / 4096
"""Angle of one count of the encoders [rad]."""
NOISE = 0.5 * COUNT
"""Standard deviation of an encoder's noise before it counts [rad]: that of a magnetic one, AS5600 say, in its fastest
mode. An encoder without any repeats one error as long as a joint rests, which no interval can know."""
ELBOW, SPRING = "elbow_pitch", {"k": 10.0, "d": 0.04}
"""Joint whose gear is flexible, its nominal stiffness [N m/rad] and damping [N m s/rad]."""
MODEL = """robot: {{file: {file}}}
components:
  - {{place: {joint}/transmission, kind: linear_spring, parameters: {{k: {k}, d: {d}}}}}
"""


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

    def drawn(nominal: Any) -> np.ndarray:
        return nominal * (1.0 + SPREAD * rng.uniform(-1.0, 1.0, np.shape(nominal)))

    spec = cast(Any, mujoco).MjSpec.from_file(str(DESCRIPTION))
    names = [joint.name for joint in spec.joints]
    servo = spec.joint(ELBOW)
    servo.parent.add_joint(
        name="twist", pos=servo.pos, axis=servo.axis
    )  # the spring, a hinge behind the servo
    model = spec.compile()
    servos, twist = [model.joint(name).dofadr[0] for name in names], model.joint("twist")
    damping, stiffness = (
        np.reshape(model.dof_damping, (model.nv, -1)),
        np.reshape(model.jnt_stiffness, (model.njnt, -1)),
    )
    values = {
        "J_m": drawn(model.dof_armature[servos]),
        "F_v": drawn(damping[servos, 0]),
        "F_c": drawn(model.dof_frictionloss[servos]),
        "k_p": drawn(model.actuator_gainprm[:, 0]),
    }
    truth = {
        f"{symbol}_{n}": float(v) for symbol, all_ in values.items() for n, v in zip(names, all_, strict=True)
    }
    model.dof_armature[servos], model.dof_frictionloss[servos] = values["J_m"], values["F_c"]
    damping[servos, 0] = values["F_v"]
    model.actuator_gainprm[:, 0], model.actuator_biasprm[:, 1] = values["k_p"], -values["k_p"]
    for symbol, place in (("k", stiffness[twist.id]), ("d", damping[twist.dofadr[0]])):
        truth[f"{symbol}_{ELBOW}"] = place[0] = float(drawn(SPRING[symbol]))
    goals, angles = zip(*(_moved(mujoco, names, model, rng) for _ in range(RECORDS)), strict=True)
    inputs = [f"goal{k}" for k in range(1, len(names) + 1)]
    # encoders are at the motor where the gear is rigid, at the joint where it is not
    outputs = [f"q_{'a' if name == ELBOW else 'm'}{k}" for k, name in enumerate(names, 1)]
    noise = float(np.hypot(NOISE, COUNT / np.sqrt(12.0)))
    records = tuple(
        Record(
            f"run_{k}",
            STEP * np.arange(len(goals[k])),
            dict(zip(inputs, goals[k].T, strict=True)),
            dict(zip(outputs, angles[k].T, strict=True)),
            role="test" if k == RECORDS - 1 else "train",
        )
        for k in range(RECORDS)
    )
    dataset = Dataset(
        "desk_arm",
        tuple(Channel(name, "rad") for name in inputs),
        tuple(Channel(name, "rad", noise) for name in outputs),
        records,
        STEP,
    )
    dataset.save(folder)
    shutil.copy(DESCRIPTION, folder)
    (folder / "model.yaml").write_text(MODEL.format(file=DESCRIPTION.name, joint=ELBOW, **SPRING))
    return dataset, truth


def _moved(
    mujoco: Any, names: list[str], model: Any, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Goals and encoder readings of a record, ``(T, joints)``: moves from pose to pose within the joints' limits."""
    samples = round(LENGTH / STEP)
    low, high = np.array([model.joint(name).range for name in names]).T
    at_servo = [model.joint(name).qposadr[0] for name in names]
    poses = low + (high - low) * rng.uniform(0.15, 0.85, (MOVES + 1, len(names)))
    move, phase = np.divmod(MOVES * np.arange(samples) / samples, 1.0)
    move = move.astype(int)
    share = np.clip(phase / rng.uniform(0.35, 0.8, (MOVES,))[move], 0.0, 1.0)
    smooth = (share**3 * (10.0 - 15.0 * share + 6.0 * share**2))[:, None]
    goals = poses[move] * (1.0 - smooth) + poses[move + 1] * smooth
    data, goal = mujoco.MjData(model), goals[0]
    elbow, twist = names.index(ELBOW), model.joint("twist").qposadr[0]

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
    return goals, COUNT * np.round((angles + rng.normal(0.0, NOISE, angles.shape)) / COUNT)
