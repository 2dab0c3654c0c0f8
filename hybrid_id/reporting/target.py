"""Exported models as sentences, tables and a page: how they err in the simulator that they were exported to."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from rich.table import Table

from hybrid_id.export.replay import Agreement, summarise
from hybrid_id.export.target import HYBRID, REFITTED, TargetErrors
from hybrid_id.records.dataset import Channel
from hybrid_id.reporting.page import Page, how_made
from hybrid_id.reporting.tables import count, error_words, table
from hybrid_id.reporting.units import in_unit, symbols_line, title


def errors_table(errors: TargetErrors) -> Table:
    """Errors of each model in MuJoCo, beside those of the package's own replay."""
    found = {label: one.summary for label, one in errors.models.items()}
    rows = ((label, f"{one.there:.3g}", f"{one.here:.3g}") for label, one in found.items())
    return table(("model", "in MuJoCo>", "here>"), rows)


def judged_on(errors: TargetErrors) -> str:
    """On which records the errors are, and how long the model runs free there, in words."""
    found = errors.exported.summary
    horizon = "" if errors.horizon.kind == "whole" else f", {errors.horizon}"
    return count(found.n_records, f"{found.role} record".strip()) + horizon


def error_lines(errors: TargetErrors) -> list[str]:
    """The errors in sentences: of all models, by output in the unit logged, and what was fitted anew in MuJoCo."""
    words = ", ".join(f"{label} {one.summary.there:.3g}" for label, one in errors.models.items())
    lines = [f"NRMSE in MuJoCo, mean over {judged_on(errors)}: {words}"]
    if errors.label == HYBRID:
        lines.append("hybrid: its networks are left out in MuJoCo, which has none; 'here' it has them")
    found = [one.summary for one in errors.models.values()]
    for output in errors.exported.summary.rmse:
        *values, unit = in_unit(
            output, [one.rmse[output] for one in found], errors.outputs, errors.exported.system
        )
        words = ", ".join(f"{label} {value}" for label, value in zip(errors.models, values, strict=True))
        line = f"RMSE of {title(output, errors.outputs)}: {words} {unit}"
        if len(found[0].rmse) > 1:
            normalised = [one.by_output[output] for one in found]
            still = all(math.isnan(one) for one in normalised)
            said = "it stands still" if still else f"NRMSE {', '.join(f'{one:.3g}' for one in normalised)}"
            line += f" ({said})"
        lines.append(line)
    for label, one in errors.models.items():
        if one.refitted:
            infos = [(one.system.parameter(name), old, new) for name, (old, new) in one.refitted.items()]
            values = ", ".join(f"{i.name} {old:.4g} to {new:.4g} {i.unit}" for i, old, new in infos)
            lines += [
                f"{label}: MuJoCo lacks some of it (error {summarise(one.before).there:.3g} as it is), so its file "
                f"holds what fits the train records best there: {values}",
                *symbols_line([info for info, *_ in infos], values),
            ]
    return lines


def worse_words(errors: TargetErrors) -> str:
    """By how much the exported model is worse in MuJoCo than the re-fitted one."""
    exported, refitted = (errors.models[label].summary.there for label in (errors.label, REFITTED))
    return (
        f"in MuJoCo the {errors.label} model errs by {exported:.3g}, the re-fitted one by {refitted:.3g} (NRMSE, mean "
        f"over {judged_on(errors)})"
    )


def replays_table(rows: Sequence[Agreement], outputs: Sequence[Channel]) -> Table:
    """How far MuJoCo, the package and the measurements are apart, for each record and output."""
    heads = ("record", "role", "output", "MuJoCo - ours>", "measured - ours>", "measured - MuJoCo>")
    cells = (
        (
            r.record,
            r.role,
            title(r.output, outputs),
            *(error_words(value, ".5f") for value in (r.known_apart, r.here, r.there)),
        )
        for r in rows
    )
    return table(heads, cells)


def target_result(errors: TargetErrors) -> dict[str, Any]:
    """The errors in MuJoCo as plain data."""
    return {
        "role": errors.exported.summary.role or None,
        "horizon": str(errors.horizon),
        "models": {
            label: {
                "nrmse": one.summary.there,
                "by_output": one.summary.by_output,
                "rmse": one.summary.rmse,
                "nrmse_here": one.summary.here,
                "nrmse_before_refit": summarise(one.before).there if one.refitted else None,
                "refitted": {
                    name: {"before": old, "after": new} for name, (old, new) in one.refitted.items()
                },
            }
            for label, one in errors.models.items()
        },
    }


def target_page(errors: TargetErrors, name: str) -> Page:
    """The page beside an exported file of a name: the errors of the models in MuJoCo."""
    summary, *lines = error_lines(errors)
    page = Page(f"{name}: the {errors.label} model in MuJoCo", summary)
    replays = errors.exported.rows
    page.section("Replays of the exported model").add(
        "NRMSE, over the same records:",
        replays_table(replays, errors.outputs),
        f"MuJoCo replays these records within {summarise(replays).worst:.2g} of ours (NRMSE).",
    )
    page.section("Errors in MuJoCo").add(
        f"NRMSE, mean over {judged_on(errors)}; 'here' is the package's own replay.",
        errors_table(errors),
        *lines,
    )
    notes = errors.exported.exported.notes or ("nothing",)
    page.section("Left out").note(*(f"{note}." for note in notes))
    return how_made(page, "export")
