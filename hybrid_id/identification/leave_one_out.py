"""What the rest of the records predicts of a part that a fit has seen, without fitting it again."""

from __future__ import annotations

import numpy as np

from hybrid_id.identification.finite_differences import Rollouts
from hybrid_id.identification.fit import make_bounds
from hybrid_id.identification.result import FitResult
from hybrid_id.simulation.batch import Batch

SHARES = (1.0, 0.3, 0.1)
"""Shares of the step that leaving a part out asks for."""
SETTLED = 1e-3
"""Relative fall of the others' cost from which another step is worth taking."""
PARTS = 6
"""Parts that are left out, one at a time."""
BLOCK = 0.5
"""Length [s] of the blocks of a single record that go to the parts in turn."""


def folds(batch: Batch) -> np.ndarray | None:
    """Number of the part that each row of a batch is left out with, ``(R,)``: whole records, one by one where few.

    Windows of a record go with it. None where all rows are of one record.
    """
    names = list(dict.fromkeys(batch.names))
    if len(names) < 2:
        return None
    number = {name: k % PARTS for k, name in enumerate(names)}
    return np.array([number[name] for name in batch.names])


def leave_one_out(result: FitResult, batch: Batch, iterations: int = 1) -> list[np.ndarray]:
    """Weighted residuals of each record, ``(T, n_y)``, each part at what the others alone ask for.

    Without part i the estimate moves by Gauss-Newton steps ``(H - H_i) delta = sum_j!=i J_j' r_j`` with the
    slopes of the whole fit (a chord method; one step: A. C. Davison and D. V. Hinkley, Bootstrap Methods and
    their Application, 1997, section 6.4). Each step is taken as far as it lowers the simulated cost of the
    others, and the fit of the others has ended where none does: all parts go side by side, as lanes of one
    rollout.

    Args:
        result: of all records of the batch, pooled.
        batch: the records.
        iterations: steps at most.
    """
    fold, time = folds(batch), np.cumsum(batch.dt.numpy(), 1) - batch.dt.numpy()
    if fold is None:  # a single record is left out block by block
        parts = (np.floor(time / BLOCK + 1e-9).astype(int) + np.arange(batch.rows)[:, None]) % PARTS
    else:
        parts = np.broadcast_to(fold[:, None], time.shape)
    model = Linearised(result, batch, parts)
    if not model.inside:
        return list(result.residual)
    free, kept = result.system.estimated, model.kept
    parts, residual = parts[kept], np.concatenate(list(result.residual))
    rollouts = Rollouts(result.system, batch, result.engine, free)
    points = np.tile(result.values, (PARTS, 1))
    left = np.tile(residual, (PARTS, 1, 1))
    costs = np.array([model.cost(i, points[i], left[i]) for i in range(PARTS)])
    active = set(range(PARTS))
    for _ in range(iterations):
        tried = np.repeat(points, len(SHARES), 0)
        for i in range(PARTS):
            tried[i * len(SHARES) : (i + 1) * len(SHARES)] = model.steps(i, points[i], left[i])
        runs = rollouts.residuals(tried, np.tile(result.x0, (len(tried), 1, 1)))[:, kept]
        for i in sorted(active):
            lanes = range(i * len(SHARES), (i + 1) * len(SHARES))
            found = [model.cost(i, tried[k], runs[k]) for k in lanes]
            best = int(np.argmin(found))
            # first states are held, which costs the whole step a little: it is taken all the same
            best = 0 if found[0] <= (1.0 + SETTLED) * min(found[best], costs[i]) else best
            if found[best] >= (1.0 - SETTLED) * costs[i]:
                active.remove(i)
            if found[best] <= (1.0 + SETTLED) * costs[i]:
                k = i * len(SHARES) + best
                points[i], left[i], costs[i] = tried[k], runs[k], found[best]
        if not active:
            break
    unseen = np.take_along_axis(left, parts[None, :, None], 0)[0]
    return np.split(unseen, np.cumsum(kept.sum(1))[:-1])


class Linearised:
    """What leaving a part of the samples out asks for, with the slopes of the whole fit.

    Args:
        result: of all rows of the batch, pooled.
        batch: the rows.
        parts: number of the part that each sample is left out with, ``(R, T)``.

    Attributes:
        inside: estimated parameters that are not at a bound.
        kept: samples that are measured, ``(R, T)``.
    """

    def __init__(self, result: FitResult, batch: Batch, parts: np.ndarray) -> None:
        self.inside = [k for k, name in enumerate(result.names) if name not in result.at_bound]
        self.kept = (batch.weight > 0).any(2).numpy()
        self.parts = parts[self.kept]
        if not self.inside:
            return
        bounds = make_bounds(result.system, result.system.estimated)
        self.low, self.high = bounds.lower.numpy(), bounds.upper.numpy()
        self.mean = bounds.prior_mean.numpy()[self.inside]
        self.precision = bounds.prior_precision.numpy()[self.inside]
        jacobian = np.concatenate([j[..., self.inside] for j in result.jacobian])
        self.size = np.sqrt(np.maximum(np.square(jacobian).sum((0, 1)) + self.precision, 1e-300))
        self.scaled = jacobian / self.size
        own = [self.scaled[self.parts == i].reshape(-1, len(self.inside)) for i in range(PARTS)]
        hessian = sum(j.T @ j for j in own) + np.diag(self.precision / self.size**2)
        self.inverses = []
        for j in own:  # pseudo-inverse along the directions that the others identify
            values, vectors = np.linalg.eigh(hessian - j.T @ j)
            seen = values > 1e-8 * max(values[-1], 1e-300)
            self.inverses.append((vectors[:, seen] / values[seen]) @ vectors[:, seen].T)

    def steps(self, part: int, point: np.ndarray, left: np.ndarray) -> np.ndarray:
        """Points at shares of the step that the samples of all other parts ask for, ``(S, n_f)``.

        Args:
            part: what is left out.
            point: where the step begins, ``(n_f,)``.
            left: weighted residuals there of the samples that are measured, ``(N, n_y)``.
        """
        others = self.parts != part
        slope = np.einsum("tyk,ty->k", self.scaled[others], left[others])
        slope -= self.precision * (point[self.inside] - self.mean) / self.size
        points = np.tile(point, (len(SHARES), 1))
        points[:, self.inside] += np.outer(SHARES, self.inverses[part] @ slope / self.size)
        return np.clip(points, self.low, self.high)

    def cost(self, part: int, point: np.ndarray, left: np.ndarray) -> float:
        """Twice the cost of all other parts at a point, with the priors; arguments as in :meth:`steps`."""
        prior = float(self.precision @ np.square(point[self.inside] - self.mean))
        return float(np.square(left[self.parts != part]).sum()) + prior


def started_without(result: FitResult, batch: Batch, fold: np.ndarray) -> np.ndarray:
    """Where fits without each part begin, ``(P, n_f)``: as far along the linearised step as serves the others best.

    Never at the fit of all: a fit that does not move from there would predict what it has seen.

    Args:
        result: of all rows of the batch, pooled.
        batch: the rows.
        fold: number of the part that each row is left out with, ``(R,)``.
    """
    model = Linearised(result, batch, np.broadcast_to(fold[:, None], batch.dt.shape))
    if not model.inside:
        return np.tile(result.values, (int(fold.max()) + 1, 1))
    residual = np.concatenate(list(result.residual))
    rollouts = Rollouts(result.system, batch, result.engine, result.system.estimated)
    found = []
    for part in range(int(fold.max()) + 1):
        points = model.steps(part, result.values, residual)
        runs = rollouts.residuals(points, np.tile(result.x0, (len(points), 1, 1)))[:, model.kept]
        cost = [model.cost(part, p, run) for p, run in zip(points, runs, strict=True)]
        found.append(points[int(np.argmin(cost))])
    return np.array(found)
