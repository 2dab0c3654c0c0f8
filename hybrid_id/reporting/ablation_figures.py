"""Pictures of an ablation: every repeat of every arm, and what the price buys."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from hybrid_id.reporting.html.interactive import Drawn, drawn
from hybrid_id.reporting.style import COLOURS, GREY, journal, new_figure
from hybrid_id.study.ablation_result import Ablation, Scores

_TITLES = {"test": "test", "beyond": "out of range", "short": "short horizon"}


def ablation_pictures(result: Ablation) -> dict[str, Drawn]:
    """Figures by the name of their file; those that would be empty are left out."""
    figures = {}
    if any(np.isfinite(result.physics.errors[name]).any() for name in _TITLES):
        figures["errors"] = errors_figure(result)
    if any(math.isfinite(s.change[name].mean) for s in result.scores[1:] for name in ("test", "beyond")):
        figures["change"] = change_figure(result)
    if result.ladder:
        figures["prices"] = prices_figure(result)
    return {name: drawn(figure) for name, figure in figures.items()}


def errors_figure(result: Ablation) -> Figure:
    """Error of each repeat of each arm, repeats on one line; 1 is the noise floor."""
    shown = [name for name in _TITLES if np.isfinite(result.physics.errors[name]).any()]
    with journal():
        figure = new_figure(0.33 * len(result.scores) + 0.9)
        panels = np.atleast_1d(figure.subplots(1, len(shown), sharey=True))
        for axes, name in zip(panels, shown, strict=True):
            for row, scores in enumerate(result.scores):
                errors = scores.errors[name][np.isfinite(scores.errors[name])]
                axes.plot(errors, np.full(len(errors), row), "o", ms=3.5, color=_colour(scores), alpha=0.6)
                if errors.size:
                    axes.plot(np.exp(np.log(errors).mean()), row, "|", ms=11, mew=1.6, color="black")
            axes.axvline(1.0, color=GREY, lw=0.8, ls="--")
            axes.set(xscale="log", title=_TITLES[name])
            _logarithmic(axes.xaxis)
        _rows(panels[0], result)
        figure.supxlabel("free-run error (1: as the noise says)", fontsize=8)
    return figure


def change_figure(result: Ablation) -> Figure:
    """Paired change of the test error against physics only, with its interval."""
    others = result.scores[1:]
    shown = [n for n in ("test", "beyond") if any(math.isfinite(s.change[n].mean) for s in others)]
    with journal():
        figure = new_figure(0.33 * len(others) + 0.9)
        panels = np.atleast_1d(figure.subplots(1, len(shown), sharey=True))
        for axes, name in zip(panels, shown, strict=True):
            axes.axvline(1.0, color="black", lw=0.6)
            for row, scores in enumerate(others, start=1):
                change = scores.change[name]
                if not math.isfinite(change.mean):
                    continue
                centre, known = math.exp(change.mean), math.isfinite(change.upper)
                if known:
                    ends = [math.exp(min(max(end, -12.0), 12.0)) for end in (change.lower, change.upper)]
                    axes.plot(ends, [row, row], color=_colour(scores), lw=1.4)
                axes.plot(centre, row, "o", ms=4.5, color=_colour(scores), mfc=None if known else "white")
            axes.set(xscale="log", title=_TITLES[name])
            _logarithmic(axes.xaxis)
        _rows(panels[0], result, 1)
        figure.supxlabel("error over that of physics only", fontsize=8)
    return figure


def prices_figure(result: Ablation) -> Figure:
    """Test error and drift of the parameters over the price of the network's output."""
    arms = list(dict.fromkeys(s.arm for s in result.ladder))
    prices = sorted({s.price for s in result.ladder if s.price is not None}, reverse=True)
    with journal():
        figure = new_figure(2.2 + 0.16 * len(arms))
        left, right = figure.subplots(1, 2)
        for k, arm in enumerate(arms):
            rungs = [s for s in result.ladder if s.arm == arm and s.price is not None]
            at = [prices.index(s.price) for s in rungs if s.price is not None]
            error = [_centre(s.errors["test"]) for s in rungs]
            style = {
                "color": COLOURS[k % len(COLOURS)],
                "marker": "o",
                "ms": 3.5,
                "label": arm.label.replace("\n", ", "),
            }
            left.plot(at, error, **style)
            right.plot(at, [s.drift for s in rungs], **style)
        left.axhline(
            _centre(result.physics.errors["test"]), color=GREY, ls="--", lw=0.8, label="physics only"
        )
        left.set(yscale="log", ylabel="test error (1: the noise)")
        _logarithmic(left.yaxis)
        right.set(ylabel="largest drift [standard errors]")
        for axes in (left, right):
            axes.set_xticks(range(len(prices)), [f"{price:g}" for price in prices])
            axes.set_xlabel("price of the network's output")
        figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=1)
    return figure


def _logarithmic(axis: Axis) -> None:
    """Few plain numbers on a logarithmic axis."""
    low, high = axis.get_view_interval()
    axis.set_major_locator(LogLocator(subs=(1.0,) if high > 30.0 * low else (1.0, 2.0, 5.0), numticks=12))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())


def _rows(axes: Axes, result: Ablation, first: int = 0) -> None:
    names = [scores.arm.label for scores in result.scores[first:]]
    axes.set_yticks(range(first, first + len(names)), names)
    axes.set_ylim(first + len(names) - 0.5, first - 0.5)


def _colour(scores: Scores) -> str:
    return COLOURS[0] if scores.arm.hybrid else COLOURS[1] if scores.arm.width else GREY


def _centre(errors: np.ndarray) -> float:
    finite = errors[np.isfinite(errors)]
    return float(np.exp(np.log(finite).mean())) if finite.size else math.nan
