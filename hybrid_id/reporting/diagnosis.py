"""A diagnosis as tables and as text of one page: the verdict first, then where, which and how far."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from hybrid_id.diagnosis.result import Diagnosis
from hybrid_id.errors import InputError
from hybrid_id.reporting.gap_ties import experiment_lines, outvoted_lines, tie_lines
from hybrid_id.reporting.gap_verdict import verdict_sentence
from hybrid_id.reporting.gap_words import (
    bent_lines,
    gap_line,
    joint_words,
    place_words,
    untold_lines,
    values_of,
    varying_lines,
    where_line,
    withdrawn_lines,
    words_of,
)
from hybrid_id.reporting.parameter_tables import JUDGED, half_width, judged_cells
from hybrid_id.reporting.tables import open_table
from hybrid_id.study import Study
from hybrid_id.systems.chain import System

TOP = 4
"""Suspects that the terminal shows."""
UNLIKELY = 0.01
"""Probability below which an effect's parameters are noise and no news."""

WORSE = 1.5
"""Error of the re-fit over that of today's values from which it is said."""


def summary(diagnosis: Diagnosis, reach: float = 1.96, level: float = 0.95) -> str:
    """The diagnosis as plain text of at most 25 lines of 120 characters.

    Args:
        diagnosis: the result.
        reach: half-width of an interval in standard errors.
        level: level of the intervals.
    """
    console = Console(width=120, no_color=True, highlight=False, emoji=False)
    with console.capture() as captured:
        console.print(diagnosis_table(diagnosis, reach, level))
    return "\n".join(line.rstrip() for line in captured.get().rstrip().splitlines())


def diagnosis_table(diagnosis: Diagnosis, reach: float = 1.96, level: float = 0.95) -> RenderableType:
    """What the terminal shows of a diagnosis."""
    parts: list[RenderableType] = [Text(verdict_sentence(diagnosis, reach), style="bold")]
    lines = {"where": where_line(diagnosis), "how far": gap_line(diagnosis)}
    parts += [Text(f"{head}: {line}") for head, line in lines.items() if line]
    parts.append(suspects_table(diagnosis, reach, level, TOP))
    remarks = (
        *tie_lines(diagnosis, brief=True)[:2],
        *outvoted_lines(diagnosis),
        *varying_lines(diagnosis),
        *withdrawn_lines(diagnosis),
        *experiment_lines(diagnosis),
        *bent_lines(diagnosis, 4),
        *untold_lines(diagnosis, 1),
        *beyond_lines(diagnosis)[:1],
        *caution_lines(diagnosis),
    )
    parts += [Text(line, style="yellow") for line in remarks]
    return Group(*parts)


def beyond_lines(diagnosis: Diagnosis) -> list[str]:
    """Where the test records disagree, those that go where no train record has been; none where they do not."""
    said = diagnosis.beyond if diagnosis.unknown or diagnosis.withdrawn else ()
    return [f"beyond: {words}: what acts there only, these train records cannot tell." for words in said]


def caution_lines(diagnosis: Diagnosis) -> list[str]:
    """What speaks against the re-fit as a ground to stand on, and against "outside the catalogue"."""
    nominal, refit, lines = diagnosis.nominal, diagnosis.refit, []
    told = nominal is not None and refit is not None and refit.nrmse > WORSE * nominal.nrmse
    if told and diagnosis.verdict != "no_gap":
        lines.append(
            "the re-fit predicts unseen records worse than today's values do: a train record may contradict the "
            "others; 'hybrid-id check' looks at each."
        )
    if diagnosis.unknown and diagnosis.search.full:
        lines.append(
            "more effects at once were not looked for; what is left may be one more: give a larger --most."
        )
    return lines


def suspects_table(
    diagnosis: Diagnosis, reach: float = 1.96, level: float = 0.95, most: int | None = None
) -> Table:
    """The effects that were tried (the first ``most``), the selected ones first, then by probability."""
    table = open_table("probability>", "effect", "where", f"parameters ± ({100 * level:g} %)", "")
    # with a selected one, as the sentence says
    tied = {member for group in diagnosis.ties for member in group}
    for one in diagnosis.effects[:most]:
        values = values_of(diagnosis, one, reach) if one.selected or one.probability >= UNLIKELY else []
        others = "tied" if f"{one.name}@{one.where}" in tied else ""
        mark = Text("selected", style="green") if one.selected else Text(others)
        table.add_row(
            f"{one.probability:.3f}", words_of(one.name), f"{joint_words(one.where)}, {place_words(one.where)}",
            ", ".join(values), mark,
        )  # fmt: skip
    return table


def parameters_table(
    nominal: System, diagnosis: Diagnosis, judged: Sequence[Study], reach: float = 1.96, level: float = 0.95
) -> Table:
    """Every estimated parameter in today's model, after its re-fit, and in the corrected model where there is one.

    Args:
        nominal: today's model.
        diagnosis: the result.
        judged: the re-fitted model as `identify` would judge it, then the corrected one, unless that is the same.
        reach: half-width of an interval in standard errors.
        level: level of the intervals.
    """
    last = judged[-1]
    fitted = ("re-fitted", "corrected")[: len(judged)]
    heads = [head for name in fitted for head in (f"{name}>", f"± ({100 * level:g} %)>")]
    table = open_table("parameter", "today>", *heads, "unit", *JUDGED)
    models = (nominal, *(one.selected_model for one in judged))
    names = {i.name: i.spec.unit for model in models for i in model.table if i.spec.estimate}
    for name, unit in names.items():
        cells = [cell for one in judged for cell in _estimate(one, name, reach)]
        grades = judged_cells(last, name) if name in last.names else []
        table.add_row(name, _value(nominal, name), *cells, unit, *grades)
    return table


def _estimate(study: Study, name: str, reach: float) -> tuple[str, str]:
    """Value of a parameter in a fitted model, and half of its interval."""
    if name not in study.names:
        return _value(study.selected_model, name), ""
    error = study.standard_errors(0)[study.names.index(name)]
    return _value(study.selected_model, name), half_width(reach * error)


def _value(system: System, name: str) -> str:
    try:
        return f"{system.parameter(name).spec.value:.4g}"
    except InputError:
        return ""
