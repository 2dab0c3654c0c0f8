"""Test records decide between effects that explain the train records alike."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hybrid_id.diagnosis.attribute import MOST, Attribution, Progress, search_on
from hybrid_id.diagnosis.belief import better
from hybrid_id.diagnosis.catalogue import over_angle
from hybrid_id.diagnosis.evidence import Evidence
from hybrid_id.diagnosis.explanation import Explanation, Name, new_effect
from hybrid_id.diagnosis.measure import errors
from hybrid_id.diagnosis.probability import TIE, Suspect
from hybrid_id.diagnosis.ranking import LEFT_OPEN, TOLD
from hybrid_id.diagnosis.refit import Refit
from hybrid_id.diagnosis.remainder import behind_play
from hybrid_id.diagnosis.round import Round, finished
from hybrid_id.systems.chain import System

RIVALS = 4
"""Rivals that are held against the test records at most."""


@dataclass(frozen=True, eq=False)
class Decision:
    """What the test records say of models that explain the train records alike.

    Attributes:
        search: the search, which stands by the model that they bear out.
        outvoted: effects that explain the train records as well and predict the test records surely worse, by how many
            standard errors.
        borne_out: the effect that they decide for; None where nothing is outvoted.
    """

    search: Attribution
    outvoted: Mapping[Name, float]
    borne_out: Name | None = None

    def against(self, one: Explanation) -> bool:
        """Whether a model has an effect that they outvote."""
        return any(name in self.outvoted for name in one.effects)

    def weighed(self, found: Sequence[Suspect]) -> list[Suspect]:
        """Suspects with the test records' word: what they outvote is less probable, and tied with none."""
        lost, names = 0.0, {f"{name}@{where}" for name, where in self.outvoted}
        weighed = []
        for one in found:
            z = self.outvoted.get((one.name, one.where), 0.0)
            share = one.probability * (1.0 - math.exp(-0.5 * z * z))
            lost += share
            ties = () if z else tuple(tie for tie in one.tied_with if tie not in names)
            weighed.append(replace(one, probability=one.probability - share, tied_with=ties))
        first = next((k for k, one in enumerate(weighed) if (one.name, one.where) == self.borne_out), None)
        if first is not None:
            weighed[first] = replace(weighed[first], probability=min(1.0, weighed[first].probability + lost))
        return weighed


def decide(refit: Refit, search: Attribution) -> Decision:
    """Let the test records decide between the chosen model and those that explain the train records as well.

    Which of two effects acts may show only where the records go elsewhere. Where a torque over the angle or play may
    send a free run elsewhere, and over windows, the test records have no word.

    Args:
        refit: holds the records, and fits rivals to the end.
        search: of the train records.
    """
    last = next((one for one in reversed(search.rounds) if _of(one, search)), None)
    if last is None or search.window is not None or not refit.dataset.test:
        return Decision(search, {})
    models = (search.chosen, *_rivals(refit, search.chosen, last))
    if any(over_angle(one.effects) or behind_play(one) for one in models):
        return Decision(search, {})
    told = {one: _on_test(refit, one) for one in models}
    if not told[search.chosen].samples:
        return Decision(search, {})

    def clearly(one: Explanation, other: Explanation) -> bool:
        """Whether one predicts them better than what a law's formula may be off."""
        return told[one].gain(told[other]) >= TIE and told[one].z(told[other]) >= TOLD

    best = min(told, key=lambda one: told[one].error)
    best = best if clearly(best, search.chosen) else search.chosen
    worse = [one for one in models if clearly(best, one)]
    outvoted = {new_effect(one, last.before): told[best].z(told[one]) for one in worse}
    kept = new_effect(best, last.before) if outvoted else None
    return Decision(search if best is search.chosen else _with(search, last, best), outvoted, kept)


def others(
    refit: Refit, system: System, decision: Decision, *, most: int = MOST, progress: Progress | None = None
) -> Iterator[Decision]:
    """What the test records may bear out where they refuse a search's effects: fewer of them, then others.

    Args:
        refit: fits models to the train records.
        system: today's model.
        decision: whose search's effects are refused.
        most: effects at most.
        progress: called with (stage, done, total).
    """
    search, chosen = decision.search, set(decision.search.chosen.effects)
    if search.window is not None:
        return
    fewer = {
        r.before.effects: r.before
        for r in search.rounds
        if r.before.effects and set(r.before.effects) < chosen
    }
    for simpler in sorted(fewer.values(), key=lambda e: -len(e.effects)):
        yield replace(decision, search=replace(search, chosen=simpler))
    again = search_on(refit, system, search, most=most, progress=progress)
    if again is not None and again.chosen.effects:
        yield decide(refit, again)


def _of(one: Round, search: Attribution) -> bool:
    """Whether a round is the one that has brought the chosen effects."""
    return one.best is not None and one.best.effects == search.chosen.effects


def _rivals(refit: Refit, chosen: Explanation, last: Round) -> list[Explanation]:
    """Other candidates of a round that explain the train records as well, fitted to the end."""
    least = min(e.evidence.error for e in last.candidates)
    allowed = min(TIE**2 * least, least + LEFT_OPEN * max(last.before.evidence.error - least, 0.0))
    alike = [
        e
        for e in last.candidates
        if e.effects != chosen.effects and e.evidence.error < allowed and better(e, last.before)
    ]
    return finished(refit, alike[:RIVALS])


def _on_test(refit: Refit, one: Explanation) -> Evidence:
    """Errors on the test records, block by block; no block where none of them moves."""
    found = errors(refit.dataset, one.system, one.result.engine, signal_share=refit.signal_share)
    if found is None:
        return Evidence(np.empty(0), 0, 0.0)
    blocks = np.concatenate([block for row in found.blocks for block in row])
    return Evidence(blocks, len(blocks), float(len(blocks)))


def _with(search: Attribution, last: Round, best: Explanation) -> Attribution:
    """The search that stands by another candidate of a round."""
    first = replace(last, candidates=(best, *(e for e in last.candidates if e.effects != best.effects)))
    return replace(search, rounds=tuple(first if one is last else one for one in search.rounds), chosen=best)
