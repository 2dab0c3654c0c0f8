"""Arms in MuJoCo that lack one thing their description does not show, and many small ones: descriptions and records.

Nothing here is shared with the diagnosis: MuJoCo integrates, and friction laws change `dof_frictionloss` at every step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.record import Record

mujoco: Any = import_module("mujoco")  # which has no types

STEP, FINE = 0.01, 5e-4
"""Sample time of the records and MuJoCo's step [s]."""
LENGTH, RECORDS = 5.0, 5
"""Length of a record [s], and how many there are, the last for the test."""
COUNT = 2.0 * np.pi / 4096
NOISE = 0.5 * COUNT
"""One count of the encoders, and the noise before they count [rad]."""
STIFF = 'solimpfriction="0.9999 0.9999 0.001" solreffriction="0.002 1"'
"""Dry friction that does not give way."""


@dataclass
class Joint:
    """One joint as it truly is."""

    axis: str
    length: float
    mass: float
    armature: float
    damping: float
    friction: float
    k_p: float
    name: str = ""
    zero: float = 0.0
    drop: float = 0.0
    v_s: float = 0.1
    mu: float = 0.0
    uneven: float = 0.0
    ripple: float = 0.0
    waves: float = 3.0
    spring: float = 0.0
    rest: float = 0.0
    bias: float = 0.0
    delay: float = 0.0
    rate: float = np.inf
    twist: float = 0.0
    mass_factor: float = 1.0

    def level(self, angle: float, speed: float, torque: float) -> float:
        """Dry friction [N m]."""
        level = self.friction * (1.0 + self.uneven * np.sign(speed))
        level *= 1.0 + self.ripple * np.sin(self.waves * angle)
        return level + self.drop * np.exp(-((speed / self.v_s) ** 2)) + self.mu * abs(torque)


@dataclass
class Arm:
    """An arm, what it lacks, and where."""

    joints: list[Joint]
    missing: str = "nothing"
    at: int = -1
    size: dict[str, float] = field(default_factory=dict)

    @property
    def names(self) -> list[str]:
        return [joint.name for joint in self.joints]


def xml(joints: list[Joint], flexible: bool = True) -> str:
    """The arm as MJCF; a gear that gives way as a hinge between servo and joint."""
    bodies, ends, motors = "", "", ""
    for k, j in enumerate(joints):
        mass, width = j.mass * j.mass_factor, 0.15 * j.length
        swing, along = mass * (j.length**2 / 12 + width**2), mass * width**2
        place = f"0 0 {joints[k - 1].length if k else 0.1:.4f}"
        drive = (
            f'armature="{j.armature:.5g}" damping="{j.damping:.5g}" frictionloss="{j.friction:.5g}" {STIFF}'
        )
        inertial = (
            f'<inertial mass="{mass:.5g}" pos="0 0 {0.5 * j.length:.4f}" '
            f'diaginertia="{swing:.5g} {swing:.5g} {along:.5g}"/>'
        )
        if flexible and j.twist:
            rotor = '<inertial mass="1e-4" pos="0 0 0" diaginertia="1e-7 1e-7 1e-7"/>'
            bodies += (
                f'<body pos="{place}"><joint name="{j.name}" axis="{j.axis}" {drive}/>{rotor}<body name="link{k}">'
                f'<joint name="twist" axis="{j.axis}" stiffness="{j.twist:.5g}" damping="{0.004 * j.twist:.5g}"/>'
                f"{inertial}"
            )
            ends += "</body></body>"
        else:
            bodies += f'<body name="link{k}" pos="{place}"><joint name="{j.name}" axis="{j.axis}" {drive}/>{inertial}'
            ends += "</body>"
        motors += f'<position joint="{j.name}" kp="{j.k_p:.5g}"/>'
    return (
        f'<mujoco><compiler angle="radian"/><option timestep="{FINE}" integrator="RK4"/><worldbody>{bodies}{ends}'
        f"</worldbody><actuator>{motors}</actuator></mujoco>"
    )


def draw(rng: np.random.Generator, missing: str) -> Arm:
    """An arm of two to seven joints that lacks a thing at a joint of its own, and small things at every joint."""
    count = int(rng.integers(2, 8))
    joints: list[Joint] = []
    for k in range(count):
        axis = "0 0 1" if k == 0 else ("0 1 0", "0 1 0", "1 0 0")[int(rng.integers(3))]
        joints.append(
            Joint(
                axis,
                rng.uniform(0.08, 0.18),
                rng.uniform(0.15, 0.5) * 0.8**k,
                0.0,
                0.0,
                0.0,
                0.0,
                f"j{k + 1}",
            )
        )
    for k, j in enumerate(joints):
        beyond = joints[k:]
        reach = np.cumsum([one.length for one in beyond]) - 0.5 * np.array([one.length for one in beyond])
        moment = 9.81 * sum(one.mass * r for one, r in zip(beyond, reach, strict=True))
        inertia = sum(one.mass * r * r for one, r in zip(beyond, reach, strict=True))
        j.k_p = moment * rng.uniform(8.0, 20.0)
        j.armature = inertia * rng.uniform(0.3, 1.0) + 1e-3
        j.damping = rng.uniform(0.6, 1.2) * np.sqrt(j.k_p * (inertia + j.armature))
        j.friction = moment * rng.uniform(0.05, 0.15)
        # small things at every joint, which no description has
        j.zero = np.radians(rng.uniform(-0.02, 0.02))
        j.drop, j.v_s = j.friction * rng.uniform(0.0, 0.05), rng.uniform(0.05, 0.2)
        j.uneven, j.ripple = rng.uniform(-0.02, 0.02), rng.uniform(0.0, 0.02)
        j.mass_factor = rng.uniform(0.98, 1.02)
    arm = Arm(joints, missing)
    if missing != "nothing":
        arm.at = (
            int(rng.integers(1, count))
            if missing in ("link_mass", "joint_flexibility")
            else int(rng.integers(count))
        )
        j = joints[arm.at]
        moment = j.k_p / 14.0
        for name, value in LACKS[missing](rng, j, moment).items():
            setattr(j, name, value)
            arm.size[name] = float(value)
    return arm


LACKS: dict[str, Callable[[np.random.Generator, Joint, float], dict[str, float]]] = {
    "stribeck_friction": lambda r, j, m: {
        "drop": j.friction * r.uniform(1.0, 2.0),
        "v_s": r.uniform(0.05, 0.2),
    },
    "load_dependent_friction": lambda r, j, m: {"mu": r.uniform(0.15, 0.35)},
    "asymmetric_friction": lambda r, j, m: {"uneven": r.choice([-1, 1]) * r.uniform(0.4, 0.7)},
    "position_dependent_friction": lambda r, j, m: {
        "ripple": r.uniform(0.6, 0.9),
        "waves": r.uniform(2.0, 5.0),
    },
    "spring_load": lambda r, j, m: {"spring": m * r.uniform(0.6, 1.5), "rest": r.uniform(-0.5, 0.5)},
    "constant_torque": lambda r, j, m: {"bias": r.choice([-1, 1]) * m * r.uniform(0.3, 0.6)},
    "encoder_zero": lambda r, j, m: {"zero": r.choice([-1, 1]) * np.radians(r.uniform(2.0, 4.0))},
    "delay": lambda r, j, m: {"delay": r.uniform(0.02, 0.05)},
    "goal_rate_limit": lambda r, j, m: {"rate": r.uniform(0.8, 1.4)},
    "joint_flexibility": lambda r, j, m: {"twist": m * r.uniform(12.0, 30.0)},
    "link_mass": lambda r, j, m: {"mass_factor": r.choice([0.5, 1.7]) * r.uniform(0.9, 1.1)},
}
"""What may be missing, by the name that a diagnosis has for it: values of a joint of weight's moment ``m`` [N m]."""


def goals(rng: np.random.Generator, count: int) -> np.ndarray:
    """Goals of a record [rad], ``(T, n)``: moves between poses, and two tones upon them."""
    time = STEP * np.arange(round(LENGTH / STEP))
    found = np.zeros((len(time), count))
    for k in range(count):
        knots = np.sort(rng.uniform(0.3, LENGTH - 0.6, 4))
        poses, at = rng.uniform(-0.7, 0.7, 5), np.zeros(len(time))
        at += poses[0]
        for knot, (a, b) in zip(knots, pairwise(poses), strict=True):
            s = np.clip((time - knot) / rng.uniform(0.3, 0.6), 0.0, 1.0)
            at += (b - a) * s * s * (3.0 - 2.0 * s)
        tones = sum(
            0.06 * np.sin(2 * np.pi * f * time + rng.uniform(0, 6.28)) for f in rng.uniform(0.5, 3.0, 2)
        )
        found[:, k] = at + tones * np.clip(time / 0.3, 0.0, 1.0)
    return found


def moved(arm: Arm, commanded: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """What the arm's encoders count [rad], ``(T, n)``."""
    model = mujoco.MjModel.from_xml_string(xml(arm.joints))
    data = mujoco.MjData(model)
    adr = [int(model.joint(name).dofadr[0]) for name in arm.names]
    twisted = next((k for k, j in enumerate(arm.joints) if j.twist), None)
    twist = None if twisted is None else int(model.joint("twist").qposadr[0])
    for k, j in enumerate(arm.joints):
        data.qpos[model.joint(j.name).qposadr[0]] = commanded[0, k]
    fine, aims = round(STEP / FINE), commanded[0].copy()
    found = np.zeros_like(commanded)
    for n in range(-100, len(commanded)):
        if n >= 0:
            found[n] = data.qpos[[int(model.joint(name).qposadr[0]) for name in arm.names]]
            if twisted is not None:
                found[n, twisted] += data.qpos[twist]
        for _ in range(fine):
            for k, j in enumerate(arm.joints):
                late = max(0, n - j.delay / STEP)
                low = min(int(late), len(commanded) - 1)
                goal = commanded[low, k] if n > 0 else commanded[0, k]
                aims[k] += np.clip(goal - aims[k], -j.rate * FINE, j.rate * FINE)
                angle = data.qpos[model.joint(j.name).qposadr[0]]
                seen = angle + (data.qpos[twist] if k == twisted else 0.0)
                data.ctrl[k] = aims[k] + (angle - seen)  # the servo's encoder sits at the joint
                speed = data.qvel[adr[k]]
                model.dof_frictionloss[adr[k]] = j.level(angle, speed, data.actuator_force[k])
                data.qfrc_applied[adr[k]] = j.bias - j.spring * (angle - j.rest)
            mujoco.mj_step(model, data)
    zeros = np.array([j.zero for j in arm.joints])
    return COUNT * np.round((found + zeros + NOISE * rng.standard_normal(found.shape)) / COUNT)


def write(folder: Path, seed: int, missing: str) -> Arm:
    """Draw an arm; write its description, whose values are up to 20 % off, its model and its records."""
    rng = np.random.default_rng(seed)
    arm = draw(rng, missing)
    described = []
    for j in arm.joints:
        off = 1.0 + 0.2 * rng.uniform(-1.0, 1.0, 4)
        described.append(
            Joint(j.axis, j.length, j.mass, j.armature * off[0], j.damping * off[1], j.friction * off[2],
                  j.k_p * off[3], j.name)
        )  # fmt: skip
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "arm.xml").write_text(xml(described, flexible=False))
    (folder / "model.yaml").write_text("robot: {file: arm.xml}\n")
    records, n = [], len(arm.joints)
    for k in range(RECORDS):
        commanded = goals(rng, n)
        angles = moved(arm, commanded, rng)
        role = "test" if k == RECORDS - 1 else "train"
        inputs = {f"goal{i + 1}": commanded[:, i] for i in range(n)}
        outputs = {f"q_a{i + 1}": angles[:, i] for i in range(n)}
        records.append(Record(f"run_{k}", STEP * np.arange(len(commanded)), inputs, outputs, role))
    std = float(np.hypot(NOISE, COUNT / np.sqrt(12.0)))
    channels = (
        tuple(Channel(f"goal{i + 1}", "rad") for i in range(n)),
        tuple(Channel(f"q_a{i + 1}", "rad", std) for i in range(n)),
    )
    Dataset("arm", *channels, tuple(records), STEP).save(folder / "records")
    return arm
