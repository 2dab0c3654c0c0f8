"""How large the gap is: errors of free runs on records that neither search nor fit has seen."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from hybrid_id.diagnosis.evidence import coloured
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.measures import less_half_a_count
from hybrid_id.simulation.prepare import SIGNAL_SHARE
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.stability import with_substeps
from hybrid_id.simulation.step import Engine
from hybrid_id.study.replays import batch_of
from hybrid_id.systems.chain import System

LOST = 1e6
"""Largest error of a run that has diverged, in the output's unit."""
BLOCK = 0.5
"""Length [s] of the blocks that are drawn for intervals."""


@dataclass(frozen=True, eq=False)
class Errors:
    """Errors of a model's free runs on records.

    Attributes:
        nrmse: normalised RMSE, averaged over outputs and records.
        by_record: of each record, outputs averaged.
        blocks: for each record and output the mean squares of short blocks, each over the signal's variance.
        noise: normalised RMSE that the encoders' noise alone would leave.
        coloured: share of the errors' mean square, in units of the measurements' weights, that is no white noise; an
            offset of half a count is none, whether an encoder rounds or counts edges.
        over_noise: RMS errors of each record in those units.
    """

    nrmse: float
    by_record: dict[str, float]
    blocks: tuple[tuple[np.ndarray, ...], ...]
    noise: float
    coloured: float = 0.0
    over_noise: dict[str, float] = field(default_factory=dict)

    def resampled(self, draw: list[list[np.ndarray]]) -> float:
        """Normalised RMSE of blocks drawn with replacement; ``draw`` holds the blocks of each record and output."""
        rows = [
            np.mean([np.sqrt(np.mean(b[d])) for b, d in zip(row, drawn, strict=True)])
            for row, drawn in zip(self.blocks, draw, strict=True)
        ]
        return float(np.mean(rows))


def errors(
    dataset: Dataset, system: System, engine: Engine | None = None, *, signal_share: float = SIGNAL_SHARE
) -> Errors | None:
    """Errors of a model on the test records, None where none of them moves.

    Args:
        dataset: its test records are replayed from their first state.
        system: the model.
        engine: how it is integrated.
        signal_share: see :func:`hybrid_id.simulation.prepare.make_batch`.
    """
    if not dataset.test:
        return None
    batch = batch_of(dataset, system, dataset.test, signal_share, "cpu")
    run = simulate(system, with_substeps(system, engine or Engine(), batch), batch)
    step = batch.step
    length = max(1, round(BLOCK / step))
    blocks, by_record, over_noise, noise, weighted = [], {}, {}, [], []
    for r, name in enumerate(batch.names):
        row, floors = [], []
        for c, output in enumerate(batch.outputs):
            valid = (batch.weight[r, :, c] > 0).numpy()
            measured, simulated = batch.y[r, valid, c].numpy(), run.y[r, valid, c].numpy()
            if not measured.size or np.ptp(measured) <= 1e-12 * np.abs(measured).max():
                continue  # nothing to explain
            error = np.clip(np.nan_to_num(simulated - measured, nan=LOST), -LOST, LOST)
            centred = less_half_a_count(error, measured)
            weighted.append((centred * batch.weight[r, valid, c].numpy())[:, None])
            square = np.square(error)
            starts = np.arange(0, len(square), length)
            size = np.add.reduceat(np.ones(len(square)), starts)
            variance = float(measured.var())
            row.append(np.add.reduceat(square, starts) / size / variance)
            declared = next((ch.noise_std for ch in dataset.outputs if ch.name == output), None)
            floors.append((declared or 0.0) / np.sqrt(variance))
        if not row:
            continue
        blocks.append(tuple(row))
        noise.append(float(np.mean(floors)))
        by_record[name] = float(np.mean([np.sqrt(b.mean()) for b in row]))
        over_noise[name] = float(np.sqrt(np.square(np.concatenate(weighted[-len(row) :])).mean()))
    if not blocks:
        return None
    nrmse, floor = float(np.mean(list(by_record.values()))), float(np.mean(noise))
    return Errors(nrmse, by_record, tuple(blocks), floor, coloured(weighted), over_noise)
