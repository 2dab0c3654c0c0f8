"""From errors of prediction to probabilities, ties and the verdict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hybrid_id.diagnosis.attribute import Attribution
from hybrid_id.diagnosis.belief import LEAST_Z, better, least_ratio
from hybrid_id.diagnosis.catalogue import effect
from hybrid_id.diagnosis.explanation import Explanation, Name, new_effect
from hybrid_id.diagnosis.ranking import LEFT_OPEN, TOLD
from hybrid_id.diagnosis.round import Round

NEEDLESS = 0.1
"""Of the probability of an effect, what is left where other effects, the test records or each record's own parameters
have made it needless."""
BESIDE = 0.3
"""Of the probability of an effect, what is left beside something outside the catalogue that has caused all that stays
unexplained: of the names that stood beside an "unknown" in published blind checks, 6 of 21 were right."""
TIE = 1.06
"""Rivals whose RMS errors differ by less than this factor are told apart by no record here, where fewer than ``TOLD``
standard errors part them."""


@dataclass(frozen=True)
class Suspect:
    """One effect at one place.

    Attributes:
        name, where: which effect acts where.
        probability: that it is at work.
        selected: whether the diagnosis stands by it.
        tied_with: effects that explain the records as well, ``name@where``.
        parameters: estimate and standard error of each parameter that it brings, by symbol; a fixed one that belongs
            to the answer has the error 0.
    """

    name: str
    where: str
    probability: float
    selected: bool
    tied_with: tuple[str, ...]
    parameters: dict[str, tuple[float, float]]


def suspects(found: Attribution) -> list[Suspect]:
    """Every effect that was tried: the selected ones as they were found, then the most probable first."""
    chosen = set(found.chosen.effects)
    believed = {
        new_effect(r.best, r.before) for r in found.rounds if r.best is not None and better(r.best, r.before)
    }
    needless = believed - chosen
    best: dict[Name, Suspect] = {}
    found_in: dict[Name, int] = {}
    for number, one in enumerate(found.rounds):
        if one.best is not None:
            found_in.setdefault(new_effect(one.best, one.before), number)
        weights, present = _weights(one), _present(one, found.chosen)
        for explanation, weight in zip(one.candidates, weights, strict=True):
            name = new_effect(explanation, one.before)
            left = NEEDLESS if name in needless else 1.0
            suspect = Suspect(
                name[0], name[1], float(left * present * weight), name in chosen, _ties(explanation, one, name),
                _parameters(found.chosen if name in chosen else explanation, name),
            )  # fmt: skip
            if name not in best or one.again or suspect.probability > best[name].probability:
                best[name] = suspect
    return sorted(
        best.values(),
        key=lambda s: (-s.selected, found_in.get((s.name, s.where), 0) * s.selected, -s.probability),
    )


def believed(found: Sequence[Suspect], varying: bool, left: float) -> list[Suspect]:
    """Suspects after what their search could not know.

    Args:
        found: suspects.
        varying: whether each record's own parameters explain the rest: none but the selected ones is called for.
        left: share of what the chosen model leaves that has a cause which nothing tells: they may only stand in for it.
    """
    shares = (1.0 - (1.0 - BESIDE) * left) * np.array(
        [NEEDLESS if varying and not s.selected else 1.0 for s in found]
    )
    return [
        replace(s, probability=float(share) * s.probability) for s, share in zip(found, shares, strict=True)
    ]


def _weights(one: Round) -> np.ndarray:
    """Share of each candidate among them, from how significantly the best predicts better."""
    if one.best is None:
        return np.empty(0)
    surplus = np.array(
        [np.inf if _contains(e, one) else max(one.best.evidence.z(e.evidence), 0.0) for e in one.candidates]
    )
    odds = np.exp(-0.5 * np.square(surplus))
    return odds / odds.sum()


def _present(one: Round, chosen: Explanation) -> float:
    """Probability that any effect beyond the model before is at work."""
    if one.best is None:
        return 0.0
    z = one.best.evidence.z(one.before.evidence)
    least = 2.0 * np.log(least_ratio(one.before))
    gain = np.log(one.before.evidence.error / one.best.evidence.error) / least
    if one.best is chosen and not better(chosen, one.before):  # the test records have borne it out
        gain = np.inf
    return float(1.0 / (1.0 + np.exp(-2.0 * (min(z - LEAST_Z, 3.0 * (gain - 1.0))))))


def _contains(explanation: Explanation, one: Round) -> bool:
    """Whether an explanation has a round's best as its special case: that it explains as much says nothing for it."""
    (name, where), best = new_effect(explanation, one.before), one.best and new_effect(one.best, one.before)
    return best is not None and best[1] == where and best[0] in effect(name).contains


def _ties(explanation: Explanation, one: Round, name: Name) -> tuple[str, ...]:
    """Rivals that explain the records as well, as ``name@where``."""
    rivals = (new_effect(e, one.before) for e in _equals(explanation, one))
    return tuple(f"{rival[0]}@{rival[1]}" for rival in rivals if rival != name)


def _equals(explanation: Explanation, one: Round) -> list[Explanation]:
    """Candidates of a round whose errors are those of an explanation, as far as its records tell."""
    best = min(e.evidence.error for e in one.candidates)
    allowed = best + LEFT_OPEN * max(one.before.evidence.error - best, 0.0)
    own = explanation.evidence.error
    return [
        e
        for e in one.candidates
        if e.evidence.error < allowed
        and not _contains(e, one)
        and max(e.evidence.error / own, own / e.evidence.error) < TIE**2
        and abs(explanation.evidence.z(e.evidence)) < TOLD
        and better(e, one.before)
    ]


def tied_explanations(found: Attribution) -> list[Explanation]:
    """Fitted models that explain the records as well as the chosen one, itself among them; empty without a rival."""
    for one in found.rounds:
        if one.best is not None and one.best.effects == found.chosen.effects:
            equals = _equals(one.best, one)
            if len(equals) > 1:
                return equals
    return []


def _parameters(explanation: Explanation, name: Name) -> dict[str, tuple[float, float]]:
    """Estimates and standard errors of what an effect brings; what it brings fixed has none."""
    result = explanation.result
    jacobian = np.concatenate([j.reshape(-1, j.shape[-1]) for j in result.jacobian])
    scale = max(result.noise_scale**2 * result.n_samples / max(explanation.evidence.effective, 1.0), 1e-300)
    information = jacobian.T @ jacobian / scale
    size = np.sqrt(np.maximum(np.diag(information), 1e-300))
    covariance = np.linalg.pinv(information / np.outer(size, size), rcond=1e-10) / np.outer(size, size)
    unseen = np.diag(information) == 0.0  # no measurement depends on it
    covariance[unseen, unseen] = np.inf
    keys = {f"{name[1]}/{kind}" for kind in effect(name[0]).kinds}
    found = {}
    for k, parameter in enumerate(result.names):
        info = result.system.parameter(parameter)
        if info.component in keys:
            found[info.symbol] = (float(result.values[k]), float(np.sqrt(max(covariance[k, k], 0.0))))
    for info in result.system.table:
        if info.component in keys and effect(name[0]).shape.get(info.symbol) in found:
            found[info.symbol] = (info.spec.value, 0.0)
    return found


def tied_sets(found: Sequence[Suspect]) -> list[tuple[str, ...]]:
    """Groups of effects that these records cannot tell apart, of the selected ones."""
    return [(f"{s.name}@{s.where}", *s.tied_with) for s in found if s.selected and s.tied_with]
