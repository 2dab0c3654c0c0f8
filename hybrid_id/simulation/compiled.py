"""Compiled sub-steps of the smooth engine: one traced RK4 step and its Jacobian as fused vector code.

Compilation takes 5 to 30 s and pays off on long jobs (several records, many starts or seeds); it is opt-in
(``Engine(compiled=True)``). One sub-step is compiled, not a whole sample, whose code would take minutes. The dry
engine's events depend on the data, so it always runs eagerly.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

from hybrid_id.errors import InputError
from hybrid_id.simulation.step import Engine, rk4
from hybrid_id.systems.chain import System

LANES = 4096
"""Lanes of the compiled code; blocks are padded to it, so that one shape serves every batch."""

_CACHE: dict[tuple[Any, ...], Callable[..., Any]] = {}


def serves(system: System, engine: Engine) -> bool:
    """Whether compiled sub-steps are asked for and possible here (smooth friction, no bristle states)."""
    return engine.compiled and engine.friction == "smooth" and not system.bristle_rows


class CompiledStep:
    """Compiled sub-steps of one structure of system; parameter values stay free.

    Args:
        system: equations of motion.
        engine: gives the number of sub-steps and the smoothing width.
        channels: names of the channels, in the order in which they are passed.
        free: indices of the parameters to differentiate by; empty for states alone.

    Raises:
        InputError: there is no C++ compiler.
    """

    def __init__(self, system: System, engine: Engine, channels: Sequence[str], free: Sequence[int]) -> None:
        if shutil.which("g++") is None and shutil.which("c++") is None and shutil.which("clang++") is None:
            raise InputError("Compiled steps need a C++ compiler; install g++, or leave 'compiled' off.")
        self.system, self.engine = system, engine
        self.channels, self.free = tuple(channels), tuple(free)
        self.n_x = len(system.state_names)

    def states(self, x: Tensor, u: Tensor, dt: Tensor, theta: Tensor) -> Tensor:
        """States ``(n_x, B)`` after ``dt`` from states ``(n_x, B)``, channels ``(n_u, B)``, parameters ``(n_p, B)``."""
        count = x.shape[1]
        x, u, h, theta = (_padded(t) for t in (x, u, dt / self.engine.substeps, theta))
        step = self._compiled("states", self._states, x, u, h, theta)
        for _ in range(self.engine.substeps):
            x = step(x, u, h, theta)
        return x[:, :count]

    def jacobian(self, x: Tensor, u: Tensor, dt: Tensor, theta: Tensor) -> tuple[Tensor, Tensor]:
        """The states after ``dt``, and ``(n_x, n_x + n_f, B)``: their Jacobian by the first states and parameters."""
        count = x.shape[1]
        x, u, h, theta = (_padded(t) for t in (x, u, dt / self.engine.substeps, theta))
        chain = x.new_zeros(self.n_x, self.n_x + len(self.free), x.shape[1])
        chain[range(self.n_x), range(self.n_x)] = 1.0
        step = self._compiled("jacobian", self._jacobian, x, chain, u, h, theta)
        for _ in range(self.engine.substeps):
            x, chain = step(x, chain, u, h, theta)
        return x[:, :count], chain[..., :count]

    def _compiled(self, name: str, function: Callable[..., Any], *example: Tensor) -> Callable[..., Any]:
        key = (name, tuple(self.system.components), self.system.gear_ratio, self.engine.width, self.channels)
        key += (self.free, example[0].dtype, example[0].device, example[0].shape)
        if key not in _CACHE:
            from torch.fx.experimental.proxy_tensor import make_fx

            _CACHE[key] = torch.compile(
                make_fx(lambda *arguments: function(*arguments))(*example), dynamic=False
            )
        step = _CACHE[key]

        def run(*arguments: Tensor) -> Any:
            with torch.no_grad():
                return step(*arguments)

        return run

    def _advance(self, x: list[Tensor], u: Tensor, h: Tensor, theta: list[Tensor]) -> list[Tensor]:
        p, channels = self.system.views(theta), dict(zip(self.channels, u.unbind(0), strict=True))
        return rk4(x, h, lambda now: self.system.rates(now, channels, p, width=self.engine.width))

    def _states(self, x: Tensor, u: Tensor, h: Tensor, theta: Tensor) -> Tensor:
        return torch.stack(self._advance(list(x.unbind(0)), u, h, list(theta.unbind(0))))

    def _jacobian(
        self, x: Tensor, chain: Tensor, u: Tensor, h: Tensor, theta: Tensor
    ) -> tuple[Tensor, Tensor]:
        leaves = [row.detach().requires_grad_() for row in x.unbind(0)]
        values = [row.detach().requires_grad_(i in self.free) for i, row in enumerate(theta.unbind(0))]
        wanted = [*leaves, *(values[i] for i in self.free)]
        with torch.enable_grad():
            after = self._advance(leaves, u, h, values)
        rows = []
        for target in after:
            grads = torch.autograd.grad(target.sum(), wanted, retain_graph=True, allow_unused=True)
            grads = [torch.zeros_like(h) if g is None else g for g in grads]
            through = [
                sum((g * chain[j, c] for j, g in enumerate(grads[: self.n_x])), torch.zeros_like(h))
                for c in range(len(wanted))
            ]
            rows.append(torch.stack([t if c < self.n_x else t + grads[c] for c, t in enumerate(through)]))
        return torch.stack([a.detach() for a in after]), torch.stack(rows)


def _padded(tensor: Tensor) -> Tensor:
    """The last axis up to the next multiple of LANES; the padding repeats the last lane, so that it stays finite."""
    missing = -tensor.shape[-1] % LANES
    if missing == 0:
        return tensor.contiguous()
    return torch.cat([tensor, tensor[..., -1:].expand(*tensor.shape[:-1], missing)], -1)
