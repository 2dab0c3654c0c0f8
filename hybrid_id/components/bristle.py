"""Friction with memory, and how a state that remembers is stepped."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace

import torch
from torch import Tensor

from hybrid_id.components.base import Effect, Friction
from hybrid_id.components.site import Site, free
from hybrid_id.parameters import Bounded

BEARING = 0.02
"""Turn of a rotor before its bearings slide [rad]: about a degree."""


class Bristle(Friction):
    """A friction with memory: it turns the dry interval of its speed into the deflection of a bristle.

    Its states replace the projection: the dry laws on the same speed tell the steady-state level.
    """

    states = ("bristle",)
    left_out = "has a bristle that is left out, its friction is dry there"
    effect = Effect(
        "presliding_friction",
        "contacts that give like a spring before they slide; usually within a degree of the rotor",
        "C. Canudas de Wit, H. Olsson, K. J. Astrom, P. Lischinsky, A new model for control of systems with friction, "
        "IEEE Trans. Automatic Control 40(3), 1995",
        {
            "backlash": "small reversals from rest of growing size: a bristle resists at once and springs back, play "
            "does neither",
            "joint_flexibility": "the same sweep from small amplitudes to large ones: a bristle gives way at "
            "breakaway, the spring of a gear stays",
        },
        smoothness="kinks at reversals",
    )

    def state_updates(
        self, p: SimpleNamespace, states: Sequence[Tensor], speed: Tensor, level: Tensor
    ) -> list[tuple[Tensor, Tensor]]:
        """Drive and rate [1/s] of each state, ``dz/dt = drive - rate z``, ``(B,)`` each.

        It is stepped exactly at constant drive and rate, which is stable however stiff the bristle.
        """
        raise NotImplementedError

    def torque(self, p: SimpleNamespace, states: Sequence[Tensor], speed: Tensor, level: Tensor) -> Tensor:
        """Friction torque [N m], ``(B,)``."""
        raise NotImplementedError


def stiffnesses(site: Site) -> list[Bounded]:
    """Start values of a bristle's stiffness [N m/rad]; none where no dry friction gives its level."""
    if not any(law.has_level for law in site.frictions):
        return []
    ways = [0.001 * site.turns, 0.01 * site.turns]
    if ways[0] > 5.0 * BEARING:
        ways.insert(0, BEARING)
    sizes = (site.dry * site.gearing**2 / way for way in ways)
    return [free(size, 0.02 * size, 50.0 * size) for size in sizes]


def relax(state: Tensor, drive: Tensor, rate: Tensor, step: Tensor) -> Tensor:
    """Exact solution of ``dz/dt = drive - rate z`` after ``step`` at constant drive and rate [1/s] >= 0."""
    decay = rate * step
    above = decay.clamp_min(1e-12)  # the limit of (1 - exp(-a)) / a at 0, without a branch
    return state * torch.exp(-decay) - drive * step * torch.expm1(-above) / above
