"""Where the gap lies: at which joint, on which side, and on what the missing torque depends.

A torque of arbitrary shape in time has no signal and needs no catalogue: it says where something unknown acts. One
torque has to explain the outputs of all joints at once, so that the right joint of an arm explains more than
another; so does the right side of a compliant gear, by less.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.signal import bilinear, lfilter
from torch import Tensor

from hybrid_id.diagnosis.criteria import CRITERIA
from hybrid_id.diagnosis.fits import Fits
from hybrid_id.diagnosis.model import FittedModel
from hybrid_id.diagnosis.response import Response, bumps, respond

SPEEDS, ANGLES, COMMANDS = 9, 10, 9
MEMORY = (0.02, 0.2)
"""Time constants [s] over which the motion before an instant still acts."""
WEAR = 6
"""Bumps over the time since a record began: friction that wears in or grows."""
SWINGS, DAMPING = (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 6.0), 0.08
"""Frequencies [Hz] and damping ratio of what may swing on the moving part."""
TURNS = (1, 2, 3, 4, 6)
"""Periods a turn of the rotor in which a motor may pass the command on unevenly."""
KNOT = 0.05
"""Time [s] over which the torque is smooth."""

HISTORY = "motion history"
"""What a torque depends on that does not follow from the angle and the speed of an instant."""
IN_WORDS = {
    "angle, opposite to the velocity": "more friction at some angles than at others",
    "command rate": "a torque that follows the changes of the command",
    "command, opposite to the velocity": "friction that grows with the command",
    HISTORY: "a torque that depends on the motion just before, as that of play, hysteresis or a delay does",
    "a resonance": "a torque that swings on after the motion, as that of a mass on a spring does",
    "time, opposite to the velocity": "more friction at some times of a record than at others",
    "command over the turn": "a torque that goes with the command and changes over the rotor's turn",
}
"""What a dependence means, for signals whose name does not say it."""


@dataclass(frozen=True, eq=False)
class Location:
    """A torque that is missing at one side of a joint, as a function of one signal.

    Attributes:
        joint: ``joint1`` ...
        side: ``motor`` or ``load``: the side of the gear; ``joint`` where both move alike.
        signal: what it depends on, in words.
        share: part of the gap's mean square that it explains on records left out.
        grid: the signal's values, ``(k,)``; empty where the dependence has no single signal.
        torque: the torque there [N m], ``(k,)``.
    """

    joint: str
    side: str
    signal: str
    share: float
    grid: np.ndarray
    torque: np.ndarray


def locate(fits: Fits, model: FittedModel) -> list[Location]:
    """Torques that would explain what a fitted model leaves, best first.

    Args:
        fits: holds the train records.
        model: the fitted model.
    """
    batch = fits.records(model.system)
    found = []
    for joint in model.system.joints:
        for side in ("motor",) if joint.rigid else ("motor", "load"):
            opened = respond(model.system, model.result.engine, batch, joint.number, side)
            for signal, waves, axis in signals(opened):
                share, coefficients = opened.explained(waves)
                if axis is None:
                    grid, torque = np.empty(0), np.empty(0)
                else:
                    low, high, count = axis
                    grid = np.linspace(low, high, 41)
                    shape = bumps(torch.tensor(grid), count, low, high).numpy()
                    torque = shape @ coefficients[:count]
                    if len(coefficients) > count:  # the dry part of the speed's family
                        torque = torque + coefficients[count] * np.sign(grid)
                where = "joint" if joint.rigid else side
                found.append(Location(joint.name, where, signal, share, grid, torque))
    return sorted(found, key=lambda one: -one.share)


def signals(opened: Response) -> Iterator[tuple[str, Tensor, tuple[float, float, int] | None]]:
    """Families of basis functions: what they depend on in words, ``(R, T, m)``, and the axis of a profile."""
    row = opened.row
    q, v = opened.batch.x[..., row], opened.batch.x[..., row + 1]
    valid = (opened.batch.weight > 0).any(2)
    sign = torch.tanh(v / (0.002 * float(v[valid].abs().max()) + 1e-12))
    top = float(v[valid].abs().quantile(0.98)) if valid.sum() < 2**24 else float(v[valid].abs().max())
    low, high = float(q[valid].min()), float(q[valid].max())
    yield "speed", torch.cat([bumps(v, SPEEDS, -top, top), sign[..., None]], -1), (-top, top, SPEEDS)
    yield "angle", bumps(q, ANGLES, low, high), (low, high, ANGLES)
    yield "angle, opposite to the velocity", bumps(q, ANGLES, low, high) * sign[..., None], None
    name = next(
        (n for n in opened.batch.u if n in [f"{stem}{opened.joint}" for stem in ("u", "duty", "tau", "i")]),
        None,
    )
    if name is not None:
        u = opened.batch.u[name]
        most = float(u[valid].abs().max())
        yield "command", bumps(u, COMMANDS, -most, most), (-most, most, COMMANDS)
        yield (
            "command rate",
            torch.stack([u - torch.cat([u[:, :1].expand(-1, k), u[:, :-k]], 1) for k in (1, 2, 4, 8)], -1),
            None,
        )
        yield (
            "command, opposite to the velocity",
            torch.stack([u.abs() * sign, u * sign * sign, u * u.abs()], -1),
            None,
        )
        if opened.side == "motor":
            turn = q[..., None] * torch.tensor(TURNS, dtype=q.dtype)
            yield "command over the turn", u[..., None] * torch.cat([turn.cos(), turn.sin()], -1), None
    # direction and speed less what they were on average of late
    step = opened.batch.sample_time
    found = []
    for constant in MEMORY:
        keep = float(np.exp(-step / constant))
        for signal in (sign, v):
            slow = lfilter([1 - keep], [1, -keep], signal.numpy(), axis=1)
            found.append(signal - torch.tensor(slow))
    yield HISTORY, torch.stack(found, -1), None
    time = torch.cumsum(opened.batch.dt, 1)
    wear = bumps(time, WEAR, 0.0, float(time.max())) * sign[..., None]
    yield "time, opposite to the velocity", wear, None
    # what masses on springs would pull, which the motion shakes: deflection and rate of each, of unit size
    width = opened.batch.sample_time
    acceleration, wave = np.gradient(v.numpy(), width, axis=1), []
    for frequency in SWINGS:
        w = 2.0 * np.pi * frequency
        for numerator in ([w * w], [w, 0.0]):
            b, a = bilinear(numerator, [1.0, 2.0 * DAMPING * w, w * w], 1.0 / width)
            swing = np.asarray(lfilter(b, a, acceleration, axis=1))
            wave.append(torch.tensor(swing / max(float(np.std(swing)), 1e-300)))
    yield "a resonance", torch.stack(wave, -1), None


@dataclass(frozen=True)
class Disturbance:
    """How much of what a model leaves a torque of arbitrary shape in time could explain at one side of a joint.

    Attributes:
        joint: ``joint1`` ...
        side: ``motor`` or ``load``: the side of the gear; ``joint`` where both move alike, or one is not measured.
        share: part of the mean square within a short window, averaged over these, less what chance would explain.
        behind: by how many standard errors it leaves more than the best place does; 0 for that.
    """

    joint: str
    side: str
    share: float
    behind: float


def disturbances(fits: Fits, model: FittedModel) -> list[Disturbance]:
    """Every side of every joint, the best first.

    Args:
        fits: holds the train records.
        model: the fitted model.
    """
    batch, engine = fits.records(model.system), model.result.engine
    left: dict[tuple[str, str], np.ndarray] = {}
    for joint in model.system.joints:
        sides = {}
        for side in ("motor",) if joint.rigid else ("motor", "load"):
            rest, whole = respond(model.system, engine, batch, joint.number, side).unexplained(KNOT)
            # windows count alike: one in which a joint sticks otherwise than it was linearised would drown the rest
            # a window that the linearisation has lost says nothing for either side
            lost = ~np.isfinite(rest) | ~np.isfinite(whole)
            rest, whole = np.where(lost, 1.0, rest), np.where(lost, 1.0, whole)
            sides["joint" if joint.rigid else side] = rest / np.maximum(whole, 1e-300)
        if not {f"q_m{joint.number}", f"q_a{joint.number}"} <= set(batch.outputs):
            sides = {"joint": min(sides.values(), key=np.mean)}  # one encoder identifies no side
        left |= {(joint.name, side): rest for side, rest in sides.items()}
    least = min(left.values(), key=np.mean)
    found = []
    for place, rest in left.items():
        # what is left in a window beyond the least, relative to both
        surplus = (rest - least) / np.maximum(rest + least, 1e-300)
        spread = float(surplus.std()) / np.sqrt(len(surplus))
        behind = float(surplus.mean()) / spread if spread > 0 else 0.0
        found.append(Disturbance(*place, 1.0 - float(rest.mean()), behind))
    return sorted(found, key=lambda one: -one.share)


def acts_at(found: Sequence[Disturbance]) -> tuple[str | None, str | None]:
    """Joint and side at which something acts, each None where another explains nearly as much."""
    if not found or found[0].share <= 0.0:
        return None, None
    best, others = found[0], found[1:]
    if any(one.joint != best.joint and one.behind < CRITERIA.place_z for one in others):
        return None, None
    sure = best.side != "joint" and all(
        one.behind >= CRITERIA.place_z for one in others if one.joint == best.joint
    )
    return best.joint, best.side if sure else None
