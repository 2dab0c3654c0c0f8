"""Whole rollouts of a batch for many parameter sets at once, and what they cost, as a function of parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from hybrid_id.errors import InputError
from hybrid_id.identification.fit import make_bounds
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.lifted import shoot
from hybrid_id.simulation.stability import with_substeps
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.chain import System

WORST = 1e3
"""Weighted residual that stands for a simulation that has left all bounds."""
REACH = 100.0
"""Farthest that a first state may be from the measured one, in its standard errors."""


class Rollouts:
    """Weighted residuals of a batch for many parameter sets at once.

    Args:
        system: what is simulated.
        batch: whole records.
        engine: how (its sub-steps are raised where stability asks for it).
        free: indices of the parameters that the points give.
    """

    def __init__(self, system: System, batch: Batch, engine: Engine, free: Sequence[int]) -> None:
        self.system, self.batch, self.free = system, batch, list(free)
        self.theta = system.theta().detach()
        self.engine = with_substeps(system, engine, batch, self.theta[:, None].expand(-1, batch.rows))
        # a delay changes the channels only: they arrive before the rollout, which then needs no past
        self.plain = system
        for key in [joint.drive.delay[0] for joint in system.joints if joint.drive.delay is not None]:
            where, _, kind = key.rpartition("/")
            self.plain = self.plain.without_component(where, kind)
        place = {(info.component, info.symbol): i for i, info in enumerate(system.table)}
        self.rows = [place[info.component, info.symbol] for info in self.plain.table]

    def residuals(self, points: np.ndarray, first: np.ndarray | None = None) -> np.ndarray:
        """Residuals ``(P, R, T, n_y)`` at the points ``(P, n_f)``, from first states ``(P, R, n_x)`` or the batch's."""
        rows, count = self.batch.rows, len(points)
        theta = self.theta[:, None].repeat(1, count)
        theta[self.free] = torch.tensor(points.T)
        theta = theta.repeat_interleave(rows, 1)
        part = self.batch.take(torch.arange(rows).repeat(count))
        if first is not None:
            # a batch that is taken whole is the caller's own: its first states stay as measured
            part = replace(part, x=part.x.clone()) if part is self.batch else part
            part.x[:, 0] = torch.as_tensor(first).flatten(0, 1)
        with torch.no_grad():
            samples = part.x.shape[1]
            views = self.system.views(list(theta.repeat_interleave(samples, 1)))
            channels = self.system.hold(
                {name: channel.reshape(-1) for name, channel in part.u.items()}, views
            )
            arrived = {name: channels[name].view_as(part.dt) for name in self.plain.input_names}
            arrived |= {name: channel for name, channel in part.u.items() if name.startswith("enable")}
            x = shoot(self.plain, self.engine, part.x, arrived, part.dt, theta[self.rows], samples)
            y = self.system.outputs(part.outputs, x.reshape(-1, x.shape[-1]).unbind(1), channels, views)
        run = torch.stack(y, -1).reshape(*x.shape[:2], -1)
        residual = ((part.y - run) * part.weight).nan_to_num(WORST, WORST, -WORST).clamp(-WORST, WORST)
        return residual.reshape(count, rows, *residual.shape[1:]).numpy()


@dataclass(frozen=True, eq=False)
class Slopes:
    """Slopes of a batch's residuals at one model's fit, for others that have most of their parameters from it.

    Attributes:
        parameters: of each by its component and symbol, ``(R * T * n_y,)``.
        first: of each state that is not known exactly at the start, by its name, ``(R, T * n_y)``.
        least: cost that others have to get below to be of any interest.
    """

    parameters: Mapping[tuple[str, str], np.ndarray]
    first: Mapping[str, np.ndarray]
    least: float = math.inf


class Cost:
    """Residuals of the records and of what is known beforehand, as a function of parameters and first states.

    A point holds the free parameters, then for every state that is not known exactly at the start its shift from the
    measured one in each row.

    Raises:
        InputError: nothing to estimate.
    """

    def __init__(self, system: System, batch: Batch, engine: Engine) -> None:
        free = system.estimated
        if not free:
            raise InputError("The model has no parameter to estimate; set 'estimate: true' for at least one.")
        self.rollouts, bounds = Rollouts(system, batch, engine, free), make_bounds(system, free)
        self.measured = batch.x[:, 0].numpy()
        spread = batch.x0_std.numpy()
        self.loose = [k for k in range(spread.shape[1]) if (spread[:, k] > 0).any()]
        std = np.maximum(spread[:, self.loose], 1e-12).T.reshape(-1)
        self.n_f, reach = len(free), REACH * std
        self.low = np.concatenate([bounds.lower.numpy(), -reach])
        self.high = np.concatenate([bounds.upper.numpy(), reach])
        self.mean = np.concatenate([bounds.prior_mean.numpy(), np.zeros(len(std))])
        self.precision = np.concatenate([bounds.prior_precision.numpy(), std**-2])
        self.scale, self.std = bounds.scale.numpy(), std.reshape(len(self.loose), batch.rows)
        self.keys = [(system.table[i].component, system.table[i].symbol) for i in free]
        self.states = [system.state_names[k] for k in self.loose]

    def shifts_of(self, x0: np.ndarray) -> np.ndarray:
        """Shifts of first states ``(R, n_x)``, as a point holds them."""
        shift = (x0 - self.measured)[:, self.loose].T.reshape(-1)
        return np.clip(shift, self.low[self.n_f :], self.high[self.n_f :])

    def first_states(self, points: np.ndarray) -> np.ndarray:
        """First states ``(P, R, n_x)`` of points."""
        first = np.tile(self.measured, (len(points), 1, 1))
        shifts = points[:, self.n_f :].reshape(len(points), len(self.loose), len(self.measured))
        first[:, :, self.loose] += shifts.transpose(0, 2, 1)
        return first

    def residuals(self, points: np.ndarray) -> np.ndarray:
        """Weighted residuals at points ``(P, n)``, then those of the priors."""
        runs = self.rollouts.residuals(points[:, : self.n_f], self.first_states(points))
        return np.hstack([runs.reshape(len(points), -1), np.sqrt(self.precision) * (self.mean - points)])

    def slopes(
        self, point: np.ndarray, left: np.ndarray, share: float, near: Slopes | None = None
    ) -> np.ndarray:
        """Slopes of the residuals ``left`` at a point by finite steps, a share of each parameter.

        What ``near`` has is taken from there; the rest is simulated.
        """
        known = near or Slopes({}, {})
        new = [i for i, key in enumerate(self.keys) if key not in known.parameters]
        loose = [k for k, name in enumerate(self.states) if name not in known.first]
        n_f, rows, value = self.n_f, self.std.shape[1], point[: self.n_f]
        step = share * np.maximum(np.abs(value), self.scale)
        up, down = self.high[:n_f] - value, value - self.low[:n_f]
        # inside the bounds, to the side that has more room where neither has enough
        step = np.where(step <= up, step, np.where(down >= up, -np.minimum(step, down), up))
        lanes = np.tile(point, (len(new) + len(loose), 1))
        lanes[np.arange(len(new)), new] += step[new]
        # what a row starts with moves that row alone: one lane moves them all
        for lane, k in enumerate(loose, len(new)):
            lanes[lane, n_f + k * rows : n_f + (k + 1) * rows] += self.std[k]
        data = len(left) - len(point)
        change = self.residuals(lanes)[:, :data] - left[:data] if len(lanes) else np.empty((0, data))
        slopes = np.zeros((len(left), len(point)))
        for i, key in enumerate(self.keys):
            if key in known.parameters:
                slopes[:data, i] = known.parameters[key]
        # what cannot move changes nothing
        slopes[:data, new] = (change[: len(new)] / np.where(step == 0.0, 1.0, step)[new, None]).T
        blocks = slopes[:data, n_f:].reshape(rows, data // rows, len(self.loose), rows)
        moved = dict(zip(loose, change[len(new) :].reshape(len(loose), rows, data // rows), strict=True))
        for k, name in enumerate(self.states):
            own = moved[k] / self.std[k, :, None] if k in moved else known.first[name]
            for r in range(rows):
                blocks[r, :, k, r] = own[r]
        slopes[:data, n_f:] = blocks.reshape(data, -1)
        slopes[data:] = np.diag(-np.sqrt(self.precision))
        return slopes

    def shared(self, slopes: np.ndarray) -> Slopes:
        """Slopes at a point, for models that have most of their parameters from this one."""
        rows, data = self.std.shape[1], len(slopes) - slopes.shape[1]
        blocks = slopes[:data, self.n_f :].reshape(rows, data // rows, len(self.loose), rows)
        own = [np.stack([blocks[r, :, k, r] for r in range(rows)]) for k in range(len(self.loose))]
        columns = {key: slopes[:data, i].copy() for i, key in enumerate(self.keys)}
        return Slopes(columns, dict(zip(self.states, own, strict=True)))
