"""How reliable each parameter of a diagnosis's fitted model is: assessed as `identify` assesses its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hybrid_id.diagnosis.fits import Fits
from hybrid_id.diagnosis.model import Model
from hybrid_id.identification.finite_differences import finite_difference_fit
from hybrid_id.study import Study, analyse_fits, check_identifiability


def as_identified(fits: Fits, model: Model, *, seed: int = 0, level: float = 0.95) -> Study:
    """The statistics of `identify` for a model that a search has fitted: intervals, reliability, what is identified.

    A search keeps of its sensitivities only their products; here they are computed again, at the values where it has
    ended. They come from finite steps, which see through events (play, stick and slip) and blur a change of the
    parameters that the outputs do not show at all: what the exact sensitivities show to be none is taken out.

    Args:
        fits: the records of the last fit, and its horizon.
        model: the fitted model.
        seed: of the bootstrap.
        level: confidence of the intervals.
    """
    found, system, dataset, share = model.result, model.system, fits.dataset, fits.signal_share
    batch = fits.batch(system)
    there = finite_difference_fit(system, batch, engine=found.engine, iterations=0, x0=found.x0)
    seen = check_identifiability(dataset, system, signal_share=share)
    unseen = [one.relative for one in seen.directions if not np.isfinite(one.relative_std)]
    there = replace(
        there,
        status=found.status,
        iterations=found.iterations,
        jacobian=tuple(_without(part, there.values, unseen) for part in there.jacobian),
    )
    return analyse_fits(
        dataset, system, [there], pooled=True, batch=batch, seed=seed, signal_share=share, level=level
    )


def _without(jacobian: np.ndarray, values: np.ndarray, unseen: list[np.ndarray]) -> np.ndarray:
    """Sensitivities ``(T, n_y, n_f)`` without what they show along relative changes ``(n_f,)`` that nothing sees."""
    if not unseen:
        return jacobian
    axes = np.linalg.qr(np.where(values == 0.0, 0.0, np.array(unseen)).T)[0]
    size = np.where(values == 0.0, 1.0, values)
    relative = jacobian * size
    return (relative - (relative @ axes) @ axes.T) / size
