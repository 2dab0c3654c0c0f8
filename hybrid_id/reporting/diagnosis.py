"""A diagnosis as tables, as text of one page and as an HTML page: the headline first, then what it rests on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from hybrid_id.diagnosis.criteria import CRITERIA
from hybrid_id.diagnosis.result import LIKELY, Diagnosis
from hybrid_id.errors import InputError
from hybrid_id.records.quality import Finding
from hybrid_id.reporting import diagnosis_words as say
from hybrid_id.reporting.page import Page, Section, records_section
from hybrid_id.reporting.residuals import residual_blocks
from hybrid_id.reporting.study import LEGEND, combinations_table, reliability_cells
from hybrid_id.reporting.tables import capital, interval_words, table
from hybrid_id.reporting.units import shown_unit
from hybrid_id.systems.by_joint import with_joint_names
from hybrid_id.systems.chain import System

TOP = 4
"""Effects that the terminal shows."""


def diagnosis_table(diagnosis: Diagnosis, max_effects: int | None = None) -> RenderableType:
    """What the terminal shows of a diagnosis; ``max_effects`` is how many a search could add."""
    parts: list[RenderableType] = [Text(say.headline(diagnosis), style="bold")]
    parts += map(Text, say.error_lines(diagnosis))
    parts += [Text(line) for line in (say.where_line(diagnosis), say.disturbance_line(diagnosis)) if line]
    parts.append(effects_table(diagnosis, TOP))
    parts += map(Text, say.value_lines(diagnosis))
    remarks = (
        *say.tie_lines(diagnosis, brief=True)[:2],
        *say.varying_lines(diagnosis),
        *say.change_lines(diagnosis),
        *say.rejected_lines(diagnosis),
        *say.experiment_lines(diagnosis),
        *say.implausible_lines(diagnosis, 4),
        *say.not_identifiable_lines(diagnosis, 1),
        *say.extrapolation_lines(diagnosis)[:1],
        *say.failed_lines(diagnosis),
        *say.caution_lines(diagnosis, max_effects),
    )
    parts += [Text(line, style="yellow") for line in remarks]
    parts += [Text(line) for line in (say.thinned_line(diagnosis),) if line]
    return Group(*parts)


def effects_table(diagnosis: Diagnosis, most: int | None = None) -> Table:
    """The effects that were tried (the first ``most``): the selected ones by share, then the others by probability."""
    tied, rows = {member for group in diagnosis.ties for member in group}, []
    told = say.asserted(diagnosis)
    for one in diagnosis.effects[:most]:
        others = "indistinguishable" if f"{one.name}@{one.where}" in tied else ""
        rows.append(
            (
                say.words_of(one.name), "" if one.share is None else say.share_words(one),
                f"{one.probability:.3f}",
                f"{say.joint_words(one.where, diagnosis.model)}, {say.place_words(one.where)}",
                Text(others) if not one.selected else Text("selected", style="green") if one in told else "negligible",
            )
        )  # fmt: skip
    return table(("effect", "share of the gap>", "probability>", "where", "status"), rows)


def parameters_table(diagnosis: Diagnosis) -> Table:
    """Every estimated parameter in the nominal, the re-fitted and the corrected model, with intervals."""
    nominal, studies = diagnosis.details.nominal, diagnosis.details.studies
    last = studies[-1]
    heads = [h for name in diagnosis.fitted for h in (f"{name}>", f"{name}, {100 * last.level:g} %>")]
    rows = []
    models = (nominal, *(one.selected_model for one in studies))
    infos = {i.name: i for model in models for i in model.table if i.spec.estimate}
    for name, info in infos.items():
        unit, factor = shown_unit(info.unit, last.outputs)
        cells = []
        for one in studies:
            known = name in one.names
            ends = factor * one.intervals(0)[one.names.index(name)] if known else ()
            cells += [_value(one.selected_model, name, factor), interval_words(*ends) if known else ""]
        word, *more = reliability_cells(last, name) if name in last.names else [""]
        rows.append((name, word, _value(nominal, name, factor), *cells, unit, info.doc, *more))
    judged = ("unit", "meaning", "lower bound>", "upper bound>", "why")
    return table(("parameter", "reliability", "nominal>", *heads, *judged), rows)


def _value(system: System, name: str, factor: float) -> str:
    try:
        return f"{factor * system.parameter(name).spec.value:.4g}"
    except InputError:
        return ""


_TORQUES = ("missing_torque", "torque_map")
"""Pictures of what is missing: beside the sentence that names it, the effects or else the place."""
SHOWN = 6
"""Effects that the table shows at least."""
_HOW = (
    "Share: fall of the mean square error on records left out when the effect is added in the stated order, over the "
    "gap (that of the re-fitted model less the noise floor). Each record is left out in turn, or validation records "
    "choose; finalists are fitted again without the records that judge them. A probability is that of the effect being "
    "at work at this place, so probabilities need not sum to one. The test records measure, and decide nothing."
)
_BASE_RATE = (
    f"Where a robot lacks something, every effect that its records do not exclude has at least {CRITERIA.base_rate:g}: "
    "real machines have many small ones."
)
_NOWHERE = (
    f"No torque over one signal explains {say.percent(say.LEAST_SHARE)} of the re-fitted residual or more."
)
_TIED = "Some are indistinguishable on these records: see Ties and next experiment."
_NO_TIES = "Nothing is indistinguishable, so no experiment is proposed."
_INTERVALS = (
    "Intervals and reliability are those that identify would give the same fit. A parameter without an interval is "
    "identified only together with others, or lies at a bound; the standard errors in "
    "diagnosis.json leave that out of account."
)
_BY_ITSELF = (
    "These values are of this joint by itself, the others moving as they were measured. The robot's page and its "
    "model.yaml have those of the fit of all joints at once, where that errs less."
)
_CAPTIONS = {
    "shares": "How the gap divides, on records left out: what each effect explains when it is added in this order, and "
    "what remains. The line: 95 % interval.",
    "gap": "NRMSE of free runs over the test records (1: as good as the signal's mean), and record by record. Dashed: "
    "the noise floor.",
    "missing_torque": "The torque that would explain the residual, over the signals that explain most; above each "
    "panel the part of the mean square that it explains on records left out. Where only voltage and angle were "
    "recorded, torques are known up to the factor that the nominal values fix.",
    "location": "Part of the residual of each model that a torque over one signal, at one side of a joint, explains on "
    "records left out. The rows overlap: speed, angle and command go together in most records.",
    "torque_map": "The missing torque over angle and speed, and above it its part of the residual on records left out "
    "(chance: none). What changes along the speed is friction or the motor, what changes along the angle a load or the "
    "gear; a step at speed 0 is dry friction. What the model's own parameters could do is not shown. A right model's "
    "map is without colour.",
    "reversals": "Error of free runs after the joint has reversed, mean of all reversals with its standard error; "
    "positive where the machine is ahead in its new direction. Play, stiction and friction with memory begin anew at "
    "each reversal, so they show here; a right model stays at 0, about.",
    "worst_record": "The test record that is predicted worst: measured, simulated in open loop, and the residuals.",
}
_NO_TEST = (
    "The first train record (no record is a test): measured, simulated in open loop, and the residuals."
)


def diagnosis_page(
    diagnosis: Diagnosis,
    figures: Mapping[str, np.ndarray],
    *,
    max_effects: int | None = None,
    findings: Sequence[Finding] = (),
    robot: str = "",
    beside: str = "",
) -> Page:
    """The page.

    Args:
        diagnosis: the result.
        figures: its pictures by name.
        max_effects: how many effects the search could add.
        findings: what the check of the records remarked.
        robot: where the page of the robot is that this is one joint of, as seen from this one; empty without.
        beside: what else that robot's diagnosis has found of these joints, in sentences.
    """
    dataset, details = diagnosis.details.dataset, diagnosis.details
    model = diagnosis.model
    names = say.joined([say.joint_words(joint.name, model) for joint in model.joints])
    by_itself = f", {names}" if model.seats else ""
    page = Page(f"Diagnosis of {diagnosis.case}{by_itself}", f"{beside} {say.headline(diagnosis)}".lstrip())
    captions = _CAPTIONS | ({} if diagnosis.with_effect else {"worst_record": _NO_TEST})

    def picture(section: Section, *names: str) -> None:
        for name in names:
            if name in figures:
                section.figure(figures[name], captions[name])

    effects = page.section("Effects")
    if robot:
        effects.links("The other joints, and all of them simulated at once:", {"the whole robot": robot})
    picture(effects, "shares")
    shown = max(sum(one.selected or one.probability >= LIKELY for one in diagnosis.effects), SHOWN)
    effects.add(effects_table(diagnosis, shown), *map(capital, say.value_lines(diagnosis)))
    picture(effects, *(_TORQUES if diagnosis.selected else ()))
    remarks = (
        *say.varying_lines(diagnosis),
        *say.rejected_lines(diagnosis),
        *say.extrapolation_lines(diagnosis),
        *say.failed_lines(diagnosis),
        *say.caution_lines(diagnosis, max_effects),
    )
    effects.add(*map(capital, remarks))
    if others := sorted({say.words_of(one.name) for one in diagnosis.effects[shown:]}):
        effects.add(capital(f"also tried, none of them more probable: {', '.join(others)}."))
    if diagnosis.ties:
        effects.add(Text(_TIED, style="yellow"))
    effects.add(f"{_HOW} {_BASE_RATE}" if robot else _HOW)
    location = page.section("Location").add(capital(say.where_line(diagnosis) or _NOWHERE))
    picture(location, *(() if diagnosis.selected else _TORQUES))
    if words := say.disturbance_line(diagnosis):
        location.add(capital(words))
    picture(location, "location", "reversals")
    tests = page.section("Test records").add(*map(capital, say.error_lines(diagnosis)))
    picture(tests, "gap", "worst_record")
    page.section("Parameters").add(
        *([diagnosis.changes] if diagnosis.changes else []),
        *map(capital, say.implausible_lines(diagnosis)),
        *map(capital, say.moved_line(say.moved_values(diagnosis), dataset.outputs)),
        *map(capital, say.not_identifiable_lines(diagnosis)),
        parameters_table(diagnosis),
        *combinations_table(details.studies[-1]),
        *([_BY_ITSELF] if robot else []),
        _INTERVALS,
        LEGEND,
    )
    channels = with_joint_names((*dataset.outputs, *dataset.inputs), model)
    page.section("Residuals").add(*residual_blocks(details.residual_tests, dataset, channels))
    ties = [*say.tie_lines(diagnosis), *say.experiment_lines(diagnosis), *say.unselected_tie_lines(diagnosis)]
    page.section("Ties and next experiment").add(*map(capital, ties or [_NO_TIES]))
    thinned = filter(None, [say.thinned_line(diagnosis)])
    records_section(page, dataset, findings).add(*map(capital, (*thinned, *say.skew_lines(diagnosis.skews))))
    return page
