"""A twin of a six-joint desktop arm: its maker's description, one arm that differs from it, and that arm's records."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
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
    model: Any = mujoco.MjModel.from_xml_path(str(DESCRIPTION))  # type: ignore[attr-defined]
    truth = _drawn(model, rng)
    joints = range(1, model.njnt + 1)
    records = tuple(
        Record(
            f"run_{k}",
            STEP * np.arange(round(LENGTH / STEP)),
            *_moved(mujoco, model, rng),
            role="test" if k == RECORDS - 1 else "train",
        )
        for k in range(RECORDS)
    )
    dataset = Dataset(
        "desk_arm",
        tuple(Channel(f"goal{k}", "rad") for k in joints),
        tuple(Channel(f"q_m{k}", "rad", COUNT / np.sqrt(12.0)) for k in joints),
        records,
        STEP,
    )
    dataset.save(folder)
    shutil.copy(DESCRIPTION, folder)
    (folder / "model.yaml").write_text(f"robot: {{file: {DESCRIPTION.name}}}\n")
    return dataset, truth


def _drawn(model: Any, rng: np.random.Generator) -> dict[str, float]:
    """Give a model one arm's values; returns them by parameter name."""
    for values in (model.dof_armature, model.dof_damping, model.dof_frictionloss):
        values[:] *= 1.0 + SPREAD * rng.uniform(-1.0, 1.0, values.shape)
    stiffness = model.actuator_gainprm[:, 0] * (1.0 + SPREAD * rng.uniform(-1.0, 1.0, model.nu))
    model.actuator_gainprm[:, 0], model.actuator_biasprm[:, 1] = stiffness, -stiffness
    own = {
        "k_p": stiffness,
        "J_m": model.dof_armature,
        "F_v": np.reshape(model.dof_damping, (model.nv, -1))[:, 0],
        "F_c": np.reshape(model.dof_frictionloss, (model.nv, -1))[:, 0],
    }
    names = [model.joint(k).name for k in range(model.njnt)]
    return {
        f"{symbol}_{name}": float(v)
        for symbol, all_ in own.items()
        for name, v in zip(names, all_, strict=True)
    }


def _moved(
    mujoco: Any, model: Any, rng: np.random.Generator
) -> tuple[Mapping[str, np.ndarray], Mapping[str, np.ndarray]]:
    """Goals and encoder readings of one record: moves from pose to pose within the joints' limits."""
    samples = round(LENGTH / STEP)
    low, high = model.jnt_range.T
    poses = low + (high - low) * rng.uniform(0.15, 0.85, (MOVES + 1, model.njnt))
    at = MOVES * np.arange(samples) / samples
    move, phase = np.divmod(at, 1.0)
    share = np.clip(phase / rng.uniform(0.35, 0.8, (MOVES,))[move.astype(int)], 0.0, 1.0)
    smooth = (share**3 * (10.0 - 15.0 * share + 6.0 * share**2))[:, None]
    goals = poses[move.astype(int)] * (1.0 - smooth) + poses[move.astype(int) + 1] * smooth
    data = mujoco.MjData(model)
    data.qpos[:], data.ctrl[:] = goals[0], goals[0]
    for _ in range(round(2.0 / model.opt.timestep)):  # the arm hangs into its gains before the record begins
        mujoco.mj_step(model, data)
    angles = np.empty_like(goals)
    for k, goal in enumerate(goals):
        angles[k] = COUNT * np.round(data.qpos / COUNT)
        data.ctrl[:] = goal
        for _ in range(round(STEP / model.opt.timestep)):
            mujoco.mj_step(model, data)
    columns = range(model.njnt)
    return {f"goal{k + 1}": goals[:, k] for k in columns}, {f"q_m{k + 1}": angles[:, k] for k in columns}
