"""Pictures of a diagnosis: how large the gap is, where it lies, what is missing there, and what remains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hybrid_id.diagnosis.locate import Location
from hybrid_id.diagnosis.maps import Reversals, TorqueMap
from hybrid_id.diagnosis.result import Diagnosis
from hybrid_id.records.dataset import Dataset
from hybrid_id.reporting.diagnosis_words import (
    LEAST_SHARE,
    errors_by_name,
    percent,
    side_words,
    words_of,
)
from hybrid_id.reporting.study_figures import comparison_figure
from hybrid_id.reporting.style import (
    COLOURS,
    DASHES,
    GREY,
    journal,
    legend_above,
    new_figure,
    pixels,
    plain_logarithm,
    power_of_ten,
    rows_of_panels,
    scaled_unit,
    shortened,
    symbol,
    unit,
)
from hybrid_id.systems.by_joint import with_joint_names
from hybrid_id.systems.chain import System

PROFILES, SHARES = 3, 9
"""Panels of missing torques and bars of shares that are drawn at most."""
ANGLES = 4
"""Outputs whose reversals are drawn at most."""
MAX_NAME = 16
MODELS = {"nominal": COLOURS[0], "re-fitted": COLOURS[1], "corrected": COLOURS[2]}


def diagnosis_figures(diagnosis: Diagnosis) -> dict[str, np.ndarray]:
    """Every picture of a diagnosis by the name of its file."""
    details = diagnosis.details
    outputs = with_joint_names(details.dataset.outputs, diagnosis.model)
    dataset = replace(details.dataset, outputs=outputs)
    figures: dict[str, Figure] = {}
    if diagnosis.selected or diagnosis.unknown:
        figures["shares"] = shares_figure(diagnosis)
    if diagnosis.nominal is not None:
        figures["gap"] = gap_figure(diagnosis)
    located = [one for one in diagnosis.location if one.share > LEAST_SHARE]
    if any(len(one.grid) for one in located):
        figures["missing_torque"] = torque_figure(dataset, diagnosis)
    if located:
        figures["location"] = location_figure(diagnosis)
    maps = [one for one in details.maps if max(found.share for found in one.values()) > LEAST_SHARE]
    if maps:
        figures["torque_map"] = torque_map_figure(dataset, maps, diagnosis.model)
    if all(details.reversals.values()):
        figures["reversals"] = reversal_figure(dataset, details.reversals)
    worst = details.worst_record
    figures["worst_record"] = comparison_figure(dataset, worst, worst.records[0])
    return {name: pixels(figure) for name, figure in figures.items()}


@journal()
def shares_figure(diagnosis: Diagnosis) -> Figure:
    """How the gap divides: a bar for each selected effect and for what remains, with 95 % intervals."""
    rows = [
        (words_of(c.name), c.share or 0.0, c.share_interval, MODELS["corrected"]) for c in diagnosis.selected
    ]
    rows.append(("unexplained", diagnosis.remainder, diagnosis.remainder_interval, GREY))
    figure, (axes,) = rows_of_panels([name for name, *_ in rows])
    for row, (_, share, interval, colour) in enumerate(rows):
        axes.barh(row, 100 * share, 0.6, color=colour)
        if interval is not None:
            low, high = interval
            axes.plot([100 * low, 100 * high], [row, row], color="black", lw=1.2)
    axes.set(xlim=(0, 105), xlabel="share of the gap with its 95 % interval [%]")
    return figure


@journal()
def gap_figure(diagnosis: Diagnosis) -> Figure:
    """Normalised error on the test records, over all and one by one, nominal model down to the noise floor."""
    models = errors_by_name(diagnosis)
    records = list(next(iter(models.values())).by_record)
    figure = new_figure(max(1.7, 0.24 * len(records) + 1.0))
    left, right = figure.subplots(1, 2, width_ratios=(1, 1.15))
    bars = {name: errors.nrmse for name, errors in models.items()}
    colours = [MODELS[name] for name in bars]
    left.barh(range(len(bars)), list(bars.values()), color=colours, height=0.62)
    top = max(bars.values())
    for row, value in enumerate(bars.values()):
        left.text(value + 0.015 * top, row, f"{value:.3g}", va="center", fontsize=7.5)
    left.set_yticks(range(len(bars)), list(bars))
    left.tick_params(axis="y", length=0)  # beside a bar of no length a tick reads as a minus
    left.set(xlim=(0, 1.16 * top), xlabel="NRMSE, mean of outputs and test records")
    left.invert_yaxis()
    if diagnosis.shrink is not None:
        left.axvline(diagnosis.shrink.floor, color="black", lw=0.8, ls=(0, (4, 2)), label="noise floor")
        left.legend(loc="lower right")
    values = {name: [errors.by_record[record] for record in records] for name, errors in models.items()}
    errors_by_row(right, [shortened(record, MAX_NAME) for record in records], values)
    right.set_xlabel("NRMSE of each test record, mean of the outputs")
    return figure


def errors_by_row(axes: Axes, names: Sequence[str], values: Mapping[str, Sequence[float]]) -> None:
    """A row a record or output: the errors of each model, on a logarithmic axis."""
    for model, errors in values.items():
        axes.plot(errors, range(len(names)), "o", ms=4.5, color=MODELS[model], label=model)
    for row, errors in enumerate(zip(*values.values(), strict=True)):
        axes.plot([min(errors), max(errors)], [row, row], color=GREY, lw=0.8, zorder=0)
    axes.set_yticks(range(len(names)), names)
    axes.set(xscale="log", ylim=(len(names) - 0.5, -0.5))
    plain_logarithm(axes.xaxis)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 0.99), ncols=3, borderaxespad=0.0)


@journal()
def torque_figure(dataset: Dataset, diagnosis: Diagnosis) -> Figure:
    """The torque that the re-fitted model lacks over the signals that explain most, and that of the corrected one."""
    shown = [one for one in diagnosis.location if one.share > LEAST_SHARE and len(one.grid)][:PROFILES]
    after = {_key(one): one for one in diagnosis.residual_after}
    figure = new_figure(2.1)
    panels = np.atleast_1d(figure.subplots(1, len(shown)))
    for axes, one in zip(panels, shown, strict=True):
        exponent = power_of_ten(one.torque)
        axes.axhline(0.0, color="black", lw=0.5)
        unit, factor, torque_unit = units_of(dataset, one.joint)
        factor = factor if one.signal in ("angle", "speed") else 1.0
        axes.plot(
            factor * one.grid,
            one.torque / 10.0**exponent,
            color=MODELS["re-fitted"],
            label="re-fitted model",
        )
        if diagnosis.selected and (left := after.get(_key(one))) is not None and len(left.grid):
            torque, colour = left.torque / 10.0**exponent, MODELS["corrected"]
            axes.plot(factor * left.grid, torque, color=colour, ls=DASHES[1], label="corrected model")
        axes.set(
            xlabel=_axis(dataset, one, unit),
            ylabel=f"missing torque {scaled_unit(torque_unit, exponent)}",
        )
        where = side_words(one.joint, one.side, diagnosis.model)
        axes.set_title(f"{where}: {100 * max(one.share, 0.0):.0f} %", loc="left")
        axes.set_xlim(factor * one.grid[0], factor * one.grid[-1])
    legend_above(figure, panels[0])
    return figure


@journal()
def location_figure(diagnosis: Diagnosis) -> Figure:
    """Part of the residual of each model that a torque over one signal explains on records left out."""
    shown = [one for one in diagnosis.location if one.share > LEAST_SHARE][:SHARES]
    after = {_key(one): max(one.share, 0.0) for one in diagnosis.residual_after}
    names = [f"{side_words(one.joint, one.side, diagnosis.model)}: {one.signal}" for one in shown]
    figure, (axes,) = rows_of_panels(names)
    rows = np.arange(len(shown))
    before = [100 * max(one.share, 0.0) for one in shown]
    if diagnosis.selected:
        left = [100 * after.get(_key(one), 0.0) for one in shown]
        axes.barh(rows - 0.18, before, 0.34, color=MODELS["re-fitted"], label="re-fitted model")
        axes.barh(rows + 0.18, left, 0.34, color=MODELS["corrected"], label="corrected model")
    else:
        axes.barh(rows, before, 0.6, color=MODELS["re-fitted"], label="re-fitted model")
    axes.set(xlim=(0, 100), xlabel="explained part of the residual [% of the mean square]")
    axes.legend(loc="lower right")
    return figure


@journal()
def torque_map_figure(dataset: Dataset, maps: Sequence[Mapping[str, TorqueMap]], system: System) -> Figure:
    """A row a joint: what the re-fitted model misses over angle and speed, and the corrected one alike."""
    figure = new_figure(2.3 * len(maps) + 0.2)
    grid = figure.subplots(len(maps), len(maps[0]), squeeze=False)
    for panels, of_joint in zip(grid, maps, strict=True):
        angle_unit, factor, torque_unit = units_of(dataset, next(iter(of_joint.values())).joint)
        reach = max(float(np.nanmax(np.abs(one.torque))) for one in of_joint.values()) or 1.0
        for axes, (name, one) in zip(panels, of_joint.items(), strict=True):
            image = axes.pcolormesh(
                factor * one.angle, factor * one.speed, one.torque, cmap="RdBu_r", vmin=-reach, vmax=reach,
                rasterized=True,
            )  # fmt: skip
            side = "link" if one.side == "load" else "motor"
            axes.set(
                xlabel=f"{side} angle [{unit(angle_unit)}]", ylabel=f"{side} speed [{unit(angle_unit)}/s]"
            )
            where = side_words(one.joint, one.side, system)
            share = percent(one.share) if one.share > LEAST_SHARE else "chance"
            axes.set_title(f"{where}, {name}: {share}", loc="left")
            figure.colorbar(image, ax=axes, label=f"missing torque [{unit(torque_unit)}]")
    return figure


@journal()
def reversal_figure(dataset: Dataset, left: Mapping[str, Sequence[Reversals]]) -> Figure:
    """A panel an angle: mean error after a reversal, and its standard error, of every model."""
    outputs = [one.output for one in next(iter(left.values()))][:ANGLES]
    units = {channel.name: channel.shown for channel in dataset.outputs}
    joints = {channel.name: f" ({channel.joint})" for channel in dataset.outputs if channel.joint}
    figure = new_figure(2.1 * len(outputs) + 0.2)
    panels = np.ravel(figure.subplots(len(outputs), 1, squeeze=False))
    for axes, output in zip(panels, outputs, strict=True):
        axes.axhline(0.0, color="black", lw=0.5)
        counts, (unit, factor) = 0, units[output]
        for k, (name, tests) in enumerate(left.items()):
            one = next((t for t in tests if t.output == output), None)
            if one is None:
                continue
            counts = one.count
            axes.plot(one.time, factor * one.mean, color=MODELS[name], ls=DASHES[k], label=f"{name} model")
            ends = (factor * (one.mean + side * one.error) for side in (-1.0, 1.0))
            words = f"{name} model ± standard error"
            axes.fill_between(one.time, *ends, color=MODELS[name], alpha=0.2, lw=0, label=words)
        axes.set(xlabel="time since the reversal [s]", ylabel=f"error {scaled_unit(unit, 0)}")
        axes.set_title(f"{symbol(output)}{joints.get(output, '')}, {counts} reversals", loc="left")
        axes.set_xlim(0.0, None)
    legend_above(figure, panels[0], 2)
    return figure


def units_of(dataset: Dataset, joint: str) -> tuple[str, float, str]:
    """Unit of a joint's angle as it was logged, its factor from SI, and unit of its torque.

    A linear axis has a way and a force.
    """
    number = joint.removeprefix("joint")
    angle = next((c for c in dataset.outputs if c.name in (f"q_m{number}", f"q_a{number}")), None)
    if angle is None:
        return "rad", 1.0, "N m"
    return *angle.shown, "N" if angle.unit == "m" else "N m"


def _key(one: Location) -> tuple[str, str, str]:
    return one.joint, one.side, one.signal


def _axis(dataset: Dataset, one: Location, angle_unit: str) -> str:
    """Axis label of the signal that a missing torque depends on."""
    side = "link" if one.side == "load" else "motor"
    if one.signal != "command":
        return f"{side} {one.signal} [{angle_unit}{'/s' * (one.signal == 'speed')}]"
    drives = [f"{stem}{one.joint.removeprefix('joint')}" for stem in ("u", "duty", "tau", "i")]
    text = next((unit(channel.unit) for channel in dataset.inputs if channel.name in drives), "")
    return f"command [{text}]" if text else "command"
