"""The first sentence of a diagnosis: what it stands by."""

from __future__ import annotations

from hybrid_id.diagnosis.course import acts_at
from hybrid_id.diagnosis.diagnose import VAGUE
from hybrid_id.diagnosis.probability import Suspect
from hybrid_id.diagnosis.result import Diagnosis
from hybrid_id.reporting.gap_words import (
    SIDES,
    capital,
    error_words,
    goes,
    goes_with,
    joined,
    joint_words,
    percent,
    place_words,
    values_of,
    words_of,
)
from hybrid_id.reporting.tables import count

LEFT_SHARE = 0.1
"""Share of what the best model leaves, noise and all, from which a torque's shape is worth naming."""


def verdict_sentence(diagnosis: Diagnosis, reach: float = 1.96) -> str:
    """What the diagnosis stands by, in plain words."""
    return {
        "effects": _effects,
        "outside_catalogue": _outside,
        "parameters_only": _parameters_only,
        "no_gap": _no_gap,
        "inconclusive": _inconclusive,
    }[diagnosis.verdict](diagnosis, reach)


def _effects(diagnosis: Diagnosis, reach: float) -> str:
    chosen = diagnosis.selected
    found = joined([_described(diagnosis, one, reach) for one in chosen])
    verb = "explains" if len(chosen) == 1 else "explain"
    return f"{capital(found)} {verb} the gap{_falls(diagnosis)}."


def _outside(diagnosis: Diagnosis, reach: float) -> str:
    words, chosen = _acting(diagnosis), diagnosis.selected
    if not chosen:
        return f"{words}, and no effect of the catalogue earns its place."
    found = joined([_described(diagnosis, s, reach) for s in chosen])
    return f"{words}. {capital(found)} {'is' if len(chosen) == 1 else 'are'} only a part of it{_falls(diagnosis)}."


def _acting(diagnosis: Diagnosis) -> str:
    """Where something unknown acts and on what it depends, as far as the records tell."""
    joint, side = acts_at(diagnosis.courses)
    told = (o for o in diagnosis.left if joint in (None, o.joint) and side in (None, o.place))
    one = next((o for o in told if o.share > LEFT_SHARE), None)
    joint = joint or (one.joint if one is not None else None)
    if joint is None:
        words = "Something that the catalogue lacks is at work"
    else:
        where = joint_words(joint) + ("" if side is None else f", on the {SIDES[side]}")
        words = f"Something that the catalogue lacks acts at {where}"
    if one is not None:
        shape = f"A torque of this shape explains {percent(one.share)} of what the best model leaves (mean square)"
        return f"{words}: {goes_with(one)}. {shape}"
    elsewhere = [o.share for o in diagnosis.courses if o.joint != joint]
    if joint is not None and elsewhere:
        words += (
            f": a torque there, whatever its course, explains {percent(diagnosis.courses[0].share)} of what the best "
            f"model leaves within short windows (mean square), elsewhere {percent(max(*elsewhere, 0.0))} at most"
        )
    elif diagnosis.with_effect is not None:
        coloured = percent(diagnosis.with_effect.coloured)
        words += f": {coloured} of what the best model leaves on unseen records (mean square) is no noise"
    return words


def _parameters_only(diagnosis: Diagnosis, _reach: float) -> str:
    nominal, refit = diagnosis.nominal, diagnosis.refit
    errors = "" if nominal is None or refit is None else (
        f": on unseen records the normalised error {goes(nominal.nrmse, refit.nrmse)} when today's model is fitted to "
        "the train records"
    )  # fmt: skip
    if diagnosis.varying:
        return (
            "No effect is missing, but the parameters differ from record to record: each record's own values leave "
            f"nothing but noise, one common set does not{errors}."
        )
    return f"Wrong parameters explain the gap, and no effect is missing{errors}."


def _no_gap(diagnosis: Diagnosis, _reach: float) -> str:
    tried = count(len(diagnosis.effects), "effect")
    if diagnosis.nominal is None:
        return f"No effect is missing: none of {tried} predicts parts left out clearly better; no record is a test."
    clearly = "unseen records surely" if diagnosis.withdrawn else "parts left out clearly"
    return (
        "There is no gap: on unseen records today's model leaves a normalised error of "
        f"{error_words(diagnosis.nominal.nrmse)}, and none of {tried} predicts {clearly} better."
    )


def _inconclusive(diagnosis: Diagnosis, _reach: float) -> str:
    worth = diagnosis.search.base.evidence.effective
    if diagnosis.vague > VAGUE:
        return (
            "These records are too short to say: they tell nothing of the parameters better than to "
            f"±{196 * diagnosis.vague:.2g} % (95 %), and an effect would hide in that. Record longer, or with faster "
            "changes of the command."
        )
    return (
        f"These records are too short to say: their errors are worth {worth:.0f} independent samples. Record longer, "
        "or with faster changes of the command."
    )


def _falls(diagnosis: Diagnosis) -> str:
    gap = diagnosis.shrink
    if gap is None:
        return " (no test record says how far)"
    if diagnosis.opened is not None and gap.share == 0.0:
        return (
            f" on record '{diagnosis.opened}'; the other test records lack nothing: normalised error "
            f"{error_words(gap.refit)} without it, {error_words(gap.with_effect)} with it"
        )
    low, high = (f"{100 * min(end, 1.0):.0f}" for end in gap.interval)
    closed = f", {100 * gap.share:.0f} % ({low}-{high} %) of what can be closed" if gap.share > 0 else ""
    return f": normalised error on unseen records {goes(gap.refit, gap.with_effect)}{closed}"


def _described(diagnosis: Diagnosis, one: Suspect, reach: float) -> str:
    values = values_of(diagnosis, one, reach)
    size = f" of {values[0].split(' = ')[1]}" if len(values) == 1 else ""
    more = f" ({', '.join(values)})" if len(values) > 1 else ""
    return f"{words_of(one.name)}{size} {place_words(one.where)} of {joint_words(one.where)}{more}"
