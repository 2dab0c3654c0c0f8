"""A diagnosis as one page: the verdict first, then what it rests on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rich.text import Text

from hybrid_id.gap.diagnosis import Diagnosis
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
from hybrid_id.reporting.tables import findings_list, records_table
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
_CAPTIONS = {
    "gap": "Normalised error of free runs over the test records (1: as good as the signal's mean), and record by "
    "record. Dashed: what the right model would leave.",
    "missing_torque": "The torque that would explain what the model leaves, over the signals that tell most; above "
    "each panel the part of the mean square that it explains on records left out. Where only voltage and angle were "
    "recorded, torques are known up to the factor that today's values fix.",
    "where": "Part of what each model leaves that a torque over one signal, at one side of a joint, explains on "
    "records left out. The rows overlap: speed, angle and command go together in most records.",
    "suspects": "Left: error of prediction with one effect added, over the re-fitted model's. Right: probability.",
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
        findings: what the check of the records remarked.
    """
    page = Page(f"Gap between {dataset.name} and its model", verdict_sentence(diagnosis, reach))
    captions = _CAPTIONS | ({} if diagnosis.with_effect else {"worst_record": _NO_TEST})

    def picture(section: Section, name: str) -> None:
        if name in figures:
            section.figure(figures[name], captions[name])

    picture(page.section("How far").add(_sentence(gap_line(diagnosis))), "gap")
    ties = (
        *tie_lines(diagnosis),
        *outvoted_lines(diagnosis),
        *varying_lines(diagnosis),
        *withdrawn_lines(diagnosis),
        *beyond_lines(diagnosis),
        *caution_lines(diagnosis),
        *experiment_lines(diagnosis),
    )
    likely = sum(one.selected or one.probability >= UNLIKELY for one in diagnosis.effects)
    shown = max(likely, SHOWN)
    which = page.section("Which").add(
        _HOW, suspects_table(diagnosis, reach, level, shown), *map(_sentence, ties)
    )
    others = sorted({words_of(one.name) for one in diagnosis.effects[shown:]})
    if others:
        which.add(_sentence(f"tried as well, each place below {percent(UNLIKELY)}: {', '.join(others)}."))
    picture(which, "suspects")
    where = page.section("Where").add(_sentence(where_line(diagnosis) or _NOWHERE))
    picture(where, "missing_torque")
    picture(where, "where")
    picture(page.section("Measured and simulated"), "worst_record")
    page.section("Parameters").add(
        *map(_sentence, [*bent_lines(diagnosis), *untold_lines(diagnosis)]),
        parameters_table(nominal, diagnosis),
    )
    records = page.section("Records").add(records_table(dataset))
    if findings:
        records.add(findings_list(findings))
    return page


def _sentence(words: str) -> Text:
    """Words as a sentence of their own; brackets in them are no markup."""
    return Text(words[:1].upper() + words[1:])
