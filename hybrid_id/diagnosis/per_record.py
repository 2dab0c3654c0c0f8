"""Parameters that differ from record to record: no common set explains such records, and yet no effect is missing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hybrid_id.diagnosis.criteria import CRITERIA
from hybrid_id.diagnosis.fits import FULL, SLOW, Fits, Task, engine, without_priors
from hybrid_id.diagnosis.model import FittedModel, Unfitted
from hybrid_id.diagnosis.starts import with_values_of
from hybrid_id.diagnosis.validation import autocorrelation, mean_square
from hybrid_id.identification.fit import kept_fit
from hybrid_id.identification.least_squares import Options
from hybrid_id.identification.result import FitResult
from hybrid_id.statistics.cross_validation import select
from hybrid_id.study.replay import cross_validate
from hybrid_id.systems.chain import System

NAMED = 3
"""Parameters that are named."""


@dataclass(frozen=True, eq=False)
class PerRecord:
    """One parameter set for each train record.

    Attributes:
        model: the model whose set stands for all records: as it was, or fitted again from that of one record, where it
            explains the train records together; otherwise with the set that predicts the others best, where that
            predicts them better.
        autocorrelation: share of what these sets leave that neighbouring samples have in common.
        varying: the parameters whose differences matter most, each with its standard deviation over the records, where
            the records' own sets leave next to nothing but white noise; none where they do not differ surely, or one
            set explains all records that no common one had explained.
        explained: whether nothing structural is left with these sets.
    """

    model: FittedModel
    autocorrelation: float
    varying: tuple[str, ...] = ()
    explained: bool = False


def per_record(fits: Fits, model: FittedModel, nominal: System) -> PerRecord | None:
    """Fit a model to every train record by itself.

    A drive's friction is another one on every day: its parameters scatter, and what one common set leaves is no effect
    of a name. An effect that a model lacks shows within a record, too, whatever its parameters are.

    Args:
        fits: holds the records.
        model: the model, fitted to all train records together, which differences may have led astray.
        nominal: the nominal system; each fit starts from its values.

    Returns:
        None where there is one record only, or a fit fails, or models are fitted over windows.
    """
    system, batch = model.system, fits.records(model.system)
    if batch.rows < 2 or not fits.whole:
        return None
    options = Options(max_iterations=FULL, tolerance=0.05, least_gain=SLOW)
    start = without_priors(with_values_of(system, nominal) or system, nominal)
    try:
        sets = kept_fit(fits.kept, start, batch, pooled=False, engine=engine(), options=options)
    except RuntimeError as error:  # one of them breaks off
        fits.tally.failed[Unfitted(model.effects, f"each record by itself: {error}")] += 1
        return None
    finally:
        fits.tally.tried += 1
    if any(one.status == "diverged" for one in sets):
        return None
    left = autocorrelation([residual for one in sets for residual in one.residual])
    if float(np.mean([structural(one.residual) for one in sets])) > CRITERIA.negligible_structure**2:
        return PerRecord(model, left)
    if model.autocorrelation <= CRITERIA.coloured:
        return PerRecord(model, left, scatter(sets), True)
    own = select(cross_validate(sets, batch, pooled=False)).index
    task, words = Task(model.effects, sets[own].system), scatter(sets)
    there, fitted = fits.run([task], 0)[0], fits.run([task], FULL)[0]
    if fitted is not None and fitted.autocorrelation <= CRITERIA.coloured:
        return PerRecord(fitted, left, explained=True)
    if there is None or not words:
        return PerRecord(model, left)
    if there.judged:
        better = there.error < model.error
    else:  # its own record has fitted it, and says nothing of it; errors count as those that it is compared with
        if fits.weights is not None:
            there = replace(there, validation=there.validation.weighted(fits.weights))
        better = there.validation.without(own).error < model.validation.without(own).error
    return PerRecord(there if better else model, left, words, True)


def structural(residual: Sequence[np.ndarray]) -> float:
    """Mean square of what a record's own values leave that is no white noise, in units of the noise.

    Args:
        residual: weighted errors, ``(T, n_y)`` of each piece.
    """
    found = autocorrelation(residual)
    return found * mean_square(residual) if found > CRITERIA.white else 0.0


def scatter(sets: Sequence[FitResult]) -> tuple[str, ...]:
    """Parameters by how much their differences move the outputs, along the directions that the records identify.

    Directions along which the sets differ by little more than their own errors are left out, so that records with
    little information are not taken for others.
    """
    values = np.array([one.values for one in sets])
    sizes = np.sqrt(np.mean(np.square(values), axis=0))  # a mean may be near zero, where signs differ
    sizes = np.where(sizes > 0.0, sizes, 1.0)
    relative = (values - values.mean(0)) / sizes
    roots = [np.concatenate([np.reshape(j, (-1, len(sizes))) for j in one.jacobian]) * sizes for one in sets]
    squares = np.array([root.T @ root for root in roots])
    eigenvalues, directions = np.linalg.eigh(squares.sum(0))
    identified = directions[:, eigenvalues > CRITERIA.least_information * eigenvalues[-1]]
    coordinates, information = relative @ identified, identified.T @ squares @ identified
    noise = np.array([max(one.noise_scale, 1e-300) ** 2 for one in sets])
    own = np.diagonal(np.linalg.pinv(information / noise[:, None, None]), axis1=1, axis2=2)
    seen = np.diagonal(information, axis1=1, axis2=2)
    # a record in which a joint stands still says nothing of its friction
    seen = seen > CRITERIA.least_information * seen.max(0)
    surely = [
        here.sum() > 1 and line[here].var(ddof=1) > CRITERIA.between_records * errors[here].mean()
        for line, errors, here in zip(coordinates.T, own.T, seen.T, strict=True)
    ]
    differ = identified[:, surely]
    scatter = (relative @ differ @ differ.T).std(0, ddof=1)
    order = np.argsort(-scatter * np.sqrt(np.diag(squares.sum(0))))[:NAMED]
    return tuple(f"{sets[0].names[i]} by {100 * scatter[i]:.2g} %" for i in order if scatter[i] > 0)
