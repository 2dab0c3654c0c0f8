"""Records and model of the SO-101: its MJCF, a servo at each of five joints, the gripper held, the table under it."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import pandas as pd

from hybrid_id.components import Delay, FloorContact, LoadDependent, PositionServo, Stribeck
from hybrid_id.components.base import Component
from hybrid_id.parameters import Bounded
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.record import Record
from hybrid_id.robots.description import load_tree
from hybrid_id.systems.builders import joint_names, robot
from hybrid_id.systems.chain import System

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")
TEST = (
    "chirp_sweep", "static_holding", "multisine", "reaching_points", "trapezoidal_profile", "coupled_joints",
    "large_amplitude", "staircase_motion", "spiral_motion", "oscillation_med_freq",
)  # fmt: skip
COUNT = 1.5e-3
"""One count of the encoder [rad]."""
GRIPPER = 0.5
"""Where the gripper is held [rad]; its motion moves 12 g."""


def aside(names: list[str]) -> list[str]:
    """The five train motions whose names have the smallest SHA-256: kept for a last look."""
    return sorted(names, key=lambda name: hashlib.sha256(name.encode()).hexdigest())[:5]


def load(folder: Path, only: str | None = None) -> dict[str, Dataset]:
    """Records by role: ``train`` (15), ``aside`` (5), ``test`` (10).

    Args:
        folder: holds ``records/*.csv.gz``.
        only: the role whose files are opened; None for all.
    """
    names = sorted(path.name.removesuffix(".csv.gz") for path in (folder / "records").glob("*.csv.gz"))
    train = [name for name in names if name not in TEST]
    kept = aside(train)
    roles = {"train": [n for n in train if n not in kept], "aside": kept, "test": list(TEST)}
    return {role: _dataset(folder, own) for role, own in roles.items() if only in (None, role)}


def _dataset(folder: Path, names: list[str]) -> Dataset:
    records = []
    for name in names:
        table = pd.read_csv(folder / "records" / f"{name}.csv.gz")
        goals = {f"goal{k}": table[f"goal_{joint}"].to_numpy() for k, joint in enumerate(JOINTS, 1)}
        angles = {f"q_a{k}": table[f"position_{joint}"].to_numpy() for k, joint in enumerate(JOINTS, 1)}
        records.append(Record(name, table["t"].to_numpy(), goals, angles))
    count = range(1, len(JOINTS) + 1)
    return Dataset(
        "so101",
        tuple(Channel(f"goal{k}", "rad") for k in count),
        tuple(Channel(f"q_a{k}", "rad", COUNT) for k in count),
        tuple(records),
    )


def model(folder: Path, extra: dict[str, tuple[str, ...]] | None = None, floor: bool = True) -> System:
    """The user's description with what the servo's data sheet says as start values.

    Args:
        folder: holds ``so101_new_calib.xml``.
        extra: names of further friction laws, ``load`` or ``stribeck``, by joint.
        floor: whether the gripper can touch a table.
    """
    tree = load_tree(folder / "so101_new_calib.xml").holding({"gripper": GRIPPER})
    system = robot(tree)
    for k, joint in enumerate(JOINTS, 1):
        # 12 V, P 16: duty of 0.165 x 16 per rad, 3 N m at stall
        lowest = Bounded(-1.1, -2.0, 0.0, "rad") if joint == "wrist_roll" else -1e4
        servo = PositionServo(
            k_p=Bounded(8.0, 2.0, 60.0, "N m/rad"),
            tau_max=Bounded(3.0, 0.5, 8.0, "N m", False),
            goal_min=lowest,
        )
        system = system.with_component(f"joint{k}/input", servo)
        system = system.with_component(f"joint{k}/input", Delay(T_d=Bounded(0.02, 0.0, 0.08, "s")))
        for law in (extra or {}).get(joint, ()):
            system = system.with_component(f"joint{k}/motor_friction", friction(law))
    if floor:
        table = FloorContact(
            "gripperframe", z_f=Bounded(-0.035, -0.08, 0.03, "m"), k_f=Bounded(300.0, 0.0, 2e4, "N/m")
        )
        system = system.with_component("joint5/load", table)
    system = System(
        system.gear_ratio, parts := _parts(system), joint_names(tree, parts), name=system.name, tree=tree
    )
    limits = {"J_m": (0.02, 0.004, 0.1), "F_c": (0.1, 0.0, 2.0), "F_v": (0.5, 0.0, 5.0)}
    specs = {}
    for info in system.table:
        if info.symbol in limits and info.component.split("/")[1] in ("motor_friction", "load"):
            value, lower, upper = limits[info.symbol]
            specs[info.name] = replace(info.spec, value=value, lower=lower, upper=upper)
    return system.with_specs(specs)


def _parts(system: System) -> list[tuple[str, Component]]:
    return [(key.rpartition("/")[0], part) for key, part in system.components.items()]  # type: ignore[misc]


def friction(law: str) -> Component:
    """A friction law that may act beside Coulomb and viscous friction, at its start values."""
    return LoadDependent(mu=0.4) if law == "load" else Stribeck(F_drop=0.1, v_s=0.1)
