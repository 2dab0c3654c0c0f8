"""Robots of one kind, each fitted by its own records, and what they say together."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from hybrid_id import __version__
from hybrid_id.errors import InputError
from hybrid_id.identification.horizons import Horizon, Kind
from hybrid_id.identification.least_squares import Options
from hybrid_id.records.dataset import Dataset
from hybrid_id.simulation.compiled import compiled_for
from hybrid_id.simulation.step import Engine
from hybrid_id.statistics.fleet import FEWEST, Fleet, fleet
from hybrid_id.statistics.uncertainty import autocorrelation_robust
from hybrid_id.study.many import each_kept
from hybrid_id.study.replay import batch_of
from hybrid_id.study.run import fit_sets
from hybrid_id.systems.chain import System

NARROW = 1e-4
"""Least standard deviation of a prior that the fleet gives, as a share of the parameter."""


@dataclass(frozen=True)
class RobotFit:
    """What the records of one robot say, as plain data.

    Attributes:
        name: of the robot.
        records: those with an estimate.
        values: estimates of each, ``(r, p)``.
        hessians: ``JᵀJ`` of each, without the model's priors, ``(r, p, p)``.
        covariances: of the estimates, which allow for autocorrelated residuals, without what the priors' own errors
            add, which all robots share, ``(r, p, p)``.
        misfit: RMS of the weighted residuals over all records; 1 where the model misses no more than the weights say.
        horizon: kind and length [s] of the free runs.
        unfinished: records whose fit did not converge; those that diverged have no estimate.
        seconds: that it took.
    """

    name: str
    records: list[str]
    values: list[list[float]]
    hessians: list[list[list[float]]]
    covariances: list[list[list[float]]]
    misfit: float
    horizon: tuple[Kind, float] = ("whole", 0.0)
    unfinished: list[str] = field(default_factory=list)
    seconds: float = 0.0


@dataclass(frozen=True, eq=False)
class FleetStudy:
    """Robots and their fleet.

    Attributes:
        system: the model that all started from.
        robots: with estimates, in their order.
        failed: why others have none, by name.
    """

    system: System
    robots: tuple[RobotFit, ...]
    failed: Mapping[str, str]

    @cached_property
    def fleet(self) -> Fleet:
        """Mean, spread, and who stands out.

        Raises:
            InputError: fewer than three robots have estimates.
        """
        if self.failed and len(self.robots) < FEWEST:
            count, reason = len(self.failed), next(iter(self.failed.values()))
            raise InputError(f"{count} of {len(self.robots) + count} robots have no estimate ({reason})")
        specs = [self.system.table[k].spec for k in self.system.estimated]
        return fleet(
            *(
                [np.array(getattr(r, key)) for r in self.robots]
                for key in ("values", "hessians", "covariances")
            ),
            prior_precision=np.array([0.0 if s.prior_std is None else s.prior_std**-2 for s in specs]),
            misfit=np.array([robot.misfit for robot in self.robots]),
            prior_mean=np.array([0.0 if s.prior_mean is None else s.prior_mean for s in specs]),
        )

    @property
    def names(self) -> list[str]:
        """Names of the estimated parameters."""
        return [self.system.table[k].name for k in self.system.estimated]

    def fleet_model(self) -> System:
        """The model with the fleet's mean as start values, and what is expected of one more robot as priors."""
        of, specs = self.fleet, {}
        for k, name in enumerate(self.names):
            spec = self.system.parameter(name).spec
            value = float(np.clip(of.mean[k], spec.lower, spec.upper))
            if of.held[k]:  # by the model's own prior, which stays: the others' means belong to this value
                specs[name] = replace(spec, value=value)
            elif np.isfinite(of.mean_error[k]):
                std = max(float(np.hypot(of.spread[k], of.mean_error[k])), NARROW * abs(value))
                # one that is 0 in all robots starts at its standard deviation, which says how large it may be
                start = value or float(np.clip(std, spec.lower, spec.upper))
                if start:
                    specs[name] = replace(spec, value=start, prior_mean=value, prior_std=std)
        return self.system.with_specs(specs)


def fit_robot(task: tuple[System, Horizon | None], dataset: Dataset) -> RobotFit:
    """Fit each train record of a robot.

    Args:
        task: model with start values, bounds and priors, and how long the free runs are; None where the records choose.
        dataset: its records.
    """
    start, (system, horizon) = time.perf_counter(), task
    batch, engine = batch_of(dataset, system, dataset.train), compiled_for(system, Engine())
    fits, horizon = fit_sets(
        system, engine, batch, horizon, pooled=False, options=Options(), starts=1, seed=0, kept=None
    )
    used = [fit for fit in fits if fit.status != "diverged"]
    if not used:
        raise InputError("every fit diverged; check units, signs and start values")
    precision, hessians, covariances = np.diag(used[0].prior_precision), [], []
    for fit in used:
        hessians.append(sum(np.einsum("tyi,tyj->ij", jacobian, jacobian) for jacobian in fit.jacobian))
        robust = autocorrelation_robust(*fit.of_records(), prior_precision=fit.prior_precision)
        covariances.append(robust.matrix - robust.inverse_hessian @ precision @ robust.inverse_hessian)
    if not np.isfinite(covariances).all():
        raise InputError("the errors of its estimates are not finite; check units and start values")
    samples = [max(fit.n_samples, 1) for fit in used]
    return RobotFit(
        dataset.name,
        [fit.records[0] for fit in used],
        [fit.values.tolist() for fit in used],
        np.array(hessians).tolist(),
        np.array(covariances).tolist(),
        float(np.sqrt(np.average([fit.noise_scale**2 for fit in used], weights=samples))),
        (horizon.kind, horizon.seconds),
        [fit.records[0] for fit in fits if not fit.ok],
        time.perf_counter() - start,
    )


def identify_fleet(
    system: System,
    robots: Sequence[Dataset],
    folder: Path,
    *,
    horizon: Horizon | None = None,
    program: str = __version__,
    **how: Any,
) -> FleetStudy:
    """Identify each robot by its own records, keep it in a file of its name, and compare all of them.

    Args:
        system: model of all, with start values, bounds and priors.
        robots: records of each, under its name.
        folder: that keeps them; robots of an earlier run that it holds are not fitted again.
        horizon: how long the free runs are; None to let the first robot's records choose for all, so that their errors
            of fit can be compared.
        program: what computes them, of which others' results are not taken.
        how: ``jobs``, ``scheduler`` and ``done`` of :func:`hybrid_id.study.many.each_kept`.

    Raises:
        InputError: no cluster answers.
    """
    fits: dict[str, RobotFit] = {}
    failed: dict[str, str] = {}

    def fit(some: Sequence[Dataset]) -> None:
        made_from = program, system, None if horizon is None else (horizon.kind, horizon.seconds)
        new, broken = each_kept(
            fit_robot, (system, horizon), {robot.name: robot for robot in some}, kind=RobotFit,
            files=lambda name: folder / f"{name}.json", key=lambda robot: (made_from, robot.digest),
            **how,
        )  # fmt: skip
        fits.update(new)
        failed.update(broken)

    left = list(robots)
    while horizon is None and left:
        first = left.pop(0)
        fit([first])
        if first.name in fits:
            horizon = Horizon(*fits[first.name].horizon)
    fit(left)
    return FleetStudy(system, tuple(fits[robot.name] for robot in robots if robot.name in fits), failed)
