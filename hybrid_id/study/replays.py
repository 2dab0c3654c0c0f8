"""Free runs of models over records: replays, models side by side, and the simulations by which a study is judged."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from hybrid_id.errors import InputError
from hybrid_id.identification.horizons import FOLLOWED, WHOLE, Horizon, choose_horizon, free_runs
from hybrid_id.identification.result import FitResult
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.record import Record
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.compiled import compiled_for
from hybrid_id.simulation.prepare import SIGNAL_SHARE, make_batch, typical_deviations
from hybrid_id.simulation.rollout import cause_of_divergence, simulate
from hybrid_id.simulation.solvers import stable_engine
from hybrid_id.simulation.step import Engine
from hybrid_id.statistics.cross_validation import CrossValidation, cross_validation
from hybrid_id.statistics.fit import fit_percent, known_mean, nrmse, rmse
from hybrid_id.systems.by_joint import with_joint_names
from hybrid_id.systems.chain import System

LANES = 400_000
"""Samples that are simulated at once."""
WORSE = 1.02
"""Error of identified values over that of the nominal ones from which it is no accident of the noise."""


def batch_of(
    dataset: Dataset,
    system: System,
    records: Sequence[Record],
    signal_share: float = SIGNAL_SHARE,
    device: str = "cpu",
) -> Batch:
    """Records of a dataset prepared with the noise that it declares, and weighed as is typical of it."""
    noise = {channel.name: channel.noise_std for channel in dataset.outputs}
    known = dataset.train or dataset.records
    typical = typical_deviations(known, noise_std=noise, signal_share=signal_share)
    return make_batch(system, records, noise_std=noise, signal_share=signal_share, typical=typical).to(device)


def cross_validate(
    sets: Sequence[FitResult], batch: Batch, horizon: Horizon = WHOLE, *, pooled: bool
) -> CrossValidation:
    """Fit % of every set on every record: measured outputs, and speeds against smoothed derivatives.

    Args:
        sets: parameter sets.
        batch: whole records, or pieces of them, over which the free runs begin anew.
        horizon: how whole records are cut into pieces, which begin in hidden states of each set's own.
        pooled: whether one set was fitted to all of them.
    """
    system = sets[0].system
    each = horizon.simulates(system, batch)
    cut = [horizon.cut(r.system, r.engine, batch) for r in (sets if each else sets[:1])]
    pieces, batch = cut if each else cut * len(sets), cut[0]
    speeds = [joint.positions[0] + 1 for joint in system.joints if f"v_m{joint.number}" not in batch.outputs]
    signals = (*batch.outputs, *(system.state_names[row] for row in speeds))
    theta = torch.stack([r.system.theta().detach() for r in sets], 1).to(batch.x.device)
    share = 1 if each else max(1, LANES // (batch.rows * batch.x.shape[1]))
    records = tuple(dict.fromkeys(batch.names))
    run_freely = simulate if len(records) == batch.rows else free_runs
    fits = np.empty((len(sets), len(records), len(signals)))
    engines = [stable_engine(r.system, r.engine, batch) for r in sets]
    for engine in dict.fromkeys(engines):  # sets of the same sub-steps at once
        alike = [k for k, one in enumerate(engines) if one == engine]
        for first in range(0, len(alike), share):
            some = torch.tensor(alike[first : first + share])
            rows = torch.arange(batch.rows).repeat(len(some)).to(batch.x.device)
            part = pieces[int(some[0])].take(rows)
            run = run_freely(system, engine, part, theta[:, some.repeat_interleave(batch.rows)])
            simulated = torch.cat([run.y, run.x[..., speeds]], -1).cpu().numpy()
            for k, i in enumerate(some.tolist()):
                fits[i] = _fits(pieces[i], simulated[k * batch.rows : (k + 1) * batch.rows], speeds)
    own = [-1] * len(sets) if pooled else list(range(len(sets)))
    labels = ["pooled"] if pooled else [r.records[0] for r in sets]
    return cross_validation(
        fits, set_names=labels, record_names=records, signal_names=signals, own_record=own
    )


def _fits(batch: Batch, simulated: np.ndarray, speeds: Sequence[int]) -> np.ndarray:
    measured = torch.cat([batch.y, batch.x[..., list(speeds)]], -1).cpu().numpy()
    records, names = list(dict.fromkeys(batch.names)), np.array(batch.names)
    fits = np.empty((len(records), measured.shape[-1]))
    valid = (batch.weight > 0).any(2).cpu().numpy()
    for row, record in enumerate(records):
        mine = valid & (names == record)[:, None]
        for column in range(measured.shape[-1]):
            fits[row, column] = fit_percent(measured[mine, column], simulated[mine, column])
    return fits


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
    signal_share: float,
    horizon: Horizon = WHOLE,
) -> tuple[dict[str, float], dict[str, OutputError]]:
    """Errors of a model on records of a dataset: normalised RMSE by record, outputs averaged, and the error by output.

    Both are empty without records.
    """
    if not records:
        return {}, {}
    batch = batch_of(dataset, system, records, signal_share)
    engine = stable_engine(system, engine, batch)  # these records may have longer samples
    runs = simulated_over(horizon, system, engine, batch)
    pairs = [(y[: len(run)].T, run.T) for y, run in zip(batch.y.numpy(), runs, strict=True)]  # (n_y, T)
    normalised, plain = (np.array([of(*pair) for pair in pairs]) for of in (nrmse, rmse))  # (records, n_y)
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
    signal_share: float,
    horizon: Horizon = WHOLE,
    tested: Mapping[str, float] | None = None,
) -> BesideNominal:
    """Errors of a set beside those of the nominal values that its fit started from.

    Args:
        dataset: the records.
        system: the model with its nominal values.
        result: the set.
        signal_share: see :func:`hybrid_id.simulation.prepare.make_batch`.
        horizon: how long the free runs are.
        tested: errors of the set on the test records, where they are known.
    """
    by_role = {"test": dataset.test, "validation": dataset.validation, "train": dataset.train}
    role, records = next((role, records) for role, records in by_role.items() if records)

    def errors(one: System) -> Mapping[str, float]:
        return errors_on(records, dataset, one, result.engine, signal_share, horizon)[0]

    nominal, identified = (
        known_mean(each.values()) for each in (errors(system), tested or errors(result.system))
    )
    return BesideNominal(role, len(records), nominal, identified)


def simulated_over(horizon: Horizon, system: System, engine: Engine, batch: Batch) -> list[np.ndarray]:
    """Outputs of a model's free runs over a horizon, those of a record one after the other, ``(T, n_y)`` each.

    The end of a record that is shorter than a window is left out.
    """
    part = horizon.cut(system, engine, batch)
    run = simulate(system, engine, part) if part is batch else free_runs(system, engine, part)
    valid, names = (part.weight > 0).any(2).numpy(), np.array(part.names)
    return [run.y.numpy()[valid & (names == name)[:, None]] for name in batch.names]


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
        return {label: _mean_error(replays) for label, replays in self.replays.items()}


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
    engine = stable_engine(system, compiled_for(system, engine or Engine()), batch)
    runs = simulated_over(horizon, system, engine, batch)
    found = []
    for record, run in zip(dataset.records, runs, strict=True):
        whole = np.pad(run, ((0, record.n_samples - len(run)), (0, 0)), constant_values=np.nan)
        fits, errors, plain = (
            {n: float(of(record.signal(n)[: len(run)], run[:, k])) for k, n in enumerate(batch.outputs)}
            for of in (fit_percent, nrmse, rmse)
        )
        outputs = dict(zip(batch.outputs, whole.T, strict=True))
        lost = "" if np.isfinite(run).all() else _why_lost(system, engine, batch, record.name)
        found.append(Replay(record, outputs, fits, errors, plain, "diverged" if lost else "ok", lost))
    return tuple(found)


def _why_lost(system: System, engine: Engine, batch: Batch, record: str) -> str:
    part = batch.take(torch.tensor([batch.names.index(record)]))
    cause = cause_of_divergence(system, engine, part, simulate(system, engine, part).x)
    return cause or f"record '{record}': the simulation has no finite output; correct the values of the model"


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


def _mean_error(runs: tuple[Replay, ...]) -> float:
    """Mean normalised RMSE over records and outputs; infinite where a run diverged."""
    error = known_mean([known_mean(run.nrmse.values()) for run in runs])
    return error if np.isfinite(error) else np.inf


def weighted_errors(
    system: System, engine: Engine, batch: Batch, horizon: Horizon = WHOLE
) -> dict[str, float]:
    """RMS of the weighted error of the free runs over a horizon by record; infinite where one diverged."""
    engine = stable_engine(system, engine, batch)
    part = horizon.cut(system, engine, batch)
    run, batch = (simulate if part is batch else free_runs)(system, engine, part), part
    square = ((run.y - batch.y) * batch.weight).square().sum((1, 2))
    count = (batch.weight > 0).sum((1, 2))
    found: dict[str, float] = {}
    for name in dict.fromkeys(batch.names):
        rows = torch.tensor([k for k, other in enumerate(batch.names) if other == name])
        mean = float(square[rows].sum() / count[rows].sum())
        found[name] = mean**0.5 if mean == mean else torch.inf
    return found
