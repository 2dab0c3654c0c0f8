"""A hybrid training as plain data, tables and pictures."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from hybrid_id.records.dataset import Dataset
from hybrid_id.reporting.html.interactive import Drawn, drawn
from hybrid_id.reporting.parameter_tables import bound_cells, judged_cells
from hybrid_id.reporting.style import COLOURS, GREY, journal, new_figure, symbol
from hybrid_id.reporting.tables import open_table
from hybrid_id.study import Study
from hybrid_id.study.hybrid import BLUR, DRIFT, HybridStudy
from hybrid_id.study.network_role import NetworkRole

FULL = ("trust, physics alone", "lower bound", "upper bound", "what speaks against it")


def hybrid_result(study: HybridStudy) -> dict[str, Any]:
    """Everything that a hybrid training tells, as plain data."""
    result = study.result
    rows = zip(
        study.names, study.units, study.physics, study.physics_error, study.hybrid, study.hybrid_error,
        result.rungs[result.chosen].loose, study.room, study.drift,
        strict=True,
    )  # fmt: skip
    heads = (
        "unit",
        "physics",
        "physics_std_error",
        "hybrid",
        "hybrid_std_error",
        "unpriced_std_error",
        "half_interval_beside_networks",
        "drift_sigma",
    )
    return {
        "validation_records": study.validation,
        "chosen_price": result.rungs[result.chosen].price,
        "physics_alone": result.chosen == 0,
        "interrupted": result.interrupted,
        "parameters": {name: dict(zip(heads, row, strict=True)) for name, *row in rows},
        "ladder": [
            {
                "price": r.price, "train_loss": r.train, "validation_loss": r.validation, "status": r.status,
                "gradients": r.iterations,
            }
            for r in result.rungs
        ],
        "networks": [
            {
                "where": role.where, "unit": role.unit, "rms": role.rms, "share": role.share,
                "variance_share": role.variance_share, "overlap": role.overlap, "alike": dict(role.alike),
                "worth": role.worth, "room": role.room,
            }
            for role in study.roles
        ],
        "error_with_one_set": study.pooled,
        "error_with_own_sets": study.own,
        "weighted_error": {n: {"physics": a, "hybrid": b} for n, (a, b) in study.errors.items()},
        "warnings": study.warnings,
    }  # fmt: skip


def hybrid_tables(study: HybridStudy, dataset: Dataset, reach: float, level: float) -> RenderableType:
    """Parameters, the ladder of prices, the networks and the errors, with the warnings in words."""
    parts: list[RenderableType] = [
        drift_table(study, reach, level),
        ladder_table(study),
        role_table(study.roles),
    ]
    parts += [error_table(study, dataset), *(Text(warning, style="yellow") for warning in study.warnings)]
    return Group(*parts)


def drift_table(study: HybridStudy, reach: float, level: float, alone: Study | None = None) -> Table:
    """Parameters without and with the networks; intervals of a level, ``reach`` standard errors to each side.

    With the physics ``alone`` as `identify` would judge it, its grades, the bounds and what speaks against a value are
    told, too, for which a terminal has no room.
    """
    sides = f"± ({100 * level:g} %)>", "± >"
    table = open_table("parameter", "physics alone>", sides[0], "hybrid>", sides[1], "unit", "drift [σ]>")
    for head in FULL if alone is not None else ():
        table.add_column(head, justify="right" if "bound" in head else "left")
    rows = zip(
        study.names, study.physics, study.physics_error, study.hybrid, study.hybrid_error, study.units, study.drift,
        strict=True,
    )  # fmt: skip
    for name, before, error, after, other, unit, drift in rows:
        moved = f"{drift:+.1f}" if math.isfinite(drift) else "unknown"
        judged = []
        if alone is not None:
            grade, *_, why = judged_cells(alone, name)
            against = [*_against(study, name), *([str(why)] if str(why) else [])]
            judged = [grade, *bound_cells(study.result.system, name), "; ".join(against)]
        table.add_row(
            name,
            f"{before:.5g}",
            f"{reach * error:.2g}",
            f"{after:.5g}",
            f"{reach * other:.2g}",
            unit,
            moved,
            *judged,
        )
    return table


def _against(study: HybridStudy, name: str) -> list[str]:
    """What the networks may have done to a parameter, so that it does not mean what its name says."""
    k = study.names.index(name)
    said = {
        "moved by the networks": math.isfinite(study.drift[k]) and abs(study.drift[k]) > DRIFT,
        "a network could do its work": study.result.chosen > 0 and study.blur[k] > BLUR,
    }
    return [words for words, holds in said.items() if holds]


def ladder_table(study: HybridStudy) -> Table:
    """The prices, what was lost at each, and which one the validation records chose."""
    table = open_table("price", "train error>", "typical validation error>", "gradients>", "ended", "")
    for k, rung in enumerate(study.result.rungs):
        price = "physics alone" if math.isinf(rung.price) else f"{rung.price:g}"
        errors = (f"{math.sqrt(2.0 * loss):.3f}" for loss in (rung.train, rung.validation))
        table.add_row(
            price,
            *errors,
            str(rung.iterations),
            rung.status.replace("_", " "),
            "chosen" if k == study.result.chosen else "",
        )
    return table


def role_table(roles: tuple[NetworkRole, ...]) -> Table:
    """What each network does."""
    heads = ("RMS>", "share of torque>", "of variance>", "overlap with physics>", "most alike")
    table = open_table("network", *heads)
    for role in roles:
        name, cosine = role.alike[0] if role.alike else ("", 0.0)
        table.add_row(
            role.where, f"{role.rms:.3g} {role.unit}", f"{100 * role.share:.2g} %",
            f"{100 * role.variance_share:.2g} %", f"{role.overlap:.2f}", f"{name} ({cosine:.2f})",
        )  # fmt: skip
    return table


def error_table(study: HybridStudy, dataset: Dataset) -> Table:
    """Free-run error of each record, 1 where it is as the weights say."""
    table = open_table("record", "role", "physics alone>", "hybrid>")
    for name, (before, after) in study.errors.items():
        role = "validation" if name in study.validation else dataset[name].role
        table.add_row(name, role, f"{before:.3g}", f"{after:.3g}")
    return table


def drift_figure(study: HybridStudy) -> Figure:
    """A bar a parameter: how far it moved when the networks came in, in standard errors."""
    drift = np.nan_to_num(study.drift)
    with journal():
        figure = new_figure(0.22 * len(drift) + 0.8, 3.5)
        axes = figure.subplots()
        far = np.abs(drift) > 3.0
        axes.barh(np.arange(len(drift)), drift, color=np.where(far, COLOURS[1], COLOURS[0]), height=0.6)
        axes.axvspan(-3.0, 3.0, color=GREY, alpha=0.15, lw=0)
        axes.axvline(0.0, color=GREY, lw=0.6)
        axes.set_yticks(np.arange(len(drift)), [symbol(name) for name in study.names])
        axes.invert_yaxis()
        axes.set_xlabel("drift from physics alone to hybrid [standard errors]")
    return figure


def map_figure(role: NetworkRole) -> Figure:
    """A network's output over speed and angle, and the motion of the records."""
    with journal():
        figure = new_figure(2.6, 4.6)
        axes = figure.subplots()
        reach = float(np.abs(role.map).max()) or 1.0
        image = axes.pcolormesh(
            role.angle, role.speed, role.map, cmap="RdBu_r", vmin=-reach, vmax=reach, rasterized=True
        )
        axes.plot(role.seen[:, 1], role.seen[:, 0], ".", ms=1.2, color="black", alpha=0.35, label="records")
        axes.set(xlabel="angle [rad]", ylabel="speed [rad/s]", title=f"network at {role.where}")
        figure.colorbar(image, label=f"output [{role.unit.replace(' ', chr(0x2009))}]")
    return figure


def hybrid_pictures(study: HybridStudy) -> dict[str, Drawn]:
    """Figures by the name of their file."""
    figures = {"drift": drift_figure(study)} if study.result.chosen else {}
    figures |= {f"map_{role.where.replace('/', '_')}": map_figure(role) for role in study.roles}
    return {name: drawn(figure) for name, figure in figures.items()}
