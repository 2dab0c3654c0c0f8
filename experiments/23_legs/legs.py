"""Twelve joints of a quadruped hung by its trunk: what is drawn, what MuJoCo makes of it, and the model to fit."""

from __future__ import annotations

from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any, cast

import numpy as np

from hybrid_id.components import CommonDelay, Component, LinkEncoder
from hybrid_id.parameters import Bounded
from hybrid_id.records.record import Record
from hybrid_id.robots.description import load_tree
from hybrid_id.systems.builders import joint_names, robot
from hybrid_id.systems.chain import System

DESCRIPTION = Path(__file__).resolve().parent / "legs.xml"
STEP, SECONDS = 0.0025, 20.0
"""Sample time of the record, which holds the goals, and its length [s]."""
FINE = 1.25e-4
"""Step of MuJoCo [s]."""
NOISE = 3e-4
"""Standard deviation of the encoders' noise [rad]."""
SWEEP = (0.1, 10.0)
"""First and last frequency of the chirp [Hz]."""
CENTRE = np.tile([0.0, 0.9, -1.8], 4)
"""Goals about which the joints swing [rad]: the description's standing posture."""
SWING = np.tile([0.15, 0.25, 0.3], 4) * np.array([1, 1, 1, -1, 1, 1, 1, -1, -1, -1, -1, -1])
"""Amplitudes [rad]."""


@dataclass(frozen=True)
class Truth:
    """What no description knows: of each joint, ``(12,)``, and the dead time [s].

    Attributes:
        armature: [kg m^2].
        viscous: [N m s/rad].
        dry: [N m].
        bias: reading of the encoder at the description's zero, which the loop reads, too [rad].
        delay: of all goals.
    """

    armature: np.ndarray
    viscous: np.ndarray
    dry: np.ndarray
    bias: np.ndarray
    delay: float

    @classmethod
    def drawn(cls, seed: int) -> Truth:
        """Values of a seed."""
        rng = np.random.default_rng(seed)
        bias = rng.uniform(0.02, 0.1, 12) * rng.choice([-1.0, 1.0], 12)
        return cls(
            rng.uniform(0.006, 0.02, 12), rng.uniform(0.3, 2.0, 12), rng.uniform(0.1, 0.5, 12), bias,
            FINE * rng.integers(24, 72),
        )  # fmt: skip

    def by_name(self, system: System) -> dict[str, float]:
        """Values by the names of the model's parameters."""
        found = {"T_d": self.delay}
        names = [] if system.tree is None else system.tree.names
        for k, joint in enumerate(names):
            own = {"J_m": self.armature, "F_v": self.viscous, "F_c": self.dry, "offset": self.bias}
            found |= {f"{symbol}_{joint}": float(values[k]) for symbol, values in own.items()}
        return found


def goals() -> np.ndarray:
    """A linear chirp about the standing posture, ``(T, 12)`` [rad]."""
    t, (low, high) = np.arange(0.0, SECONDS, STEP), SWEEP
    phase = 2.0 * np.pi * (low * t + (high - low) / (2.0 * SECONDS) * t**2)
    return CENTRE + SWING * np.sin(phase)[:, None]


def record(truth: Truth, seed: int) -> Record:
    """What the encoders read while the loops follow the chirp, from rest at the first goal.

    RK4 at 0.125 ms; dry friction gives way over 1 ms and not over MuJoCo's usual 20 ms, which would be viscous.
    """
    mujoco: Any = import_module("mujoco")  # has no types
    model = mujoco.MjModel.from_xml_path(str(DESCRIPTION))
    model.opt.timestep, model.opt.integrator = FINE, int(mujoco.mjtIntegrator.mjINT_RK4)
    model.dof_armature[:], model.dof_damping[:] = truth.armature, truth.viscous
    model.dof_frictionloss[:] = truth.dry
    model.dof_solref[:], model.dof_solimp[:, :2] = [1e-3, 1.0], 0.99
    wanted, every, late = goals(), round(STEP / FINE), round(truth.delay / FINE)
    data = mujoco.MjData(model)
    data.qpos[:], data.ctrl[:] = wanted[0] - truth.bias, wanted[0] - truth.bias
    for _ in range(round(1.0 / FINE)):
        mujoco.mj_step(model, data)
    seen = np.empty_like(wanted)
    for k in range(len(wanted)):
        seen[k] = data.qpos + truth.bias
        for fine in range(every):
            data.ctrl[:] = wanted[max(0, (k * every + fine - late) // every)] - truth.bias
            mujoco.mj_step(model, data)
    seen += np.random.default_rng([seed, 1]).normal(0.0, NOISE, seen.shape)
    inputs = {f"goal{k + 1}": wanted[:, k] for k in range(12)}
    return Record(
        "chirp", STEP * np.arange(len(wanted)), inputs, {f"q_a{k + 1}": seen[:, k] for k in range(12)}
    )


def model() -> System:
    """The description, with 49 parameters to be fitted: stiffness, damping and limits of the loops are known."""
    tree = load_tree(DESCRIPTION)
    parts = [(key.rpartition("/")[0], cast(Component, part)) for key, part in robot(tree).components.items()]
    free = Bounded(0.0, -0.3, 0.3, "rad")
    parts += [(f"joint{k}/sensor", LinkEncoder(offset=free)) for k in range(1, 13)]
    parts.append(("joint1/input", CommonDelay(T_d=Bounded(STEP, 0.0, 0.02, "s"))))
    names = joint_names(tree, parts) | {("joint1/input/common_delay", "T_d"): "T_d"}
    system = System([1.0] * 12, parts, names, "robot", tree)
    kept = {i.name: replace(i.spec, estimate=False) for i in system.table if i.symbol == "k_p"}
    return system.with_specs(kept)
