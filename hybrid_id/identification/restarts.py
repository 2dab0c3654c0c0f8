"""Perturbed restarts: whether a fit has ended at its optimum, and a way out of the ripples of its cost."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from hybrid_id.errors import InputError
from hybrid_id.identification.finite_differences import (
    SETTLED,
    STEPS,
    Cost,
    finite_difference_fit,
)
from hybrid_id.identification.fit import Progress, kept_fit
from hybrid_id.identification.keep import Kept
from hybrid_id.identification.least_squares import Options
from hybrid_id.identification.result import NO_ESTIMATE, FitResult
from hybrid_id.simulation.batch import Batch

NOISE = 1.05
"""RMS of the weighted residuals up to which they are noise: no other end can be much lower."""
RISE = 0.05
"""Rise of the cost, relative to it, that the restart's distance would bring on a quadratic cost."""
FALL = 0.005
"""Fall of the cost, relative to it, that shows that the fit had not ended."""
BRIEF = 8
"""Iterations of a restart."""
NEARER = (1.0, 0.5, 0.25, 0.1)
"""Shares of a restart's distance, of which the first is taken at which the system is physical."""
RESTARTS = 4
"""Restarts that may each find a lower cost."""
TRIES, LANES, BETWEEN = 6, 48, 12
"""Rounds of perturbed restarts, points of each, and iterations from the best of them."""
GIVE_UP = 3
"""Rounds in a row without a gain after which the fit is taken as it is."""
SPREAD = 0.3
"""Rise of the cost, relative to it, that a first perturbation would bring on a smooth one; halved by every failure."""


def confirmed(
    result: FitResult,
    batch: Batch,
    *,
    options: Options | None = None,
    seed: int = 0,
    kept: Kept | None = None,
    progress: Progress | None = None,
) -> FitResult:
    """The fit, or a better one that restarts beside it have led to; "max_iterations" where each did.

    The restart begins beside the estimate along the axes of what the records tell, to a random side of each, and far
    along the weak ones. Where a few iterations from there end lower, the fit goes on from them. A fit that leaves no
    more than noise is confirmed as it is.

    Args:
        result: of one parameter set, over all rows of the batch.
        batch: the rows that it was fitted to.
        options: settings of the fit.
        seed: of the sides.
        kept: fits of an earlier run.
        progress: as in :func:`hybrid_id.identification.fit.fit`.
    """
    options, generator = options or Options(), np.random.default_rng(seed)
    brief = replace(options, max_iterations=BRIEF)
    for _ in range(RESTARTS):
        if result.status in NO_ESTIMATE or result.noise_scale <= NOISE:
            return result
        start, values = None, beside(result, generator)
        for share in NEARER:  # where the point beside the estimate is unphysical, a nearer one
            point = result.values + share * (values - result.values)
            with suppress(InputError):
                start = result.system.with_values(dict(zip(result.names, point.tolist(), strict=True)))
                break
        if start is None:
            return result
        settings = {"pooled": True, "engine": result.engine, "warm": False, "progress": progress}
        again = kept_fit(kept, start, batch, options=brief, **settings)[0]
        if again.status in NO_ESTIMATE or not again.cost < (1.0 - FALL) * result.cost:
            return result
        further = kept_fit(kept, again.system, batch, options=options, **settings)[0]
        result = further if further.cost <= again.cost else again
    return replace(result, status="max_iterations")


def beside(result: FitResult, generator: np.random.Generator) -> np.ndarray:
    """A point beside an estimate, at most 30 % of each parameter away and inside its bounds, ``(n_f,)``."""
    jacobian = np.concatenate([part.reshape(-1, part.shape[-1]) for part in result.jacobian])
    size, axes, far = _reach(jacobian.T @ jacobian + np.diag(result.prior_precision), RISE * result.cost)
    step = axes @ (far * generator.choice([-1.0, 1.0], len(size))) / size
    most = 0.3 * np.abs(result.values)
    specs = [result.system.parameter(name).spec for name in result.names]
    moved = result.values + np.where(most > 0, np.clip(step, -most, most), step)
    return np.clip(moved, [spec.lower for spec in specs], [spec.upper for spec in specs])


def _reach(information: np.ndarray, rise: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Axes of what records tell of parameters in units of ``1 / size``, and how far along each a cost rises so much.

    Returns:
        size ``(n_f,)``, axes ``(n_f, n_f)``, distance along each axis if all of them share the rise ``(n_f,)``.
    """
    size = np.sqrt(np.maximum(np.diag(information), 1e-300))
    strength, axes = np.linalg.eigh(information / np.outer(size, size))
    return size, axes, np.sqrt(2.0 * rise / len(size) / np.maximum(strength, 1e-4 * strength[-1]))


def perturbed_restarts(result: FitResult, batch: Batch, *, seed: int = 0, tries: int = TRIES) -> FitResult:
    """The best of finite-difference fits from points around a fit: a way out of the ripples of its cost.

    Points are drawn as far from the fit as it is uncertain, first states follow them, and a fit starts at the best.

    Args:
        result: where the fit has ended.
        batch: its records.
        seed: of the points.
        tries: rounds at most.
    """
    generator, share, failures, here = np.random.default_rng(seed), SPREAD, 0, None
    for _ in range(tries):
        if here is not result:
            cost, here = Cost(result.system, batch, result.engine), result
            n_f, point = cost.n_f, cost.point(result.values, result.x0)
            slopes = cost.slopes(point, cost.residuals(point[None])[0], STEPS[-1])
            tangents, follow = cost.eliminated(slopes)
            information = np.diag(cost.precision[:n_f]) + (follow.T * cost.precision[n_f:]) @ follow
            information += (tangents @ tangents.transpose(0, 2, 1)).sum(0)
        size, axes, far = _reach(information, share * result.cost)
        step = (generator.standard_normal((LANES, n_f)) * far) @ axes.T / size
        most = 0.3 * np.maximum(np.abs(result.values), cost.scale)
        points = np.clip(result.values + np.clip(step, -most, most), cost.low[:n_f], cost.high[:n_f])
        moved = np.hstack([points, point[n_f:] + (points - result.values) @ follow.T])
        moved = np.clip(moved, cost.low, cost.high)
        best = points[int(cost.costs(moved, cost.residuals(moved)).argmin())]
        start = result.system.with_values(dict(zip(result.names, best.tolist(), strict=True)))
        again = finite_difference_fit(start, batch, engine=result.engine, iterations=BETWEEN, x0=result.x0)
        if again.cost < (1.0 - SETTLED) * result.cost:
            result, failures = replace(again, status=result.status), 0
        else:
            share, failures = 0.5 * share, failures + 1
        if failures == GIVE_UP:
            break
    return result
