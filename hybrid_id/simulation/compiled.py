"""Compiled engine: the smooth engine's sub-steps and their condensed sensitivities as vector code for this machine.

One sub-step of the equations of motion and its Jacobian are recorded (see :mod:`hybrid_id.simulation.tracing`) and
become the body of a loop over neighbouring samples, which a C compiler turns into vector instructions. Around it, the
sub-steps are chained and the samples condensed while they are still in the processor's cache. Compilation takes about a
second and needs a C compiler; it is opt-in (``Engine(compiled=True)``). The dry engine's events depend on the data:
its lanes are walked one by one (see :mod:`hybrid_id.simulation.compiled_dry`).
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any
from weakref import WeakKeyDictionary

import torch
from torch import Tensor

from hybrid_id.simulation.c_code import TEMPLATE, WIDTH, call, library
from hybrid_id.simulation.step import Engine
from hybrid_id.simulation.tracing import DECLARED, record
from hybrid_id.systems.chain import System

_OF_SYSTEM: WeakKeyDictionary[System, dict[tuple[Any, ...], ctypes.CDLL]] = WeakKeyDictionary()


def serves(system: System, engine: Engine, x: Tensor) -> bool:
    """Whether compiled sub-steps are asked for and possible here: smooth friction, no network, delay or GPU."""
    here = x.device.type == "cpu" and x.dtype == torch.float64
    plain = not system.networks and not any(j.drive.delay for j in system.joints)
    return engine.compiled and engine.friction == "smooth" and plain and here


class CompiledStep:
    """Compiled sub-steps of one structure of system; parameter values stay free.

    Args:
        system: equations of motion.
        engine: gives the number of sub-steps and the smoothing width.
        channels: names of the channels.
        free: indices of the parameters to differentiate by; empty for states alone.

    Raises:
        InputError: there is no C compiler, or the model uses an operation that has no C expression.
    """

    def __init__(self, system: System, engine: Engine, channels: Sequence[str], free: Sequence[int]) -> None:
        self.system, self.engine = system, engine
        self.channels, self.free = tuple(channels), tuple(free)
        self.n_x = len(system.state_names)
        known, key = _OF_SYSTEM.setdefault(system, {}), (engine.width, self.channels, self.free)
        if key not in known:
            known[key] = library(self.source())
        self.library = known[key]

    def shoot(self, x: Tensor, u: Mapping[str, Tensor], dt: Tensor, theta: Tensor, length: int) -> Tensor:
        """Nodes ``(R, T, n_x)`` with those inside each chunk of ``length`` replaced by a rollout of its first."""
        rows, samples, _ = x.shape
        path = x.contiguous().clone()
        if length >= samples:  # one chunk a row: the rows are the lanes
            self._call("walk", path, *self._point(u, dt, theta), rows, samples)
            return path
        self._call("shoot", path, *self._point(u, dt, theta), rows, samples, length)
        return path

    def condensed(self, x: Tensor, u: Mapping[str, Tensor], dt: Tensor, theta: Tensor) -> Tensor:
        """Condensed sensitivities of the nodes ``(R, T, n_x, n_x + n_f + 1)``, see :func:`lifted.condense`."""
        rows, samples, n_x = x.shape
        chain = x.new_empty(rows, samples, n_x, n_x + len(self.free) + 1)
        self._call("condensed", chain, x.contiguous(), *self._point(u, dt, theta), rows, samples)
        return chain

    def _point(self, u: Mapping[str, Tensor], dt: Tensor, theta: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        held = torch.stack([u[name] for name in self.channels]) if self.channels else dt.new_empty(0)
        return held, dt / self.engine.substeps, theta.T.contiguous()

    def _call(self, name: str, *arguments: Tensor | int) -> None:
        call(self.library, name, *arguments, self.engine.substeps)

    # --- the code --------------------------------------------------------------------------------------------------

    def source(self) -> str:
        """C code of this structure."""
        n_x, n_f, n_u = self.n_x, len(self.free), len(self.channels)
        start = [0.1] * n_x + [1.0] * n_u + [1e-3] + [float(value) for value in self.system.theta().detach()]
        names = [f"x{i}" for i in range(n_x)] + [f"u{i}" for i in range(n_u)] + ["h"]
        names += [f"p{i}" for i in range(len(self.system.table))]
        load = [f"const double x{i} = x[{i}][l];" for i in range(n_x)]
        load += [f"const double u{i} = u[{i}][l];" for i in range(n_u)]
        parameters = [f"const double p{i} = p[{i}];" for i in range(len(self.system.table))]
        plain, after = record(self._advance, names, start)
        whole, results = record(self._jacobian, names, start)
        columns = n_x + n_f
        chained = [f"const double c{j}_{c} = c[{j}][{c}][l];" for j in range(n_x) for c in range(columns)]
        for i in range(n_x):
            row = results[n_x + i * columns : n_x + (i + 1) * columns]
            for c in range(columns):
                terms = [f"{g} * c{j}_{c}" for j, g in enumerate(row[:n_x]) if g != "0.0"]
                terms += [row[c]] if c >= n_x and row[c] != "0.0" else []
                chained.append(f"c[{i}][{c}][l] = {' + '.join(terms) or '0.0'};")

        def body(*parts: list[str]) -> str:
            return "\n".join(f"        {line}" for part in parts for line in part)

        return TEMPLATE.substitute(
            functions=DECLARED,
            n_x=n_x, n_u=max(n_u, 1), held=n_u, n_f=n_f, n_p=len(self.system.table), width=WIDTH,
            parameters="\n".join(f"    {line}" for line in parameters),
            row_parameters=body([f"const double p{i} = p[{i}][l];" for i in range(len(self.system.table))]),
            states=body(load, plain, [f"x[{i}][l] = {a};" for i, a in enumerate(after)]),
            tangents=body(load, whole, chained, [f"x[{i}][l] = {a};" for i, a in enumerate(results[:n_x])]),
        )  # fmt: skip

    def _advance(self, *rows: Tensor) -> list[Tensor]:
        x, held, h = rows[: self.n_x], rows[self.n_x :], rows[self.n_x + len(self.channels)]
        p = self.system.views(rows[self.n_x + len(self.channels) + 1 :])
        channels = dict(zip(self.channels, held[: len(self.channels)], strict=True))
        return replace(self.engine, substeps=1).sample(self.system, x, channels, h, p)

    def _jacobian(self, *rows: Tensor) -> list[Tensor]:
        first = self.n_x + len(self.channels) + 1
        wanted = [*range(self.n_x), *(first + i for i in self.free)]
        leaves = [row.detach().requires_grad_(k in wanted) for k, row in enumerate(rows)]
        with torch.enable_grad():
            after = self._advance(*leaves)
            sums = [target.sum() for target in after]
        found = [a.detach() for a in after]
        for target, total in zip(after, sums, strict=True):
            grads = torch.autograd.grad(
                total, [leaves[k] for k in wanted], retain_graph=True, allow_unused=True
            )
            found += [torch.zeros_like(target) if g is None else g for g in grads]
        return found
