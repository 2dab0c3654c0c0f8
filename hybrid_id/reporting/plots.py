"""Pictures of a study: parameter sets over the experiments, cross-validation, residuals, and the truth where known."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from hybrid_id.reporting.style import (
    COLOURS,
    GREY,
    WIDTH,
    journal,
    new_figure,
    power_of_ten,
    scaled_unit,
    symbol,
)
from hybrid_id.statistics.residuals import Whiteness
from hybrid_id.study import Study

MAX_TICKS, MAX_NAME = 7, 14
"""Records that are named under one panel, and characters of such a name."""
MAX_NUMBERED = 14
"""Largest matrix whose cells are given as numbers too."""


def parameter_figure(study: Study, reach: float = 1.96) -> Figure:
    """Every parameter over the experiments, with intervals of ``reach`` standard errors, mean and std/mean."""
    count = len(study.names)
    columns = 3 if count in (3, 5, 6, 9) else min(4, count)
    rows = math.ceil(count / columns)
    errors = np.array([study.standard_errors(i) for i in range(len(study.sets))])
    longest = max(len(_short(name)) for name in study.cross_validation.set_names)
    with journal():
        figure = new_figure(1.45 * rows + 0.5 + 0.045 * longest, WIDTH * columns / 4 if columns > 1 else 3.5)
        grid = figure.subplots(rows, columns, squeeze=False, sharex=True)
        for k, axes in enumerate(grid.flat):
            if k >= count:
                axes.set_axis_off()
                continue
            _parameter(axes, study, k, reach * errors[:, k])
        for k in range(max(0, count - columns), count):
            grid.flat[k].tick_params(labelbottom=True)
            grid.flat[k].set_xlabel("set" if study.pooled else "record")
        if not np.isfinite(errors).all():
            grid.flat[0].plot(
                [], [], "o", ms=3.5, mfc="white", mec=COLOURS[0], label="no interval may be claimed"
            )
        handles, labels = grid.flat[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper right", ncols=len(labels))
        return figure


def _parameter(axes: Axes, study: Study, k: int, reach: np.ndarray) -> None:
    x = np.arange(len(study.sets))
    exponent = power_of_ten(study.values[:, k])
    values, reach = study.values[:, k] / 10.0**exponent, reach / 10.0**exponent
    spec = study.system.parameter(study.names[k]).spec
    selected = study.selection.index
    if spec.prior_std is not None and spec.prior_mean is not None:
        low, high = ((spec.prior_mean + side * spec.prior_std) / 10.0**exponent for side in (-1, 1))
        axes.axhspan(low, high, color=COLOURS[5], alpha=0.18, lw=0, label="prior ± 1 std")
    axes.plot(
        [], [], "o", ms=3.5, color=COLOURS[0], label="one set a record" if not study.pooled else "pooled set"
    )
    axes.plot([], [], "o", ms=4.5, color=COLOURS[1], label="selected")
    for i in x:
        colour, size = (COLOURS[1], 4.5) if i == selected else (COLOURS[0], 3.5)
        known = bool(np.isfinite(reach[i]))
        bar = reach[i] if known else None
        axes.errorbar(
            x[i], values[i], yerr=bar, fmt="o", ms=size, mfc=colour if known else "white", mec=colour, ecolor=colour,
            elinewidth=0.9, capsize=1.8, capthick=0.9,
        )  # fmt: skip
    title = symbol(study.names[k])
    if study.variation is not None:
        axes.axhline(
            study.variation.mean[k] / 10.0**exponent,
            color=GREY,
            lw=0.8,
            ls=(0, (4, 2)),
            zorder=0,
            label="mean",
        )
        percent = study.variation.percent[k]
        title += f",  std/mean {'< 0.01' if percent < 0.01 else f'{percent:.3g}'} %"
    axes.set_title(title, loc="left")
    axes.set_ylabel(scaled_unit(study.selected.units[k], exponent))
    axes.set_xlim(-0.6, len(x) - 0.4)
    shown = x[:: math.ceil(len(x) / MAX_TICKS)]
    names = ["all" if study.pooled else _short(study.cross_validation.set_names[i]) for i in shown]
    axes.set_xticks(shown, names, rotation=45, ha="right", rotation_mode="anchor")


def cross_validation_figure(study: Study) -> Figure:
    """Fit of every set on every record; own records framed, the selected set marked."""
    matrix, cross = study.cross_validation.matrix(), study.cross_validation
    n_sets, n_records = matrix.shape
    shown = np.where(np.isfinite(matrix), np.maximum(matrix, 0.0), np.nan)
    cell = min(0.5, (WIDTH - 2.2) / n_records)
    with journal():
        figure = new_figure(max(0.42 * n_sets, cell * n_sets) + 1.25, min(WIDTH, cell * n_records + 3.6))
        axes = figure.subplots()
        low = math.floor(min(np.nanmin(shown), 99.0)) if np.isfinite(shown).any() else 0
        image = axes.imshow(shown, cmap="cividis", vmin=low, vmax=100, aspect="auto")
        if n_records <= MAX_NUMBERED:
            for i, j in np.ndindex(matrix.shape):
                text = _percent(float(matrix[i, j])) if np.isfinite(matrix[i, j]) else "div."
                dark = np.isfinite(shown[i, j]) and shown[i, j] < 0.5 * (low + 100)
                axes.text(
                    j, i, text, ha="center", va="center", color="white" if dark else "black", fontsize=7
                )
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


def residual_figure(study: Study, white: Whiteness, sample_time: float) -> Figure:
    """Autocorrelation and distribution of the selected set's weighted residuals."""
    outputs = study.cross_validation.signal_names[: white.correlation.shape[1]]
    residual = np.concatenate(study.selected.residual)
    with journal():
        figure = new_figure(2.4)
        left, right = figure.subplots(1, 2, width_ratios=(2, 1))
        lags = 1e3 * sample_time * white.lags
        left.axhspan(
            -white.band,
            white.band,
            color=GREY,
            alpha=0.35,
            lw=0,
            label=f"{100 * white.level:.0f} % band of white noise",
        )
        left.axhline(0.0, color="black", lw=0.5)
        bins, sizes = np.linspace(-4, 4, 42), np.sqrt(np.mean(residual**2, axis=0))
        for k, name in enumerate(outputs):
            left.plot(lags, white.correlation[:, k], color=COLOURS[k % len(COLOURS)], label=symbol(name))
            shown = np.clip(residual[:, k] / max(sizes[k], 1e-300), -4, 4)
            words, colour = f"{symbol(name)}, RMS {sizes[k]:.2g}", COLOURS[k % len(COLOURS)]
            right.hist(shown, bins, density=True, alpha=0.6, color=colour, label=words)
        grid = np.linspace(-4, 4, 301)
        right.plot(
            grid, np.exp(-0.5 * grid**2) / math.sqrt(2 * math.pi), color="black", lw=0.9, label="normal"
        )
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


def truth_figure(study: Study, truth: Mapping[str, float], reach: float = 1.96) -> Figure:
    """Selected set against known values: relative error of each parameter with its interval."""
    errors = reach * study.standard_errors(study.selection.index)
    names = [name for name in study.names if name in truth]
    share = {name: 100 / abs(truth[name]) * errors[study.names.index(name)] for name in names}
    halves = [half for half in share.values() if np.isfinite(half)]
    far = 4.0 * float(np.median(halves)) if halves else np.inf  # one wide interval must not hide all others
    with journal():
        figure = new_figure(0.21 * len(names) + 0.8, 4.5)
        axes = figure.subplots()
        axes.axvline(0.0, color="black", lw=0.6)
        reaches: list[float] = []
        for row, name in enumerate(names):
            k = study.names.index(name)
            error, half = 100 / abs(truth[name]) * (study.selected.values[k] - truth[name]), share[name]
            known = bool(np.isfinite(half))
            reaches.append(abs(error) + (half if half < far else 0.0))
            if far <= half < np.inf:
                axes.annotate(f"± {half:.0f} %", (1.0, row), (3, 0), xycoords=("axes fraction", "data"),
                              textcoords="offset points", va="center", fontsize=7, annotation_clip=False)  # fmt: skip
            axes.errorbar(
                error, row, xerr=half if known else None, fmt="o", ms=4, mfc=COLOURS[1] if known else "white",
                mec=COLOURS[1], ecolor=COLOURS[0], elinewidth=1.2, capsize=2,
            )  # fmt: skip
        axes.set_yticks(range(len(names)), [symbol(name) for name in names])
        limit = 1.15 * max(reaches, default=1.0)
        axes.set_xlim(-limit, limit)
        for row, name in enumerate(names):  # an arrow where an interval leaves the panel
            error = 100 / abs(truth[name]) * (study.selected.values[study.names.index(name)] - truth[name])
            for side, arrow in ((-1, "<"), (1, ">")):
                if limit < side * error + share[name] < np.inf:
                    axes.plot(0.985 * side * limit, row, arrow, ms=5, color=COLOURS[0])
        axes.invert_yaxis()
        axes.set_xlabel("estimate − truth [% of the truth], with its interval")
        return figure


def _short(name: str) -> str:
    """A record's name as it fits under a tick; names often differ at their end."""
    return name if len(name) <= MAX_NAME else f"…{name[1 - MAX_NAME :]}"


def _percent(value: float) -> str:
    """A fit as it fits into a cell; how bad a bad one is does not matter."""
    return (
        f"{value:.1f}"
        if 0 <= value < 1000
        else f"{value:.0f}"
        if -100 < value < 0
        else "<−99"
        if value < 0
        else ">999"
    )
