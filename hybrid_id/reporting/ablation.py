"""An ablation as plain data, tables, pictures and one page."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.table import Table
from rich.text import Text

from hybrid_id.records.dataset import Dataset
from hybrid_id.reporting.page import Page, records_section
from hybrid_id.reporting.style import COLOURS, GREY, journal, pixels, plain_logarithm, rows_of_panels
from hybrid_id.reporting.tables import count, table
from hybrid_id.study.ablation import Arm
from hybrid_id.study.ablation_result import SETS, Ablation, Scores, answer, signed, verdict

PICTURES = ("errors", "change")
"""Names of the pictures that an ablation may have."""
_TITLES = {"test": "test", "beyond": "out of range", "short": "short horizon"}
_HOW = (
    "Errors are the RMS of the free run over whole records, in units of the measurement's standard deviation (1: as "
    "the noise says), geometric means over the repeats; short: the same over a fraction of a second from measured "
    "states. Each repeat draws its own records (but for those of role test) and first weights, the same for all arms, "
    "and is compared in pairs with physics only. Intervals are Student's, widened for training sets that share records "
    "(Nadeau and Bengio, 2003). The network that the validation records like best is scored on test records that chose "
    "nothing; the intervals of the other arms are not corrected for their number."
)


def ablation_result(result: Ablation) -> dict[str, Any]:
    """Everything that an ablation says, as plain data."""

    def plain(scores: Scores) -> dict[str, Any]:
        return {
            "arm": scores.arm.name,
            "seeds": scores.seeds,
            "weighted_error": {name: scores.errors[name] for name in SETS},
            "diverged": {name: scores.diverged(name) for name in SETS},
            "log_ratio_to_physics": {name: vars(scores.change[name]) for name in SETS},
            "share": scores.share,
            "overlap": scores.overlap,
            "drift_sigma": scores.drift,
        }

    return {
        "answer": answer(result),
        "verdict": verdict(result),
        "level": result.level,
        "arms": [plain(scores) for scores in result.scores],
        "parameters": {
            arm.name: {
                name: {"mean": v.mean[k], "std": v.std[k], "percent": v.percent[k]}
                for k, name in enumerate(v.names)
            }
            for arm, v in result.parameters.items()
        },
        "splits": {str(seed): vars(split) for seed, split in result.splits.items()},
        "failed": result.failed,
    }


def failures(result: Ablation) -> list[Text]:
    """One line a cell that came to nothing."""
    return [Text(f"{name}: {reason}", style="red") for name, reason in result.failed.items()]


def arms_table(result: Ablation) -> Table:
    """One row an arm: errors, their paired change against physics only, and what a network does beside physics."""
    heads = (
        "arm", "validation>", "test>", "change of\ntest [%]>", "short\nhorizon>", "out of\nrange>",
        "change out of\nrange [%]>", "share of\ntorque>", "overlap>", "largest\ndrift [σ]>", "n>",
    )  # fmt: skip
    rows = [
        (
            scores.arm.label, _error(scores, "validation"), _error(scores, "test"), _change(scores, "test"),
            _error(scores, "short"), _error(scores, "beyond"), _change(scores, "beyond"),
            *(("", "", "") if not scores.arm.hybrid else
              (f"{100 * scores.share:.1f} %", f"{scores.overlap:.2f}", f"{scores.drift:.1f}")),
            str(len(scores.seeds)),
        )
        for scores in result.scores
    ]  # fmt: skip
    return table(heads, rows)


def parameters_table(result: Ablation) -> Table:
    """Mean and std/mean of the physical parameters over the repeats, physics only beside the best hybrid."""
    sets = result.parameters.values()
    heads = ("parameter", *(f"{words}>" for arm in result.parameters for words in (arm.label, "std/mean")))
    rows = []
    for k, name in enumerate(next(iter(sets)).names):
        row = [name]
        for v in sets:  # one repeat has no spread
            row += [f"{v.mean[k]:.5g}", f"{v.percent[k]:.2f} %" if math.isfinite(v.percent[k]) else ""]
        rows.append(row)
    return table(heads, rows)


def _error(scores: Scores, records: str) -> str:
    """Geometric mean of the errors over the repeats; how many diverged."""
    error, diverged = scores.error(records), scores.diverged(records)
    words = f"{error:.3g}" if math.isfinite(error) else ""
    return f"{words} ({diverged} diverged)".strip() if diverged else words


def _change(scores: Scores, records: str) -> str:
    mid, low, high = scores.percent(records)
    if scores.arm == Arm() or not math.isfinite(mid):
        return ""
    interval = f" ({signed(low)} … {signed(high)})" if math.isfinite(high) else ""
    return signed(mid) + interval.replace(" ", "\N{NO-BREAK SPACE}")


def ablation_pictures(result: Ablation) -> dict[str, np.ndarray]:
    """Figures by the name of their file; those that would be empty are left out."""
    figures = {}
    if shown := [name for name in _TITLES if np.isfinite(result.physics.errors[name]).any()]:
        figures["errors"] = errors_figure(result, shown)
    others = result.scores[1:]
    if shown := [n for n in ("test", "beyond") if any(math.isfinite(s.change[n].mean) for s in others)]:
        figures["change"] = change_figure(result, shown)
    return {name: pixels(figure) for name, figure in figures.items()}


def _rows(scores: Sequence[Scores], shown: Sequence[str], words: str) -> tuple[Figure, Sequence[Axes]]:
    """A panel for each set of records, logarithmic, and in it a row for each arm."""
    figure, panels = rows_of_panels([of_arm.arm.label for of_arm in scores], len(shown), height=0.33)
    for axes, name in zip(panels, shown, strict=True):
        axes.axvline(1.0, color=GREY, lw=0.8, ls="--")
        axes.set(xscale="log", title=_TITLES[name])
    figure.supxlabel(words, fontsize=8)
    return figure, panels


def _colour(scores: Scores) -> str:
    return COLOURS[0] if scores.arm.hybrid else COLOURS[1] if scores.arm.width else GREY


@journal()
def errors_figure(result: Ablation, shown: Sequence[str]) -> Figure:
    """Error of each repeat of each arm, repeats on one line; 1 is the noise floor."""
    figure, panels = _rows(result.scores, shown, "free-run error (1: as the noise says)")
    for axes, name in zip(panels, shown, strict=True):
        for row, scores in enumerate(result.scores):
            errors = scores.errors[name][np.isfinite(scores.errors[name])]
            axes.plot(errors, np.full(len(errors), row), "o", ms=3.5, color=_colour(scores), alpha=0.6)
            if errors.size:
                axes.plot(scores.error(name), row, "|", ms=11, mew=1.6, color="black")
        plain_logarithm(axes.xaxis)
    return figure


@journal()
def change_figure(result: Ablation, shown: Sequence[str]) -> Figure:
    """Paired change of the test error against physics only, with its interval."""
    figure, panels = _rows(result.scores[1:], shown, "error over that of physics only")
    for axes, name in zip(panels, shown, strict=True):
        for row, scores in enumerate(result.scores[1:]):
            change = scores.change[name]
            known = math.isfinite(change.upper)
            if known:
                ends = np.exp(np.clip([change.lower, change.upper], -12.0, 12.0))
                axes.plot(ends, [row, row], color=_colour(scores), lw=1.4)
            if math.isfinite(change.mean):
                centre, face = math.exp(change.mean), None if known else "white"
                axes.plot(centre, row, "o", ms=4.5, color=_colour(scores), mfc=face)
        plain_logarithm(axes.xaxis)
    return figure


def ablation_page(dataset: Dataset, result: Ablation, pictures: Mapping[str, np.ndarray]) -> Page:
    """The page of an ablation."""
    (lead, *others), repeats = verdict(result), len(result.splits)
    page = Page(f"Physics only or hybrid? {dataset.name}", lead)
    what = (
        f"{len(result.scores)} models, trained and tested on the same records in {count(repeats, 'repeat')}."
    )
    section = page.section("Answer").add(*others).note(what).add(*failures(result))
    if repeats > 1 and len({split.test for split in result.splits.values()}) == 1:
        section.note(
            "All repeats test on the same records, which have the role of test records: how the answer would change "
            "with others is not in the intervals."
        )
    if "change" in pictures:
        words = "Error over that of physics only on the same records: mean and interval of each arm."
        section.figure(pictures["change"], words)
    section = page.section("Arms").add(arms_table(result)).note(_HOW)
    if "errors" in pictures:
        words = "Every repeat of every arm; the bar is the mean, the dashed line the noise."
        section.figure(pictures["errors"], words)
    page.section("Parameters over the repeats").add(parameters_table(result))
    splits = [
        (str(seed), *(", ".join(names) for names in (s.train, s.validation, s.test, s.beyond)))
        for seed, s in result.splits.items()
    ]
    heads = ("seed>", "train", "validation", "test", "out of range")
    records_section(page, dataset).note(table(heads, splits))
    return page
