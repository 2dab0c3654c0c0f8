"""A blind check as one page: the scoreboard, the targets, then where it goes wrong."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from hybrid_id.reporting.html.interactive import Drawn
from hybrid_id.reporting.html.made import how_made
from hybrid_id.reporting.html.page import Page
from hybrid_id.reporting.provenance import short
from hybrid_id.reporting.scoreboard import (
    Scores,
    calibration,
    group_rows,
    score_rows,
    target_rows,
    ties_line,
    value,
)
from hybrid_id.reporting.tables import open_table

_HOW = (
    "Effects were drawn by a generator with physics of its own and withheld; the answers were sealed before the run "
    "and opened to score it. Names and places that the records cannot tell from the true ones count as right. Shares "
    "carry Wilson's 95 % interval and the number of cases behind them; medians the interval of order statistics."
)

HEADLINES = {
    "top_1": "the right effect first",
    "whole": "exactly what was at work named",
    "false_alarms": "false alarms",
    "outside_detected": "outside the catalogue detected",
    "closed": "closable gap closed (median)",
}
"""Scores that the lead tells, in words."""


def blind_page(content: Scores, figures: Mapping[str, Drawn]) -> Page:
    """The page.

    Args:
        content: what is kept in ``scores.json``.
        figures: ``confusion`` and ``reliability``.
    """
    about, first = content["about"], next(iter(content["methods"]))
    told = content["methods"][first]
    page = Page(f"Blind check, seed {about['seed']}", _lead(first, told, about))
    page.section("Scoreboard").add(_table(*score_rows(content)), _HOW)
    page.section("Targets").add(_table(*target_rows(told["targets"])))
    page.section("What was said for what was at work").figure(
        figures["confusion"],
        f"{first}: rows are what was at work, columns what was said; pairs are left out.",
    )
    page.section("Probabilities").add(calibration(told["scores"]["reliability"])).figure(
        figures["reliability"],
        "How often a named effect was at work, against the probability claimed.",
    )
    groups = page.section("Group by group")
    for dimension, figures in told["scores"]["by"].items():
        groups.add(f"By {dimension}", _table(*group_rows(figures)))
    if content["ties"] is not None:
        page.section("Ties").add(ties_line(content["ties"]).replace("**", ""))
    facts = {
        "scored": about["date"],
        "diagnosed": f"at commit {about['commit']}",
        "made": f"at commit {about['made_at']}, seed {about['seed']}",
        "hash of the answers": ", ".join(about["sha256"]),
    }
    return how_made(
        page, "blind score", "\n".join(about["commands"]), facts, words="what makes and scores it again"
    )


def _lead(method: str, told: Mapping[str, Any], about: Mapping[str, Any]) -> str:
    """The outcome in words: targets met, the headline figures, and what was scored."""
    asked = [t for t in told["targets"] if t["met"] is not None]
    missed = [t["claim"] for t in asked if not t["met"]]
    met = len(asked) - len(missed)
    every = f"all {met}" if asked and not missed else f"{met} of {len(asked)}"
    words = f"{method} meets {every} targets" if asked else "No case speaks of a target"
    beyond = sum(t["met"] and not t["shown"] for t in asked)
    words += f", {beyond} of these with an interval that reaches beyond the target" if beyond else ""
    silent = len(told["targets"]) - len(asked)
    words += f" ({silent} more without a case)" if asked and silent else ""
    words += f"; missed: {'; '.join(missed)}." if missed else "."
    scores = told["scores"]["all"]
    figures = [
        f"{said} {value(n, scores[n], interval=False)}" for n, said in HEADLINES.items() if scores.get(n)
    ]
    words += f" Over all cases: {', '.join(figures)}." if figures else ""
    return f"{words} {about['scored']} of {about['cases']} cases scored, commit {short(about['commit'])}."


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]):
    found = open_table(*heads)
    for row in rows:
        found.add_row(*(cell.replace("**", "").replace(" %", "\N{NO-BREAK SPACE}%") for cell in row))
    return found
