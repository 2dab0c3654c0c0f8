"""Measured outputs at the nodes of a batch, with their Jacobians by states and parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from hybrid_id.systems.chain import System


@dataclass(frozen=True)
class Measured:
    """Outputs at all nodes.

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

    def chain(self, chain: Tensor) -> Tensor:
        """Sensitivities of the outputs from those of the nodes, ``(R, T, n_y, n_x + n_f + 1)``."""
        states = [pick for pick in self.picks if pick is not None]
        if len(states) == len(self.picks):
            return chain[:, :, states]
        through = self.c @ chain
        through[..., chain.shape[2] : -1] += self.d
        return through


def measure(
    system: System,
    x: Tensor,
    u: Mapping[str, Tensor],
    theta: Tensor,
    free: Sequence[int],
    outputs: Sequence[str],
) -> Measured:
    """Evaluate and differentiate the outputs at every node.

    Args:
        system: tells the outputs.
        x: nodes, ``(R, T, n_x)``.
        u: channels, ``(R, T)`` each.
        theta: all parameters in table order, ``(n_p, R)``.
        free: indices of the parameters to differentiate by.
        outputs: names of the measured outputs.
    """
    rows, samples, n_x = x.shape
    n_y, n_f = len(outputs), len(free)
    states = x[:, 0].unbind(1)  # one sample of each row tells which outputs are states
    with torch.no_grad():
        found = system.outputs(
            outputs, states, {name: channel[:, 0] for name, channel in u.items()}, system.views(list(theta))
        )
    picks = [next((j for j, state in enumerate(states) if one is state), None) for one in found]
    if all(pick is not None for pick in picks):
        c = torch.eye(n_x, dtype=x.dtype, device=x.device)[picks].expand(rows, samples, n_y, n_x)
        return Measured(x[..., picks], c, x.new_zeros(1).expand(rows, samples, n_y, n_f), tuple(picks))
    leaves = [column.reshape(-1).requires_grad_() for column in x.detach().clone().unbind(2)]
    values = list(theta.repeat_interleave(samples, 1).unbind(0))
    for i in free:
        values[i] = values[i].detach().requires_grad_()
    channels = {name: channel.reshape(-1) for name, channel in u.items()}
    with torch.enable_grad():
        found = system.outputs(outputs, leaves, channels, system.views(values))
        sums = [target.sum() for target in found]  # lanes do not mix: one sweep a row
    jacobian = x.new_zeros(rows * samples, n_y, n_x + n_f)
    wanted = [*leaves, *(values[i] for i in free)]
    for i, total in enumerate(sums):
        if total.requires_grad:
            grads = torch.autograd.grad(total, wanted, retain_graph=True, allow_unused=True)
            for j, grad in enumerate(grads):
                if grad is not None:
                    jacobian[:, i, j] = grad
    y = torch.stack([target.detach() for target in found], -1) if found else x.new_empty(rows * samples, 0)
    grid = jacobian.reshape(rows, samples, n_y, n_x + n_f)
    return Measured(y.reshape(rows, samples, n_y), grid[..., :n_x], grid[..., n_x:], tuple(picks))
