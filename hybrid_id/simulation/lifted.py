"""Lifted simulation: every sample's state is a node, and all samples are integrated at once.

A rollout is a chain ``x_{k+1} = Phi(x_k, u_k, theta)`` that a loop must walk step by step, and in eager torch each step
costs the same for one lane as for thousands. Here the states of all samples are unknowns. One call evaluates Phi and
its Jacobians for all samples as lanes; the defects ``d_k = Phi(x_k) - x_{k+1}`` and the sensitivities are then chained
by a linear recursion ("condensing"), itself cut into chunks that run side by side:

    delta_{k+1} = A_k delta_k + B_k delta_theta + d_k.

With delta_theta = 0 this is Newton's method for the simulation; it ends at the loop's own result. Together with the
output residuals it is the Gauss-Newton step of lifted multiple shooting in which every sample is a node.

Sources: H. G. Bock's multiple shooting (1981); J. Albersmeyer, M. Diehl, "The Lifted Newton Method", SIAM J. Optim.
20 (2010); Y. H. Lim et al., "Parallelizing non-linear sequential models over the sequence length", ICLR 2024.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from hybrid_id.simulation.compiled import CompiledStep, serves
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.chain import System

LANES = 25_000
"""Lanes per block: enough to hide the cost of Python, few enough for 200 MB of saved values."""


@dataclass(frozen=True)
class Linearisation:
    """Phi and the outputs at all nodes, with Jacobians.

    Attributes:
        x_next: Phi of each node, ``(R, T, n_x)``; the last node of a row is its own successor.
        a: d x_next / d x, ``(R, T, n_x, n_x)``.
        b: d x_next / d theta, ``(R, T, n_x, n_f)``.
        y: outputs, ``(R, T, n_y)``.
        c: d y / d x, ``(R, T, n_y, n_x)``.
        d: d y / d theta, ``(R, T, n_y, n_f)``.
        picks: for each output the state that it is, None where it is a function of states and parameters.
    """

    x_next: Tensor
    a: Tensor
    b: Tensor
    y: Tensor
    c: Tensor
    d: Tensor
    picks: tuple[int | None, ...]

    def output_chain(self, chain: Tensor) -> Tensor:
        """Sensitivities of the outputs from those of the nodes, ``(R, T, n_y, n_x + n_f + 1)``."""
        states = [pick for pick in self.picks if pick is not None]
        if len(states) == len(self.picks):
            return chain[:, :, states]
        through = self.c @ chain
        through[..., chain.shape[2] : -1] += self.d
        return through


def linearise(
    system: System,
    engine: Engine,
    x: Tensor,
    u: Mapping[str, Tensor],
    dt: Tensor,
    theta: Tensor,
    free: Sequence[int],
    outputs: Sequence[str],
) -> Linearisation:
    """Evaluate and differentiate one sample at every node of a batch of rows, reverse mode, block by block.

    Args:
        system: equations of motion.
        engine: how a sample is integrated.
        x: nodes, ``(R, T, n_x)``.
        u: channels, ``(R, T)`` each.
        dt: sample times [s], ``(R, T)``; 0 in the last column and in padding.
        theta: all parameters in table order, ``(n_p, R)``.
        free: indices of the parameters to differentiate by.
        outputs: names of the measured outputs.
    """
    rows, samples, n_x = x.shape
    n_y, n_f, lanes = len(outputs), len(free), rows * samples
    flat_x, flat_dt = x.reshape(lanes, n_x), dt.reshape(lanes)
    flat_u = {name: channel.reshape(lanes) for name, channel in u.items()}
    x_next, y = x.new_empty(lanes, n_x), x.new_empty(lanes, n_y)
    jacobian = x.new_zeros(lanes, n_x + n_y, n_x + n_f)
    row_of = torch.arange(rows, device=x.device).repeat_interleave(samples)
    theta_rows = theta[:, :1] if bool((theta == theta[:, :1]).all()) else theta
    picks: list[int | None] = [None] * n_y
    compiled = CompiledStep(system, engine, tuple(u), free) if serves(system, engine) else None
    for start in range(0, lanes, LANES):
        block = slice(start, min(start + LANES, lanes))
        row = row_of[block]
        leaves = [column.contiguous().requires_grad_() for column in flat_x[block].unbind(1)]
        values: list[Tensor] = [t if t.shape[0] == 1 else t[row] for t in theta_rows]
        for i in free:
            values[i] = theta[i, row].requires_grad_()
        channels = {name: channel[block] for name, channel in flat_u.items()}
        p = system.views(values)
        after: list[Tensor] = []
        if compiled is not None:
            point = flat_x[block].T, torch.stack(list(channels.values())), flat_dt[block], theta[:, row]
            states, chain = compiled.jacobian(*point)
            x_next[block], jacobian[block, :n_x] = states.T, chain.movedim(2, 0)
        with torch.enable_grad():
            if compiled is None:
                after = engine.sample(system, leaves, channels, flat_dt[block], p)
            measured = system.outputs(outputs, leaves, channels, p)
        wanted = [*leaves, *(values[i] for i in free)]
        for i, target in enumerate([*after, *measured], 0 if after else n_x):  # lanes do not mix: one sweep a row
            (x_next[block, i] if i < n_x else y[block, i - n_x]).copy_(target.detach())
            alias = next((j for j, leaf in enumerate(leaves) if target is leaf), None)
            if i >= n_x:
                picks[i - n_x] = alias
            if alias is not None:
                jacobian[block, i, alias] = 1.0
            elif target.requires_grad:
                grads = torch.autograd.grad(target.sum(), wanted, retain_graph=True, allow_unused=True)
                for j, grad in enumerate(grads):
                    if grad is not None:
                        jacobian[block, i, j] = grad
    grid = jacobian.reshape(rows, samples, n_x + n_y, n_x + n_f)
    return Linearisation(
        x_next.reshape(rows, samples, n_x),
        grid[:, :, :n_x, :n_x],
        grid[:, :, :n_x, n_x:],
        y.reshape(rows, samples, n_y),
        grid[:, :, n_x:, :n_x],
        grid[:, :, n_x:, n_x:],
        tuple(picks),
    )


def condense(lin: Linearisation, x: Tensor) -> Tensor:
    """Chain the defects and sensitivities of all nodes from the first node of each row.

    Args:
        lin: linearisation at the nodes.
        x: the nodes, ``(R, T, n_x)``.

    Returns:
        ``(R, T, n_x, n_x + n_f + 1)``: change of each node per unit of the first node's state, per unit of each
        parameter, and (last column) through the defects.
    """
    rows, samples, n_x = x.shape
    n_f = lin.b.shape[-1]
    columns = n_x + n_f + 1
    steps = samples - 1
    length = max(1, round(max(steps, 1) ** 0.5))
    chunks = -(-steps // length)
    pad = chunks * length - steps
    identity = torch.eye(n_x, dtype=x.dtype, device=x.device)
    forcing = x.new_zeros(length, rows, chunks, n_x, columns)
    transition = x.new_zeros(length, rows, chunks, n_x, n_x)

    def chunked(tensor: Tensor) -> Tensor:
        """(R, T - 1, ...) to time-major (length, R, chunks, ...)."""
        if pad:
            tensor = torch.cat([tensor, tensor.new_zeros(rows, pad, *tensor.shape[2:])], 1)
        return tensor.reshape(rows, chunks, length, *tensor.shape[2:]).movedim(2, 0)

    transition.copy_(chunked(lin.a[:, :-1]))
    forcing[..., n_x:-1].copy_(chunked(lin.b[:, :-1]))
    forcing[..., -1].copy_(chunked(lin.x_next[:, :-1] - x[:, 1:]))
    lanes = rows * chunks
    transition = transition.reshape(length, lanes, n_x, n_x)
    forcing = forcing.reshape(length, lanes, n_x, columns)
    inside = x.new_empty(length, lanes, n_x, columns)
    current = x.new_zeros(lanes, n_x, columns)
    current[:, :, :n_x] = identity
    for k in range(length):
        current = torch.baddbmm(forcing[k], transition[k], current)
        inside[k] = current
    # across chunks: the state at each chunk's start
    ends = inside[-1].reshape(rows, chunks, n_x, columns)
    start = x.new_zeros(rows, n_x, columns)
    start[:, :, :n_x] = identity
    starts = x.new_empty(rows, chunks, n_x, columns)
    for c in range(chunks):
        starts[:, c] = start
        step = ends[:, c]
        start = torch.bmm(step[:, :, :n_x], start)
        start[:, :, n_x:] += step[:, :, n_x:]
    spread = starts.reshape(1, lanes, n_x, columns).expand(length, -1, -1, -1)
    chained = torch.matmul(inside[..., :n_x], spread)
    chained[..., n_x:] += inside[..., n_x:]
    chained = chained.reshape(length, rows, chunks, n_x, columns).movedim(0, 2)
    chained = chained.reshape(rows, chunks * length, n_x, columns)[:, :steps]
    first = x.new_zeros(rows, 1, n_x, columns)
    first[:, 0, :, :n_x] = identity
    return torch.cat([first, chained], 1)


@torch.no_grad()
def shoot(
    system: System,
    engine: Engine,
    x: Tensor,
    u: Mapping[str, Tensor],
    dt: Tensor,
    theta: Tensor,
    length: int = 16,
) -> Tensor:
    """Replace the nodes inside each chunk of ``length`` samples by a rollout from the chunk's first node.

    The defects that remain sit between chunks. A reversal whose time is off then costs one Newton step instead of
    one for each sample by which it moves. Arguments as in :func:`linearise`; returns the new nodes ``(R, T, n_x)``.
    """
    rows, samples, n_x = x.shape
    chunks = -(-samples // length)
    pad = chunks * length - samples

    def chunked(tensor: Tensor) -> Tensor:
        return torch.nn.functional.pad(tensor, (0, pad)).reshape(rows * chunks, length)

    starts = x[:, ::length].reshape(rows * chunks, n_x)
    steps = chunked(dt).unbind(1)
    channels = {name: chunked(channel).unbind(1) for name, channel in u.items()}
    p = system.views([*_spread(theta, chunks)])
    state = list(starts.unbind(1))
    path = [starts]
    if serves(system, engine):
        compiled = CompiledStep(system, engine, tuple(u), ())
        spread = theta.repeat_interleave(chunks, 1)
    for k in range(length - 1):
        held = {name: c[k] for name, c in channels.items()}
        if serves(system, engine):
            after = compiled.states(torch.stack(state), torch.stack(list(held.values())), steps[k], spread)
            state = list(after.unbind(0))
        else:
            state = engine.sample(system, state, held, steps[k], p)
        path.append(torch.stack(state, -1))
    return torch.stack(path, 1).reshape(rows, chunks * length, n_x)[:, :samples]


def _spread(theta: Tensor, count: int) -> Tensor:
    """Parameters of each row for ``count`` lanes a row, ``(n_p, R * count)``, or ``(n_p, 1)`` where rows agree."""
    shared = bool((theta == theta[:, :1]).all())
    return theta[:, :1] if shared else theta.repeat_interleave(count, 1)
