"""Where fits of effects over an angle begin: torques that would explain most of what a fit leaves.

A sine that starts with the wrong period, or a spot at the wrong angle, is in another basin than the right one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from hybrid_id.components.base import Component
from hybrid_id.components.motor.cogging import least_periods
from hybrid_id.diagnosis.response import Response, respond
from hybrid_id.identification.result import FitResult
from hybrid_id.simulation.batch import Batch
from hybrid_id.systems.joint import Joint, Views

PERIODS = (*range(1, 49), 54, 60, 63, 72, 84, 90, 120, 126, 144, 168, 180, 252, 264, 360)
"""Periods a turn of the rotor that a motor's poles and slots may have, common multiples of many poles among them."""
BETWEEN = 13.0
"""Below it what lies between is looked for, too: the gear ratio may be another one, ripples may sit elsewhere."""
GEAR_PERIODS = (0.25, 4.0)
"""Fewest and most periods a turn of the rotor of a gear's error: a shaft behind it turns once in several of its."""
FINEST = 4800
"""Periods over such a range, or below the whole ones of a motor, that are looked at, at most."""
THINNED, SHORTLIST = 4, 90
"""Of many shapes, every so many windows choose so many of them, which are then held against all windows."""
TOGETHER = 32
"""Shapes whose responses are held at once: those of hundreds do not fit the cache."""
ROUNDING = 1e-10
"""Share of a shape's squares beside the model's own parameters, below which these do the same."""
MOST_WAVES = 12.0
"""Waves of friction over the joint's range at most: finer ones are a texture that no record resolves."""
TURNED = 4
"""Most whole waves of friction a turn that are looked for, however many turns a shaft makes."""
SPOTS = 24
"""Places of a tight spot over the joint's range."""
WIDTHS = (0.03, 0.07, 0.15)
"""Its half widths, as shares of the range."""

Shape = Callable[[int, Response], Tensor]
"""A torque by its number within the windows of a response, ``(W, L, m)``."""


@dataclass(frozen=True, eq=False)
class Residual:
    """What a fit leaves, opened for torques at the sides of its joints, each once for all who look there.

    Attributes:
        result: pooled fit.
        batch: its records.
    """

    result: FitResult
    batch: Batch
    _responses: dict[tuple[int, str], Response] = field(default_factory=dict, repr=False)

    def opened(self, joint: int, side: str) -> Response:
        """The probe at one side (``motor`` or ``load``) of a joint, numbered from 1."""
        if (joint, side) not in self._responses:
            fit = self.result
            self._responses[joint, side] = respond(fit.system, fit.engine, self.batch, joint, side)
        return self._responses[joint, side]


def rotor_waves(left: Residual, joint: int, place: str) -> list[tuple[float, ...]]:
    """Torques ``T_c cos(n q) + T_s sin(n q)`` over the rotor's angle that come again, best first: (n, T_c, T_s).

    The phase is that of the measured angle: a simulation that is off by a fraction of a period has lost it.

    Args:
        left: what a fit leaves.
        joint: number, from 1.
        place: where the torque acts.
    """
    opened = left.opened(joint, "motor")
    phase = left.batch.x[..., opened.row]
    least = least_periods(max(float(phase.max() - phase.min()), 1e-3))
    slow = _between(max(GEAR_PERIODS[0], least), BETWEEN, phase)
    periods = sorted({*slow, *(float(n) for n in PERIODS if n >= least)})

    def shape(i: int, of: Response) -> Tensor:
        return _waves(periods[i] * of.within(phase))

    found = _strongest(opened, len(periods), shape) if periods else []
    return [(periods[i], *size) for i, size in _peaks(found)]


def _between(low: float, high: float, angle: Tensor) -> list[float]:
    """Periods a turn from ``low`` to below ``high``, so close that half a wave over an angle's range separates them."""
    step = max(math.pi / max(float(angle.max() - angle.min()), 1e-3), (high - low) / FINEST)
    return np.arange(low, high, step).tolist()


def _peaks(found: Sequence[tuple[int, tuple[float, ...]]]) -> list[tuple[int, tuple[float, ...]]]:
    """Shapes by number, best first, without those beside a better one: its neighbours are its own slopes."""
    kept: list[tuple[int, tuple[float, ...]]] = []
    seen: set[int] = set()
    for i, size in found:
        if not seen & {i - 1, i, i + 1}:
            kept.append((i, size))
        seen.add(i)
    return kept


def friction_waves(left: Residual, joint: int, place: str) -> list[tuple[float, ...]]:
    """Dry friction ``A_c cos(n q) + A_s sin(n q)`` over the joint's angle, best first: (n, A_c, A_s).

    Args:
        left: what a fit leaves.
        joint: number, from 1.
        place: where the friction acts.
    """
    opened, angle, rub = _rubbing(left, joint, place)
    reach = float(angle.max() - angle.min())
    # half a wave over the range is distinguished from its neighbours, and a slope over the range is a quarter of one
    steps = np.arange(1, math.ceil(2 * MOST_WAVES) + 1) * math.pi / max(reach, 1e-3)
    # a joint that turns on and on has whole waves beyond those
    steps = np.array([*steps, *(n for n in range(1, TURNED + 1) if n > steps[-1])])

    def shape(i: int, of: Response) -> Tensor:
        return of.within(rub)[..., None] * _waves(steps[i] * of.within(angle))

    found = _strongest(opened, len(steps), shape)
    return [(float(steps[i]), *size) for i, size in _peaks(found)[:2]]


def friction_spots(left: Residual, joint: int, place: str) -> list[tuple[float, ...]]:
    """Dry friction ``A exp(-((q - q_0) / w)^2)`` over the joint's angle, best first: (q_0, w, A).

    Args:
        left: what a fit leaves.
        joint: number, from 1.
        place: where the friction acts.
    """
    opened, angle, rub = _rubbing(left, joint, place)
    low, high = float(angle.min()), float(angle.max())
    spots = [(q, share * (high - low)) for share in WIDTHS for q in np.linspace(low, high, SPOTS).tolist()]

    def shape(i: int, of: Response) -> Tensor:
        q, w = spots[i]
        return (of.within(rub) * torch.exp(-(((of.within(angle) - q) / w) ** 2)))[..., None]

    found = _strongest(opened, len(spots), shape)
    return [(*spots[i], *size) for i, size in found[:2]]


def gear_waves(left: Residual, joint: int, place: str) -> list[tuple[float, ...]]:
    """Errors ``e(q) = E_c cos(n q) + E_s sin(n q)`` of a gear over the rotor's angle, best first: (n, E_c, E_s).

    To first order, a link of inertia J behind a rigid ``q / r + e(q)`` pulls at the rotor by
    ``-(J / r) (2 e' a + e'' v^2)``. A compliant gear of stiffness k and damping d is wound up by e, which drives the
    link by ``T = k e + d e' v``, and the rotor by ``-T / r - (J / r) e' a``.

    Args:
        left: what a fit leaves.
        joint: number, from 1.
        place: of the gear.
    """
    system = left.result.system
    part = system.joint(joint)
    opened = left.opened(joint, "motor")
    q, v = (left.batch.x[..., opened.row + k] for k in range(2))
    a = torch.gradient(v, dim=1)[0] / left.batch.sample_time
    views = {key: c.view() for key, c in system.components.items() if isinstance(c, Component)}
    key, inertia = part.inertia
    pull = float(inertia.behind_gear(views[key], part.gear_ratio).detach()) / part.gear_ratio
    stiffness = None if part.rigid else _stiffness(part, left.batch.x, views)
    periods = _between(*GEAR_PERIODS, q)

    def error_of(i: int, of: Response) -> tuple[Tensor, Tensor]:
        error = _waves(periods[i] * of.within(q))
        return error, periods[i] * torch.stack([-error[..., 1], error[..., 0]], -1)

    def wound(error: Tensor, slope: Tensor, of: Response) -> Tensor:
        assert stiffness is not None
        k, d = stiffness
        return of.within(k)[..., None] * error + (of.within(d) * of.within(v))[..., None] * slope

    def at_link(i: int, of: Response) -> Tensor:
        return wound(*error_of(i, of), of)

    def at_rotor(i: int, of: Response) -> Tensor:
        error, slope = error_of(i, of)
        pushed = pull * slope * of.within(a)[..., None]
        if stiffness is None:
            return -2.0 * pushed + pull * periods[i] ** 2 * error * of.within(v).square()[..., None]
        return -wound(error, slope, of) / part.gear_ratio - pushed

    beside = None if part.rigid else (left.opened(joint, "load"), at_link)
    return [(periods[i], *size) for i, size in _peaks(_strongest(opened, len(periods), at_rotor, beside))]


def _stiffness(part: Joint, x: Tensor, views: Views) -> tuple[Tensor, Tensor]:
    """Stiffness [N m/rad] and damping [N m s/rad] of a compliant gear at every sample, ``(R, T)`` each."""
    rows = [row.detach().requires_grad_() for row in x.unbind(-1)]
    link = part.positions[1]
    with torch.enable_grad():
        torque = part.spring_torque(rows, views).sum()
    found = torch.autograd.grad(torque, rows[link : link + 2], allow_unused=True, materialize_grads=True)
    return -found[0], -found[1]


def _rubbing(left: Residual, joint: int, place: str) -> tuple[Response, Tensor, Tensor]:
    """A probe where friction acts, the joint's angle there, and the direction against the motion."""
    side = "load" if place == "link_friction" else "motor"
    opened, x = left.opened(joint, side), left.batch.x
    ratio = 1.0 if side == "load" else left.result.system.joint(joint).gear_ratio
    return opened, x[..., opened.row] / ratio, -torch.sign(x[..., opened.row + 1])


def _waves(phase: Tensor) -> Tensor:
    return torch.stack([phase.cos(), phase.sin()], -1)


def _strongest(
    opened: Response, count: int, shape: Shape, beside: tuple[Response, Shape] | None = None
) -> list[tuple[int, tuple[float, ...]]]:
    """Number and coefficients of the shapes that leave least beside the model's own parameters.

    Each acts with its twin at another side of the joint, where ``beside`` holds these. Of very many shapes a part of
    the windows says which are worth all of them.
    """
    numbers = list(range(count))
    if count > SHORTLIST * THINNED:
        twin = None if beside is None else (beside[0].thinned(THINNED), beside[1])
        numbers = sorted(i for i, _ in _ranked(opened.thinned(THINNED), numbers, shape, twin)[:SHORTLIST])
    return _ranked(opened, numbers, shape, beside)


def _ranked(
    opened: Response,
    numbers: Sequence[int],
    shape: Shape,
    beside: tuple[Response, Shape] | None,
) -> list[tuple[int, tuple[float, ...]]]:
    """Some of the shapes by what they leave, least first; all have the same number of columns.

    Squares and products beside the model's own parameters say it all: no shape is ever projected sample by sample.
    """
    own, left = opened.own.flatten(0, 1).numpy(), opened.left.flatten().numpy()
    basis = np.linalg.qr(own / np.maximum(np.linalg.norm(own, axis=0), 1e-300))[0]
    left = left - basis @ (basis.T @ left)
    found = []
    for first in range(0, len(numbers), TOGETHER):
        some = numbers[first : first + TOGETHER]
        moved = opened.chained(torch.cat([shape(i, opened) for i in some], -1))
        if beside is not None:
            other, twin = beside
            moved = moved + other.chained(torch.cat([twin(i, other) for i in some], -1))
        # by how much each of some shapes lessens the squares of what is left, and its coefficients: (k,), (k, m)
        columns = moved.flatten(0, 1).numpy()
        shapes = len(some)
        each = shapes, columns.shape[1] // shapes
        slopes, inside = (left @ columns).reshape(each), (basis.T @ columns).reshape(-1, *each)
        columns = columns.reshape(-1, *each)
        squares = np.empty((*each, each[1]))
        for i, j in np.ndindex(squares.shape[1:]):
            squares[:, i, j] = np.einsum("nk,nk->k", columns[..., i], columns[..., j])
        unit = 1.0 / np.sqrt(np.maximum(np.diagonal(squares, axis1=1, axis2=2), 1e-300))
        squares -= np.einsum("pki,pkj->kij", inside, inside)
        # what the model's own parameters do as well leaves rounding alone, and explains nothing
        share, axes = np.linalg.eigh(squares * unit[:, :, None] * unit[:, None])
        along = np.einsum("kij,ki->kj", axes, slopes * unit)
        along = np.where(share > ROUNDING, along / np.maximum(share, ROUNDING), 0.0)
        amplitude = np.einsum("kij,kj->ki", axes, along) * unit
        found.append(((slopes * amplitude).sum(1), amplitude))
    gain, size = (np.concatenate(part) for part in zip(*found, strict=True))
    return [(numbers[k], tuple(size[k].tolist())) for k in np.argsort(-gain, kind="stable")]
