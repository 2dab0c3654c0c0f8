"""Replaying records through models, and setting models side by side."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hybrid_id.errors import InputError
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.record import Record
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.solvers import stable_engine
from hybrid_id.simulation.step import Engine
from hybrid_id.statistics.fit import fit_percent, nrmse
from hybrid_id.systems.chain import System


@dataclass(frozen=True, eq=False)
class Replay:
    """Free run of a model under the inputs of a record.

    Attributes:
        record: the record.
        outputs: simulated outputs by name, ``(T,)``.
        fit: fit of each output [%]; -inf where the simulation diverged.
        nrmse: normalised RMSE of each output.
        status: "ok" or "diverged".
    """

    record: Record
    outputs: Mapping[str, np.ndarray]
    fit: Mapping[str, float]
    nrmse: Mapping[str, float]
    status: str


@dataclass(frozen=True, eq=False)
class Comparison:
    """Several models on the same records.

    Attributes:
        replays: label of each model -> its replays, all in the order of the records.
    """

    replays: Mapping[str, tuple[Replay, ...]]

    @property
    def records(self) -> tuple[str, ...]:
        """Names of the records."""
        return tuple(replay.record.name for replay in next(iter(self.replays.values())))

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return tuple(next(iter(self.replays.values()))[0].fit)

    def table(self, measure: str) -> dict[str, np.ndarray]:
        """``fit`` or ``nrmse`` by model, ``(n_records, n_signals)``."""
        return {
            label: np.array(
                [[getattr(replay, measure)[signal] for signal in self.signals] for replay in replays]
            )
            for label, replays in self.replays.items()
        }


def replay(dataset: Dataset, system: System, *, engine: Engine | None = None) -> tuple[Replay, ...]:
    """Simulate every record of a dataset in open loop from its start position.

    Args:
        dataset: the records.
        system: the model.
        engine: how a sample is integrated (default: dry friction); sub-steps are raised where stability needs it.

    Raises:
        InputError: a channel that the model needs is missing.
    """
    noise = {channel.name: channel.noise_std for channel in dataset.outputs}
    batch = make_batch(system, dataset.records, noise_std=noise)
    run = simulate(system, stable_engine(system, engine or Engine(), batch), batch)
    found = []
    for row, record in enumerate(dataset.records):
        outputs = {n: run.y[row, : record.n_samples, k].numpy() for k, n in enumerate(batch.outputs)}
        found.append(
            Replay(
                record,
                outputs,
                {n: float(fit_percent(record.signal(n), values)) for n, values in outputs.items()},
                {n: float(nrmse(record.signal(n), values)) for n, values in outputs.items()},
                run.status[row],
            )
        )
    return tuple(found)


def compare(dataset: Dataset, models: Mapping[str, System], *, engine: Engine | None = None) -> Comparison:
    """Replay every record through every model; arguments as in :func:`replay`, models by label."""
    if not models:
        raise InputError("there is no model to compare; give at least one")
    replays = {}
    for label, system in models.items():
        try:
            replays[label] = replay(dataset, system, engine=engine)
        except InputError as error:
            raise InputError(f"{label}: {error}") from None
    return Comparison(replays)
