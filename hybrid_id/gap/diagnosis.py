"""The diagnosis: where the gap between records and simulator lies, which effect causes it, how far it shrinks."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

from hybrid_id.errors import InputError
from hybrid_id.gap.attribute import MOST, Attribution, Progress, attribute, sure_though_small
from hybrid_id.gap.bent import bent_parameters
from hybrid_id.gap.locate import Location, locate
from hybrid_id.gap.measure import Errors, errors
from hybrid_id.gap.next_experiment import Experiment, next_experiment
from hybrid_id.gap.probability import Suspect, suspects, tied_explanations, tied_sets
from hybrid_id.gap.refit import Explanation, Refit, engine
from hybrid_id.gap.remainder import no_noise, outside
from hybrid_id.gap.shrink import Shrink, shrink
from hybrid_id.gap.untold import untold
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.facts import inseparable
from hybrid_id.records.reach import beyond
from hybrid_id.simulation.prepare import SIGNAL_SHARE
from hybrid_id.systems.chain import System

PARAMETRIC = 1.1
"""Ratio of nominal to re-fitted error from which the parameters were wrong."""
TOO_SHORT = 30.0
"""Independent samples below which no structure can be told."""


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Result of :func:`diagnose`.

    Attributes:
        case: name of the dataset.
        verdict: ``effects``, ``parameters_only``, ``no_gap``, ``outside_catalogue`` or ``inconclusive``.
        effects: every effect that was tried, the selected ones first, then by probability.
        ties: groups of effects that these records cannot tell apart.
        unknown: whether something acts that the catalogue lacks.
        nominal, refit, with_effect: errors on the test records of today's model, the re-fitted and the corrected one;
            None without test records.
        shrink: how far the gap shrinks; None without test records.
        before: torques that would explain what the re-fitted model leaves, best first.
        after: the same for the corrected model.
        bent: parameters that the re-fit has bent beyond what data sheets get wrong, in words.
        withdrawn: effects that the train records called for, in words, and whose gain on the test records is not sure.
        untold: changes of the chosen model's parameters that these records do not see, in words.
        together: facts of the records (a controller's gain, the temperature) that change together, in words.
        beyond: test records that go where no train record has been, in words.
        experiments: records that would tell tied effects apart, the best first; empty without ties.
        search: all that was tried.
    """

    case: str
    verdict: str
    effects: tuple[Suspect, ...]
    ties: tuple[tuple[str, ...], ...]
    unknown: bool
    nominal: Errors | None
    refit: Errors | None
    with_effect: Errors | None
    shrink: Shrink | None
    before: tuple[Location, ...]
    after: tuple[Location, ...]
    bent: tuple[str, ...]
    experiments: tuple[Experiment, ...]
    withdrawn: tuple[str, ...]
    untold: tuple[str, ...]
    together: tuple[str, ...]
    beyond: tuple[str, ...]
    search: Attribution = field(repr=False)

    @property
    def selected(self) -> tuple[Suspect, ...]:
        """The effects that the diagnosis stands by."""
        return tuple(s for s in self.effects if s.selected)

    @property
    def model(self) -> System:
        """Today's model, re-fitted, with the selected effects."""
        return self.search.chosen.system

    def as_dict(self) -> dict[str, Any]:
        """The content of ``diagnosis.json``."""
        gap = self.shrink
        return {
            "case": self.case,
            "verdict": self.verdict,
            "unknown": self.unknown,
            "no_gap": self.verdict in ("no_gap", "parameters_only"),
            "effects": [
                {
                    "name": s.name,
                    "where": s.where,
                    "probability": round(s.probability, 4),
                    "tied_with": list(s.tied_with),
                    "parameters": {k: list(v) for k, v in s.parameters.items()},
                    "selected": s.selected,
                }
                for s in self.effects
            ],
            "ties": [list(group) for group in self.ties],
            "gap": {
                "nominal": None if self.nominal is None else self.nominal.nrmse,
                "refit": None if gap is None else gap.refit,
                "with_effect": None if gap is None else gap.with_effect,
                "noise_floor": None if gap is None else gap.floor,
                "shrink": None if gap is None else gap.share,
                "shrink_interval": None if gap is None else list(gap.interval),
            },
            "location": [
                {
                    "joint": one.joint,
                    "place": one.place,
                    "signal": one.signal,
                    "share": max(one.share, 0.0),
                    "profile": {"signal": one.grid.tolist(), "torque": one.torque.tolist()},
                }
                for one in self.before[:6]
            ],
            "left": [
                {"joint": o.joint, "place": o.place, "signal": o.signal, "share": max(o.share, 0.0)}
                for o in self.after[:3]
            ],
            "bent_parameters": list(self.bent),
            "withdrawn": list(self.withdrawn),
            "cannot_be_told": [*self.untold, *self.together],
            "beyond_training": list(self.beyond),
            "window": self.search.window,
            "next_experiments": [
                {"name": e.name, "joint": e.joint, "distance": e.distance, "distance_today": e.today}
                for e in self.experiments[:3]
                if e.tells
            ],
        }


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

    Search and fits use the train records only; the test records are opened once, to measure the gap. Effects whose gain
    on them may as well be none (95 % interval) are withdrawn; one that is sure but small on the train records is
    believed where it explains what the test records leave open.

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
    refit = Refit(dataset, jobs=jobs, signal_share=signal_share)
    say = progress or (lambda *_: None)
    say("today's model", 0, 1)
    search = attribute(refit, system, most=most, progress=progress)
    base, withdrawn = search.base, ()
    say("location", 0, 1)
    before = tuple(locate(refit, base))
    nominal, first = errors(dataset, system, engine()), errors(dataset, base.system, base.result.engine)
    judged = partial(_judged, refit, before, first, seed)
    now = judged(search)
    if search.chosen is not base and now.gap is not None and now.gap.interval[0] <= 0.0:
        withdrawn, now = search.chosen.effects, judged(replace(search, chosen=base))
    if now.unknown and (small := sure_though_small(now.search)) is not None:
        borne_out = judged(small)
        if not borne_out.unknown and borne_out.gap is not None and borne_out.gap.interval[0] > 0.0:
            withdrawn, now = (), borne_out
    search, found = now.search, tuple(suspects(now.search))
    return Diagnosis(
        case=dataset.name,
        verdict=_verdict(base, search, nominal, first, now.unknown),
        effects=found,
        ties=tuple(tied_sets(found)),
        unknown=now.unknown,
        nominal=nominal,
        refit=first,
        with_effect=now.last,
        shrink=now.gap,
        before=before,
        after=now.after,
        bent=tuple(bent_parameters(system, base.system)),
        experiments=tuple(next_experiment(dataset, tied_explanations(search))),
        withdrawn=tuple(f"{name} at {where}" for name, where in withdrawn),
        untold=untold(dataset, search.chosen.system),
        together=tuple(inseparable(dataset.records)),
        beyond=tuple(beyond(dataset)),
        search=search,
    )


@dataclass(frozen=True, eq=False)
class _Judged:
    """A search's chosen model on the test records: what it leaves, its errors, how far the gap shrinks."""

    search: Attribution
    after: tuple[Location, ...]
    last: Errors | None
    gap: Shrink | None
    unknown: bool


def _judged(
    refit: Refit, before: tuple[Location, ...], first: Errors | None, seed: int, search: Attribution
) -> _Judged:
    """A search's chosen model held against the test records; ``before`` and ``first`` are of the re-fitted one."""
    chosen = search.chosen
    if chosen is search.base:
        after, last = before, first
    else:
        after, last = tuple(locate(refit, chosen)), errors(refit.dataset, chosen.system, chosen.result.engine)
    gap = None
    if first is not None and last is not None:
        floor = max(last.noise, last.nrmse * math.sqrt(1.0 - min(no_noise(chosen, after, last), 0.99)))
        gap = shrink(first, last, min(floor, last.nrmse), seed=seed)
    return _Judged(search, after, last, gap, outside(chosen, first, last))


def _verdict(
    base: Explanation, search: Attribution, nominal: Errors | None, refit: Errors | None, unknown: bool
) -> str:
    if unknown:
        return "outside_catalogue"
    if search.chosen is not base:
        return "effects"
    if base.evidence.effective < TOO_SHORT:
        return "inconclusive"
    if nominal is None or refit is None or nominal.nrmse < PARAMETRIC * refit.nrmse:
        return "no_gap"
    return "parameters_only"
