"""Least squares by whole rollouts and finite steps, for models too far from the records for a linearisation.

Behind play, and where a link sticks and slips on a spring, the tangent of a trajectory grows with every event while the
trajectory itself does not: exact sensitivities tell the wrong way, and Newton's method over all samples leaves the
valley. Differences over a hundredth of a parameter see through the events. Every difference is a lane of one compiled
rollout, and so is every trial step: Levenberg-Marquardt with many dampings at once.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from scipy.optimize import lsq_linear

from hybrid_id.errors import InputError
from hybrid_id.identification.fit import make_bounds
from hybrid_id.identification.result import FitResult
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.lifted import shoot
from hybrid_id.simulation.stability import with_substeps
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.chain import System

STEPS = (0.01, 0.1, 0.01)
"""Finite steps, as shares of the parameters: in between, a coarse one sees through the ripple of the cost."""
DAMPINGS = 10.0 ** np.arange(-2, 4)
"""Dampings that are tried side by side, relative to the last that was best."""
LEAST_DAMPING, MOST_DAMPING = 1e-9, 1e6
SHARES = (1.0, 0.3, 0.1)
"""Shares of the step that leaving a record out asks for."""
WORST = 1e3
"""Weighted residual that stands for a simulation that has left all bounds."""
SETTLED = 1e-4
"""The fit ends when cost or parameters change by less than this share."""


class Rollouts:
    """Weighted residuals of a batch for many parameter sets at once.

    Args:
        system: what is simulated.
        batch: whole records; their first states are held.
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

    def residuals(self, points: np.ndarray) -> np.ndarray:
        """Residuals ``(P, R, T, n_y)`` at the points ``(P, n_f)``."""
        rows, count = self.batch.rows, len(points)
        theta = self.theta[:, None].repeat(1, count)
        theta[self.free] = torch.tensor(points.T)
        theta = theta.repeat_interleave(rows, 1)
        part = self.batch.take(torch.arange(rows).repeat(count))
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


def secant_fit(
    system: System, batch: Batch, *, engine: Engine, iterations: int = 20, starts: Sequence[System] = ()
) -> FitResult:
    """Fit one parameter set to all rows of a batch.

    Args:
        system: model with start values and bounds.
        batch: prepared records.
        engine: how a sample is integrated; compiled rollouts make this affordable.
        iterations: steps at most.
        starts: the same model at other values; the fit starts at the best of them all.

    Raises:
        InputError: nothing to estimate.
    """
    free = [i for i, info in enumerate(system.table) if info.spec.estimate]
    if not free:
        raise InputError("The model has no parameter to estimate; set 'estimate: true' for at least one.")
    bounds, rollouts = make_bounds(system, free), Rollouts(system, batch, engine, free)
    low, high, scale, mean, precision = (
        value.numpy()
        for value in (bounds.lower, bounds.upper, bounds.scale, bounds.prior_mean, bounds.prior_precision)
    )

    def residuals(points: np.ndarray) -> np.ndarray:
        priors = np.sqrt(precision) * (mean - points)
        return np.hstack([rollouts.residuals(points).reshape(len(points), -1), priors])

    def slopes(point: np.ndarray, left: np.ndarray, share: float) -> np.ndarray:
        step = share * np.maximum(np.abs(point), scale)
        step = np.where(point + step > high, -np.minimum(step, point - low), step)
        return ((residuals(point + np.diag(step)) - left) / step[:, None]).T

    points = np.clip([s.theta().detach().numpy()[free] for s in (system, *starts)], low, high)
    found = residuals(points)
    best = int(np.square(found).sum(1).argmin())
    point, left = points[best], found[best]
    damping, stage, history = 1e-2, 0, [0.5 * float(left @ left)]
    while stage < len(STEPS) and len(history) <= iterations:
        jacobian = slopes(point, left, STEPS[stage])
        dampings = np.clip(damping * DAMPINGS, LEAST_DAMPING, MOST_DAMPING)
        points = np.array([_step(jacobian, left, point, low, high, d) for d in dampings])
        found = residuals(points)
        costs = 0.5 * np.square(found).sum(1)
        best = int(np.nanargmin(costs))
        gained = history[-1] - costs[best]
        if gained > 0:
            point, left, damping = points[best], found[best], float(dampings[best])
        if gained < SETTLED * history[-1]:
            stage, damping = stage + 1, 1e-2
        history.append(min(history[-1], float(costs[best])))
    jacobian = slopes(point, left, STEPS[-1])
    shape, count = batch.y.shape, batch.y.numel()
    runs, tangents = left[:count].reshape(shape), -jacobian[:count].reshape(*shape, len(free))
    keep = [(batch.weight[r] > 0).any(1).numpy() for r in range(batch.rows)]
    names = tuple(system.table[i].name for i in free)
    return FitResult(
        system=system.with_values(dict(zip(names, point.tolist(), strict=True))),
        names=names,
        values=point,
        units=tuple(system.table[i].spec.unit for i in free),
        status="converged" if stage == len(STEPS) else "max_iterations",
        records=batch.names,
        cost=history[-1],
        n_samples=int((batch.weight > 0).sum()),
        iterations=len(history) - 1,
        jacobian=tuple(tangents[r][keep[r]] for r in range(batch.rows)),
        residual=tuple(runs[r][keep[r]] for r in range(batch.rows)),
        prior_precision=precision,
        x0=batch.x[:, 0].numpy(),
        engine=rollouts.engine,
        history=tuple(history),
    )


def _step(
    jacobian: np.ndarray,
    left: np.ndarray,
    point: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    damping: float,
) -> np.ndarray:
    """Point that minimises the linearised residuals, damped (Marquardt's scaling), inside the box."""
    hessian, slope = jacobian.T @ jacobian, jacobian.T @ left
    size = np.sqrt(np.maximum(np.diag(hessian), 1e-12 * hessian.diagonal().max(initial=1e-300)))
    matrix = hessian / np.outer(size, size) + damping * np.eye(len(size))
    values, vectors = np.linalg.eigh(matrix)
    root = np.sqrt(np.maximum(values, 1e-12 * values[-1]))
    factor, target = root[:, None] * vectors.T, -(vectors.T @ (slope / size)) / root
    width = np.maximum(high - low, 1e-300)
    below, above = (low - point) * size, (high - point) * size
    step = lsq_linear(
        factor, target, (below - 1e-12 * width * size, above + 1e-12 * width * size), method="bvls"
    ).x
    return np.clip(point + step / size, low, high)


def left_out(result: FitResult, batch: Batch) -> list[np.ndarray]:
    """Weighted residuals of each record, ``(T, n_y)``, at what the other records alone would ask for.

    Without record i the estimate moves by one Gauss-Newton step, ``(H - H_i) delta = -J_i' r_i``, for the sum of all
    ``J_j' r_j`` is nothing at the end of a fit (A. C. Davison and D. V. Hinkley, Bootstrap Methods and their
    Application, 1997, section 6.4). The step is taken as far as it lowers the cost of the others, and simulated.

    Args:
        result: of all records of the batch, pooled.
        batch: the records.
    """
    free = [i for i, info in enumerate(result.system.table) if info.spec.estimate]
    inside = [k for k, name in enumerate(result.names) if name not in result.at_bound]
    if batch.rows == 1 or not inside:
        return list(result.residual)
    jacobians = [j.reshape(-1, j.shape[-1])[:, inside] for j in result.jacobian]
    size = np.sqrt(np.maximum(sum(np.square(j).sum(0) for j in jacobians), 1e-300))
    hessians = [(j / size).T @ (j / size) for j in jacobians]
    points = []
    for j, r, h in zip(jacobians, result.residual, hessians, strict=True):
        values, vectors = np.linalg.eigh(np.sum(hessians, 0) - h)
        told = values > 1e-8 * max(values[-1], 1e-300)
        along = vectors[:, told] @ ((vectors[:, told].T @ (-(j / size).T @ r.reshape(-1))) / values[told])
        for share in SHARES:
            point = result.values.copy()
            point[inside] += share * along / size
            points.append(point)
    bounds = make_bounds(result.system, free)
    tried = np.clip(np.array(points), bounds.lower.numpy(), bounds.upper.numpy())
    runs = Rollouts(result.system, batch, result.engine, free).residuals(tried)
    runs = runs.reshape(batch.rows, len(SHARES), *runs.shape[1:])
    found = []
    for i, own in enumerate(result.residual):
        keep = (batch.weight[i] > 0).any(1).numpy()
        costs = np.square(runs[i]).sum((2, 3))
        others = costs.sum(1) - costs[:, i]
        best, stay = int(others.argmin()), sum(float(np.square(r).sum()) for r in result.residual)
        moved = others[best] < stay - float(np.square(own).sum())
        found.append(runs[i, best, i][keep] if moved else own)
    return found
