"""Friction with memory, and how a state that remembers is stepped."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace

import torch
from torch import Tensor

from hybrid_id.components.base import Friction


class Bristle(Friction):
    """A friction with memory: it turns the dry interval of its speed into the deflection of a bristle.

    Its states replace the projection: the dry laws on the same speed tell the steady-state level.
    """

    states = ("bristle",)

    def relaxations(
        self, p: SimpleNamespace, states: Sequence[Tensor], speed: Tensor, level: Tensor
    ) -> list[tuple[Tensor, Tensor]]:
        """Drive and rate [1/s] of each state, ``dz/dt = drive - rate z``, ``(B,)`` each.

        It is stepped exactly at constant drive and rate, which is stable however stiff the bristle.
        """
        raise NotImplementedError

    def torque(self, p: SimpleNamespace, states: Sequence[Tensor], speed: Tensor, level: Tensor) -> Tensor:
        """Friction torque [N m], ``(B,)``."""
        raise NotImplementedError


def relax(state: Tensor, drive: Tensor, rate: Tensor, step: Tensor) -> Tensor:
    """Exact solution of ``dz/dt = drive - rate z`` after ``step`` at constant drive and rate [1/s] >= 0."""
    decay = rate * step
    above = decay.clamp_min(1e-12)  # the limit of (1 - exp(-a)) / a at 0, without a branch
    return state * torch.exp(-decay) - drive * step * torch.expm1(-above) / above
