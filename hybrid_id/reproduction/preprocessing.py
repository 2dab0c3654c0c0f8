"""The paper's preprocessing of one record (section II.E, Fig. 3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hybrid_id.records.derivatives import differentiate
from hybrid_id.records.record import Record


@dataclass(frozen=True, eq=False)
class Preprocessed:
    """Voltage, and the motor's motion raw and from the Fourier transform, ``(T,)`` each.

    Attributes:
        time: [s].
        voltage: [V].
        angle: as the encoder read it [rad].
        smooth_angle: what the band keeps of it [rad].
        difference: its samples' differences over the sample time [rad/s].
        speed: j omega times its spectrum [rad/s].
        band: frequencies that are kept [Hz].
    """

    time: np.ndarray
    voltage: np.ndarray
    angle: np.ndarray
    smooth_angle: np.ndarray
    difference: np.ndarray
    speed: np.ndarray
    band: tuple[float, float]


def preprocess(record: Record) -> Preprocessed:
    """Drop the frequencies in the noise, and differentiate in the frequency domain."""
    angle = record.outputs["q_m1"]
    found = differentiate(angle, record.sample_time)
    return Preprocessed(
        record.time, record.inputs["u1"], angle, found.position, np.gradient(angle, record.sample_time),
        found.velocity, found.band,
    )  # fmt: skip
