"""What the records cannot tell apart, and what would, in words."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

from hybrid_id.diagnosis.catalogue import separation
from hybrid_id.diagnosis.result import Diagnosis
from hybrid_id.reporting.gap_words import joint_words, place_words, words_of


def tie_lines(diagnosis: Diagnosis, brief: bool = False) -> list[str]:
    """Effects that these records cannot tell apart, each group with what would; ``brief`` leaves out why."""
    lines = []
    for group in diagnosis.ties:
        members = [(name, where) for name, where in (member.split("@") for member in group)]
        names = ", ".join(_at(*member) for member in members)
        words = _excitations(members, brief)
        told = f" What would: {words}." if words else ""
        lines.append(f"these records do not tell apart: {names}.{told}")
    return lines


def _excitations(members: Sequence[tuple[str, str]], brief: bool) -> str:
    """What would tell the members of a tie apart, pairs with the first one first; each excitation is said once."""
    told: dict[str, list[str]] = {}
    for one, other in combinations(members, 2):
        pair = f"{words_of(one[0])} and {words_of(other[0])}"
        if one[0] == other[0]:
            pair = f"the places of {words_of(one[0])}"
        if words := separation(one, other):
            pairs = told.setdefault(words.partition(": ")[0] if brief else words, [])
            pairs += [pair] if pair not in pairs else []
    if brief or len(members) == 2:
        return "; ".join(told)
    return "; ".join(f"for {', and for '.join(pairs)}, {words}" for words, pairs in told.items())


def outvoted_lines(diagnosis: Diagnosis) -> list[str]:
    """Effects that the test records decide against, as one line; none where there is none."""
    if not diagnosis.outvoted:
        return []
    names = [_at(*words.split(" at ")) for words in diagnosis.outvoted]
    verb = "explains" if len(names) == 1 else "explain"
    return [
        f"test records decide: {', '.join(names)} {verb} the train records as well, but not the test records."
    ]


def _at(name: str, where: str) -> str:
    return f"{words_of(name)} ({joint_words(where)}, {place_words(where)})"


def experiment_lines(diagnosis: Diagnosis) -> list[str]:
    """The record that would part the tied models most, as one line; none where nothing is tied."""
    if not diagnosis.experiments:
        return []
    best = diagnosis.experiments[0]
    if not best.tells:
        told = (
            f"no command that was simulated parts the tied models by more than {best.distance:.2g} times the "
        )
        return [f"next experiment: {told}encoders' noise (RMS); change the load, or how the joint stands."]
    told = (
        f"next experiment: {best.name} at joint {best.joint}: the outputs of the tied models would differ by "
        f"{best.distance:.2g} times the encoders' noise (RMS; {best.today:.2g} in these records)."
    )
    alike = "; ".join(" and ".join(_at(*name.split("@")) for name in pair) for pair in best.together)
    return [told + (f" It does not part {alike}." if alike else "")]
