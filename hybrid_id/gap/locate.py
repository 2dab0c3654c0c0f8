"""Where the gap lies: at which joint, on which side, and on what the missing torque depends."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from scipy.signal import lfilter
from torch import Tensor

from hybrid_id.gap.probe import Probe, bumps, probe
from hybrid_id.gap.refit import Explanation, Refit

SPEEDS, ANGLES, COMMANDS = 9, 10, 9
MEMORY = (0.02, 0.2)
"""Time constants [s] of what remembers the motion."""


@dataclass(frozen=True, eq=False)
class Location:
    """A torque that is missing at one side of a joint, as a function of one signal.

    Attributes:
        joint: ``joint1`` ...
        place: ``motor`` or ``load``: the side of the gear.
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
                found.append(Location(joint.name, side, signal, share, grid, torque))
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
    yield "what the motion was", _remembered(opened, v, sign), None


def _late(signal: Tensor, samples: int) -> Tensor:
    return torch.cat([signal[:, :1].expand(-1, samples), signal[:, :-samples]], 1)


def _remembered(opened: Probe, v: Tensor, sign: Tensor) -> Tensor:
    """Low-passed direction and speed, and the angle since the last reversal."""
    step = float(opened.batch.dt[opened.batch.dt > 0].median())
    found = []
    for constant in MEMORY:
        keep = float(np.exp(-step / constant))
        for signal in (sign, v):
            slow = lfilter([1 - keep], [1, -keep], signal.numpy(), axis=1)
            found.append(signal - torch.tensor(slow))
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
