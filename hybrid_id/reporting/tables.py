"""Results as tables (rich), for the terminal and for pages."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import zip_longest
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from hybrid_id.records.dataset import Dataset
from hybrid_id.records.quality import Finding

if TYPE_CHECKING:  # the table of the records is on the screen before torch is loaded
    from hybrid_id.statistics.identifiability import Identifiability
    from hybrid_id.study import BaseParameterCheck, Comparison, Study

_SEVERITY = {"error": "bold red", "warning": "yellow", "info": "dim"}


MOST_ROWS, TERMS = 12, 3
"""Rows of the table of base parameters, and terms of a combination that are written out."""


def records_table(dataset: Dataset) -> Table:
    """Length, sampling and role of each record."""
    heads = ("record", "role", "samples>", "length [s]>", "step [ms]>", "sampling", "note")
    rows = (
        (
            record.name, record.role, str(record.n_samples), f"{record.duration:.4g}",
            f"{1e3 * record.sample_time:.4g}", "uniform" if record.is_uniform else "jittered", record.note,
        )
        for record in dataset
    )  # fmt: skip
    return table(heads, rows)


def findings_list(findings: Sequence[Finding]) -> RenderableType:
    """One line a finding, worst first."""
    if not findings:
        return Text("nothing to warn of", style="green")
    lines = [
        Text.assemble((f"{f.severity:<7}", _SEVERITY[f.severity]), "  ", _sentence(f.message))
        for f in findings
    ]
    return Group(*lines)


def identifiability_table(identified: Identifiability) -> RenderableType:
    """What is not identifiable in words, the combinations that are, and parameters without an interval."""
    parts: list[RenderableType] = []
    if identified.directions:
        number = f"{count(len(identified.directions), 'direction')} of {len(identified.names)}"
        words = f"{number} cannot be determined from these records:"
        parts.append(Text(words, style="yellow"))
        parts += [Text(f"  {k}. {d.text}") for k, d in enumerate(identified.directions, start=1)]
    else:
        words = f"all {len(identified.names)} parameters are identifiable"
        words += f" (condition number {identified.condition_number:.3g})"
        parts.append(Text(words, style="green"))
    cells = [
        (c.text, f"± {196 * std:.2g} %")
        for c, std in zip(identified.combinations, identified.combination_std, strict=True)
    ]
    if cells:
        parts.append(two_a_row(["what the records identify", "predicted ± (95 %)>"], cells))
    if identified.not_claimable:
        alone = ", ".join(identified.not_claimable)
        words = (
            f"{alone} {'has' if len(identified.not_claimable) == 1 else 'have each'} no interval by itself"
        )
        parts.append(Text(words, style="yellow"))
    elif identified.directions:
        parts.append(Text("with the priors every parameter has an interval of its own", style="green"))
    return Group(*parts)


def base_parameters_table(based: BaseParameterCheck, most: int = MOST_ROWS) -> RenderableType:
    """Number of base parameters, condition number of the motion, and the worst excited ones."""
    from hybrid_id.study.base_parameters import INDEPENDENT, TORQUE_ERROR, UNSURE

    base = based.base
    silent = len(base.without_effect)
    words = (
        f"{len(base.names)} inertial parameters of links and rotors act through {len(base.independent)} combinations "
        f"(base parameters); {silent} have no effect on any torque"
    )
    if based.missing:
        return Group(
            Text(words), Text(f"how the records excite them is not known: {based.missing}", style="yellow")
        )
    dead, unsure, number = int(np.isinf(based.std).sum()), int(based.unsure.sum()), len(based.std)
    condition = f"(condition number {based.condition_number:.3g})"
    if dead:
        motion = Text(f"the records' motion does not excite {count(dead, 'base parameter')}", style="yellow")
    elif unsure:
        motion = Text(
            f"the records' motion identifies {number - unsure} of {number} well {condition}; the predicted standard "
            f"error of {unsure} is {100 * UNSURE:g} % of the start value or more",
            style="yellow",
        )
    else:
        motion = Text(f"the records' motion excites all of them {condition}")
    relative = based.relative_std
    # not excited, then by relative error, then those whose start value is 0
    worst = sorted(
        range(len(relative)), key=lambda k: (based.std[k] < np.inf, relative[k] == np.inf, -relative[k])
    )
    shown = worst[:most] if most else worst
    rows = (
        (
            base.text(k, TERMS),
            f"{based.values[k]:.4g}",
            f"{based.std[k]:.2g}" if math.isfinite(based.std[k]) else "none",
            _percent(relative[k]),
        )
        for k in shown
    )
    title = "base parameter" if len(shown) == len(worst) else f"{len(shown)} of {len(worst)}, the worst first"
    heads = (title, "start value>", "std. error>", "relative>")
    note = (
        f"standard errors for torques that are off by {100 * TORQUE_ERROR:g} % (RMS), anew every "
        f"{1e3 * INDEPENDENT:g} ms; kg, kg m, kg m^2 in the joints' own axes"
    )
    return Group(Text(words), motion, table(heads, rows), Text(note, style="dim"))


def _percent(value: float) -> str:
    return f"{100 * value:.2g} %" if math.isfinite(value) else "-"


def two_a_row(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    """A table of two columns of rows, so that it is half as long; of one where there is a single row."""
    half = (len(rows) + 1) // 2
    pairs = zip_longest(rows[:half], rows[half:], fillvalue=())
    return table((*heads, *(f" {head}" for head in heads if len(rows) > 1)), ((*a, *b) for a, b in pairs))


def comparison_table(comparison: Comparison) -> Table:
    """Fit, normalised RMSE and RMSE of every model on every record and output, with the mean over the records.

    The RMSE is in the unit that was logged.
    """
    labels, titles = list(comparison.replays), {c.name: c.title for c in comparison.outputs}
    units = {c.name: c.shown for c in comparison.outputs}
    shown = [units.get(signal, ("", 1.0)) for signal in comparison.signals]
    forms = (("fit", ".2f"), ("nrmse", ".4f"), ("rmse", ".3g"))
    head = [f"{words}>" for label in labels for words in (f"{label}\nfit [%]", "\nNRMSE", "\nRMSE")]
    found = open_table("record", "role", "output", *head, "\nunit")
    tables = {measure: comparison.table(measure) for measure, _ in forms}
    for values in tables["rmse"].values():
        values *= [factor for _, factor in shown]
    every = [(tables[measure][label], form) for label in labels for measure, form in forms]
    for row, replay in enumerate(comparison.replays[labels[0]]):
        for column, signal in enumerate(comparison.signals):
            cells = (error_words(values[row, column], form) for values, form in every)
            found.add_row(
                replay.record.name, replay.record.role, titles.get(signal, signal), *cells, shown[column][0]
            )  # fmt: skip
    found.add_section()
    for column, signal in enumerate(comparison.signals):
        means = (_mean(values[:, column], form) for values, form in every)
        found.add_row("mean", "", titles.get(signal, signal), *means, shown[column][0])
    return found


def truth_table(study: Study, truth: Mapping[str, float]) -> Table:
    """Known values beside the estimates of the selected set."""
    from hybrid_id.study.result import against_truth

    heads = ("parameter", "truth>", "estimate>", f"{100 * study.level:g} % interval>", "unit", "off by>")
    rows = []
    for one in against_truth(study, truth):
        inside = Text("yes", style="green") if one.inside else Text("no", style="yellow")
        inside = Text("none claimed", style="dim") if one.inside is None else inside
        interval = interval_words(*one.interval)
        off = f"{100 * one.relative_error:+.2f} %"
        rows.append((one.name, f"{one.truth:.5g}", f"{one.estimate:.5g}", interval, one.unit, off, inside))
    return table((*heads, "in the interval"), rows)


def interval_words(low: float, high: float) -> str:
    """An interval as it is printed, with digits enough for its ends to differ; ``none`` where it has no ends."""
    if not (math.isfinite(low) and math.isfinite(high)):
        return "none"
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    narrow = math.ceil(math.log10(abs(middle) / half)) if middle and half else 0
    digits = min(max(4, narrow + 2), 12)
    return f"{low:.{digits}g} to {high:.{digits}g}"


def count(number: int, noun: str) -> str:
    """A number with its noun, ``1 record``, ``2 records``."""
    return f"{number} {noun}{'s' * (number != 1)}"


def capital(words: str) -> str:
    """A sentence's start."""
    return words[:1].upper() + words[1:]


def table(heads: Sequence[str], rows: Iterable[Sequence[str | Text]]) -> Table:
    """A table of rows; heads as in `open_table`."""
    found = open_table(*heads)
    for row in rows:
        found.add_row(*row)
    return found


def markdown_table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in Markdown."""
    return "\n".join(f"| {' | '.join(row)} |" for row in (heads, ["---"] * len(heads), *rows))


def open_table(*heads: str) -> Table:
    """An open table; a head that ends in '>' stands over numbers."""
    table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 2, 0, 0))
    for head in heads:
        if head.endswith(">"):
            table.add_column(head.rstrip(">"), justify="right")
        else:
            table.add_column(head, overflow="fold")  # a name that is cut is no name
    return table


def error_words(value: float, form: str) -> str:
    """An error as it is printed; in words where the output stands still (NaN) or the simulation diverged."""
    return format(value, form) if np.isfinite(value) else "diverged" if np.isinf(value) else "constant"


def _mean(values: np.ndarray, form: str) -> str:
    known = values[~np.isnan(values)]
    return error_words(float(known.mean()), form) if known.size else "constant"


def _sentence(text: str) -> str:
    return text if text.endswith((".", "]")) else f"{text}."
