"""A diagnosis as one page: the verdict first, then what it rests on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rich.text import Text

from hybrid_id.diagnosis.result import Diagnosis
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.finding import Finding
from hybrid_id.reporting.gap import UNLIKELY, beyond_lines, caution_lines, parameters_table, suspects_table
from hybrid_id.reporting.gap_ties import experiment_lines, outvoted_lines, tie_lines
from hybrid_id.reporting.gap_verdict import verdict_sentence
from hybrid_id.reporting.gap_words import (
    LEAST_SHARE,
    bent_lines,
    gap_line,
    percent,
    untold_lines,
    varying_lines,
    where_line,
    withdrawn_lines,
    words_of,
)
from hybrid_id.reporting.html.page import Page, Section
from hybrid_id.reporting.html.twin import Drawn
from hybrid_id.reporting.parameter_tables import GRADES, combinations_table
from hybrid_id.reporting.residual_words import Residuals, residual_blocks
from hybrid_id.reporting.tables import count, findings_list, records_table
from hybrid_id.study import Study
from hybrid_id.systems.chain import System

SHOWN = 6
"""Effects that the table shows at least."""
_HOW = (
    "Search and fits use the train records; the test records measure the gap, and decide between effects that explain "
    "the train records alike. Where they alone show something, the worst of them joins the train records. Both are "
    "said where they happen. Each effect is added to today's model and fitted with its "
    "parameters; the error of prediction is that on parts of the train records left out, each in turn. A probability "
    "is that of the effect being at work at this place, so they need not sum to one."
)
_NOWHERE = f"No torque over one signal explains {percent(LEAST_SHARE)} of what the re-fitted model leaves."
_TIED = "These records do not tell all of them apart: see Ties and next experiment."
_NO_TIES = "nothing is tied, so there is nothing for an experiment to part."
_INTERVALS = (
    "Intervals and grades are those that identify would give the same fit. A parameter without an interval is told "
    "only together with others, or lies at a bound; the interval of an effect's size in the verdict leaves that out of "
    "account, so read it beside what is identified."
)
_CAPTIONS = {
    "gap": "Normalised error of free runs over the test records (1: as good as the signal's mean), and record by "
    "record. Dashed: what the right model would leave.",
    "missing_torque": "The torque that would explain what the model leaves, over the signals that tell most; above "
    "each panel the part of the mean square that it explains on records left out. Where only voltage and angle were "
    "recorded, torques are known up to the factor that today's values fix.",
    "where": "Part of what each model leaves that a torque over one signal, at one side of a joint, explains on "
    "records left out. The rows overlap: speed, angle and command go together in most records.",
    "suspects": "Left: error of prediction with one effect added, over the re-fitted model's. Right: probability.",
    "torque_map": "The missing torque over angle and speed, where the records have been; above each map the part of "
    "what the model leaves that such a torque explains on records left out (chance: none). What changes along the "
    "speed is friction or the motor, what changes along the angle a load or the gear; a step at speed 0 is dry "
    "friction. What the model's own parameters could do (a slope over the speed, say) is not told. A right model's map "
    "is pale.",
    "reversals": "What free runs leave after the joint has turned round, mean of all reversals in all records with its "
    "standard error; positive where the machine is ahead in its new direction. Play, stiction and friction with memory "
    "begin anew at each reversal, so they show here; a right model stays at 0, about.",
    "worst_record": "The test record that is predicted worst: measured, simulated in open loop, and the residuals.",
}

_NO_TEST = (
    "The first train record (no record is a test): measured, simulated in open loop, and the residuals."
)


def gap_page(
    dataset: Dataset,
    nominal: System,
    diagnosis: Diagnosis,
    figures: Mapping[str, Drawn],
    *,
    reach: float,
    level: float,
    judged: Sequence[Study],
    residuals: Residuals,
    findings: Sequence[Finding] = (),
) -> Page:
    """The page.

    Args:
        dataset: the records.
        nominal: today's model.
        diagnosis: the result.
        figures: its pictures by name.
        reach: half-width of an interval in standard errors.
        level: level of the intervals.
        judged: the re-fitted model as `identify` would judge it, and the corrected one where it is another.
        residuals: tests of what each of them leaves.
        findings: what the check of the records remarked.
    """
    page = Page(f"Gap between {dataset.name} and its model", verdict_sentence(diagnosis, reach))
    captions = _CAPTIONS | ({} if diagnosis.with_effect else {"worst_record": _NO_TEST})

    def picture(section: Section, name: str) -> None:
        if name in figures:
            section.figure(figures[name], captions[name])

    where = page.section("Where").add(_sentence(where_line(diagnosis) or _NOWHERE))
    for name in ("missing_torque", "where", "torque_map", "reversals"):
        picture(where, name)
    likely = sum(one.selected or one.probability >= UNLIKELY for one in diagnosis.effects)
    shown = max(likely, SHOWN)
    told = (
        *outvoted_lines(diagnosis),
        *varying_lines(diagnosis),
        *withdrawn_lines(diagnosis),
        *beyond_lines(diagnosis),
        *caution_lines(diagnosis),
    )
    which = page.section("Which").add(suspects_table(diagnosis, reach, level, shown), *map(_sentence, told))
    others = sorted({words_of(one.name) for one in diagnosis.effects[shown:]})
    if others:
        which.add(_sentence(f"tried as well, each place below {percent(UNLIKELY)}: {', '.join(others)}."))
    if diagnosis.ties:
        which.add(Text(_TIED, style="yellow"))
    picture(which, "suspects")
    which.add(_HOW)
    far = page.section("How far").add(_sentence(gap_line(diagnosis)))
    picture(far, "gap")
    picture(far, "worst_record")
    page.section("Parameters").add(
        *map(_sentence, [*bent_lines(diagnosis), *untold_lines(diagnosis)]),
        parameters_table(nominal, diagnosis, judged, reach, level),
        *combinations_table(judged[-1], reach, level),
        _INTERVALS,
        GRADES,
    )
    seen = diagnosis.as_searched(dataset)
    role = "test" if seen.test else "train"
    records = count(len(seen.test or seen.train), f"{role} record")
    page.section("Residuals").add(*residual_blocks(residuals, records))
    ties = [*tie_lines(diagnosis), *experiment_lines(diagnosis)]
    page.section("Ties and next experiment").add(*map(_sentence, ties or [_NO_TIES]))
    records = page.section("Records").add(records_table(dataset))
    if findings:
        records.add(findings_list(findings))
    return page


def _sentence(words: str) -> Text:
    """Words as a sentence of their own; brackets in them are no markup."""
    return Text(words[:1].upper() + words[1:])
