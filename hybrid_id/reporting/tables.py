"""Results as tables for the terminal (rich)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from hybrid_id.records.dataset import Dataset
from hybrid_id.records.quality import Finding
from hybrid_id.statistics.identifiability import Identifiability
from hybrid_id.study import Comparison, Study

_SEVERITY = {"error": "bold red", "warning": "yellow", "info": "dim"}


def records_table(dataset: Dataset) -> Table:
    """Length, sampling and role of each record."""
    table = open_table("record", "role", "samples>", "length [s]>", "step [ms]>", "sampling", "note")
    for record in dataset:
        steps = "uniform" if record.is_uniform else "jittered"
        table.add_row(
            record.name, record.role, str(record.n_samples), f"{record.duration:.4g}",
            f"{1e3 * record.sample_time:.4g}", steps, record.note,
        )  # fmt: skip
    return table


def findings_list(findings: Sequence[Finding]) -> RenderableType:
    """One line a finding, worst first."""
    if not findings:
        return Text("nothing to warn of", style="green")
    lines = [
        Text.assemble((f"{f.severity:<7}", _SEVERITY[f.severity]), "  ", _sentence(f.message))
        for f in findings
    ]
    return Group(*lines)


def identifiability_table(told: Identifiability) -> RenderableType:
    """What cannot be told in words, the combinations that can be, and which parameters stand alone."""
    parts: list[RenderableType] = []
    if told.directions:
        number = f"{count(len(told.directions), 'direction')} of {len(told.names)}"
        words = f"{number} cannot be determined from these records:"
        parts.append(Text(words, style="yellow"))
        parts += [Text(f"  {k}. {d.text}") for k, d in enumerate(told.directions, start=1)]
    else:
        words = f"all {len(told.names)} parameters can be told (condition number {told.condition_number:.3g})"
        parts.append(Text(words, style="green"))
    cells = [
        (c.text, f"± {196 * std:.2g} %")
        for c, std in zip(told.combinations, told.combination_std, strict=True)
    ]
    if cells:
        parts.append(two_a_row(["what the records tell", "predicted ± (95 %)>"], cells))
    if told.not_claimable:
        parts.append(
            Text(
                f"no interval may be claimed for {', '.join(told.not_claimable)} on their own", style="yellow"
            )
        )
    elif told.directions:
        parts.append(Text("with the priors every parameter has an interval of its own", style="green"))
    return Group(*parts)


def two_a_row(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    """A table of two columns of rows, so that it is half as long; of one where there is a single row."""
    half = (len(rows) + 1) // 2
    table = open_table(*heads, *(f" {head}" for head in heads if len(rows) > 1))
    for k in range(half):
        table.add_row(*rows[k], *(rows[half + k] if half + k < len(rows) else ()))
    return table


def comparison_table(comparison: Comparison) -> Table:
    """Fit and normalised RMSE of every model on every record and output, with the mean over the records."""
    fits, errors = comparison.table("fit"), comparison.table("nrmse")
    labels = list(comparison.replays)
    head = [f"{words}>" for label in labels for words in (f"{label}\nfit [%]", "\nNRMSE")]
    table = open_table("record", "role", "output", *head)
    replays = comparison.replays[labels[0]]
    for row, replay in enumerate(replays):
        for column, signal in enumerate(comparison.signals):
            cells = [
                text
                for label in labels
                for text in (
                    _number(fits[label][row, column], ".2f"),
                    _number(errors[label][row, column], ".4f"),
                )
            ]
            table.add_row(replay.record.name, replay.record.role, signal, *cells)
    table.add_section()
    for column, signal in enumerate(comparison.signals):
        cells = [
            text
            for label in labels
            for text in (_mean(fits[label][:, column], ".2f"), _mean(errors[label][:, column], ".4f"))
        ]
        table.add_row("mean", "", signal, *cells)
    return table


def truth_table(study: Study, truth: Mapping[str, float], reach: float, level: float) -> Table:
    """Known values beside the estimates of the selected set."""
    errors = reach * study.standard_errors(study.selection.index)
    table = open_table(
        "parameter", "truth>", "estimate>", f"± ({100 * level:g} %)>", "unit", "off by>", "in the interval"
    )
    for k, name in enumerate(study.names):
        if name not in truth:
            continue
        off = study.selected.values[k] - truth[name]
        inside = Text("yes", style="green") if abs(off) <= errors[k] else Text("no", style="yellow")
        if not np.isfinite(errors[k]):
            inside = Text("none claimed", style="dim")
        table.add_row(
            name, f"{truth[name]:.5g}", f"{study.selected.values[k]:.5g}",
            f"{errors[k]:.2g}" if np.isfinite(errors[k]) else "none", study.selected.units[k],
            f"{100 * off / abs(truth[name]):+.2f} %", inside,
        )  # fmt: skip
    return table


def count(number: int, noun: str) -> str:
    """A number with its noun, ``1 record``, ``2 records``."""
    return f"{number} {noun}{'s' * (number != 1)}"


def open_table(*heads: str) -> Table:
    """An open table; a head that ends in '>' stands over numbers."""
    table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 2, 0, 0))
    for head in heads:
        table.add_column(head.rstrip(">"), justify="right" if head.endswith(">") else "left")
    return table


def _number(value: float, form: str) -> str:
    return format(value, form) if np.isfinite(value) else "diverged" if np.isinf(value) else "constant"


def _mean(values: np.ndarray, form: str) -> str:
    known = values[~np.isnan(values)]
    return _number(float(known.mean()), form) if known.size else "constant"


def _sentence(text: str) -> str:
    return text if text.endswith((".", "]")) else f"{text}."
