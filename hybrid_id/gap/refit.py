"""Fits of candidate models to the train records, a few at a time, in order of promise."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from joblib import Parallel, delayed

from hybrid_id.errors import InputError
from hybrid_id.gap.evidence import Evidence, evidence, predicted
from hybrid_id.identification.fit import fit
from hybrid_id.identification.horizons import hidden_links
from hybrid_id.identification.least_squares import Options
from hybrid_id.identification.result import FitResult
from hybrid_id.identification.secant import Rollouts, secant_fit
from hybrid_id.records.dataset import Dataset
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.prepare import SIGNAL_SHARE
from hybrid_id.simulation.step import Engine
from hybrid_id.study.replays import batch_of
from hybrid_id.systems.chain import System

LOOSE = Engine(friction="smooth", width=0.05, compiled=True)
"""How a gear with play is simulated: its contacts need short steps."""
GLANCE = Engine(friction="smooth", width=0.3, compiled=True)
"""The same at a first look."""
LOOK = 6
"""Iterations up to which a fit is a first look, whose end need not be a free run."""
Name = tuple[str, str]
"""An effect's name and where it acts."""


@dataclass(frozen=True, eq=False)
class Explanation:
    """A model with some effects added, fitted to the train records.

    Attributes:
        effects: what has been added to today's model, in the order of their names.
        result: the fit.
        evidence: its errors on records left out.
    """

    effects: tuple[Name, ...]
    result: FitResult
    evidence: Evidence

    @property
    def system(self) -> System:
        """The fitted model."""
        return self.result.system


@dataclass(frozen=True)
class Task:
    """A model to fit.

    Attributes:
        effects: that it has.
        system: where the fit starts.
        others: other start points of a gear with play ...
        before: ... and the fit without it.
    """

    effects: tuple[Name, ...]
    system: System
    others: tuple[System, ...] = ()
    before: FitResult | None = None


class Refit:
    """Fits models to the train records of a dataset.

    Args:
        dataset: only its train records are used.
        jobs: processes.
        signal_share: see :func:`hybrid_id.simulation.prepare.make_batch`.
    """

    def __init__(self, dataset: Dataset, *, jobs: int = 1, signal_share: float = SIGNAL_SHARE) -> None:
        self.dataset, self.jobs, self.signal_share = dataset, jobs, signal_share
        self.sample_time = min(record.sample_time for record in dataset.train)

    def base(self, system: System) -> Explanation:
        """Today's model, fitted from its nominal values."""
        batch = batch_of(self.dataset, system, self.dataset.train, self.signal_share, "cpu")
        result = fit(system, batch, pooled=True)[0]
        return Explanation((), result, evidence(result, self.sample_time))

    def run(
        self, tasks: Sequence[Task], iterations: int, done: Callable[[], object] | None = None
    ) -> list[Explanation | None]:
        """Fit models for at most so many iterations each, from where they stand; None where one cannot be fitted."""
        if not tasks:
            return []
        found: list[Explanation | None] = []
        jobs = min(self.jobs, len(tasks))
        calls = (delayed(_fit)(self.dataset, self.signal_share, task, iterations) for task in tasks)
        for outcome in Parallel(n_jobs=jobs, return_as="generator")(calls):
            found.append(outcome)
            if done is not None:
                done()
        return found


def _fit(dataset: Dataset, signal_share: float, task: Task, iterations: int) -> Explanation | None:
    torch.set_num_threads(1)
    if multiprocessing.parent_process() is not None:  # Ctrl-C is for the first process to answer
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    step = min(record.sample_time for record in dataset.train)
    try:
        batch = batch_of(dataset, task.system, dataset.train, signal_share, "cpu")
        if hidden_links(task.system, batch):
            if task.before is not None and iterations < LOOK:
                return _glance(task, task.before, batch, step)
            starts = _wider_and_narrower(task) if iterations == LOOK else [task.system]
            fits = [secant_fit(start, batch, engine=LOOSE, iterations=iterations) for start in starts]
            result = min(fits, key=lambda one: one.cost)
        else:
            options = Options(max_iterations=iterations, tolerance=0.05, closed=iterations > LOOK)
            result = fit(task.system, batch, pooled=True, warm=False, options=options)[0]
    except (InputError, RuntimeError):  # a start that the physics refuses is no candidate
        return None
    if result.status == "diverged":
        return None
    found = evidence(result, step)
    return Explanation(task.effects, result, found) if found.error < float("inf") else None


def _wider_and_narrower(task: Task) -> list[System]:
    """Start points of a model whose only effect is play: sizes beside the one that looked best."""
    gaps = [
        info for info in task.system.table if info.component.endswith("/backlash") and info.symbol == "gap"
    ]
    if len(task.effects) > 1 or len(gaps) != 1:
        return [task.system]
    value, name = gaps[0].spec.value, gaps[0].name
    return [
        task.system.with_values({name: min(f * value, gaps[0].spec.upper)})
        for f in (1.0, 0.65, 1.5, 0.4, 2.5)
    ]


def _glance(task: Task, before: FitResult, batch: Batch, step: float) -> Explanation:
    """The best start point of a model whose gear has play, to first order in everything else.

    The parameters of the fit without the effect are free along their sensitivities, and so is the size of what the
    effect does at its start point.
    """
    starts = (task.system, *task.others)
    own = {(info.component, info.symbol) for info in before.system.table}
    new = [i for i, info in enumerate(task.system.table) if (info.component, info.symbol) not in own]
    run = Rollouts(task.system, batch, GLANCE, new)
    runs = run.residuals(np.array([s.theta().detach().numpy()[new] for s in starts]))
    keep = [(batch.weight[r] > 0).any(1).numpy() for r in range(batch.rows)]
    # all starts have the same parameters; a gear with play takes a spring's place
    names = {(info.component, info.symbol): info.name for info in task.system.table}
    keys = [(i.component, i.symbol) for i in (before.system.parameter(name) for name in before.names)]
    kept = [k for k, key in enumerate(keys) if key in names]
    looks = []
    for start, rows in zip(starts, runs, strict=True):
        residual = tuple(rows[r][k] for r, k in enumerate(keep))
        change = [(old - one)[..., None] for old, one in zip(before.residual, residual, strict=True)]
        jacobian = [np.concatenate(pair, -1) for pair in zip(before.jacobian, change, strict=True)]
        result = replace(
            before, system=start, names=tuple(names[keys[k]] for k in kept), values=before.values[kept],
            units=tuple(before.units[k] for k in kept), jacobian=tuple(j[..., kept] for j in before.jacobian),
            prior_precision=before.prior_precision[kept], residual=residual, status="max_iterations",
            engine=run.engine,
        )  # fmt: skip
        looks.append(Explanation(task.effects, result, predicted(jacobian, residual, step)))
    return min(looks, key=lambda look: look.evidence.error)
