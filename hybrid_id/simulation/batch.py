"""Records as rows of tensors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import torch
from torch import Tensor


@dataclass(frozen=True)
class Batch:
    """Records (or windows of records) as rows of one batch, padded at their end with sample time 0 and weight 0.

    Attributes:
        u: channels, ``(R, T)`` each, held between samples.
        dt: sample times [s], ``(R, T)``; 0 in each row's last sample and after it.
        y: measured outputs, ``(R, T, n_y)``.
        weight: 1 / standard deviation of each measurement, ``(R, T, n_y)``; 0 where there is none.
        x: first guess of the states at all samples, ``(R, T, n_x)``.
        x0_std: prior standard deviation of each row's first state around ``x[:, 0]``, ``(R, n_x)``; 0 holds it.
        outputs: names of the outputs.
        names: names of the rows.
    """

    u: Mapping[str, Tensor]
    dt: Tensor
    y: Tensor
    weight: Tensor
    x: Tensor
    x0_std: Tensor
    outputs: tuple[str, ...]
    names: tuple[str, ...]

    @property
    def rows(self) -> int:
        """Number of rows."""
        return self.y.shape[0]

    @property
    def sample_time(self) -> float:
        """Median sample time [s]."""
        return float(self.dt[self.dt > 0].median())

    def std(self, values: Tensor) -> Tensor:
        """Standard deviation over the samples that each row has, ``(R, n)``, of values ``(R, T, n)``."""
        own = (self.weight > 0).any(2, keepdim=True).to(values.dtype)
        count = own.sum(1).clamp_min(2.0)
        mean = (own * values).sum(1) / count
        return ((own * (values - mean[:, None])).square().sum(1) / (count - 1.0)).sqrt()

    def motion(self) -> Tensor:
        """How much each row's outputs move, weighted: their standard deviation, ``(R, n_y)``."""
        return self.std(self.y) * self.weight.amax(1)

    def take(self, rows: Tensor) -> Batch:
        """The batch of some rows (indices may repeat); itself where they are all of them in order."""
        if len(rows) == self.rows and bool((rows == torch.arange(self.rows, device=rows.device)).all()):
            return self
        names = tuple(self.names[i] for i in rows.tolist())
        picked = {field: getattr(self, field)[rows] for field in ("dt", "y", "weight", "x", "x0_std")}
        return replace(self, u={name: c[rows] for name, c in self.u.items()}, names=names, **picked)

    def to(self, device: torch.device | str, dtype: torch.dtype | None = None) -> Batch:
        """The batch on another device, and in another precision."""
        fields = ("dt", "y", "weight", "x", "x0_std")
        moved = {field: getattr(self, field).to(device, dtype) for field in fields}
        return replace(self, u={name: c.to(device, dtype) for name, c in self.u.items()}, **moved)

    def windows(self, length: int, stride: int, x0_std: Tensor) -> tuple[Batch, Tensor]:
        """Short windows of the rows, each with a first state of its own, and the row that each comes from.

        Args:
            length: samples in a window.
            stride: samples from one window's start to the next one's.
            x0_std: prior standard deviation of the first states around the guess, ``(R, n_x)``.
        """
        samples, device = self.dt.shape[1], self.dt.device
        starts = torch.arange(0, max(samples - length, 0) + 1, stride, device=device)
        row = torch.arange(self.rows, device=device).repeat_interleave(len(starts))
        batch = self.pieces(row, starts.repeat(self.rows), torch.full_like(row, length), x0_std[row])
        useful = (batch.weight > 0).any(2).any(1).nonzero().flatten()
        return batch.take(useful), row[useful]

    def pieces(self, row: Tensor, start: Tensor, length: Tensor, x0_std: Tensor) -> Batch:
        """Pieces of the rows as rows of their own, padded at their end.

        Args:
            row: which each piece is cut from, ``(P,)``.
            start: its first sample there, ``(P,)``.
            length: its samples, ``(P,)``.
            x0_std: prior standard deviation of its first state around the guess, ``(P, n_x)``.
        """
        here = torch.arange(int(length.max()), device=self.dt.device)
        index = (start[:, None] + torch.minimum(here, length[:, None] - 1)).clamp_max(self.dt.shape[1] - 1)
        picked = {field: getattr(self, field)[row[:, None], index] for field in ("dt", "y", "weight", "x")}
        picked["dt"][here >= length[:, None] - 1] = 0.0
        picked["weight"][here >= length[:, None]] = 0.0
        return replace(
            self,
            u={name: channel[row[:, None], index] for name, channel in self.u.items()},
            x0_std=x0_std,
            names=tuple(self.names[i] for i in row.tolist()),
            **picked,
        )
