"""Curves of the paper's figures: friction over velocity (Figs 13, 14), and a record's preprocessing (II.E, Fig. 3)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hybrid_id.machines.physics.friction import AsymmetricStribeck
from hybrid_id.records.derivatives import differentiate
from hybrid_id.records.record import Record
from hybrid_id.reproduction.result import StageResult

LEVELS = ("f_11", "f_12", "f_13", "f_14", "f_21", "f_22", "f_23", "f_24")


@dataclass(frozen=True, eq=False)
class Curve:
    """Friction torque of one motor: eq. (15)-(16) with a stage's estimate and with its run's truth.

    Attributes:
        label: what it is of.
        speed: motor speed [rad/s], ``(T,)``.
        torque: estimated [N m].
        truth: true [N m].
    """

    label: str
    speed: np.ndarray
    torque: np.ndarray
    truth: np.ndarray


def friction_curve(
    label: str, result: StageResult, truth: Mapping[str, float], *, motor: str = "", top: float = 300.0
) -> Curve:
    """The friction of a motor over its speed.

    Args:
        label: what it is of.
        result: the stage.
        truth: the twin's parameters, for what the stage's runs do not tell (held ones).
        motor: what the motor's parameters end in.
        top: largest speed [rad/s].
    """
    found = dict(zip(result.names, result.values[result.selected], strict=True))
    own = dict(zip(result.names, result.truths[result.selected], strict=True))
    speed = np.concatenate([np.linspace(-top, -1e-6, 400), np.linspace(1e-6, top, 400)])
    curves = []
    for values in ({**result.held, **found}, {**truth, **own}):
        dry = AsymmetricStribeck(**{name: values[name + motor] for name in LEVELS})
        forwards, backwards = dry.levels(speed)
        curves.append(np.where(speed > 0, forwards, -backwards) + values[f"f_3{motor}"] * speed)
    return Curve(label, speed, *curves)


def link_friction_curve(result: StageResult) -> Curve:
    """Friction at the link, eq. (9), over its speed."""
    speed = np.linspace(-0.15, 0.15, 801)
    curves = []
    for table in (result.values, result.truths):
        values = dict(zip(result.names, table[result.selected], strict=True))
        curves.append(np.where(speed > 0, values["f_a1"], values["f_a2"]) * np.tanh(70 * speed))
    return Curve("at the link", speed, *curves)


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
