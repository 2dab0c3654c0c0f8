"""Free runs of a batch: the loop, the lifted Newton iteration that ends at the same result, and why one diverges."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.compiled import supports_compiled
from hybrid_id.simulation.lifted import condense, linearise, shoot
from hybrid_id.simulation.stability import LIMIT, fastest_rate
from hybrid_id.simulation.step import MAX_SUBSTEPS, Engine
from hybrid_id.systems.chain import System

CHUNK = 8
"""Samples of the loop between two iterations; more cost more than the iterations that they save."""


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
    guess; a row that has not closed its defects after a dozen iterations takes the loop. The compiled
    engine always takes the loop.

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
    for _ in range(
        0 if supports_compiled(system, engine, x) else 12
    ):  # its loop takes less time than one iteration
        part = batch.take(open_rows)
        nodes = shoot(system, engine, x[open_rows], part.u, part.dt, theta[:, open_rows], CHUNK)
        lin = linearise(system, engine, nodes, part.u, part.dt, theta[:, open_rows], [], ())
        step = condense(lin, nodes)[..., -1]
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


def cause_of_divergence(
    system: System, engine: Engine, batch: Batch, x: Tensor, theta: Tensor | None = None
) -> str:
    """Which record lost which state at what time, and why probably, of the first row that diverged; "" where none did.

    Args:
        system: what was simulated, with the values that it was simulated with.
        engine: how.
        batch: the records.
        x: states of their free runs, ``(R, T, n_x)``.
        theta: all parameters, ``(n_p,)`` (default: the system's values).
    """
    finite = torch.isfinite(x)
    lost = (~finite.all(2).all(1)).nonzero().flatten().tolist()
    if not lost:
        return ""
    row = lost[0]
    sample = int((~finite[row].all(1)).nonzero()[0, 0])
    state = system.state_names[int((~finite[row, sample]).nonzero()[0, 0])]
    time = float(batch.dt[row, :sample].sum())
    where = f"record '{batch.names[row]}': the simulation has no finite {state} from {time:.3g} s on"
    if not torch.isfinite(batch.x[row]).all():
        return f"{where}, because the record's own samples are not finite; correct the record"
    theta = (system.theta().detach() if theta is None else theta)[:, None]
    p = system.views(list(theta))
    for key, part in system.arm.couplings.items():
        least = system.arm.determinant(p, key, part)
        if least is not None and not bool((least > 0).all()):
            return f"{where}, because the mass matrix is singular; bring down the values of {part.kind}"
    one = batch.take(torch.tensor([row]))
    rate = fastest_rate(system, engine, one, theta)
    step, limit = float(one.dt.max()), LIMIT["memory" if system.memory_rows else engine.friction]
    if step * rate > limit * max(engine.substeps, 1):
        taken = step / max(engine.substeps, 1)
        return (
            f"{where}, because its step of {taken:.2g} s is unstable for a model whose fastest "
            f"time constant is {1.0 / rate:.2g} s ({MAX_SUBSTEPS} sub-steps a sample at most); correct the units or "
            "the smallest inertia, or resample"
        )
    largest = float(x[row, :sample].abs().max()) if sample else 0.0
    return (
        f"{where}, because the motion grows without bound (up to {largest:.2g} before); correct the units, "
        "the signs or the values of the model"
    )
