"""A controller and a machine in a loop at a sample time, for many variants side by side."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from hybrid_id.control.computed_torque import ComputedTorque
from hybrid_id.control.reference import Reference


class Plant(Protocol):
    """A machine that is driven sample by sample; B of them side by side."""

    def measure(self) -> np.ndarray:
        """Motor angles as the encoders read them [rad], ``(n_joints, B)``."""
        ...

    def true_angles(self) -> np.ndarray:
        """Joint angles at the links as they are [rad], ``(n_joints, B)``."""
        ...

    def step(self, command: np.ndarray) -> None:
        """Hold commands, ``(n_joints, B)``, for one sample."""
        ...


@dataclass(frozen=True, eq=False)
class Tracking:
    """What came of following a reference.

    Attributes:
        reference: the desired motion.
        angle: joint angles at the links [rad], ``(T, n_joints, B)``.
        command: voltages, currents or torques as commanded [V, A or N m], ``(T, n_joints, B)``.
    """

    reference: Reference
    angle: np.ndarray
    command: np.ndarray

    @property
    def error(self) -> np.ndarray:
        """Desired less true joint angle [rad], ``(T, n_joints, B)``."""
        return self.reference.angle[..., None] - self.angle

    @property
    def rms(self) -> np.ndarray:
        """Root mean square of the error [rad], ``(n_joints, B)``."""
        return np.sqrt(np.mean(self.error**2, axis=0))

    @property
    def peak(self) -> np.ndarray:
        """Largest error [rad], ``(n_joints, B)``."""
        return np.abs(self.error).max(axis=0)


def track(
    controller: ComputedTorque, plant: Plant, reference: Reference, *, cutoff: float = 20.0
) -> Tracking:
    """Follow a reference.

    Args:
        controller: made for this reference.
        plant: starts at rest where the reference starts.
        reference: desired motion.
        cutoff: of the filter that differentiates the encoder's angle [Hz]; it sees the deviation from the planned
            motion only, so that the planned speed comes without its lag.
    """
    step = reference.sample_time
    keep = np.exp(-2 * np.pi * cutoff * step)
    last = plant.measure() - controller.planned(0)[0]
    drift = np.zeros_like(last)
    angles, commands = [], []
    for k in range(len(reference.time)):
        angles.append(plant.true_angles())
        measured = plant.measure()
        angle, speed = controller.planned(k)
        drift = keep * drift + (1.0 - keep) * (measured - angle - last) / step
        last = measured - angle
        commands.append(controller.command(k, measured, speed + drift))
        plant.step(commands[-1])
    return Tracking(reference, np.stack(angles), np.stack(commands))
