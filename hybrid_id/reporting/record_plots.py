"""Pictures of records: measured against simulated, with the residual and the input that drove it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.excitation import Multisine
from hybrid_id.records.units import stem
from hybrid_id.reporting.style import (
    COLOURS,
    DASHES,
    GREY,
    journal,
    label,
    new_figure,
    pad,
    scaled_unit,
    symbol,
)
from hybrid_id.reporting.tables import count
from hybrid_id.study import Comparison, Replay

MAX_INPUTS = 3
MAX_LABEL = 32


def fit_figure(dataset: Dataset, replay: Replay, title: str = "") -> Figure:
    """One record: each output measured and simulated, its residual, and the inputs below."""
    return _overlay(dataset, {"simulated": replay}, title or f"{replay.record.name} ({replay.record.role})")


def comparison_figure(dataset: Dataset, comparison: Comparison, record: str) -> Figure:
    """One record: each output measured and simulated by every model, residuals and inputs below."""
    row = comparison.records.index(record)
    replays = {name: replays[row] for name, replays in comparison.replays.items()}
    return _overlay(dataset, replays, f"{record} ({dataset[record].role})")


def excitation_figure(design: Multisine, name: str = "u1") -> Figure:
    """A designed multisine over time, and the amplitude of its tones."""
    with journal():
        figure = new_figure(2.3)
        left, right = figure.subplots(1, 2, width_ratios=(3, 1))
        left.plot(design.time, design.signal, color=COLOURS[0], lw=0.8)
        for limit in (design.offset - design.peak, design.offset + design.peak):
            left.axhline(limit, color=GREY, lw=0.6, ls=(0, (4, 2)))
        left.set(xlabel="time [s]", ylabel=label(name, "V"))
        left.set_title(f"crest factor {design.crest_factor:.3f}", loc="left")
        left.margins(x=0)
        right.vlines(design.frequencies, 0, design.amplitudes, color=COLOURS[0])
        right.plot(design.frequencies, design.amplitudes, "o", ms=3, color=COLOURS[0])
        right.set(xlabel="frequency [Hz]", ylabel="amplitude [V]", ylim=(0, None))
        right.set_title(count(len(design.frequencies), "tone"), loc="left")
        return figure


def _overlay(dataset: Dataset, replays: Mapping[str, Replay], title: str) -> Figure:
    record = next(iter(replays.values())).record
    inputs = _moving(record.inputs)
    signals = [
        channel for channel in dataset.outputs if all(channel.name in r.outputs for r in replays.values())
    ]
    heights = [2.4, 1.0] * len(signals) + [0.9] * len(inputs)
    with journal():
        figure = new_figure(0.65 * sum(heights) + 0.5)
        panels = np.ravel(figure.subplots(len(heights), 1, sharex=True, height_ratios=heights))
        for k, channel in enumerate(signals):
            _signal(panels[2 * k], panels[2 * k + 1], record.time, channel, replays)
        panels[0].set_title(title, loc="left")
        units = {channel.name: channel.unit for channel in dataset.inputs}
        for axes, name in zip(panels[2 * len(signals) :], inputs, strict=True):
            axes.step(record.time, record.inputs[name], where="post", color="black", lw=0.7)
            axes.set_ylabel(f"{symbol(name)}\n{scaled_unit(units[name], 0)}".rstrip())
            pad(axes)
        panels[-1].set_xlabel("time [s]")
        panels[-1].set_xlim(record.time[0], record.time[-1])
        figure.align_ylabels(panels)
        return figure


def _signal(
    main: Axes, below: Axes, time: np.ndarray, channel: Channel, replays: Mapping[str, Replay]
) -> None:
    measured = next(iter(replays.values())).record.signal(channel.name)
    main.plot(time, measured, color=GREY, lw=2.4, alpha=0.75, label="measured", solid_capstyle="round")
    below.axhline(0.0, color="black", lw=0.5)
    for k, (long_name, replay) in enumerate(replays.items()):
        name = long_name if len(long_name) <= MAX_LABEL else f"…{long_name[1 - MAX_LABEL :]}"
        colour, dash = COLOURS[k % len(COLOURS)], DASHES[k % len(DASHES)]
        if replay.status != "ok":
            main.plot([], [], color=colour, ls=dash, label=f"{name}: diverged")
            continue
        fit = replay.fit[channel.name]
        error = measured - replay.outputs[channel.name]
        main.plot(
            time,
            replay.outputs[channel.name],
            color=colour,
            ls=dash,
            lw=1.0,
            label=f"{name}, fit {fit:.2f} %",
        )
        below.plot(time, error, color=colour, lw=0.6, alpha=0.9)
    main.set_ylabel(label(channel.name, channel.unit))
    pad(main)
    main.legend(loc="lower right", bbox_to_anchor=(1.0, 0.99), ncols=3, borderaxespad=0.0)
    below.set_ylabel("residual\n" + label(channel.name, channel.unit).split(" ")[-1])
    pad(below)


def _moving(inputs: Mapping[str, np.ndarray]) -> list[str]:
    """The inputs that are worth a panel: those that change, settings of the loop last."""
    moving = [name for name, values in inputs.items() if np.ptp(values) > 0]
    settings = ("gain", "enable", "supply")
    return sorted(moving, key=lambda name: stem(name) in settings)[:MAX_INPUTS]
