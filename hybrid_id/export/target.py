"""Models in MuJoCo: their errors there on records left out, and the re-fit there of what MuJoCo cannot carry."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from hybrid_id.errors import InputError
from hybrid_id.export.drives import Mjcf
from hybrid_id.export.mjcf import to_mjcf
from hybrid_id.export.replay import (
    READ,
    Agreement,
    FreeRun,
    Summary,
    agreement,
    free_runs_of,
    mujoco_replays,
    summarise,
)
from hybrid_id.identification.horizons import WHOLE, Horizon
from hybrid_id.parameters import Bounded
from hybrid_id.records.dataset import Dataset
from hybrid_id.systems.chain import System

WORSE = 1.05
"""Ratio of errors from which the larger one is worse: MuJoCo's against the package's, a model's against another's.
Fits of one model that differ in nothing but the treatment of the first states differ by less on test records."""
STEPS = 15
"""Steps of a re-fit at most."""
STEP = 1e-4
"""Relative change of a parameter for its derivative."""
PROBE, MOVED = 1e-2, 1e-4
"""Relative change of a parameter, and that of the errors by which it shows that MuJoCo has it: more than rounding."""
LOST = 1e6
"""Weighted error of a sample that MuJoCo cannot reach: it has become unstable."""


@dataclass(frozen=True, eq=False)
class InTarget:
    """A model in MuJoCo.

    Attributes:
        system: the model, at the values that are exported.
        exported: the file, and what it leaves out.
        rows: replays there and, of the model as it was before any re-fit there, here.
        refitted: value before and after of each parameter that was fitted anew there; empty where none was.
        before: the same replays of the model as it was; its own where nothing was fitted anew.
    """

    system: System
    exported: Mjcf
    rows: tuple[Agreement, ...]
    refitted: Mapping[str, tuple[float, float]]
    before: tuple[Agreement, ...]

    @property
    def summary(self) -> Summary:
        """Errors on the records that judge."""
        return summarise(self.rows)

    def worse_than(self, other: InTarget) -> bool:
        """Whether this model errs more in MuJoCo than another one, on the records that judge both."""
        return not self.summary.there <= WORSE * other.summary.there


def in_mujoco(
    system: System,
    dataset: Dataset,
    *,
    train: Dataset | None = None,
    horizon: Horizon = WHOLE,
    starts: Sequence[System] = (),
) -> InTarget:
    """A model in MuJoCo: replayed, and fitted anew there where it loses by the way.

    What MuJoCo lacks is not looked up but measured: where its replays of the train records are surely worse than the
    package's, the parameters that move them are fitted in MuJoCo to these records.

    Args:
        system: the model.
        dataset: records to replay.
        train: records that the model was fitted to; None: nothing is fitted anew.
        horizon: how long the free runs are.
        starts: models whose values the re-fit may begin with, too, where they have the same parameters.

    Raises:
        InputError: MuJoCo is not installed, or the exported model is unstable there.
    """
    exported = to_mjcf(system)
    before = tuple(agreement(system, exported, dataset, horizon))
    fitted = system if train is None else _refit(system, train, horizon, starts)
    if fitted is system:
        return InTarget(system, exported, before, {}, before)
    exported = to_mjcf(fitted)
    rows = tuple(agreement(system, exported, dataset, horizon, there=fitted))
    pairs = zip(system.table, system.theta().tolist(), fitted.theta().tolist(), strict=True)
    return InTarget(
        fitted, exported, rows, {i.name: (old, new) for i, old, new in pairs if old != new}, before
    )


def with_comment(exported: Mjcf, words: Sequence[str]) -> Mjcf:
    """The exported system with sentences as a comment at the end of the file."""
    lines = "\n  ".join(words).replace("--", "- -")
    return replace(exported, text=f"{exported.text.rstrip()}\n<!-- {lines} -->\n")


def _refit(system: System, train: Dataset, horizon: Horizon, starts: Sequence[System]) -> System:
    """The system with those parameters that MuJoCo has fitted there; itself where there is nothing to win."""
    runs = free_runs_of(system, train, horizon)
    here = np.concatenate([_weighted(run, run.outputs) for run in runs])

    def errors(there: System) -> np.ndarray:
        try:
            replays = mujoco_replays(there, to_mjcf(there), runs)
        except InputError:
            return np.full(here.shape, LOST)
        return np.concatenate([_weighted(run, one) for run, one in zip(runs, replays, strict=True)])

    own = errors(system)
    if np.linalg.norm(own) <= WORSE * np.linalg.norm(here):
        return system
    moving = [
        info
        for info in (system.table[row] for row in system.estimated)
        if np.linalg.norm(errors(system.with_values({info.name: _probed(info.spec)})) - own)
        > MOVED * np.linalg.norm(own)
    ]
    if not moving:
        return system

    def at(x: np.ndarray) -> System:
        return system.with_values({info.name: float(v) for info, v in zip(moving, x, strict=True)})

    def residual(x: np.ndarray) -> np.ndarray:
        priors = [
            (v - i.spec.prior_mean) / i.spec.prior_std
            for i, v in zip(moving, x, strict=True)
            if i.spec.prior_std
        ]
        return np.concatenate([errors(at(x)), priors])

    known = [{info.name: info.spec.value for info in one.table} for one in (system, *starts)]
    begins = [np.array([values.get(info.name, info.spec.value) for info in moving]) for values in known]
    low, high = np.array([(info.spec.lower, info.spec.upper) for info in moving]).T
    begins = [np.clip(begin, low, high) for begin in begins]
    best = min(begins, key=lambda x: float(np.linalg.norm(residual(x))))
    fit = least_squares(
        residual,
        best,
        bounds=(low, high),
        x_scale="jac",
        diff_step=STEP,
        ftol=1e-3,
        xtol=1e-4,
        max_nfev=STEPS,
    )
    if np.linalg.norm(residual(best)) <= WORSE * np.linalg.norm(residual(fit.x)):  # nothing won but scatter
        return system if best is begins[0] else at(best)
    return at(fit.x)


def _weighted(run: FreeRun, outputs: Mapping[str, np.ndarray]) -> np.ndarray:
    """Errors of a free run's outputs, of those that MuJoCo has, over the standard deviation of their measurement."""
    names = [name for name in run.outputs if name[:3] in READ]
    found = np.concatenate([(outputs[name] - run.record.signal(name)) * run.weight[name] for name in names])
    return np.nan_to_num(found, nan=LOST, posinf=LOST, neginf=-LOST)


def _probed(spec: Bounded) -> float:
    """A value a little off the present one, within the bounds."""
    change = PROBE * abs(spec.value) or PROBE**3
    return spec.value + change if spec.value + change <= spec.upper else spec.value - change
