"""Pictures of a diagnosis: how large the gap is, where it lies, what is missing there, and what remains."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hybrid_id.diagnosis.locate import Location
from hybrid_id.diagnosis.measure import Errors
from hybrid_id.diagnosis.result import Diagnosis
from hybrid_id.diagnosis.round import Round
from hybrid_id.records.dataset import Dataset
from hybrid_id.reporting.gap_maps import MODELS, map_figures, units_of
from hybrid_id.reporting.gap_words import LEAST_SHARE, joint_words, place_words, side_words, words_of
from hybrid_id.reporting.html.live import record_plot
from hybrid_id.reporting.html.twin import Drawn, drawn
from hybrid_id.reporting.record_plots import comparison_figure
from hybrid_id.reporting.style import (
    DASHES,
    GREY,
    journal,
    new_figure,
    pixels,
    power_of_ten,
    scaled_unit,
    unit,
)
from hybrid_id.simulation.prepare import SIGNAL_SHARE
from hybrid_id.study import Comparison, replay
from hybrid_id.systems.chain import System

PROFILES, SHARES, ODDS = 3, 9, 12
MAX_NAME = 16


def diagnosis_figures(
    dataset: Dataset, nominal: System, diagnosis: Diagnosis, *, signal_share: float = SIGNAL_SHARE
) -> dict[str, Drawn]:
    """Every picture of a diagnosis by the name of its file.

    Args:
        dataset: the records.
        nominal: today's model.
        diagnosis: the result.
        signal_share: see :func:`hybrid_id.simulation.prepare.make_batch`.
    """
    figures: dict[str, Figure] = {}
    if diagnosis.nominal is not None:
        figures["gap"] = gap_figure(diagnosis)
    told = [one for one in diagnosis.where if one.share > LEAST_SHARE]
    if any(len(one.grid) for one in told):
        figures["missing_torque"] = torque_figure(dataset, diagnosis)
    if told:
        figures["where"] = share_figure(diagnosis)
    figures |= map_figures(dataset, diagnosis, signal_share)
    figures["suspects"] = odds_figure(diagnosis)
    worst = worst_comparison(dataset, nominal, diagnosis)
    image = pixels(comparison_figure(dataset, worst, worst.records[0]))
    found = {name: drawn(figure) for name, figure in figures.items()}
    return found | {"worst_record": Drawn(image, record_plot(dataset, worst, worst.records[0]))}


def gap_figure(diagnosis: Diagnosis) -> Figure:
    """Normalised error on the test records, over all and one by one, today's model down to the floor."""
    models = {name: errors for name, errors in _errors(diagnosis).items() if errors is not None}
    records = list(next(iter(models.values())).by_record)
    with journal():
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
        left.set(xlim=(0, 1.16 * top), xlabel="normalised error, mean of the test records")
        left.invert_yaxis()
        if diagnosis.shrink is not None:
            left.axvline(diagnosis.shrink.floor, color="black", lw=0.8, ls=(0, (4, 2)), label="right model")
            left.legend(loc="lower right")
        for name, errors in models.items():
            values = [errors.by_record[record] for record in records]
            right.plot(values, range(len(records)), "o", ms=4.5, color=MODELS[name], label=name)
        for row, record in enumerate(records):
            values = [errors.by_record[record] for errors in models.values()]
            right.plot([min(values), max(values)], [row, row], color=GREY, lw=0.8, zorder=0)
        right.set_yticks(range(len(records)), [_short(record) for record in records])
        right.set(
            xscale="log", xlabel="normalised error of each test record", ylim=(len(records) - 0.5, -0.5)
        )
        _plain_logarithm(right)
        right.legend(loc="lower center", bbox_to_anchor=(0.5, 0.99), ncols=3, borderaxespad=0.0)
        return figure


def torque_figure(dataset: Dataset, diagnosis: Diagnosis) -> Figure:
    """The torque that the re-fitted model lacks over the signals that tell most, and what the corrected one lacks."""
    shown = [one for one in diagnosis.where if one.share > LEAST_SHARE and len(one.grid)][:PROFILES]
    after = {_key(one): one for one in diagnosis.left}
    with journal():
        figure = new_figure(2.1)
        panels = np.atleast_1d(figure.subplots(1, len(shown)))
        for axes, one in zip(panels, shown, strict=True):
            exponent = power_of_ten(one.torque)
            axes.axhline(0.0, color="black", lw=0.5)
            axes.plot(
                one.grid, one.torque / 10.0**exponent, color=MODELS["re-fitted"], label="re-fitted model"
            )
            if diagnosis.selected and (left := after.get(_key(one))) is not None and len(left.grid):
                torque, colour = left.torque / 10.0**exponent, MODELS["corrected"]
                axes.plot(left.grid, torque, color=colour, ls=DASHES[1], label="corrected model")
            axes.set(
                xlabel=_axis(dataset, one),
                ylabel=f"missing torque {scaled_unit(units_of(dataset, one.joint)[1], exponent)}",
            )
            axes.set_title(
                f"{side_words(one.joint, one.place)}: {100 * max(one.share, 0.0):.0f} %", loc="left"
            )
            axes.set_xlim(one.grid[0], one.grid[-1])
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper right", ncols=len(labels))
        return figure


def share_figure(diagnosis: Diagnosis) -> Figure:
    """Part of what each model leaves that a torque over one signal explains on records left out."""
    shown = [one for one in diagnosis.where if one.share > LEAST_SHARE][:SHARES]
    after = {_key(one): max(one.share, 0.0) for one in diagnosis.left}
    with journal():
        figure = new_figure(0.27 * len(shown) + 0.9)
        axes = figure.subplots()
        rows = np.arange(len(shown))
        before = [100 * max(one.share, 0.0) for one in shown]
        if diagnosis.selected:
            left = [100 * after.get(_key(one), 0.0) for one in shown]
            axes.barh(rows - 0.18, before, 0.34, color=MODELS["re-fitted"], label="re-fitted model")
            axes.barh(rows + 0.18, left, 0.34, color=MODELS["corrected"], label="corrected model")
        else:
            axes.barh(rows, before, 0.6, color=MODELS["re-fitted"], label="re-fitted model")
        axes.set_yticks(rows, [f"{side_words(o.joint, o.place)}: {o.signal}" for o in shown])
        axes.set(xlim=(0, 100), xlabel="explained part of what the model leaves [% of the mean square]")
        axes.invert_yaxis()
        axes.legend(loc="lower right")
        return figure


def odds_figure(diagnosis: Diagnosis) -> Figure:
    """Errors of prediction of the candidates of the first round, and the probability of each."""
    first: Round = diagnosis.search.rounds[0]
    shown = first.candidates[:ODDS]
    suspects = {(s.name, s.where): s for s in diagnosis.effects}
    with journal():
        figure = new_figure(0.21 * len(shown) + 0.9)
        left, right = figure.subplots(1, 2, sharey=True, width_ratios=(1.7, 1))
        names = []
        for row, candidate in enumerate(shown):
            name = next(n for n in candidate.effects if n not in first.before.effects)
            names.append(f"{words_of(name[0])} {place_words(name[1])}, {joint_words(name[1])}")
            suspect = suspects[name]
            colour = MODELS["corrected"] if suspect.selected else GREY
            ratio = (candidate.evidence.error / first.before.evidence.error) ** 0.5
            left.plot([min(ratio, 1.0), 1.0], [row, row], color=GREY, lw=0.8, zorder=0)
            left.plot(ratio, row, "o", ms=4.5, color=colour)
            right.barh(row, suspect.probability, 0.6, color=colour)
        left.axvline(1.0, color="black", lw=0.6)
        left.set_yticks(range(len(shown)), names)
        left.set_xlabel("error of prediction / that of the re-fitted model")
        right.set(xlim=(0, 1), xlabel="probability")
        right.tick_params(axis="y", length=0)
        left.invert_yaxis()
        return figure


def worst_comparison(dataset: Dataset, nominal: System, diagnosis: Diagnosis) -> Comparison:
    """All models on the test record that the last one predicts worst (a train record where there is no test)."""
    errors = diagnosis.with_effect
    name = (
        dataset.train[0].name if errors is None else max(errors.by_record, key=errors.by_record.__getitem__)
    )
    part, search = dataset.select([name]), diagnosis.search
    replays = {
        "today": replay(part, nominal),
        "re-fitted": replay(part, search.base.system, engine=search.base.result.engine),
    }
    if diagnosis.selected:
        replays["corrected"] = replay(part, diagnosis.model, engine=search.chosen.result.engine)
    return Comparison(replays)


def _errors(diagnosis: Diagnosis) -> dict[str, Errors | None]:
    corrected = {"corrected": diagnosis.with_effect} if diagnosis.selected else {}
    return {"today": diagnosis.nominal, "re-fitted": diagnosis.refit} | corrected


def _key(one: Location) -> tuple[str, str, str]:
    return one.joint, one.place, one.signal


def _axis(dataset: Dataset, one: Location) -> str:
    """Axis label of the signal that a missing torque depends on."""
    side = "link" if one.place == "load" else "motor"
    if one.signal != "command":
        return f"{side} {one.signal} [{units_of(dataset, one.joint)[0]}{'/s' * (one.signal == 'speed')}]"
    drives = [f"{stem}{one.joint.removeprefix('joint')}" for stem in ("u", "duty", "tau", "i")]
    text = next((unit(channel.unit) for channel in dataset.inputs if channel.name in drives), "")
    return f"command [{text}]" if text else "command"


def _plain_logarithm(axes: Axes) -> None:
    """Numbers instead of powers of ten, where they fit."""
    low, high = axes.get_xlim()
    steps = (1, 2, 5) if high < 40 * low else (1,)
    ticks = [tick for e in range(-6, 4) for m in steps if low <= (tick := m * 10.0**e) <= high]
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.minorticks_off()


def _short(name: str) -> str:
    return name if len(name) <= MAX_NAME else f"…{name[1 - MAX_NAME :]}"
