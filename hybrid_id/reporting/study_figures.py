"""Pictures of a study: parameter sets over the experiments, cross-validation, residuals, profiles, records."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.units import stem
from hybrid_id.reporting.style import (
    COLOURS,
    DASHES,
    GREY,
    WIDTH,
    journal,
    label,
    legend_above,
    new_figure,
    pad,
    pixels,
    power_of_ten,
    scaled_unit,
    shortened,
    symbol,
)
from hybrid_id.statistics.residuals import LEVEL
from hybrid_id.statistics.uncertainty import normal_interval
from hybrid_id.study import Comparison, Replay, Study

MAX_TITLE = 50
"""Characters of a title that leave room for the legend."""
MAX_TICKS, MAX_NAME = 7, 14
"""Records that are named under one panel, and characters of such a name."""
MAX_NUMBERED = 14
"""Largest matrix whose cells are given as numbers too."""


def study_figures(dataset: Dataset, study: Study, runs: Sequence[Replay]) -> dict[str, np.ndarray]:
    """Every picture of a study by the name of its file, with replays of all records by the selected set."""
    figures = {"parameters": parameter_figure(study)}
    if min(study.cross_validation.fits.shape[:2]) > 1:
        figures["cross_validation"] = cross_validation_figure(study)
    figures["residuals"] = residual_figure(study, dataset[study.selected.records[0]].sample_time)
    if study.profiles:
        figures["profiles"] = profile_figure(study)
    for run in runs:
        title = f"{run.record.name} ({run.record.role})"
        with_set = f"{title}, parameter set {study.selection.name}"
        title = with_set if len(with_set) < MAX_TITLE else title
        figures[f"fit_{run.record.name}"] = _overlay(dataset, {"simulated": run}, title)
    return {name: pixels(figure) for name, figure in figures.items()}


@journal()
def parameter_figure(study: Study) -> Figure:
    """Every parameter over the experiments, with its interval, mean and std/mean."""
    count = len(study.names)
    columns = 3 if count in (3, 5, 6, 9) else min(4, count)
    rows = math.ceil(count / columns)
    intervals = np.array([study.intervals(i) for i in range(len(study.sets))])
    longest = max(len(shortened(name, MAX_NAME)) for name in study.cross_validation.set_names)
    figure = new_figure(1.45 * rows + 0.5 + 0.045 * longest, WIDTH * columns / 4 if columns > 1 else 3.5)
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True)
    for k, axes in enumerate(grid.flat):
        if k >= count:
            axes.set_axis_off()
            continue
        x = np.arange(len(study.sets))
        exponent = power_of_ten(study.values[:, k])
        values = study.values[:, k] / 10.0**exponent
        sides = np.abs(intervals[:, k] / 10.0**exponent - values[:, None])  # to the lower and the upper end
        spec = study.system.parameter(study.names[k]).spec
        if spec.prior_std is not None and spec.prior_mean is not None:
            low, high = ((spec.prior_mean + side * spec.prior_std) / 10.0**exponent for side in (-1, 1))
            axes.axhspan(low, high, color=COLOURS[5], alpha=0.18, lw=0, label="prior ± 1 std")
        known, chosen = np.isfinite(sides).all(1), x == study.selection.index
        sets = "pooled set" if study.pooled else "one set a record"
        for words, group, colour, size in (
            (sets, ~chosen, COLOURS[0], 3.5),
            ("selected", chosen, COLOURS[1], 4.5),
        ):
            axes.plot([], [], "o", ms=size, color=colour, label=words)
            axes.plot(x[group], values[group], "o", ms=size, mfc="white", color=colour)
            bars = {"elinewidth": 0.9, "capsize": 1.8, "capthick": 0.9, "color": colour}
            at = group & known
            axes.errorbar(x[at], values[at], yerr=sides[at].T, fmt="o", ms=size, **bars)
        title = symbol(study.names[k])
        if study.variation is not None:
            mean = study.variation.mean[k] / 10.0**exponent
            axes.axhline(mean, color=GREY, lw=0.8, ls=(0, (4, 2)), zorder=0, label="mean")
            percent = study.variation.percent[k]
            title += f",  std/mean {'< 0.01' if percent < 0.01 else f'{percent:.3g}'} %"
        axes.set_title(title, loc="left")
        axes.set_ylabel(scaled_unit(study.selected.units[k], exponent))
        axes.set_xlim(-0.6, len(x) - 0.4)
        shown = x[:: math.ceil(len(x) / MAX_TICKS)]
        names = [
            "all" if study.pooled else shortened(study.cross_validation.set_names[i], MAX_NAME) for i in shown
        ]
        axes.set_xticks(shown, names, rotation=45, ha="right", rotation_mode="anchor")
    for k in range(max(0, count - columns), count):
        grid.flat[k].tick_params(labelbottom=True)
        grid.flat[k].set_xlabel("set" if study.pooled else "record")
    if not np.isfinite(intervals).all():
        grid.flat[0].plot(
            [], [], "o", ms=3.5, mfc="white", mec=COLOURS[0], label="no interval may be claimed"
        )
    legend_above(figure, grid.flat[0])
    return figure


@journal()
def cross_validation_figure(study: Study) -> Figure:
    """Fit of every set on every record; own records framed, the selected set marked."""
    matrix, cross = study.cross_validation.matrix(), study.cross_validation
    n_sets, n_records = matrix.shape
    shown = np.where(np.isfinite(matrix), matrix, np.nan)
    cell = min(0.5, (WIDTH - 2.2) / n_records)
    figure = new_figure(max(0.42 * n_sets, cell * n_sets) + 1.25, min(WIDTH, cell * n_records + 3.6))
    axes = figure.subplots()
    low = math.floor(np.clip(np.nanmin(shown), 0.0, 99.0)) if np.isfinite(shown).any() else 0
    edges = (np.arange(count + 1) - 0.5 for count in (n_records, n_sets))
    image = axes.pcolormesh(*edges, shown, cmap="cividis", vmin=low, vmax=100)
    axes.invert_yaxis()
    if n_records <= MAX_NUMBERED:
        for i, j in np.ndindex(matrix.shape):
            text = _percent(float(matrix[i, j])) if np.isfinite(matrix[i, j]) else "div."
            dark = np.isfinite(shown[i, j]) and shown[i, j] < 0.5 * (low + 100)
            axes.text(j, i, text, ha="center", va="center", color="white" if dark else "black", fontsize=7)
    for i, j in enumerate(cross.own_record):
        if j >= 0:
            axes.add_patch(Rectangle((j - 0.5, i - 0.5), 1, 1, fill=False, ec="black", lw=1.4, zorder=3))
    chosen = study.selection.index
    axes.set_yticks(
        range(n_sets), [f"{'► ' if i == chosen else ''}{n}" for i, n in enumerate(cross.set_names)]
    )
    axes.get_yticklabels()[chosen].set_fontweight("bold")
    axes.set_xticks(range(n_records), cross.record_names, rotation=45, ha="right", rotation_mode="anchor")
    # the numbers by which the set was selected
    side = axes.secondary_yaxis("right")
    pairs = zip(study.selection.mean, study.selection.std, strict=True)
    side.set_yticks(range(n_sets), [f"{_percent(mean)} ± {_percent(std)}" for mean, std in pairs])
    side.tick_params(length=0)
    axes.annotate("mean ± std", (1.0, 1.0), (4, 6), xycoords="axes fraction", textcoords="offset points")
    side.spines[:].set_visible(False)
    axes.set_xticks(np.arange(n_records + 1) - 0.5, minor=True)
    axes.set_yticks(np.arange(n_sets + 1) - 0.5, minor=True)
    axes.grid(which="minor", color="white", lw=0.8)
    axes.tick_params(which="both", length=0)
    axes.spines[:].set_visible(False)
    axes.set(xlabel="replayed on record", ylabel="parameter set")
    signals = ", ".join(symbol(name) for name in cross.signal_names)
    axes.set_title(f"fit [%], mean of {signals}", loc="left")
    figure.colorbar(image, ax=axes, fraction=0.04, pad=0.03)
    return figure


@journal()
def residual_figure(study: Study, sample_time: float) -> Figure:
    """Autocorrelation and distribution of the selected set's weighted residuals."""
    white = study.whiteness
    outputs = study.cross_validation.signal_names[: white.correlation.shape[1]]
    residual = np.concatenate(study.selected.residual)
    figure = new_figure(2.4)
    left, right = figure.subplots(1, 2, width_ratios=(2, 1))
    lags = 1e3 * sample_time * white.lags
    left.axhspan(
        -white.band,
        white.band,
        color=GREY,
        alpha=0.35,
        lw=0,
        label=f"{100 * LEVEL:.0f} % band of white noise",
    )
    left.axhline(0.0, color="black", lw=0.5)
    bins, sizes = np.linspace(-4, 4, 42), np.sqrt(np.mean(residual**2, axis=0))
    for k, name in enumerate(outputs):
        left.plot(lags, white.correlation[:, k], color=COLOURS[k % len(COLOURS)], label=symbol(name))
        shown = np.clip(residual[:, k] / max(sizes[k], 1e-300), -4, 4)
        words, colour = f"{symbol(name)}, RMS {sizes[k]:.2g}", COLOURS[k % len(COLOURS)]
        right.hist(shown, bins, density=True, alpha=0.6, color=colour, label=words)
    grid = np.linspace(-4, 4, 301)
    right.plot(grid, np.exp(-0.5 * grid**2) / math.sqrt(2 * math.pi), color="black", lw=0.9, label="normal")
    left.set_title(
        f"set {study.selection.name}: {100 * white.outside.max():.0f} % of the lags leave the band",
        loc="left",
    )
    right.set_title("RMS in units of the assumed noise", loc="left")
    left.set(xlabel="lag [ms]", ylabel="autocorrelation", xlim=(0, lags[-1]), ylim=(None, 1.05))
    left.legend(loc="upper right")
    right.set(
        xlabel="residual / RMS of its output",
        ylabel="density",
        xlim=(-4, 4),
        ylim=(0, (1.3 + 0.12 * len(outputs)) * right.get_ylim()[1]),
    )
    right.legend(loc="upper right")
    return figure


def _percent(value: float) -> str:
    """A fit as it fits into a cell; how bad a bad one is does not matter."""
    if not -100 < value < 1000:
        return "<−99" if value < 0 else ">999"
    return f"{value:.1f}" if value >= 0 else f"{value:.0f}"


COLUMNS, TOP = 3, 2.5
"""Panels beside each other, and how far up they show, in heights of the threshold."""


@journal()
def profile_figure(study: Study) -> Figure:
    """Rise of the cost over each profiled parameter by its threshold, and the parabola of its standard error."""
    count = len(study.profiles)
    columns = min(COLUMNS, count)
    rows = math.ceil(count / columns)
    figure = new_figure(1.9 * rows + 0.3, WIDTH * columns / COLUMNS if columns > 1 else 3.5)
    grid = figure.subplots(rows, columns, squeeze=False, sharey=True)
    for axes, (name, profile) in zip(grid.flat, study.profiles.items(), strict=False):
        k = study.names.index(name)
        estimate = study.selected.values[k]
        minimum = profile.costs[np.argmin(np.abs(profile.values - estimate))]
        exponent = power_of_ten(np.array([estimate, *profile.values]))
        factor = 10.0**-exponent
        rise = (profile.costs - minimum) / (profile.threshold - minimum)
        ends = [e for e, closed in zip((profile.lower, profile.upper), profile.closed, strict=True) if closed]
        axes.plot(factor * profile.values, rise, "o-", ms=3, color=COLOURS[0])
        axes.plot(factor * estimate, 0.0, "o", ms=4.5, color=COLOURS[1])
        error = study.standard_errors(study.selection.index)[k]
        if np.isfinite(error):
            half = 0.5 * float(np.diff(normal_interval(estimate, error, study.level))[0])
            value = np.linspace(profile.values.min(), profile.values.max(), 100)
            axes.plot(factor * value, ((value - estimate) / half) ** 2, color=GREY, lw=0.8)
        axes.axhline(1.0, color="black", lw=0.8, ls="--")
        for end in ends:
            axes.axvline(factor * end, color=COLOURS[0], lw=0.8, ls=":")
        axes.set(ylim=(-0.1, TOP), xlabel=f"{symbol(name)} {scaled_unit(study.selected.units[k], exponent)}")
    for axes in list(grid.flat)[count:]:
        axes.set_axis_off()
    for axes in grid[:, 0]:
        axes.set_ylabel("rise of the cost\n/ threshold")
    return figure


MAX_INPUTS = 3
MAX_LABEL = 32
LEGEND_COLUMNS = 3


def comparison_figure(dataset: Dataset, comparison: Comparison, record: str) -> Figure:
    """One record: each output measured and simulated by every model, residuals and inputs below."""
    row = comparison.records.index(record)
    replays = {name: replays[row] for name, replays in comparison.replays.items()}
    return _overlay(dataset, replays, f"{record} ({dataset[record].role})")


@journal()
def _overlay(dataset: Dataset, replays: Mapping[str, Replay], title: str) -> Figure:
    record = next(iter(replays.values())).record
    # the inputs that are worth a panel: those that change, settings of the loop last
    moving = [name for name, values in record.inputs.items() if np.ptp(values) > 0]
    moving.sort(key=lambda name: stem(name) in ("gain", "enable", "supply"))
    inputs = moving[:MAX_INPUTS]
    signals = [
        channel for channel in dataset.outputs if all(channel.name in r.outputs for r in replays.values())
    ]
    heights = [2.4, 1.0] * len(signals) + [0.9] * len(inputs)
    figure = new_figure(0.65 * sum(heights) + 0.5)
    panels = np.ravel(figure.subplots(len(heights), 1, sharex=True, height_ratios=heights))
    for k, channel in enumerate(signals):
        _signal(panels[2 * k], panels[2 * k + 1], record.time, channel, replays)
    rows = math.ceil((1 + len(replays)) / LEGEND_COLUMNS)  # one beside the title; more push it up
    panels[0].set_title(title, loc="left", pad=None if rows == 1 else 4 + 11 * rows)
    units = {channel.name: channel.unit for channel in dataset.inputs}
    for axes, name in zip(panels[2 * len(signals) :], inputs, strict=True):
        axes.step(
            record.time, record.inputs[name], where="post", color="black", lw=0.7, label=f"_{symbol(name)}"
        )
        axes.set_ylabel(f"{symbol(name)}\n{scaled_unit(units[name], 0)}".rstrip())
        pad(axes)
    panels[-1].set_xlabel("time [s]")
    panels[-1].set_xlim(record.time[0], record.time[-1])
    figure.align_ylabels(panels)
    return figure


def _signal(
    main: Axes, below: Axes, time: np.ndarray, channel: Channel, replays: Mapping[str, Replay]
) -> None:
    unit, factor = channel.shown
    measured = factor * next(iter(replays.values())).record.signal(channel.name)
    main.plot(time, measured, color=GREY, lw=2.4, alpha=0.75, label="measured", solid_capstyle="round")
    below.axhline(0.0, color="black", lw=0.5)
    for k, (long_name, replay) in enumerate(replays.items()):
        name = shortened(long_name, MAX_LABEL)
        colour, dash = COLOURS[k % len(COLOURS)], DASHES[k % len(DASHES)]
        if replay.status != "ok":
            main.plot([], [], color=colour, ls=dash, label=f"{name}: diverged")
            continue
        fit = replay.fit[channel.name]
        simulated = factor * replay.outputs[channel.name]
        main.plot(
            time,
            simulated,
            color=colour,
            ls=dash,
            lw=1.0,
            label=name if math.isnan(fit) else f"{name}, fit {fit:.2f} %",
        )
        below.plot(time, measured - simulated, color=colour, lw=0.6, alpha=0.9)
    joint = f"{shortened(channel.joint, MAX_TITLE)}\n" if channel.joint else ""
    main.set_ylabel(joint + label(channel.name, unit))
    pad(main)
    main.legend(loc="lower right", bbox_to_anchor=(1.0, 0.99), ncols=LEGEND_COLUMNS, borderaxespad=0.0)
    below.set_ylabel("residual\n" + label(channel.name, unit).split(" ")[-1])
    pad(below)
