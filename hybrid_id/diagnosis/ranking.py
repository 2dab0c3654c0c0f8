"""Candidates of a round, best first: of each set of effects the best fit, of equals the simplest."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from hybrid_id.diagnosis.catalogue import CATALOGUE
from hybrid_id.diagnosis.evidence import COLOURED, WHITE, coloured
from hybrid_id.diagnosis.explanation import Explanation, Name

SAME = 2e-3
"""Costs that differ by less than this share are of one valley."""
SIMPLER, SIMPLER_ONES = 1.1, 4
"""Mean square error over the best's up to which a candidate with fewer parameters is fitted to the end, too, and how
many are."""
LEAST_RATIO = 1.015
"""An effect, or a further parameter of one, must lower the RMS of the errors of prediction at least by this factor."""
TOLD = 2.5
"""Standard errors, block by block, from which records part two rivals."""
LEFT_OPEN = 0.1
"""A rival that leaves more than this share of the gap's mean square open, which another closes, is none."""
Variant = tuple[tuple[Name, ...], tuple[float, ...]]
"""A set of effects with their shape."""


def effects_of(one: Explanation) -> tuple[Name, ...]:
    """A candidate's effects, whatever their shape."""
    return one.effects


def variant(one: Explanation) -> Variant:
    """A candidate's effects with their shape: waves of different periods are different models."""
    laws = [(CATALOGUE[name], where) for name, where in one.effects if name in CATALOGUE]
    fixed = {f"{where}/{kind}": law.shape for law, where in laws if law.shape for kind in law.kinds}
    if not fixed:
        return one.effects, ()
    return one.effects, tuple(
        i.spec.value
        for i in one.system.table
        if i.symbol in fixed.get(i.component, ()) and not i.spec.estimate
    )


def simpler_ones(ranked: Sequence[Explanation]) -> list[Explanation]:
    """Candidates that may yet explain as much as the best, with fewer parameters than it has."""
    return [
        e
        for e in ranked
        if not e.finished
        and e.evidence.error < SIMPLER * ranked[0].evidence.error
        and len(e.result.names) < len(ranked[0].result.names)
    ][:SIMPLER_ONES]


def is_white(one: Explanation) -> bool:
    """Whether a candidate leaves next to nothing but white noise: no other can do much better."""
    return coloured(one.result.residual) < WHITE


def is_explained(one: Explanation) -> bool:
    """Whether what a candidate leaves of the train records calls for nothing from outside the catalogue."""
    return coloured(one.result.residual) <= COLOURED


def simplest_first(ranked: list[Explanation], before: Explanation) -> list[Explanation]:
    """Of the candidates that predict as well as the best, the one with the fewest parameters leads (Occam).

    Where the records cannot tell on which side of a gear an effect acts, it is where it usually does.
    """
    if not ranked:
        return []
    best = ranked[0].evidence
    closed = best.error + LEFT_OPEN * max(before.evidence.error - best.error, 0.0)
    equals = [
        e
        for e in ranked
        if e.finished
        and e.evidence.error < LEAST_RATIO**2 * best.error
        and (e.evidence.error <= closed or best.z(e.evidence) < TOLD)
    ]
    first = min(equals, key=lambda e: len(e.result.names), default=ranked[0])
    twins = [e for e in equals if _joints(e) == _joints(first) and first.evidence.z(e.evidence) < TOLD]
    first = min(twins, key=_unusual, default=first)
    return [first, *(e for e in ranked if e is not first)]


def _joints(one: Explanation) -> list[tuple[str, str]]:
    """A candidate's effects by name and joint, wherever in the joint they act."""
    return sorted((name, where.split("/")[0]) for name, where in one.effects)


def _unusual(one: Explanation) -> int:
    """How far a candidate's places are from those where its effects usually act."""
    return sum(CATALOGUE[name].places.index(where.split("/")[1]) for name, where in one.effects)


def best_of_each(
    found: Sequence[Explanation], each: int = 1, key: Callable[[Explanation], object] = variant
) -> list[Explanation]:
    """The best fits of each set of effects, best first; of those that have come to the same end only one.

    Args:
        found: fits.
        each: so many of each set.
        key: what counts as one set; by default every shape does.
    """
    ends: dict[object, list[float]] = {}
    best = []
    for one in sorted(found, key=lambda e: e.evidence.error):
        known = ends.setdefault(key(one), [])
        if len(known) < each and all(abs(one.result.cost - end) > SAME * end for end in known):
            known.append(one.result.cost)
            best.append(one)
    return best
