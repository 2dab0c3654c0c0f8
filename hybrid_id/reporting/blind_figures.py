"""Pictures of a blind check: what was said for what was at work, and what the probabilities are worth."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from hybrid_id.reporting.html.interactive import Drawn, drawn
from hybrid_id.reporting.style import COLOURS, GREY, journal, new_figure


def confusion_figure(confusion: Mapping[str, Any]) -> Drawn:
    """Rows: what was at work; columns: what was said."""
    counts = np.array(confusion["counts"], float).reshape(len(confusion["rows"]), len(confusion["columns"]))
    share = counts / np.maximum(counts.sum(1, keepdims=True), 1)
    rows, columns = ([name.replace("_", " ") for name in confusion[k]] for k in ("rows", "columns"))
    with journal():
        figure = new_figure(1.6 + 0.19 * max(len(rows), 4), 2.0 + 0.21 * max(len(columns), 10))
        axes = figure.subplots()
        edges = (np.arange(n + 1) - 0.5 for n in share.shape[::-1])
        axes.pcolormesh(*edges, share, cmap="Blues", vmin=0, vmax=1)
        axes.invert_yaxis()
        for i, j in zip(*np.nonzero(counts), strict=True):
            colour = "white" if share[i, j] > 0.6 else "black"
            axes.text(j, i, f"{counts[i, j]:.0f}", ha="center", va="center", color=colour, fontsize=7)
        axes.set_xticks(range(len(columns)), columns, rotation=90)
        axes.set_yticks(range(len(rows)), rows)
        axes.set_xlabel("said")
        axes.set_ylabel("at work")
        return drawn(figure)


def reliability_figure(told: Mapping[str, Mapping[str, Any]]) -> Drawn:
    """Reliability curve of each contender with Wilson's intervals.

    Args:
        told: by contender, see `hybrid_id.blind.score.reliability`.
    """
    with journal():
        figure = new_figure(2.8, 3.4)
        axes = figure.subplots()
        axes.plot([0, 1], [0, 1], color=GREY, linewidth=0.8)
        for (name, curve), colour in zip(told.items(), COLOURS, strict=False):
            if not curve["bins"]:
                continue
            x, y, low, high = (
                np.array([b[k] for b in curve["bins"]]) for k in ("claimed", "value", "low", "high")
            )
            reach = np.maximum([y - low, high - y], 0)
            axes.errorbar(x, y, reach, color=colour, marker="o", markersize=3, elinewidth=0.6, label=name)
        axes.set_xlabel("claimed probability of a named effect")
        axes.set_ylabel("share of cases in which it was at work")
        axes.set(xlim=(-0.03, 1.03), ylim=(-0.03, 1.03))
        if axes.get_legend_handles_labels()[0]:
            axes.legend()
        return drawn(figure)
