"""Least squares by whole rollouts and finite steps, for models too far from the records for a linearisation.

Behind play, and where a link sticks and slips on a spring, the tangent of a trajectory grows with every event while the
trajectory itself does not: exact sensitivities tell the wrong way, and Newton's method over all samples leaves the
valley. Differences over a hundredth of a parameter see through the events. Every difference is a lane of one compiled
rollout, and so is every trial step: Levenberg-Marquardt with many dampings at once.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import lsq_linear

from hybrid_id.identification.result import FitResult
from hybrid_id.identification.rollouts import Cost, Slopes
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.chain import System

STEPS = (0.01, 0.1, 0.01)
"""Finite steps, as shares of the parameters: in between, a coarse one sees through the ripple of the cost."""
DAMPINGS = 10.0 ** np.arange(-2, 4)
"""Dampings that are tried side by side, relative to the last that was best."""
FEW = DAMPINGS[1:5]
"""Those of a cheap look."""
LEAST_DAMPING, MOST_DAMPING = 1e-9, 1e6
SETTLED = 1e-4
"""A finite step has done its work when the cost falls by less than this share."""
POOR = 0.02
"""Slopes that have been mended are simulated anew when a step lowers the cost by less than this share."""
CLOSE, PATIENCE = 1.1, 3
"""Cost, relative to that of the model beside it, up to which a look's slopes are believed, and steps after which."""
TRIES, LANES, BETWEEN = 6, 48, 12
"""Shakes of a fit, points of each, and iterations from the best of them."""
GIVE_UP = 3
"""Shakes in a row without a gain after which the fit is taken as it is."""
SHAKE = 0.3
"""Rise of the cost, relative to it, that a first shake would bring on a smooth one; it falls with every failure."""


def secant_fit(
    system: System,
    batch: Batch,
    *,
    engine: Engine,
    iterations: int = 20,
    x0: np.ndarray | None = None,
    near: Slopes | None = None,
) -> FitResult:
    """Fit one parameter set and the first states of all rows of a batch.

    With ``near`` the fit is a cheap look, which ends where it comes to nothing: only what the neighbouring model lacks
    is simulated for the first slopes, and every step mends them by Broyden's rank-one update (C. G. Broyden, Math.
    Comp. 19, 1965) instead of new ones.

    Args:
        system: model with start values and bounds.
        batch: prepared records.
        engine: how a sample is integrated; compiled rollouts make this affordable.
        iterations: steps at most.
        x0: where the search for the first states starts, ``(R, n_x)`` (default: as measured).
        near: slopes of a model close to the start, to begin with.

    Raises:
        InputError: nothing to estimate.
    """
    cost = Cost(system, batch, engine)
    free = cost.rollouts.free
    low, high = cost.low[: len(free)], cost.high[: len(free)]
    shifts = cost.shifts_of(batch.x[:, 0].numpy() if x0 is None else x0)
    point = np.concatenate([np.clip(system.theta().detach().numpy()[free], low, high), shifts])
    left = cost.residuals(point[None])[0]
    damping, stage, history = 1e-2, 0, [0.5 * float(left @ left)]
    jacobian = None if near is None else cost.slopes(point, left, STEPS[0], near)
    fresh = False
    while stage < len(STEPS) and len(history) <= iterations:
        if jacobian is None:
            jacobian, fresh = cost.slopes(point, left, STEPS[stage]), True
        dampings = np.clip(damping * (DAMPINGS if near is None else FEW), LEAST_DAMPING, MOST_DAMPING)
        points = _steps(jacobian, left, point, cost, dampings)
        found = cost.residuals(points)
        costs = 0.5 * np.square(found).sum(1)
        best = int(np.nanargmin(costs))
        gained = history[-1] - costs[best]
        if near is not None and _idle(
            near, len(history), min(history[-1], float(costs[best])), left, jacobian, points[0] - point
        ):
            stage = len(STEPS)
        elif gained < SETTLED * history[-1] and (fresh or (near is not None and len(history) > 1)):
            stage, jacobian, damping = stage + 1, None if near is None else jacobian, 1e-2
        elif gained < POOR * history[-1] and (near is None or len(history) == 1):
            jacobian = None
        else:
            jacobian, fresh = _mended(jacobian, points[best] - point, found[best] - left), False
        if gained > 0:
            point, left, damping = points[best], found[best], float(dampings[best])
        history.append(min(history[-1], float(costs[best])))
    if jacobian is None or near is None:
        jacobian = cost.slopes(point, left, STEPS[-1])
    shape, count, n_f = batch.y.shape, batch.y.numel(), len(free)
    tangents = -_followed(jacobian, n_f)[0][:count].reshape(*shape, n_f)
    runs = left[:count].reshape(shape)
    keep = [(batch.weight[r] > 0).any(1).numpy() for r in range(batch.rows)]
    names = tuple(system.table[i].name for i in free)
    return FitResult(
        system=system.with_values(dict(zip(names, point[:n_f].tolist(), strict=True))),
        names=names,
        values=point[:n_f],
        units=tuple(system.table[i].spec.unit for i in free),
        status="converged" if stage == len(STEPS) else "max_iterations",
        records=batch.names,
        cost=history[-1],
        n_samples=int((batch.weight > 0).sum()),
        iterations=len(history) - 1,
        jacobian=tuple(tangents[r][keep[r]] for r in range(batch.rows)),
        residual=tuple(runs[r][keep[r]] for r in range(batch.rows)),
        prior_precision=cost.precision[:n_f],
        x0=cost.first_states(point[None])[0],
        engine=cost.rollouts.engine,
        history=tuple(history),
    )


def _followed(jacobian: np.ndarray, n_f: int) -> tuple[np.ndarray, np.ndarray]:
    """Slopes by the parameters while the first states follow these, and how far they do, ``(n_states, n_f)``."""
    starts = jacobian[:, n_f:]
    follow = -np.linalg.solve(starts.T @ starts, starts.T @ jacobian[:, :n_f])
    return jacobian[:, :n_f] + starts @ follow, follow


def _idle(
    near: Slopes, iteration: int, cost: float, left: np.ndarray, jacobian: np.ndarray, step: np.ndarray
) -> bool:
    """Whether a look has come to nothing: it is no better than what it starts beside, and its slopes promise no more.

    They are believed where it has come near, or after a few steps.
    """
    interesting = (1.0 - POOR) * near.least
    if cost <= interesting or (cost >= CLOSE * near.least and iteration < PATIENCE):
        return False
    return 0.5 * float(np.square(left + jacobian @ step).sum()) > interesting


def slopes_at(system: System, batch: Batch, engine: Engine) -> Slopes:
    """Slopes at a model's own values, from measured first states, for looks at its neighbours."""
    cost = Cost(system, batch, engine)
    point = np.concatenate([cost.rollouts.theta.numpy()[cost.rollouts.free], np.zeros(cost.std.size)])
    return cost.shared(cost.slopes(point, cost.residuals(point[None])[0], STEPS[0]))


def _mended(jacobian: np.ndarray, step: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Slopes that tell the change that a step has brought, otherwise as they were (Broyden, in scaled parameters)."""
    along = np.square(jacobian).sum(0) * step
    length = float(along @ step)
    return jacobian + np.outer(change - jacobian @ step, along / length) if length > 0 else jacobian


def _steps(
    jacobian: np.ndarray, left: np.ndarray, point: np.ndarray, cost: Cost, dampings: np.ndarray
) -> np.ndarray:
    """Points that minimise the linearised residuals inside the box, one for each damping (Marquardt's scaling)."""
    hessian, slope = jacobian.T @ jacobian, jacobian.T @ left
    # first states that are known exactly in some rows are as stiff as that, and say nothing of the parameters' sizes
    own = hessian.diagonal()[: cost.n_f].max(initial=1e-300)
    size = np.sqrt(np.maximum(np.diag(hessian), 1e-12 * own))
    hessian, slope = hessian / np.outer(size, size), slope / size
    margin = 1e-12 * np.maximum(cost.high - cost.low, 1e-300) * size
    box = (cost.low - point) * size - margin, (cost.high - point) * size + margin
    found = []
    for damping in dampings:
        values, vectors = np.linalg.eigh(hessian + damping * np.eye(len(size)))
        root = np.sqrt(np.maximum(values, 1e-12 * values[-1]))
        step = lsq_linear(root[:, None] * vectors.T, -(vectors.T @ slope) / root, box, method="bvls").x
        found.append(np.clip(point + step / size, cost.low, cost.high))
    return np.array(found)


def shaken(result: FitResult, batch: Batch, *, seed: int = 0, tries: int = TRIES) -> FitResult:
    """A fit shaken out of the ripples of its cost: points around it, as far as it is uncertain, and fits from the best.

    Args:
        result: where the fit has ended.
        batch: its records.
        seed: of the points.
        tries: shakes at most.
    """
    generator, share, failures, here = np.random.default_rng(seed), SHAKE, 0, None
    for _ in range(tries):
        if here is not result:
            cost = Cost(result.system, batch, result.engine)
            free, shifts, here = cost.rollouts.free, cost.shifts_of(result.x0), result
            point = np.concatenate([result.values, shifts])
            jacobian = cost.slopes(point, cost.residuals(point[None])[0], STEPS[-1])
            tangents, follow = _followed(jacobian, len(free))
        size = np.sqrt(np.maximum(np.square(tangents).sum(0), 1e-300))
        values, vectors = np.linalg.eigh((tangents / size).T @ (tangents / size))
        far = np.sqrt(2.0 * share * result.cost / len(free) / np.maximum(values, 1e-4 * values[-1]))
        step = (generator.standard_normal((LANES, len(free))) * far) @ vectors.T / size
        most = 0.3 * np.maximum(np.abs(result.values), cost.scale)
        points = np.clip(
            result.values + np.clip(step, -most, most), cost.low[: len(free)], cost.high[: len(free)]
        )
        moved = np.clip(
            shifts + (points - result.values) @ follow.T, cost.low[len(free) :], cost.high[len(free) :]
        )
        left = cost.residuals(np.hstack([points, moved]))
        best = points[int(np.square(left).sum(1).argmin())]
        start = result.system.with_values(dict(zip(result.names, best.tolist(), strict=True)))
        again = secant_fit(start, batch, engine=result.engine, iterations=BETWEEN, x0=result.x0)
        if again.cost < (1.0 - SETTLED) * result.cost:
            result, failures = replace(again, status=result.status), 0
        else:
            share, failures = 0.5 * share, failures + 1
        if failures == GIVE_UP:
            break
    return result
