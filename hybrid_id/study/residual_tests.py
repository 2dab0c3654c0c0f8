"""Whether what a model leaves of records looks like noise: the residuals of its free runs, output by output."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from hybrid_id.identification.horizons import WHOLE, Horizon
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.measures import less_half_a_count
from hybrid_id.records.record import Record
from hybrid_id.records.smoothing import noise_level
from hybrid_id.simulation.prepare import SIGNAL_SHARE
from hybrid_id.simulation.solvers import stable_engine
from hybrid_id.simulation.step import Engine
from hybrid_id.statistics.residuals import ResidualTest, residual_test
from hybrid_id.study.replays import batch_of, simulated_over
from hybrid_id.study.result import Study
from hybrid_id.systems.chain import System


def residual_tests(
    dataset: Dataset,
    system: System,
    engine: Engine,
    *,
    records: Sequence[Record] = (),
    x0: np.ndarray | None = None,
    horizon: Horizon = WHOLE,
    signal_share: float = SIGNAL_SHARE,
) -> tuple[ResidualTest, ...]:
    """Test what a model's free runs leave; an output that stands still in all of the records is left out.

    Args:
        dataset: the records, with the noise that it declares; it is estimated from the records where it is not.
        system: the model.
        engine: how it was fitted.
        records: which to simulate (default: the test records, or the train records where none is a test).
        x0: first state of each, ``(R, n_x)`` (default: as measured); of whole records only.
        horizon: how long the free runs are (default: whole records).
        signal_share: see :func:`hybrid_id.simulation.prepare.make_batch`.
    """
    records = records or dataset.test or dataset.train
    batch = batch_of(dataset, system, records, signal_share, "cpu")
    if x0 is not None and horizon.kind == "whole":
        batch.x[:, 0] = torch.as_tensor(x0)
    runs = simulated_over(horizon, system, stable_engine(system, engine, batch), batch)
    declared = {channel.name: channel.noise_std for channel in dataset.outputs}
    tests = []
    for column, output in enumerate(batch.outputs):
        residual, inputs, noise = [], [], []
        for run, record in zip(runs, records, strict=True):
            measured = record.outputs[output][: len(run)]
            if np.ptp(measured) == 0.0:
                continue
            left = measured - run[:, column]
            residual.append(less_half_a_count(left, measured) if np.isfinite(left).all() else left)
            inputs.append({name: values[: len(run)] for name, values in record.inputs.items()})
            given = declared[output]
            noise.append(float(noise_level(measured)) if given is None else given)
        if residual:
            tests.append(residual_test(output, residual, inputs, noise))
    return tuple(tests)


def study_residuals(
    dataset: Dataset, study: Study, *, signal_share: float = SIGNAL_SHARE
) -> dict[str, tuple[ResidualTest, ...]]:
    """What the selected set leaves of the records that it was fitted to (``train``), and of the test records."""
    chosen = study.selected
    fitted = [dataset[name] for name in dict.fromkeys(chosen.records)]
    parts = {"train": (fitted, chosen.x0)} | ({"test": (dataset.test, None)} if dataset.test else {})
    return {
        role: residual_tests(
            dataset,
            chosen.system,
            chosen.engine,
            records=records,
            x0=x0,
            horizon=study.horizon,
            signal_share=signal_share,
        )
        for role, (records, x0) in parts.items()
    }
