"""Models in MuJoCo: their errors there on records left out, and the re-fit there of what MuJoCo cannot carry."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from hybrid_id.errors import InputError
from hybrid_id.export.drives import Mjcf
from hybrid_id.export.mjcf import to_mjcf
from hybrid_id.export.replay import (
    READ,
    Agreement,
    Summary,
    agreement,
    free_runs_of,
    mujoco_replays,
    summarise,
)
from hybrid_id.identification.horizons import WHOLE, Horizon
from hybrid_id.parameters import ParameterInfo
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.units import number_of
from hybrid_id.systems.by_joint import with_joint_names
from hybrid_id.systems.chain import System

NOMINAL, REFITTED, CORRECTED, HYBRID = "nominal", "re-fitted", "corrected", "hybrid"
"""What the models of a diagnosis are called, and one with networks, which MuJoCo does not have."""
WORSE = 1.02
"""Ratio of errors in MuJoCo from which a corrected model, or a hybrid one, is worse than the re-fitted one."""
SCATTER = 1.05
"""Ratio of errors up to which a re-fit in MuJoCo has nothing to win: a smaller gain on train records is none on test
records. Fits of one model that differ in nothing but the treatment of the first states differ by less."""
STEPS = 15
"""Steps of a re-fit at most."""
STEP = 1e-4
"""Relative change of a parameter for its derivative."""
PROBE, MOVED = 1e-2, 1e-4
"""Relative change of a parameter, and that of the errors by which it shows that MuJoCo has it: more than rounding."""
Progress = Callable[[str, int, int], object]
"""Called before each model is replayed and after each replay of a fit with (stage, done, total at most)."""
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


@dataclass(frozen=True, eq=False)
class TargetErrors:
    """Models in MuJoCo, replayed there on the same records.

    Attributes:
        models: by what they are called; the one that is exported comes last.
        outputs: channels of the records.
        horizon: how long the free runs are.
    """

    models: Mapping[str, InTarget]
    outputs: tuple[Channel, ...]
    horizon: Horizon

    @property
    def label(self) -> str:
        """What the exported model is called."""
        return list(self.models)[-1]

    @property
    def exported(self) -> InTarget:
        """The model that is exported."""
        return self.models[self.label]

    @property
    def worse(self) -> bool:
        """Whether a corrected or hybrid model errs more in MuJoCo than the re-fitted one, on the records that judge."""
        if self.label not in (CORRECTED, HYBRID) or REFITTED not in self.models:
            return False
        return not self.exported.summary.there <= WORSE * self.models[REFITTED].summary.there


def target_errors(
    models: Mapping[str, System],
    dataset: Dataset,
    *,
    train: Dataset | None = None,
    horizon: Horizon = WHOLE,
    progress: Progress | None = None,
) -> TargetErrors:
    """Models replayed in MuJoCo, all but the nominal one fitted anew there where they lose by the way.

    The re-fit of a corrected model may begin where that of the re-fitted one has ended. A model beside the exported one
    that is unstable there is passed over.

    Args:
        models: by what they are called; the one that is exported comes last.
        dataset: records to replay.
        train: records that the models were fitted to; None: nothing is fitted anew.
        horizon: how long the free runs are.
        progress: see :data:`Progress`; a stage begins with the model's name.

    Raises:
        InputError: MuJoCo is not installed, or the exported model is unstable there.
    """
    found, last = dict[str, InTarget](), list(models)[-1]
    for label, system in models.items():
        known = None if label == NOMINAL else train

        def say(stage: str, done: int, total: int, label: str = label) -> None:
            if progress is not None:
                progress(f"{label} model, {stage}", done, total)

        starts = [found[REFITTED].system] if REFITTED in found else []
        with suppress(InputError) if label != last else nullcontext():
            found[label] = in_mujoco(
                system, dataset, train=known, horizon=horizon, starts=starts, progress=say
            )
    return TargetErrors(found, with_joint_names(dataset.outputs, models[last]), horizon)


def in_mujoco(
    system: System,
    dataset: Dataset,
    *,
    train: Dataset | None = None,
    horizon: Horizon = WHOLE,
    starts: Sequence[System] = (),
    progress: Progress | None = None,
) -> InTarget:
    """A model in MuJoCo: replayed, and fitted anew there where it loses by the way.

    What MuJoCo lacks is not looked up but measured: where its replays of the train records are surely worse than the
    package's, the parameters that move them are fitted in MuJoCo to these records; of a robot's, those of the joints
    that are replayed worse.

    Args:
        system: the model.
        dataset: records to replay.
        train: records that the model was fitted to; None: nothing is fitted anew.
        horizon: how long the free runs are.
        starts: models whose values the re-fit may begin with, too, where they have the same parameters.
        progress: see :data:`Progress`.

    Raises:
        InputError: MuJoCo is not installed, or the exported model is unstable there.
    """
    say = progress or (lambda *_: None)
    say("replays", 0, 1)
    exported = to_mjcf(system)
    before = tuple(agreement(system, exported, dataset, horizon))
    fitted = system if train is None else _refit(system, train, horizon, starts, say)
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


def _refit(
    system: System, train: Dataset, horizon: Horizon, starts: Sequence[System], say: Progress
) -> System:
    """The system with those parameters that MuJoCo has fitted there; itself where there is nothing to win."""
    runs = free_runs_of(system, train, horizon)

    def weighted(outputs: Sequence[Mapping[str, np.ndarray]]) -> np.ndarray:
        """Errors of free runs in the outputs that MuJoCo has, over the standard deviation of their measurement."""
        errors = [
            (simulated[name] - run.record.signal(name)) * run.weight[name]
            for run, simulated in zip(runs, outputs, strict=True)
            for name in run.outputs
            if name[:3] in READ
        ]
        return np.nan_to_num(np.concatenate(errors), nan=LOST, posinf=LOST, neginf=-LOST)

    stage, done, total = "replays of train records", 0, 1

    def errors(there: System) -> np.ndarray:
        nonlocal done
        try:
            found = weighted(mujoco_replays(there, to_mjcf(there), runs))
        except InputError:
            found = np.full(here.shape, LOST)
        done += 1
        say(stage, min(done, total), total)
        return found

    here = weighted([run.outputs for run in runs])
    own = errors(system)
    size = float(np.linalg.norm(own))
    if size <= SCATTER * np.linalg.norm(here):
        return system
    estimated = [system.table[row] for row in system.estimated]
    if system.tree is not None and not system.tree.couplings:  # the others have nothing to win
        numbers = [
            np.full(run.record.n_samples, int(number_of(name) or 0))
            for run in runs
            for name in run.outputs
            if name[:3] in READ
        ]
        joint = np.concatenate(numbers)
        lost = [
            f"{one.name}/"
            for one in system.joints
            if np.linalg.norm(own[joint == one.number]) > SCATTER * np.linalg.norm(here[joint == one.number])
        ]
        estimated = [info for info in estimated if info.component.startswith(tuple(lost))]
    total = 1 + len(estimated) + STEPS * (1 + len(estimated))
    moving: list[ParameterInfo] = []
    for info in (
        estimated
    ):  # a value a little off, on the side where its bounds leave more room, shows what MuJoCo has
        spec = info.spec
        change = PROBE * abs(spec.value) or PROBE**3
        up, down = min(spec.value + change, spec.upper), max(spec.value - change, spec.lower)
        probed = up if up - spec.value >= spec.value - down else down
        if np.linalg.norm(errors(system.with_values({info.name: probed})) - own) > MOVED * size:
            moving.append(info)
    if not moving:
        return system
    total = done + STEPS * (1 + len(moving))

    def at(x: np.ndarray) -> System:
        return system.with_values({info.name: float(v) for info, v in zip(moving, x, strict=True)})

    def residual(x: np.ndarray) -> np.ndarray:
        pairs = [(v, i.spec) for i, v in zip(moving, x, strict=True) if i.spec.prior_std]
        return np.concatenate([errors(at(x)), [(v - spec.prior_mean) / spec.prior_std for v, spec in pairs]])

    low, high = np.array([(info.spec.lower, info.spec.upper) for info in moving]).T
    known: list[dict[str, float]] = [
        {info.name: info.spec.value for info in one.table} for one in (system, *starts)
    ]
    begins = [
        np.clip([values.get(info.name, info.spec.value) for info in moving], low, high) for values in known
    ]
    best = min(begins, key=lambda x: float(np.linalg.norm(residual(x))))
    settings = {"x_scale": "jac", "diff_step": STEP, "ftol": 1e-3, "xtol": 1e-4, "max_nfev": STEPS}
    fit = least_squares(residual, best, bounds=(low, high), **settings)
    if np.linalg.norm(residual(best)) <= SCATTER * np.linalg.norm(fit.fun):  # nothing won but scatter
        return system if best is begins[0] else at(best)
    return at(fit.x)
