"""The main job in one call: records and a model in, parameter sets with their statistics out (paper, III)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from hybrid_id.errors import InputError
from hybrid_id.identification.fit import fit, make_bounds
from hybrid_id.identification.least_squares import Options
from hybrid_id.identification.objective import evaluate
from hybrid_id.identification.result import FitResult, sensitivities
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.record import Record
from hybrid_id.simulation.prepare import SIGNAL_SHARE, Batch, make_batch
from hybrid_id.simulation.rollout import halved, simulate
from hybrid_id.simulation.stability import with_substeps
from hybrid_id.simulation.step import Engine
from hybrid_id.statistics.bootstrap import block_contributions, one_step_bootstrap
from hybrid_id.statistics.cross_validation import CrossValidation, cross_validation
from hybrid_id.statistics.fit import fit_percent, nrmse
from hybrid_id.statistics.identifiability import Identifiability, identifiability
from hybrid_id.statistics.selection import Selection, select
from hybrid_id.statistics.trust import Trust, trust_grades
from hybrid_id.statistics.uncertainty import Covariance, covariance, robust_covariance
from hybrid_id.statistics.variation import Variation, mean_interval, variation
from hybrid_id.systems.chain import System

REFERENCES = ("P_m1", "k_t", "P_m1m1", "P_m1m2")
"""Parameters by which identifiable combinations are divided, where the model has them."""
LANES = 400_000
"""Samples that are simulated at once."""

Progress = Callable[[str, int, Tensor, Tensor], bool | None]


@dataclass(frozen=True, eq=False)
class Study:
    """Result of :func:`identify`.

    Attributes:
        system: the model that the study started from.
        sets: one fit a record, or one over all.
        pooled: whether it is one over all.
        variation: std/mean of each parameter over the experiments; None with fewer than two sets.
        covariances: plain covariance of each set.
        robust: autocorrelation-robust covariance of each set.
        identifiability: what the records of the selected set tell.
        trust: grade of each parameter.
        cross_validation: fit % of every set on every record, measured signals and speeds.
        selection: the set to use.
        test_nrmse: normalised RMSE of the selected set on each test record, by name; empty without test records.
        engine_error: largest change of an estimate in standard errors when the step is halved.
    """

    system: System
    sets: tuple[FitResult, ...]
    pooled: bool
    variation: Variation | None
    covariances: tuple[Covariance, ...]
    robust: tuple[Covariance, ...]
    identifiability: Identifiability
    trust: tuple[Trust, ...]
    cross_validation: CrossValidation
    selection: Selection
    test_nrmse: dict[str, float]
    engine_error: float

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the estimated parameters."""
        return self.sets[0].names

    @property
    def values(self) -> np.ndarray:
        """Estimates, ``(n_sets, n_parameters)``."""
        return np.array([result.values for result in self.sets])

    @property
    def selected(self) -> FitResult:
        """The selected set."""
        return self.sets[self.selection.index]

    @property
    def selected_model(self) -> System:
        """The system with the selected set's values."""
        return self.selected.system

    def standard_errors(self, index: int) -> np.ndarray:
        """Standard errors of a set: the larger of plain and robust; inf where no interval may be claimed."""
        larger = np.maximum(self.covariances[index].std_error, self.robust[index].std_error)
        return np.where(self.identifiability.claimable, larger, np.inf)

    def summary(self) -> str:
        """The study in a page: parameters with intervals and grades, variation, cross-validation, selection."""
        index = self.selection.index
        errors, grades = self.standard_errors(index), {t.name: t for t in self.trust}
        lines = [f"{'pooled' if self.pooled else 'selected'} set: {self.selected.summary().splitlines()[0]}"]
        width = max(map(len, self.names))
        rows = zip(self.names, self.selected.values, errors, self.selected.units, strict=True)
        for k, (name, value, error, unit) in enumerate(rows):
            reach = f"± {1.96 * error:.2g}" if np.isfinite(error) else "(no interval)"
            spread = "" if self.variation is None else f"  std/mean {self.variation.percent[k]:.2f} %"
            lines.append(f"  {name:<{width}}  {value:11.5g} {reach:>14} {unit:<10}{spread}  trust {grades[name].grade}")
        lines.append(self.identifiability.summary())
        lines.append(self.selection.summary())
        if self.test_nrmse:
            mean = float(np.mean(list(self.test_nrmse.values())))
            lines.append(f"normalised RMSE on {len(self.test_nrmse)} test records: {mean:.4g}")
        lines.append(f"integration error (step halved): {self.engine_error:.2g} standard errors at most")
        return "\n".join(lines)


def identify(
    dataset: Dataset,
    system: System,
    *,
    pooled: bool = False,
    engine: Engine | None = None,
    options: Options | None = None,
    starts: int = 1,
    seed: int = 0,
    device: str = "cpu",
    signal_share: float = SIGNAL_SHARE,
    progress: Progress | None = None,
) -> Study:
    """Identify one parameter set for each train record, or one over all, with the paper's statistics.

    Args:
        dataset: train records are fitted, test records only scored.
        system: model with start values, bounds and priors.
        pooled: one set over all train records.
        engine: how a sample is integrated (default: dry friction by projection).
        options: settings of the fit (loss, iterations ...).
        starts: start points; the best end counts.
        seed: of start points and bootstrap.
        device: torch device.
        signal_share: see :func:`hybrid_id.simulation.prepare.make_batch`.
        progress: see :func:`hybrid_id.identification.fit.fit`.

    Raises:
        InputError: no train record, missing channels, nothing to estimate, or every fit diverged.
    """
    if not dataset.train:
        raise InputError(f"dataset '{dataset.name}' has no train record; give at least one the role 'train'.")
    batch = _batch(dataset, system, dataset.train, signal_share, device)
    model = system.to(device)
    sets = fit(model, batch, pooled=pooled, engine=engine, options=options, starts=starts, seed=seed, progress=progress)
    return assess(dataset, system, sets, pooled=pooled, batch=batch, seed=seed, signal_share=signal_share)


def assess(
    dataset: Dataset,
    system: System,
    sets: Sequence[FitResult],
    *,
    pooled: bool,
    batch: Batch | None = None,
    seed: int = 0,
    signal_share: float = SIGNAL_SHARE,
) -> Study:
    """The statistics of parameter sets, however they were found; arguments as in :func:`identify`."""
    if all(result.status == "diverged" for result in sets):
        raise InputError(f"Every fit of dataset '{dataset.name}' diverged; check units, signs and start values.")
    batch = _batch(dataset, system, dataset.train, signal_share, "cpu") if batch is None else batch
    plain = tuple(covariance(r.jacobian, r.residual, prior_information=r.prior_precision) for r in sets)
    robust = tuple(robust_covariance(r.jacobian, r.residual, prior_information=r.prior_precision) for r in sets)
    matrix = cross_validate(sets, batch, pooled=pooled)
    selection = select(matrix)
    chosen = sets[selection.index]
    finite = np.isfinite(plain[selection.index].std_error)
    ratios = robust[selection.index].std_error[finite] / plain[selection.index].std_error[finite]
    told = told_by(chosen, inflation=max(float(np.median(ratios, axis=None)) if finite.any() else 1.0, 1.0))
    values = np.array([r.values for r in sets])
    names = sets[0].names
    errors = _standard_errors(sets, plain, robust, pooled, seed)
    held = [n for n, share in zip(names, told.prior_share, strict=True) if share > 0.5]
    trust = trust_grades(
        names,
        values.mean(0),
        errors,
        not_identifiable=told.not_claimable,
        at_bound=chosen.at_bound,
        held=held,
    )
    test = _test_nrmse(dataset, chosen, signal_share)
    spread = variation(values, names, held=held) if len(sets) > 1 else None
    return Study(
        system, tuple(sets), pooled, spread, plain, robust, told, trust, matrix, selection, test,
        engine_error(chosen, batch, plain[selection.index].std_error),
    )  # fmt: skip


def told_by(result: FitResult, *, inflation: float = 1.0) -> Identifiability:
    """What the records of a fit tell about its parameters, at its estimates and its noise."""
    scale = max(result.noise_scale, 1e-300)
    bounds = [result.system.parameter(n).spec for n in result.names]
    size = np.array([abs(v) or (s.upper if np.isfinite(s.upper) else 1.0) for v, s in zip(result.values, bounds, strict=True)])
    return identifiability(
        result.values,
        result.names,
        jacobian=[j / scale for j in result.jacobian],
        prior_information=result.prior_precision,
        scale=size,
        inflation=inflation,
        references=REFERENCES,
    )


def preflight(dataset: Dataset, system: System, *, signal_share: float = SIGNAL_SHARE) -> Identifiability:
    """What the train records can tell about the model's parameters, before any fit, at its start values.

    The sensitivities are those of a free run linearised along the measured motion.
    """
    batch = _batch(dataset, system, dataset.train or dataset.records, signal_share, "cpu")
    free = [i for i, info in enumerate(system.table) if info.spec.estimate]
    theta = system.theta().detach()[:, None].expand(-1, batch.rows)
    engine = with_substeps(system, Engine(), batch, theta)
    options = Options()
    at = evaluate(system, engine, batch, batch.x, theta, free, loss=options.loss, chunk=options.chunk)
    every = torch.arange(batch.rows)
    jacobian, _ = sensitivities(at, every, every, batch, options)
    info = [system.table[i] for i in free]
    bounds = make_bounds(system, free)
    return identifiability(
        np.array([i.spec.value for i in info]),
        [i.name for i in info],
        jacobian=jacobian,
        prior_information=bounds.prior_precision.numpy(),
        scale=(10.0 * bounds.scale).numpy(),
        references=REFERENCES,
    )


def cross_validate(sets: Sequence[FitResult], batch: Batch, *, pooled: bool) -> CrossValidation:
    """Fit % of every set on every row of a batch: measured outputs, and speeds against smoothed derivatives."""
    system, engine = sets[0].system, max((r.engine for r in sets), key=lambda e: e.substeps)
    speeds = [joint.positions[0] + 1 for joint in system.joints if f"v_m{joint.number}" not in batch.outputs]
    signals = (*batch.outputs, *(system.state_names[row] for row in speeds))
    theta = torch.stack([r.system.theta().detach() for r in sets], 1).to(batch.x.device)
    share = max(1, LANES // (batch.rows * batch.x.shape[1]))
    fits = np.empty((len(sets), batch.rows, len(signals)))
    for first in range(0, len(sets), share):
        some = torch.arange(first, min(first + share, len(sets)))
        rows = torch.arange(batch.rows).repeat(len(some)).to(batch.x.device)
        run = simulate(system, engine, batch.take(rows), theta[:, some.repeat_interleave(batch.rows)])
        simulated = torch.cat([run.y, run.x[..., speeds]], -1).cpu().numpy()
        for k, i in enumerate(some.tolist()):
            fits[i] = _fits(batch, simulated[k * batch.rows : (k + 1) * batch.rows], speeds)
    own = [-1] * len(sets) if pooled else list(range(len(sets)))
    labels = ["pooled"] if pooled else [r.records[0] for r in sets]
    return cross_validation(fits, set_names=labels, record_names=batch.names, signal_names=signals, own_record=own)


def _fits(batch: Batch, simulated: np.ndarray, speeds: Sequence[int]) -> np.ndarray:
    measured = torch.cat([batch.y, batch.x[..., list(speeds)]], -1).cpu().numpy()
    fits = np.empty((len(measured), measured.shape[-1]))
    for row, valid in enumerate((batch.weight > 0).any(2).cpu().numpy()):
        for column in range(measured.shape[-1]):
            fits[row, column] = fit_percent(measured[row, valid, column], simulated[row, valid, column])
    return fits


def _standard_errors(
    sets: Sequence[FitResult],
    plain: Sequence[Covariance],
    robust: Sequence[Covariance],
    pooled: bool,
    seed: int,
) -> dict[str, np.ndarray]:
    """Standard errors of the study's estimate (the pooled set, or the mean over the experiments), in several ways."""
    if not pooled:
        count = len(sets)
        mean = {
            way: np.sqrt(np.mean([c.std_error**2 for c in ways], 0) / count)
            for way, ways in (("plain", plain), ("robust", robust))
        }
        if count < 2:
            return mean
        return mean | {"between records": mean_interval(np.array([r.values for r in sets])).std_error}
    result = sets[0]
    scale = result.noise_scale
    jacobian, residual = [j / scale for j in result.jacobian], [r / scale for r in result.residual]
    errors = {"plain": plain[0].std_error, "robust": robust[0].std_error}
    ways = {"block bootstrap": "auto"} | ({"record bootstrap": "record"} if len(residual) > 4 else {})
    for way, block in ways.items():
        blocks = block_contributions(jacobian, residual, block=block)
        errors[way] = one_step_bootstrap(
            result.values, blocks, prior_information=result.prior_precision, seed=seed
        ).std_error
    return errors


def engine_error(result: FitResult, batch: Batch, std_error: np.ndarray) -> float:
    """Change of the estimates when the step is halved, in standard errors, at most (linearised at the estimate)."""
    rows = torch.tensor([batch.names.index(name) for name in result.records])
    part = batch.take(rows)
    runs = [simulate(result.system, engine, part).y for engine in (result.engine, halved(result.engine))]
    change = ((runs[1] - runs[0]) * part.weight).cpu().numpy()
    change = np.concatenate([c[: len(r)].reshape(-1) for c, r in zip(change, result.residual, strict=True)])
    jacobian = np.concatenate([j.reshape(-1, j.shape[-1]) for j in result.jacobian])
    if not np.all(np.isfinite(change)):
        return float("inf")
    size = np.where(np.isfinite(std_error), std_error, 0.0)
    step = np.linalg.lstsq(jacobian * size, change, rcond=1e-9)[0]
    return float(np.max(np.abs(step), initial=0.0))


def _test_nrmse(dataset: Dataset, result: FitResult, signal_share: float) -> dict[str, float]:
    if not dataset.test:
        return {}
    batch = _batch(dataset, result.system, dataset.test, signal_share, "cpu")
    y, measured = simulate(result.system, result.engine, batch).y.numpy(), batch.y.numpy()
    valid = (batch.weight > 0).any(2).numpy()
    return {
        name: float(np.mean([nrmse(measured[r, valid[r], c], y[r, valid[r], c]) for c in range(y.shape[-1])]))
        for r, name in enumerate(batch.names)
    }


def _batch(dataset: Dataset, system: System, records: Sequence[Record], signal_share: float, device: str) -> Batch:
    noise = {channel.name: channel.noise_std for channel in dataset.outputs}
    return make_batch(system, records, noise_std=noise, signal_share=signal_share).to(device)
