"""Lifted simulation: every sample's state is a node, and all samples are integrated at once.

A rollout is a chain ``x_{k+1} = Phi(x_k, u_k, theta)`` that a loop must follow step by step, and in eager torch each
step costs the same for one lane as for thousands. Here the states of all samples are unknowns. One call evaluates Phi
and its Jacobians for all samples as lanes; the defects ``d_k = Phi(x_k) - x_{k+1}`` and the sensitivities are then
chained by a linear recursion ("condensing"):

    delta_{k+1} = A_k delta_k + B_k delta_theta + d_k.

With delta_theta = 0 this is Newton's method for the simulation; it ends at the loop's own result. Together with the
output residuals it is the Gauss-Newton step of lifted multiple shooting in which every sample is a node.

Sources: H. G. Bock's multiple shooting (1981); J. Albersmeyer, M. Diehl, "The Lifted Newton Method", SIAM J. Optim.
20 (2010); Y. H. Lim et al., "Parallelizing non-linear sequential models over the sequence length", ICLR 2024.
"""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources

import torch
from torch import Tensor

from hybrid_id.errors import InputError
from hybrid_id.simulation import compiled
from hybrid_id.simulation.c_code import call, library
from hybrid_id.simulation.compiled import supports_compiled
from hybrid_id.simulation.step import Engine, fill_jacobian
from hybrid_id.systems.chain import System

LANES, ON_GPU = 25_000, 1_000_000
"""Lanes per block, on the CPU and on a GPU: enough to hide the cost of Python, few enough for 200 MB of saved values
and for 1.5 GB."""

BLOCK = 16
"""Samples whose Jacobians compiled condensing gathers at once: two lines of cache of each element."""


def lanes_at_once(x: Tensor) -> int:
    """Lanes per block where a tensor lies."""
    return LANES if x.device.type == "cpu" else ON_GPU


def slices(count: int, length: int) -> list[slice]:
    """Blocks of so many at most, one after the other."""
    return [slice(begin, min(begin + length, count)) for begin in range(0, count, length)]


@dataclass(frozen=True)
class Outputs:
    """Simulated outputs at all nodes, with their Jacobians.

    Attributes:
        y: outputs, ``(R, T, n_y)``.
        c: d y / d x, ``(R, T, n_y, n_x)``.
        d: d y / d theta, ``(R, T, n_y, n_f)``.
        picks: for each output the state that it is, None where it is a function of states and parameters.
    """

    y: Tensor
    c: Tensor
    d: Tensor
    picks: tuple[int | None, ...]

    def through(self, nodes: Tensor) -> Tensor:
        """Sensitivities of the outputs ``(R, T, n_y, n_x + n_f + 1)`` from those of the nodes, see :func:`condense`."""
        states = [pick for pick in self.picks if pick is not None]
        if len(states) == len(self.picks):
            return nodes[:, :, states]
        found = self.c @ nodes
        found[..., nodes.shape[2] : -1] += self.d
        return found


@dataclass(frozen=True)
class Linearisation(Outputs):
    """The outputs and Phi at all nodes, with Jacobians.

    Attributes:
        x_next: Phi of each node, ``(R, T, n_x)``; the last node of a row is its own successor.
        a: d x_next / d x, ``(R, T, n_x, n_x)``.
        b: d x_next / d theta, ``(R, T, n_x, n_f)``.
    """

    x_next: Tensor
    a: Tensor
    b: Tensor


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
    """Evaluate and differentiate one sample at every node of a batch of rows: compiled, or reverse mode by blocks.

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
    if supports_compiled(system, engine, x):
        after, jacobian = compiled.linearise(system, engine, x, u, dt, theta, free)
        simulated = linearise_outputs(system, x, u, theta, free, outputs)
        return Linearisation(**vars(simulated), x_next=after, a=jacobian[..., :n_x], b=jacobian[..., n_x:])
    lanes, columns = rows * samples, n_x + len(free)
    flat_x, flat_dt = x.reshape(lanes, n_x), dt.reshape(lanes)
    flat_u = {name: channel.reshape(lanes) for name, channel in u.items()}
    x_next = x.new_empty(n_x, lanes)
    jacobian = x.new_zeros(n_x, columns, lanes)
    row_of = torch.arange(rows, device=x.device).repeat_interleave(samples)
    theta_rows = theta[:, :1] if bool((theta == theta[:, :1]).all()) else theta
    for block in slices(lanes, lanes_at_once(x)):
        row = row_of[block]
        leaves = [column.contiguous().requires_grad_() for column in flat_x[block].unbind(1)]
        values: list[Tensor] = [t if t.shape[0] == 1 else t[row] for t in theta_rows]
        for i in free:
            values[i] = theta[i, row].requires_grad_()
        channels = {name: channel[block] for name, channel in flat_u.items()}
        with torch.enable_grad():
            after = engine.sample(system, leaves, channels, flat_dt[block], system.views(values))
        for i, target in enumerate(after):
            x_next[i, block] = target.detach()
        fill_jacobian(jacobian[:, :, block], after, [*leaves, *(values[i] for i in free)])
    grid = jacobian.reshape(n_x, columns, rows, samples).permute(2, 3, 0, 1)
    return Linearisation(
        **vars(linearise_outputs(system, x, u, theta, free, outputs)),
        x_next=x_next.reshape(n_x, rows, samples).movedim(0, 2),
        a=grid[..., :n_x],
        b=grid[..., n_x:],
    )


def linearise_outputs(
    system: System,
    x: Tensor,
    u: Mapping[str, Tensor],
    theta: Tensor,
    free: Sequence[int],
    outputs: Sequence[str],
) -> Outputs:
    """Evaluate and differentiate the outputs at every node.

    Args:
        system: has the outputs.
        x: nodes, ``(R, T, n_x)``.
        u: channels, ``(R, T)`` each.
        theta: all parameters in table order, ``(n_p, R)``.
        free: indices of the parameters to differentiate by.
        outputs: names of the measured outputs.
    """
    rows, samples, n_x = x.shape
    n_y, n_f = len(outputs), len(free)
    states = x[:, 0].unbind(1)  # one sample of each row shows which outputs are states
    with torch.no_grad():
        found = system.outputs(
            outputs, states, {name: channel[:, 0] for name, channel in u.items()}, system.views(list(theta))
        )
    picks = [next((j for j, state in enumerate(states) if one is state), None) for one in found]
    if all(pick is not None for pick in picks):
        c = torch.eye(n_x, dtype=x.dtype, device=x.device)[picks].expand(rows, samples, n_y, n_x)
        return Outputs(x[..., picks], c, x.new_zeros(1).expand(rows, samples, n_y, n_f), tuple(picks))
    leaves = [column.reshape(-1).requires_grad_() for column in x.detach().clone().unbind(2)]
    values = list(theta.repeat_interleave(samples, 1).unbind(0))
    for i in free:
        values[i] = values[i].detach().requires_grad_()
    channels = {name: channel.reshape(-1) for name, channel in u.items()}
    with torch.enable_grad():
        found = system.outputs(outputs, leaves, channels, system.views(values))
    jacobian = x.new_zeros(rows * samples, n_y, n_x + n_f)
    fill_jacobian(jacobian.permute(1, 2, 0), found, [*leaves, *(values[i] for i in free)])
    y = torch.stack([target.detach() for target in found], -1) if found else x.new_empty(rows * samples, 0)
    grid = jacobian.reshape(rows, samples, n_y, n_x + n_f)
    return Outputs(y.reshape(rows, samples, n_y), grid[..., :n_x], grid[..., n_x:], tuple(picks))


def condense(lin: Linearisation, x: Tensor) -> Tensor:
    """Chain the defects and sensitivities of all nodes from the first node of each row: in C where that can be.

    Args:
        lin: linearisation at the nodes.
        x: the nodes, ``(R, T, n_x)``.

    Returns:
        ``(R, T, n_x, n_x + n_f + 1)``: change of each node per unit of the first node's state, per unit of each
        parameter, and (last column) through the defects.
    """
    found = condense_compiled(x, lin.a, lin.b, lin.x_next)
    return condense_reference(lin, x) if found is None else found


def condense_reference(lin: Linearisation, x: Tensor) -> Tensor:
    """What :func:`condense` returns, in PyTorch: chunks side by side, then one after the other."""
    rows, samples, n_x = x.shape
    columns = n_x + lin.b.shape[-1] + 1
    steps = samples - 1
    length = max(1, round(max(steps, 1) ** 0.5))
    chunks = max(1, -(-steps // length))
    pad = chunks * length - steps
    identity = torch.eye(n_x, columns, dtype=x.dtype, device=x.device)
    chain = x.new_empty(rows, 1 + chunks * length, n_x, columns)
    chain[:, 0] = identity
    inside = chain[:, 1:].view(rows, chunks, length, n_x, columns)

    def chunked(tensor: Tensor) -> Tensor:
        """(R, T - 1, ...) to (R, chunks, length, ...)."""
        if pad:
            tensor = torch.cat([tensor, tensor.new_zeros(rows, pad, *tensor.shape[2:])], 1)
        return tensor.unflatten(1, (chunks, length))

    transition, forcing = chunked(lin.a[:, :-1]), chunked(lin.b[:, :-1])
    defect = chunked(lin.x_next[:, :-1] - x[:, 1:])
    current = identity.expand(rows, chunks, n_x, columns)
    for k in range(length):
        now = inside[:, :, k]
        torch.mul(transition[:, :, k, :, :1], current[:, :, :1], out=now)
        for j in range(1, n_x):
            now.addcmul_(transition[:, :, k, :, j : j + 1], current[:, :, j : j + 1])
        now[..., n_x:-1] += forcing[:, :, k]
        now[..., -1] += defect[:, :, k]
        current = now
    # across chunks: from the chunk's first node to the row's
    for c in range(1, chunks):
        start = inside[:, c - 1, -1]
        now = inside[:, c]
        through = (now[..., :n_x].flatten(1, 2) @ start).view_as(now)
        through[..., n_x:] += now[..., n_x:]
        now.copy_(through)
    return chain[:, :samples]


def condense_compiled(x: Tensor, a: Tensor, b: Tensor, x_next: Tensor) -> Tensor | None:
    """What :func:`condense` returns, by one pass over the samples, ten times faster than the reference.

    None where there is no C compiler, and for numbers on a GPU or of another precision.

    Args:
        x: nodes, ``(R, T, n_x)``.
        a: d x_next / d x, ``(R, T, n_x, n_x)``.
        b: d x_next / d theta, ``(R, T, n_x, n_f)``.
        x_next: Phi of each node, ``(R, T, n_x)``.
    """
    if (code := _code_for(x, a, b, x_next)) is None:
        return None
    (rows, samples, n_x), n_f = x.shape, b.shape[-1]
    chain = x.new_empty(rows, samples, n_x, n_x + n_f + 1)
    block = x.new_empty(BLOCK, n_x, n_x + n_f + 1)
    strides = torch.tensor([*a.stride(), *b.stride(), *x_next.stride()], device="cpu")
    sizes = (rows, samples, n_x, n_f, BLOCK)
    call(code, "condense", chain, block, x.contiguous(), a, b, x_next, strides, *sizes)
    return chain


def forced(through: Tensor, a: Tensor, b: Tensor, inputs: Tensor) -> Tensor:
    """Outputs ``(R, T, n_y, n_w)`` of linear maps that begin at zero, under inputs: in C where that can be.

    Args:
        through: outputs by states, ``(R, T, n_y, n_x)``.
        a: the next states by the states, ``(R, T, n_x, n_x)``.
        b: the next states by the input, ``(R, T, n_x)``.
        inputs: each a column of its own, ``(R, T, n_w)``.
    """
    parts = [part.contiguous() for part in (through, a, b, inputs)]
    (rows, samples, n_y, n_x), n_w = through.shape, inputs.shape[-1]
    found, state = through.new_empty(rows, samples, n_y, n_w), through.new_zeros(2, n_x, n_w)
    if (code := _code_for(*parts)) is not None:
        call(code, "forced", found, *state, *parts, rows, samples, n_x, n_y, n_w)
        return found
    now = state[0].expand(rows, n_x, n_w)
    for k in range(samples):  # a state at a time: those of all samples would not fit the cache
        found[:, k] = through[:, k] @ now
        now = torch.baddbmm(b[:, k, :, None] * inputs[:, k, None], a[:, k], now)
    return found


def _code_for(*parts: Tensor) -> ctypes.CDLL | None:
    """The compiled recursions; None without a C compiler, and for numbers on a GPU or of another precision."""
    plain = all(part.device.type == "cpu" and part.dtype == torch.float64 for part in parts)
    return _condensing() if plain else None


@functools.cache
def _condensing() -> ctypes.CDLL | None:
    try:
        source = resources.files("hybrid_id.simulation").joinpath("condense.c").read_text(encoding="utf-8")
        return library(source, ("condense", "forced"))
    except InputError:
        return None


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

    Channels and sample times may have fewer rows, of which R is a multiple: then they repeat.
    """
    if supports_compiled(system, engine, x):
        return compiled.shoot(system, engine, x, u, dt, theta, length)
    rows, samples, n_x = x.shape
    chunks = -(-samples // length)
    pad = chunks * length - samples

    def chunked(tensor: Tensor) -> Tensor:
        tensor = tensor.repeat(rows // len(tensor), 1)
        return torch.nn.functional.pad(tensor, (0, pad)).reshape(rows * chunks, length)

    starts = x[:, ::length].reshape(rows * chunks, n_x)
    steps = chunked(dt).unbind(1)
    channels = {name: chunked(channel).unbind(1) for name, channel in u.items()}
    shared = bool((theta == theta[:, :1]).all())
    p = system.views([*(theta[:, :1] if shared else theta.repeat_interleave(chunks, 1))])
    state = list(starts.unbind(1))
    path = [starts]
    for k in range(length - 1):
        held = {name: c[k] for name, c in channels.items()}
        state = engine.sample(system, state, held, steps[k], p)
        path.append(torch.stack(state, -1))
    return torch.stack(path, 1).reshape(rows, chunks * length, n_x)[:, :samples]
