"""What the rest of the records predicts of a part that a fit has seen, without fitting it again."""

from __future__ import annotations

import numpy as np

from hybrid_id.identification.fit import make_bounds
from hybrid_id.identification.result import FitResult
from hybrid_id.identification.rollouts import Rollouts
from hybrid_id.simulation.batch import Batch

SHARES = (1.0, 0.3, 0.1)
"""Shares of the step that leaving a part out asks for."""
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


def leave_one_out(result: FitResult, batch: Batch) -> list[np.ndarray]:
    """Weighted residuals of each record, ``(T, n_y)``, each part at what the others alone would ask for.

    Without part i the estimate moves by one Gauss-Newton step, ``(H - H_i) delta = -J_i' r_i``, for the sum of all
    ``J_j' r_j`` is nothing at the end of a fit (A. C. Davison and D. V. Hinkley, Bootstrap Methods and their
    Application, 1997, section 6.4). The step is taken as far as it lowers the cost of the others, and simulated.

    Args:
        result: of all records of the batch, pooled.
        batch: the records.
    """
    free = result.system.estimated
    inside = [k for k, name in enumerate(result.names) if name not in result.at_bound]
    if not inside:
        return list(result.residual)
    kept = [(batch.weight[r] > 0).any(1).numpy() for r in range(batch.rows)]
    parts = _parts(batch)
    part = np.concatenate([p[keep] for p, keep in zip(parts, kept, strict=True)])
    jacobian = np.concatenate([j[..., inside] for j in result.jacobian])
    residual = np.concatenate(list(result.residual))
    size = np.sqrt(np.maximum(np.square(jacobian).sum((0, 1)), 1e-300))
    scaled = [(jacobian[part == i] / size).reshape(-1, len(inside)) for i in range(PARTS)]
    hessians = [j.T @ j for j in scaled]
    points = []
    for i, (j, h) in enumerate(zip(scaled, hessians, strict=True)):
        values, vectors = np.linalg.eigh(np.sum(hessians, 0) - h)
        told = values > 1e-8 * max(values[-1], 1e-300)
        pull = -j.T @ residual[part == i].reshape(-1)
        along = vectors[:, told] @ ((vectors[:, told].T @ pull) / values[told])
        for share in SHARES:
            point = result.values.copy()
            point[inside] += share * along / size
            points.append(point)
    bounds = make_bounds(result.system, free)
    tried = np.clip(np.array(points), bounds.lower.numpy(), bounds.upper.numpy())
    first = np.tile(result.x0, (len(tried), 1, 1))
    runs = Rollouts(result.system, batch, result.engine, free).residuals(tried, first)
    runs = runs.reshape(PARTS, len(SHARES), *runs.shape[1:])
    found = [own.copy() for own in result.residual]
    squares, stay = np.square(residual).sum(1), float(np.square(residual).sum())
    for i in range(PARTS):
        costs = np.square(runs[i]).sum(3)
        others = (costs * (parts != i)).sum((1, 2))
        best = int(others.argmin())
        if others[best] >= stay - float(squares[part == i].sum()):
            continue
        for own, run, mine, keep in zip(found, runs[i, best], parts == i, kept, strict=True):
            own[mine[keep]] = run[mine & keep]
    return found


def _parts(batch: Batch) -> np.ndarray:
    """Number of the part that each sample belongs to, ``(R, T)``; a single record is left out block by block."""
    time = np.cumsum(batch.dt.numpy(), 1) - batch.dt.numpy()
    fold = folds(batch)
    if fold is not None:
        return np.broadcast_to(fold[:, None], time.shape)
    blocks = np.floor(time / BLOCK + 1e-9).astype(int)
    return (blocks + np.arange(batch.rows)[:, None]) % PARTS
