"""Loss of the weighted output error (paper, eq. 2)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Loss:
    """Loss of a weighted residual r: ``l2`` r^2 / 2, ``huber`` (Huber with threshold ``delta``), ``l1`` |r|.

    ``l1`` is smoothed below ``delta``; both robust losses act through iterative re-weighting.
    """

    kind: str = "l2"
    delta: float = 3.0

    def value(self, r: Tensor) -> Tensor:
        """Loss of each residual."""
        if self.kind == "l2":
            return 0.5 * r.square()
        small = r.abs() <= self.delta
        huber = torch.where(small, 0.5 * r.square(), self.delta * (r.abs() - 0.5 * self.delta))
        return huber / self.delta if self.kind == "l1" else huber

    def factor(self, r: Tensor) -> Tensor:
        """Weight of each squared residual in the quadratic model, loss'(r) / r."""
        if self.kind == "l2":
            return torch.ones_like(r)
        factor = self.delta / r.abs().clamp_min(self.delta)
        return factor / self.delta if self.kind == "l1" else factor
