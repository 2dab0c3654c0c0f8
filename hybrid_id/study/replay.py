"""The errors of free runs: records simulated through a model, whole or from measured states, and how far outputs stray.

Commands, cross-validation, diagnosis and export all take them from here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from hybrid_id.errors import InputError
from hybrid_id.identification.horizons import FOLLOWED, WHOLE, Horizon, choose_horizon, free_runs
from hybrid_id.identification.result import FitResult
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.record import Record
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.compiled import compiled_for
from hybrid_id.simulation.prepare import make_batch, typical_deviations
from hybrid_id.simulation.rollout import Simulation, cause_of_divergence, simulate
from hybrid_id.simulation.solvers import stable_engine
from hybrid_id.simulation.step import Engine
from hybrid_id.statistics.cross_validation import CrossValidation
from hybrid_id.statistics.fit import fit_percent, known_mean, nrmse, rmse
from hybrid_id.systems.by_joint import with_joint_names
from hybrid_id.systems.chain import System

WORSE = 1.02
"""Error of identified values over that of the nominal ones from which it is no accident of the noise."""


def batch_of(dataset: Dataset, system: System, records: Sequence[Record], device: str = "cpu") -> Batch:
    """Records of a dataset prepared with the noise that it declares, and weighed as is typical of it."""
    known = dataset.train or dataset.records
    noise = {channel.name: channel.noise_std for channel in dataset.outputs}
    weighing: dict[str, Any] = {"noise_std": noise, "signal_share": dataset.signal_share}
    typical = typical_deviations(known, **weighing)
    return make_batch(system, records, typical=typical, **weighing).to(device)


@dataclass(frozen=True, eq=False)
class FreeRuns:
    """Free runs of a model over records.

    Attributes:
        records: names of the records.
        pieces: what is simulated: the records, or pieces of each one after the other.
        simulated: states and outputs of the pieces.
        engine: how they are integrated.
    """

    records: tuple[str, ...]
    pieces: Batch
    simulated: Simulation
    engine: Engine

    def by_record(self, values: Tensor) -> list[np.ndarray]:
        """Values ``(P, T, n)`` of the pieces of each record, ``(T_r, n)``: an end shorter than a window is left out."""
        used, samples = (self.pieces.weight > 0).any(2).cpu().numpy(), values.cpu().numpy()
        rows: dict[str, list[int]] = {record: [] for record in self.records}
        for row, record in enumerate(self.pieces.names):
            rows[record].append(row)
        return [samples[pieces][used[pieces]] for pieces in rows.values()]

    def errors(self, measure: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> np.ndarray:
        """A measure of :mod:`hybrid_id.statistics.fit` by record and output, ``(n_records, n_outputs)``."""
        pairs = zip(self.by_record(self.pieces.y), self.by_record(self.simulated.y), strict=True)
        return np.array([measure(measured.T, simulated.T) for measured, simulated in pairs])


def run_freely(system: System, engine: Engine, batch: Batch, horizon: Horizon = WHOLE) -> FreeRuns:
    """Simulate records through a model.

    Args:
        system: the model.
        engine: how; its sub-steps are raised where stability needs it: other records may have longer samples.
        batch: whole records, prepared for the model.
        horizon: where the runs begin anew from a measured state (default: nowhere).
    """
    pieces = horizon.cut(system, engine, batch)
    engine = stable_engine(system, engine, pieces)
    # a whole record starts at rest, where it was measured
    run = simulate(system, engine, pieces) if pieces is batch else free_runs(system, engine, pieces)
    return FreeRuns(tuple(dict.fromkeys(batch.names)), pieces, run, engine)


def weighted_errors(
    system: System, engine: Engine, batch: Batch, horizon: Horizon = WHOLE
) -> dict[str, float]:
    """RMS of the weighted errors of :func:`run_freely` by record, all outputs together; infinite where one diverged."""
    runs = run_freely(system, engine, batch, horizon)
    weight, errors = runs.pieces.weight, {}
    left = runs.by_record((runs.simulated.y - runs.pieces.y) * weight)
    for record, residual, used in zip(runs.records, left, runs.by_record(weight), strict=True):
        with np.errstate(over="ignore"):  # on its way to infinity
            mean = float(np.square(residual).sum() / np.count_nonzero(used))
        errors[record] = mean**0.5 if mean == mean else np.inf
    return errors


def cross_validate(
    sets: Sequence[FitResult], batch: Batch, horizon: Horizon = WHOLE, *, pooled: bool
) -> CrossValidation:
    """Fit % of every set on every record: measured outputs, and speeds against smoothed derivatives.

    Args:
        sets: parameter sets.
        batch: whole records.
        horizon: how they are cut into pieces, which begin in hidden states of each set's own.
        pooled: whether one set was fitted to all of them.
    """
    system, fits = sets[0].system, []
    speeds = [joint.positions[0] + 1 for joint in system.joints if f"v_m{joint.number}" not in batch.outputs]
    for result in sets:
        runs = run_freely(result.system, result.engine, batch, horizon)
        measured, simulated = (
            runs.by_record(torch.cat([of.y, of.x[..., speeds]], -1)) for of in (runs.pieces, runs.simulated)
        )
        fits.append([fit_percent(y.T, run.T) for y, run in zip(measured, simulated, strict=True)])
    return CrossValidation(
        np.array(fits),
        set_names=("pooled",) if pooled else tuple(result.records[0] for result in sets),
        record_names=tuple(dict.fromkeys(batch.names)),
        signal_names=(*batch.outputs, *(system.state_names[row] for row in speeds)),
        own_record=[-1] * len(sets) if pooled else list(range(len(sets))),
    )


def engine_error(result: FitResult, batch: Batch) -> float:
    """Change of the estimates when the step is halved, in standard errors, at most.

    Linearised at the estimate, along the principal axes of what the records tell, so that it holds where single
    parameters have no standard error.
    """
    rows = torch.tensor([row for row, name in enumerate(batch.names) if name in result.records])
    part = batch.take(rows)
    coarse = simulate(result.system, result.engine, part)
    near = part if "diverged" in coarse.status else replace(part, x=coarse.x)
    fine = simulate(result.system, result.engine.halved(), near)
    change = ((fine.y - coarse.y) * part.weight).cpu().numpy()
    change = np.concatenate([c[: len(r)].reshape(-1) for c, r in zip(change, result.residual, strict=True)])
    jacobian = np.concatenate([j.reshape(-1, j.shape[-1]) for j in result.jacobian])
    if not np.all(np.isfinite(change)):
        return float("inf")
    size = np.linalg.norm(jacobian, axis=0)
    axes, strength, _ = np.linalg.svd(jacobian / np.where(size > 0, size, 1.0), full_matrices=False)
    shift = axes[:, strength > 1e-9 * strength[0]].T @ change
    return float(np.max(np.abs(shift), initial=0.0) / max(result.noise_scale, 1e-300))


@dataclass(frozen=True)
class OutputError:
    """Error of free runs in one output, mean of records.

    Attributes:
        rmse: in the output's SI unit; inf where a run diverged.
        nrmse: normalised; NaN where the output stands still in all records.
    """

    rmse: float
    nrmse: float


def errors_on(
    records: Sequence[Record],
    dataset: Dataset,
    system: System,
    engine: Engine,
    horizon: Horizon = WHOLE,
) -> tuple[dict[str, float], dict[str, OutputError]]:
    """Errors of a model on records of a dataset: normalised RMSE by record, outputs averaged, and the error by output.

    Both are empty without records.
    """
    if not records:
        return {}, {}
    batch = batch_of(dataset, system, records)
    runs = run_freely(system, engine, batch, horizon)
    normalised, plain = runs.errors(nrmse), runs.errors(rmse)
    by_record = {name: known_mean(row) for name, row in zip(batch.names, normalised, strict=True)}
    by_output = {
        name: OutputError(float(plain[:, c].mean()), known_mean(normalised[:, c]))
        for c, name in enumerate(batch.outputs)
    }
    return by_record, by_output


@dataclass(frozen=True)
class BesideNominal:
    """How well the selected set predicts records beside the nominal values: test records where there are any.

    Attributes:
        role: of the records: test, else validation, else train.
        count: how many they are.
        nominal: normalised RMSE with the nominal values, mean of the outputs and records; inf where a run diverged.
        identified: the same with the selected set.
    """

    role: str
    count: int
    nominal: float
    identified: float

    @property
    def worse(self) -> bool:
        """Whether the selected set errs more than the nominal values, by more than noise would have it."""
        return self.identified > WORSE * self.nominal

    @property
    def words(self) -> str:
        """Both errors in a sentence, and what to do where the selected set errs more."""
        records = f"{self.count} {self.role} record{'s' * (self.count > 1)}"
        why = (
            "other start values (--starts), or --pooled, may fit them better"
            if self.role == "train"
            else "the train records do not determine the values, or show what the model lacks otherwise than these "
            "records ('hybrid-id diagnose'); keep the nominal values, or record more motion"
        )
        return (
            f"the identified values predict the {records} worse than the nominal values do: normalised RMSE "
            f"{self.identified:.3g}, nominal {self.nominal:.3g}; {why}"
        )


def beside_nominal(
    dataset: Dataset,
    system: System,
    result: FitResult,
    horizon: Horizon = WHOLE,
    tested: Mapping[str, float] | None = None,
) -> BesideNominal:
    """Errors of a set beside those of the nominal values that its fit started from.

    Args:
        dataset: the records.
        system: the model with its nominal values.
        result: the set.
        horizon: how long the free runs are.
        tested: errors of the set on the test records, where they are known.
    """
    by_role = {"test": dataset.test, "validation": dataset.validation, "train": dataset.train}
    role, records = next((role, records) for role, records in by_role.items() if records)

    def errors(one: System) -> Mapping[str, float]:
        return errors_on(records, dataset, one, result.engine, horizon)[0]

    nominal, identified = (
        known_mean(each.values()) for each in (errors(system), tested or errors(result.system))
    )
    return BesideNominal(role, len(records), nominal, identified)


@dataclass(frozen=True, eq=False)
class Replay:
    """Free run of a model under the inputs of a record.

    Attributes:
        record: the record.
        outputs: simulated outputs by name, ``(T,)``; NaN in an end that is shorter than a window.
        fit: fit of each output [%]; -inf where the simulation diverged.
        nrmse: normalised RMSE of each output.
        rmse: RMSE of each output in its SI unit.
        status: "ok" or "diverged".
        message: why it diverged, in one sentence; empty where it did not.
    """

    record: Record
    outputs: Mapping[str, np.ndarray]
    fit: Mapping[str, float]
    nrmse: Mapping[str, float]
    rmse: Mapping[str, float]
    status: str
    message: str = ""


@dataclass(frozen=True, eq=False)
class Comparison:
    """Several models on the same records.

    Attributes:
        replays: label of each model -> its replays, all in the order of the records.
        horizon: how long the free runs are, alike for all models.
        outputs: channels of the dataset.
    """

    replays: Mapping[str, tuple[Replay, ...]]
    horizon: Horizon = WHOLE
    outputs: tuple[Channel, ...] = ()

    @property
    def records(self) -> tuple[str, ...]:
        """Names of the records."""
        return tuple(replay.record.name for replay in next(iter(self.replays.values())))

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return tuple(next(iter(self.replays.values()))[0].fit)

    def table(self, measure: str) -> dict[str, np.ndarray]:
        """``fit``, ``nrmse`` or ``rmse`` by model, ``(n_records, n_signals)``."""
        return {
            label: np.array(
                [[getattr(replay, measure)[signal] for signal in self.signals] for replay in replays]
            )
            for label, replays in self.replays.items()
        }

    @property
    def mean_error(self) -> dict[str, float]:
        """NRMSE of each model, mean of records and outputs; infinite where a run diverged."""
        errors = {
            label: known_mean([known_mean(run.nrmse.values()) for run in replays])
            for label, replays in self.replays.items()
        }
        return {label: error if np.isfinite(error) else np.inf for label, error in errors.items()}


def replay(
    dataset: Dataset, system: System, *, engine: Engine | None = None, horizon: Horizon = WHOLE
) -> tuple[Replay, ...]:
    """Simulate every record of a dataset in open loop from its start position.

    Args:
        dataset: the records.
        system: the model.
        engine: how a sample is integrated (default: dry friction), compiled where it can be; sub-steps are raised
            where stability needs it.
        horizon: where the free runs begin anew from a measured state (default: nowhere).

    Raises:
        InputError: a channel that the model needs is missing.
    """
    batch = batch_of(dataset, system, dataset.records)
    runs = run_freely(system, compiled_for(system, engine or Engine()), batch, horizon)
    measures = [runs.errors(measure) for measure in (fit_percent, nrmse, rmse)]
    replays = []
    for row, (record, run) in enumerate(zip(dataset.records, runs.by_record(runs.simulated.y), strict=True)):
        whole = np.pad(run, ((0, record.n_samples - len(run)), (0, 0)), constant_values=np.nan)
        outputs = dict(zip(batch.outputs, whole.T, strict=True))
        fit, error, plain = (dict(zip(batch.outputs, of[row].tolist(), strict=True)) for of in measures)
        lost = ""
        if not np.isfinite(run).all():
            alone = batch.take(torch.tensor([row]))
            states = simulate(system, runs.engine, alone).x
            lost = (
                cause_of_divergence(system, runs.engine, alone, states)
                or f"record '{record.name}': the simulation has no finite output; correct the values of the model"
            )
        replays.append(Replay(record, outputs, fit, error, plain, "diverged" if lost else "ok", lost))
    return tuple(replays)


def compare(
    dataset: Dataset,
    models: Mapping[str, System],
    *,
    engine: Engine | None = None,
    horizon: Horizon | None = None,
    say: Callable[[int, int], object] = lambda done, total: None,
) -> Comparison:
    """Replay every record through every model over one horizon.

    Args:
        dataset: the records.
        models: by label.
        engine: as in :func:`replay`.
        horizon: of all models (default: the records choose it, by the model that errs least over whole records).
        say: called before each fit that chooses it with how many are done, and how many there are at most.

    Raises:
        InputError: no model, a channel that a model needs is missing, or a simulation diverged.
    """
    if not models:
        raise InputError("there is no model to compare; give at least one")
    replays, outputs = {}, with_joint_names(dataset.outputs, next(iter(models.values())))
    for label, system in models.items():
        try:
            replays[label] = replay(dataset, system, engine=engine, horizon=horizon or WHOLE)
        except InputError as error:
            raise InputError(f"{label}: {error}") from None
        if lost := next((run.message for run in replays[label] if run.message), ""):
            raise InputError(f"{label}: {lost}")
    if horizon is not None:
        return Comparison(replays, horizon, outputs)
    errors = Comparison(replays).mean_error
    best = models[min(errors, key=lambda label: errors[label])]
    horizon = Horizon(reason="they follow the records")
    if min(errors.values()) > FOLLOWED:
        compiled = compiled_for(best, engine or Engine())
        horizon = choose_horizon(best, compiled, batch_of(dataset, best, dataset.records), say=say)
    if horizon.kind == "whole":
        return Comparison(replays, horizon, outputs)
    return compare(dataset, models, engine=engine, horizon=horizon)
