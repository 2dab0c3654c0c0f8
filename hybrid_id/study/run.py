"""The main job in one call: records and a model in, parameter sets with their statistics out (paper, III)."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import numpy as np
import torch
from joblib import Parallel, delayed

from hybrid_id.errors import InputError
from hybrid_id.identification.fit import Progress, fit, fit_records, kept_fit
from hybrid_id.identification.horizons import WHOLE, Horizon, choose_horizon, settled
from hybrid_id.identification.keep import Kept
from hybrid_id.identification.least_squares import Options
from hybrid_id.identification.restarts import confirmed
from hybrid_id.identification.result import FitResult
from hybrid_id.records.dataset import Dataset
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.compiled import compiled_for
from hybrid_id.simulation.rollout import cause_of_divergence, simulate
from hybrid_id.simulation.solvers import stable_engine
from hybrid_id.simulation.step import Engine
from hybrid_id.statistics.cross_validation import select
from hybrid_id.statistics.reliability import Reliability, reliability_grades
from hybrid_id.statistics.uncertainty import (
    Covariance,
    autocorrelation_robust,
    block_bootstrap,
    covariance,
)
from hybrid_id.statistics.variation import error_of_mean, prior_variances, variation
from hybrid_id.study.checks import identifiability_of
from hybrid_id.study.many import leave_ctrl_c_to_the_first, whole_pool
from hybrid_id.study.replay import batch_of, beside_nominal, cross_validate, engine_error, errors_on
from hybrid_id.study.result import Study
from hybrid_id.systems.by_joint import with_joint_names
from hybrid_id.systems.chain import System


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
    horizon: Horizon | None = None,
    level: float = 0.95,
    jobs: int = 1,
    kept: Kept | None = None,
    noisier: Sequence[Dataset] = (),
    progress: Progress | None = None,
) -> Study:
    """Identify one parameter set for each train record, or one over all, with the paper's statistics.

    Args:
        dataset: train records are fitted, test records only scored.
        system: model with start values, bounds and priors.
        pooled: one set over all train records.
        engine: how a sample is integrated (default: dry friction, with stick and slip as events), compiled where it
            can be.
        options: settings of the fit (loss, iterations ...).
        starts: start points; the best end counts.
        seed: of start points and bootstrap.
        device: torch device.
        horizon: how long the free runs are that are fitted and compared with the records (default: whole records where
            they follow them, otherwise see :func:`hybrid_id.identification.horizons.choose_horizon`).
        level: confidence of the intervals.
        jobs: processes that share the records; one where they share a parameter set.
        kept: fits that an earlier run has kept, and where those of this one are kept.
        noisier: the same records with as much noise again on inputs that were measured, a few times: how far they move
            the estimates is what the noise that is there may have done, and is added to all errors.
        progress: see :func:`hybrid_id.identification.fit.fit`; with several processes its method ``watch``, where it
            has one, gets the file that ends them all.

    Raises:
        InputError: no train record, missing channels, nothing to estimate, or every fit diverged.
    """
    if not dataset.train:
        raise InputError(f"dataset '{dataset.name}' has no train record; give at least one the role 'train'.")
    engine, batch = compiled_for(system, engine or Engine()), None
    if jobs > 1 and not pooled:
        records, watch = dataset.train, getattr(progress, "watch", lambda _: None)
        options = options or Options()
        settings = {"engine": engine, "options": options, "starts": starts, "seed": seed, "kept": kept}
        shares = [range(k, len(records), jobs) for k in range(min(jobs, len(records)))]
        with TemporaryDirectory() as folder:
            stop = Path(folder) / "stop"

            def fitted(over: Horizon) -> list[FitResult]:
                shared = dataset, system, settings, stop, over, device
                with whole_pool():
                    results: Any = Parallel(jobs)(delayed(fit_share)(share, *shared) for share in shares)
                by_record = {fit.records[0]: fit for fits in results for fit in fits}
                return [by_record[record.name] for record in records]

            watch(stop)
            try:
                sets = fitted(horizon or WHOLE)
                if horizon is None:
                    whole = batch_of(dataset, system, records)
                    horizon = choose_horizon(system, engine, whole, sets, options=options)
                    if horizon.kind != "whole":  # stopped before, the sets are those of whole records
                        sets, horizon = (sets, WHOLE) if stop.exists() else (fitted(horizon), horizon)
            finally:
                watch(None)
    else:
        batch = batch_of(dataset, system, dataset.train, device)
        model = copy.deepcopy(system).to(device)  # the caller's stays where it is
        sets, horizon = fit_sets(
            model, engine, batch, horizon, pooled=pooled, options=options, starts=starts, seed=seed, kept=kept,
            progress=progress,
        )  # fmt: skip
    shifts = None
    if noisier and not any(result.left_early or result.status == "diverged" for result in sets):
        # To the first order in the noise's variance, twice the noise moves an estimate as far again as once the noise
        # has moved it from the truth: J. R. Cook and L. A. Stefanski, Simulation-extrapolation estimation in parametric
        # measurement error models, JASA 89, 1994. Differs from it in that the estimate stays and its error is widened.
        for result in sets:
            result.system.to("cpu")
        start = torch.stack([result.system.theta().detach() for result in sets], 1)
        ends = []
        for data in noisier:
            noisy = batch_of(data, system, data.train)
            part = horizon.cut(sets[0].system, sets[0].engine, noisy)
            how = {"engine": sets[0].engine, "options": options, "warm": False, "start_values": start}
            fits = fit(system, part, pooled=pooled, **how)
            ends.append([np.where(one.status == "diverged", np.inf, one.values) for one in fits])
        shifts = np.array(ends) - _estimates(sets)
    return analyse_fits(
        dataset, system, sets, pooled=pooled, batch=batch, shifts=shifts, seed=seed,
        horizon=horizon, level=level,
    )  # fmt: skip


def fit_sets(
    model: System,
    engine: Engine,
    batch: Batch,
    horizon: Horizon | None,
    *,
    pooled: bool,
    starts: int,
    kept: Kept | None,
    numbers: Sequence[int] | None = None,
    **settings: Any,
) -> tuple[list[FitResult], Horizon]:
    """All sets of a batch, and the horizon over which they are fitted: the one given, or what the records ask for.

    Args:
        model: with start values.
        engine: how a sample is integrated.
        batch: of the records.
        horizon: None to let the records choose.
        pooled: one set over all records.
        starts: start points; the best end counts.
        kept: fits that are kept from before.
        numbers: of the records among all, which draw their start points; default: these are all.
        settings: further arguments of :func:`hybrid_id.identification.fit.fit`.
    """

    def fitted(horizon: Horizon) -> list[FitResult]:
        part = horizon.cut(model, engine, batch)
        if pooled:
            (found,) = kept_fit(kept, model, part, pooled=True, starts=starts, engine=engine, **settings)
            sets = [confirmed(found, part, kept=kept, **settings)]
        else:
            sets = fit_records(
                model, part, numbers=numbers, starts=starts, kept=kept, engine=engine, **settings
            )
        return settled(sets, horizon, batch, engine=engine, kept=kept, **settings)

    sets = fitted(horizon or WHOLE)
    if horizon is None:
        horizon = choose_horizon(model, engine, batch, sets, options=settings["options"])
        sets = sets if horizon.kind == "whole" else fitted(horizon)
    return sets, horizon


def fit_share(
    share: Sequence[int],
    dataset: Dataset,
    system: System,
    settings: Mapping[str, Any],
    stop: Path,
    horizon: Horizon,
    device: str,
) -> list[FitResult]:
    """The share of one process, train records by number; it ends early when the file `stop` is there."""
    leave_ctrl_c_to_the_first()
    torch.set_num_threads(1)
    # all records first: the weight of an output that stands still in one is known from the others
    batch = batch_of(dataset, system, dataset.train).take(torch.tensor(share)).to(device)
    sets, _ = fit_sets(
        system.to(device), batch=batch, horizon=horizon, pooled=False, numbers=share,
        progress=lambda *_: stop.exists(), **settings,
    )  # fmt: skip
    return sets


def analyse_fits(
    dataset: Dataset,
    system: System,
    sets: Sequence[FitResult],
    *,
    pooled: bool,
    batch: Batch | None = None,
    shifts: np.ndarray | None = None,
    seed: int = 0,
    horizon: Horizon = WHOLE,
    level: float = 0.95,
) -> Study:
    """The statistics of parameter sets, however they were found; other arguments as of :func:`identify`.

    ``batch`` is of the train records (default: made anew), ``shifts`` how far noisier inputs move each set,
    ``(n, n_sets, p)``, and ``horizon`` the one over which the sets were fitted.
    """
    batch = batch_of(dataset, system, dataset.train) if batch is None else batch.to("cpu")
    if all(result.status == "diverged" for result in sets):
        engine = stable_engine(system, sets[0].engine, batch)
        cause = cause_of_divergence(system, engine, batch, simulate(system, engine, batch).x)
        why = f" ({cause})" if cause else ""
        raise InputError(
            f"Every fit of dataset '{dataset.name}' diverged; check units, signs and start values{why}."
        )
    for result in sets:  # statistics are numpy's
        result.system.to("cpu")

    def covariance_by(way: Callable[..., Covariance], result: FitResult) -> Covariance:
        if result.status == "diverged":
            nothing = np.full((len(result.values),) * 2, np.nan)
            return Covariance(nothing, nothing[0], math.nan, nothing)
        return way(*result.of_records(), prior_precision=result.prior_precision)

    plain, robust = (
        tuple(covariance_by(way, r) for r in sets) for way in (covariance, autocorrelation_robust)
    )
    matrix = cross_validate(sets, batch, horizon, pooled=pooled)
    selection = select(matrix)
    chosen = sets[selection.index]
    finite = np.isfinite(plain[selection.index].std_error)
    ratios = robust[selection.index].std_error[finite] / plain[selection.index].std_error[finite]
    identifiability = identifiability_of(
        chosen, inflation=max(float(np.median(ratios, axis=None)) if finite.any() else 1.0, 1.0)
    )
    values = _estimates(sets)
    names = sets[0].names
    errors = _errors_of_the_mean(sets, plain, robust, pooled, seed)
    input_error = None
    if shifts is not None:
        input_error = np.sqrt(np.mean(shifts**2, 0))
        of_mean = np.sqrt(np.mean(np.nanmean(shifts, 1) ** 2, 0))
        errors = {way: np.hypot(error, of_mean) for way, error in errors.items()}
    held = [n for n, share in zip(names, identifiability.prior_share, strict=True) if share > 0.5]
    variations = variation(values, names, held=held) if len(sets) > 1 else None
    scattered = {}
    if variations is not None:  # none that priors hold
        rows = zip(names, variations.percent, variations.acceptable, strict=True)
        scattered = {name: percent for name, percent, fine in rows if not fine and name not in held}
    reliability = reliability_grades(
        names,
        np.nanmean(values, 0),
        errors,
        not_identifiable=identifiability.not_claimable,
        at_bound=chosen.at_bound,
        held=held,
        scattered=scattered,
    )
    if any(result.left_early for result in sets):
        why = "a fit was stopped before its end, so that its values are no estimate; let it finish"
        reliability = tuple(Reliability(name, "D", math.inf, why) for name in names)
    elif any(result.status == "max_iterations" for result in sets):
        why = "the iterations were used up before the fit had converged"
        reliability = tuple(replace(r, grade="C", reason=why) if r.grade in "AB" else r for r in reliability)
    pieces = horizon.cut(chosen.system, chosen.engine, batch)
    by_record, by_output = errors_on(dataset.test, dataset, chosen.system, chosen.engine, horizon)
    beside = beside_nominal(dataset, system, chosen, horizon, by_record)
    return Study(
        system, tuple(sets), pooled, variations, plain, robust, identifiability, reliability, matrix, selection,
        by_record, engine_error(chosen, pieces), beside,
        horizon=horizon, level=level, test_errors=by_output, outputs=with_joint_names(dataset.outputs, system),
        input_error=input_error,
    )  # fmt: skip


def _estimates(sets: Sequence[FitResult]) -> np.ndarray:
    """Values of all sets (n, p); NaN where a fit diverged, whose values are no estimate."""
    return np.array([np.full(len(r.values), np.nan) if r.status == "diverged" else r.values for r in sets])


def _errors_of_the_mean(
    sets: Sequence[FitResult],
    plain: Sequence[Covariance],
    robust: Sequence[Covariance],
    pooled: bool,
    seed: int,
) -> dict[str, np.ndarray]:
    """Standard errors of the mean of the sets (of the set itself where it is pooled), in several ways.

    The grades compare them; the interval of a single set takes :meth:`Study.standard_errors`.
    """
    if not pooled:
        ended = [k for k, result in enumerate(sets) if result.status != "diverged"]
        count = len(ended)
        # all sets have the same prior: what that is off by moves them alike, and no mean over them lessens it
        prior, shared = prior_variances([plain[k].inverse_hessian for k in ended], sets[0].prior_precision)

        def of_mean(ways: Sequence[Covariance]) -> np.ndarray:
            own = np.maximum([ways[k].std_error ** 2 for k in ended] - prior, 0.0)
            return np.sqrt(np.mean(own, 0) / count + shared)

        mean = {"plain": of_mean(plain), "robust": of_mean(robust)}
        if count < 2:
            return mean
        scatter = error_of_mean(_estimates(sets))
        return mean | {"between records": np.sqrt(scatter**2 + shared)}
    result = sets[0]
    errors = {"plain": plain[0].std_error, "robust": robust[0].std_error}
    ways: dict[str, Literal["auto", "record"]] = {"block bootstrap": "auto"}
    ways |= {"record bootstrap": "record"} if len(result.residual) > 4 else {}
    for way, block in ways.items():
        errors[way] = block_bootstrap(
            *result.of_records(), block=block, prior_precision=result.prior_precision, seed=seed
        )
    return errors
