"""Robots of one kind, each fitted by its own records and kept, and what they say together."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from pydantic import TypeAdapter

from hybrid_id import __version__
from hybrid_id.errors import InputError
from hybrid_id.identification.horizons import Horizon, Kind
from hybrid_id.identification.least_squares import Options
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.files import write_json
from hybrid_id.simulation.compiled import compiled_for
from hybrid_id.simulation.step import Engine
from hybrid_id.statistics.fleet import FEWEST, Fleet, fleet
from hybrid_id.statistics.uncertainty import autocorrelation_robust
from hybrid_id.study.fan_out import Failure, fan_out, sealed, unsealed
from hybrid_id.study.replays import batch_of
from hybrid_id.study.run import fit_sets
from hybrid_id.systems.chain import System
from hybrid_id.systems.model_file import describe_model

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
        message: why there is no estimate; empty where there is one.
    """

    name: str
    records: tuple[str, ...] = ()
    values: tuple[tuple[float, ...], ...] = ()
    hessians: tuple[tuple[tuple[float, ...], ...], ...] = ()
    covariances: tuple[tuple[tuple[float, ...], ...], ...] = ()
    misfit: float = 0.0
    horizon: tuple[Kind, float] = ("whole", 0.0)
    unfinished: tuple[str, ...] = ()
    seconds: float = 0.0
    message: str = ""


@dataclass(frozen=True, eq=False)
class FleetTask:
    """What the fits of all robots share.

    Attributes:
        system: model with start values, bounds and priors.
        horizon: how long the free runs are; None where the first robot's records choose for all.
    """

    system: System
    horizon: Horizon | None = None


@dataclass(frozen=True, eq=False)
class FleetStudy:
    """Robots and their fleet.

    Attributes:
        system: the model that all started from.
        robots: with estimates, in their order.
        failed: without.
        fleet: mean, spread, and who stands out.
    """

    system: System
    robots: tuple[RobotFit, ...]
    failed: tuple[RobotFit, ...]
    fleet: Fleet

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


def fit_robot(task: FleetTask, dataset: Dataset) -> RobotFit:
    """Fit each train record of a robot; arguments in the order of :func:`.fan_out.fan_out`."""
    start = time.perf_counter()
    engine = compiled_for(task.system, Engine())
    batch = batch_of(dataset, task.system, dataset.train)
    sets, horizon = fit_sets(
        task.system, engine, batch, task.horizon, pooled=False, options=Options(), starts=1, seed=0, kept=None
    )
    used = [one for one in sets if one.status != "diverged"]
    if not used:
        raise InputError("every fit diverged; check units, signs and start values")
    precision = np.diag(used[0].prior_precision)
    hessians, covariances = [], []
    for one in used:
        hessians.append(sum(np.einsum("tyi,tyj->ij", j, j) for j in one.jacobian))
        found = autocorrelation_robust(*one.of_records(), prior_precision=one.prior_precision)
        covariances.append(found.matrix - found.inverse_hessian @ precision @ found.inverse_hessian)
    if not all(np.isfinite(one).all() for one in covariances):
        raise InputError("the errors of its estimates are not finite; check units and start values")
    samples = [max(one.n_samples, 1) for one in used]
    return RobotFit(
        dataset.name,
        tuple(one.records[0] for one in used),
        tuple(tuple(one.values.tolist()) for one in used),
        tuple(tuple(map(tuple, matrix.tolist())) for matrix in hessians),
        tuple(tuple(map(tuple, matrix.tolist())) for matrix in covariances),
        float(np.sqrt(np.average([one.noise_scale**2 for one in used], weights=samples))),
        (horizon.kind, horizon.seconds),
        tuple(one.records[0] for one in sets if not one.ok),
        time.perf_counter() - start,
    )


def fit_robots(
    task: FleetTask, robots: Sequence[Dataset], *, jobs: int = 1, scheduler: str | None = None
) -> Iterator[RobotFit]:
    """Fit robots, each as soon as it is done; one that breaks is a result that says so.

    Args:
        task: what they share; its horizon is known.
        robots: their records.
        jobs: processes on this machine.
        scheduler: address of an existing Dask cluster, which is taken instead.

    Raises:
        InputError: nobody answers at the address, or Dask is not installed.
    """
    for number, result in fan_out(fit_robot, task, robots, jobs=jobs, scheduler=scheduler):
        yield RobotFit(robots[number].name, message=result.message) if isinstance(result, Failure) else result


def gather(system: System, robots: Sequence[RobotFit]) -> FleetStudy:
    """The fleet of robots that have been fitted.

    Raises:
        InputError: fewer than three have estimates.
    """
    fitted = tuple(robot for robot in robots if not robot.message)
    failed = tuple(robot for robot in robots if robot.message)
    if failed and len(fitted) < FEWEST:
        raise InputError(f"{len(failed)} of {len(robots)} robots have no estimate ({failed[0].message})")
    specs = [system.table[k].spec for k in system.estimated]
    found = fleet(
        *(
            [np.array(getattr(robot, what)) for robot in fitted]
            for what in ("values", "hessians", "covariances")
        ),
        prior_precision=np.array([0.0 if spec.prior_std is None else spec.prior_std**-2 for spec in specs]),
        misfit=np.array([robot.misfit for robot in fitted]),
        prior_mean=np.array([0.0 if spec.prior_mean is None else spec.prior_mean for spec in specs]),
    )
    return FleetStudy(system, fitted, failed, found)


def key_of(task: FleetTask, dataset: Dataset, program: str = __version__) -> str:
    """Digest of all that decides a robot's fit: records, model, settings, and the program that computes it."""
    horizon = None if task.horizon is None else (task.horizon.kind, task.horizon.seconds)
    model = describe_model(task.system), task.system.tree
    return hashlib.sha256(repr((program, model, horizon, dataset.digest)).encode()).hexdigest()


def save_robot(folder: Path, robot: RobotFit, key: str) -> None:
    """Keep a robot's fit under its name, whole or not at all."""
    write_json(folder / f"{robot.name}.json", sealed(asdict(robot), key))


def load_robot(folder: Path, name: str, key: str) -> RobotFit | None:
    """The fit that an earlier run has kept; None where there is none, or one of other records or settings."""
    try:
        kept = unsealed(folder / f"{name}.json", key)
        return None if kept is None else TypeAdapter(RobotFit).validate_python(kept)
    except ValueError:
        return None
