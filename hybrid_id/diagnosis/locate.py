"""Where the gap lies: at which joint, on which side, and on what the missing torque depends."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from scipy.signal import bilinear, lfilter
from torch import Tensor

from hybrid_id.diagnosis.explanation import Explanation
from hybrid_id.diagnosis.probe import Probe, bumps, probe
from hybrid_id.diagnosis.refit import Refit

SPEEDS, ANGLES, COMMANDS = 9, 10, 9
MEMORY = (0.02, 0.2)
"""Time constants [s] of what remembers the motion."""
WEAR = 6
"""Bumps over the time since a record began: friction that wears in or grows."""
SWINGS, DAMPING = (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 6.0), 0.08
"""Frequencies [Hz] and damping ratio of what may swing on the moving part."""
TURNS = (1, 2, 3, 4, 6)
"""Periods a turn of the rotor in which a motor may pass the command on unevenly."""

IN_WORDS = {
    "angle, against the motion": "it brakes more at some angles than at others",
    "change of the command": "it follows the changes of the command",
    "command, against the motion": "it opposes the motion and goes with the command",
    "what the motion was": "it remembers the motion, as a delay or a hysteresis does",
    "what swings on it": "it swings after the motion, as a mass on a spring does",
    "time, against the motion": "it brakes more at some times of a record than at others",
    "command over the turn": "it goes with the command and changes over the rotor's turn",
}
"""What a dependence means, for signals whose name does not say it."""


@dataclass(frozen=True, eq=False)
class Location:
    """A torque that is missing at one side of a joint, as a function of one signal.

    Attributes:
        joint: ``joint1`` ...
        place: ``motor`` or ``load``: the side of the gear; ``joint`` where both move alike.
        signal: what it depends on, in words.
        share: part of the gap's mean square that it explains on records left out.
        grid: the signal's values, ``(k,)``; empty where the dependence has no single signal.
        torque: the torque there [N m], ``(k,)``.
    """

    joint: str
    place: str
    signal: str
    share: float
    grid: np.ndarray
    torque: np.ndarray


def locate(refit: Refit, explanation: Explanation) -> list[Location]:
    """Torques that would explain what a fitted model leaves, best first.

    Args:
        refit: holds the train records.
        explanation: the fitted model.
    """
    batch = refit.records(explanation.system)
    found = []
    for joint in explanation.system.joints:
        for side in ("motor",) if joint.rigid else ("motor", "load"):
            opened = probe(explanation.system, explanation.result.engine, batch, joint.number, side)
            for signal, waves, axis in signals(opened):
                share, coefficients = opened.explained(waves)
                grid, torque = _profile(axis, coefficients)
                place = "joint" if joint.rigid else side
                found.append(Location(joint.name, place, signal, share, grid, torque))
    return sorted(found, key=lambda one: -one.share)


def signals(opened: Probe) -> Iterator[tuple[str, Tensor, tuple[float, float, int] | None]]:
    """Families of basis functions: what they depend on in words, ``(R, T, m)``, and the axis of a profile."""
    row = opened.row
    q, v = opened.batch.x[..., row], opened.batch.x[..., row + 1]
    valid = (opened.batch.weight > 0).any(2)
    sign = torch.tanh(v / (0.002 * float(v[valid].abs().max()) + 1e-12))
    top = float(v[valid].abs().quantile(0.98)) if valid.sum() < 2**24 else float(v[valid].abs().max())
    low, high = float(q[valid].min()), float(q[valid].max())
    yield "speed", torch.cat([bumps(v, SPEEDS, -top, top), sign[..., None]], -1), (-top, top, SPEEDS)
    yield "angle", bumps(q, ANGLES, low, high), (low, high, ANGLES)
    yield "angle, against the motion", bumps(q, ANGLES, low, high) * sign[..., None], None
    name = next(
        (n for n in opened.batch.u if n[:-1] in ("u", "duty", "tau", "i") and n[-1] == str(opened.joint)),
        None,
    )
    if name is not None:
        u = opened.batch.u[name]
        most = float(u[valid].abs().max())
        yield "command", bumps(u, COMMANDS, -most, most), (-most, most, COMMANDS)
        yield "change of the command", torch.stack([u - _late(u, k) for k in (1, 2, 4, 8)], -1), None
        yield (
            "command, against the motion",
            torch.stack([u.abs() * sign, u * sign * sign, u * u.abs()], -1),
            None,
        )
        if opened.side == "motor":
            turn = q[..., None] * torch.tensor(TURNS, dtype=q.dtype)
            yield "command over the turn", u[..., None] * torch.cat([turn.cos(), turn.sin()], -1), None
    yield "what the motion was", _remembered(opened, v, sign), None
    time = torch.cumsum(opened.batch.dt, 1)
    wear = bumps(time, WEAR, 0.0, float(time.max())) * sign[..., None]
    yield "time, against the motion", wear, None
    yield "what swings on it", _swinging(opened, v), None


def _late(signal: Tensor, samples: int) -> Tensor:
    return torch.cat([signal[:, :1].expand(-1, samples), signal[:, :-samples]], 1)


def _remembered(opened: Probe, v: Tensor, sign: Tensor) -> Tensor:
    """Direction and speed less what they were on average of late."""
    step = opened.batch.step
    found = []
    for constant in MEMORY:
        keep = float(np.exp(-step / constant))
        for signal in (sign, v):
            slow = lfilter([1 - keep], [1, -keep], signal.numpy(), axis=1)
            found.append(signal - torch.tensor(slow))
    return torch.stack(found, -1)


def _swinging(opened: Probe, v: Tensor) -> Tensor:
    """What masses on springs would pull, which the motion shakes: deflection and rate of each, of unit size."""
    step = opened.batch.step
    acceleration, found = np.gradient(v.numpy(), step, axis=1), []
    for frequency in SWINGS:
        w = 2.0 * np.pi * frequency
        for numerator in ([w * w], [w, 0.0]):
            b, a = bilinear(numerator, [1.0, 2.0 * DAMPING * w, w * w], 1.0 / step)
            swing = np.asarray(lfilter(b, a, acceleration, axis=1))
            found.append(torch.tensor(swing / max(float(np.std(swing)), 1e-300)))
    return torch.stack(found, -1)


def _profile(
    axis: tuple[float, float, int] | None, coefficients: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    if axis is None:
        return np.empty(0), np.empty(0)
    low, high, count = axis
    grid = np.linspace(low, high, 41)
    shape = bumps(torch.tensor(grid), count, low, high).numpy()
    torque = shape @ coefficients[:count]
    if len(coefficients) > count:  # the dry part of the speed's family
        torque = torque + coefficients[count] * np.sign(grid)
    return grid, torque
