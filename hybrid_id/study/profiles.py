"""Profile likelihoods of a study's selected set: intervals that need not be symmetric, and show where they are open."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import count

import numpy as np

from hybrid_id.errors import InputError
from hybrid_id.identification.fit import fit
from hybrid_id.identification.least_squares import Options
from hybrid_id.identification.result import FitResult
from hybrid_id.parameters import Bounded
from hybrid_id.records.dataset import Dataset
from hybrid_id.simulation.prepare import SIGNAL_SHARE
from hybrid_id.statistics.profile import Profile, profile_likelihood
from hybrid_id.study.replays import batch_of
from hybrid_id.study.result import Study
from hybrid_id.systems.chain import System

FIRST_STEP = 0.1
"""First step as a share of the estimate, where no standard error is known."""


def profiles(
    dataset: Dataset,
    study: Study,
    names: Sequence[str],
    *,
    level: float = 0.95,
    options: Options | None = None,
    signal_share: float = SIGNAL_SHARE,
    progress: Callable[[str], object] | None = None,
) -> dict[str, Profile]:
    """Profile likelihood of some parameters of the selected set, by name: every point is a fit of all the others.

    The cost rises to where the larger of the plain and the robust standard error would end if the model were linear, so
    that noise, autocorrelation and priors count as they do there. Ctrl-C ends it with the profiles that are complete.

    Args:
        dataset: of the study.
        study: whose selected set is profiled.
        names: of parameters that it estimates.
        level: confidence of the intervals.
        options: settings of the fits; those of the study's own.
        signal_share: as in the study.
        progress: called with words before each fit.

    Raises:
        InputError: a name that the study does not estimate, or no other parameter is estimated.
    """
    check_names(names, study.names)
    chosen, index = study.selected, study.selection.index
    records = [record for record in dataset.train if record.name in chosen.records]
    batch = batch_of(dataset, chosen.system, records, signal_share, "cpu")
    batch = study.horizon.cut(chosen.system, chosen.engine, batch)
    plain, robust = study.covariances[index], study.robust[index]

    def profile(name: str) -> Profile:
        k = chosen.names.index(name)
        errors = plain.std_error[k], robust.std_error[k]
        known = bool(np.isfinite(errors).all()) and min(errors) > 0.0
        variance = max(errors) ** 2 / plain.inverse_hessian[k, k] if known else plain.noise_variance
        spec, number = chosen.system.parameter(name).spec, count(1)

        def fitted(start: System) -> FitResult:
            if progress is not None:
                progress(f"profile of {name}, fit {next(number)}")
            return fit(start, batch, pooled=True, engine=chosen.engine, options=options, warm=False)[0]

        def cost_at(value: float, start: np.ndarray) -> tuple[float, np.ndarray]:
            moved = chosen.system.with_values(dict(zip(chosen.names, start, strict=True)))
            one = fitted(moved.with_specs({name: replace(spec, value=value, estimate=False)}))
            found = dict(zip(one.names, one.values, strict=True)) | {name: value}
            return 2.0 * one.cost + _prior(spec, value), np.array([found[n] for n in chosen.names])

        best = fitted(chosen.system)
        return profile_likelihood(
            cost_at,
            best.values,
            k,
            minimum=2.0 * best.cost,
            step=max(errors) if known else FIRST_STEP * abs(best.values[k]) or FIRST_STEP,
            noise_variance=variance,
            level=level,
            bounds=(spec.lower, spec.upper),
        )

    found: dict[str, Profile] = {}
    try:
        for name in names:
            found[name] = profile(name)
    except KeyboardInterrupt:
        return found
    return found


def _prior(spec: Bounded, value: float) -> float:
    """What the prior of a parameter that is held adds to twice the cost."""
    if spec.prior_std is None or spec.prior_mean is None:
        return 0.0
    return ((value - spec.prior_mean) / spec.prior_std) ** 2


def check_names(names: Sequence[str], estimated: Sequence[str]) -> None:
    """Refuse names that a study does not estimate, and a profile without other parameters to fit."""
    for name in names:
        if name not in estimated:
            raise InputError(
                f"key 'statistics.profile': '{name}' is not estimated; give some of {', '.join(estimated)}"
            )
    if names and len(estimated) < 2:
        raise InputError(
            f"key 'statistics.profile': nothing but {estimated[0]} is estimated, so that its interval is its profile; "
            "leave it out"
        )
