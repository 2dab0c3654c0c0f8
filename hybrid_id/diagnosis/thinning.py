"""Records thinned where that loses nothing: the cost of a search grows with their samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hybrid_id.diagnosis.criteria import CRITERIA
from hybrid_id.diagnosis.fits import engine
from hybrid_id.identification.windows import SHORTEST
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.resample import resample_record
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.stability import with_substeps
from hybrid_id.study.replay import batch_of
from hybrid_id.systems.chain import System

LONGEST = 5e-3
"""Longest sample time [s] to which records are thinned: what swings at 50 Hz still has four samples a period."""
FEWEST = 8 * SHORTEST
"""Samples that the shortest train record keeps at least: two windows of each of the four that it is cut into."""
CARRIED = 2.0
"""RMS, in noises, of what is left of an output between the samples that stay; its noise alone leaves 1.2."""


def thinned(dataset: Dataset, system: System) -> Dataset:
    """A dataset of as few samples as lose nothing, at most 5 ms apart; inputs are averaged over the longer steps.

    Nothing is lost where the train records' outputs are had back from the samples that stay, within their noise, and
    where the nominal model's free runs, at its nominal values, differ by no more than what counts as nothing missing.
    What looks at another value than the nominal one or has more structure is judged on the thinned records alone, the
    same for every effect.

    Args:
        dataset: records; those that do not share one sample time stay as they are.
        system: the nominal model.
    """
    step = dataset.sample_time
    if step is None:
        return dataset
    least = min(record.n_samples for record in dataset.train)
    most = min(int(LONGEST / step + 1e-6), least // FEWEST)
    if most < 2:
        return dataset
    whole = batch_of(dataset, system, dataset.train)

    def outputs(batch: Batch) -> np.ndarray:
        # of the nominal model's free runs of whole records, (R, T, n_y)
        return simulate(system, with_substeps(system, engine(), batch), batch).y.numpy()

    run = outputs(whole)
    for factor in range(most, 1, -1):
        resampled = [resample_record(record, factor * step) for record in dataset.records]
        coarse = replace(dataset, records=tuple(record for record, _ in resampled), sample_time=factor * step)
        # whether what the longer steps do not carry of each output is within its noise
        left = [
            [report.lost.get(name, 0.0) for name in whole.outputs]
            for (_, report), record in zip(resampled, dataset, strict=True)
            if record.role == "train"
        ]
        if not bool((np.array(left) * whole.weight.amax(1).numpy() <= CARRIED).all()):
            continue
        # RMS difference, in noises, of the free runs at longer steps from the same first states
        short = batch_of(coarse, system, coarse.train)
        x = short.x.clone()
        x[:, 0] = whole.x[:, 0]
        other = outputs(replace(short, x=x))
        samples = min(other.shape[1], -(-run.shape[1] // factor))
        kept = slice(0, factor * samples, factor)
        weight = whole.weight.numpy()[:, kept] * (short.weight.numpy()[:, :samples] > 0)
        miss = (other[:, :samples] - run[:, kept]) * weight
        if np.sqrt(np.square(miss).sum() / max((weight > 0).sum(), 1)) <= CRITERIA.negligible:
            return coarse
    return dataset
