"""Least squares by whole rollouts and finite differences, for models too far from the records for a linearisation.

Behind play, and where a link sticks and slips on a spring, the tangent of a trajectory grows with every event while the
trajectory itself does not: exact sensitivities tell the wrong way, and Newton's method over all samples leaves the
minimum. Differences over a hundredth of a parameter see through the events. Every difference is a lane of one compiled
rollout, and so is every trial step: the LM step of :mod:`.least_squares` for many dampings at once.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from hybrid_id.identification.fit import make_bounds
from hybrid_id.identification.least_squares import bounded_lm_step, free_parameters
from hybrid_id.identification.result import FitResult
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.lifted import shoot
from hybrid_id.simulation.stability import with_substeps
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.arm import LOAD
from hybrid_id.systems.chain import System

WORST = 1e3
"""Weighted residual that stands for a simulation that has left all bounds."""
FARTHEST_START = 100.0
"""Farthest that a first state may be from the measured one, in its standard errors."""
STEPS = (0.01, 0.1, 0.01)
"""Finite steps, as shares of the parameters: in between, a coarse one sees through the ripple of the cost."""
DAMPINGS = 10.0 ** np.arange(-2, 4)
"""Dampings that are tried side by side, relative to the last that was best."""
FEW = DAMPINGS[1:5]
"""Those of a coarse fit."""
SHORTER = 1e3
"""Factor of the damping with which a coarse fit is tried once more where it has gained nothing."""
LEAST_DAMPING, MOST_DAMPING = 1e-9, 1e6
SETTLED = 1e-4
"""A finite step has done its work when the cost falls by less than this share."""
POOR = 0.02
"""Updated slopes are simulated anew when a step lowers the cost by less than this share."""
CLOSE, PATIENCE = 1.1, 3
"""Cost, relative to the neighbouring model's, up to which a coarse fit's slopes are believed; steps after which."""


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
        batch, rows, count = self.batch, self.batch.rows, len(points)
        shape = count, rows, batch.x.shape[1]
        theta = self.theta[:, None].repeat(1, count)
        theta[self.free] = torch.tensor(points.T)
        x = batch.x.new_empty(count * rows, *batch.x.shape[1:])  # whose first samples decide the others
        x[:, 0] = batch.x[:, 0].repeat(count, 1) if first is None else torch.as_tensor(first).flatten(0, 1)
        # channels that the points delay differ from point to point; the records' own are as they are
        delayed = {name.split("@")[0] for name in batch.u if "@" in name}
        u = {
            name: channel.expand(shape) if name.split("@")[0] in delayed else channel
            for name, channel in batch.u.items()
        }
        with torch.no_grad():
            views = self.system.views(list(theta[:, :, None, None]))  # the same for all samples of a lane
            channels = self.system.hold(u, views)
            arrived = {name: channels[name].reshape(-1, shape[2]) for name in self.plain.input_names}
            arrived |= {n: c for n, c in batch.u.items() if n.startswith("enable") or LOAD in n}
            lanes = theta[self.rows].repeat_interleave(rows, 1)
            x = shoot(self.plain, self.engine, x, arrived, batch.dt, lanes, shape[2]).view(*shape, -1)
            y = self.system.outputs(batch.outputs, x.unbind(-1), channels, views)
        run = torch.stack([one.expand(shape) for one in y], -1)
        residual = torch.sub(batch.y, run, out=run).mul_(batch.weight)
        return residual.nan_to_num_(WORST, WORST, -WORST).clamp_(-WORST, WORST).numpy()


@dataclass(frozen=True, eq=False)
class Slopes:
    """Slopes of a batch's residuals at one model's fit, for others that have most of their parameters from it.

    Attributes:
        parameters: of each by its component and symbol, ``(R, T n_y)``.
        first: of each state that is not known exactly at the start, by its name, ``(R, T n_y)``.
        x0: these states there, by their names, ``(R,)``.
        least: cost that others have to get below to be of any interest.
    """

    parameters: Mapping[tuple[str, str], np.ndarray]
    first: Mapping[str, np.ndarray]
    x0: Mapping[str, np.ndarray]
    least: float = math.inf

    def of_rows(self, rows: np.ndarray) -> Slopes:
        """The slopes of some rows of the batch."""
        parameters = {key: slope[rows] for key, slope in self.parameters.items()}
        first, x0 = ({name: s[rows] for name, s in of.items()} for of in (self.first, self.x0))
        return replace(self, parameters=parameters, first=first, x0=x0)


class Cost:
    """Residuals of the records and of what is known beforehand, as a function of parameters and first states.

    A point holds the free parameters, then for every state that is not known exactly at the start its shift from the
    measured one in each row. A row's residuals depend on the parameters and its own states alone: its slopes by these,
    ``(R, n_f + n_s, T n_y)``, are all that are kept.

    Raises:
        InputError: nothing to estimate.
    """

    def __init__(self, system: System, batch: Batch, engine: Engine) -> None:
        free = free_parameters(system)
        self.rollouts, bounds = Rollouts(system, batch, engine, free), make_bounds(system, free)
        self.measured = batch.x[:, 0].numpy()
        spread = batch.x0_std.numpy()
        self.loose = [k for k in range(spread.shape[1]) if (spread[:, k] > 0).any()]
        std = np.maximum(spread[:, self.loose], 1e-12).T.reshape(-1)
        self.n_f, reach = len(free), FARTHEST_START * std
        self.start = self.rollouts.theta.numpy()[free]
        self.low = np.concatenate([bounds.lower.numpy(), -reach])
        self.high = np.concatenate([bounds.upper.numpy(), reach])
        self.mean = np.concatenate([bounds.prior_mean.numpy(), np.zeros(len(std))])
        self.precision = np.concatenate([bounds.prior_precision.numpy(), std**-2])
        self.scale, self.std = bounds.scale.numpy(), std.reshape(len(self.loose), batch.rows)
        self.keys = [(system.table[i].component, system.table[i].symbol) for i in free]
        self.states = [system.state_names[k] for k in self.loose]
        states = self.n_f + np.arange(len(std)).reshape(self.std.shape).T
        self.places = np.hstack([np.tile(np.arange(self.n_f), (batch.rows, 1)), states])
        """Where a point has what each row depends on, ``(R, n_f + n_s)``."""

    def point(self, values: np.ndarray, x0: np.ndarray) -> np.ndarray:
        """The point of parameters ``(n_f,)`` and first states ``(R, n_x)``, inside the bounds."""
        shift = (x0 - self.measured)[:, self.loose].T.reshape(-1)
        return np.clip(np.concatenate([values, shift]), self.low, self.high)

    def first_states(self, points: np.ndarray) -> np.ndarray:
        """First states ``(P, R, n_x)`` of points."""
        first = np.tile(self.measured, (len(points), 1, 1))
        shifts = points[:, self.n_f :].reshape(len(points), len(self.loose), len(self.measured))
        first[:, :, self.loose] += shifts.transpose(0, 2, 1)
        return first

    def residuals(self, points: np.ndarray) -> np.ndarray:
        """Weighted residuals of each row at points ``(P, n)``, ``(P, R, T n_y)``."""
        runs = self.rollouts.residuals(points[:, : self.n_f], self.first_states(points))
        return runs.reshape(len(points), len(self.measured), -1)

    def costs(self, points: np.ndarray, residuals: np.ndarray) -> np.ndarray:
        """Cost at points ``(P, n)``, that of the priors included, ``(P,)``."""
        flat = residuals.reshape(len(points), 1, -1)
        data = (flat @ flat.transpose(0, 2, 1))[:, 0, 0]
        return 0.5 * (data + (self.precision * np.square(points - self.mean)).sum(1))

    def slopes(
        self, point: np.ndarray, left: np.ndarray, share: float, near: Slopes | None = None
    ) -> np.ndarray:
        """Slopes of the residuals ``left`` at a point by finite steps, a share of each parameter.

        What ``near`` has is taken from there; the rest is simulated.
        """
        known = near or Slopes({}, {}, {})
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
        slopes = np.empty((rows, n_f + len(self.states), left.shape[1]))
        for i, key in enumerate(self.keys):
            if key in known.parameters:
                slopes[:, i] = known.parameters[key]
        for k, name in enumerate(self.states, n_f):
            if name in known.first:
                slopes[:, k] = known.first[name]
        if len(lanes):
            moved = self.residuals(lanes)
            moved -= left
            # what cannot move changes nothing
            moved[: len(new)] /= np.where(step == 0.0, 1.0, step)[new, None, None]
            moved[len(new) :] /= self.std[loose, :, None]
            slopes[:, [*new, *(n_f + k for k in loose)]] = moved.transpose(1, 0, 2)
        return slopes

    def steps(
        self, point: np.ndarray, residual: np.ndarray, slopes: np.ndarray, dampings: np.ndarray
    ) -> np.ndarray:
        """Points to which an LM step leads inside the bounds, one for each damping, ``(D, n)``.

        First states follow the parameters, damped as these are; those that a bound holds stay, others end at it.
        """
        n_f, states, count = self.n_f, self.places[:, self.n_f :], len(dampings)
        gradient = self.precision * (point - self.mean)
        np.add.at(gradient, self.places, (slopes @ residual[..., None])[..., 0])
        squares = slopes @ slopes.transpose(0, 2, 1)
        hessian = squares[:, :n_f, :n_f].sum(0) + np.diag(self.precision[:n_f])
        pull, now = gradient[states], point[states]
        held = ((now <= self.low[states]) & (pull > 0)) | ((now >= self.high[states]) & (pull < 0))
        free, own = 1.0 - held, np.arange(states.shape[1])
        cross = squares[:, n_f:, :n_f] * free[..., None]
        starts = squares[:, n_f:, n_f:] * (free[:, None] * free[..., None])
        starts[:, own, own] += np.where(held, 1.0, self.precision[states])
        starts = np.tile(starts, (count, 1, 1, 1))
        starts[:, :, own, own] *= 1.0 + dampings[:, None, None]
        right = np.concatenate([cross, (pull * free)[..., None]], 2)
        back = np.linalg.solve(starts, np.broadcast_to(right, (count, *right.shape)))
        through = (cross.transpose(0, 2, 1) @ back).sum(1)
        unit = np.diagonal(hessian)
        unit = torch.as_tensor(np.maximum(unit, max(1e-12 * unit.max(), 1e-300)) ** -0.5).expand(count, -1)
        low, high = (
            torch.as_tensor((limit - point)[:n_f]).expand_as(unit) for limit in (self.low, self.high)
        )
        step = bounded_lm_step(
            torch.as_tensor(hessian - through[..., :-1]),
            torch.as_tensor(gradient[:n_f] - through[..., -1]),
            unit, torch.as_tensor(dampings)[:, None].expand_as(unit), low, high,
        )[0]  # fmt: skip
        shift = (step * unit).numpy()
        follow = -back[..., -1] - (back[..., :-1] @ shift[:, None, :, None])[..., 0]
        shift = np.hstack([shift, follow.transpose(0, 2, 1).reshape(count, -1)])
        return np.clip(point + shift, self.low, self.high)

    def promised(self, to: np.ndarray, point: np.ndarray, residual: np.ndarray, slopes: np.ndarray) -> float:
        """Cost that slopes at a point promise at another one."""
        left = residual + ((to - point)[self.places][:, None] @ slopes)[:, 0]
        return float(self.costs(to[None], left)[0])

    def eliminated(self, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Slopes by the parameters while each row's first states follow these, and how they do.

        As in :meth:`steps`, but undamped and whatever the bounds.

        Returns:
            These slopes, ``(R, n_f, T n_y)``, and the slopes of a point's first states, ``(n_s R, n_f)``.
        """
        by_values, starts = slopes[:, : self.n_f], slopes[:, self.n_f :]
        squares = starts @ starts.transpose(0, 2, 1)
        own = np.arange(starts.shape[1])
        squares[:, own, own] += self.precision[self.places[:, self.n_f :]]
        follow = -np.linalg.solve(squares, starts @ by_values.transpose(0, 2, 1))
        along = by_values + follow.transpose(0, 2, 1) @ starts
        return along, follow.swapaxes(0, 1).reshape(-1, self.n_f)


def finite_difference_fit(
    system: System,
    batch: Batch,
    *,
    engine: Engine,
    iterations: int = 20,
    x0: np.ndarray | None = None,
    near: Slopes | None = None,
    begin: Slopes | None = None,
    tangents: bool = True,
    shares: Sequence[float] = STEPS,
    least_gain: float = 0.0,
) -> FitResult:
    """Fit one parameter set and the first states of all rows of a batch.

    With ``near`` the fit is a coarse one, which ends where it comes to nothing: only what the neighbouring model lacks,
    if anything, is simulated for the first slopes, and every step updates them by Broyden's formula in scaled
    parameters (Math. Comp. 19, 1965), for each row by what it depends on alone (L. K. Schubert, Math. Comp. 24, 1970);
    new ones are simulated only where the first step by borrowed ones gains little.

    Args:
        system: model with start values and bounds.
        batch: prepared records.
        engine: how a sample is integrated; compiled rollouts make this affordable.
        iterations: steps at most.
        x0: where the search for the first states starts, ``(R, n_x)`` (default: those of ``near``, else as measured).
        near: slopes of a model close to the start, to begin with.
        begin: slopes at the start itself, where they are known; further ones are simulated.
        tangents: whether the result has a Jacobian; without one it has no standard errors, and is had sooner.
        shares: finite steps, as shares of the parameters, with each of which the fit goes on until it gains nothing.
        least_gain: share of the cost beyond the noise's, half a unit a sample, below which a gain is none.

    Raises:
        InputError: nothing to estimate.
    """
    cost = Cost(system, batch, engine)
    if x0 is None:  # as measured, but for what a neighbouring model's fit has found
        x0 = batch.x[:, 0].numpy().copy()
        for k, name in enumerate(system.state_names):
            x0[:, k] = x0[:, k] if near is None else near.x0.get(name, x0[:, k])
    point = cost.point(cost.start, x0)
    residual = cost.residuals(point[None])[0]
    damping, stage, history = 1e-2, 0, [float(cost.costs(point[None], residual)[0])]
    known = near or begin
    jacobian = None if known is None else cost.slopes(point, residual, shares[0], known)
    complete = known is not None and known.parameters.keys() >= set(cost.keys)
    fresh, shorter = complete, False
    noise = 0.5 * float((batch.weight > 0).sum())
    while stage < len(shares) and len(history) <= iterations:
        if jacobian is None:
            jacobian, fresh = cost.slopes(point, residual, shares[stage]), True
        dampings = np.clip(
            damping * (DAMPINGS if near is None or complete else FEW), LEAST_DAMPING, MOST_DAMPING
        )
        points = cost.steps(point, residual, jacobian, dampings)
        trials = cost.residuals(points)
        costs = cost.costs(points, trials)
        best = int(np.nanargmin(costs))
        gained, least = history[-1] - costs[best], min(history[-1], float(costs[best]))
        nothing = gained < max(SETTLED * history[-1], least_gain * (history[-1] - noise))
        # a coarse fit may be no better than what it starts beside; what its slopes promise may be believed where it has
        # come near, or after a few steps
        if (
            near is not None
            and least > (1.0 - POOR) * near.least
            and (least < CLOSE * near.least or len(history) >= PATIENCE)
            and cost.promised(points[0], point, residual, jacobian) > (1.0 - POOR) * near.least
        ):
            stage = len(shares)
        elif near is not None and nothing and (fresh or len(history) > 1):
            stage, shorter = len(shares) if shorter else stage, not shorter
        elif near is None and nothing and fresh:
            stage, jacobian, damping = stage + 1, None, 1e-2
        elif gained < POOR * history[-1] and (near is None or (len(history) == 1 and not fresh)):
            jacobian = None
        else:
            # the slopes tell the change that the step has brought, otherwise they stay as they were
            step, fresh = (points[best] - point)[cost.places], False
            along = np.einsum("rkm,rkm->rk", jacobian, jacobian) * step
            length = (along * step).sum(1, keepdims=True)
            along = np.divide(along, length, out=np.zeros_like(along), where=length > 0)
            missing = trials[best] - residual - (step[:, None] @ jacobian)[:, 0]
            jacobian += along[..., None] * missing[:, None]
        if gained > 0:
            point, residual, damping = points[best], trials[best], float(dampings[best])
        if shorter and nothing:  # the same slopes are tried by shorter steps, once
            damping *= SHORTER
        history.append(least)
    if tangents and (jacobian is None or near is None):
        jacobian = cost.slopes(point, residual, shares[-1])
    status = "converged" if stage == len(shares) else "max_iterations"
    n_f = cost.n_f
    tangent: tuple[np.ndarray, ...] = ()
    measured = [(batch.weight[r] > 0).any(1).numpy() for r in range(batch.rows)]
    if tangents and jacobian is not None:
        along = cost.eliminated(jacobian)[0].reshape(batch.rows, n_f, *batch.y.shape[1:])
        tangent = tuple(-row[:, k].transpose(1, 2, 0) for row, k in zip(along, measured, strict=True))
    info = [system.table[i] for i in cost.rollouts.free]
    names = tuple(i.name for i in info)
    return FitResult(
        system=system.with_values(dict(zip(names, point[:n_f].tolist(), strict=True))),
        names=names,
        values=point[:n_f],
        units=tuple(i.unit for i in info),
        status=status,
        records=batch.names,
        cost=history[-1],
        n_samples=int((batch.weight > 0).sum()),
        iterations=len(history) - 1,
        jacobian=tangent,
        residual=tuple(r[k] for r, k in zip(residual.reshape(batch.y.shape), measured, strict=True)),
        prior_precision=cost.precision[:n_f],
        x0=cost.first_states(point[None])[0],
        engine=cost.rollouts.engine,
        history=tuple(history),
    )


def slopes_at(system: System, batch: Batch, engine: Engine, x0: np.ndarray | None = None) -> Slopes:
    """Slopes at a model's own values, from first states ``(R, n_x)``, by default the measured ones."""
    cost = Cost(system, batch, engine)
    point = cost.point(cost.start, cost.measured if x0 is None else x0)
    slopes = cost.slopes(point, cost.residuals(point[None])[0], STEPS[0]).swapaxes(0, 1)
    first_states = cost.first_states(point[None])[0][:, cost.loose].T
    return Slopes(
        parameters=dict(zip(cost.keys, slopes[: cost.n_f], strict=True)),
        first=dict(zip(cost.states, slopes[cost.n_f :], strict=True)),
        x0=dict(zip(cost.states, first_states, strict=True)),
    )
