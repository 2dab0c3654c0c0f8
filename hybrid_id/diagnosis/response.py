"""What the outputs of a fitted model would do if a torque of any shape acted beside it: one linearisation tells.

The response to a torque ``w(t) = sum_i c_i phi_i(t)`` at one side of a joint is linear in c to first order. The sample
maps are linearised once along the measured motion, cut into windows so that small errors stay small; every basis
function is then one more column of the recursion that chains sensitivities. What the start states and the model's own
parameters could explain is projected out before c is estimated (the score test with nuisance parameters: D. R. Cox and
D. V. Hinkley, Theoretical Statistics, 1974, section 9.3).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from hybrid_id.components.load.constant_torque import ConstantTorque
from hybrid_id.components.motor.rotor_bias import RotorBias
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.lifted import Linearisation, condense, forced, linearise
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.chain import System

WINDOW = 0.4
"""Length [s] of the windows over which a linear response is trusted; each has a start state of its own."""
FOLDS = 5
"""Parts that the windows of a single record are dealt to."""
RIDGE = 1e-3
"""Ridge of the regression, relative to the strongest column."""
FREE_RIDGE = 1e-6
"""The same where every window has a torque of its own, relative to the mean column."""


@dataclass(frozen=True, eq=False)
class Response:
    """A fitted model, opened for torques at one side of one joint.

    Attributes:
        side: ``"motor"`` or ``"load"``.
        joint: number, from 1.
        row: of the angle on that side in the state; its speed is the next.
        batch: the records.
        index: samples of each window in its record, ``(W, L)``.
        record: of each window, ``(W,)``.
        lin: the linearisation of the windows, the torque its only parameter.
        x: their measured states, ``(W, L, n_x)``.
        own: for each window what the model's own parameters can do, ``(W, L n_y, n_f)``, its start state projected out.
        left: for each window the weighted residuals alike, ``(W, L n_y)``.
        start: an orthonormal basis of what its start state can do, ``(W, L n_y, n_x)``.
        weight: of the measurements, ``(W, L, n_y)``.
    """

    side: str
    joint: int
    row: int
    batch: Batch
    index: Tensor
    record: Tensor
    lin: Linearisation
    x: Tensor
    own: Tensor
    left: Tensor
    start: Tensor
    weight: Tensor

    def thinned(self, every: int) -> Response:
        """The same with every so many of its windows."""
        some = {
            name: getattr(self, name)[::every]
            for name in ("index", "record", "x", "own", "left", "start", "weight")
        }
        lin = replace(
            self.lin,
            **{name: getattr(self.lin, name)[::every] for name in ("y", "c", "d", "x_next", "a", "b")},
        )
        return replace(self, lin=lin, **some)

    def within(self, signal: Tensor) -> Tensor:
        """What a signal of the records ``(R, T, ...)`` is within the windows, ``(W, L, ...)``."""
        return signal[self.record[:, None], self.index]

    def chained(self, waves: Tensor) -> Tensor:
        """Weighted response of the windows' outputs to torques [N m] within them, ``(W, L, m)``: ``(W, L n_y, m)``."""
        through = self.lin.c * self.weight[..., None]
        found = forced(through, self.lin.a, self.lin.b[..., 0], waves).flatten(1, 2)
        return torch.baddbmm(found, self.start, self.start.transpose(1, 2) @ found, alpha=-1.0)

    def unexplained(self, knot: float) -> tuple[np.ndarray, np.ndarray]:
        """Squares that a torque of any course in time cannot explain, and all of them, in each window, ``(W,)``.

        Each window has a torque of its own, smooth over a time; both are per degree of freedom, so that noise alone
        leaves them equal.

        Args:
            knot: distance of the bumps that make up the torque [s].
        """
        length = self.index.shape[1]
        count = max(2, round(length * self.batch.sample_time / knot))
        waves = bumps(torch.linspace(0.0, 1.0, length, dtype=self.x.dtype), count, 0.0, 1.0)
        columns = self.chained(waves.expand(len(self.record), length, count))
        columns = columns / columns.square().sum((0, 1)).sqrt().max().clamp_min(1e-300)
        squares = columns.transpose(1, 2) @ columns
        ridge = FREE_RIDGE * squares.diagonal(dim1=1, dim2=2).mean().clamp_min(1e-300)
        slopes = columns.transpose(1, 2) @ self.left[..., None]
        found = torch.linalg.solve(squares + ridge * torch.eye(count, dtype=squares.dtype), slopes)
        rest = self.left - (columns @ found)[..., 0]
        freedom = self.left.shape[1] - self.x.shape[2]
        return (
            (rest.square().sum(1) / max(freedom - count, 1)).numpy(),
            (self.left.square().sum(1) / max(freedom, 1)).numpy(),
        )

    def explained(self, waves: Tensor) -> tuple[float, np.ndarray]:
        """Share of the residuals' mean square that torques explain on records left out, and their coefficients.

        Of a single record every fifth window is left out.

        Args:
            waves: basis functions, ``(R, T, m)``.
        """
        columns = torch.cat([self.own, self.chained(self.within(waves))], 2)
        size = columns.square().sum((0, 1)).sqrt()
        size = size.where(size > 0, torch.ones_like(size))
        columns, n_own = columns / size, self.own.shape[2]
        ridge = torch.diag(
            torch.cat([torch.full((n_own,), 1e-9), torch.full((len(size) - n_own,), RIDGE)])
        ).to(size)
        part = self.record if bool(self.record.any()) else torch.arange(len(self.record)) % FOLDS
        count = int(part.max()) + 1
        squares = size.new_zeros(count, len(size), len(size))
        squares.index_add_(0, part, columns.transpose(1, 2) @ columns)
        slopes = size.new_zeros(count, len(size))
        slopes.index_add_(0, part, (columns.transpose(1, 2) @ self.left[..., None])[..., 0])
        energy = size.new_zeros(count).index_add_(0, part, self.left.square().sum(1))
        whole, slope = squares.sum(0) + ridge, slopes.sum(0)
        error = []
        for some in (slice(0, n_own), slice(0, len(size))):
            total = 0.0
            for h, g, e in zip(squares, slopes, energy, strict=True):
                rest, pull = (whole, slope) if count == 1 else (whole - h, slope - g)
                step = torch.linalg.lstsq(rest[some, some], pull[some][:, None], driver="gelsd").solution[
                    :, 0
                ]
                total += float(e - 2 * step @ g[some] + step @ h[some, some] @ step)
            error.append(total)
        coefficients = torch.linalg.lstsq(whole, slope[:, None], driver="gelsd").solution[:, 0] / size
        return 1.0 - error[1] / max(error[0], 1e-300), coefficients[n_own:].numpy()


def respond(system: System, engine: Engine, batch: Batch, joint: int, side: str) -> Response:
    """Open a fitted model for torques at the rotor (``motor``) or at the link (``load``) of a joint.

    Args:
        system: fitted model.
        engine: how it was fitted.
        batch: records, prepared for it.
        joint: number, from 1.
        side: ``"motor"`` or ``"load"``.
    """
    where = f"joint{joint}/{side}"
    part = RotorBias(T_0=0.0) if side == "motor" else ConstantTorque(T_0=0.0)
    key = f"{where}/{part.kind}"
    opened = system if key in system.components else system.with_component(where, part)
    table = opened.table
    torque = next(i for i, info in enumerate(table) if (info.component, info.symbol) == (key, "T_0"))
    own = [i for i, o in enumerate(table) if o.spec.estimate and (o.component != key or opened is system)]
    free = own if torque in own else [*own, torque]
    step, samples = batch.sample_time, batch.dt.shape[1]
    length = min(max(25, round(WINDOW / step)), samples)
    first = torch.arange(0, samples - length + 1, length)
    record = torch.arange(batch.rows).repeat_interleave(len(first))
    index = (first[:, None] + torch.arange(length)).repeat(batch.rows, 1)
    full = (batch.weight[record[:, None], index] > 0).any(2).all(1)
    record, index = record[full], index[full]
    at = (record[:, None], index)
    dt = batch.dt[at].clone()
    dt[:, -1] = 0.0
    x, weight, theta = batch.x[at], batch.weight[at], opened.theta().detach()[:, None].expand(-1, len(record))
    channels = {name: channel[at] for name, channel in batch.u.items()}
    smooth = engine if engine.friction == "dry" else Engine(substeps=engine.substeps)
    lin = linearise(opened, smooth, x, channels, dt, theta, free, batch.outputs)
    n_x, chained = x.shape[-1], condense(lin, x)
    through = lin.c @ chained
    through[..., n_x:-1] += lin.d
    left = ((batch.y[at] - lin.y - through[..., -1]) * weight).flatten(1, 2)
    columns = (through[..., :-1] * weight[..., None]).flatten(1, 2)
    start = torch.linalg.qr(columns[..., :n_x])[0]
    mine = columns[..., n_x : n_x + len(own)]
    mine = mine - start @ (start.transpose(1, 2) @ mine)
    left = left - (start @ (start.transpose(1, 2) @ left[..., None]))[..., 0]
    # a torque that drives is meant; the component at the link opposes
    sign, one = 1.0 if side == "motor" else -1.0, [free.index(torque)]
    only = replace(lin, b=sign * lin.b[..., one], d=lin.d[..., one])
    positions = opened.joint(joint).positions
    row = positions[0] if side == "motor" else positions[-1]
    return Response(side, joint, row, batch, index, record, only, x, mine, left, start, weight)


def bumps(signal: Tensor, count: int, low: float, high: float) -> Tensor:
    """Gaussian bumps side by side over a range, which together are flat, ``(..., count)``.

    Args:
        signal: any shape.
        count: how many.
        low: start of the range.
        high: its end.
    """
    centres = torch.linspace(low, high, count, dtype=signal.dtype)
    width = (high - low) / max(count - 1, 1) or 1.0  # a signal that never changes
    weight = torch.exp(-0.5 * ((signal[..., None] - centres) / width) ** 2)
    return weight / weight.sum(-1, keepdim=True).clamp_min(1e-12)
