"""Picture of profile likelihoods."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

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
from hybrid_id.statistics.profile import Profile
from hybrid_id.study import Study

COLUMNS, TOP = 3, 2.5
"""Panels beside each other, and how far up they show, in heights of the threshold."""


def profile_figure(study: Study, reach: float = 1.96) -> Figure:
    """Rise of the cost over each profiled parameter by its threshold, and the parabola of ``reach`` standard errors."""
    count = len(study.profiles)
    columns = min(COLUMNS, count)
    rows = math.ceil(count / columns)
    with journal():
        figure = new_figure(1.9 * rows + 0.3, WIDTH * columns / COLUMNS if columns > 1 else 3.5)
        grid = figure.subplots(rows, columns, squeeze=False, sharey=True)
        for axes, (name, profile) in zip(grid.flat, study.profiles.items(), strict=False):
            _panel(axes, study, name, profile, reach)
        for axes in list(grid.flat)[count:]:
            axes.set_axis_off()
        for axes in grid[:, 0]:
            axes.set_ylabel("rise of the cost\n/ threshold")
        return figure


def _panel(axes: Axes, study: Study, name: str, profile: Profile, reach: float) -> None:
    k, index = study.names.index(name), study.selection.index
    estimate = study.selected.values[k]
    minimum = profile.costs[np.argmin(np.abs(profile.values - estimate))]
    exponent = power_of_ten(np.array([estimate, *profile.values]))
    factor = 10.0**-exponent
    rise = (profile.costs - minimum) / (profile.threshold - minimum)
    ends = [e for e, closed in zip((profile.lower, profile.upper), profile.closed, strict=True) if closed]
    axes.plot(factor * profile.values, rise, "o-", ms=3, color=COLOURS[0])
    axes.plot(factor * estimate, 0.0, "o", ms=4.5, color=COLOURS[1])
    error = study.standard_errors(index)[k]
    if np.isfinite(error):
        value = np.linspace(profile.values.min(), profile.values.max(), 100)
        axes.plot(factor * value, ((value - estimate) / (reach * error)) ** 2, color=GREY, lw=0.8)
    axes.axhline(1.0, color="black", lw=0.8, ls="--")
    for end in ends:
        axes.axvline(factor * end, color=COLOURS[0], lw=0.8, ls=":")
    axes.set(ylim=(-0.1, TOP), xlabel=f"{symbol(name)} {scaled_unit(study.selected.units[k], exponent)}")
