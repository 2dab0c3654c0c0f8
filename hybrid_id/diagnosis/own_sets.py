"""Parameters that differ from record to record: no common set explains such records, and yet no effect is missing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hybrid_id.diagnosis.evidence import WHITE, coloured, mean_square
from hybrid_id.diagnosis.explanation import Explanation
from hybrid_id.diagnosis.ranking import is_explained
from hybrid_id.diagnosis.refit import TO_THE_END, Refit, Task, engine
from hybrid_id.diagnosis.starts import as_today
from hybrid_id.identification.fit import fit
from hybrid_id.identification.least_squares import Options
from hybrid_id.identification.result import FitResult
from hybrid_id.statistics.selection import select
from hybrid_id.study.replays import batch_of, cross_validate
from hybrid_id.systems.chain import System

NAMED = 3
"""Parameters that are named."""
BEYOND = 4.0
"""Variance of the sets along a direction, over that of their own errors, from which the records differ along it."""
FAINT = 0.5
"""RMS of weighted errors up to which their colour says nothing: that of an encoder's counts, which dwell at rest."""
TOLD = 1e-6
"""Eigenvalue of the information on relative changes, over the greatest, below which records do not tell a direction."""


@dataclass(frozen=True, eq=False)
class OwnSets:
    """One parameter set for each record, train and test, where these leave no more than white noise.

    Attributes:
        common: the model whose set stands for all records: as it was, or fitted again from that of one record, where it
            explains the train records together; otherwise with the train record's set that fits the others best.
        varying: the parameters whose differences matter most, each with its standard deviation over the records; none
            where they do not differ surely, or one set explains all train records that no common one had explained.
    """

    common: Explanation
    varying: tuple[str, ...] = ()


def own_sets(refit: Refit, explanation: Explanation, today: System) -> OwnSets | None:
    """Fit a model to every record by itself.

    A drive's friction is another one on every day: its parameters scatter, and what one common set leaves is no effect
    of a name. An effect that a model lacks shows within a record, too, whatever its parameters are. Nor is one shown by
    a test record that the model explains with other values than the train records have told.

    Args:
        refit: holds the records.
        explanation: the model, fitted to all train records together, which differences may have led astray.
        today: today's model; each fit starts from its values.

    Returns:
        None where there is one record only, or a record is not explained by any set of its own.
    """
    dataset, system = refit.dataset, explanation.system
    if len(dataset.records) < 2:
        return None
    batch = batch_of(dataset, system, dataset.records, refit.signal_share, "cpu")
    options = Options(max_iterations=TO_THE_END, tolerance=0.05)
    start = as_today(system, today) or system
    try:
        sets = fit(start, batch, pooled=False, engine=engine(), options=options)
    except RuntimeError:  # one of them breaks off
        return None
    if any(one.status == "diverged" or not _explained(one) for one in sets):
        return None
    if is_explained(explanation):
        return OwnSets(explanation, _scatter(sets))
    train = {record.name for record in dataset.train}
    seen = [one for one in sets if one.records[0] in train]
    best = seen[select(cross_validate(seen, refit.records(system), pooled=False)).index]
    task, words = Task(explanation.effects, best.system), _scatter(sets)
    there, fitted = refit.run([task], 0)[0], refit.run([task], TO_THE_END)[0]
    if fitted is not None and is_explained(fitted):
        return OwnSets(fitted)
    return None if there is None or not words else OwnSets(there, words)


def _explained(one: FitResult) -> bool:
    """Whether a record's own values leave noise, or so little that only the encoder's counts are left."""
    return coloured(one.residual) <= WHITE or mean_square(one.residual) < FAINT**2


def _scatter(sets: list[FitResult]) -> tuple[str, ...]:
    """Parameters by how much their differences move the outputs, along the directions that the records tell.

    Directions along which the sets differ by little more than their own errors are left out, so that records that tell
    little are not taken for others.
    """
    values = np.array([one.values for one in sets])
    sizes = np.sqrt(np.mean(np.square(values), axis=0))  # a mean may be near zero, where signs differ
    sizes = np.where(sizes > 0.0, sizes, 1.0)
    relative = (values - values.mean(0)) / sizes
    roots = [np.concatenate([np.reshape(j, (-1, len(sizes))) for j in one.jacobian]) * sizes for one in sets]
    squares = np.array([root.T @ root for root in roots])
    eigenvalues, directions = np.linalg.eigh(squares.sum(0))
    told = directions[:, eigenvalues > TOLD * eigenvalues[-1]]
    coordinates, information = relative @ told, told.T @ squares @ told
    noise = np.array([max(one.noise_scale, 1e-300) ** 2 for one in sets])
    own = np.diagonal(np.linalg.pinv(information / noise[:, None, None]), axis1=1, axis2=2)
    seen = np.diagonal(information, axis1=1, axis2=2)
    seen = seen > TOLD * seen.max(0)  # a record in which a joint stands still tells nothing of its friction
    surely = [
        here.sum() > 1 and line[here].var(ddof=1) > BEYOND * errors[here].mean()
        for line, errors, here in zip(coordinates.T, own.T, seen.T, strict=True)
    ]
    differ = told[:, surely]
    scatter = (relative @ differ @ differ.T).std(0, ddof=1)
    order = np.argsort(-scatter * np.sqrt(np.diag(squares.sum(0))))[:NAMED]
    return tuple(f"{sets[0].names[i]} by {100 * scatter[i]:.2g} %" for i in order if scatter[i] > 0)
