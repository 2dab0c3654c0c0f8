"""Desired motions of the joints, with their derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybrid_id.errors import InputError


@dataclass(frozen=True, eq=False)
class Reference:
    """Desired motion at the links.

    Attributes:
        time: uniform time stamps [s], ``(T,)``.
        angle: joint angles [rad], ``(T, n_joints)``.
        speed: their rates [rad/s].
        acceleration: theirs [rad/s^2].
    """

    time: np.ndarray
    angle: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray

    @property
    def sample_time(self) -> float:
        """Step of the time stamps [s]."""
        return float(self.time[1] - self.time[0])


def sines(
    joints: Sequence[Sequence[tuple[float, float]]], *, duration: float, sample_time: float, fade: float = 1.0
) -> Reference:
    """Sums of sines that set in smoothly from rest at zero.

    Args:
        joints: for each joint its sines, each (amplitude [rad], frequency [Hz]).
        duration: length [s].
        sample_time: step [s].
        fade: time over which the motion sets in [s]; angle, speed and acceleration start at zero.

    Raises:
        InputError: no joint, or a duration shorter than ten samples.
    """
    if not joints or not duration > 10 * sample_time:
        raise InputError("A reference needs at least one joint and a duration of more than ten samples.")
    time = sample_time * np.arange(round(duration / sample_time))
    s = np.clip(time / fade, 0.0, 1.0)
    # smoothest polynomial with three derivatives zero at both ends
    rise = np.array([s**4 * (35 - 84 * s + 70 * s**2 - 20 * s**3)])
    rise = np.vstack(
        [rise, 140 * s**3 * (1 - s) ** 3 / fade, 420 * s**2 * (1 - s) ** 2 * (1 - 2 * s) / fade**2]
    )
    motions = []
    for parts in joints:
        wave = np.zeros((3, len(time)))
        for amplitude, frequency in parts:
            w = 2 * np.pi * frequency
            sine, cosine = amplitude * np.sin(w * time), amplitude * w * np.cos(w * time)
            wave += np.stack([sine, cosine, -(w**2) * sine])
        motions.append(
            np.stack(
                [
                    rise[0] * wave[0],
                    rise[1] * wave[0] + rise[0] * wave[1],
                    rise[2] * wave[0] + 2 * rise[1] * wave[1] + rise[0] * wave[2],
                ]
            )
        )
    angle, speed, acceleration = np.stack(motions, axis=2)
    return Reference(time, angle, speed, acceleration)
