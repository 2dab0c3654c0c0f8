"""The test records, opened once: how large the gap is, and how far it shrinks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from hybrid_id.diagnosis.validation import BLOCK, autocorrelation
from hybrid_id.identification.horizons import WHOLE, Horizon
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.measures import less_half_a_count
from hybrid_id.records.record import Record
from hybrid_id.simulation.step import Engine
from hybrid_id.study.replay import batch_of, run_freely
from hybrid_id.systems.chain import System

LOST = 1e6
"""Largest error of a run that has diverged, in the output's unit."""
DRAWS = 500
"""Draws of blocks for intervals."""
ALIKE, ALIKE_LENGTH = 0.02, 0.8
"""RMS difference of two records' inputs, and of their first angles, relative to what they move, up to which one repeats
the other; and how much of the longer one the shorter one has at least."""


@dataclass(frozen=True, eq=False)
class Errors:
    """Errors of a model's free runs on records.

    Attributes:
        nrmse: normalised RMSE, averaged over outputs and records.
        by_record: of each record, outputs averaged.
        by_output: of each output, records averaged.
        blocks: for each record and output the mean squares of short blocks, each over the signal's variance.
        noise: normalised RMSE that the encoders' noise alone would leave.
        autocorrelation: share of the errors' mean square, in units of the measurements' weights, that neighbouring
            samples have in common; an offset of half a count is none, whether an encoder rounds or counts edges.
        over_noise: RMS of all errors in those units.
        rmse: RMSE of each output in its SI unit, records averaged.
        squares: of each output the normalised mean square, and that in SI units squared, records averaged.
    """

    nrmse: float
    by_record: dict[str, float]
    by_output: dict[str, float]
    blocks: tuple[tuple[np.ndarray, ...], ...]
    noise: float
    autocorrelation: float = 0.0
    over_noise: float = 0.0
    rmse: dict[str, float] = field(default_factory=dict)
    squares: dict[str, tuple[float, float]] = field(default_factory=dict)

    def resampled(self, draw: list[list[np.ndarray]]) -> float:
        """Normalised RMSE of blocks drawn with replacement; ``draw`` holds the blocks of each record and output."""
        rows = [
            np.mean([np.sqrt(np.mean(b[d])) for b, d in zip(row, drawn, strict=True)])
            for row, drawn in zip(self.blocks, draw, strict=True)
        ]
        return float(np.mean(rows))


def errors(
    dataset: Dataset,
    system: System,
    engine: Engine,
    records: Sequence[Record] | None = None,
    *,
    horizon: Horizon = WHOLE,
) -> Errors | None:
    """Errors of a model on records, None where there is none that moves.

    Args:
        dataset: holds the outputs and their noise.
        system: the model.
        engine: how it is integrated.
        records: the records; by default the test records.
        horizon: how long the free runs are before they start again from a measured state.
    """
    records = dataset.test if records is None else records
    if not records:
        return None
    whole = batch_of(dataset, system, records)
    runs = run_freely(system, engine, whole, horizon)
    batch, simulated = runs.pieces, runs.simulated.y.numpy()
    length = max(1, round(BLOCK / batch.sample_time))
    declared = {channel.name: channel.noise_std or 0.0 for channel in dataset.outputs}
    blocks, by_record, by_output, plain, noise, weighted = [], {}, {}, {}, [], []
    for r, name in enumerate(whole.names):
        row, floors = [], []
        rows = [k for k, one in enumerate(batch.names) if one == name]
        for c, output in enumerate(batch.outputs):
            measured = whole.y[r, (whole.weight[r, :, c] > 0), c].numpy()
            if not measured.size or np.ptp(measured) <= 1e-12 * np.abs(measured).max():
                continue  # nothing to explain
            variance, means = float(measured.var()), []
            for k in rows:
                valid = (batch.weight[k, :, c] > 0).numpy()
                seen = batch.y[k, valid, c].numpy()
                error = np.clip(np.nan_to_num(simulated[k, valid, c] - seen, nan=LOST), -LOST, LOST)
                weighted.append((less_half_a_count(error, seen) * batch.weight[k, valid, c].numpy())[:, None])
                starts = np.arange(0, len(error), length)
                size = np.add.reduceat(np.ones(len(error)), starts)
                means.append(np.add.reduceat(np.square(error), starts) / size / variance)
            row.append(np.concatenate(means))
            by_output.setdefault(output, []).append(float(np.sqrt(row[-1].mean())))
            plain.setdefault(output, []).append(by_output[output][-1] * np.sqrt(variance))
            floors.append(declared.get(output, 0.0) / np.sqrt(variance))
        if not row:
            continue
        blocks.append(tuple(row))
        noise.append(float(np.mean(floors)))
        by_record[name] = float(np.mean([np.sqrt(b.mean()) for b in row]))
    if not blocks:
        return None
    return Errors(
        float(np.mean(list(by_record.values()))),
        by_record,
        {output: float(np.mean(values)) for output, values in by_output.items()},
        tuple(blocks),
        float(np.mean(noise)),
        autocorrelation(weighted),
        float(np.sqrt(np.square(np.concatenate(weighted)).mean())),
        {output: float(np.mean(values)) for output, values in plain.items()},
        {
            output: (float(np.mean(np.square(values))), float(np.mean(np.square(plain[output]))))
            for output, values in by_output.items()
        },
    )


def repeatability(dataset: Dataset) -> float | None:
    """Normalised RMSE that test records leave which are repeats of others: no model predicts a machine better.

    Half of the variance of the difference between two runs is that of one of them. None where nothing is repeated.
    """
    found = []
    for record in dataset.test:
        pairs = [_apart(record, other) for other in dataset.records if _repeats(record, other)]
        if pairs:
            found.append(float(np.mean(pairs)))
    return float(np.mean(found)) if found else None


def _repeats(one: Record, other: Record) -> bool:
    """Whether a record was taken with the inputs of another, from the same start."""
    n = min(one.n_samples, other.n_samples)
    if one is other or n < ALIKE_LENGTH * max(one.n_samples, other.n_samples):
        return False
    if abs(one.sample_time - other.sample_time) > 1e-3 * one.sample_time:
        return False
    driven = [(one.inputs[c], other.inputs[c]) for c in one.inputs]
    apart = [(np.sqrt(np.mean(np.square(a[:n] - b[:n]))), float(a.std())) for a, b in driven]
    starts = [
        (abs(one.outputs[c][0] - other.outputs[c][0]), float(one.outputs[c].std())) for c in one.outputs
    ]
    return all(distance <= ALIKE * size for distance, size in (*apart, *starts) if size > 0.0)


def _apart(one: Record, other: Record) -> float:
    """Normalised RMSE of one run as the other predicts it, less what the other adds, outputs averaged."""
    n = min(one.n_samples, other.n_samples)
    pairs = [(one.outputs[c][:n], other.outputs[c][:n]) for c in one.outputs]
    return float(
        np.mean([np.sqrt(0.5 * np.mean(np.square(a - b))) / a.std() for a, b in pairs if a.std() > 0.0])
    )


@dataclass(frozen=True)
class Shrink:
    """Share of the closable gap that is closed on the test records.

    Attributes:
        share: ``(refit - with_effect) / (refit - floor)``; 0 where nothing is left to close.
        interval: 95 % interval from blocks drawn with replacement; its lower end takes the floor for the measurements'
            noise alone, its upper end for ``floor``, either with the scatter of the error itself: more is not known of
            it. A model may do better on these records than the right one would, so that it may reach beyond 1. It holds
            the share, whatever the draws of next to no gap say.
        refit, with_effect, floor: normalised RMSE.
        repeated: whether the floor is the repeatability of records that were taken twice.
    """

    share: float
    interval: tuple[float, float]
    refit: float
    with_effect: float
    floor: float
    repeated: bool = False


def shrink(refit: Errors, with_effect: Errors, floor: float, *, seed: int = 0) -> Shrink:
    """Compare two models on the same records.

    Args:
        refit: errors of the nominal model, re-fitted.
        with_effect: errors with the effects added.
        floor: normalised RMSE that the right model would leave.
        seed: of the draws.
    """
    generator = np.random.default_rng(seed)
    pairs = []
    for _ in range(DRAWS):
        draw = [[generator.integers(0, len(b), len(b)) for b in row] for row in refit.blocks]
        pairs.append((refit.resampled(draw), with_effect.resampled(draw)))
    scale = max(with_effect.nrmse, 1e-300)
    scatter = min(1.96 * float(np.std([after for _, after in pairs])) / scale, 0.5)
    least, most = min(with_effect.noise, floor) / scale * (1.0 - scatter), floor / scale * (1.0 + scatter)
    # the floor moves with the error that is drawn: the same blocks hold the same noise
    ends = []
    for before, after in pairs:
        highest = 0.5 * (before + after * (after < before))
        # what errs more than before errs the more of a gap, the less of it was there
        ends.append(sorted(_share(before, after, f) for f in (least * after, min(most * after, highest))))
    low, high = (
        float(np.quantile(end, q)) for end, q in zip(np.transpose(ends), (0.025, 0.975), strict=True)
    )
    share = _share(refit.nrmse, with_effect.nrmse, floor)
    return Shrink(share, (min(low, share), max(high, share)), refit.nrmse, with_effect.nrmse, floor)


def unconfirmed(gap: Shrink, what: str) -> str:
    """That the test records do not confirm a correction, in a sentence; empty where they do.

    Args:
        gap: how far it shrinks.
        what: "model" or "robot".
    """
    if gap.interval[1] <= 0.0 and gap.with_effect > gap.refit:
        return f"On the test records the corrected {what} predicts worse than the re-fitted one."
    if gap.interval[0] <= 0.0:
        return "The test records do not confirm the correction: the interval of the shrink holds zero."
    return ""


def _share(before: float, after: float, floor: float) -> float:
    closable = before - floor
    return float((before - after) / closable) if closable > 1e-3 * before else 0.0
