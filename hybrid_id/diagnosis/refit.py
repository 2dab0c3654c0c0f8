"""Fits of candidate models to the train records, a few at a time, in order of promise."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
import torch
from joblib import Parallel, delayed
from joblib.externals.loky.process_executor import BrokenProcessPool

from hybrid_id.diagnosis.catalogue import over_angle
from hybrid_id.diagnosis.evidence import WHITE, coloured, evidence
from hybrid_id.diagnosis.explanation import Explanation, Name
from hybrid_id.diagnosis.windows import windows
from hybrid_id.errors import InputError, MachineError
from hybrid_id.identification.fit import fit
from hybrid_id.identification.horizons import hidden_links
from hybrid_id.identification.least_squares import Options
from hybrid_id.identification.left_out import left_out
from hybrid_id.identification.result import FitResult
from hybrid_id.identification.rollouts import Slopes
from hybrid_id.identification.secant import secant_fit, shaken, slopes_at
from hybrid_id.records.dataset import Dataset
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.c_code import compiler
from hybrid_id.simulation.prepare import SIGNAL_SHARE
from hybrid_id.simulation.step import Engine
from hybrid_id.study.fan_out import leave_ctrl_c_to_the_first
from hybrid_id.study.replays import batch_of
from hybrid_id.systems.chain import System

BEGINNING = 12
"""Iterations of the fit in windows that today's model starts with: its nominal values may be far."""
TO_THE_END = 40
"""Iterations after which a fit is taken as it is."""
LOOK = 5
"""Iterations up to which a fit is a first look, judged by the records that it has seen."""
STRAYED = 0.1
"""Normalised RMSE of the best model's free runs from which they have lost the records: what acts at one angle or speed
is then simulated at another, and an error at one instant lasts to the end."""
WINDOW = 0.5
"""Length [s] of the windows, each from a measured state, over which models are compared instead."""
WINDOW_LOOK = 12
"""Iterations of a first look over windows."""
SHARED_FROM = 2_000_000
"""States times samples that have been fitted when further fits are shared: about the time that processes take to start,
and not the time itself, on which no result may depend."""


@dataclass(frozen=True, eq=False)
class Task:
    """A model to fit.

    Attributes:
        effects: that it has.
        system: where the fit starts.
        near: slopes of the model that it is close to, for a first look.
        cost: where a look has ended; another method is tried where the fit ends higher.
        x0: first states that the look has ended with, ``(R, n_x)``.
        shake: whether the last fit of a gear that nobody sees behind is shaken out of the ripples of its cost.
    """

    effects: tuple[Name, ...]
    system: System
    near: Slopes | None = None
    cost: float = 0.0
    x0: np.ndarray | None = None
    shake: bool = True


class Refit:
    """Fits models to the train records of a dataset.

    Args:
        dataset: only its train records are used.
        jobs: processes that share the fits, once a search turns out to be long.
        signal_share: see :func:`hybrid_id.simulation.prepare.make_batch`.
        window: length [s] of the windows that models are fitted to; None for whole records.
    """

    def __init__(
        self,
        dataset: Dataset,
        *,
        jobs: int = 1,
        signal_share: float = SIGNAL_SHARE,
        window: float | None = None,
    ) -> None:
        self.dataset, self.jobs, self.signal_share, self.window = dataset, jobs, signal_share, window
        self.fitted = 0

    def within(self, window: float) -> Refit:
        """The same over windows."""
        shorter = copy.copy(self)
        shorter.window = window
        return shorter

    def records(self, system: System) -> Batch:
        """The train records, whole."""
        return batch_of(self.dataset, system, self.dataset.train, self.signal_share, "cpu")

    def batch(self, system: System) -> Batch:
        """What models are fitted to: the train records, or windows of them from measured states."""
        batch = self.records(system)
        return batch if self.window is None else windows(system, engine(), batch, self.window)

    def strays(self, explanation: Explanation) -> bool:
        """Whether a model's free runs lose the records; what is noise loses none, however little an output moves."""
        batch = self.records(explanation.system)
        scale = batch.std(batch.y) * batch.weight.amax(1)
        square = [np.maximum(np.square(r).mean(0) - 1.0, 0.0) for r in explanation.result.residual]
        return float(np.sqrt(square / np.maximum(np.square(scale.numpy()), 1.0)).mean()) > STRAYED

    def base(self, system: System) -> Explanation:
        """Today's model, fitted from its nominal values and from a fit in windows, whichever ends lower."""
        batch = self.records(system)
        options = Options(max_iterations=BEGINNING, closed=False)
        near = fit(system, batch, pooled=True, engine=engine(), options=options)[0]
        tasks = [Task((), start) for start in (system, near.system)]
        ends = [e for e in self.run(tasks, TO_THE_END) if e is not None]
        if not ends:
            raise InputError(
                f"Today's model diverges on dataset '{self.dataset.name}'; check units, signs and start values."
            )
        return min(ends, key=lambda e: e.result.cost)

    def slopes(self, system: System, least: float) -> Slopes | None:
        """Slopes of a model, with which looks at neighbours of a cost below ``least`` begin; windows need none."""
        if self.window is not None:
            return None
        return replace(slopes_at(system, self.records(system), engine()), least=least)

    def run(
        self, tasks: Sequence[Task], iterations: int, done: Callable[[], object] | None = None
    ) -> list[Explanation | None]:
        """Fit models for at most so many iterations each, from where they stand; None where one cannot be fitted."""
        samples, found = sum(record.n_samples for record in self.dataset.train), []
        while len(found) < len(tasks):
            left = tasks[len(found) :]
            shared = self.jobs > 1 and self.fitted >= SHARED_FROM
            some, jobs = (left, self.jobs) if shared and len(left) > 1 else (left[:1], 1)
            try:
                # another process need not know the catalogue, to which the user may have added
                calls = (delayed(_fit)(self, t, iterations, over_angle(t.effects)) for t in some)
                for outcome in Parallel(n_jobs=jobs, return_as="generator")(calls):
                    found.append(outcome)
                    if done is not None:
                        done()
            except (BrokenProcessPool, OSError):  # for want of memory, say: the rest in turn
                if jobs == 1:
                    raise
                self.jobs = 1
            self.fitted += sum(len(task.system.state_names) for task in some) * samples
        return found


def _fit(refit: Refit, task: Task, iterations: int, halting: bool) -> Explanation | None:
    torch.set_num_threads(1)
    if refit.jobs > 1:
        leave_ctrl_c_to_the_first()
    step, last = min(record.sample_time for record in refit.dataset.train), iterations == TO_THE_END
    try:
        batch = refit.batch(task.system)
        loose = refit.window is None and hidden_links(task.system, batch)
        if refit.window is not None:
            result = _within(task, batch, iterations)
        elif loose or iterations <= LOOK:
            result = secant_fit(
                task.system, batch, engine=engine(), iterations=iterations, near=task.near, x0=task.x0
            )
        else:
            result = _nearest(task, batch, iterations, halting)
        if loose and task.shake and last:
            result = shaken(result, batch)
        blind = result.residual if iterations <= LOOK else left_out(result, batch)
        found = evidence(blind, step)
    except (InputError, RuntimeError, np.linalg.LinAlgError) as error:
        if isinstance(error, MachineError) or "allocate memory" in str(error):
            raise
        return None  # a start that the physics refuses is no candidate
    kept = result.condensed()  # a search keeps hundreds
    return Explanation(task.effects, kept, found, last) if found.error < float("inf") else None


def _nearest(task: Task, batch: Batch, iterations: int, halting: bool) -> FitResult:
    """The best of several ways to a fit; the last words are had from windows, too, where that leaves more than noise.

    The cost of whole rollouts ripples where a torque over the angle may halt the motion (``halting``), that of windows
    from measured states does not.
    """
    ends = _both_ways(task.system, batch, iterations, task.cost, task.x0)
    if halting and iterations == TO_THE_END and min(coloured(end.residual) for end in ends) > WHITE:
        with suppress(InputError, RuntimeError):
            near = _within(task, windows(task.system, engine(), batch, WINDOW), WINDOW_LOOK)
            ends += _both_ways(near.system, batch, iterations, task.cost, None)
    return min(ends, key=lambda end: end.cost)


def _both_ways(
    system: System, batch: Batch, iterations: int, cost: float, x0: np.ndarray | None
) -> list[FitResult]:
    """The fit by exact sensitivities of all samples, and that by finite steps where it may end lower than a cost.

    The first walks through valleys in which whole rollouts are stuck; the second sees through events and from afar.
    """
    options, ends = Options(max_iterations=iterations, tolerance=0.05), []
    last = iterations == TO_THE_END
    with suppress(InputError, RuntimeError):
        exact = fit(system, batch, pooled=True, engine=engine(), options=options, warm=last)[0]
        # behind impacts exact sensitivities tell nothing of the neighbourhood: finite ones are kept
        there = secant_fit(exact.system, batch, engine=exact.engine, iterations=0, x0=exact.x0)
        ends.append(replace(there, status=exact.status, iterations=exact.iterations))
    if last or not ends or ends[0].cost > cost:
        ends.append(secant_fit(system, batch, engine=engine(), iterations=iterations, x0=x0))
    return ends


def _within(task: Task, batch: Batch, iterations: int) -> FitResult:
    """The fit to windows by exact sensitivities: a model is nearly linear over so short a time.

    Standard errors are those of the encoders' noise, of which the errors are many times here: half of one is little.
    """
    options = Options(max_iterations=max(iterations, WINDOW_LOOK), tolerance=0.5)
    result = fit(task.system, batch, pooled=True, engine=engine(), options=options, warm=False)[0]
    if not np.isfinite(result.cost):
        raise RuntimeError("the start values diverge")
    return result


def engine() -> Engine:
    """How candidates are simulated: dry friction located in time, by compiled steps where there is a compiler."""
    return Engine(compiled=compiler() is not None)
