"""An arm moved in MuJoCo: what was commanded, how it truly moved, and what its encoders count.

Friction laws change MuJoCo's dry friction at every step. MuJoCo is asked for when it is used.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from itertools import pairwise
from typing import Any

import numpy as np

from hybrid_id.errors import InputError
from hybrid_id.machines.arms.effects import Effect
from hybrid_id.machines.arms.robot import STEP, Arm, mjcf, stacked

SAMPLE = 0.01
"""Sample time of the records [s]."""
LENGTH = 5.0
"""Length of a record [s]."""
TRAIN = 4
"""Train records; one more is for the test."""
SETTLING = 0.6
"""Time for which an arm holds its first pose before a record begins [s]."""


class Unstable(Exception):
    """An arm whose motion runs away."""


@dataclass(frozen=True, eq=False)
class Motion:
    """One record of an arm as it truly moved.

    Attributes:
        command: goals [rad], or torques [N m] where these are commanded, (T, n).
        angle, speed: of the joints, (T, n) [rad, rad/s].
        torque: by what acts outside the catalogue, mean of each sample (T, n) [N m].
        factor: of that on the dry friction, likewise.
    """

    command: np.ndarray
    angle: np.ndarray
    speed: np.ndarray
    torque: np.ndarray
    factor: np.ndarray


def mujoco() -> Any:
    """MuJoCo.

    Raises:
        InputError: it is not installed.
    """
    try:
        return import_module("mujoco")
    except ImportError:
        raise InputError(
            "blind make: arms move in MuJoCo, which is not installed; install it with pip install 'hybrid_id[robots]'"
        ) from None


def draw_goals(rng: np.random.Generator, joints: int) -> np.ndarray:
    """Goals of a record (T, n) [rad]: moves between poses, and two tones upon them."""
    time = SAMPLE * np.arange(round(LENGTH / SAMPLE))
    found = np.zeros((len(time), joints))
    for k in range(joints):
        starts = np.sort(rng.uniform(0.06 * LENGTH, 0.88 * LENGTH, 4))
        poses = rng.uniform(-0.72, 0.72, 5)
        own = np.full(len(time), poses[0])
        for start, (before, after) in zip(starts, pairwise(poses), strict=True):
            part = np.clip((time - start) / rng.uniform(0.28, 0.64), 0.0, 1.0)
            own += (after - before) * part * part * (3.0 - 2.0 * part)
        for frequency in rng.uniform(0.5, 3.2, 2):
            tone = 0.06 * np.sin(2 * np.pi * frequency * time + rng.uniform(-np.pi, np.pi))
            own += tone * np.clip(time / 0.4, 0.0, 1.0)
        found[:, k] = own
    return found


def moved(
    arm: Arm,
    goals: np.ndarray,
    outside: Sequence[Effect],
    drift: np.ndarray,
    phase: float,
) -> Motion:
    """Move an arm.

    Args:
        arm: as it is.
        goals: (T, n) [rad].
        outside: effects that its drives do not have.
        drift: factor on the friction of each joint, (n,).
        phase: of a clock of its own, at the record's start [rad].

    Raises:
        Unstable: it runs away.
    """
    mj = mujoco()
    model = mj.MjModel.from_xml_string(mjcf(arm))
    data, count, fine = mj.MjData(model), len(arm.links), round(SAMPLE / STEP)
    drive = stacked(arm.drives)
    at = [model.joint(name).qposadr[0] for name in arm.names]
    dof = [model.joint(name).dofadr[0] for name in arm.names]
    model.dof_damping[dof] *= drift
    soft = np.flatnonzero(drive.twist)
    twist = [model.joint("twist").qposadr[0] for _ in soft]
    twist_speed = [model.joint("twist").dofadr[0] for _ in soft]
    late = np.flatnonzero(drive.delay)
    data.qpos[at] = goals[0]
    aims, brake = goals[0].copy(), np.array(arm.brake)
    laws = [(effect.joint, _law(effect, phase)) for effect in outside]
    found = Motion(*(np.zeros_like(goals) for _ in range(5)))
    found.command[:] = goals
    for n in range(-round(SETTLING / SAMPLE), len(goals)):
        angle, speed = data.qpos[at], data.qvel[dof]
        angle[soft] += data.qpos[twist]
        speed[soft] += data.qvel[twist_speed]
        now = max(n, 0)
        if n >= 0:
            found.angle[n], found.speed[n] = angle, speed
        if not arm.servo:
            found.command[now] = drive.gain * (goals[now] - angle) - brake * speed
        command = found.command[now].copy()
        for f in range(fine):
            for k in late:
                command[k] = found.command[
                    max(0, int(np.floor((now * fine + f - drive.delay[k] / STEP) / fine))), k
                ]
            angle, speed = data.qpos[at], data.qvel[dof]
            if arm.servo:
                aims += np.clip(command - aims, -drive.rate * STEP, drive.rate * STEP)
                data.ctrl[:] = aims
                data.ctrl[soft] -= data.qpos[twist]  # the encoder sits at the joint
            else:
                data.ctrl[:] = command
            torque, factor = np.zeros(count), np.ones(count)
            for k, law in laws:
                torque[k], factor[k] = law(STEP * (n * fine + f), angle, speed)
            level = drift * factor * drive.dry(angle, speed, data.actuator_force)
            model.dof_frictionloss[dof] = level
            data.qfrc_applied[dof] = drive.push(angle) + torque
            mj.mj_step(model, data)
            if n >= 0:
                found.torque[n] += torque / fine
                found.factor[n] += factor / fine
        if not np.abs(data.qpos).max() < 4 * np.pi:
            raise Unstable
    return found


Law = Callable[[float, np.ndarray, np.ndarray], tuple[float, float]]
"""Torque [N m] and factor on the dry friction, from the time [s], angles [rad] and speeds [rad/s]."""


def _law(effect: Effect, phase: float) -> Law:
    """An effect outside the catalogue, with a memory where it has one."""
    own, v = effect.joint, effect.values
    memory = {"side": 1.0, "travel": 0.0}

    def over_other(time: float, angle: np.ndarray, speed: np.ndarray) -> tuple[float, float]:
        return 0.0, 1.0 + v["share"] * np.sin(v["waves"] * angle[int(v["other"])] + v["phase"])

    def over_time(time: float, angle: np.ndarray, speed: np.ndarray) -> tuple[float, float]:
        turn = 2 * np.pi * v["rate"] * time + phase
        return v["torque"] * np.sin(turn + 1.7 * np.sin(0.37 * turn)), 1.0

    def latch(time: float, angle: np.ndarray, speed: np.ndarray) -> tuple[float, float]:
        if abs(angle[own]) > v["reach"]:
            memory["side"] = float(np.sign(angle[own]))
        return memory["side"] * v["torque"], 1.0

    def running_in(time: float, angle: np.ndarray, speed: np.ndarray) -> tuple[float, float]:
        memory["travel"] += abs(speed[own]) * STEP if time > 0 else 0.0
        return 0.0, 1.0 + v["share"] * np.exp(-memory["travel"] / v["travel"])

    laws = {
        "friction_over_other_joint": over_other,
        "torque_over_time": over_time,
        "latch": latch,
        "running_in": running_in,
    }
    return laws[effect.formula]


def counted(arm: Arm, angle: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """What encoders read of true angles (T, n) [rad]."""
    zero = np.array([drive.zero for drive in arm.drives])
    noisy = angle + zero + arm.jitter * rng.standard_normal(angle.shape)
    return arm.count * np.round(noisy / arm.count)


@dataclass(frozen=True, eq=False)
class Load:
    """What the joints carry while all move as they truly did: between samples, (R, T - 1, n) each.

    Attributes:
        inertia: of a joint by itself, without its rotor [kg m^2].
        torque: that weight and motion of the others take from it [N m].
        slope: of that over the joint's own angle [N m/rad].
        angle: of the joints, for which this holds [rad].
    """

    inertia: np.ndarray
    torque: np.ndarray
    slope: np.ndarray
    angle: np.ndarray

    def less(self, other: "Load") -> "Load":
        """By how much it is more than another one."""
        inertia, torque = self.inertia - other.inertia, self.torque - other.torque
        return replace(self, inertia=inertia, torque=torque, slope=self.slope - other.slope)


def carried(arm: Arm, masses: Sequence[float], motions: Sequence[Motion]) -> Load:
    """What joints carry of links whose masses are off by shares."""
    mj, count = mujoco(), len(arm.links)
    rigid = tuple(replace(one, mass=own, twist=0.0) for one, own in zip(arm.drives, masses, strict=True))
    model = mj.MjModel.from_xml_string(mjcf(replace(arm, drives=rigid)))
    model.dof_armature[:] = 0.0
    model.dof_damping[:] = 0.0
    data, whole, tilt = mj.MjData(model), np.zeros((count, count)), 1e-4
    shape = (len(motions), len(motions[0].angle) - 1, count)
    found = Load(*(np.zeros(shape) for _ in range(4)))

    def torque(angle: np.ndarray, speed: np.ndarray, acceleration: np.ndarray) -> np.ndarray:
        data.qpos[:], data.qvel[:] = angle, speed
        mj.mj_fwdPosition(model, data)
        mj.mj_fwdVelocity(model, data)
        mj.mj_fullM(model, data, whole)
        return data.qfrc_bias + whole @ acceleration - np.diag(whole) * acceleration

    for r, motion in enumerate(motions):
        middle = [0.5 * (one[1:] + one[:-1]) for one in (motion.angle, motion.speed)]
        acceleration = np.diff(motion.speed, axis=0) / SAMPLE
        found.angle[r] = middle[0]
        for n, (angle, speed, faster) in enumerate(zip(*middle, acceleration, strict=True)):
            found.torque[r, n] = torque(angle, speed, faster)
            found.inertia[r, n] = np.diag(whole)
            for k in range(count):
                aside = angle.copy()
                aside[k] += tilt
                found.slope[r, n, k] = (torque(aside, speed, faster)[k] - found.torque[r, n, k]) / tilt
    return found
