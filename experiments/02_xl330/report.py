"""The tables of the experiment, as Markdown."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from ladder import Rung, jackknife

from hybrid_id.records.record import Record


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n" + "\n".join(f"| {' | '.join(line)} |" for line in lines)


def error_table(pooled: Mapping[str, Mapping[str, Rung]]) -> str:
    """Mean absolute position error, fitted objective, end and processor time of every model, for each drive."""
    parts = []
    for drive, ladder in pooled.items():
        rows = [
            [name, f"{r.errors.mean():.4f}", f"{r.result.cost:.0f}", r.result.status, f"{r.seconds:.0f}"]
            for name, r in ladder.items()
        ]
        parts.append(table([drive, "mean abs. error [rad]", "objective", "end", "processor time [s]"], rows))
    return "\n".join(parts)


def held_out_table(
    title: str,
    rotation: Sequence[Mapping[str, Rung]],
    test: Mapping[float, Sequence[Record]],
    config: Mapping[str, Any],
    prepare: Callable,
    mean_errors: Callable,
) -> str:
    """Error on the records of each group, by models that were fitted to the other groups."""
    rows = []
    for name in config["ladder"]:
        found = []
        for ladder, some in zip(rotation, test.values(), strict=True):
            one = ladder[name].result
            found.append(mean_errors(one.system, one.engine, prepare(config, one.system, some)).mean())
        rows.append([name, *(f"{e:.4f}" for e in found), f"{np.mean(found):.4f}"])
    return table([title, *(f"{g:g}" for g in test), "mean"], rows)


def parameter_table(
    drive: str, left_out: Mapping[str, tuple[np.ndarray, np.ndarray]], ladder: Mapping[str, Rung]
) -> str:
    """Estimates with standard errors between records, and the error on the record left out."""
    names = list(dict.fromkeys(n for rung in ladder.values() for n in rung.result.names))
    columns = []
    for model, rung in ladder.items():
        errors, sets = left_out[model]
        values = dict(
            zip(rung.result.names, zip(rung.result.values, jackknife(sets), strict=True), strict=True)
        )
        cells = [f"{values[n][0]:.4g} ± {values[n][1]:.2g}" if n in values else "" for n in names]
        columns.append([*cells, f"{errors.mean():.4f}"])
    units = {n: u for r in ladder.values() for n, u in zip(r.result.names, r.result.units, strict=True)}
    labels = [*(f"{n} [{units[n]}]" for n in names), "error on the record left out [rad]"]
    return table(
        [drive, *ladder],
        [[label, *row] for label, row in zip(labels, zip(*columns, strict=True), strict=True)],
    )
