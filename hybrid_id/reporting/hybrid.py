"""A hybrid training as plain data, tables, pictures and one page."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from hybrid_id.records.dataset import Dataset
from hybrid_id.reporting.page import Page, records_section
from hybrid_id.reporting.residuals import Residuals, residual_blocks
from hybrid_id.reporting.study import LEGEND, bound_cells, reliability_cells
from hybrid_id.reporting.style import journal, new_figure, pixels, unit
from hybrid_id.reporting.tables import capital, count, interval_words, table
from hybrid_id.statistics.uncertainty import normal_interval
from hybrid_id.study import Study
from hybrid_id.study.hybrid import HybridStudy, NetworkRole


def hybrid_result(study: HybridStudy) -> dict[str, Any]:
    """Everything that a hybrid training says, as plain data."""
    result = study.result
    columns = {
        "unit": study.units,
        "physics": study.physics,
        "physics_std_error": study.physics_error,
        "hybrid": study.hybrid,
        "hybrid_std_error": study.hybrid_error,
        "unpriced_std_error": result.models[result.chosen].loose,
        "half_interval_beside_networks": study.room,
        "drift_sigma": study.drift,
    }
    of_role = ("where", "unit", "rms", "share", "variance_share", "overlap", "alike", "worth", "room")
    return {
        "validation_records": study.validation,
        "price": result.price,
        "physics_alone": result.chosen == 0,
        "interrupted": result.interrupted,
        "parameters": {
            name: {head: values[k] for head, values in columns.items()} for k, name in enumerate(study.names)
        },
        "models": {
            name: {
                "train_loss": model.train, "validation_loss": model.validation, "status": model.status,
                "gradients": model.iterations,
            }
            for name, model in zip(("physics", "hybrid"), result.models, strict=False)
        },
        "networks": [
            {name: getattr(role, name) for name in of_role} | {"alike": dict(role.alike)} for role in study.roles
        ],
        "error_with_one_set": study.pooled,
        "error_with_per_record_fits": study.own,
        "weighted_error": {n: {"physics": a, "hybrid": b} for n, (a, b) in study.errors.items()},
        "warnings": study.warnings,
    }  # fmt: skip


def hybrid_tables(study: HybridStudy, dataset: Dataset) -> RenderableType:
    """Parameters, both models, the networks and the errors, with the warnings in words."""
    warnings = (Text(warning, style="yellow") for warning in study.warnings)
    tables = drift_table(study), model_table(study), role_table(study.roles)
    return Group(*tables, error_table(study, dataset), *warnings)


def drift_table(study: HybridStudy, alone: Study | None = None) -> Table:
    """Parameters without and with the networks, with their intervals.

    With the physics ``alone`` as `identify` would judge it, its reliability, the bounds and what speaks against a value
    are given, too, for which a terminal has no room.
    """
    heads, rows = (f"{100 * study.level:g} % interval>", f"{100 * study.level:g} % interval >"), []
    without = normal_interval(study.physics, study.physics_error, study.level)
    with_networks = normal_interval(study.hybrid, study.hybrid_error, study.level)
    for k, name in enumerate(study.names):
        before, after, drift = study.physics[k], study.hybrid[k], study.drift[k]
        row = [
            name, f"{before:.5g}", interval_words(*without[k]), f"{after:.5g}",
            interval_words(*with_networks[k]), study.units[k],
            f"{drift:+.1f}" if math.isfinite(drift) else "unknown",
        ]  # fmt: skip
        if alone is not None:
            word, *_, why = reliability_cells(alone, name)
            against = [*study.against(name), *([str(why)] if str(why) else [])]
            row = [name, word, *row[1:], *bound_cells(study.result.system, name), "; ".join(against)]
        rows.append(row)
    values = ("physics alone>", heads[0], "hybrid>", heads[1], "unit", "drift [σ]>")
    if alone is None:
        return table(("parameter", *values), rows)
    judged = ("lower bound>", "upper bound>", "what speaks against it")
    return table(("parameter", "reliability, physics alone", *values, *judged), rows)


def model_table(study: HybridStudy) -> Table:
    """Errors of the physics alone and with networks, and which of both the validation records chose."""
    rows = [
        (
            "with networks" if k else "physics alone",
            *(f"{math.sqrt(2.0 * loss):.3f}" for loss in (model.train, model.validation)),
            str(model.iterations), model.status.replace("_", " "), "chosen" if k == study.result.chosen else "",
        )
        for k, model in enumerate(study.result.models)
    ]  # fmt: skip
    return table(("model", "train error>", "typical validation error>", "gradients>", "ended", ""), rows)


def role_table(roles: tuple[NetworkRole, ...]) -> Table:
    """What each network does."""
    heads = ("network", "RMS>", "share of torque>", "of variance>", "overlap with physics>", "most alike")
    rows = [
        (
            role.where, f"{role.rms:.3g} {role.unit}", f"{100 * role.share:.2g} %",
            f"{100 * role.variance_share:.2g} %", f"{role.overlap:.2f}",
            "{} ({:.2f})".format(*(role.alike[0] if role.alike else ("", 0.0))),
        )
        for role in roles
    ]  # fmt: skip
    return table(heads, rows)


def error_table(study: HybridStudy, dataset: Dataset) -> Table:
    """Free-run error of each record, 1 where it is as the weights say."""
    rows = [
        (
            name,
            "validation" if name in study.validation else dataset[name].role,
            f"{before:.3g}",
            f"{after:.3g}",
        )
        for name, (before, after) in study.errors.items()
    ]
    return table(("record", "role", "physics alone>", "hybrid>"), rows)


@journal()
def map_figure(
    angle: np.ndarray, speed: np.ndarray, output: np.ndarray, seen: np.ndarray, title: str, words: str
) -> Figure:
    """A network's output ``(n_v, n_q)`` over angle and speed, and both at samples of the records, ``(n, 2)``."""
    figure = new_figure(2.6, 4.6)
    axes = figure.subplots()
    reach = float(np.abs(output).max()) or 1.0
    image = axes.pcolormesh(angle, speed, output, cmap="RdBu_r", vmin=-reach, vmax=reach, rasterized=True)
    axes.plot(seen[:, 0], seen[:, 1], ".", ms=1.2, color="black", alpha=0.35)
    axes.set(xlabel="angle [rad]", ylabel="speed [rad/s]", title=title)
    figure.colorbar(image, label=words)
    return figure


def hybrid_pictures(study: HybridStudy) -> dict[str, np.ndarray]:
    """Figures by the name of their file."""
    return {
        f"map_{role.where.replace('/', '_')}": pixels(
            map_figure(
                role.angle, role.speed, role.map, role.seen[:, ::-1], f"network at {role.where}",
                f"output [{unit(role.unit)}]",
            )
        )
        for role in study.roles
    }  # fmt: skip


_ERRORS = (
    "1 is as the weights say. All are errors of free runs from measured first states; the typical validation error is "
    "the geometric mean over ten parts of each record, for a run that has lost its record says little from there on. "
    "The errors further down are the RMS of whole free runs."
)
_RELIABLE = (
    "The reliability is that of physics alone, as identify would give it: beside a network there is no second way to "
    "compute an error. A network that could do a parameter's work leaves only the price to hold its value."
)


def _lead(study: HybridStudy) -> str:
    """The outcome in plain words."""
    models, chosen, warnings = study.result.models, study.result.chosen, study.warnings
    if not chosen:
        words = warnings[0] if warnings else "physics alone is kept"
        return f"{capital(words)}."
    before, after = (math.sqrt(2.0 * models[k].validation) for k in (0, chosen))
    words = (
        f"{count(len(study.roles), 'network')} beside the physics, at the price {study.result.price:g}: the typical "
        f"error on validation records falls from {before:.3g} to {after:.3g} (1: as the noise says)."
    )
    if warnings:
        return f"{words} Read the {count(len(warnings), 'warning')} below before you read the parameters."
    return f"{words} No network does the physics' work."


def hybrid_page(
    dataset: Dataset,
    study: HybridStudy,
    pictures: Mapping[str, np.ndarray],
    *,
    alone: Study,
    residuals: Residuals,
) -> Page:
    """The page of a hybrid training, with physics ``alone`` as `identify` would judge it."""
    page = Page(f"Physics and networks on {dataset.name}", _lead(study))
    warnings = (Text(f"{capital(words)}.", style="yellow") for words in study.warnings)
    page.section("Parameters").add(drift_table(study, alone), LEGEND, _RELIABLE, *warnings)
    networks = page.section("Networks")
    if not study.result.chosen:
        networks.add("What the networks have learnt; they are not kept.")
    networks.add(role_table(study.roles))
    for picture in pictures.values():
        networks.figure(picture, "Output over speed and angle; dots: where the records have been.")
    page.section("Errors").add(_ERRORS, model_table(study), error_table(study, dataset))
    page.section("Residuals").add(*residual_blocks(residuals, dataset, alone.outputs))
    records_section(page, dataset)
    return page
