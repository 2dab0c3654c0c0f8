"""An ablation as plain data, tables, pictures and one page."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from hybrid_id.records.dataset import Dataset
from hybrid_id.reporting.page import Page
from hybrid_id.reporting.style import COLOURS, GREY, journal, new_figure, pixels, plain_logarithm
from hybrid_id.reporting.tables import count, records_table, table
from hybrid_id.study.ablation_result import HYBRID, OPEN, SETS, Ablation, Scores, answer, signed, verdict

_STYLE = {HYBRID: "green", OPEN: "yellow"}


def ablation_result(result: Ablation) -> dict[str, Any]:
    """Everything that an ablation says, as plain data."""
    return {
        "answer": answer(result),
        "verdict": verdict(result),
        "level": result.level,
        "arms": [_scores(scores) for scores in result.scores],
        "ladder": [_scores(scores) for scores in result.ladder],
        "parameters": {
            arm.name: {
                name: {"mean": v.mean[k], "std": v.std[k], "percent": v.percent[k]}
                for k, name in enumerate(v.names)
            }
            for arm, v in result.parameters.items()
        },
        "splits": {str(seed): vars(split) for seed, split in result.splits.items()},
        "failed": {r.cell.name: r.message for r in result.failed},
    }


def _scores(scores: Scores) -> dict[str, Any]:
    return {
        "arm": scores.arm.name,
        "price": "chosen" if scores.price is None else scores.price,
        "seeds": scores.seeds,
        "weighted_error": {name: scores.errors[name] for name in SETS},
        "diverged": {name: scores.diverged(name) for name in SETS},
        "log_ratio_to_physics": {name: vars(scores.change[name]) for name in SETS},
        "share": scores.share,
        "overlap": scores.overlap,
        "drift_sigma": scores.drift,
    }


def ablation_tables(result: Ablation) -> RenderableType:
    """The answer, the arms, what the price does, the parameters, and the cells that broke."""
    parts: list[RenderableType] = [verdict_text(result), arms_table(result)]
    parts += [ladder_table(result)] if result.ladder else []
    parts += [parameters_table(result)]
    return Group(*parts, *failures(result))


def verdict_text(result: Ablation) -> Group:
    """The answer in words, and one paragraph for each thing that goes with it."""
    first, *others = verdict(result)
    return Group(Text(first, style=_STYLE.get(answer(result), "")), *map(Text, others))


def arms_table(result: Ablation) -> Table:
    """One row an arm: errors, and their paired change against physics only."""
    heads = (
        "arm", "validation>", "test>", "change of\ntest [%]>", "short\nhorizon>", "out of\nrange>",
        "change out of\nrange [%]>", "n>",
    )  # fmt: skip
    rows = [
        (
            scores.arm.label, _error(scores, "validation"), _error(scores, "test"), _change(result, scores, "test"),
            _error(scores, "short"), _error(scores, "beyond"), _change(result, scores, "beyond"),
            str(len(scores.seeds)),
        )
        for scores in result.scores
    ]  # fmt: skip
    return table(heads, rows)


def ladder_table(result: Ablation) -> Table:
    """What the price of the network's output buys: error, share, overlap and drift of the parameters."""
    heads = (
        "arm", "price>", "validation>", "test>", "change of\ntest [%]>", "out of\nrange>", "share of\ntorque>",
        "overlap>", "largest\ndrift [σ]>",
    )  # fmt: skip
    rows = [
        (
            scores.arm.label, f"{scores.price:g}", _error(scores, "validation"), _error(scores, "test"),
            _change(result, scores, "test"), _error(scores, "beyond"), f"{100 * scores.share:.1f} %",
            f"{scores.overlap:.2f}", f"{scores.drift:.1f}",
        )
        for scores in result.ladder
    ]  # fmt: skip
    return table(heads, rows)


def parameters_table(result: Ablation) -> Table:
    """Mean and std/mean of the physical parameters over the repeats, physics only beside the best hybrid."""
    arms = list(result.parameters.items())
    heads = ("parameter", *(f"{words}>" for arm, _ in arms for words in (arm.label, "std/mean")))
    rows = [
        (name, *(text for _, v in arms for text in (f"{v.mean[k]:.5g}", _spread(v.percent[k]))))
        for k, name in enumerate(arms[0][1].names if arms else ())
    ]
    return table(heads, rows)


def splits_table(result: Ablation) -> Table:
    """Which records each repeat trained, validated and tested on."""
    rows = [
        (
            str(seed),
            *(", ".join(names) for names in (split.train, split.validation, split.test, split.beyond)),
        )
        for seed, split in result.splits.items()
    ]
    return table(("seed>", "train", "validation", "test", "out of range"), rows)


def failures(result: Ablation) -> list[Text]:
    """One line a cell that came to nothing."""
    return [Text(f"{r.cell.name}: {r.message}", style="red") for r in result.failed]


def _error(scores: Scores, records: str) -> str:
    """Geometric mean of the errors over the repeats; how many diverged."""
    error, diverged = scores.error(records), scores.diverged(records)
    words = f"{error:.3g}" if math.isfinite(error) else ""
    return f"{words} ({diverged} diverged)".strip() if diverged else words


def _spread(percent: float) -> str:
    """std/mean; nothing where one repeat has none."""
    return f"{percent:.2f} %" if math.isfinite(percent) else ""


def _change(result: Ablation, scores: Scores, records: str) -> str:
    mid, low, high = scores.percent(records)
    if scores is result.physics or not math.isfinite(mid):
        return ""
    interval = f"\N{NO-BREAK SPACE}({signed(low)} … {signed(high)})" if math.isfinite(high) else ""
    return signed(mid) + interval.replace(" ", "\N{NO-BREAK SPACE}")


PICTURES = ("errors", "change", "prices")
"""Names of the pictures that an ablation may have."""
_HOW = (
    "Errors are the RMS of the free run over whole records, in units of the measurement's standard deviation (1: as "
    "the noise says), geometric means over the repeats; short: the same over a fraction of a second from measured "
    "states. Each repeat draws its own records (but for those of role test) and first weights, the same for all arms, "
    "and is compared in pairs with physics only. Intervals are Student's, widened for training sets that share records "
    "(Nadeau and Bengio, 2003). The network that the validation records like best is scored on test records that chose "
    "nothing; the intervals of the other arms are not corrected for their number."
)
_TITLES = {"test": "test", "beyond": "out of range", "short": "short horizon"}


def ablation_pictures(result: Ablation) -> dict[str, np.ndarray]:
    """Figures by the name of their file; those that would be empty are left out."""
    figures = {}
    if any(np.isfinite(result.physics.errors[name]).any() for name in _TITLES):
        figures["errors"] = errors_figure(result)
    if any(math.isfinite(s.change[name].mean) for s in result.scores[1:] for name in ("test", "beyond")):
        figures["change"] = change_figure(result)
    if result.ladder:
        figures["prices"] = prices_figure(result)
    return {name: pixels(figure) for name, figure in figures.items()}


@journal()
def errors_figure(result: Ablation) -> Figure:
    """Error of each repeat of each arm, repeats on one line; 1 is the noise floor."""
    shown = [name for name in _TITLES if np.isfinite(result.physics.errors[name]).any()]
    figure = new_figure(0.33 * len(result.scores) + 0.9)
    panels = np.atleast_1d(figure.subplots(1, len(shown), sharey=True))
    for axes, name in zip(panels, shown, strict=True):
        for row, scores in enumerate(result.scores):
            errors = scores.errors[name][np.isfinite(scores.errors[name])]
            axes.plot(errors, np.full(len(errors), row), "o", ms=3.5, color=_colour(scores), alpha=0.6)
            if errors.size:
                axes.plot(scores.error(name), row, "|", ms=11, mew=1.6, color="black")
        axes.axvline(1.0, color=GREY, lw=0.8, ls="--")
        axes.set(xscale="log", title=_TITLES[name])
        plain_logarithm(axes.xaxis)
    _rows(panels[0], result)
    figure.supxlabel("free-run error (1: as the noise says)", fontsize=8)
    return figure


@journal()
def change_figure(result: Ablation) -> Figure:
    """Paired change of the test error against physics only, with its interval."""
    others = result.scores[1:]
    shown = [n for n in ("test", "beyond") if any(math.isfinite(s.change[n].mean) for s in others)]
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
        plain_logarithm(axes.xaxis)
    _rows(panels[0], result, 1)
    figure.supxlabel("error over that of physics only", fontsize=8)
    return figure


@journal()
def prices_figure(result: Ablation) -> Figure:
    """Test error and drift of the parameters over the price of the network's output."""
    arms = list(dict.fromkeys(s.arm for s in result.ladder))
    prices = sorted({s.price for s in result.ladder if s.price is not None}, reverse=True)
    figure = new_figure(2.2 + 0.16 * len(arms))
    left, right = figure.subplots(1, 2)
    for k, arm in enumerate(arms):
        rungs = [s for s in result.ladder if s.arm == arm and s.price is not None]
        at = [prices.index(s.price) for s in rungs if s.price is not None]
        error = [s.error("test") for s in rungs]
        style = {
            "color": COLOURS[k % len(COLOURS)],
            "marker": "o",
            "ms": 3.5,
            "label": arm.label.replace("\n", ", "),
        }
        left.plot(at, error, **style)
        right.plot(at, [s.drift for s in rungs], **style)
    left.axhline(result.physics.error("test"), color=GREY, ls="--", lw=0.8, label="physics only")
    left.set(yscale="log", ylabel="test error (1: the noise)")
    plain_logarithm(left.yaxis)
    right.set(ylabel="largest drift [standard errors]")
    for axes in (left, right):
        axes.set_xticks(range(len(prices)), [f"{price:g}" for price in prices])
        axes.set_xlabel("price of the network's output")
    figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=1)
    return figure


def _rows(axes: Axes, result: Ablation, first: int = 0) -> None:
    names = [scores.arm.label for scores in result.scores[first:]]
    axes.set_yticks(range(first, first + len(names)), names)
    axes.set_ylim(first + len(names) - 0.5, first - 0.5)


def _colour(scores: Scores) -> str:
    return COLOURS[0] if scores.arm.hybrid else COLOURS[1] if scores.arm.width else GREY


def ablation_page(dataset: Dataset, result: Ablation, pictures: Mapping[str, np.ndarray]) -> Page:
    """The page.

    Args:
        dataset: the records.
        result: the ablation.
        pictures: its figures by name.
    """
    (lead, *others), repeats = verdict(result), len(result.splits)
    page = Page(f"Physics only or hybrid? {dataset.name}", lead)
    what = (
        f"{len(result.scores)} models, trained and tested on the same records in {count(repeats, 'repeat')}."
    )
    section = page.section("Answer").add(*others, what, *failures(result))
    if repeats > 1 and len({split.test for split in result.splits.values()}) == 1:
        section.add(
            "All repeats test on the same records, which have the role of test records: how the answer would change "
            "with others is not in the intervals."
        )
    if "change" in pictures:
        words = "Error over that of physics only on the same records: mean and interval of each arm."
        section.figure(pictures["change"], words)
    section = page.section("Arms").add(arms_table(result), _HOW)
    if "errors" in pictures:
        words = "Every repeat of every arm; the bar is the mean, the dashed line the noise."
        section.figure(pictures["errors"], words)
    if result.ladder:
        page.section("Price of the network's output").add(
            "A dear network adds only what the physics cannot say; a free one may take the physics' work, and the "
            "parameters drift. Each price starts from the dearer one above it.",
            ladder_table(result),
        ).figure(pictures["prices"], "Test error and drift of the parameters by price.")
    page.section("Parameters over the repeats").add(parameters_table(result))
    page.section("Records").add(splits_table(result), records_table(dataset))
    return page
