"""From records and today's model to a diagnosis: search, test records, what they bear out."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from hybrid_id.diagnosis.arbiter import decide, others
from hybrid_id.diagnosis.attribute import MOST, Attribution, Progress, attribute, sure_though_small
from hybrid_id.diagnosis.bent import bent_parameters
from hybrid_id.diagnosis.course import courses
from hybrid_id.diagnosis.evidence import COLOURED, negligible
from hybrid_id.diagnosis.explanation import Explanation
from hybrid_id.diagnosis.judged import Judge
from hybrid_id.diagnosis.measure import Errors, errors
from hybrid_id.diagnosis.next_experiment import next_experiment
from hybrid_id.diagnosis.own_sets import own_sets
from hybrid_id.diagnosis.probability import believed, suspects, tied_explanations, tied_sets
from hybrid_id.diagnosis.ranking import LEFT_OPEN
from hybrid_id.diagnosis.refit import Refit, engine
from hybrid_id.diagnosis.remainder import worst_unseen
from hybrid_id.diagnosis.result import Diagnosis
from hybrid_id.diagnosis.untold import untold
from hybrid_id.errors import InputError
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.facts import inseparable
from hybrid_id.records.reach import beyond
from hybrid_id.simulation.prepare import SIGNAL_SHARE
from hybrid_id.study.identifiable import preflight
from hybrid_id.systems.chain import System

PARAMETRIC = 1.1
"""Ratio of nominal to re-fitted error from which the parameters were wrong."""
VAGUE = 0.1
"""Least standard error, relative, of what records tell of a model's parameters, from which an effect hides in them."""
TOO_SHORT = 30.0
"""Independent samples below which no structure can be told."""


def diagnose(
    dataset: Dataset,
    system: System,
    *,
    most: int = MOST,
    jobs: int = 1,
    seed: int = 0,
    signal_share: float = SIGNAL_SHARE,
    progress: Progress | None = None,
) -> Diagnosis:
    """Find out why records and simulator disagree.

    Search and fits use the train records; the test records measure the gap, and decide between effects that explain the
    train records alike. Effects whose gain on them may as well be none (95 % interval) are withdrawn, and others are
    searched for in their place; one that is sure but small on the train records is believed where it explains what the
    test records leave open. Where the test records alone show something that no effect explains, the worst of them
    joins the train records: what explains it there has to explain the others, or to leave them as they are where they
    lack nothing. What is left is no effect where each record's own parameters explain all of it.

    Args:
        dataset: train and test records.
        system: today's model.
        most: effects at most.
        jobs: processes.
        seed: of the resampling.
        signal_share: see :func:`hybrid_id.simulation.prepare.make_batch`.
        progress: called with (stage, done, total).

    Raises:
        InputError: no train record, or today's model cannot be fitted to them.
    """
    if not dataset.train:
        raise InputError(f"dataset '{dataset.name}' has no train record; give at least one the role 'train'.")
    search = partial(
        _diagnosed,
        system=system,
        most=most,
        jobs=jobs,
        seed=seed,
        signal_share=signal_share,
        progress=progress,
    )
    found = search(dataset)
    worst = worst_unseen(found.search.chosen, found.with_effect, found.unknown)
    if worst is None or found.halted:
        return found
    seen = (replace(r, role="train") if r.name == worst else r for r in dataset.records)
    again = search(replace(dataset, records=tuple(seen)), whole=found.refit)
    more = found.unknown or set(found.search.chosen.effects) < set(again.search.chosen.effects)
    return replace(again, opened=worst) if again.verdict == "effects" and more else found


def _diagnosed(
    dataset: Dataset,
    *,
    system: System,
    most: int,
    jobs: int,
    seed: int,
    signal_share: float,
    progress: Progress | None,
    whole: Errors | None = None,
) -> Diagnosis:
    """Search on the train records, judged by the test records; ``whole``: see :class:`Judge`."""
    refit = Refit(dataset, jobs=jobs, signal_share=signal_share)
    say = progress or (lambda *_: None)
    say("today's model", 0, 1)
    decision = decide(refit, attribute(refit, system, most=most, progress=progress))
    search = decision.search
    base, withdrawn = search.base, ()
    say("location", 0, 1)
    judged = Judge(refit, base, whole, seed)
    now = judged(search)
    # where the other test records lack nothing, it is enough that an effect does them no harm
    silent = whole is not None and judged.first is not None and judged.first.coloured <= COLOURED
    refused = now.gap is not None and not now.halted and now.gap.interval[silent] <= 0.0
    if search.chosen is not base and refused:
        called_for, now = search.chosen.effects, judged(replace(search, chosen=base))
        for other in others(refit, system, decision, most=most, progress=progress):
            instead = judged(other.search)
            if instead.borne_out:
                decision, now = other, instead
                break
        withdrawn = tuple(name for name in called_for if name not in now.search.chosen.effects)
    if now.unknown and (small := sure_though_small(now.search)) is not None:
        added = judged(small)
        if not added.unknown and added.borne_out:
            now = added
    own = own_sets(refit, now.search.chosen, system) if now.unknown else None
    if own is not None and own.common.effects and own.common is now.search.chosen and not own.varying:
        own = None  # a wrong formula, too, explains each record by values of its own; they have to differ surely
    varying = () if own is None else own.varying
    if own is not None:
        if not own.common.effects:
            base = own.common
            # where nothing varies, the common fit had not found its end: that from one record's values is the re-fit
            if not own.varying:
                judged = Judge(refit, base, whole, seed)
                now = replace(now, search=replace(now.search, base=base))
        same = own.common is now.search.chosen
        now = replace(now if same else judged(replace(now.search, chosen=own.common)), unknown=False)
    if now.unknown and now.gap is not None and now.search.chosen.effects and now.gap.share < LEFT_OPEN:
        # beside what the catalogue lacks, what closes next to nothing is not worth a name
        withdrawn, now = (*withdrawn, *now.search.chosen.effects), judged(replace(now.search, chosen=base))
    gap = replace(now.gap, share=0.0, interval=(0.0, 1.0)) if silent and now.gap is not None else now.gap
    search = now.search
    found = tuple(
        believed(decision.weighed(suspects(search)), bool(varying), now.left if now.unknown else 0.0)
    )
    nothing = search.chosen is base and not now.unknown and not varying
    # what these records tell of today's model is asked only where something hangs on it
    told = preflight(dataset, system) if nothing or bent_parameters(system, base.system) else None
    vague = float(min(told.combination_std, default=np.inf)) if nothing and told is not None else 0.0
    return Diagnosis(
        case=dataset.name,
        verdict=_verdict(
            base, search, _wrong_values(dataset, system, base), now.unknown, bool(varying), vague
        ),
        effects=found,
        ties=tuple(tied_sets(found)),
        unknown=now.unknown,
        nominal=errors(dataset, system, engine(), signal_share=signal_share),
        refit=judged.first,
        with_effect=now.last,
        shrink=gap,
        where=judged.before,
        left=now.after,
        bent=tuple(bent_parameters(system, base.system, told)),
        experiments=tuple(
            next_experiment(dataset, [e for e in tied_explanations(search) if not decision.against(e)])
        ),
        withdrawn=tuple(f"{name} at {where}" for name, where in withdrawn),
        outvoted=tuple(f"{name} at {where}" for name, where in decision.outvoted),
        varying=varying,
        halted=now.halted,
        untold=untold(dataset, search.chosen.system),
        together=tuple(inseparable(dataset.records)),
        beyond=tuple(beyond(dataset)),
        search=search,
        vague=vague,
        courses=tuple(courses(refit, search.chosen)) if now.unknown else (),
    )


def _wrong_values(dataset: Dataset, system: System, base: Explanation) -> bool:
    """Whether today's values err clearly more than re-fitted ones: on the test records, on the others without these."""
    seen = dataset.test or tuple(replace(record, role="test") for record in dataset.records)
    among = replace(dataset, records=seen)
    nominal, refit = errors(among, system, engine()), errors(among, base.system, base.result.engine)
    return nominal is not None and refit is not None and nominal.nrmse >= PARAMETRIC * refit.nrmse


def _verdict(
    base: Explanation, search: Attribution, wrong: bool, unknown: bool, varying: bool, vague: float = 0.0
) -> str:
    if unknown:
        return "outside_catalogue"
    if search.chosen is not base:
        return "effects"
    if varying:
        return "parameters_only"
    if vague > VAGUE:
        return "inconclusive"  # what moves no parameter surely moves no effect either
    if base.evidence.effective < TOO_SHORT and not negligible(base.result.residual):
        return "inconclusive"
    return "parameters_only" if wrong else "no_gap"
