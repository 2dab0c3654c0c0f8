"""Training by the adjoint method on a dataset's records, and its history in TensorBoard."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from hybrid_id.errors import InputError
from hybrid_id.identification.adjoint import Snapshot
from hybrid_id.identification.adjoint import train as train_batch
from hybrid_id.identification.horizons import window_samples
from hybrid_id.identification.result import FitResult
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.record import Record
from hybrid_id.simulation.prepare import SIGNAL_SHARE
from hybrid_id.statistics.fit import fit_percent
from hybrid_id.study.replay import batch_of
from hybrid_id.systems.chain import System

__all__ = ["Overlay", "Snapshot", "overlays", "scalars", "too_long", "train"]


def train(
    dataset: Dataset,
    system: System,
    *,
    device: str = "cpu",
    signal_share: float = SIGNAL_SHARE,
    **settings: Any,
) -> list[FitResult]:
    """Train one parameter set for each train record, or one over all; validation records validate, else test records.

    Args:
        dataset: the records.
        system: model with start values; it stays as it is.
        device: torch device.
        signal_share: see :func:`hybrid_id.simulation.prepare.make_batch`.
        settings: further arguments of :func:`hybrid_id.identification.adjoint.train`.

    Raises:
        InputError: no train record.
    """
    if not dataset.train:
        raise InputError(f"dataset '{dataset.name}' has no train record; give at least one the role 'train'")
    batch, held = (
        batch_of(dataset, system, records, signal_share, device) if records else None
        for records in (dataset.train, dataset.validation or dataset.test)
    )
    assert batch is not None
    return train_batch(copy.deepcopy(system).to(device), batch, validation=held, **settings)


def too_long(records: Sequence[Record], windows: Sequence[float]) -> tuple[list[float], str]:
    """Windows [s] of which not four fit into the longest record, and why, in words."""
    step = float(np.median(np.concatenate([np.diff(record.time) for record in records])))
    samples = max(record.n_samples for record in records)
    size = f"{samples * step:.3g} s ({samples} samples)"
    why = f"the longest record has {size}; four windows must fit, of 25 samples or more"
    return [s for s in windows if window_samples(samples, step, s) is None], why


@dataclass(frozen=True, eq=False)
class Overlay:
    """An output of one record (or window) as measured and as simulated by a set, ``(T,)`` each.

    Attributes:
        set_name: name of the set; record: of the record; signal: of the output.
        time: [s] from the first sample.
        measured, simulated: in the output's unit.
    """

    set_name: str
    record: str
    signal: str
    time: np.ndarray
    measured: np.ndarray
    simulated: np.ndarray


def overlays(snapshot: Snapshot, *, first_only: bool = False) -> Iterator[Overlay]:
    """Measured and simulated outputs of the records of every set, of the first one of each with ``first_only``."""
    batch, start = snapshot.batch, snapshot.batch.dt.new_zeros(1)
    for g, name in enumerate(snapshot.names):
        rows = (snapshot.sets == g).nonzero().flatten().tolist()
        for row in rows[:1] if first_only else rows:
            time = torch.cat([start, batch.dt[row].cumsum(0)[:-1]])
            for k, signal in enumerate(batch.outputs):
                used = batch.weight[row, :, k] > 0
                columns = (time[used], batch.y[row, used, k], snapshot.simulated[row, used, k])
                yield Overlay(name, batch.names[row], signal, *(np.asarray(c.cpu()) for c in columns))


def scalars(snapshot: Snapshot, *, fits: bool = True) -> dict[str, dict[str, float]]:
    """Figures of a snapshot by set and tag: losses, gradient, parameters; with ``fits`` the mean fit [%] of outputs."""
    found: dict[str, dict[str, float]] = {}
    for g, name in enumerate(snapshot.names):
        found[name] = {
            "loss/train": float(snapshot.train[g]),
            "gradient/norm": float(snapshot.gradient_norm[g]),
        }
        if snapshot.validation is not None:
            found[name]["loss/validation"] = float(snapshot.validation[g])
        values = (float(value) for value in snapshot.values[g])
        found[name] |= dict(zip(snapshot.parameter_tags, values, strict=True)) | dict(snapshot.scalars)
    of_output: dict[tuple[str, str], list[float]] = {}
    for one in overlays(snapshot) if fits else ():
        fit = float(fit_percent(one.measured, one.simulated))
        of_output.setdefault((one.set_name, one.signal), []).append(fit)
    for (name, signal), some in of_output.items():
        found[name][f"fit/{signal}"] = float(np.nanmean(some)) if np.isfinite(some).any() else float("nan")
    return found
