"""Whether what a model leaves of records looks like noise: the residuals of its free runs, output by output."""

from __future__ import annotations

import numpy as np

from hybrid_id.records.dataset import Dataset
from hybrid_id.records.measures import less_half_a_count
from hybrid_id.records.smoothing import noise_level
from hybrid_id.simulation.prepare import SIGNAL_SHARE
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.solvers import OdeEngine, stable_engine
from hybrid_id.simulation.step import Engine
from hybrid_id.statistics.residuals import ResidualTest, residual_test
from hybrid_id.study.replays import batch_of
from hybrid_id.systems.chain import System


def residual_tests(
    dataset: Dataset, system: System, engine: Engine | OdeEngine, *, signal_share: float = SIGNAL_SHARE
) -> tuple[ResidualTest, ...]:
    """Test what a model leaves of the test records, or of the train records where no record is a test.

    Free runs from measured first states. An output that stands still in all of these records is left out.

    Args:
        dataset: the records, with the noise that it declares; it is estimated from the records where it is not.
        system: the model.
        engine: how it was fitted.
        signal_share: see :func:`hybrid_id.simulation.prepare.make_batch`.
    """
    records = dataset.test or dataset.train
    batch = batch_of(dataset, system, records, signal_share, "cpu")
    run = simulate(system, stable_engine(system, engine, batch), batch)
    declared = {channel.name: channel.noise_std for channel in dataset.outputs}
    tests = []
    for column, output in enumerate(batch.outputs):
        residual, inputs, noise = [], [], []
        for row, record in enumerate(records):
            measured = record.outputs[output]
            if np.ptp(measured) == 0.0:
                continue
            left = measured - run.y[row, : record.n_samples, column].numpy()
            residual.append(less_half_a_count(left, measured) if np.isfinite(left).all() else left)
            inputs.append(record.inputs)
            given = declared[output]
            noise.append(float(noise_level(measured)) if given is None else given)
        if residual:
            tests.append(residual_test(output, residual, inputs, noise))
    return tuple(tests)
