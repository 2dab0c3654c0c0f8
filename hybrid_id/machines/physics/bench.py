"""A machine on the bench: commands or a controller, encoders, and what is logged."""

from dataclasses import dataclass

import numpy as np

from hybrid_id.machines.physics.machine import Machine
from hybrid_id.machines.physics.mujoco import MujocoMachine


@dataclass(frozen=True, eq=False)
class Flaws:
    """What encoders get wrong beside noise: ``q(t - late) + ripple sin(q + phase) + lost``.

    Attributes:
        ripple: (n_outputs,) of an eccentric disk, once a turn of the encoder's shaft [rad].
        phase: (n_outputs,) of it [rad].
        late: (n_outputs,) by which a channel is sampled after the others, as a share of a sample.
        lost: (T, n_outputs, B) counts missed at that time, until the index is passed [rad].
    """

    ripple: np.ndarray
    phase: np.ndarray
    late: np.ndarray
    lost: np.ndarray


@dataclass(frozen=True, eq=False)
class Encoders:
    """``y = Q round((q + n) / Q)`` with quantum Q [rad] and jitter n [rad].

    Attributes:
        quantum: (n_outputs,), rotors first.
        jitter: (T, n_outputs, B).
        link: whether the link of joint 1 has an encoder too.
        at_links: whether all encoders are at the links instead of the rotors.
        flaws: beside noise; None where there are none.
    """

    quantum: np.ndarray
    jitter: np.ndarray
    link: bool = False
    flaws: Flaws | None = None
    at_links: bool = False

    def angles(self, rotor: np.ndarray, link: np.ndarray) -> np.ndarray:
        """True angles (n_outputs, B) of all shafts with an encoder."""
        if self.at_links:
            return link
        return np.concatenate([rotor, link[:1]]) if self.link else rotor

    def read(self, k: int, true: np.ndarray, before: np.ndarray) -> np.ndarray:
        """Measured angles (n_outputs, B) of sample k, from the true ones and those of the sample before it."""
        if self.flaws is not None:
            ripple, phase, late = (
                self.flaws.ripple[:, None],
                self.flaws.phase[:, None],
                self.flaws.late[:, None],
            )
            seen = true - late * (true - before)
            true = seen + ripple * (np.sin(seen + phase) - np.sin(phase)) + self.flaws.lost[k]
        quantum = self.quantum[:, None]
        return quantum * np.round((true + self.jitter[k]) / quantum)


@dataclass(frozen=True, eq=False)
class Program:
    """What is done to B runs: ``u = feed + kp e + kd e' + ki int e``, clipped; e is the error of the rotor's angle.

    Attributes:
        feed: (T, n_joints, B) [V].
        reference: (T, n_joints, B) of the rotor [rad].
        kp, kd, ki: (n_joints, B) [V/rad, V s/rad, V/(rad s)]; all zero for an open loop.
        limit: (n_joints, B) [V].
        disturbance: (T, n_joints, B) torque on the rotor [N m].
    """

    feed: np.ndarray
    reference: np.ndarray
    kp: np.ndarray
    kd: np.ndarray
    ki: np.ndarray
    limit: np.ndarray
    disturbance: np.ndarray


DIFFERENCE = 5
"""Samples over which a controller takes the speed."""


def run(
    plant: Machine | MujocoMachine,
    program: Program,
    encoders: Encoders,
    *,
    sample_time: float,
    rest: float = 0.1,
    start: np.ndarray | None = None,
    slope: int = DIFFERENCE,
) -> tuple[np.ndarray, np.ndarray]:
    """Run all records of a program.

    Args:
        plant: the machine.
        program: commands and controllers.
        encoders: sensors, whose readings the controllers see.
        sample_time: of records and controllers [s].
        rest: time without voltage at the start [s].
        start: link angles (n_joints, B) [rad]; without them the machine settles by itself.
        slope: samples over which the controllers take the speed.

    Returns:
        Logged voltages (T, n_joints, B), rounded to 0.1 mV, and measured angles (T, n_outputs, B).
    """
    samples, joints, lanes = program.feed.shape
    resting = round(rest / sample_time)
    plant.begin(lanes, samples, sample_time, start)
    volts = np.zeros((samples, joints, lanes))
    measured = np.zeros((samples, len(encoders.quantum), lanes))
    integral = np.zeros((joints, lanes))
    error = np.zeros((slope + 1, joints, lanes))  # the newest last
    before = encoders.angles(*plant.angles())
    for k in range(samples):
        true = encoders.angles(*plant.angles())
        measured[k] = encoders.read(k, true, before)
        before = true
        error = np.concatenate([error[1:], (program.reference[k] - measured[k, :joints])[None]])
        if k >= resting:
            rate = (error[-1] - error[0]) / (slope * sample_time)
            integral = integral + sample_time * error[-1]
            u = program.feed[k] + program.kp * error[-1] + program.kd * rate + program.ki * integral
            volts[k] = np.round(np.clip(u, -program.limit, program.limit), 4)
        plant.advance(volts[k], program.disturbance[k])
    return volts, measured


def replay(
    plant: Machine,
    volts: np.ndarray,
    *,
    sample_time: float,
    link: bool = False,
    start: np.ndarray | None = None,
) -> np.ndarray:
    """True angles (T, n_outputs, B) [rad] under logged voltages (T, n_joints, B): no noise, no disturbance.

    `start` holds link angles (n_joints, B) [rad]; without them the machine settles by itself.
    """
    plant.begin(volts.shape[2], len(volts), sample_time, start)
    rotor, links = plant.carry(volts)
    return np.concatenate([rotor, links[:, :1]], axis=1) if link else rotor
