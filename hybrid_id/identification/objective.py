"""The output-error objective on a batch of records: data as tensors, weights, loss, initial states."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
        return self.y.shape[0]

    def take(self, rows: Tensor) -> Batch:
        """The batch of some rows (indices may repeat)."""
        names = tuple(self.names[int(i)] for i in rows)
        pick = {f: getattr(self, f)[rows] for f in ("dt", "y", "weight", "x", "x0_std")}
        return replace(self, u={n: c[rows] for n, c in self.u.items()}, names=names, **pick)

    def windows(self, length: int, stride: int, x0_std: Tensor) -> tuple[Batch, Tensor]:
        """Short windows of the rows, each with a first state of its own, and the row that each comes from.

        Args:
            length: samples in a window.
            stride: samples from one window's start to the next one's.
            x0_std: prior standard deviation of the first states around the guess, ``(R, n_x)``.
        """
        samples = self.dt.shape[1]
        starts = torch.arange(0, max(samples - length, 0) + 1, stride)
        index = (starts[:, None] + torch.arange(length)).clamp_max(samples - 1).to(self.dt.device)

        def cut(tensor: Tensor) -> Tensor:
            return tensor[:, index].flatten(0, 1)

        row = torch.arange(self.rows, device=self.dt.device).repeat_interleave(len(starts))
        dt = cut(self.dt).clone()
        dt[:, -1] = 0.0
        batch = Batch(
            {name: cut(c) for name, c in self.u.items()},
            dt, cut(self.y), cut(self.weight), cut(self.x), x0_std[row], self.outputs,
            tuple(self.names[int(r)] for r in row),
        )
        useful = (batch.weight > 0).any(2).any(1).nonzero().flatten()
        return batch.take(useful), row[useful]

    def to(self, device: torch.device | str) -> Batch:
        """The batch on another device."""
        moved = {f: getattr(self, f).to(device) for f in ("dt", "y", "weight", "x", "x0_std")}
        return replace(self, u={n: c.to(device) for n, c in self.u.items()}, **moved)


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


def free_indices(estimate: Sequence[bool]) -> list[int]:
    """Indices of the parameters that a fit moves."""
    return [i for i, e in enumerate(estimate) if e]
