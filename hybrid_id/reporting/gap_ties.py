"""What the records cannot tell apart, and what would, in words."""

from __future__ import annotations

from hybrid_id.gap.catalogue import CATALOGUE
from hybrid_id.gap.diagnosis import Diagnosis
from hybrid_id.reporting.gap_words import joint_words, place_words, words_of


def tie_lines(diagnosis: Diagnosis) -> list[str]:
    """Effects that these records cannot tell apart, each group with the experiment that would."""
    lines = []
    for group in diagnosis.ties:
        pairs = [member.split("@") for member in group]
        names = [_at(name, where) for name, where in pairs]
        known = CATALOGUE.get(pairs[0][0])
        told = f" What would: {known.separated_by}." if known is not None else ""
        lines.append(f"these records do not tell apart: {', '.join(names)}.{told}")
    return lines


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
