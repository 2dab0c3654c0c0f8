"""Compiled engine: the smooth engine's sub-steps and their condensed sensitivities as vector code for this machine.

One RK4 step of the equations of motion and its Jacobian are recorded (see :mod:`hybrid_id.simulation.tracing`) and
become the body of a loop over neighbouring samples, which a C compiler turns into vector instructions. Around it, the
sub-steps are chained and the samples condensed while they are still in the processor's cache. Compilation takes a few
seconds and pays off on long jobs; it is opt-in (``Engine(compiled=True)``). The dry engine's events depend on the
data, so it always runs eagerly.
"""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from string import Template
from typing import Any

import torch
from torch import Tensor

from hybrid_id.errors import InputError
from hybrid_id.simulation.step import Engine, rk4
from hybrid_id.simulation.tracing import FUNCTIONS, record
from hybrid_id.systems.chain import System

FLAGS = (
    "-O3", "-march=native", "-std=gnu11", "-fPIC", "-fno-math-errno", "-fno-trapping-math", "-fno-signed-zeros",
    "-ffinite-math-only", "-freciprocal-math", "-ffp-contract=fast", "-fopenmp-simd",
)  # fmt: skip
WIDTH = 16
"""Neighbouring samples that a loop of vector instructions takes at once."""

_CACHE: dict[tuple[Any, ...], ctypes.CDLL] = {}


def serves(system: System, engine: Engine) -> bool:
    """Whether compiled sub-steps are asked for and possible here (smooth friction, no states that remember)."""
    return engine.compiled and engine.friction == "smooth" and not system.memory_rows


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
        key = (tuple(system.components), system.gear_ratio, engine.width, self.channels, self.free)
        if key not in _CACHE:
            _CACHE[key] = _build(self.source())
        self.library = _CACHE[key]

    def shoot(self, x: Tensor, u: Mapping[str, Tensor], dt: Tensor, theta: Tensor, length: int) -> Tensor:
        """Nodes ``(R, T, n_x)`` with those inside each chunk of ``length`` replaced by a rollout of its first."""
        rows, samples, _ = x.shape
        path = x.contiguous().clone()
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
        values = [
            ctypes.c_void_p(a.data_ptr()) if isinstance(a, Tensor) else ctypes.c_long(a) for a in arguments
        ]
        getattr(self.library, name)(*values, ctypes.c_long(self.engine.substeps))

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
            functions="\n".join(f'__attribute__((simd("notinbranch"))) double {f}(double);' for f in FUNCTIONS),
            n_x=n_x, n_u=max(n_u, 1), held=n_u, n_f=n_f, n_p=len(self.system.table), width=WIDTH,
            parameters="\n".join(f"    {line}" for line in parameters),
            states=body(load, plain, [f"x[{i}][l] = {a};" for i, a in enumerate(after)]),
            tangents=body(load, whole, chained, [f"x[{i}][l] = {a};" for i, a in enumerate(results[:n_x])]),
        )  # fmt: skip

    def _advance(self, *rows: Tensor) -> list[Tensor]:
        x, held, h = rows[: self.n_x], rows[self.n_x :], rows[self.n_x + len(self.channels)]
        p = self.system.views(rows[self.n_x + len(self.channels) + 1 :])
        channels = dict(zip(self.channels, held[: len(self.channels)], strict=True))
        return rk4(x, h, lambda now: self.system.rates(now, channels, p, width=self.engine.width))

    def _jacobian(self, *rows: Tensor) -> list[Tensor]:
        first = self.n_x + len(self.channels) + 1
        wanted = [*range(self.n_x), *(first + i for i in self.free)]
        leaves = [row.detach().requires_grad_(k in wanted) for k, row in enumerate(rows)]
        with torch.enable_grad():
            after = self._advance(*leaves)
        found = [a.detach() for a in after]
        for target in after:
            grads = torch.autograd.grad(
                target,
                [leaves[k] for k in wanted],
                torch.ones_like(target),
                retain_graph=True,
                allow_unused=True,
            )
            found += [torch.zeros_like(target) if g is None else g for g in grads]
        return found


def _build(source: str) -> ctypes.CDLL:
    compiler = next((c for c in ("gcc", "clang", "cc") if shutil.which(c)), None)
    if compiler is None:
        raise InputError("Compiled steps need a C compiler; install gcc, or leave 'compiled' off.")
    with tempfile.TemporaryDirectory() as folder:
        code, library = Path(folder) / "steps.c", Path(folder) / "steps.so"
        code.write_text(source)
        vectors = ["-lmvec"] if "gcc" in compiler else []
        for extra in (vectors, []):
            done = subprocess.run(
                [compiler, *FLAGS, "-shared", str(code), "-o", str(library), *extra, "-lm"],
                capture_output=True, text=True,
            )  # fmt: skip
            if done.returncode == 0:
                return ctypes.CDLL(str(library))
        raise InputError(
            f"The C compiler {compiler} failed, leave 'compiled' off: {done.stderr.strip()[-300:]}"
        )


TEMPLATE = Template("""\
#include <math.h>
$functions
#define W $width
enum { NX = $n_x, NU = $n_u, HELD = $held, NF = $n_f, NP = $n_p, NC = NX + NF, ALL = NC + 1 };

static void states(double x[NX][W], double u[NU][W], double step[W], const double *p)
{
$parameters
    #pragma omp simd
    for (int l = 0; l < W; l++) {
        const double h = step[l];
$states
    }
}

static void tangents(double x[NX][W], double c[NX][NC][W], double u[NU][W], double step[W], const double *p)
{
$parameters
    #pragma omp simd
    for (int l = 0; l < W; l++) {
        const double h = step[l];
$tangents
    }
}

static void hold(const double *u, const double *dt, long size, long at, long stride, int lanes,
                 double held[NU][W], double h[W])
{
    for (int l = 0; l < W; l++) {
        const long k = at + (l < lanes ? l : lanes - 1) * stride;
        for (int i = 0; i < HELD; i++) held[i][l] = u[i * size + k];
        h[l] = dt[k];
    }
}

void shoot(double *path, const double *u, const double *dt, const double *p, long rows, long samples, long length,
           long sub_steps)
{
    double x[NX][W], held[NU][W], h[W];
    for (long r = 0; r < rows; r++)
        for (long first = 0; first < samples; first += W * length) {
            const long left = (samples - first + length - 1) / length, at = r * samples + first;
            const int lanes = left < W ? left : W;
            for (int l = 0; l < W; l++)
                for (int i = 0; i < NX; i++)
                    x[i][l] = path[(at + (l < lanes ? l : lanes - 1) * length) * NX + i];
            for (long k = 0; k + 1 < length; k++) {
                int open = lanes;
                while (open > 0 && first + (open - 1) * length + k + 1 >= samples) open--;
                if (open == 0) break;
                hold(u, dt, rows * samples, at + k, length, open, held, h);
                for (long s = 0; s < sub_steps; s++) states(x, held, h, p + r * NP);
                for (int l = 0; l < open; l++)
                    for (int i = 0; i < NX; i++) path[(at + l * length + k + 1) * NX + i] = x[i][l];
            }
        }
}

void condensed(double *chain, const double *nodes, const double *u, const double *dt, const double *p, long rows,
               long samples, long sub_steps)
{
    double x[NX][W], c[NX][NC][W], held[NU][W], h[W];
    for (long r = 0; r < rows; r++) {
        double *now = chain + r * samples * NX * ALL;
        for (int i = 0; i < NX; i++)
            for (int j = 0; j < ALL; j++) now[i * ALL + j] = i == j;
        for (long first = 0; first + 1 < samples; first += W) {
            const long at = r * samples + first;
            const int lanes = samples - 1 - first < W ? samples - 1 - first : W;
            for (int l = 0; l < W; l++)
                for (int i = 0; i < NX; i++) {
                    x[i][l] = nodes[(at + (l < lanes ? l : lanes - 1)) * NX + i];
                    for (int j = 0; j < NC; j++) c[i][j][l] = i == j;
                }
            hold(u, dt, rows * samples, at, 1, lanes, held, h);
            for (long s = 0; s < sub_steps; s++) tangents(x, c, held, h, p + r * NP);
            for (int l = 0; l < lanes; l++) {
                double *next = now + NX * ALL;
                for (int i = 0; i < NX; i++) {
                    for (int j = 0; j < ALL; j++) {
                        double sum = 0.0;
                        for (int m = 0; m < NX; m++) sum += c[i][m][l] * now[m * ALL + j];
                        next[i * ALL + j] = sum;
                    }
                    for (int j = NX; j < NC; j++) next[i * ALL + j] += c[i][j][l];
                    next[i * ALL + NC] += x[i][l] - nodes[(at + l + 1) * NX + i];
                }
                now = next;
            }
        }
    }
}
""")
