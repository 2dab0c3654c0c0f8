"""What the others predict of a record that a fit has seen, without fitting it again."""

from __future__ import annotations

import numpy as np

from hybrid_id.identification.fit import make_bounds
from hybrid_id.identification.result import FitResult
from hybrid_id.identification.rollouts import Rollouts
from hybrid_id.simulation.batch import Batch

SHARES = (1.0, 0.3, 0.1)
"""Shares of the step that leaving a record out asks for."""


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
    first = np.tile(result.x0, (len(tried), 1, 1))
    runs = Rollouts(result.system, batch, result.engine, free).residuals(tried, first)
    runs = runs.reshape(batch.rows, len(SHARES), *runs.shape[1:])
    found, stay = [], sum(float(np.square(r).sum()) for r in result.residual)
    for i, own in enumerate(result.residual):
        keep = (batch.weight[i] > 0).any(1).numpy()
        costs = np.square(runs[i]).sum((2, 3))
        others = costs.sum(1) - costs[:, i]
        best = int(others.argmin())
        moved = others[best] < stay - float(np.square(own).sum())
        found.append(runs[i, best, i][keep] if moved else own)
    return found
