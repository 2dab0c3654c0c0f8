"""Exported models as sentences, tables and a page: how they err in the simulator that they were exported to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich.table import Table

from hybrid_id.export.replay import Agreement, summarise
from hybrid_id.export.target import InTarget
from hybrid_id.reporting.page import Page, how_made
from hybrid_id.reporting.tables import count, table
from hybrid_id.reporting.units import symbols_line

Models = Mapping[str, InTarget]
"""Models in MuJoCo by what they are called, the exported one last."""


def errors_table(models: Models) -> Table:
    """Errors of each model in MuJoCo, beside what the package's own replay has, and in MuJoCo by output."""
    found = {label: one.summary for label, one in models.items()}
    outputs = list(next(iter(found.values())).by_output)
    split = outputs if len(outputs) > 1 else []
    heads = ("model", "in MuJoCo>", "here>", *(f"{name}>" for name in split))
    rows = (
        (label, f"{one.there:.3g}", f"{one.here:.3g}", *(f"{one.by_output[name]:.3g}" for name in split))
        for label, one in found.items()
    )
    return table(heads, rows)


def judged_on(models: Models) -> str:
    """On which records the errors are, in words."""
    rows = list(models.values())[-1].rows
    role = summarise(rows).role
    names = {row.record for row in rows if role in ("", row.role)}
    return count(len(names), f"{role} record".strip())


def error_lines(models: Models) -> list[str]:
    """The errors in sentences: all models on the records that judge, and what was fitted anew in MuJoCo."""
    errors = ", ".join(f"{label} {one.summary.there:.3g}" for label, one in models.items())
    lines = [f"normalised RMSE in MuJoCo, mean over {judged_on(models)}: {errors}"]
    return lines + [line for label, one in models.items() for line in refit_lines(label, one)]


def refit_lines(label: str, one: InTarget) -> list[str]:
    """What was fitted anew in MuJoCo, in a sentence; none where nothing was."""
    if not one.refitted:
        return []
    infos = [(one.system.parameter(name), old, new) for name, (old, new) in one.refitted.items()]
    values = ", ".join(f"{i.name} {old:.4g} to {new:.4g} {i.spec.unit}" for i, old, new in infos)
    return [
        f"{label}: MuJoCo lacks some of it (error {summarise(one.before).there:.3g} as it is), so its file holds what "
        f"fits the train records best there: {values}",
        *symbols_line([info for info, *_ in infos], values),
    ]


def replays_table(rows: Sequence[Agreement]) -> Table:
    """How far MuJoCo, the package and the measurements are apart, for each record and output."""
    heads = ("record", "role", "output", "MuJoCo - ours>", "measured - ours>", "measured - MuJoCo>")
    cells = (
        (r.record, r.role, r.output, *(f"{value:.5f}" for value in (r.apart, r.here, r.there))) for r in rows
    )
    return table(heads, cells)


def target_result(models: Models) -> dict[str, Any]:
    """The errors in MuJoCo as plain data."""
    return {
        "role": list(models.values())[-1].summary.role or None,
        "models": {
            label: {
                "nrmse": one.summary.there,
                "by_output": one.summary.by_output,
                "nrmse_here": one.summary.here,
                "nrmse_before_refit": summarise(one.before).there if one.refitted else None,
                "refitted": {
                    name: {"before": old, "after": new} for name, (old, new) in one.refitted.items()
                },
            }
            for label, one in models.items()
        },
    }


def target_page(models: Models, name: str) -> Page:
    """The page beside an exported file.

    Args:
        models: in MuJoCo.
        name: of the file.
    """
    label, exported = list(models.items())[-1]
    lines = error_lines(models)
    page = Page(f"{name}: the {label} model in MuJoCo", lines[0])
    page.section("Errors in MuJoCo").add(
        f"Normalised RMSE, mean over {judged_on(models)}; 'here' is the package's own replay.",
        errors_table(models),
        *lines[1:],
    )
    notes = exported.exported.notes or ("nothing",)
    page.section("Left out").add(*(f"{note}." for note in notes))
    page.section("Replays of the exported model").add(replays_table(exported.rows))
    return how_made(page, "export")
