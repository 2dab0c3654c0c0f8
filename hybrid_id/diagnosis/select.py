"""Which effects: forward selection with swaps and backward elimination.

The effect that predicts records left out best is added, of equals the simplest or most probable; then the next beside
it; then those that had explained as much as the first are tried in its place, and each of the selected has to show that
the rest cannot do without it. Before an effect is accepted, the model without it is fitted again from where the model
with it has ended.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace

from hybrid_id.diagnosis.catalogue import CATALOGUE, over_angle, with_further
from hybrid_id.diagnosis.criteria import CRITERIA
from hybrid_id.diagnosis.fits import FINER, FULL, Fits, Task
from hybrid_id.diagnosis.model import FittedModel, Name, added_effect
from hybrid_id.diagnosis.per_record import PerRecord
from hybrid_id.diagnosis.periodic import Residual
from hybrid_id.diagnosis.screen import (
    FINALISTS,
    HOPELESS,
    SAME,
    Progress,
    SelectionStep,
    Shown,
    by_prediction,
    needed_fall,
    promising,
    selection_step,
    simplest_first,
)
from hybrid_id.diagnosis.starts import swapped, without
from hybrid_id.diagnosis.validation import mean_square, p_values
from hybrid_id.identification.horizons import WHOLE, Horizon
from hybrid_id.systems.chain import System

MAX_EFFECTS = 3
"""Effects at once."""
MAX_STEPS = 6
"""Steps of a selection, in which effects that have made others needless may take their place."""


@dataclass(frozen=True, eq=False)
class Selection:
    """Result of the search.

    Attributes:
        base: the nominal model, re-fitted.
        steps: the selection steps; the first says what each effect explains alone.
        chosen: the model that the search ends with; ``base`` where no effect is accepted.
        interrupted: whether the search was stopped before its end.
        own: each record's own values of the nominal model, where they explain all that any effect does, and more.
        near: the search over short runs that this one, over whole records, has gone on from.
        horizon: how long free runs of its fits are.
        refuted: effects that were accepted and take nothing of what each record's own values leave.
        unsure: effects that were accepted and are not sure enough to be asserted.
    """

    base: FittedModel
    steps: tuple[SelectionStep, ...]
    chosen: FittedModel
    interrupted: bool = False
    own: PerRecord | None = None
    near: Selection | None = None
    refuted: tuple[Name, ...] = ()
    unsure: tuple[Name, ...] = ()
    horizon: Horizon = WHOLE

    @property
    def compared(self) -> tuple[SelectionStep, ...]:
        """The steps that say how probable effects are: short runs, if any, tell the first from its rivals."""
        return self.steps if self.near is None else (*self.near.steps, *self.steps[1:])

    @property
    def shown(self) -> dict[Name, Shown]:
        """What joints of a robot together say of effects that act on all of them."""
        steps = ((step.shown, step.leader, step.before) for step in self.steps)
        return {added_effect(one, before): shown for shown, one, before in steps if shown and one is not None}

    @property
    def fitted(self) -> dict[str, FittedModel]:
        """The models that the search stands by: ``re-fitted``, and ``corrected`` where that is another one."""
        return {"re-fitted": self.base} | ({} if self.chosen is self.base else {"corrected": self.chosen})


def select(
    fits: Fits,
    base: FittedModel,
    nominal: System,
    *,
    start: FittedModel | None = None,
    first: SelectionStep | None = None,
    max_effects: int = MAX_EFFECTS,
    progress: Progress | None = None,
) -> Selection:
    """Stage select: search the catalogue, step by step, for the effects that the train records call for.

    Stopped by Ctrl-C once a step has ended, it says what it has found until then.

    Args:
        fits: fits models to the train records, over its horizon.
        base: the nominal model, re-fitted over that horizon.
        nominal: the nominal system.
        start: the model that the search begins with; None for ``base``.
        first: the first step, where it has been taken.
        max_effects: effects at most.
        progress: called with (stage, done, total).

    Raises:
        KeyboardInterrupt: stopped before the end of its first step.
    """
    so_far = _SoFar(base, start or base, [])
    try:
        # the search of :func:`select`; so_far takes each step and each model as soon as it is there
        steps, restarted = so_far.steps, False
        while (
            len(so_far.model.effects) < max_effects
            and sum(not one.swap for one in steps) < MAX_STEPS
            and leaves_something(so_far.model)
        ):
            model = so_far.model
            step = first or selection_step(
                fits, model, nominal, among=_alive(steps, model), progress=progress
            )
            first = None
            step = so_far.asked = _accepted_first(step)
            steps.append(step)
            best, swaps = step.leader, list[SelectionStep]()
            if best is not None and model.effects and promising(best, model):
                # each earlier effect against those that explained as much as it did when it stood alone, now beside the
                # others
                swaps = []
                for one in steps:
                    name = None if one.swap or one.leader is None else added_effect(one.leader, one.before)
                    if name not in best.effects or one.leader is None or one.leader.effects == best.effects:
                        continue
                    rest = without(best.system, so_far.base.system, name)
                    if rest is None:
                        continue
                    near = one.leader.error / (1.0 - CRITERIA.distinct_fall)
                    rivals = [e for e in one.candidates[1:] if e.judged and e.error < near][:FINALISTS]
                    tasks = swapped(rest, tuple(e for e in best.effects if e != name), rivals, one.before)
                    ends = sorted((e for e in fits.run(tasks, FULL) if e is not None), key=lambda e: e.error)
                    alone = refitted_without(fits, so_far.base, best, name) if ends else None
                    if alone is not None:
                        ranked = sorted((*ends, best), key=lambda e: e.error)
                        if ranked[0].no_structure:
                            # of equals the one that was found first leads
                            better = ranked[0].validation.fall(best.validation) > CRITERIA.least_fall
                            leading = ranked[0] if better else best
                        else:
                            leading = simplest_first(ranked, alone)[0]
                        swaps.append(
                            SelectionStep(
                                alone, (leading, *(e for e in ranked if e is not leading)), swap=True
                            )
                        )
                best = min(
                    (s.leader for s in swaps if s.leader is not None), key=lambda e: e.error, default=best
                )
            if best is None or not accepted(best, model, step.candidates):
                break
            # the model that a step has begun with, fitted again from where the best with one more effect has ended
            if not set(model.effects) < set(best.effects):
                before = model
            else:
                again = refitted_without(fits, so_far.base, best, added_effect(best, model), known=model)
                before = again if again is not None and again.error < model.error else model
            so_far.base = so_far.base if before.effects else before
            steps[:] = [*(_with_fit(one, before) for one in steps[:-1]), replace(step, before=before)]
            if not accepted(best, before, step.candidates):
                so_far.model, so_far.asked = before, None
                if before is model or restarted:
                    break
                restarted = True  # the fit before had not found its best: the step is repeated from there
                so_far.repeated = [steps.pop()]
                continue
            steps += swaps
            so_far.model, so_far.asked = best, None
            so_far.model = _freed(fits, _with_whole_numbers(fits, best))
            if before.effects:
                so_far.model = _necessary(fits, so_far.base, so_far.model, steps)
                steps[:] = [_with_fit(one, so_far.model) for one in steps]
                if len(so_far.model.effects) <= len(before.effects) and not (
                    so_far.model.error < before.error
                    and bool(so_far.model.effects)
                    and so_far.model.effects != before.effects
                ):
                    break
        so_far.asked = None
    except KeyboardInterrupt:
        so_far.steps = so_far.steps or so_far.repeated
        if not so_far.steps:
            raise
        return so_far.selection(fits.horizon, interrupted=True)
    return so_far.selection(fits.horizon)


@dataclass
class _SoFar:
    """What a search has found so far.

    Attributes:
        base: the nominal model, re-fitted.
        model: the model that it has come to.
        steps: the selection steps.
        asked: the last step, as long as nothing is decided of it.
        repeated: a step that is being repeated, from where the model before it has been fitted again.
    """

    base: FittedModel
    model: FittedModel
    steps: list[SelectionStep]
    asked: SelectionStep | None = None
    repeated: list[SelectionStep] = field(default_factory=list)

    def selection(self, horizon: Horizon, *, interrupted: bool = False) -> Selection:
        """The result of the search; what leads a step that nothing is decided of yet counts where it is accepted."""
        model, step = self.model, self.asked
        if (
            step is not None
            and step.leader is not None
            and accepted(step.leader, step.before, step.candidates)
        ):
            model = step.leader
        base = self.base if model.effects else model
        return Selection(base, tuple(self.steps), model, interrupted=interrupted, horizon=horizon)


def stopped_after(step: SelectionStep, base: FittedModel, horizon: Horizon) -> Selection:
    """What a search has found that was stopped after its first step."""
    step = _accepted_first(step)
    return _SoFar(base, base, [step], step).selection(horizon, interrupted=True)


def _accepted_first(step: SelectionStep) -> SelectionStep:
    """The step led by the best candidate that is accepted; as it was where none is."""
    passing = accepted_ones(step)
    if not passing or passing[0] is step.candidates[0]:
        return step
    return replace(step, candidates=(passing[0], *(e for e in step.candidates if e is not passing[0])))


def accepted(richer: FittedModel, simpler: FittedModel, rivals: Collection[FittedModel] = ()) -> bool:
    """Whether a richer model predicts records left out clearly better: by enough, and more than by chance.

    Args:
        richer: with more effects.
        simpler: with fewer.
        rivals: all candidates among which the richer one has been found.
    """
    # what has not been fitted to the end has seen the records that would judge it
    return richer.judged and passes(richer, simpler, chance(richer, simpler, rivals))


def passes(richer: FittedModel, simpler: FittedModel, p: float) -> bool:
    """Whether a fall of the error on records left out is large enough and no chance's.

    Where the simpler model leaves structure, that something is missing is plain, and the question is what.
    """
    level = CRITERIA.false_alarms if simpler.no_structure else CRITERIA.wrong_names
    return p <= level and richer.validation.fall(simpler.validation) >= needed_fall(richer, simpler)


def accepted_ones(step: SelectionStep) -> list[FittedModel]:
    """The candidates of a step that are accepted, in its order: one draw of chance serves them all."""
    return [e for e, p in chances(step).items() if passes(e, step.before, p)]


def chances(step: SelectionStep) -> dict[FittedModel, float]:
    """Of each finished candidate, the probability that the best of all would predict so much better by chance."""
    ends = [e for e in step.candidates if e.judged]
    found = p_values([e.validation for e in ends], step.before.validation)
    return dict(zip(ends, found.tolist(), strict=True))


def chance(richer: FittedModel, simpler: FittedModel, rivals: Collection[FittedModel] = ()) -> float:
    """Probability that the best of all candidates would predict so much better by chance."""
    others = [e for e in rivals if e is not richer and e.judged]
    return float(p_values([e.validation for e in (richer, *others)], simpler.validation)[0])


def judged_fits(steps: Sequence[SelectionStep], effects: tuple[Name, ...]) -> list[FittedModel]:
    """Fits of a set of effects that steps have fitted to the end and judged."""
    return [e for s in steps for e in (s.before, *s.candidates) if e.effects == effects and e.judged]


def best_without(
    fits: Fits, base: FittedModel, richer: FittedModel, name: Name, steps: Sequence[SelectionStep]
) -> FittedModel | None:
    """A model less one of its effects, no worse than steps of a search have fitted it; None where it cannot be fitted.

    The others have ended elsewhere than before they had each other: the rest may do better from there.
    """
    if len(richer.effects) == 1:
        return base
    ends = judged_fits(steps, tuple(e for e in richer.effects if e != name))
    known = min(ends, key=lambda e: e.trained, default=None)
    again = refitted_without(fits, base, richer, name, known=known)
    return min((e for e in (*ends, again) if e is not None), key=lambda e: e.error, default=None)


def refitted_without(
    fits: Fits, base: FittedModel, richer: FittedModel, name: Name, *, known: FittedModel | None = None
) -> FittedModel | None:
    """A model less one of its effects, fitted from where it stands; None where that cannot be fitted.

    ``known``, if there is any, is the judged fit with the same effects that errs least on its own records: it is taken
    where the new one does not err less there.
    """
    start = without(richer.system, base.system, name)
    rest = tuple(effect for effect in richer.effects if effect != name)
    found = None if start is None else fits.run([Task(rest, start)], FINER)[0]
    if found is None or (known is not None and found.trained > HOPELESS * max(richer.trained, base.trained)):
        return known
    below = math.inf if known is None else (1.0 - SAME) * known.trained
    if known is not None and below <= found.trained <= known.trained / (1.0 - SAME):
        return known
    end = fits.run([Task(rest, found.system, judged_below=below)], FULL)[0]
    return known if end is None or not end.judged else end


def _freed(fits: Fits, chosen: FittedModel) -> FittedModel:
    """The model with what an effect's law leaves open freed too, where that predicts clearly better.

    Before another effect may explain what the first one's simplest form has left.
    """
    if not over_angle(chosen.effects):  # only their laws leave anything open, further waves
        return chosen
    left = Residual(chosen.result, fits.records(chosen.system))
    starts = [
        start
        for name, where in chosen.effects
        for start in with_further(CATALOGUE[name], chosen.system, where, left)
    ]
    for one in fits.run([Task(chosen.effects, start) for start in starts], FULL):
        enough = one is not None and one.validation.fall(chosen.validation) >= CRITERIA.least_fall
        if one is not None and enough and chance(one, chosen) <= CRITERIA.false_alarms:
            chosen = one
    return chosen


def _with_whole_numbers(fits: Fits, chosen: FittedModel) -> FittedModel:
    """The model with periods per turn of a motor held at whole numbers, where it predicts as well (parsimony)."""
    whole = {
        (f"{where}/{kind}", symbol)
        for name, where in chosen.effects
        for kind in CATALOGUE[name].kinds
        for symbol in CATALOGUE[name].whole
    }
    if not whole:
        return chosen
    near = {}
    for info in chosen.system.table:
        if info.spec.estimate and (info.component, info.symbol) in whole:
            # a start is bounded to its own ripple, whose whole number may be the next one
            number = min(max(round(info.spec.value), math.ceil(info.spec.lower), 1), info.spec.upper)
            near[info.name] = replace(info.spec, value=float(number), estimate=False)
    if any(not spec.value.is_integer() for spec in near.values()):
        return chosen
    one = fits.run([Task(chosen.effects, chosen.system.with_specs(near))], FULL)[0]
    return (
        one if one is not None and one.validation.fall(chosen.validation) > -CRITERIA.least_fall else chosen
    )


def _with_fit(step: SelectionStep, model: FittedModel) -> SelectionStep:
    """A step in which a candidate has ended where the search has come to since by another way, if clearly better.

    Else the odds would be those of a fit that has failed, be it without one record alone, so that it need not be sure.
    """
    known = next((e for e in step.candidates if e.effects == model.effects), None)
    if known is None or step.swap or not model.judged:
        return step
    if known.judged and model.error >= (1.0 - CRITERIA.distinct_fall) * known.error:
        return step
    ends = sorted((model if e is known else e for e in step.candidates), key=by_prediction)
    return _accepted_first(replace(step, candidates=tuple(simplest_first(ends, step.before))))


def leaves_something(model: FittedModel) -> bool:
    """Whether another effect could be accepted at all.

    It could not where errors are far below the noise, or are white noise: what an effect takes neighbouring samples
    have in common, unless it changes from one sample to the next, and it has to take enough.
    """
    if mean_square(model.result.residual) < CRITERIA.negligible**2:
        return False
    return model.autocorrelation >= (CRITERIA.completing_fall if model.effects else CRITERIA.least_fall)


def _alive(steps: Sequence[SelectionStep], model: FittedModel) -> frozenset[Name] | None:
    """Effects that are worth a fit beside two others: those that have brought anything beside one of them.

    None for all of the catalogue.
    """
    last = next((one for one in reversed(steps) if one.before.effects and not one.swap), None)
    if last is None or len(model.effects) <= len(last.before.effects):
        return None
    alive = (e for e in last.candidates if e.result.cost < CRITERIA.retry_cost * last.before.result.cost)
    return frozenset(added_effect(e, last.before) for e in alive)


def _necessary(
    fits: Fits, base: FittedModel, chosen: FittedModel, steps: Sequence[SelectionStep]
) -> FittedModel:
    """Drop what the others have made needless: of several such effects the one whose loss costs least."""
    enough = []
    for name in chosen.effects:
        simpler = best_without(fits, base, chosen, name, steps)
        if simpler is not None and not accepted(chosen, simpler):
            enough.append(simpler)
    return min(enough, key=lambda e: e.error, default=chosen)
