"""A diagnosis as tables and as text of one page: the headline first, then where, which and how far."""

from __future__ import annotations

import math

from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from hybrid_id.diagnosis.result import Diagnosis
from hybrid_id.errors import InputError
from hybrid_id.reporting.diagnosis_words import (
    caution_lines,
    change_lines,
    disturbance_line,
    error_lines,
    experiment_lines,
    extrapolation_lines,
    headline,
    implausible_lines,
    joint_words,
    not_identifiable_lines,
    percent,
    place_words,
    range_percent,
    rejected_lines,
    tie_lines,
    value_lines,
    varying_lines,
    where_line,
    words_of,
)
from hybrid_id.reporting.parameter_tables import JUDGED, judged_cells
from hybrid_id.reporting.tables import open_table
from hybrid_id.study import Study
from hybrid_id.systems.chain import System

TOP = 4
"""Effects that the terminal shows."""


def summary(diagnosis: Diagnosis, reach: float = 1.96, level: float = 0.95) -> str:
    """The diagnosis as plain text of at most 25 lines of 120 characters.

    Args:
        diagnosis: the result.
        reach: half-width of an interval in standard errors.
        level: level of the intervals of parameters.
    """
    console = Console(width=120, no_color=True, highlight=False, emoji=False)
    with console.capture() as captured:
        console.print(diagnosis_table(diagnosis, reach, level))
    return "\n".join(line.rstrip() for line in captured.get().rstrip().splitlines())


def diagnosis_table(
    diagnosis: Diagnosis, reach: float = 1.96, level: float = 0.95, max_effects: int | None = None
) -> RenderableType:
    """What the terminal shows of a diagnosis; ``max_effects`` is how many a search could add."""
    parts: list[RenderableType] = [Text(headline(diagnosis), style="bold")]
    parts += map(Text, error_lines(diagnosis))
    parts += [Text(line) for line in (where_line(diagnosis), disturbance_line(diagnosis)) if line]
    parts.append(effects_table(diagnosis, TOP))
    parts += map(Text, value_lines(diagnosis, reach, level))
    remarks = (
        *tie_lines(diagnosis, brief=True)[:2],
        *varying_lines(diagnosis),
        *change_lines(diagnosis),
        *rejected_lines(diagnosis),
        *experiment_lines(diagnosis),
        *implausible_lines(diagnosis, 4),
        *not_identifiable_lines(diagnosis, 1),
        *extrapolation_lines(diagnosis)[:1],
        *caution_lines(diagnosis, max_effects),
    )
    parts += [Text(line, style="yellow") for line in remarks]
    return Group(*parts)


def effects_table(diagnosis: Diagnosis, most: int | None = None) -> Table:
    """The effects that were tried (the first ``most``): the selected ones by share, then the others by probability."""
    table = open_table("share of the gap>", "probability>", "effect", "where", "")
    tied = {member for group in diagnosis.ties for member in group}
    for one in diagnosis.effects[:most]:
        others = "indistinguishable" if f"{one.name}@{one.where}" in tied else ""
        mark = Text("selected", style="green") if one.selected else Text(others)
        interval = "" if one.share_interval is None else f" ({range_percent(one.share_interval)})"
        table.add_row(
            "" if one.share is None else percent(one.share) + interval, f"{one.probability:.3f}",
            words_of(one.name), f"{joint_words(one.where)}, {place_words(one.where)}", mark,
        )  # fmt: skip
    return table


def parameters_table(diagnosis: Diagnosis, reach: float = 1.96, level: float = 0.95) -> Table:
    """Every estimated parameter in the nominal, the re-fitted and the corrected model, with intervals.

    Args:
        diagnosis: the result.
        reach: half-width of an interval in standard errors.
        level: level of the intervals.
    """
    nominal, studies = diagnosis.details.nominal, diagnosis.details.studies
    last = studies[-1]
    heads = [h for name in diagnosis.fitted for h in (f"{name}>", f"{100 * level:g} % interval")]
    table = open_table("parameter", "meaning", "nominal>", *heads, "unit", *JUDGED)
    models = (nominal, *(one.selected_model for one in studies))
    infos = {i.name: i for model in models for i in model.table if i.spec.estimate}
    for name, info in infos.items():
        cells = [cell for one in studies for cell in _estimate(one, name, reach)]
        grades = judged_cells(last, name) if name in last.names else []
        table.add_row(name, info.doc, _value(nominal, name), *cells, info.spec.unit, *grades)
    return table


def _estimate(study: Study, name: str, reach: float) -> tuple[str, str]:
    """Value of a parameter in a fitted model, and its interval."""
    text = _value(study.selected_model, name)
    if name not in study.names:
        return text, ""
    value = study.selected_model.parameter(name).spec.value
    half = reach * float(study.standard_errors(0)[study.names.index(name)])
    return text, f"{value - half:.4g} to {value + half:.4g}" if math.isfinite(half) else "none"


def _value(system: System, name: str) -> str:
    try:
        return f"{system.parameter(name).spec.value:.4g}"
    except InputError:
        return ""
