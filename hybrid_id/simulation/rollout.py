"""Free-run simulation of a batch: the loop, and the lifted Newton iteration that ends at the same result."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from hybrid_id.simulation.compiled_dry import walks
from hybrid_id.simulation.lifted import condensed, shoot
from hybrid_id.simulation.prepare import Batch
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.chain import System

CHUNK = 8
"""Samples that are walked between two iterations; longer walks cost more than the iterations that they save."""


@dataclass(frozen=True)
class Simulation:
    """Free run of a batch.

    Attributes:
        x: states, ``(R, T, n_x)``.
        y: outputs, ``(R, T, n_y)``, in the order of the batch's outputs.
        status: "ok" or "diverged" for each row.
    """

    x: Tensor
    y: Tensor
    status: tuple[str, ...]


@torch.no_grad()
def rollout(system: System, engine: Engine, batch: Batch, theta: Tensor) -> Tensor:
    """States of the free run from ``batch.x[:, 0]``, sample by sample, ``(R, T, n_x)``."""
    return shoot(system, engine, batch.x, batch.u, batch.dt, theta, batch.x.shape[1])


def simulate(
    system: System, engine: Engine, batch: Batch, theta: Tensor | None = None, tolerance: float = 1e-9
) -> Simulation:
    """Free run of every row from its first state under its logged channels.

    Newton's method over all samples at once (see :mod:`hybrid_id.simulation.lifted`), started from the batch's
    guess; a row that has not closed its defects after a dozen iterations is walked by the loop.

    Args:
        system: what is simulated.
        engine: how a sample is integrated.
        batch: rows; ``batch.x[:, 0]`` are the start states.
        theta: parameters of each row in table order, ``(n_p, R)`` (default: the system's values).
        tolerance: largest closing step relative to the largest state.
    """
    if theta is None:
        theta = system.theta().detach().to(batch.x.device)[:, None].expand(-1, batch.rows)
    x, first = batch.x.clone(), batch.x[:, 0]
    open_rows = torch.arange(batch.rows, device=x.device)
    for _ in range(0 if walks(system, engine, x) else 12):  # its loop takes less time than one iteration
        part = batch.take(open_rows)
        nodes = shoot(system, engine, x[open_rows], part.u, part.dt, theta[:, open_rows], CHUNK)
        step = condensed(system, engine, nodes, part.u, part.dt, theta[:, open_rows], [], ())[1][..., -1]
        nodes = nodes + step
        nodes[:, 0] = first[open_rows]
        x[open_rows] = nodes
        finite = torch.isfinite(nodes).all(2).all(1)
        small = step.abs().amax((1, 2)) <= tolerance * nodes.abs().amax((1, 2)).clamp_min(1e-12)
        open_rows = open_rows[~(small & finite)]
        if open_rows.numel() == 0:
            break
        if not bool(finite.all()):
            break
    if open_rows.numel():
        x[open_rows] = rollout(system, engine, batch.take(open_rows), theta[:, open_rows])
    u = {name: channel.reshape(-1) for name, channel in batch.u.items()}
    p = system.views(list(theta.repeat_interleave(x.shape[1], 1)))
    with torch.no_grad():
        rows = system.outputs(batch.outputs, x.reshape(-1, x.shape[-1]).unbind(1), u, p)
    y = torch.stack(rows, -1).reshape(*x.shape[:2], len(rows))
    finite = torch.isfinite(y).all(2).all(1) & torch.isfinite(x).all(2).all(1)
    return Simulation(x, y, tuple("ok" if ok else "diverged" for ok in finite.tolist()))
