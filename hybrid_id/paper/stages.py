"""The paper's stages: records of a twin, a model that holds what earlier stages found, sets beside their truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import PlainValidator

from hybrid_id.errors import InputError
from hybrid_id.identification.fit import Progress
from hybrid_id.identification.objective import Loss, evaluate
from hybrid_id.paper.tracking import Array
from hybrid_id.paper.twin import make_campaign, model_description, replay
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.derivatives import smooth_derivatives
from hybrid_id.records.yaml_file import read_yaml
from hybrid_id.simulation.rollout import simulate
from hybrid_id.statistics.fit import fit_percent
from hybrid_id.study import Study, identify
from hybrid_id.study.replay import batch_of
from hybrid_id.systems.builders import carry_over
from hybrid_id.systems.chain import System
from hybrid_id.systems.model_file import ModelFile, build_model

PLAN = "reproduce.yaml"
QUICK_RECORDS, QUICK_LENGTH, QUICK_TRACKING = 2, 1.0, {"duration": 1.2, "fade": 0.5}
"""Records a stage and their length [s], and times of the closed loops [s], where a look at everything is enough."""

Errors = Annotated[np.ndarray, PlainValidator(lambda kept: np.nan_to_num(np.array(kept, float), nan=np.inf))]
"""Standard errors, for which a file of results has null where there is none."""
Plan = Mapping[str, Any]
"""A stage, or the closed loops, as `configs/reproduce.yaml` says."""


@dataclass(frozen=True, eq=False)
class StageResult:
    """One stage: n sets of p parameters, s signals.

    Attributes:
        names: estimated parameters (p).
        units: theirs.
        values: estimates ``(n, p)``.
        truth: parameters of the machine, by name.
        truths: of each set's own run ``(n, p)``; nan for what the machine does not have.
        std_error: of each set, its records alone ``(n, p)``; inf where no interval may be claimed.
        covariance: of the selected set ``(p, p)``.
        held_error: what the uncertainty of held parameters adds to the selected set's standard errors ``(p,)``.
        by_prior: names that a prior holds.
        held: parameters that an earlier stage or the data sheet holds, and their values.
        words: what the check says of the records' limits.
        signals: replayed signals (s).
        fits: fit % of every set on every record ``(n, n, s)``.
        truth_fits: fit % of the selected run's true parameters on every record ``(n, s)``.
        selected: index of the selected set.
        failed: sets that did not converge, and why.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    truth: dict[str, float]
    truths: Array
    std_error: Errors
    covariance: Array
    held_error: Array
    by_prior: tuple[str, ...]
    held: dict[str, float]
    words: tuple[str, ...]
    signals: tuple[str, ...]
    fits: Array
    truth_fits: Array
    selected: int
    failed: tuple[str, ...]


Stage = tuple[StageResult, System]
"""What came of a stage, and the model with the selected set."""


def config_folder() -> Path:
    """Where the shipped settings lie: in the installed package, or beside it in a checkout.

    Raises:
        InputError: they are in neither place.
    """
    package = Path(__file__).parents[1]
    for folder in (package / "configs", package.parent / "configs"):
        if (folder / PLAN).exists():
            return folder
    raise InputError(f"{PLAN} is missing beside the package in {package}; install hybrid_id again")


def read_plan(*, quick: bool) -> dict[str, Any]:
    """The stages and closed loops of `configs/reproduce.yaml`, shortened where a look at everything is enough."""
    plan = read_yaml(config_folder() / PLAN)
    return plan | {"tracking": plan["tracking"] | QUICK_TRACKING} if quick else plan


def twin_settings(plan: Plan, *, quick: bool) -> tuple[dict[str, Any], dict[str, Any]]:
    """Settings of a stage's machine with the stage's experiments, and the settings that its model comes from."""
    twin = read_yaml(config_folder() / plan["twin"])
    knowledge = read_yaml(config_folder() / plan["knowledge"]) if "knowledge" in plan else twin
    twin["excitation"] = knowledge["excitation"]
    if quick:
        twin["duration"], period = QUICK_LENGTH, QUICK_LENGTH - twin["rest"]
        experiments = twin["excitation"]["experiments"][:QUICK_RECORDS]
        twin["excitation"] = twin["excitation"] | {"experiments": experiments}
        for experiment in experiments:  # no more tones than a short period holds
            for sines in [experiment] if "band" in experiment else [experiment.get(u) for u in ("u1", "u2")]:
                if sines:
                    low, high = sines["band"]
                    sines["tones"] = max(1, min(sines["tones"], int(high * period) - int(low * period)))
                    sines["band"] = [low, max(high, 2.0 / period)]
    return twin, knowledge


def run_stage(
    plan: Plan,
    earlier: Mapping[str, Stage],
    *,
    quick: bool = False,
    seed: int = 0,
    progress: Progress | None = None,
) -> Stage:
    """Identify a stage.

    Args:
        plan: the stage.
        earlier: the stages before it, by name.
        quick: few and short records.
        seed: of the twin's disturbances and of the start values.
        progress: called after each iteration of the fit.
    """
    config, knowledge = twin_settings(plan, quick=quick)
    dataset, truths = make_campaign(config, seed)
    # wrong start values and priors of the data sheet, then what earlier stages hold, or lead to expect
    description = model_description(knowledge, seed, priors=True)
    system = build_model(ModelFile.model_validate(description), plan["twin"])
    for stage, names in plan.get("hold", {}).items():
        system = carry_over(system, earlier[stage][1], list(names), names)
    for stage, names in plan.get("expect", {}).items():
        found = earlier[stage][0]
        for here, there in names.items():  # as wide as the sets scatter and as the parameter was identified
            k = found.names.index(there)
            mean, error = float(found.values[:, k].mean()), found.std_error[found.selected, k]
            width = float(np.hypot(found.values[:, k].std(ddof=1), error if np.isfinite(error) else 0.0))
            spec = system.parameter(here).spec
            spec = replace(spec, value=mean, estimate=True, prior_mean=mean, prior_std=width)
            system = system.with_specs({here: spec})
    study = identify(dataset, system, seed=seed, progress=progress)
    chosen, names, told = study.selection.index, study.names, study.identifiability
    either = (study.covariances[chosen], study.robust[chosen])
    result = StageResult(
        names=names,
        units=study.selected.units,
        values=study.values,
        truth=config["truth"],
        truths=np.array([[run.get(name, np.nan) for name in names] for run in truths]),
        std_error=np.array([study.standard_errors(i) for i in range(len(study.sets))]),
        covariance=max(either, key=lambda c: float(np.nansum(c.std_error))).matrix,
        held_error=_held_error(plan, earlier, study, dataset),
        by_prior=tuple(n for n, share in zip(names, told.prior_share, strict=True) if share > 0.5),
        held={info.name: info.spec.value for info in study.system.table if not info.spec.estimate},
        words=tuple(direction.text for direction in told.directions),
        signals=study.cross_validation.signal_names,
        fits=study.cross_validation.fits,
        truth_fits=truth_fits(config, dataset, truths, chosen, study.cross_validation.signal_names),
        selected=chosen,
        failed=tuple(f"{r.records[0]}: {r.message}" for r in study.sets if not r.ok),
    )
    return result, study.selected_model


def _held_error(plan: Plan, earlier: Mapping[str, Stage], study: Study, dataset: Dataset) -> np.ndarray:
    """What the uncertainty of held parameters adds to the selected set's standard errors, ``(p,)``.

    That uncertainty is the earlier stage's own, and what differs from run to run as the scatter of its sets shows it;
    none for what a data sheet holds. A shift of held values moves the estimates as the Gauss-Newton step says.
    """
    result = study.selected
    table = [info.name for info in result.system.table]
    held = [info.name for info in study.system.table if not info.spec.estimate]
    covariance = np.zeros((len(held), len(held)))
    for stage, names in plan.get("hold", {}).items():
        found = earlier[stage][0]
        whole = np.nan_to_num(found.covariance) + np.cov(found.values, rowvar=False)
        own = [k for k, name in enumerate(held) if names.get(name) in found.names]
        there = [found.names.index(names[held[k]]) for k in own]
        covariance[np.ix_(own, own)] = whole[np.ix_(there, there)]
    if not np.any(covariance):
        return np.zeros(len(study.names))
    batch = batch_of(dataset, result.system, [dataset[result.records[0]]])
    theta = result.system.theta().detach()[:, None]
    nodes = simulate(result.system, result.engine, batch, theta).x
    moved = [table.index(name) for name in (*study.names, *held)]
    at = evaluate(result.system, result.engine, batch, nodes, theta, moved, loss=Loss(), chunk=1)
    hessian, states = at.hessian[0].numpy(), nodes.shape[-1]
    free = states + len(study.names)
    inner = hessian[:free, :free] + np.diag(np.r_[np.zeros(states), result.prior_precision])
    unit = 1.0 / np.sqrt(np.diag(inner))
    shift = np.linalg.solve(inner * unit * unit[:, None], unit[:, None] * hessian[:free, free:])
    shift = -(unit[:, None] * shift)[states:]
    return np.sqrt(np.einsum("ij,jk,ik->i", shift, covariance, shift).clip(0.0))


def truth_fits(
    config: Plan,
    dataset: Dataset,
    truths: list[dict[str, float]],
    chosen: int,
    signals: tuple[str, ...],
) -> np.ndarray:
    """Fit % of every record, ``(n, s)``, replayed with the true parameters of one run from the record's own start."""
    parameters = [truths[chosen] | {n: v for n, v in run.items() if n.startswith("q_0")} for run in truths]
    fits = np.empty((len(truths), len(signals)))
    for i, run in enumerate(replay(config, dataset.train, parameters)):
        for k, signal in enumerate(signals):
            measured = dataset.train[i].outputs[f"q_{signal[2:]}"]
            if signal.startswith("v"):
                measured = smooth_derivatives(measured, dataset.train[i].sample_time)[1]
            fits[i, k] = fit_percent(measured, run[signal])
    return fits
