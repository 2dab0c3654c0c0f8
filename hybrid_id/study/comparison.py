"""Replaying records through models, and setting models side by side."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch

from hybrid_id.errors import InputError
from hybrid_id.identification.horizon_choice import FOLLOWED, choose_horizon
from hybrid_id.identification.horizons import WHOLE, Horizon
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.record import Record
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.divergence import cause_of_divergence
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.solvers import stable_engine
from hybrid_id.simulation.step import Engine
from hybrid_id.statistics.fit import fit_percent, known_mean, nrmse
from hybrid_id.study.replays import simulated_over
from hybrid_id.systems.chain import System


@dataclass(frozen=True, eq=False)
class Replay:
    """Free run of a model under the inputs of a record.

    Attributes:
        record: the record.
        outputs: simulated outputs by name, ``(T,)``; NaN in an end that is shorter than a window.
        fit: fit of each output [%]; -inf where the simulation diverged.
        nrmse: normalised RMSE of each output.
        status: "ok" or "diverged".
        message: why it diverged, in one sentence; empty where it did not.
    """

    record: Record
    outputs: Mapping[str, np.ndarray]
    fit: Mapping[str, float]
    nrmse: Mapping[str, float]
    status: str
    message: str = ""


@dataclass(frozen=True, eq=False)
class Comparison:
    """Several models on the same records.

    Attributes:
        replays: label of each model -> its replays, all in the order of the records.
        horizon: how long the free runs are, alike for all models.
    """

    replays: Mapping[str, tuple[Replay, ...]]
    horizon: Horizon = WHOLE

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


def replay(
    dataset: Dataset, system: System, *, engine: Engine | None = None, horizon: Horizon = WHOLE
) -> tuple[Replay, ...]:
    """Simulate every record of a dataset in open loop from its start position.

    Args:
        dataset: the records.
        system: the model.
        engine: how a sample is integrated (default: dry friction); sub-steps are raised where stability needs it.
        horizon: where the free runs begin anew from a measured state (default: nowhere).

    Raises:
        InputError: a channel that the model needs is missing.
    """
    batch = _batch(dataset, system)
    engine = stable_engine(system, engine or Engine(), batch)
    runs = simulated_over(horizon, system, engine, batch)
    found = []
    for record, run in zip(dataset.records, runs, strict=True):
        whole = np.pad(run, ((0, record.n_samples - len(run)), (0, 0)), constant_values=np.nan)
        fits, errors = (
            {n: float(of(record.signal(n)[: len(run)], run[:, k])) for k, n in enumerate(batch.outputs)}
            for of in (fit_percent, nrmse)
        )
        outputs = dict(zip(batch.outputs, whole.T, strict=True))
        lost = "" if np.isfinite(run).all() else _why_lost(system, engine, batch, record.name)
        found.append(Replay(record, outputs, fits, errors, "diverged" if lost else "ok", lost))
    return tuple(found)


def _why_lost(system: System, engine: Engine, batch: Batch, record: str) -> str:
    part = batch.take(torch.tensor([batch.names.index(record)]))
    cause = cause_of_divergence(system, engine, part, simulate(system, engine, part).x)
    return cause or f"record '{record}': the simulation has no finite output; correct the values of the model"


def _batch(dataset: Dataset, system: System) -> Batch:
    noise = {channel.name: channel.noise_std for channel in dataset.outputs}
    return make_batch(system, dataset.records, noise_std=noise)


def compare(
    dataset: Dataset,
    models: Mapping[str, System],
    *,
    engine: Engine | None = None,
    horizon: Horizon | None = None,
) -> Comparison:
    """Replay every record through every model over one horizon.

    Args:
        dataset: the records.
        models: by label.
        engine: as in :func:`replay`.
        horizon: of all models (default: the records choose it, by the model that errs least over whole records).

    Raises:
        InputError: no model, a channel that a model needs is missing, or a simulation diverged.
    """
    if not models:
        raise InputError("there is no model to compare; give at least one")
    replays = {}
    for label, system in models.items():
        try:
            replays[label] = replay(dataset, system, engine=engine, horizon=horizon or WHOLE)
        except InputError as error:
            raise InputError(f"{label}: {error}") from None
        if lost := next((run.message for run in replays[label] if run.message), ""):
            raise InputError(f"{label}: {lost}")
    if horizon is not None:
        return Comparison(replays, horizon)
    errors = {label: _mean_error(runs) for label, runs in replays.items()}
    best = models[min(errors, key=lambda label: errors[label])]
    horizon = Horizon(reason="they follow the records")
    if min(errors.values()) > FOLLOWED:
        horizon = choose_horizon(best, engine or Engine(), _batch(dataset, best))
    if horizon.kind == "whole":
        return Comparison(replays, horizon)
    return compare(dataset, models, engine=engine, horizon=horizon)


def _mean_error(runs: tuple[Replay, ...]) -> float:
    """Mean normalised RMSE over records and outputs; infinite where a run diverged."""
    error = known_mean([known_mean(run.nrmse.values()) for run in runs])
    return error if np.isfinite(error) else np.inf
