"""A diagnosis in sentences: the headline first, then where, how far, what is indistinguishable and what is doubtful."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import combinations

import numpy as np

from hybrid_id.diagnosis.catalogue import CATALOGUE, brought, effect, separation
from hybrid_id.diagnosis.changes import NOMINAL
from hybrid_id.diagnosis.criteria import CRITERIA
from hybrid_id.diagnosis.errors_on_test import Errors, Shrink
from hybrid_id.diagnosis.grade import NEGLIGIBLE, Interval, RatedEffect
from hybrid_id.diagnosis.locate import HISTORY, IN_WORDS, acts_at
from hybrid_id.diagnosis.plausibility import named
from hybrid_id.diagnosis.result import Diagnosis
from hybrid_id.parameters import ParameterInfo
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.reporting.tables import capital, count, interval_words
from hybrid_id.reporting.units import in_unit, shown_unit
from hybrid_id.systems.by_joint import with_joint_names
from hybrid_id.systems.chain import System

LEAST_SHARE = 0.02
"""Share of the gap from which a place is worth naming."""
WORSE = 1.5
"""Error of the re-fitted model over that of the nominal one from which it is said."""
NAMED = 4
"""Members of a tie that a headline names."""
PLACES = {
    "input": "at the input", "motor": "in the motor", "motor_friction": "on the motor side",
    "transmission": "in the gear", "link_friction": "on the link side", "load": "at the load",
    "sensor": "in the encoder",
}  # fmt: skip
SIDES = {"motor": "motor side", "load": "link side"}

# ---- the headline ----


_CAUSES = "an effect outside the catalogue, or several small ones"


def headline(diagnosis: Diagnosis) -> str:
    """What the diagnosis states, what is known first."""
    tried = count(len(diagnosis.effects), "effect")
    match diagnosis.verdict:
        case "effects":
            sentence = _effects(diagnosis)
        case "outside_catalogue":
            share = f"{percent(diagnosis.remainder)} ({range_percent(diagnosis.remainder_interval)})"
            sentence = (
                f"None of {tried} of the catalogue surely explains any of the gap; {share} remains "
                f"unexplained{_acting(diagnosis)}: {_CAUSES}."
            )
        case "parameters_only" if diagnosis.varying:
            sentence = (
                "No effect is missing, but the parameters differ from record to record: per-record fits of the train "
                "records leave nothing but noise; one common set, whose errors stand below, leaves more."
            )
        case "parameters_only":
            sentence = "Wrong parameter values explain the gap, and no effect is missing."
            # which physical change explains the new values
            sentence += f" {diagnosis.changes}" if diagnosis.changes else ""
        case "no_gap" if not diagnosis.effects:
            sentence = (
                "There is no gap: the re-fitted nominal model leaves white noise or less, in which no effect was "
                "tried."
            )
        case "no_gap":
            sentence = (
                f"There is no gap: none of {tried} predicts records left out surely better than the nominal model, "
                "re-fitted."
            )
        case _ if diagnosis.interrupted:
            sentence = "Inconclusive: no effect had been accepted."
        case _:
            sentence = "Inconclusive: too little data."
            if diagnosis.relative_std > CRITERIA.max_relative_std:
                surest = f"±{196 * diagnosis.relative_std:.2g} % (95 %)"
                sentence += (
                    f" No parameter is identified better than to {surest}, and an effect would hide in that."
                )
            else:
                worth = diagnosis.search.base.validation.effective
                sentence += f" The errors are worth {worth:.0f} independent samples."
            sentence += " Record longer, or with faster changes of the command."
    if diagnosis.interrupted:
        sentence += " The search was interrupted: what is missing here may not have been tried."
    return f"{sentence} {diagnosis.contradiction}".rstrip()


def _effects(diagnosis: Diagnosis) -> str:
    chosen = asserted(diagnosis)
    said = [
        f"{_named(diagnosis, one)}{' explains' if k == 0 else ''} {share_words(one, sure_words(one))}"
        for k, one in enumerate(chosen)
    ]
    rest = "nothing structural remains"
    if diagnosis.remainder >= NEGLIGIBLE:
        interval = range_percent(diagnosis.remainder_interval)
        rest = f"{percent(diagnosis.remainder)} ({interval}) remains unexplained{_acting(diagnosis)}"
    sentence = f"{capital(joined(said))} of the gap; {rest}."
    if diagnosis.unknown:
        more = diagnosis.remainder >= sum(one.share or 0.0 for one in diagnosis.selected)
        least = f"At least {percent(diagnosis.remainder_interval[0])} of the gap has another cause"
        sentence += f" {'More remains than is explained' if more else least}: {_CAUSES}."
    if unsure := [
        words_of(c.name) for c in chosen if c.share_interval is not None and c.share_interval[0] <= 0.0
    ]:
        sentence += (
            f" How much {joined(unsure)} explains differs so from record to record that its size is open."
        )
    if beside := [
        _at(one.name, one.where, diagnosis.model) for one in diagnosis.selected if one not in chosen
    ]:
        sentence += f" Also fitted, negligible (less than 0.5 % of the gap each): {joined(beside)}."
    return sentence


def asserted(diagnosis: Diagnosis) -> list[RatedEffect]:
    """The selected effects that explain more than next to nothing; all of them where none does."""
    return [one for one in diagnosis.selected if not one.negligible] or list(diagnosis.selected)


def sure_words(one: RatedEffect) -> str:
    """The probability of an effect, or of one that it is indistinguishable from."""
    value = "above 0.99" if one.together > 0.99 else f"{one.together:.2f}"  # never said to be one
    return f"probability{' of one of them' if one.tied_with else ''} {value}"


def _named(diagnosis: Diagnosis, one: RatedEffect) -> str:
    """An effect with those that it is indistinguishable from, and its joint where several joints leave no doubt."""
    members = [(one.name, one.where), *(_member(tie) for tie in one.tied_with)]
    names = list(dict.fromkeys(words_of(name) for name, _ in members))
    shown = [*names[:NAMED], *([f"{len(names) - NAMED} more"] if len(names) > NAMED else [])]
    words = joined(shown, "or")
    joints = {where.split("/")[0] for _, where in members}
    if len(diagnosis.model.joints) > 1 and joints == {acts_at(diagnosis.disturbances_before)[0]}:
        words += f" at {joint_words(one.where, diagnosis.model)}"
    return words + (" (indistinguishable on these records)" if len(names) > 1 else "")


def _acting(diagnosis: Diagnosis) -> str:
    """Where what remains acts and on what it depends, as far as the records identify that."""
    joint, side = acts_at(diagnosis.disturbances)
    if joint is None:
        return ""
    words = f", at {joint_words(joint, diagnosis.model)}"
    words += f", on the {SIDES[side]}" if side in SIDES else ""
    for (
        one
    ) in diagnosis.residual_after:  # the torque over one signal that explains most there, if it does a tenth
        if one.joint == joint and side in (None, one.side) and one.share > CRITERIA.substantial:
            return words + (
                f" ({IN_WORDS[one.signal]})" if one.signal in IN_WORDS else f", with the {one.signal}"
            )
    return words


# ---- the lines below it ----


def where_line(diagnosis: Diagnosis) -> str:
    """Sides of joints and signals that explain most of the residual of the re-fitted model; empty where none does."""
    sides: dict[str, list[str]] = {}
    for one in [one for one in diagnosis.location if one.share > LEAST_SHARE][:3]:
        side = side_words(one.joint, one.side, diagnosis.model)
        sides.setdefault(side, []).append(f"{one.signal} ({percent(one.share)})")
    if not sides:
        return ""
    words = "; ".join(f"{side}, over {', '.join(signals)}" for side, signals in sides.items())
    words += ", each alone" if sum(map(len, sides.values())) > 1 else ""
    history = (
        "; motion history: how the joint moved just before, its last reversal say" if HISTORY in words else ""
    )
    return f"residual before (mean square, re-fitted model) is explained by a torque at {words}{history}."


def disturbance_line(diagnosis: Diagnosis) -> str:
    """What a torque of arbitrary shape in time explains of the remainder, here and elsewhere; empty without one."""
    joint, _ = acts_at(diagnosis.disturbances)
    elsewhere = [one.share for one in diagnosis.disturbances if one.joint != joint]
    if joint is None or not elsewhere:
        return ""
    model, place = "corrected" if diagnosis.corrected else "re-fitted", joint_words(joint, diagnosis.model)
    return (
        f"residual after ({model} model): a torque of arbitrary shape in time at {place} explains "
        f"{percent(diagnosis.disturbances[0].share)} of it within short windows (mean square), elsewhere "
        f"{percent(max(*elsewhere, 0.0))} at most."
    )


def thinned_line(diagnosis: Diagnosis) -> str:
    """To which sample time the records were thinned for the search; empty where they were not."""
    logged, fitted = diagnosis.details.dataset.sample_time, diagnosis.sample_time
    if logged is None or fitted is None or fitted < 1.5 * logged:
        return ""
    return (
        f"records thinned to what the drive needs: fitted at {1e3 * fitted:.3g} ms instead of {1e3 * logged:.3g} ms; "
        "what the steps between say of the outputs is within their noise, and the nominal model runs alike."
    )


def error_lines(diagnosis: Diagnosis) -> list[str]:
    """NRMSE of each output on the test records, nominal to corrected, and the shrink.

    Where no effect is asserted nothing is corrected, and that is said in place of a shrink.
    """
    nominal, refit, gap = diagnosis.nominal, diagnosis.refit, diagnosis.shrink
    if nominal is None or refit is None or gap is None:
        return [f"{unmeasured(diagnosis.details.dataset)}; models were compared over {diagnosis.horizon}."]
    last = diagnosis.with_effect if diagnosis.corrected else None
    records = count(len(nominal.by_record), "test record")
    models = [one for one in (nominal, refit, last) if one is not None]
    system, channels = diagnosis.details.nominal, diagnosis.details.dataset.outputs
    titles = {channel.name: channel.title for channel in with_joint_names(channels, system)}
    outputs = []
    for output in nominal.by_output:
        names = ("nominal", "re-fitted", "corrected")
        said = [f"{name} {one.by_output[output]:.3g}" for name, one in zip(names, models, strict=False)]
        *values, unit = in_unit(output, [one.rmse[output] for one in models], channels, system)
        outputs.append(f"{titles[output]} {', '.join(said)} (RMSE {', '.join(values)} {unit})")
    floor = "noise floor, by repeated records," if gap.repeated else "noise floor"
    lines = [f"NRMSE on {records}, {diagnosis.horizon}: {'; '.join(outputs)}; {floor} {gap.floor:.3g}."]
    if last is not None:
        lines.append(shrink_line(gap))
    else:
        one_set = ", with one set for all records" if diagnosis.varying else ""
        lines.append(
            f"there is no corrected model, for no effect is asserted: the nominal one is re-fitted{one_set}."
        )
    if diagnosis.rest_differs:
        lines.append(rest_line())
    return lines


def rest_line(where: str = "") -> str:
    """That free runs stick elsewhere than the machine, at the joints that ``where`` names."""
    return (
        f"rest positions differ (stick){where}: free runs halt elsewhere than the machine, although the corrected "
        "model follows it from measured states."
    )


def unmeasured(dataset: Dataset) -> str:
    """That no test record measures the gain, why, and what to do, without a full stop."""
    why, one = (
        ("no test record moves", "one that moves") if dataset.test else ("there is no test record", "one")
    )
    return f"{why}, so nothing measures the gain: give {one} the role test"


def shrink_line(gap: Shrink) -> str:
    """How far the gap shrinks on the test records, said of which the line stands below."""
    low, high = (round(100 * min(end, 1.0)) for end in gap.interval)
    between = "-" if low >= 0 else " to "
    return f"shrink of the gap on them: {percent(gap.share)} ({low}{between}{high} %)."


def tie_lines(diagnosis: Diagnosis, brief: bool = False) -> list[str]:
    """Groups of indistinguishable effects, each with what would distinguish them; ``brief`` omits why."""
    lines = []
    for group in diagnosis.ties:
        members = [_member(member) for member in group]
        names = ", ".join(_at(*member, diagnosis.model) for member in members)
        # what would distinguish the members of a tie, pairs with the first one first; each excitation is said once
        found: dict[str, list[str]] = {}
        for one, other in combinations(members, 2):
            pair = f"{words_of(one[0])} and {words_of(other[0])}"
            if one[0] == other[0]:
                pair = f"the places of {words_of(one[0])}"
            if words := separation(one, other):
                pairs = found.setdefault(words.partition(": ")[0] if brief else words, [])
                pairs += [pair] if pair not in pairs else []
        if brief or len(members) == 2:
            words = "; ".join(found)
        else:
            words = "; ".join(f"for {', and for '.join(pairs)}, {words}" for words, pairs in found.items())
        advice = f" What would distinguish them: {words}." if words else ""
        lines.append(f"indistinguishable on these records: {names}.{advice}")
    return lines


def unselected_tie_lines(diagnosis: Diagnosis) -> list[str]:
    """Groups of indistinguishable effects of which none is selected, as one line; none without any."""
    groups = [
        (f"{one.name}@{one.where}", *one.tied_with)
        for one in diagnosis.effects
        if one.tied_with and not one.selected
    ]
    known: list[set[str]] = [set(group) for group in diagnosis.ties]
    said = []
    for group in sorted(groups, key=len, reverse=True):  # each of a group names the others: it is said once
        if not any(larger.issuperset(group) for larger in known):
            known.append(set(group))
            said.append(", ".join(_at(*_member(member), diagnosis.model) for member in group))
    if not said:
        return []
    also = "also " if diagnosis.ties else ""
    return [
        f"{also}indistinguishable on these records, of effects that are not selected: {'; '.join(said)}. No experiment "
        "is proposed for these."
    ]


def experiment_lines(diagnosis: Diagnosis) -> list[str]:
    """The records that would together distinguish the models, as one line; none without ties."""
    if not diagnosis.experiments:
        if not diagnosis.ties or diagnosis.model.tree is None:
            return []
        return [
            "next experiment: none is proposed, for by every simulated command the joint would run away, or leave the "
            "range of these records by more than half of it; change the load, or how the joint stands."
        ]
    *_, best = diagnosis.experiments  # with all before it
    if not best.distinguishes:
        return [
            "next experiment: after no simulated commands would these models, fitted anew, differ by more than "
            f"{best.distance:.2g} times the errors that they leave (RMS); change the load, or how the joint stands."
        ]
    how = " by goals for its own controller" if best.by_controller else ""
    at: dict[int, dict[str, list[str]]] = {}
    for one in diagnosis.experiments:
        at.setdefault(one.joint, {}).setdefault(one.name, []).extend([one.posture] * bool(one.posture))
    records = "; ".join(
        f"{joint_words(f'joint{joint}', diagnosis.model)}{how}: "
        + "; ".join(
            f"{name}{f' ({joined(postures)})' if postures else ''}" for name, postures in names.items()
        )
        for joint, names in at.items()
    )
    if best.posture:
        records += "; in brackets where the other joints are held in the range that they have moved through"
    words = (
        f"next experiment, {count(len(diagnosis.experiments), 'record')} of {best.time[-1]:.0f} s at {records}. "
        f"Even fitted anew to them, these models would differ by {best.distance:.2g} times the errors that they leave "
        "(RMS)."
    )
    alike = "; ".join(
        " and ".join(_at(*_member(name), diagnosis.model) for name in pair) for pair in best.undistinguished
    )
    return [words + (f" They do not distinguish {alike}." if alike else "")]


def rejected_lines(diagnosis: Diagnosis, why: str = "improbable, or of a size that may be zero") -> list[str]:
    """Effects that the search accepted and that are not sure enough to be asserted, a line for each reason."""
    found: dict[str, list[str]] = {}
    for one, record in diagnosis.rejected.items():
        name, _, where = one.partition(" at ")
        found.setdefault(record, []).append(_at(name, where, diagnosis.model))
    return [
        f"rejected: {joined(words)}: {why}" + (f"; without record '{record}' no better." if record else ".")
        for record, words in found.items()
    ]


def failed_lines(diagnosis: Diagnosis) -> list[str]:
    """How many fits of the search failed, and why the most frequent ones did, as one line; none where all went well."""
    failed = diagnosis.tally.failed
    if not failed:
        return []
    parts = []
    for one, times in failed.most_common(2):
        effects = [_at(*name, diagnosis.model) for name in one.effects]
        names = joined(effects) if effects else "the nominal model"
        parts.append(f"{names}{f' ({times} times)' if times > 1 else ''}: {one.reason.rstrip('.')}")
    more = f"; and {len(failed) - 2} more kinds, in diagnosis.json" if len(failed) > 2 else ""
    return [
        f"{failed.total()} of {diagnosis.tally.tried} fits of candidates failed: {'; '.join(parts)}{more}."
    ]


def change_lines(diagnosis: Diagnosis) -> list[str]:
    """Which physical change explains the new values, as one line; none where the headline says it."""
    if not diagnosis.changes or diagnosis.verdict == "parameters_only":
        return []
    return [f"parameter values: {diagnosis.changes}"]


def varying_lines(diagnosis: Diagnosis) -> list[str]:
    """Between-record variation of parameters, as one line; none where one set explains all records."""
    if not diagnosis.varying:
        return []
    return [
        f"between-record variation (standard deviation): {joined(list(diagnosis.varying))}. `identify` gives a set for "
        "each record; draw a simulator's values from these."
    ]


def not_identifiable_lines(diagnosis: Diagnosis, most: int | None = None) -> list[str]:
    """Changes of parameters that these records do not identify, then signals that are confounded, a line each."""
    lines = [f"not identifiable: {words}." for words in diagnosis.not_identifiable[:most]]
    return lines + [f"confounded: {words}." for words in diagnosis.confounded[:most]]


def implausible_lines(diagnosis: Diagnosis, most: int | None = None) -> list[str]:
    """Parameters that the re-fit has moved beyond data-sheet tolerance, as one line; none where there is none."""
    if not diagnosis.implausible:
        return []
    shown = list(diagnosis.implausible[:most])
    more = len(diagnosis.implausible) - len(shown)
    words = ", ".join(shown) + (f" and {more} more" if more else "")
    why = (
        "their values were wrong, or a missing effect hides in them"
        if not diagnosis.selected
        else "the missing effect hides in them"
    )
    return [
        f"implausible parameters: the re-fit alone moves them beyond data-sheet tolerance, so {why}: {words}."
    ]


Moved = tuple[ParameterInfo, float, Sequence[float] | np.ndarray]
"""A parameter as the nominal model has it, its fitted value, and the ends of that value's interval."""


def moved_line(values: Iterable[Moved], channels: Sequence[Channel], most: int | None = None) -> list[str]:
    """Parameters whose intervals exclude the nominal value, the farthest moved first, as one line; none without any.

    Those that moved by less than nominal values are known to (2 %) are counted, and so are those after the first
    ``most``.
    """

    def share(one: Moved) -> float:
        return abs(one[1] - one[0].spec.value) / max(abs(one[0].spec.value), 1e-300)

    away = [one for one in values if not one[2][0] <= one[0].spec.value <= one[2][1]]
    far = [one for one in away if share(one) >= NOMINAL]
    if not far:
        return []
    far.sort(key=share, reverse=True)
    said = []
    for info, value, ends in far[:most]:
        unit, factor = shown_unit(info.spec.unit, channels)
        now = measured(factor * value, [factor * end for end in ends], unit)
        said.append(f"{named(info)} {now}, nominal {factor * info.spec.value:.4g}")
    more = [f"{len(far) - len(said)} others"] if len(far) > len(said) else []
    more += [f"{len(away) - len(far)} more by less than {100 * NOMINAL:g} %"] if len(away) > len(far) else []
    beside = f" (and {', '.join(more)})" if more else ""
    return [
        f"intervals exclude the nominal value: {'; '.join(said)}{beside}. Take fitted values that lie within "
        "data-sheet tolerance; others are suspect."
    ]


def moved_values(diagnosis: Diagnosis) -> Iterator[Moved]:
    """Parameters of the nominal model as the last fit has them, with the intervals of the table of parameters."""
    study, nominal = diagnosis.details.studies[-1], diagnosis.details.nominal
    known = {info.name: info for info in nominal.table}
    values = (study.selected_model.parameter(name).spec.value for name in study.names)
    for name, value, ends in zip(study.names, values, study.intervals(0), strict=True):
        if name in known and np.isfinite(ends).all():
            yield known[name], value, ends


def skew_lines(skews: Sequence[str]) -> list[str]:
    """Channels that a diagnosis has shifted, a line each: what was found, without what to do about it elsewhere."""
    return [f"{words.partition(';')[0]}: it was shifted for this diagnosis." for words in skews]


def extrapolation_lines(diagnosis: Diagnosis) -> list[str]:
    """Test records that go where no train record has been, where something is left or contradicts."""
    doubt = diagnosis.unknown or diagnosis.rejected or diagnosis.contradiction
    lines = diagnosis.extrapolation if doubt else ()
    return [
        f"extrapolation: {words}: the train records do not identify what acts there only." for words in lines
    ]


def caution_lines(diagnosis: Diagnosis, max_effects: int | None = None) -> list[str]:
    """What speaks against the re-fit, and against what remains being outside the catalogue."""
    nominal, refit, lines = diagnosis.nominal, diagnosis.refit, []
    worse = nominal is not None and refit is not None and refit.nrmse > WORSE * nominal.nrmse
    if worse and diagnosis.verdict != "no_gap":
        lines.append(
            "the re-fitted model predicts the test records worse than the nominal one: a train record may contradict "
            "the others; 'hybrid-id check' looks at each."
        )
    if diagnosis.unknown and max_effects is not None and len(diagnosis.selected) >= max_effects:
        lines.append("more effects at once were not looked for: give a larger --max-effects.")
    return lines


# ---- words ----


def value_lines(diagnosis: Diagnosis) -> list[str]:
    """Parameters of the selected effects with their intervals, a line each."""
    level = diagnosis.details.studies[-1].level
    return [
        f"{words_of(one.name)} ({joint_words(one.where, diagnosis.model)}, {place_words(one.where)}; "
        f"{100 * level:g} % intervals): "
        f"{', '.join(values)}."
        for one in diagnosis.selected
        if (values := values_of(diagnosis, one))
    ]


def values_of(diagnosis: Diagnosis, one: RatedEffect) -> list[str]:
    """Parameters of a selected effect as ``total play gap 0.012 (0.0116 to 0.0124) rad``.

    The interval is that of ``identify``, as in the table of parameters.
    """
    infos, study, found = brought(diagnosis.model, one.name, one.where), diagnosis.details.studies[-1], []
    intervals = dict(zip(study.names, study.intervals(0), strict=True))
    for symbol, (value, _) in one.parameters.items():
        if info := infos.get(symbol):
            unit, factor = shown_unit(info.unit, study.outputs)
            ends = None if info.name not in intervals else factor * intervals[info.name]
            found.append(f"{called(info)} {measured(factor * value, ends, unit)}")
    return found


def called(info: ParameterInfo) -> str:
    """A parameter's meaning and symbol, one where both are the same."""
    return info.doc if info.doc == info.symbol else f"{info.doc} {info.symbol}"


def measured(value: float, interval: Sequence[float] | np.ndarray | None, unit: str) -> str:
    """A value with its interval and unit; what is held has no interval, what is not identified says so."""
    sure = ""
    if interval is not None:
        words = interval_words(*interval)
        sure = " (not identified)" if words == "none" else f" ({words})"
    return f"{value:.4g}{sure}{'' if unit == '1' else f' {unit}'}"


def errors_by_name(diagnosis: Diagnosis) -> dict[str, Errors]:
    """Errors on the test records by the name of the model, as far as there are any."""
    corrected = {"corrected": diagnosis.with_effect} if diagnosis.corrected else {}
    found = {"nominal": diagnosis.nominal, "re-fitted": diagnosis.refit} | corrected
    return {name: errors for name, errors in found.items() if errors is not None}


def words_of(name: str) -> str:
    """An effect's name as people write it."""
    return name.replace("_dependent", "-dependent").replace("_", " ").replace("stribeck", "Stribeck")


def _member(tie: str) -> tuple[str, str]:
    """``name@where`` of a tie."""
    name, _, where = tie.partition("@")
    return name, where


def _at(name: str, where: str, system: System) -> str:
    """An effect with its place; ``name@where and name@where`` of models with several more effects."""
    if " and " in where:
        first, _, rest = where.partition(" and ")
        return f"{_at(name, first, system)} with {_at(*_member(rest), system)}"
    return f"{words_of(name)} ({joint_words(where, system)}, {spot_words(name, where, system)})"


def spot_words(name: str, where: str, system: System) -> str:
    """Where an effect acts: at a body or point of a robot's description, or at its place of the joint."""
    kinds = effect(name).kinds if name in CATALOGUE else ()
    parts = (system.components[key] for kind in kinds if (key := f"{where}/{kind}") in system.components)
    point = next((point for part in parts if (point := getattr(part, "point", ""))), "")
    return f"at '{point}'" if point else place_words(where)


def joint_words(where: str, system: System) -> str:
    """``joint1/motor`` -> ``joint 1``, or as the description of a robot calls that joint."""
    joint = where.split("/")[0]
    if system.tree is None:
        return joint.replace("joint", "joint ")
    return system.tree.names[int(joint.removeprefix("joint")) - 1]


def side_words(joint: str, place: str, system: System) -> str:
    """``joint1``, ``load`` -> ``joint 1, link side``; a joint whose sides move alike has none."""
    words = joint_words(joint, system)
    return f"{words}, {SIDES[place]}" if place in SIDES else words


def place_words(where: str) -> str:
    """``joint1/transmission`` -> ``in the gear``."""
    return PLACES.get(where.split("/")[-1], where)


def percent(share: float) -> str:
    """A share as it is printed."""
    return f"{round(100 * min(share, 1.0))} %"


def share_words(one: RatedEffect, *more: str) -> str:
    """The share of an effect that has one, its interval where that says more, and more words beside it."""
    beside = list(more)
    if one.share is not None and one.share_interval is not None:
        between = range_percent(one.share_interval)
        beside[:0] = [between] if between != range_percent((one.share, one.share)) else []
    return percent(one.share or 0.0) + (f" ({'; '.join(beside)})" if beside else "")


def range_percent(interval: Interval) -> str:
    """An interval of a share as it is printed; a share lies between 0 and 1."""
    low, high = (100 * min(max(end, 0.0), 1.0) for end in interval)
    return f"{low:.0f}-{high:.0f} %"


def joined(words: Sequence[str], last: str = "and") -> str:
    """A list as people say it."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} {last} {words[-1]}"
