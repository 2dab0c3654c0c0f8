"""The parameters of a study as tables: intervals, trust grades, bounds, and what is told only in combinations."""

from __future__ import annotations

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from hybrid_id.reporting.tables import count, open_table, two_a_row
from hybrid_id.study import Study
from hybrid_id.systems.chain import System

GRADES = (
    "trust: A all ways to compute the error agree; B only the plain covariance is too confident; C the ways disagree; "
    "D no value to use on its own"
)
JUDGED = ("trust", "lower bound>", "upper bound>", "why")
_GRADE = {"A": "green", "B": "green", "C": "yellow", "D": "red"}


def study_table(study: Study, reach: float, level: float, *, full: bool = False) -> RenderableType:
    """Parameters of the selected set with intervals, their variation and their trust grade, and what follows.

    With ``full`` their bounds and the reasons of the grades are told, too, for which a terminal has no room.
    """
    index = study.selection.index
    errors = reach * study.standard_errors(index)
    heads = ["parameter", "pooled set>" if study.pooled else f"set {study.selection.name}>"]
    heads += [f"± ({100 * level:g} %)>", "unit"]
    heads += [] if study.variation is None else ["mean of sets>", "std/mean>"]
    table = open_table(*heads, *(JUDGED if full else JUDGED[:1]))
    for k, name in enumerate(study.names):
        row = [
            name,
            f"{study.selected.values[k]:.5g}",
            half_width(errors[k]),
            study.selected.units[k],
        ]
        if study.variation is not None:
            spread = Text(f"{study.variation.percent[k]:.2f} %")
            if not study.variation.acceptable[k] and not study.variation.held[k]:
                spread.stylize("red")
            row += [f"{study.variation.mean[k]:.5g}", spread]
        judged = judged_cells(study, name)
        table.add_row(*row, *(judged if full else judged[:1]))
    combined = combinations_table(study, reach, level)
    return Group(table, *combined, *(Text(line) for line in _remarks(study)))


def judged_cells(study: Study, name: str) -> list[Text]:
    """Grade, lower and upper bound of a parameter of the selected set, and why it has no better grade."""
    trust = study.trust[study.names.index(name)]
    why = "" if trust.grade == "A" else trust.reason
    return [
        Text(trust.grade, style=_GRADE[trust.grade]),
        *bound_cells(study.selected_model, name),
        Text(why),
    ]


def bound_cells(system: System, name: str) -> list[Text]:
    """Lower and upper bound of a parameter, in its unit; the one that its value has reached is marked."""
    spec, cells = system.parameter(name).spec, []
    for bound in (spec.lower, spec.upper):
        at = abs(spec.value - bound) <= 1e-9 * max(abs(spec.value), 1e-300)
        words = f"{bound:.4g}" if np.isfinite(bound) else "none"
        cells.append(Text(f"{words}, reached", style="red") if at else Text(words))
    return cells


def combinations_table(study: Study, reach: float, level: float) -> list[Table]:
    """The functions of parameters that do have an interval where parameters alone have none; no table without any."""
    if study.identifiability.claimable.all():
        return []
    told, index = study.combinations, study.selection.index
    heads = ["what is identified", "value>", f"± ({100 * level:g} %)>"]
    heads += [] if told.variation is None else ["std/mean>"]
    rows = []
    for k, name in enumerate(told.names):
        if name in study.names:
            continue
        row = [name, f"{told.values[index, k]:.5g}", half_width(reach * told.std_error[index, k])]
        rows.append(row if told.variation is None else [*row, f"{told.variation.percent[k]:.2f} %"])
    return [two_a_row(heads, rows)] if rows else []


def half_width(value: float) -> str:
    """Half of an interval; none where the records set no bound."""
    return f"{value:.2g}" if np.isfinite(value) else "none"


def _remarks(study: Study) -> list[str]:
    lines = [GRADES]
    lines += [] if study.horizon.kind == "whole" else [f"horizon: {study.horizon}"]
    lines += [f"identifiability: {direction.text}" for direction in study.identifiability.directions]
    failed = [result for result in study.sets if not result.ok]
    lines += [f"{', '.join(list(dict.fromkeys(r.records))[:3])}: {r.message}" for r in failed[:3]]
    hits = [sum(name in result.at_bound for result in study.sets) for name in study.names]
    if any(hits):
        of = f" (in {{}} of {len(study.sets)} sets)" if len(study.sets) > 1 else ""
        words = [name + of.format(n) for name, n in zip(study.names, hits, strict=True) if n]
        lines.append(f"at a bound: {', '.join(words)}")
    if len(study.sets) > 1 or not study.selection.candidate.any():
        lines.append(f"selection: {study.selection.summary()}")
    if study.test_nrmse:
        seen = count(len(study.test_nrmse), "record")
        lines.append(f"test: normalised RMSE {study.test_error:.4g} on {seen} that no fit has seen")
    lines.append(f"integration error (step halved): {study.engine_error:.2g} standard errors at most")
    lines += [
        f"profile of {n}: {p.lower:.5g} to {p.upper:.5g}, {p.message}" for n, p in study.profiles.items()
    ]
    return lines
