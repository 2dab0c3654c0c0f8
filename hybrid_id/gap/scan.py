"""Where fits of effects over an angle begin: torques that would explain most of what a fit leaves.

A sine that starts with the wrong period, or a spot at the wrong angle, is in another valley than the right one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from hybrid_id.components.base import Component
from hybrid_id.gap.probe import Probe, probe
from hybrid_id.identification.result import FitResult
from hybrid_id.parameters import Bounded
from hybrid_id.simulation.batch import Batch

PERIODS = range(1, 49)
"""Periods a turn of the rotor that a motor's poles and slots may have."""
GEAR_PERIODS = (0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0)
"""Periods a turn of the rotor that errors of a gear may have: a shaft behind it turns once in several turns of its."""
MOST_WAVES = 12.0
"""Waves of friction over the joint's range at most: finer ones are a texture that no record resolves."""
SPOTS = 24
"""Places of a tight spot over the joint's range."""
WIDTHS = (0.03, 0.07, 0.15)
"""Its half widths, as shares of the range."""


@dataclass(frozen=True, eq=False)
class Left:
    """What a fit leaves, opened for torques at the sides of its joints, each once for all who look there.

    Attributes:
        result: pooled fit.
        batch: its records.
    """

    result: FitResult
    batch: Batch
    _probes: dict[tuple[int, str], Probe] = field(default_factory=dict, repr=False)

    def opened(self, joint: int, side: str) -> Probe:
        """The probe at one side (``motor`` or ``load``) of a joint, numbered from 1."""
        if (joint, side) not in self._probes:
            fit = self.result
            self._probes[joint, side] = probe(fit.system, fit.engine, self.batch, joint, side)
        return self._probes[joint, side]


def rotor_waves(left: Left, joint: int, place: str) -> list[tuple[float, ...]]:
    """Torques ``T_c cos(n q) + T_s sin(n q)`` over the rotor's angle, best first: (n, T_c, T_s).

    The phase is that of the measured angle: a simulation that is off by a fraction of a period has lost it.

    Args:
        left: what a fit leaves.
        joint: number, from 1.
        place: where the torque acts.
    """
    opened = left.opened(joint, "motor")
    phase = left.batch.x[..., opened.row]
    found = _strongest(opened, [_waves(n * phase) for n in PERIODS])
    return [(float(PERIODS[i]), *size) for i, size in found[:2]]


def second_wave(
    waves: Callable[[Left, int, str], list[tuple[float, ...]]], symbols: tuple[str, str], most: float
) -> Callable[[Component, Left, int, str], list[dict[str, float | Bounded]]]:
    """A further wave beside one that a component has: the strongest of another period.

    Args:
        waves: looks for waves, best first.
        symbols: of its cosine and sine.
        most: largest amplitude, over the first wave's.
    """

    def start(part: Component, left: Left, joint: int, place: str) -> list[dict[str, float | Bounded]]:
        if part.specs[symbols[0]].estimate:
            return []
        own = part.specs["n"].value
        first = max(math.hypot(*(part.specs[symbol[:-1]].value for symbol in symbols)), 1e-12)
        others = [(n, size) for n, *size in waves(left, joint, place) if n != own]
        return [
            {"n_2": n} | {s: Bounded(min(max(x, -most * first), most * first), -most * first, most * first)
                          for s, x in zip(symbols, size, strict=True)}
            for n, size in others[:1]
        ]  # fmt: skip

    return start


def friction_waves(left: Left, joint: int, place: str) -> list[tuple[float, ...]]:
    """Dry friction ``A_c cos(n q) + A_s sin(n q)`` over the joint's angle, best first: (n, A_c, A_s).

    Args:
        left: what a fit leaves.
        joint: number, from 1.
        place: where the friction acts.
    """
    opened, angle, rub = _rubbing(left, joint, place)
    reach = float(angle.max() - angle.min())
    # half a wave over the range is told from its neighbours, and a slope over the range is a quarter of one
    steps = np.arange(1, math.ceil(2 * MOST_WAVES) + 1) * math.pi / max(reach, 1e-3)
    found = _strongest(opened, [rub[..., None] * _waves(n * angle) for n in steps])
    return [(float(steps[i]), *size) for i, size in found[:2]]


def friction_spots(left: Left, joint: int, place: str) -> list[tuple[float, ...]]:
    """Dry friction ``A exp(-((q - q_0) / w)^2)`` over the joint's angle, best first: (q_0, w, A).

    Args:
        left: what a fit leaves.
        joint: number, from 1.
        place: where the friction acts.
    """
    opened, angle, rub = _rubbing(left, joint, place)
    low, high = float(angle.min()), float(angle.max())
    spots = [(q, share * (high - low)) for share in WIDTHS for q in np.linspace(low, high, SPOTS).tolist()]
    found = _strongest(opened, [(rub * torch.exp(-(((angle - q) / w) ** 2)))[..., None] for q, w in spots])
    return [(*spots[i], *size) for i, size in found[:2]]


def gear_waves(left: Left, joint: int, place: str) -> list[tuple[float, ...]]:
    """Errors ``E_c cos(n q) + E_s sin(n q)`` of a rigid gear over the rotor's angle, best first: (n, E_c, E_s).

    A link of inertia J behind ``q / r + e(q)`` pulls at the rotor by ``-(J / r) (2 e' a + e'' v^2)``, to first order.

    Args:
        left: what a fit leaves.
        joint: number, from 1.
        place: of the gear.
    """
    system, batch = left.result.system, left.batch
    part = system.joints[joint - 1]
    if not part.rigid:
        return []
    opened = left.opened(joint, "motor")
    q, v = batch.x[..., opened.row], batch.x[..., opened.row + 1]
    a = torch.gradient(v, dim=1)[0] / batch.step
    key, inertia = part.inertia
    view = system.components[key].view()  # type: ignore[operator]
    pull = -float(inertia.link(view, part.gear_ratio).detach()) / part.gear_ratio
    shapes = []
    for n in GEAR_PERIODS:
        first = torch.stack([-n * (n * q).sin(), n * (n * q).cos()], -1)
        shapes.append(pull * (2.0 * first * a[..., None] - n**2 * _waves(n * q) * v.square()[..., None]))
    return [(GEAR_PERIODS[i], *size) for i, size in _strongest(opened, shapes)[:2]]


def _rubbing(left: Left, joint: int, place: str) -> tuple[Probe, Tensor, Tensor]:
    """A probe where friction acts, the joint's angle there, and the direction against the motion."""
    side = "load" if place == "link_friction" else "motor"
    opened, x = left.opened(joint, side), left.batch.x
    ratio = 1.0 if side == "load" else left.result.system.joints[joint - 1].gear_ratio
    return opened, x[..., opened.row] / ratio, -torch.sign(x[..., opened.row + 1])


def _waves(phase: Tensor) -> Tensor:
    return torch.stack([phase.cos(), phase.sin()], -1)


def _strongest(opened: Probe, shapes: Sequence[Tensor]) -> list[tuple[int, tuple[float, ...]]]:
    """Number and coefficients of the shapes ``(R, T, m)`` that leave least beside the model's own parameters."""
    own, left = opened.own.flatten(0, 1).numpy(), opened.left.flatten().numpy()
    response = opened.response(torch.cat(list(shapes), -1)).flatten(0, 1).numpy()
    basis = np.linalg.qr(own / np.maximum(np.linalg.norm(own, axis=0), 1e-300))[0]
    response, left = response - basis @ (basis.T @ response), left - basis @ (basis.T @ left)
    found, first = [], 0
    for i, shape in enumerate(shapes):
        columns = response[:, first : first + shape.shape[-1]]
        first += shape.shape[-1]
        size = np.linalg.lstsq(columns, left, rcond=1e-8)[0]
        found.append((float(np.square(left - columns @ size).sum()), i, tuple(size.tolist())))
    return [(i, size) for _, i, size in sorted(found)]
