"""How far a diagnosis's fitted model is to be trusted, parameter by parameter: judged as `identify` judges its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hybrid_id.diagnosis.fits import Fits
from hybrid_id.diagnosis.model import Model
from hybrid_id.identification.secant import secant_fit
from hybrid_id.records.dataset import Dataset
from hybrid_id.simulation.prepare import SIGNAL_SHARE
from hybrid_id.study import Study, assess, preflight


def as_identified(
    dataset: Dataset, model: Model, *, signal_share: float = SIGNAL_SHARE, seed: int = 0
) -> Study:
    """The statistics of `identify` for a model that a search has fitted: intervals, grades, what is told together.

    A search keeps of its sensitivities only their products; here they are had again, at the values where it has ended.
    They come from finite steps, which see through events (play, stick and slip) and blur a change of the parameters
    that the outputs do not show at all: what the exact sensitivities tell to be none is taken out.

    Args:
        dataset: the records as the search has taken them, train and test.
        model: the fitted model.
        signal_share: see :func:`hybrid_id.simulation.prepare.make_batch`.
        seed: of the bootstrap.
    """
    found, system = model.result, model.system
    batch = Fits(dataset, signal_share=signal_share).records(system)
    there = secant_fit(system, batch, engine=found.engine, iterations=0, x0=found.x0)
    told = preflight(dataset, system, signal_share=signal_share)
    unseen = [one.relative for one in told.directions if not np.isfinite(one.relative_std)]
    there = replace(
        there,
        status=found.status,
        iterations=found.iterations,
        jacobian=tuple(_without(part, there.values, unseen) for part in there.jacobian),
    )
    return assess(dataset, system, [there], pooled=True, batch=batch, seed=seed, signal_share=signal_share)


def _without(jacobian: np.ndarray, values: np.ndarray, unseen: list[np.ndarray]) -> np.ndarray:
    """Sensitivities ``(T, n_y, n_f)`` without what they show along relative changes ``(n_f,)`` that nothing sees."""
    if not unseen:
        return jacobian
    axes = np.linalg.qr(np.where(values == 0.0, 0.0, np.array(unseen)).T)[0]
    size = np.where(values == 0.0, 1.0, values)
    relative = jacobian * size
    return (relative - (relative @ axes) @ axes.T) / size
