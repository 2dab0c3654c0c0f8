"""One stage of the paper: records of a twin, a model that holds what earlier stages found, sets beside their truth."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hybrid_id.identification.fit import Progress
from hybrid_id.identification.least_squares import Options
from hybrid_id.identification.objective import evaluate
from hybrid_id.machines.twin.campaign import make_campaign, model_description, replay
from hybrid_id.parameters import Bounded
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.derivatives import smooth_derivatives
from hybrid_id.reproduction.plan import StagePlan, twin_settings
from hybrid_id.reproduction.result import StageResult
from hybrid_id.simulation.prepare import SIGNAL_SHARE
from hybrid_id.simulation.rollout import simulate
from hybrid_id.statistics.fit import fit_percent
from hybrid_id.study import Study, identify
from hybrid_id.study.replays import batch_of
from hybrid_id.systems.builders import carry_over
from hybrid_id.systems.chain import System
from hybrid_id.systems.model_file import ModelFile, build_model

Found = tuple[StageResult, System]


def records_of(plan: StagePlan, *, quick: bool, seed: int = 0) -> tuple[Dataset, list[dict[str, float]]]:
    """The records of a stage and the truth of each run."""
    return make_campaign(twin_settings(plan, quick=quick)[0], seed)


def start_model(
    plan: StagePlan, knowledge: Mapping[str, Any], earlier: Mapping[str, Found], seed: int = 0
) -> System:
    """The model that a stage starts from: wrong start values, priors of the data sheet, what earlier stages hold."""
    description = model_description(knowledge, seed, priors=True)
    system = build_model(ModelFile.model_validate(description), plan.twin)
    for stage, names in plan.hold.items():
        system = carry_over(system, earlier[stage][1], list(names), names)
    for stage, names in plan.expect.items():
        found = earlier[stage][0]
        for here, there in names.items():
            system = system.with_specs({here: _expected(system.parameter(here).spec, found, there)})
    return system


def _expected(spec: Bounded, found: StageResult, name: str) -> Bounded:
    """A parameter with a prior at the mean of an earlier stage's sets, as wide as their scatter and its error."""
    k = found.names.index(name)
    mean, width = found.values[:, k].mean(), found.values[:, k].std(ddof=1)
    error = found.std_error[found.selected, k]
    width = float(np.hypot(width, error if np.isfinite(error) else 0.0))
    return replace(spec, value=float(mean), estimate=True, prior_mean=float(mean), prior_std=width)


def run_stage(
    plan: StagePlan,
    earlier: Mapping[str, Found],
    *,
    quick: bool = False,
    seed: int = 0,
    progress: Progress | None = None,
) -> Found:
    """Identify a stage.

    Args:
        plan: the stage.
        earlier: the stages before it, by name.
        quick: few and short records.
        seed: of the twin's disturbances and of the start values.
        progress: called after each iteration of the fit.

    Returns:
        The result, and the model with the selected set.
    """
    config, knowledge = twin_settings(plan, quick=quick)
    dataset, truths = make_campaign(config, seed)
    system = start_model(plan, knowledge, earlier, seed)
    begin = time.monotonic()
    study = identify(dataset, system, seed=seed, progress=progress)
    seconds = time.monotonic() - begin
    identifiability = study.identifiability
    held = {info.name: info.spec.value for info in study.system.table if not info.spec.estimate}
    chosen = study.selection.index
    larger = max(
        (study.covariances[chosen], study.robust[chosen]), key=lambda c: float(np.nansum(c.std_error))
    )
    result = StageResult(
        title=plan.title,
        names=study.names,
        units=study.selected.units,
        values=study.values,
        truths=np.array([[run.get(name, np.nan) for name in study.names] for run in truths]),
        std_error=np.array([study.standard_errors(i) for i in range(len(study.sets))]),
        covariance=larger.matrix,
        held_error=_held_error(study, dataset, list(held), held_covariance(plan, list(held), earlier)),
        by_prior=tuple(
            n for n, share in zip(study.names, identifiability.prior_share, strict=True) if share > 0.5
        ),
        held=held,
        predicted_std=identifiability.relative_std,
        words=tuple(direction.text for direction in identifiability.directions),
        signals=study.cross_validation.signal_names,
        fits=study.cross_validation.fits,
        truth_fits=_truth_fits(dataset, truths, study, config),
        selected=chosen,
        failed=tuple(f"{r.records[0]}: {r.message}" for r in study.sets if not r.ok),
        seconds=seconds,
    )
    return result, study.selected_model


def held_covariance(plan: StagePlan, held: Sequence[str], earlier: Mapping[str, Found]) -> np.ndarray:
    """Covariance of held values against this run's truth, ``(h, h)``; 0 for what a data sheet holds.

    The selected set's own, and what differs from run to run as the scatter of the earlier stage's sets shows it.
    """
    matrix = np.zeros((len(held), len(held)))
    for stage, names in plan.hold.items():
        found = earlier[stage][0]
        whole = np.nan_to_num(found.covariance) + np.cov(found.values, rowvar=False)
        here = [name for name in held if names.get(name) in found.names]
        there = [found.names.index(names[name]) for name in here]
        own = [list(held).index(name) for name in here]
        matrix[np.ix_(own, own)] = whole[np.ix_(there, there)]
    return matrix


def _held_error(study: Study, dataset: Dataset, held: Sequence[str], covariance: np.ndarray) -> np.ndarray:
    """What the covariance of held parameters adds to the selected set's standard errors, ``(p,)``."""
    if not np.any(covariance):
        return np.zeros(len(study.names))
    result = study.selected
    system, names = result.system, [info.name for info in result.system.table]
    batch = batch_of(dataset, system, [dataset[result.records[0]]], SIGNAL_SHARE, "cpu")
    theta = system.theta().detach()[:, None]
    nodes = simulate(system, result.engine, batch, theta).x
    moved = [names.index(name) for name in (*study.names, *held)]
    options = Options()
    at = evaluate(system, result.engine, batch, nodes, theta, moved, loss=options.loss, chunk=1)
    matrix, own = at.hessian[0].numpy(), nodes.shape[-1] + len(study.names)
    inner = matrix[:own, :own].copy()
    rows = np.arange(nodes.shape[-1], own)
    inner[rows, rows] += result.prior_precision
    unit = 1.0 / np.sqrt(np.diag(inner))
    shift = -unit[:, None] * np.linalg.solve(inner * unit * unit[:, None], unit[:, None] * matrix[:own, own:])
    shift = shift[nodes.shape[-1] :]
    return np.sqrt(np.einsum("ij,jk,ik->i", shift, covariance, shift).clip(0.0))


def _truth_fits(
    dataset: Dataset, truths: Sequence[Mapping[str, float]], study: Study, config: Mapping[str, Any]
) -> np.ndarray:
    """Fit % of every record, ``(n, s)``, replayed with the true parameters of the selected set's run."""
    chosen = truths[study.selection.index]
    starts = [{n: v for n, v in run.items() if n.startswith("q_0")} for run in truths]
    fits = []
    signals = study.cross_validation.signal_names
    parameters = [{**chosen, **start} for start in starts]
    runs = replay(dataset.train, parameters, config=config, substeps=config["substeps"])
    for record, run in zip(dataset.train, runs, strict=True):
        row = []
        for signal in signals:
            angle = record.outputs[f"q_{signal[2:]}"]
            seen = smooth_derivatives(angle, record.sample_time)[1] if signal.startswith("v") else angle
            row.append(float(fit_percent(seen, run[signal])))
        fits.append(row)
    return np.array(fits)
