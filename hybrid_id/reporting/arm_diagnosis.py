"""The diagnosis of a robot: the headline, which joint lacks what, and how well the whole robot is simulated then."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure
from rich.table import Table

from hybrid_id.diagnosis.arm import NOT_ASKED, STOPPED, ArmDiagnosis, CommonSize
from hybrid_id.diagnosis.coupled_gear import CoupledGear
from hybrid_id.diagnosis.errors_on_test import Errors
from hybrid_id.diagnosis.grade import NEGLIGIBLE, RatedEffect
from hybrid_id.diagnosis.whole_robot import brought_to
from hybrid_id.records.dataset import Channel
from hybrid_id.records.quality import Finding
from hybrid_id.records.units import number_of, stem
from hybrid_id.reporting import diagnosis_words as say
from hybrid_id.reporting.diagnosis_figures import MAX_NAME, errors_by_row
from hybrid_id.reporting.page import Page, records_section
from hybrid_id.reporting.style import journal, new_figure, pixels, shortened
from hybrid_id.reporting.tables import capital, count, interval_words, table
from hybrid_id.reporting.units import geared, in_unit, shown_unit
from hybrid_id.systems.by_joint import part_with

PAGE = "report.html"
MOVED = 6
"""Parameters of a robot, of those that moved, which are listed."""
_VERDICTS = {
    "parameters_only": "nothing; other values",
    "no_gap": "nothing",
    "outside_catalogue": "something outside the catalogue",
    "inconclusive": "inconclusive",
}
_REJECTED = "improbable, of a size that may be zero, or no help beside values of each record's own"
_DIFFERS = "nothing; values differ from record to record"
_HOW = (
    "Each joint is searched by itself while the others move as they were measured. What acts on all joints, as a floor "
    "does, and what a joint's records cannot distinguish is judged with all joints simulated. Where two neighbours "
    "lack something, a gear is tried by which a motor turns with both. As far as something remains at a joint, what is "
    "named there may be the image of something else, which lowers its probability. Last, the re-fitted and the "
    "corrected robot are fitted once more as a whole, driven by commands alone, and the test records measure them."
)
_PART = (
    "The gap is what the nominal model leaves of the train records after a re-fit, beyond noise and what other values "
    "in each record explain: mean squares, each joint's relative to how far it moves, the others moving as measured. "
    "One joint often has nearly all of it, for a third of another's error is a ninth of its part. The interval of a "
    "share holds what it would be if other joints' gaps were larger or none. RMSE is of all joints simulated, so that "
    "what mends one joint may lower the errors of others."
)
_LEFT = "Parts of the gap are of what the coupled gear leaves: what it explains is in none of them."
_OF_ALL = (
    "These values are of the fit of all joints at once, as in model.yaml here. A joint's own page and folder have "
    "those of the joint by itself, driven by the others' measured motion with its noise, so that the two differ."
)
_OF_EACH = (
    "These values are those of each joint by itself: there is no fit of all joints at once that errs less."
)
_CAPTION = (
    "RMSE on the test records, all joints simulated from their commands, of the nominal, the re-fitted and the "
    "corrected robot, joint by joint."
)


def arm_headline(found: ArmDiagnosis) -> str:
    """What the diagnosis states of the whole robot, what is known first."""
    large, small, _ = _by_size(found)
    of = "the gap of the joints that were diagnosed" if found.skipped else "the gap"
    of = f"what the gear{'s' if len(found.gears) > 1 else ''} leaves of {of}" if found.gears else of
    if found.selected:
        said = [
            f"{say.words_of(one.name)} at {_joint(one)}{' explains' if k == 0 else ''} "
            f"{say.share_words(one, say.sure_words(one))}"
            for k, (one, _, _) in enumerate(large)
        ]
        sentence = f"{capital(say.joined(said))} of {of}; " if said else f"No effect explains 0.5 % of {of}; "
        rest = found.remainder
        sentence += (
            f"{say.percent(rest)} remains unexplained."
            if rest >= NEGLIGIBLE
            else "nothing structural remains."
        )
        if found.unknown:
            there = say.joined(found.joints_with_unknown)
            sentence += (
                f" What remains at {there} has a cause that the catalogue lacks, or several small ones."
            )
        if small:
            said = [
                f"{say.words_of(one.name)} at {_joint(one)} ({say.percent(own.share or 0.0)} of that joint's own gap; "
                f"{say.sure_words(one)})"
                for one, own, _ in small
            ]
            sentence += f" Of less than 0.5 % of the robot's gap each: {say.joined(said)}."
    else:
        sentence = _nothing_named(found)
    if found.interrupted:
        lacking = STOPPED in found.skipped.values() or any(one.interrupted for one in found.joints.values())
        what = "not all joints were diagnosed to the end" if lacking else "what all joints say together lacks"
        sentence += f" The search was interrupted: {what}."
    sentence = " ".join([*map(gear_words, found.gears), sentence])
    return f"{sentence} {found.contradiction}".rstrip() if found.selected or found.gears else sentence


def gear_words(one: CoupledGear) -> str:
    """A gear that the model lacks, in a sentence."""
    turns = say.measured(one.turns, _ends(one.turns, one.std), "1")
    return (
        f"The motor of {one.motor} turns with {one.joint}, too: {turns} turns behind its own gear for one of that "
        f"joint (probability {one.probability:.2f}). With such a coupled gear, which the model lacks, the mean square "
        f"of both joints' errors on records left out falls by {say.percent(one.share)}."
    )


def part_words(found: ArmDiagnosis, joint: str) -> str:
    """What the page of a joint's own diagnosis says first, where a gear was found there; empty elsewhere."""
    gear = next((one for one in found.gears if joint == part_with(found.model, one.motor)), None)
    return "" if gear is None else f"{gear_words(gear)} Here the nominal model has it."


def _ends(value: float, std: float) -> tuple[float, float] | None:
    return (value - 1.96 * std, value + 1.96 * std) if std < float("inf") else None


Rated = tuple[RatedEffect, RatedEffect, str]
"""An effect as the robot and as its joint by itself has it, and that joint's name."""


def _joint(one: RatedEffect) -> str:
    """The joint at which an effect of the robot acts, of a coupled gear's joints the one."""
    return one.where.rpartition("/")[0]


def _by_size(found: ArmDiagnosis) -> tuple[list[Rated], list[Rated], list[Rated]]:
    """The selected effects: of the robot's gap, of hardly more than their joint's own, and of next to nothing."""
    named = [one for one in found.rated() if one[0].selected]
    large = [one for one in named if not one[0].negligible]
    small = [one for one in named if one[0].negligible and not one[1].negligible]
    return large, small, [one for one in named if one[0].negligible and one[1].negligible]


def _nothing_named(found: ArmDiagnosis) -> str:
    any_joint = "any joint that was diagnosed" if found.skipped else "any joint"
    gap = "what the gear leaves" if found.gears else "the gap"
    if found.interrupted:
        beside = "Beside it" if found.gears else "Inconclusive:"
        return f"{beside} no effect had been accepted at {any_joint}."
    there = [joint for joint, one in found.joints.items() if one.verdict == found.of_joints]
    if found.of_joints == "outside_catalogue":
        return (
            f"No effect of the catalogue surely explains any of {gap}, and something structural remains at "
            f"{say.joined(there)}."
        )
    if found.of_joints == "parameters_only":
        values = "Other" if found.gears else "Wrong"
        at = say.joined(there)
        return f"{values} parameter values explain {gap} at {at}, and no effect is missing at {any_joint}."
    if found.of_joints == "no_gap":
        further = " further" if found.gears else ""
        surely = "predicts records left out surely better than the model"
        return f"There is no{further} gap: no effect at {any_joint} {surely}."
    return say.headline(found.joints[there[0]])


def lacks(found: ArmDiagnosis, joint: str) -> str:
    """What a joint lacks, in words."""
    one = found.joints[joint]
    with_gear = bool(part_words(found, joint))
    if not one.selected:
        rest = _DIFFERS if one.varying else _VERDICTS[one.verdict]
        return f"a coupled gear; beside it {rest}" if with_gear else rest
    several = len(one.model.joints) > 1  # of a coupled gear
    return ("a coupled gear; " if with_gear else "") + "; ".join(
        f"{say.words_of(e.name)}{' or what looks like it' if e.tied_with else ''}"
        f"{f' of {say.joint_words(e.where, one.model)}' if several else ''}, "
        f"{say.spot_words(e.name, e.where, one.model)}"
        for e in say.asserted(one)
    )


def joints_table(found: ArmDiagnosis) -> Table:
    """A row a joint: its part of the gap, what it lacks, how surely, what remains, and its errors.

    Below them those that were left out, with the reason; but for those that nobody has asked for.
    """
    part = "part of what the gear leaves>" if found.gears else "part of the gap>"
    heads = ["joint", "lacks", part, "share of the joint's own gap>", "probability>", "unexplained>"]
    if models := _models(found):
        heads += [*(f"RMSE {name}>" for name in models), "unit"]
    rows = []
    for joint, share in sorted(found.parts.items(), key=lambda item: -item[1]):
        one = found.joints[joint]
        sure = "; ".join(f"{e.together:.2f}" for e in say.asserted(one))
        explained = "; ".join(map(say.share_words, say.asserted(one)))
        left = say.percent(one.remainder) if one.verdict in ("effects", "outside_catalogue") else ""
        of_all = say.percent(share) if len(found.parts) > 1 else ""  # of the other joints nothing is known
        own = (lacks(found, joint), of_all, explained, sure, left)
        rows.append((joint, *own, *_errors_cells(found, joint)))
    rows += [
        (joint, f"not diagnosed: {why}", *[""] * (len(heads) - 2))
        for joint, why in found.skipped.items()
        if why != NOT_ASKED
    ]
    made = table(heads, rows)
    made.columns[0].no_wrap = True  # the name of a joint stays whole, where there is room for it at all
    return made


def _models(found: ArmDiagnosis) -> dict[str, Errors]:
    """Errors of the robot on the test records by the model's name; the corrected one where an effect is asserted."""
    every = {"nominal": found.nominal_errors, "re-fitted": found.refit_errors} | (
        {"corrected": found.model_errors} if found.selected or found.gears else {}
    )
    return {name: errors for name, errors in every.items() if errors is not None}


def _errors_cells(found: ArmDiagnosis, joint: str) -> list[str]:
    """RMSE of a joint on the test records by each model, all joints simulated, and the unit, which was logged.

    Values of several outputs of the joint stand one after the other.
    """
    models, one = _models(found), found.joints[joint].details
    if not models:
        return []
    rows = [
        in_unit(c.name, [each.rmse[c.name] for each in models.values()], one.dataset.outputs, one.nominal)
        for c in one.dataset.outputs
        if all(c.name in each.rmse for each in models.values())
    ]
    return ["; ".join(cells) for cells in zip(*rows, strict=True)] if rows else [""] * (len(models) + 1)


def error_lines(found: ArmDiagnosis) -> list[str]:
    """Errors of the whole robot on the test records, and the shrink."""
    nominal, gap = found.nominal_errors, found.shrink
    if nominal is None or gap is None:
        return [f"{say.unmeasured(found.dataset)}."]
    corrected = f", corrected {gap.with_effect:.3g}" if found.selected or found.gears else ""
    anew = "" if found.horizon.kind == "whole" else f" in {found.horizon.length}"
    lines = [
        f"NRMSE on {count(len(nominal.by_record), 'test record')}, all joints simulated from their commands{anew}, "
        f"mean of the joints: nominal {nominal.nrmse:.3g}, re-fitted {gap.refit:.3g}{corrected}; "
        f"noise floor {gap.floor:.3g}."
    ]
    if gap.refit > nominal.nrmse:
        lines.append(
            "The re-fit of the train records predicts the test records worse than the nominal values: they do not "
            "determine all parameters."
        )
    if found.selected or found.gears:
        lines.append(say.shrink_line(gap))
    if halting := [joint for joint, one in found.joints.items() if one.rest_differs]:
        lines.append(say.rest_line(f" at {say.joined(halting)}"))
    return lines


def remark_lines(found: ArmDiagnosis) -> list[str]:
    """Sizes of the effects, what several joints have in common, values that moved far, and joints not asked for."""
    large, small, _ = _by_size(found)
    sizes = [
        f"{_joint(one)}: {say.words_of(one.name)}, {', '.join(values)}."
        for one, own, joint in (*large, *small)
        if (values := _sizes(found, one, own, joint))
    ]
    lines = [*sizes, *([_OF_ALL if found.estimates else _OF_EACH] if sizes else [])]
    lines += [common_words(one, found.dataset.outputs) for one in found.common]
    for joint, one in found.joints.items():
        lines += [f"{joint}, fitted by itself: {one.changes.removesuffix('.')}."] if one.changes else []
        more = (*say.rejected_lines(one, _REJECTED), *say.implausible_lines(one), *say.failed_lines(one))
        lines += [f"{joint}: {line}" for line in more]
    lines += [
        f"{joint}: values differ from record to record (friction of another day, say), {say.joined(list(one.varying))} "
        "(standard deviation); values of each record's own leave noise."
        for joint, one in found.joints.items()
        if one.varying
    ]
    for joint, groups in found.tied.items():
        one = found.joints[joint]
        more = (*say.tie_lines(replace(one, ties=groups), brief=True), *say.experiment_lines(one))
        lines += [f"{joint}: {line}" for line in more]
    # what acts on all joints, which each of them carries, comes once
    nominal = {info.name: info for one in found.joints.values() for info in one.details.nominal.table}
    fitted = [(info, *found.estimates.get(name, (0.0, 0.0))) for name, info in nominal.items()]
    moved = [(info, value, _ends(value, std)) for info, value, std in fitted if std > 0.0]
    lines += say.moved_line(((i, v, e) for i, v, e in moved if e is not None), found.dataset.outputs, MOVED)
    left = [joint for joint, why in found.skipped.items() if why == NOT_ASKED]
    if beside := [f"{say.words_of(one.name)} at {_joint(one)}" for one, _, _ in _by_size(found)[2]]:
        lines.append(f"also fitted, negligible (less than 0.5 % of any gap): {say.joined(beside)}.")
    return lines + ([f"not diagnosed: {say.joined(left)} ({NOT_ASKED})."] if left else [])


def _sizes(found: ArmDiagnosis, one: RatedEffect, own: RatedEffect, joint: str) -> list[str]:
    """Parameters of an effect in the corrected robot, with 95 % intervals where its fit tells them.

    Beside a value stands the joint's own where that lies outside the interval.

    Args:
        found: the diagnosis.
        one: the effect as the robot has it.
        own: the effect as the joint by itself has it.
        joint: its name.
    """
    infos, said = brought_to(found.model, (own.name, own.where), found.joints[joint].model), []
    outputs = found.joints[joint].details.dataset.outputs
    for symbol, (value, std) in one.parameters.items():
        if (info := infos.get(symbol)) is None:
            continue
        unit, factor = shown_unit(info.unit, outputs)
        known = info.name in found.estimates and std > 0.0
        ends = _ends(factor * value, factor * std) if known else None
        alone = factor * own.parameters[symbol][0]
        beside = f" [by itself {alone:.4g}]" if ends and not ends[0] <= alone <= ends[1] else ""
        said.append(f"{say.called(info)} {say.measured(factor * value, ends, unit)}{beside}")
    return said


def common_words(one: CommonSize, outputs: Sequence[Channel]) -> str:
    """Whether a parameter of an effect that several joints have is the same at all of them.

    Args:
        one: the parameter.
        outputs: of the records, whose unit an angle is shown in.
    """
    shown, factor = shown_unit(one.unit, outputs)
    unit = "" if shown == "1" else f" {shown}"
    what = f"{say.words_of(one.effect)} of {say.joined(list(one.joints))}: {one.symbol}"
    if not one.common:
        return f"{what} differs from joint to joint (chance {one.chance:.1g})."
    value, std = factor * one.value, factor * one.std
    ends = interval_words(value - 1.96 * std, value + 1.96 * std)
    return f"{what} may be one for all of them, {value:.4g} ({ends}){unit}."


def arm_figures(found: ArmDiagnosis) -> dict[str, np.ndarray]:
    """Every picture by the name of its file."""
    return {"joints": pixels(joints_figure(found))} if found.model_errors is not None else {}


@journal()
def joints_figure(found: ArmDiagnosis) -> Figure:
    """RMSE of each joint's angles, seen at the joint, on the test records, of the three models."""
    models = _models(found)
    names = () if found.model.tree is None else found.model.tree.names
    every = [] if found.refit_errors is None else list(found.refit_errors.rmse)
    outputs = [one for one in every if stem(one) in ("q_a", "q_m")]  # speeds have another unit
    shown = {one: 1e3 / (geared(one, found.model) or 1.0) for one in outputs}
    figure = new_figure(0.27 * len(outputs) + 1.0)
    axes = figure.subplots()
    numbers = [number_of(output) for output in outputs]
    labels = [
        shortened(names[int(number) - 1], MAX_NAME)
        + (", motor" if numbers.count(number) > 1 and stem(output) == "q_m" else "")
        for output, number in zip(outputs, numbers, strict=True)
    ]
    values = {
        name: [shown[output] * errors.rmse[output] for output in outputs] for name, errors in models.items()
    }
    errors_by_row(axes, labels, values)
    axes.set_xlabel("RMSE on the test records [1e-3 rad or m]")
    return figure


def arm_page(
    found: ArmDiagnosis,
    figures: Mapping[str, np.ndarray],
    pages: Mapping[str, str],
    *,
    findings: Sequence[Finding] = (),
) -> Page:
    """The page of the whole robot.

    Args:
        found: the result.
        figures: its pictures by name.
        pages: where each joint's own page is, as seen from this one.
        findings: what the check of the records remarked.
    """
    page = Page(f"Diagnosis of {found.case}", arm_headline(found))
    joints = page.section("Joints").add(joints_table(found))
    joints.note(*([_LEFT] if found.gears else []), _PART)
    if pages:
        joints.links("Each joint's own page:", pages)
    joints.add(*remark_lines(found)).note(_HOW)
    tests = page.section("Test records").add(*map(capital, error_lines(found)))
    if "joints" in figures:
        tests.figure(figures["joints"], _CAPTION)
    records_section(page, found.dataset, findings).note(*say.skew_lines(found.skews))
    return page
