"""From records and the nominal model to a diagnosis: measure, search, freeze, test, report.

The search goes by selection steps, of three stages each: screen and fit (``screen.py``), select (``select.py``).
Train records fit. Train records left out whole, in turn, or validation records where there are some, choose and reject.
The test records are opened once, after the answer is frozen: they measure the gap and change nothing.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from hybrid_id.diagnosis.changes import find_change
from hybrid_id.diagnosis.criteria import CRITERIA
from hybrid_id.diagnosis.details import Details
from hybrid_id.diagnosis.errors_on_test import errors, repeatability, shrink, unconfirmed
from hybrid_id.diagnosis.fits import FULL, WINDOW, Fits, Task, engine, with_priors_of, without_priors
from hybrid_id.diagnosis.grade import (
    Grade,
    behind_play,
    doubtful,
    grade,
    structural_share,
    tied_models,
    tied_sets,
)
from hybrid_id.diagnosis.locate import Location, disturbances, locate
from hybrid_id.diagnosis.model import FittedModel, Name, added_effect
from hybrid_id.diagnosis.next_experiment import Experiment, next_experiment
from hybrid_id.diagnosis.per_record import PerRecord, per_record
from hybrid_id.diagnosis.plausibility import implausible_parameters, not_identifiable, within_reach
from hybrid_id.diagnosis.result import Diagnosis
from hybrid_id.diagnosis.screen import (
    Progress,
    SelectionStep,
    better_ways,
    log_odds,
    named_alike,
    selection_step,
)
from hybrid_id.diagnosis.select import (
    MAX_EFFECTS,
    Selection,
    accepted,
    accepted_ones,
    best_without,
    leaves_something,
    select,
    stopped_after,
)
from hybrid_id.diagnosis.thinning import thinned
from hybrid_id.diagnosis.validation import mean_square
from hybrid_id.errors import InputError
from hybrid_id.identification.fit import make_bounds
from hybrid_id.identification.horizons import Horizon, window_errors
from hybrid_id.identification.keep import Kept
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.quality import beyond, confounded_signals
from hybrid_id.records.skew import Skew, find_skews
from hybrid_id.study.checks import check_identifiability
from hybrid_id.study.replay import batch_of
from hybrid_id.systems.chain import System

LENGTHS = (WINDOW, 2.0 * WINDOW, 4.0 * WINDOW)
"""Lengths [s] of the windows over which structure is looked for where whole runs do not follow the records."""


def diagnose(
    dataset: Dataset,
    system: System,
    *,
    horizon: Horizon | None = None,
    max_effects: int = MAX_EFFECTS,
    jobs: int = 1,
    seed: int = 0,
    level: float = 0.95,
    kept: Kept | None = None,
    progress: Progress | None = None,
) -> Diagnosis:
    """Find out why records and simulator disagree.

    Args:
        dataset: train records, validation records if there are any, and test records.
        system: the nominal model.
        horizon: how long free runs are before they start again from a measured state; None for what the
            records ask for.
        max_effects: effects at most.
        jobs: processes.
        seed: of the resampling.
        level: confidence of the parameters' intervals.
        kept: fits that an earlier run has kept, and where those of this one are kept.
        progress: called with (stage, done, total).

    Ctrl-C during the search ends it with what it has found: ``Diagnosis.interrupted`` says so.

    Raises:
        InputError: no train record, or the nominal model cannot be fitted to them.
        KeyboardInterrupt: stopped before the search has found anything.
    """
    answer = answered(
        dataset, system, horizon=horizon, max_effects=max_effects, jobs=jobs, seed=seed,
        kept=kept, progress=progress,
    )  # fmt: skip
    if progress is not None:
        progress("test records", 0, 1)
    return reported(answer, system, seed=seed, level=level)


def answered(
    dataset: Dataset,
    system: System,
    *,
    horizon: Horizon | None = None,
    max_effects: int = MAX_EFFECTS,
    jobs: int = 1,
    seed: int = 0,
    kept: Kept | None = None,
    progress: Progress | None = None,
) -> Answer:
    """Stages measure to freeze of :func:`diagnose`, whose arguments these are: the test records stay closed.

    Raises:
        InputError: see there.
    """
    if not dataset.train:
        raise InputError(f"dataset '{dataset.name}' has no train record; give at least one the role 'train'.")
    say = progress or (lambda *_: None)
    say("nominal model", 0, 1)
    system = within_reach(system)
    # stage measure: skew taken out of the records, these thinned, and the nominal model re-fitted
    skews = tuple(find_skews(dataset))
    dataset = dataset.without_skew({one.channel: one.late for one in skews})
    fits = Fits(thinned(dataset, system), jobs=jobs, kept=kept)
    fits = fits if horizon is None else fits.over(horizon)
    base = fits.base(system)
    fits, found = search(
        fits,
        base,
        system,
        choose_horizon=horizon is None,
        max_effects=max_effects,
        progress=progress,
    )
    say("location", 0, 1)
    return freeze(dataset, skews, fits, found, system, seed=seed)


@dataclass(frozen=True, eq=False)
class Answer:
    """What the train and validation records say. Frozen: the test records change none of it.

    Of one joint of a robot it is frozen once more where all joints say otherwise.

    Attributes:
        dataset: all records, their channels shifted to one time.
        skews: channels that were recorded late against others.
        fits: holds the records that models were fitted to, thinned where that loses nothing, and their horizon.
        searched: the search.
        found: the same with what is asserted alone, its models fitted to train and validation records.
        grade: shares, probabilities, what remains.
        before, after: torques that would explain what the re-fitted and the chosen model leave, best first.
        structural: share of what the chosen model leaves that has a cause.
        varying: parameters that differ from record to record, in words.
        rejected: effects that were accepted and then were not sure enough to be asserted, ``name at place``, each with
            the record without which it predicts no better (empty where there is none).
        wrong_values: whether the nominal values err clearly more than the re-fitted ones.
        relative_std: smallest relative standard error of what the records identify of the nominal model, where
            nothing is named; 0 elsewhere.
    """

    dataset: Dataset
    skews: tuple[Skew, ...]
    fits: Fits
    searched: Selection
    found: Selection
    grade: Grade
    before: tuple[Location, ...]
    after: tuple[Location, ...]
    structural: float
    varying: tuple[str, ...]
    rejected: Mapping[str, str]
    wrong_values: bool
    relative_std: float

    @property
    def verdict(self) -> str:
        """``effects``, ``outside_catalogue``, ``parameters_only``, ``no_gap`` or ``inconclusive``."""
        base = self.found.base
        if self.found.chosen.effects:
            return "effects"
        if self.found.interrupted:
            return "inconclusive"  # the rest of the catalogue was not tried
        if self.grade.unknown:
            return "outside_catalogue"
        if self.varying:
            return "parameters_only"
        if self.relative_std > CRITERIA.max_relative_std:
            return "inconclusive"  # what identifies no parameter identifies no effect either
        noisy = mean_square(base.result.residual) >= CRITERIA.negligible**2
        if noisy and base.validation.effective < CRITERIA.too_few:
            return "inconclusive"
        return "parameters_only" if self.wrong_values else "no_gap"


def search(
    fits: Fits,
    base: FittedModel,
    system: System,
    *,
    choose_horizon: bool = True,
    max_effects: int = MAX_EFFECTS,
    progress: Progress | None = None,
) -> tuple[Fits, Selection]:
    """Stages screen, fit and select: the horizon, and the effects that the train records call for.

    Models are fitted and compared by free runs over whole records, where these follow them with the best effect and
    leave no structure. Otherwise it is done over windows, where these say more of what is missing
    (:func:`_over_short`), and goes on over whole records, where these confirm the effects found over windows: a slow
    effect shows there alone. Where the best effect still leaves some and each record's own values of the nominal model
    leave none, records differ and no effect is missing.

    Args:
        fits: fits models to the train records.
        base: the nominal model, re-fitted over the horizon of ``fits``.
        system: the nominal model.
        choose_horizon: whether the records choose the horizon; otherwise it is that of ``fits``.
        max_effects: effects at most.
        progress: called with (stage, done, total).

    Returns:
        Fits over the horizon of the search, and its result.
    """
    best, first, whole = base, None, None
    if not leaves_something(base):
        return fits, Selection(base, (), base, horizon=fits.horizon)
    try:
        if choose_horizon:
            if fits.astray(base) <= CRITERIA.lost_refit:
                first = selection_step(fits, base, system, progress=progress)
                best = min((e for e in (base, *first.candidates) if e.judged), key=lambda e: e.error)
                if not best.no_structure and (own := _differing(fits, base, system)) is not None:
                    return fits, Selection(base, (first,), base, own=own, horizon=fits.horizon)
            if _adds_up(fits, base, best, system):
                short = _short_runs(fits, system)
                step = short and _over_short(short, fits, first, best, system, progress)
                if short and step:
                    whole = None if first is None else (fits, base, first)
                    (fits, base), first = short, step
    except KeyboardInterrupt:
        if first is None:
            raise
        return fits, stopped_after(first, base, fits.horizon)
    found = select(fits, base, system, first=first, max_effects=max_effects, progress=progress)
    if found.interrupted:
        return fits, found
    try:
        more = None if whole is None else _along_whole(*whole, found, system, max_effects, progress)
    except KeyboardInterrupt:
        return fits, replace(found, interrupted=True)
    return (fits, found) if whole is None or more is None else (whole[0], more)


def _along_whole(
    fits: Fits,
    base: FittedModel,
    first: SelectionStep,
    near: Selection,
    system: System,
    max_effects: int,
    progress: Progress | None,
) -> Selection | None:
    """The search gone on over whole records beside the effects found over short runs; None where it cannot.

    What is fast shows over short runs, what is slow along whole ones, and most machines lack both. It goes on only
    where whole records confirm these effects.
    """
    if not near.chosen.effects:
        return None
    start = with_priors_of(near.chosen.system, base.system)
    free = without_priors(start, system)
    ways = [Task(near.chosen.effects, start)]
    if free.table != start.table:
        ways.append(Task(near.chosen.effects, free))
    model = next(iter(better_ways([near.chosen] * len(ways), fits.run(ways, FULL))), None)
    if model is None or not accepted(model, base):
        return None
    found = select(fits, base, system, start=model, max_effects=max_effects, progress=progress)
    return replace(found, steps=(first, *found.steps), near=near)


def _adds_up(fits: Fits, base: FittedModel, best: FittedModel, system: System) -> bool:
    """Whether what the best model lacks adds up along its free runs, so that shorter ones are asked for.

    Not within a few noises, and not where each record's own values explain the structure that is left.
    """
    if best is not base and best.trained <= CRITERIA.followed**2:
        return False
    if fits.astray(best) > CRITERIA.lost:
        return True
    return not (best.no_structure or (best is not base and _differing(fits, best, system) is not None))


def _short_runs(fits: Fits, system: System) -> tuple[Fits, FittedModel] | None:
    """The shortest free runs over which the re-fitted nominal model leaves structure, and that model; None without any.

    There are most of them, and each is a witness of its own of what is missing: along a run what a model lacks adds up
    to few errors that go together, in which unlike explanations look alike.
    """
    for seconds in LENGTHS:
        pieces = fits.over(Horizon("windows", seconds, "what is missing adds up along whole ones"))
        start = pieces.base(system)
        if not start.no_structure and mean_square(start.result.residual) >= CRITERIA.negligible**2:
            return pieces, start
    return None


def _over_short(
    short: tuple[Fits, FittedModel],
    fits: Fits,
    first: SelectionStep | None,
    best: FittedModel,
    system: System,
    progress: Progress | None,
) -> SelectionStep | None:
    """The first step over short runs, where these say more of what is missing than whole ones, if any; else None.

    Short runs are surer than whole ones of which effect it is, of those that explain the greater part over whole ones.
    Or no effect follows the whole records, or none is accepted there, so that nothing they say of any counts, and one
    explains next to all that short runs show: a fit over whole records may be stuck far from what it would explain.

    Args:
        short: fits over short runs, and the re-fitted model there.
        fits: over whole records.
        first: the step there; None where the re-fitted model has lost them.
        best: the model that predicts best there.
        system: the nominal model.
        progress: called with (stage, done, total).
    """
    if first is None:
        return selection_step(*short, system, progress=progress)
    # The effects that explain the greater part of what any of them does. What shows over shorter runs alone is a
    # smaller effect: a slow one shows along whole runs, and may be most of the gap.
    most = min((e.trained for e in first.candidates), default=0.0)
    least = first.before.trained - CRITERIA.major_share * (first.before.trained - most)
    rivals = frozenset(added_effect(e, first.before) for e in first.candidates if e.trained <= least)
    step = None
    if fits.astray(best) > CRITERIA.lost or not accepted_ones(first):
        step = selection_step(*short, system, progress=progress)
        if accepted_ones(step) and _left(step) < CRITERIA.left_open * _left(first):
            return step
    if step is None or rivals:
        step = selection_step(*short, system, among=rivals or None, progress=progress)
    return step if _rivalry(step) < _rivalry(first) else None


def _left(step: SelectionStep) -> float:
    """Share of the simpler model's mean square that the best candidate leaves, on records left out."""
    best = min((e.error for e in step.candidates if e.judged), default=step.before.error)
    return best / max(step.before.error, 1e-300)


def _rivalry(step: SelectionStep) -> float:
    """Log-odds of the strongest rival of the effect that leads a step, at whatever place; of none without any.

    Infinite where no effect is accepted.
    """
    best = next(iter(accepted_ones(step)), None)
    if best is None:
        return math.inf
    rivals = (e for e in step.candidates if e.judged and named_alike(e) != named_alike(best))
    return max((log_odds(best, e, step.before) for e in rivals), default=-math.inf)


def _differing(fits: Fits, model: FittedModel, system: System) -> PerRecord | None:
    """Each record's own values of a model, where they leave noise alone: the records differ, and nothing is missing."""
    own = per_record(fits, model, system)
    return own if own is not None and own.explained else None


def freeze(
    dataset: Dataset, skews: tuple[Skew, ...], fits: Fits, found: Selection, system: System, *, seed: int = 0
) -> Answer:
    """Freeze the answer, once all that is selected is sure enough to be asserted.

    Of one joint of a robot, only what all of its joints say may change it again (:func:`frozen_again`).

    :func:`locate` comes first, for the structural share of what remains depends on it; :func:`grade` divides the gap.
    The last effect that is not sure enough is dropped, and both are done again for the rest.
    """
    searched, before = found, tuple(locate(fits, found.base))
    rejected = {_in_words(name): "" for name in found.refuted}
    while True:
        chosen = found.chosen
        after = before if chosen is found.base else tuple(locate(fits, chosen))
        structural = structural_share(chosen, after)
        own = (found.own or per_record(fits, chosen, system)) if structural > CRITERIA.coloured else None
        if own is not None:
            structural = 0.0 if own.explained else structural_share(chosen, after, own.autocorrelation)
            found = replace(found, chosen=own.model, base=found.base if own.model.effects else own.model)
        varying = () if own is None else own.varying
        graded = grade(fits, found, structural, seed=seed)
        unsure = doubtful(graded)
        if not unsure:
            break
        name = unsure[-1]
        rest = best_without(fits, found.base, chosen, name, found.steps) or found.base
        # the record without which the model predicts no better than the simpler one; empty where there is none
        record = None
        if found.chosen.judged and rest.judged:
            record = found.chosen.validation.rests_on(rest.validation)
        judging = fits.dataset.validation or fits.dataset.train
        rejected[_in_words(name)] = "" if record is None else judging[record].name
        found = replace(found, chosen=rest, unsure=(*found.unsure, name))
    nothing = not found.chosen.effects and not graded.unknown and not varying
    identified = check_identifiability(fits.dataset, system) if nothing else None
    std = 0.0 if identified is None else float(min(identified.combination_std, default=np.inf))
    if fits.dataset.validation:  # fitted once more, to train and validation records together
        models = [found.base] if found.chosen is found.base else [found.base, found.chosen]
        ends = fits.on_all().run([Task(e.effects, e.system) for e in models], FULL)
        ends = [end or e for end, e in zip(ends, models, strict=True)]
        found = replace(found, base=ends[0], chosen=ends[-1])
    found = _unheld(found, system)
    # whether the nominal values err clearly more on the train records than the re-fitted ones
    both = [
        errors(
            fits.dataset,
            one,
            engine(),
            fits.dataset.train,
            horizon=fits.horizon,
        )
        for one in (system, found.base.system)
    ]
    nominal, refit = both
    wrong = nominal is not None and refit is not None and nominal.nrmse >= CRITERIA.wrong_values * refit.nrmse
    return Answer(
        dataset,
        skews,
        fits,
        searched,
        found,
        graded,
        before,
        after,
        structural,
        varying,
        rejected,
        wrong,
        std,
    )


def frozen_again(answer: Answer, searched: Selection, system: System, *, seed: int = 0) -> Answer:
    """A joint's answer frozen once more, by a search that the whole robot has changed; what was rejected stays so.

    But for what the robot has chosen instead.
    """
    unsure = tuple(name for name in answer.found.unsure if name not in searched.chosen.effects)
    searched = replace(searched, unsure=unsure)
    again = freeze(answer.dataset, answer.skews, answer.fits, searched, system, seed=seed)
    chosen = [_in_words(name) for name in again.found.chosen.effects]
    words = {**answer.rejected, **again.rejected}
    return replace(again, rejected={one: record for one, record in words.items() if one not in chosen})


def _in_words(name: Name) -> str:
    """An effect and its place."""
    return f"{name[0]} at {name[1]}"


def _unheld(found: Selection, nominal: System) -> Selection:
    """The models without the priors that held their parameters during the search, which nobody has given."""

    def free(model: FittedModel) -> FittedModel:
        system = without_priors(model.system, nominal)
        precision = make_bounds(system, system.estimated).prior_precision.numpy()
        return replace(model, result=replace(model.result, system=system, prior_precision=precision))

    base = free(found.base)
    return replace(found, base=base, chosen=base if found.chosen is found.base else free(found.chosen))


def reported(answer: Answer, system: System, *, seed: int = 0, level: float = 0.95) -> Diagnosis:
    """Stages test and report of :func:`diagnose`: all that a diagnosis shows and writes, in one object.

    The test records are opened once, to measure the gap before and after over the horizon of the fits.
    """
    dataset, found, graded, fits = answer.dataset, answer.found, answer.grade, answer.fits
    base, chosen = found.base, found.chosen
    models = ((system, engine()), (base.system, base.result.engine), (chosen.system, chosen.result.engine))
    nominal, first, last = (errors(dataset, one, how, horizon=fits.horizon) for one, how in models)
    gap, contradiction, differs = None, "", False
    if nominal is None or first is None or last is None:
        nominal = first = last = None
    else:
        coloured, play = last.autocorrelation > CRITERIA.coloured, behind_play(chosen)
        left = last.autocorrelation if coloured or play else answer.structural
        again = repeatability(dataset) if fits.whole else None
        rest = last.nrmse * float(np.sqrt(1.0 - min(left, 1.0)))
        floor = min(max(last.noise, rest if again is None else again), last.nrmse)
        gap = replace(shrink(first, last, floor, seed=seed), repeated=again is not None)
        # Whether free runs over them are lost at other rest positions, although the model is right about them: by
        # windows that begin at measured states, where it leaves next to nothing of what the re-fitted model leaves.
        if fits.whole and coloured and chosen.effects and not play:
            squares = []
            for model in (base.system, chosen.system):
                batch = batch_of(fits.dataset, model, fits.dataset.test)
                windows = window_errors(model, engine(), batch, WINDOW)
                squares.append(sum(float(np.square(one).sum()) for one in windows))
            differs = 0.0 < squares[1] < CRITERIA.left_open * squares[0]
        if not differs:
            contradiction = unconfirmed(gap, "model") if chosen.effects else ""
            quiet = chosen.autocorrelation <= CRITERIA.coloured
            least = max(np.sqrt(mean_square(chosen.result.residual)), CRITERIA.negligible)
            if not contradiction and quiet and coloured and last.over_noise > 2.0 * least:
                contradiction = (
                    "The test records show what no train record shows: give one of them the role 'train' and diagnose "
                    "again."
                )
    # Which physical change explains the new values. Beside effects, or where something unknown remains, only a load:
    # these change friction, and what scales everything, themselves.
    changes, alone = "", answer.verdict == "parameters_only"
    if not chosen.result.left_early and (answer.wrong_values or alone):
        change = find_change(system, chosen.result)
        changes = change.words if alone or "load" in (change.together or (change.name,)) else ""
    # what to record next; nothing where a model cannot be simulated so: a proposal must not cost the answer
    experiments = list[Experiment]()
    fine, coarse = dataset.sample_time, fits.dataset.sample_time
    with suppress(RuntimeError, InputError, np.linalg.LinAlgError):
        experiments = next_experiment(
            dataset,
            tied_models(found),
            fits.horizon if found.near is None else found.near.horizon,
            thinned=coarse / fine if fine and coarse else 1.0,
        )
    substantial = graded.unknown or graded.remainder >= CRITERIA.substantial
    named_joint = bool(chosen.effects) and len(system.joints) > 1
    odd = bool(implausible_parameters(system, base.system))
    identified = check_identifiability(dataset, system) if odd else None
    return Diagnosis(
        case=dataset.name,
        verdict=answer.verdict,
        effects=graded.effects,
        ties=tuple(tied_sets(graded.effects)),
        unknown=graded.unknown and not found.interrupted,
        remainder=graded.remainder,
        remainder_interval=graded.remainder_interval,
        beyond_floor=graded.beyond_floor,
        horizon=fits.horizon,
        sample_time=fits.dataset.sample_time,
        nominal=nominal,
        refit=first,
        with_effect=last,
        shrink=gap,
        contradiction=contradiction,
        rest_differs=differs,
        location=answer.before,
        residual_after=answer.after,
        implausible=tuple(implausible_parameters(system, base.system, identified)),
        experiments=tuple(experiments),
        rejected=answer.rejected,
        varying=answer.varying,
        not_identifiable=not_identifiable(dataset, chosen.system),
        confounded=tuple(confounded_signals(dataset.records)),
        extrapolation=tuple(beyond(dataset)),
        disturbances=tuple(disturbances(fits, chosen)) if substantial else (),
        disturbances_before=tuple(disturbances(fits, base)) if named_joint else (),
        relative_std=answer.relative_std,
        changes=changes,
        skews=tuple(one.message for one in answer.skews),
        tally=copy.deepcopy(fits.tally),  # details that are asked for later count nowhere
        search=found,
        details=Details(fits, system, found.fitted, answer.before, last, seed=seed, level=level),
    )
