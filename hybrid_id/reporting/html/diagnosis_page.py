"""A diagnosis as one page: the headline first, then what it rests on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rich.text import Text

from hybrid_id.diagnosis.result import Diagnosis
from hybrid_id.records.finding import Finding
from hybrid_id.reporting.diagnosis import effects_table, parameters_table
from hybrid_id.reporting.diagnosis_words import (
    LEAST_SHARE,
    UNLIKELY,
    capital,
    caution_lines,
    disturbance_line,
    error_lines,
    experiment_lines,
    extrapolation_lines,
    headline,
    implausible_lines,
    not_identifiable_lines,
    percent,
    rejected_lines,
    tie_lines,
    value_lines,
    varying_lines,
    where_line,
    words_of,
)
from hybrid_id.reporting.html.interactive import Drawn
from hybrid_id.reporting.html.page import Page, Section
from hybrid_id.reporting.parameter_tables import GRADES, combinations_table
from hybrid_id.reporting.residual_words import residual_blocks
from hybrid_id.reporting.tables import count, findings_list, records_table

SHOWN = 6
"""Effects that the table shows at least."""
_HOW = (
    "Share: fall of the mean square error on records left out when the effect is added in the stated order, over the "
    "gap (that of the re-fitted model less the noise floor). Each record is left out in turn, or validation records "
    "choose; finalists are fitted again without the records that judge them. A probability is that of the effect being "
    "at work at this place, so probabilities need not sum to one. The test records measure, and decide nothing."
)
_NOWHERE = (
    f"No torque over one signal explains {percent(LEAST_SHARE)} of the residual before (re-fitted model)."
)
_TIED = "Some are indistinguishable on these records: see Ties and next experiment."
_NO_TIES = "Nothing is indistinguishable, so no experiment is proposed."
_INTERVALS = (
    "Intervals and reliability are those that identify would give the same fit. A parameter without an interval is "
    "identified only together with others, or lies at a bound; the standard errors in "
    "diagnosis.json leave that out of account."
)
_CAPTIONS = {
    "shares": "How the gap divides, on records left out: what each effect explains when it is added in this order, and "
    "what remains. Black: 95 % interval.",
    "gap": "NRMSE of free runs over the test records (1: as good as the signal's mean), and record by record. Dashed: "
    "the noise floor.",
    "missing_torque": "The torque that would explain what the model leaves, over the signals that explain most; above "
    "each panel the part of the mean square that it explains on records left out. Where only voltage and angle were "
    "recorded, torques are known up to the factor that the nominal values fix.",
    "location": "Part of what each model leaves that a torque over one signal, at one side of a joint, explains on "
    "records left out. The rows overlap: speed, angle and command go together in most records.",
    "candidates": "Left: RMS error on records left out with one effect added, over the re-fitted model's. Right: "
    "probability.",
    "torque_map": "The missing torque over angle and speed, where the records have been; above each map the part of "
    "what the model leaves that such a torque explains on records left out (chance: none). What changes along the "
    "speed is friction or the motor, what changes along the angle a load or the gear; a step at speed 0 is dry "
    "friction. What the model's own parameters could do (a slope over the speed, say) is not shown. A right model's "
    "map is pale.",
    "reversals": "Error of free runs after the joint has reversed, mean of all reversals in all records with its "
    "standard error; positive where the machine is ahead in its new direction. Play, stiction and friction with memory "
    "begin anew at each reversal, so they show here; a right model stays at 0, about.",
    "worst_record": "The test record that is predicted worst: measured, simulated in open loop, and the residuals.",
}
_NO_TEST = (
    "The first train record (no record is a test): measured, simulated in open loop, and the residuals."
)


def diagnosis_page(
    diagnosis: Diagnosis,
    figures: Mapping[str, Drawn],
    *,
    reach: float,
    level: float,
    max_effects: int | None = None,
    findings: Sequence[Finding] = (),
) -> Page:
    """The page.

    Args:
        diagnosis: the result.
        figures: its pictures by name.
        reach: half-width of an interval in standard errors.
        level: level of the intervals.
        max_effects: how many effects the search could add.
        findings: what the check of the records remarked.
    """
    dataset, details = diagnosis.details.dataset, diagnosis.details
    page = Page(f"Diagnosis of {diagnosis.case}", headline(diagnosis))
    captions = _CAPTIONS | ({} if diagnosis.with_effect else {"worst_record": _NO_TEST})

    def picture(section: Section, name: str) -> None:
        if name in figures:
            section.figure(figures[name], captions[name])

    likely = sum(one.selected or one.probability >= UNLIKELY for one in diagnosis.effects)
    shown = max(likely, SHOWN)
    remarks = (
        *varying_lines(diagnosis),
        *rejected_lines(diagnosis),
        *extrapolation_lines(diagnosis),
        *caution_lines(diagnosis, max_effects),
    )
    effects = page.section("Effects")
    picture(effects, "shares")
    values = value_lines(diagnosis, reach, level)
    effects.add(effects_table(diagnosis, shown), *map(_sentence, (*values, *remarks)))
    others = sorted({words_of(one.name) for one in diagnosis.effects[shown:]})
    if others:
        effects.add(_sentence(f"also tried, probability below {UNLIKELY:g}: {', '.join(others)}."))
    if diagnosis.ties:
        effects.add(Text(_TIED, style="yellow"))
    picture(effects, "candidates")
    effects.add(_HOW)
    location = page.section("Location").add(_sentence(where_line(diagnosis) or _NOWHERE))
    if words := disturbance_line(diagnosis):
        location.add(_sentence(words))
    for name in ("missing_torque", "location", "torque_map", "reversals"):
        picture(location, name)
    tests = page.section("Test records").add(*map(_sentence, error_lines(diagnosis)))
    picture(tests, "gap")
    picture(tests, "worst_record")
    page.section("Parameters").add(
        *([diagnosis.changes] if diagnosis.changes else []),
        *map(_sentence, [*implausible_lines(diagnosis), *not_identifiable_lines(diagnosis)]),
        parameters_table(diagnosis, reach, level),
        *combinations_table(details.studies[-1], reach, level),
        _INTERVALS,
        GRADES,
    )
    role = "test" if dataset.test else "train"
    records = count(len(dataset.test or dataset.train), f"{role} record")
    page.section("Residuals").add(*residual_blocks(details.residual_tests, records))
    ties = [*tie_lines(diagnosis), *experiment_lines(diagnosis)]
    page.section("Ties and next experiment").add(*map(_sentence, ties or [_NO_TIES]))
    table = page.section("Records").add(records_table(dataset))
    if findings:
        table.add(findings_list(findings))
    return page


def _sentence(words: str) -> Text:
    """Words as a sentence of their own; brackets in them are no markup."""
    return Text(capital(words))
