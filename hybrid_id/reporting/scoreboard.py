"""The benchmark report of a blind check, as Markdown and as one page with pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from rich.table import Table

from hybrid_id.reporting.page import Page, how_made
from hybrid_id.reporting.provenance import short
from hybrid_id.reporting.style import COLOURS, GREY, journal, new_figure, pixels
from hybrid_id.reporting.tables import markdown_table, table

Scores = Mapping[str, Any]
"""What ``blind score`` keeps in ``scores.json``."""

ROWS = {
    "top_1": "first name right (single effects; a dominant one of a messy machine)",
    "top_3": "among the first three",
    "leads_train": "a dominant effect leads on the train records, too",
    "place": "place of the first right",
    "top_1_at_place": "first name right at the right place",
    "joint": "joint of the first right (arms)",
    "tied": "right name first or among those indistinguishable from it (arms)",
    "f1": "F1 of the set (pairs)",
    "whole": "exactly what was at work named (all cases)",
    "false_alarms": "false alarms (nothing at work)",
    "values": "nothing wrong or the values alone, as it is (nothing at work)",
    "outside_detected": "outside the catalogue: detected",
    "outside_at": "joint (and side) of it right, where stated",
    "false_unknown": "false 'unknown'",
    "shrink_error": "error of the claimed shrink, median [points]",
    "covered": "95 % intervals that hold the true shrink",
    "share_error": "error of the claimed shares, median [points]",
    "share_covered": "95 % intervals that hold the first one's true share",
    "sure": "claims of 0.95 or more that are right",
    "calibration": "expected calibration error",
    "closed": "closable gap that is closed, median",
    "seconds": "time per case, median [s]",
    "slowest": "time per case, most [s]",
    "processor": "processor time per case, median [s]",
    "broken": "broken cases",
}
DOUBTFUL = "met; its interval reaches beyond"
"""What is said of a target that the figure seen meets, and not all of its interval."""
_PLAIN = ("shrink_error", "share_error", "seconds", "slowest", "processor")
"""Scores in points or seconds."""


def value(name: str, score: Mapping[str, Any] | None, *, interval: bool = True) -> str:
    """A score in words: value, interval and number of cases."""
    if score is None:
        return "–"
    percent = name not in ("f1", "calibration", *_PLAIN)
    form = "{:.1f}" if name in _PLAIN else "{:.3f}" if name == "calibration" else "{:.2f}"

    def number(x: float) -> str:
        return f"{100 * x:.0f}" if percent else form.format(x)

    text = number(score["value"]) + (" %" if percent else "")
    if not interval or name in ("seconds", "slowest", "processor"):
        return text
    if score.get("low") is None:  # of few cases
        return f"{text} ({score['n']})"
    return f"{text} ({number(score['low'])} to {number(score['high'])}; {score['n']})"


def score_rows(content: Scores) -> tuple[list[str], list[list[str]]]:
    """Heads and rows of the main table: scores against methods."""
    methods = list(content["methods"])
    rows = []
    for name, words in ROWS.items():
        found = [content["methods"][m]["scores"]["all"].get(name) for m in methods]
        if any(found):
            rows.append([words, *(value(name, one) for one in found)])
    return ["", *methods], rows


def target_rows(targets: Sequence[Mapping[str, Any]]) -> tuple[list[str], list[list[str]]]:
    """Heads and rows of the targets."""
    rows = [
        [
            t["claim"],
            t["target"],
            value(t["score"], t["seen"]),
            "no case"
            if t["met"] is None
            else "**missed**"
            if not t["met"]
            else "met"
            if t["shown"]
            else DOUBTFUL,
            ", ".join(t["cases"][:12]),
        ]
        for t in targets
    ]
    return ["claim", "target", "seen", "", "cases to look at"], rows


def markdown(content: Scores) -> str:
    """The report as a file of its own.

    Args:
        content: what is kept in ``scores.json``.
    """
    about, first = content["about"], next(iter(content["methods"]))
    hashes = ", ".join(one[:16] for one in about["sha256"])
    others = {m: c for m, c in about.get("commits", {}).items() if c != about["commit"]}
    parts = [
        f"# {about['date']}, commit {short(about['commit'])}, seed {about['seed']}",
        f"{about['scored']} of {about['cases']} cases scored"
        + (f", {lost} more could not be made" if (lost := about["asked"] - about["cases"]) else "")
        + f"; made at commit {short(about['made_at'])}, hash of the answers {hashes}. "
        + "".join(f"`{method}` was run at commit {short(at)}. " for method, at in others.items())
        + "Shares with Wilson's 95 % interval and the number of cases behind them.",
        f"    {about['command']}",
        markdown_table(*score_rows(content)),
        f"Targets, for `{first}`:",
        markdown_table(*target_rows(content["methods"][first]["targets"])),
        calibration(content["methods"][first]["scores"]["reliability"]),
    ]
    return "\n\n".join(parts) + "\n"


def calibration(claims: Mapping[str, Any]) -> str:
    """The calibration of the probabilities in a sentence."""
    if claims["expected_error"] is None:
        return "No effect was ranked, so that there is no probability to judge."
    return (
        f"Probabilities of the named effects: expected calibration error {claims['expected_error']:.3f} (ten bins of "
        f"equal count; absent names below 0.02 left out), Brier score {claims['brier']:.3f} over {claims['n']} claims."
    )


@journal()
def confusion_figure(confusion: Mapping[str, Any]) -> np.ndarray:
    """Rows: what was at work; columns: what was said."""
    counts = np.array(confusion["counts"], float).reshape(len(confusion["rows"]), len(confusion["columns"]))
    share = counts / np.maximum(counts.sum(1, keepdims=True), 1)
    rows, columns = ([name.replace("_", " ") for name in confusion[k]] for k in ("rows", "columns"))
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
    return pixels(figure)


@journal()
def reliability_figure(curves: Mapping[str, Mapping[str, Any]]) -> np.ndarray:
    """Reliability curve of each method with Wilson's intervals.

    Args:
        curves: by method, see `hybrid_id.machines.score.reliability`.
    """
    figure = new_figure(2.8, 3.4)
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], color=GREY, linewidth=0.8)
    for (name, curve), colour in zip(curves.items(), COLOURS, strict=False):
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
    return pixels(figure)


_HOW = (
    "Effects were drawn by a generator with physics of its own and withheld; the answers were sealed before the run "
    "and opened to score it. Names and places that are indistinguishable from the true ones on the records count as "
    "right. Shares carry Wilson's 95 % interval and the number of cases behind them; medians the interval of order "
    "statistics."
)

HEADLINES = {
    "top_1": "the right effect first",
    "whole": "exactly what was at work named",
    "false_alarms": "false alarms",
    "outside_detected": "outside the catalogue detected",
    "closed": "closable gap closed (median)",
}
"""Scores that the lead states, in words."""


def blind_page(content: Scores, figures: Mapping[str, np.ndarray]) -> Page:
    """The page.

    Args:
        content: what is kept in ``scores.json``.
        figures: ``confusion`` and ``reliability``.
    """
    about, first = content["about"], next(iter(content["methods"]))
    entry = content["methods"][first]
    asked = [t for t in entry["targets"] if t["met"] is not None]
    missed = [t["claim"] for t in asked if not t["met"]]
    words = f"{first} meets {len(asked) - len(missed)} of {len(asked)} targets"
    words += f"; missed: {'; '.join(missed)}." if missed else "."
    every = entry["scores"]["all"]
    shown = [f"{said} {value(n, every[n], interval=False)}" for n, said in HEADLINES.items() if every.get(n)]
    words += f" Over all cases: {', '.join(shown)}." if shown else ""
    words += f" {about['scored']} of {about['cases']} cases scored, commit {short(about['commit'])}."
    page = Page(f"Blind check, seed {about['seed']}", words)
    page.section("Scores").add(_on_page(*score_rows(content)), _HOW)
    page.section("Targets").add(_on_page(*target_rows(entry["targets"])))
    page.section("What was said for what was at work").figure(
        figures["confusion"],
        f"{first}: rows are what was at work, columns what was said; pairs are left out.",
    )
    page.section("Probabilities").add(calibration(entry["scores"]["reliability"])).figure(
        figures["reliability"],
        "How often a named effect was at work, against the probability claimed.",
    )
    settings = {
        "scored": about["date"],
        "diagnosed": f"at commit {about['commit']}",
        "made": f"at commit {about['made_at']}, seed {about['seed']}",
        "hash of the answers": ", ".join(about["sha256"]),
    }
    return how_made(page, "blind score", about["command"], settings, words="what makes the cases again")


def _on_page(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    """A table of the report as the page shows it, without Markdown's marks."""
    return table(
        heads, ([cell.replace("**", "").replace(" %", "\N{NO-BREAK SPACE}%") for cell in row] for row in rows)
    )


def scoreboard_figures(content: Scores) -> dict[str, np.ndarray]:
    """Pictures of the report by name: what was said, of the first method, and the probabilities of all."""
    scores = {method: entry["scores"] for method, entry in content["methods"].items()}
    return {
        "confusion": confusion_figure(next(iter(scores.values()))["confusion"]),
        "reliability": reliability_figure({method: one["reliability"] for method, one in scores.items()}),
    }
