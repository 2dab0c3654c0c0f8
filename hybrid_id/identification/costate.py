"""Gradient of the output error by the adjoint method, for whole records, with all samples side by side.

The state of the adjoint equation (the costate) at sample k is ``lambda_k = dL/dx_k = l_k + A_k' lambda_{k+1}``: what
the measurement at k says, plus what comes back through the sample after it. The solver's own adjoint (torchdiffeq's
`odeint_adjoint`) gives A_k for all samples in one backward integration a state; the recursion, which is linear, runs
over all samples; and one more backward integration from ``lambda_{k+1}`` gives the gradient of the parameters. A loop
through the record, sample by sample, comes to the same numbers at many hundred times the cost.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor, nn

from hybrid_id.identification.objective import Loss
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.lifted import (
    Linearisation,
    condense,
    lanes_at_once,
    linearise,
    linearise_outputs,
    slices,
)
from hybrid_id.simulation.rollout import rollout
from hybrid_id.simulation.solvers import OdeEngine
from hybrid_id.systems.chain import System

NEWTON_STEPS, ADVANCE = 12, 2000
"""Steps of Newton's method, and samples for which one more is allowed: what has closed advances from the start on."""
CLOSED = 1e-9
"""Step of Newton's method, relative to the largest state, at which a free run has closed."""
SHORTEST = 256
"""Samples of a row that are worked on at once, at least; `lanes_at_once` of all rows together."""


@dataclass
class Gradient:
    """Cost of each row and its gradient.

    Attributes:
        x: states of the free run, ``(R, T, n_x)``.
        y: its outputs, ``(R, T, n_y)``.
        cost: loss of the weighted residuals, ``(R,)``; NaN where the simulation diverged.
        theta: by the free parameters, ``(R, n_f)``.
        start: by the first states, ``(R, n_x)``.
        extra: by the parameters beyond the system's table, summed over the rows, shaped like them.
    """

    x: Tensor
    y: Tensor
    cost: Tensor
    theta: Tensor
    start: Tensor
    extra: list[Tensor]


def gradient(
    system: System,
    engine: OdeEngine,
    batch: Batch,
    guess: Tensor,
    theta: Tensor,
    free: Sequence[int],
    *,
    loss: Loss | None = None,
    extra: Sequence[nn.Parameter] = (),
) -> Gradient:
    """Simulate every row from its first state and differentiate the loss of its output error.

    Args:
        system: equations of motion.
        engine: how a sample is integrated and differentiated.
        batch: rows of data.
        guess: states near the free run, ``(R, T, n_x)``; its first column is the start states.
        theta: all parameters of each row in table order, ``(n_p, R)``.
        free: indices of the parameters to differentiate by.
        loss: loss of the weighted residuals (default: least squares).
        extra: parameters beyond the table to differentiate by, which all rows share.
    """
    loss = loss or Loss()
    with _held(extra):
        x, closed = free_run(system, engine, batch, guess, theta)
    y, cost = torch.empty_like(batch.y), batch.y.new_zeros(batch.rows)
    leaf = theta[list(free)].detach().clone().requires_grad_()
    wanted = [leaf, *extra]
    total = [torch.zeros_like(parameter) for parameter in wanted]
    later = torch.zeros_like(x[:, 0])  # what comes back through the end of a piece
    for piece in reversed(_pieces(batch)):
        part, nodes = _cut(batch, piece), x[:, piece].nan_to_num(0.0)
        with _held(extra):
            lin = linearise_sorted(system, engine, part, nodes, theta)
        y[:, piece] = lin.y
        residual = (part.y - lin.y) * part.weight
        slope = -loss.factor(residual) * residual * part.weight
        costate = _costates(lin, (lin.c.transpose(2, 3) @ slope[..., None])[..., 0], later)
        arriving, later = torch.cat([costate[:, 1:], later[:, None]], 1), costate[:, 0]
        cost += loss.value(residual).sum((1, 2))
        # pull the costates at each sample's end and the outputs' slope back to the parameters
        rows, samples, n_x = nodes.shape
        lanes = rows * samples
        row_of = torch.arange(rows, device=x.device).repeat_interleave(samples)
        flat_x, flat_dt = nodes.reshape(lanes, n_x), part.dt.reshape(lanes)
        flat_u = {name: channel.reshape(lanes) for name, channel in part.u.items()}
        pull, push = arriving.reshape(lanes, n_x), slope.reshape(lanes, -1)
        for block in slices(lanes, lanes_at_once(nodes)):
            row = row_of[block]
            values = list(theta[:, row].unbind(0))
            for position, index in enumerate(free):
                values[index] = leaf[position, row]
            channels = {name: channel[block] for name, channel in flat_u.items()}
            p, now = system.views(values), flat_x[block].unbind(1)
            with torch.enable_grad():
                after = torch.stack(engine.sample(system, now, channels, flat_dt[block], p), 1)
                measured = torch.stack(system.outputs(batch.outputs, now, channels, p), 1)
                surrogate = (after * pull[block]).sum() + (measured * push[block]).sum()
            if surrogate.requires_grad:
                slopes = torch.autograd.grad(surrogate, wanted, allow_unused=True)
                for so_far, more in zip(total, slopes, strict=True):
                    if more is not None:
                        so_far += more
    return Gradient(x, y, cost.where(closed, torch.nan), total[0].T.contiguous(), later, total[1:])


@contextmanager
def _held(weights: Sequence[nn.Parameter]) -> Iterator[None]:
    """Spare what neither the simulation nor A needs: gradients of the weights."""
    for weight in weights:
        weight.requires_grad_(False)
    try:
        yield
    finally:  # Ctrl-C, too, leaves them as they were
        for weight in weights:
            weight.requires_grad_(True)


def _pieces(batch: Batch) -> list[slice]:
    """Pieces of the samples that are worked on one after the other, so that memory does not grow with a record."""
    rows, samples = batch.dt.shape
    return slices(samples, max(lanes_at_once(batch.x) // rows, SHORTEST))


def _cut(batch: Batch, piece: slice) -> Batch:
    """The rows between two samples."""
    picked = {field: getattr(batch, field)[:, piece] for field in ("dt", "y", "weight", "x")}
    return replace(batch, u={name: channel[:, piece] for name, channel in batch.u.items()}, **picked)


def free_run(
    system: System,
    engine: OdeEngine,
    batch: Batch,
    guess: Tensor,
    theta: Tensor,
    *,
    roll_out: bool = False,
) -> tuple[Tensor, Tensor]:
    """Free run from ``guess[:, 0]`` by Newton's method over all samples (see :mod:`hybrid_id.simulation.lifted`).

    Returns:
        States ``(R, T, n_x)``, and for each row whether its defects closed; a row that did not close has diverged, or
        its guess was too far off. With ``roll_out`` such rows are simulated sample by sample (slow), and have closed
        where they are finite.
    """
    x, cheap = guess.clone(), replace(engine, gradient="backprop")
    closed, pieces = torch.ones(batch.rows, dtype=torch.bool, device=x.device), _pieces(batch)
    peaks = torch.stack([x[:, piece].abs().amax((1, 2)) for piece in pieces])
    for number, piece in enumerate(pieces):
        whole = slice(piece.start, piece.stop + 1)  # its last state is the first one of the next piece
        part, nodes = _cut(batch, whole), x[:, whole]
        peaks[number] = 0.0
        elsewhere, opened = peaks.amax(0), closed.nonzero().flatten()
        closed = torch.zeros_like(closed)
        for _ in range(NEWTON_STEPS + nodes.shape[1] // ADVANCE):
            some = part.take(opened)
            lin = linearise_sorted(system, cheap, some, nodes[opened], theta[:, opened])
            step = condense(lin, nodes[opened])[..., -1]
            nodes[opened] = nodes[opened] + step
            peak = torch.maximum(elsewhere[opened], nodes[opened].abs().amax((1, 2)))
            size = step.abs().amax((1, 2)) / peak.clamp_min(1e-12)
            closed[opened] = size <= CLOSED
            opened = opened[(size > CLOSED) & torch.isfinite(size)]
            if opened.numel() == 0:
                break
        if not bool(closed.any()):
            break
        peaks[number] = nodes.abs().amax((1, 2))
    if roll_out and not bool(closed.all()):
        rows = (~closed).nonzero().flatten()
        with torch.no_grad():
            x[rows] = rollout(system, cheap, batch.take(rows), theta[:, rows])
        closed[rows] = torch.isfinite(x[rows]).all(2).all(1)
    return x, closed


def simulated(system: System, batch: Batch, x: Tensor, theta: Tensor) -> Tensor:
    """Outputs ``(R, T, n_y)`` of a free run's states."""
    parts = [(_cut(batch, piece), x[:, piece].nan_to_num(0.0)) for piece in _pieces(batch)]
    found = [linearise_outputs(system, nodes, part.u, theta, (), batch.outputs).y for part, nodes in parts]
    return torch.cat(found, 1)


def linearise_sorted(
    system: System, engine: OdeEngine, batch: Batch, x: Tensor, theta: Tensor, free: Sequence[int] = ()
) -> Linearisation:
    """Linearise at all nodes, block by block of lanes sorted by effort, so that few blocks hold the costly ones.

    What is needed to differentiate a sample takes hundreds of times the memory of its result, so that no more than a
    block of it is there at once.
    """
    rows, samples, n_x = x.shape
    lanes = rows * samples
    flat_x, flat_dt = x.reshape(lanes, n_x), batch.dt.reshape(lanes)
    flat_u = {name: channel.reshape(lanes) for name, channel in batch.u.items()}

    def at(place: Tensor) -> tuple[Tensor, dict[str, Tensor], Tensor, Tensor]:
        channels = {name: channel[place] for name, channel in flat_u.items()}
        return flat_x[place], channels, flat_dt[place], theta[:, place // samples]

    near = []
    for place in torch.arange(lanes, device=x.device).split(lanes_at_once(x)):
        now, u, dt, values = at(place)
        near.append(engine.near_rest(system, now.unbind(1), u, dt, system.views(list(values))))
    order = torch.cat(near).to(torch.int8).argsort(stable=True)
    found: dict[str, Tensor] = {}
    picks: tuple[int | None, ...] = ()
    for place in order.split(lanes_at_once(x)):
        now, u, dt, values = at(place)
        u = {name: channel[:, None] for name, channel in u.items()}
        part = linearise(system, engine, now[:, None], u, dt[:, None], values, free, batch.outputs)
        picks = part.picks
        for field in fields(part):
            if isinstance(tensor := getattr(part, field.name), Tensor):
                whole = found.setdefault(field.name, tensor.new_empty(lanes, *tensor.shape[2:]))
                whole.index_copy_(0, place, tensor[:, 0])
    grids = {name: whole.reshape(rows, samples, *whole.shape[1:]) for name, whole in found.items()}
    return Linearisation(**grids, picks=picks)


def _costates(lin: Linearisation, source: Tensor, later: Tensor) -> Tensor:
    """Solve ``lambda_k = source_k + A_k' lambda_{k+1}`` for all rows, ``(R, T, n_x)``: condensing, back in time.

    ``later`` is the one after the last, ``(R, n_x)``.
    """
    rows, samples, n_x = source.shape
    source[:, -1] += (lin.a[:, -1].transpose(1, 2) @ later[..., None])[..., 0]
    back = lin.a.transpose(2, 3).flip(1)
    forcing = torch.cat([source.flip(1), source.new_zeros(rows, 1, n_x)], 1)
    none = source.new_zeros(rows, samples + 1, n_x, 0)
    chain = replace(lin, x_next=forcing, a=torch.cat([back, back[:, :1]], 1), b=none)
    return condense(chain, torch.zeros_like(forcing))[:, 1:, :, -1].flip(1)
