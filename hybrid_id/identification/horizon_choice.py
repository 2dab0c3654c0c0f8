"""The longest horizon over which a model's free runs still teach its parameters, from the records themselves."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from hybrid_id.errors import InputError
from hybrid_id.identification.fit import fit
from hybrid_id.identification.horizons import WHOLE, Horizon
from hybrid_id.identification.least_squares import Options
from hybrid_id.identification.result import FitResult
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.chain import System

FOLLOWED, LOST = 0.1, 0.5
"""Normalised RMSE beyond noise up to which free runs follow their records, and from which they have lost them."""
SECONDS = (0.25, 0.5, 1.0, 2.0)
"""Lengths of windows [s] that are compared."""
BRIEF = 12
"""Iterations of the fit over each horizon."""
BLOCKS = 16
"""Blocks of the records whose scatter gives a standard error; it is known to 1 / sqrt(2 * 15) = 18 % then."""
SURELY = 1.5
"""Ratio of two such standard errors that is no accident: 1 + 2 * sqrt(2) * 18 %."""


def choose_horizon(
    system: System,
    engine: Engine,
    batch: Batch,
    whole: Sequence[FitResult] = (),
    *,
    followed: float = FOLLOWED,
    pieces: bool = False,
    options: Options | None = None,
) -> Horizon:
    """The longest of whole records, strokes and windows beyond which error grows faster than information.

    Whole records are taken where the free runs of the fit follow them. Otherwise the model is fitted over each horizon,
    from the shortest on. The standard errors of its parameters are taken from the scatter of the score over blocks of
    the records, the same for every horizon (sandwich estimate; H. White, Econometrica 50, 1982): a longer free run
    says more about the parameters, but what the model lacks accumulates in it, too. The longest horizon is chosen
    whose standard errors are not surely larger than the least, in the geometric mean over the identified directions.

    Args:
        system: model with start values.
        engine: how it is simulated.
        batch: whole records, prepared for it.
        whole: fits of the records as a whole, one or one a record; fitted here where there is none.
        followed: normalised RMSE beyond noise up to which they do; 0 to compare horizons in any case.
        pieces: whether whole records are not to be taken while any shorter horizon is followed.
        options: settings of these fits.
    """
    options = options or Options()
    if not system.estimated:
        return WHOLE
    whole = whole or fit(system, batch, pooled=True, engine=engine, options=options)
    if astray(whole, batch) <= followed:
        return Horizon(reason="they follow the records")
    brief, found = replace(options, max_iterations=BRIEF), []
    for horizon in (*(Horizon("windows", s) for s in SECONDS), Horizon("strokes"), WHOLE):
        part = horizon.cut(system, engine, batch)
        if (pieces or horizon.kind != "whole") and part.rows == batch.rows:
            continue
        with suppress(RuntimeError, InputError):  # it diverges over so long a time
            one = fit(system, part, pooled=True, engine=engine, options=brief, warm=False)[0]
            if one.status != "diverged":
                system = one.system
                if astray([one], batch) < LOST:
                    found.append((float(part.dt.sum(1).median()), horizon, one))
    if not found:
        return Horizon(reason="no horizon is followed")
    inside = [
        k for k in range(len(system.estimated)) if all(one.names[k] not in one.at_bound for *_, one in found)
    ]
    size, told = np.array([covariance_size(one, inside) for *_, one in found]).T
    size = size / max(float(told.max()), 1.0)
    able = [k for k in range(len(found)) if size[k] <= size.min() + np.log(SURELY)]
    _, horizon, one = found[max(able, key=lambda k: found[k][0])]
    if horizon.kind == "whole":
        return replace(horizon, reason="no shorter ones say more about the parameters")
    return replace(horizon, reason=f"whole runs lose the records{_lost_after(one, batch)}")


def astray(fits: Sequence[FitResult], batch: Batch) -> float:
    """Normalised RMSE beyond noise of the free runs of fits, outputs and records averaged.

    Noise leads no free run astray, however little an output moves.

    Args:
        fits: of whole records or of their pieces.
        batch: the whole records.
    """
    found = []
    for one in fits:
        for record in dict.fromkeys(one.records):
            square = np.square(_joined(one.residual, one, record)).mean(0)
            found.append(_relative(square, batch, batch.names.index(record)).mean())
    return float(np.mean(found))


def _relative(square: np.ndarray, batch: Batch, row: int) -> np.ndarray:
    """Error beyond noise as a share of what a record's outputs move; mean squares of weighted residuals (..., n_y)."""
    scale = batch.motion()[row].cpu().numpy()
    return np.sqrt(np.maximum(square - 1.0, 0.0) / np.maximum(np.square(scale), 1.0))


def _lost_after(result: FitResult, batch: Batch) -> str:
    """In words: the time after which a model's free runs over whole records have an error that lost them."""
    run = simulate(result.system, result.engine, batch)
    residual = ((run.y - batch.y) * batch.weight).cpu().numpy()
    samples = np.arange(1, residual.shape[1] + 1)[:, None]
    errors = [_relative(np.cumsum(r**2, 0) / samples, batch, k).mean(1) for k, r in enumerate(residual)]
    lost = ~(np.mean(errors, 0) <= FOLLOWED)
    return f" after {np.argmax(lost) * batch.step:.2g} s" if lost.any() else ""


def _joined(parts: Sequence[np.ndarray], result: FitResult, record: str) -> np.ndarray:
    """Rows of a record's pieces, one after the other."""
    return np.concatenate([part for part, name in zip(parts, result.records, strict=True) if name == record])


def covariance_size(result: FitResult, inside: Sequence[int]) -> tuple[float, float]:
    """Log volume of the ellipsoid of standard errors of some parameters, and in how many directions records tell it.

    The scatter of the score over blocks gives it. Nobody knows less of a parameter than its own size.
    """
    records, inside = list(dict.fromkeys(result.records)), list(inside)
    noise = max(result.noise_scale, 1e-12) ** 2
    prior = np.diag(result.prior_precision[inside])
    weak = noise * np.diag(1.0 / np.maximum(np.abs(result.values[inside]), 1e-12) ** 2)
    information, scatter = prior + weak, prior + noise * weak
    known = information
    for record in records:
        jacobian = _joined(result.jacobian, result, record)[..., inside]
        score = np.einsum("tyi,ty->ti", jacobian, _joined(result.residual, result, record))
        information = information + np.einsum("tyi,tyj->ij", jacobian, jacobian)
        blocks = np.array([b.sum(0) for b in np.array_split(score, -(-BLOCKS // len(records)))])
        scatter = scatter + blocks.T @ blocks
    size = 0.5 * np.linalg.slogdet(scatter)[1] - np.linalg.slogdet(information)[1]
    return float(size), len(inside) - float(np.trace(np.linalg.solve(information, known)))
