"""Fits of models to the train records, and their errors on records left out: validation or train records."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch
from joblib import Parallel, delayed
from joblib.externals.loky.process_executor import BrokenProcessPool

from hybrid_id.diagnosis.catalogue import over_angle
from hybrid_id.diagnosis.criteria import CRITERIA
from hybrid_id.diagnosis.model import FittedModel, Name, Tally, Unfitted
from hybrid_id.diagnosis.plausibility import NUISANCE
from hybrid_id.diagnosis.validation import Validation, autocorrelation, mean_square, validation
from hybrid_id.errors import InputError, MachineError, shortened
from hybrid_id.identification.finite_differences import (
    STEPS,
    WORST,
    Rollouts,
    Slopes,
    finite_difference_fit,
    slopes_at,
)
from hybrid_id.identification.fit import fit, kept_fit, make_bounds
from hybrid_id.identification.horizons import WHOLE, Horizon, astray, settled
from hybrid_id.identification.keep import Arrays, Kept, pack_result, same_but_for_values, unpack_result
from hybrid_id.identification.least_squares import LeastSquares, Options, minimise
from hybrid_id.identification.leave_one_out import folds, leave_one_out, started_without
from hybrid_id.identification.restarts import confirmed, perturbed_restarts
from hybrid_id.identification.result import FitResult
from hybrid_id.identification.windows import hidden_links
from hybrid_id.parameters import NARROWEST_PRIOR, Bounded
from hybrid_id.records.dataset import Dataset
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.compiled import compiler_works
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.stability import with_substeps
from hybrid_id.simulation.step import MAX_SUBSTEPS, Engine
from hybrid_id.study.many import leave_ctrl_c_to_the_first
from hybrid_id.study.replay import batch_of, run_freely
from hybrid_id.systems.chain import System

BEGINNING = 12
"""Iterations of the fit in windows that the nominal model starts with: its values may be far."""
COARSE, FINER, FULL = 4, 10, 40
"""Iterations of a first coarse fit, of a finer one, and of a fit to the end."""
AGAIN = 4
"""Iterations of its re-fit without some records."""
STUCK = 2e-3
"""Fall of the others' cost below which a re-fit without a record has not moved."""
WINDOW = 0.5
"""Length [s] of the windows, each from a measured state, over which a fit from afar begins."""
HOLDS = (NUISANCE, NUISANCE / 3, NUISANCE / 10, NUISANCE / 30)
"""How closely parameters are held where the model leaves structure: ever closer, as long as that predicts better."""
CLOSER = 0.99
"""Ratio of mean squares that each step closer has to reach: what is held closely lends its error to an effect."""
TRIES = 2
"""Rounds of perturbed restarts of a gear whose link nobody measures."""
SUBSTEP_RATE = 4000.0
"""Sub-steps that a candidate needs at most [1/s]: they follow what swings at 300 Hz. More where the nominal values
ask for more than half as many: twice theirs; not where a fit does, which may be close to a singular mass matrix."""
SLOW = 1e-3
"""Share of what a fit leaves beyond noise that a few steps, or one by new finite slopes, have to gain for another."""
NARROWEST = 1e-6
"""Relative standard deviation of the narrowest prior that a fit can still move against."""
MOST_REASON = 200
"""Characters of why a fit has failed."""
FAILURES = InputError, RuntimeError, np.linalg.LinAlgError
"""What a fit may end with that has gone astray."""
PARALLEL_FROM = 2_000_000
"""States times samples that have been fitted when further fits are shared: about the time that processes take to start,
and not the time itself, on which no result may depend."""


@dataclass(frozen=True, eq=False)
class Task:
    """A model to fit.

    Attributes:
        effects: that it has.
        system: where the fit starts.
        near: slopes of the model that it is close to, for a coarse fit.
        cost: where an earlier fit has ended; another method is tried where this one ends higher.
        x0: first states that the earlier fit has ended with, ``(R, n_x)``.
        perturb: whether the last fit of a gear whose link nobody measures is restarted from perturbed values.
        judged_below: mean square of its own errors below which the last fit is followed by its errors on records left
            out, by re-fits where these are train records.
    """

    effects: tuple[Name, ...]
    system: System
    near: Slopes | None = None
    cost: float = 0.0
    x0: np.ndarray | None = None
    perturb: bool = True
    judged_below: float = math.inf


class Fits:
    """Fits models to the train records of a dataset, and judges them on records left out.

    Args:
        dataset: models are fitted to its train records; the validation records, where there are any, only judge.
        jobs: processes that share the fits, once a search turns out to be long.
        horizon: how long free runs are before they start again from a measured state.
        kept: fits of an earlier run, and where those of this one are kept.

    Attributes:
        weights: of the records that judge, ``(R,)``; None until the nominal model is fitted.
        engine: how candidates are simulated. What is too fast for its sub-steps fits badly, and costs no more for it.
        tally: how many fits were tried and which failed, over every horizon.
    """

    def __init__(
        self,
        dataset: Dataset,
        *,
        jobs: int = 1,
        horizon: Horizon = WHOLE,
        kept: Kept | None = None,
    ) -> None:
        self.dataset, self.jobs, self.horizon = dataset, jobs, horizon
        self.kept = kept
        self.fitted = 0
        self.weights: np.ndarray | None = None
        self.engine = engine()
        self.tally = Tally()

    def over(self, horizon: Horizon) -> Fits:
        """The same over another horizon."""
        other = copy.copy(self)
        other.horizon, other.weights = horizon, None
        return other

    @property
    def whole(self) -> bool:
        """Whether models run free over whole records."""
        return self.horizon.kind == "whole"

    def on_all(self) -> Fits:
        """The same for the train and validation records together."""
        every = self.over(self.horizon)
        seen = (replace(r, role="train") if r.role == "validation" else r for r in self.dataset.records)
        every.dataset = replace(self.dataset, records=tuple(seen))
        return every

    def records(self, system: System) -> Batch:
        """The train records, whole."""
        return batch_of(self.dataset, system, self.dataset.train)

    def batch(self, system: System) -> Batch:
        """What models are fitted to: the train records, or pieces of them from measured states."""
        return self.horizon.cut(system, self.engine, self.records(system))

    def astray(self, model: FittedModel) -> float:
        """Normalised RMSE of a model's free runs, less the noise, however little an output moves."""
        return astray([model.result], self.records(model.system))

    def base(self, system: System, *, free: bool = False) -> FittedModel:
        """The nominal model, fitted from a fit in windows and, where that leaves structure, from its own values, too.

        Where it leaves structure its parameters are held (:func:`with_priors`), unless they are to be ``free``. How
        well it predicts each record says how much that counts in all later comparisons.
        """
        batch = self.records(system)
        options = Options(max_iterations=BEGINNING, closed=False)
        near = kept_fit(self.kept, system, batch, pooled=True, engine=engine(), options=options)[0]
        most = max(
            round(SUBSTEP_RATE * batch.sample_time), 2 * with_substeps(system, engine(), batch).substeps, 1
        )
        self.engine = replace(engine(), most_substeps=min(most, MAX_SUBSTEPS))
        # the fit from several starts that ends lowest; the first that leaves no more than noise is enough
        starts = [Task((), near.system, x0=near.x0), Task((), system)]
        fitted_ends = list[FittedModel]()
        for start in starts:
            fitted_ends += [
                end for end in self.run([replace(start, judged_below=0.0)], FULL) if end is not None
            ]
            if fitted_ends and fitted_ends[-1].white:
                break
        best = min(fitted_ends, key=lambda e: e.result.cost, default=None)
        if best is None:
            raise InputError(
                f"The nominal model diverges on dataset '{self.dataset.name}'; check units, signs and start values."
            )
        if not (best.no_structure or free):
            best = self._base_with_priors(system, best) or best
        # a fit that has stopped early would lend its gap to the first effect that frees it
        again = confirmed(
            best.result, self.batch(best.system), options=Options(tolerance=0.05), kept=self.kept
        )
        left = [] if best.judged else [best.result]
        if again is not best.result:
            left.append(again)
        ends = self.run([Task((), end.system, x0=end.x0) for end in left], FULL)
        judged = [end for end in (best, *ends) if end is not None and end.judged]
        best = min(judged, key=lambda e: e.result.cost, default=best)
        self.weights = best.validation.even_weights()
        return replace(best, validation=best.validation.weighted(self.weights))

    def _base_with_priors(self, system: System, free: FittedModel) -> FittedModel | None:
        """The nominal model with its parameters held as closely as predicts records left out best.

        The first fit begins at the nominal values; where it errs clearly more than the free one, at that one's, too,
        whichever ends lower.
        """

        def held(start: Task, share: float) -> FittedModel | None:
            return self.run([replace(start, system=with_priors(start.system, system, free, share))], FULL)[0]

        ends = [held(Task((), system), HOLDS[0])]
        if ends[0] is None or ends[0].trained > free.trained / (1.0 - CRITERIA.distinct_fall):
            ends.append(held(Task((), free.system, x0=free.result.x0), HOLDS[0]))
        found = min((e for e in ends if e is not None), key=lambda e: e.result.cost, default=None)
        if found is None:
            return None
        end, most = found, found.validation.typical
        for share in HOLDS[1:]:
            end = held(Task((), end.system, x0=end.result.x0), share)
            if end is None:
                break
            most *= CLOSER
            if end.validation.typical <= most:
                found, most = end, end.validation.typical
        return found

    def slopes(self, system: System, least: float, x0: np.ndarray | None = None) -> Slopes | None:
        """Slopes of a model, with which looks at neighbours of a cost below ``least`` begin; windows need none.

        Args:
            system: the model.
            least: cost that the neighbours have to get below to be of interest.
            x0: first states that it has been fitted with, ``(R, n_x)`` (default: as measured).
        """
        if not self.whole:
            return None
        return replace(slopes_at(system, self.records(system), self.engine, x0), least=least)

    def run(
        self, tasks: Sequence[Task], iterations: int, done: Callable[[], object] | None = None
    ) -> list[FittedModel | None]:
        """Fit models for at most so many iterations each, from where they stand; None where one cannot be fitted.

        The tally counts each of them.
        """
        samples, found = sum(record.n_samples for record in self.dataset.train), []
        while len(found) < len(tasks):
            left = tasks[len(found) :]
            shared = self.jobs > 1 and self.fitted >= PARALLEL_FROM
            some, jobs = (left, self.jobs) if shared and len(left) > 1 else (left[:1], 1)
            try:
                # another process need not know the catalogue, to which the user may have added
                calls = (delayed(_kept)(self, t, iterations, over_angle(t.effects)) for t in some)
                for outcome in Parallel(n_jobs=jobs, return_as="generator")(calls):
                    self.tally.tried += 1
                    if isinstance(outcome, Unfitted):
                        self.tally.failed[outcome] += 1
                    found.append(None if isinstance(outcome, Unfitted) else outcome)
                    if done is not None:
                        done()
            except (BrokenProcessPool, OSError):  # for want of memory, say: the rest in turn
                if jobs == 1:
                    raise
                self.jobs = 1
            self.fitted += sum(len(task.system.state_names) for task in some) * samples
        return found


def with_priors(system: System, nominal: System, fitted: FittedModel, share: float) -> System:
    """A model whose parameters are held to their nominal values as data sheets hold them, or closer.

    What a model lacks moves its parameters beyond reason, and a re-fit without one record the more: an error of several
    noises that lasts is one measurement, and weighs as little. Friction is held by no data sheet, nor is anything held
    that has a prior of its own or a nominal value of zero.

    Args:
        system: the model, with any effects.
        nominal: with the nominal values.
        fitted: its mean square and the number of independent samples that it leaves scale the priors.
        share: standard deviation of the priors, relative to the values.
    """
    worth = fitted.result.noise_scale**2 * fitted.result.n_samples / max(fitted.validation.effective, 1.0)
    std = max(share / max(worth, 1.0) ** 0.5, NARROWEST)
    return _prior_on_known(system, nominal, lambda value: (value, std * abs(value)))


def without_priors(system: System, nominal: System) -> System:
    """The same model held no longer: one that lacks nothing needs no help to stay near its true values."""
    return _prior_on_known(system, nominal, lambda value: (None, None))


def with_priors_of(system: System, other: System) -> System:
    """The same model with its parameters held as another one holds those that both have."""
    given = {(info.component, info.symbol): info.spec for info in other.table}
    held = {
        info.name: _held(info.spec, spec.prior_mean, spec.prior_std)
        for info in system.table
        if (spec := given.get((info.component, info.symbol))) is not None
    }
    return system.with_specs(held)


def _prior_on_known(
    system: System, nominal: System, prior: Callable[[float], tuple[float | None, float | None]]
) -> System:
    known = {(i.component, i.symbol): i.spec for i in nominal.table if i.spec.prior_std is None}
    priors = {}
    for info in system.table:
        spec = known.get((info.component, info.symbol))
        if spec is None or not spec.estimate or spec.value == 0.0 or "_friction/" in info.component:
            continue
        mean, std = prior(spec.value)
        priors[info.name] = _held(info.spec, mean, std)
    return system.with_specs(priors)


def _held(spec: Bounded, mean: float | None, std: float | None) -> Bounded:
    """A parameter with a prior, or without: from where no fit could bring it back it begins at the prior's mean."""
    if mean is not None and std is not None and std < NARROWEST_PRIOR * abs(spec.value):
        spec = spec.at(mean)
    return replace(spec, prior_mean=mean, prior_std=std)


def _kept(fits: Fits, task: Task, iterations: int, halting: bool) -> FittedModel | Unfitted:
    """A fit, as an earlier run has kept it if there is one."""
    if fits.kept is None:
        return _fit(fits, task, iterations, halting)
    records = (fits.dataset.train, fits.dataset.validation, fits.dataset.outputs)
    asked = (fits.horizon, fits.dataset.signal_share, fits.weights, task, iterations, halting, fits.engine)
    made_from = (records, *asked, CRITERIA.white, CRITERIA.coloured)

    def pack(model: FittedModel | Unfitted) -> Arrays | None:
        if isinstance(model, Unfitted):
            return {"reason": np.array(model.reason)}
        if not same_but_for_values(model.result, task.system):
            return None
        seen = vars(model.validation) | {"judged": model.judged}
        return pack_result(model.result) | {name: np.asarray(value) for name, value in seen.items()}

    def unpack(arrays: Mapping[str, np.ndarray]) -> FittedModel | Unfitted:
        if "reason" in arrays:
            return Unfitted(task.effects, str(arrays["reason"]))
        seen = Validation(
            arrays["blocks"], arrays["sizes"], arrays["row"], float(arrays["effective"]), arrays["record"]
        )
        return FittedModel(task.effects, unpack_result(arrays, task.system), seen, bool(arrays["judged"]))

    return fits.kept.of(made_from, partial(_fit, fits, task, iterations, halting), pack, unpack)


def _fit(fits: Fits, task: Task, iterations: int, halting: bool) -> FittedModel | Unfitted:
    torch.set_num_threads(1)
    if fits.jobs > 1:
        leave_ctrl_c_to_the_first()
    full = iterations == FULL
    try:
        batch = fits.batch(task.system)
        hidden = fits.whole and hidden_links(task.system, batch)
        if not fits.whole:
            # the fit to windows from the start, or from where a fit over short ones has ended, whichever ends lower
            ends = [_within(fits.engine, task.system, batch, iterations)]
            if fits.horizon.seconds > WINDOW and autocorrelation(ends[0].residual) > CRITERIA.white:
                with suppress(*FAILURES):
                    short = fits.over(Horizon("windows", WINDOW)).batch(task.system)
                    near = _within(fits.engine, task.system, short, iterations)
                    ends.append(_within(fits.engine, near.system, batch, iterations))
            end = min(ends, key=lambda end: end.cost)
            if iterations < FULL:
                result = end
            else:
                records, options = fits.records(task.system), _near(FINER)
                result = settled(
                    [end], fits.horizon, records, engine=fits.engine, options=options, warm=False
                )[0]
        elif hidden or iterations <= COARSE:
            result = finite_difference_fit(
                task.system, batch, engine=fits.engine, iterations=iterations, near=task.near, x0=task.x0
            )
        else:
            result = _nearest(fits.engine, task, batch, iterations, halting)
        if hidden and task.perturb and full:
            result = perturbed_restarts(result, batch, tries=TRIES)
        # what is taken as it stands has seen no validation record either
        judge = full or (iterations == 0 and bool(fits.dataset.validation))
        judge = judge and mean_square(result.residual) < task.judged_below
        errors = _unseen(fits, result) if judge else (result.residual, batch.sample_time, batch.names)
        found = validation(*errors)
        if judge and fits.weights is not None:  # each record as it counts
            found = found.weighted(fits.weights)
    except FAILURES as error:
        if isinstance(error, MachineError) or "allocate memory" in str(error):
            raise
        return Unfitted(task.effects, shortened(" ".join(str(error).split()), MOST_REASON))
    sound = np.isfinite(found.error) and all(np.isfinite(part).all() for part in result.jacobian)
    if not sound:
        return Unfitted(task.effects, "its errors or their slopes are not finite")
    return FittedModel(task.effects, result.condensed(), found, judge)  # a search keeps hundreds


def _unseen(fits: Fits, result: FitResult) -> tuple[list[np.ndarray], float, Sequence[str]]:
    """Weighted errors of a fit on the validation records, or on the train records left out whole, in turn.

    With the sample time and the record of each. All begin in hidden first states of the fit's own values.

    A free run that has lost its record errs at most by as much as any record moves: how far it strays from there says
    nothing of the model, and would drown all other records.
    """
    system = result.system
    train = fits.records(system)
    reach = train.motion().amax(0).clamp_min(1.0).numpy()
    if not fits.dataset.validation:
        pieces = fits.horizon.cut(system, fits.engine, train)
        return bounded(predicted(result, pieces), reach), pieces.sample_time, pieces.names
    whole = batch_of(fits.dataset, system, fits.dataset.validation)
    runs = run_freely(system, result.engine, whole, fits.horizon)
    seen, run = runs.pieces, runs.simulated.y.numpy()
    error = np.nan_to_num((seen.y.numpy() - run) * seen.weight.numpy(), nan=WORST).clip(-WORST, WORST)
    kept = [row[(weight > 0).any(1)] for row, weight in zip(error, seen.weight.numpy(), strict=True)]
    return bounded(kept, reach), seen.sample_time, seen.names


def bounded(errors: Sequence[np.ndarray], reach: np.ndarray) -> list[np.ndarray]:
    """Weighted errors of free runs, ``(T, n_y)`` each, scaled down to an RMS of at most ``reach`` ``(n_y,)``."""
    sizes = [np.sqrt(np.square(row).mean(0)) for row in errors]
    return [
        row * np.minimum(1.0, reach / np.maximum(size, 1e-300))
        for row, size in zip(errors, sizes, strict=True)
    ]


def predicted(result: FitResult, batch: Batch) -> list[np.ndarray]:
    """Weighted errors of each row, ``(T, n_y)``, predicted by fits of the other records alone.

    Every fit starts from that of all records, over windows from its linearised estimate without the part, with the
    first states that it has found: these are the left-out record's own. What nobody measures of them has been fitted to
    that record and would explain it: it begins as the values say. A single record has no others: its blocks are left
    out one sixth at a time.
    """
    fold = folds(batch)
    if fold is None:
        return leave_one_out(result, batch, AGAIN)
    if len(set(batch.names)) == batch.rows:
        # the same of whole records, by finite steps, which see through stick and slip and play
        first = _as_measured(result, batch)
        rippled = autocorrelation(result.residual) > CRITERIA.coloured
        starts = started_without(result, batch, fold) if rippled else None
        found: list[np.ndarray] = [np.empty(0)] * batch.rows
        slopes = slopes_at(result.system, batch, result.engine, result.x0)  # where all these fits begin
        for k in np.unique(fold):
            inside, outside = (torch.as_tensor(np.flatnonzero(rows)) for rows in (fold != k, fold == k))
            others = batch.take(inside)
            settings = {
                "engine": result.engine, "iterations": AGAIN, "x0": result.x0[inside.numpy()], "tangents": False,
                "shares": STEPS[:1],
            }  # fmt: skip
            # where errors are noise, the slopes of all records lead to the others' minimum, too
            known = {"begin" if rippled else "near": slopes.of_rows(inside.numpy())}
            again = finite_difference_fit(result.system, others, **known, **settings)
            if starts is not None and again.cost > (1.0 - STUCK) * again.history[0]:
                with suppress(InputError):  # a step may leave an arm no mass matrix
                    start = result.system.with_values(
                        dict(zip(result.names, starts[k].tolist(), strict=True))
                    )
                    again = finite_difference_fit(start, others, **settings)
            rest = Rollouts(result.system, batch.take(outside), result.engine, result.system.estimated)
            errors = rest.residuals(again.values[None], first[None, outside.numpy()])[0]
            for row, error in zip(outside.tolist(), errors, strict=True):
                found[row] = error[(batch.weight[row] > 0).any(1).numpy()]
        return found
    first = _as_measured(result, batch)
    inside = [np.flatnonzero(fold != k) for k in range(fold.max() + 1)]
    system, free, parts = result.system, result.system.estimated, len(inside)
    sets = torch.repeat_interleave(torch.arange(parts), torch.tensor([len(rows) for rows in inside]))
    some = batch.take(torch.as_tensor(np.concatenate(inside)))
    some = replace(some, x=some.x.clone())
    some.x[:, 0] = torch.as_tensor(first[np.concatenate(inside)])
    theta = system.theta().detach()[:, None].repeat(1, parts)
    theta[free] = torch.as_tensor(started_without(result, batch, fold).T)
    options, bounds = Options(max_iterations=2 * AGAIN, tolerance=0.5), make_bounds(system, free)
    nodes = simulate(system, result.engine, some, theta[:, sets]).x
    problem = LeastSquares(system, result.engine, some, sets, free, bounds)
    again = minimise(problem, theta, options, nodes=nodes)
    points = again.theta[free].T.numpy()
    runs = Rollouts(system, batch, result.engine, free).residuals(points, np.tile(first, (parts, 1, 1)))
    kept = (batch.weight > 0).any(2).numpy()
    return [runs[fold[row], row, kept[row]] for row in range(batch.rows)]


def _as_measured(result: FitResult, batch: Batch) -> np.ndarray:
    """First states of a fit, ``(R, n_x)``, of which those that nobody measures are the batch's."""
    first = torch.where(batch.x0_std > 0, torch.as_tensor(result.x0), batch.x[:, 0])
    hidden = [row for joint in result.system.joints for row in joint.hidden_rows(batch.outputs)]
    first[:, hidden] = batch.x[:, 0, hidden]
    return first.numpy()


def _nearest(how: Engine, task: Task, batch: Batch, iterations: int, halting: bool) -> FitResult:
    """The best of several ways to a fit; the last words are had from windows, too, where that leaves more than noise.

    The cost of whole rollouts ripples where a torque over the angle may halt the motion (``halting``), that of windows
    from measured states does not.
    """
    ends = _both_ways(how, task.system, batch, iterations, task.cost, task.x0)
    if halting and iterations == FULL and min(autocorrelation(end.residual) for end in ends) > CRITERIA.white:
        with suppress(*FAILURES):
            near = _within(how, task.system, Horizon("windows", WINDOW).cut(task.system, how, batch), FINER)
            ends += _both_ways(how, near.system, batch, iterations, task.cost, None)
    return min(ends, key=lambda end: end.cost)


def _both_ways(
    how: Engine, system: System, batch: Batch, iterations: int, cost: float, x0: np.ndarray | None
) -> list[FitResult]:
    """The fit by exact sensitivities, and by finite steps, too, where the first is not enough.

    It is not where it ends above an earlier cost or, in the last fit, leaves more than white noise. The first walks
    through basins in which whole rollouts are stuck; the second sees through events and from afar.
    """
    # standard errors are those of the encoders' noise, of which the errors of what is not there yet are many
    noise = (2.0 * cost / float((batch.weight > 0).sum())) ** 0.5
    options, ends = Options(max_iterations=iterations, tolerance=0.05 * max(noise, 1.0), least_gain=SLOW), []
    last = iterations == FULL
    with suppress(*FAILURES):
        known = None if x0 is None else torch.as_tensor(x0)
        warm = last and known is None
        exact = fit(system, batch, pooled=True, engine=how, options=options, warm=warm, x0=known)[0]
        # behind impacts exact sensitivities tell nothing of the neighbourhood: finite ones are kept
        there = finite_difference_fit(exact.system, batch, engine=exact.engine, iterations=0, x0=exact.x0)
        ends.append(replace(there, status=exact.status, iterations=exact.iterations))
    enough = ends and (autocorrelation(ends[0].residual) < CRITERIA.white if last else ends[0].cost <= cost)
    if not enough:
        ends.append(
            finite_difference_fit(system, batch, engine=how, iterations=iterations, x0=x0, least_gain=SLOW)
        )
    return ends


def _near(iterations: int) -> Options:
    """Settings of a fit to windows.

    Standard errors are those of the encoders' noise, of which the errors are many times here: half of one is little.
    """
    return Options(max_iterations=iterations, tolerance=0.5)


def _within(how: Engine, start: System, batch: Batch, iterations: int) -> FitResult:
    """The fit to windows by exact sensitivities: a model is nearly linear over so short a time."""
    result = fit(start, batch, pooled=True, engine=how, options=_near(iterations), warm=False)[0]
    if not np.isfinite(result.cost):
        raise RuntimeError("the start values diverge")
    return result


def engine() -> Engine:
    """How candidates are simulated: dry friction located in time, by compiled steps where there is a compiler."""
    return Engine(compiled=compiler_works())
