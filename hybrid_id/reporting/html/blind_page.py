"""A blind check as one page: the scoreboard, the targets, then where it goes wrong."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from hybrid_id.reporting.html.made import how_made
from hybrid_id.reporting.html.page import Page
from hybrid_id.reporting.html.twin import Drawn
from hybrid_id.reporting.provenance import short
from hybrid_id.reporting.scoreboard import Scores, calibration, group_rows, score_rows, target_rows, ties_line
from hybrid_id.reporting.tables import open_table

_HOW = (
    "Effects were drawn by a generator with physics of its own and withheld; the answers were sealed before the run "
    "and opened to score it. Names and places that the records cannot tell from the true ones count as right. Shares "
    "carry Wilson's 95 % interval and the number of cases behind them; medians the interval of order statistics."
)


def blind_page(content: Scores, figures: Mapping[str, Drawn]) -> Page:
    """The page.

    Args:
        content: what is kept in ``scores.json``.
        figures: ``confusion`` and ``reliability``.
    """
    about, first = content["about"], next(iter(content["methods"]))
    told = content["methods"][first]
    missed = [t["claim"] for t in told["targets"] if t["met"] is False]
    page = Page(
        f"Blind check, seed {about['seed']}",
        f"{about['scored']} of {about['cases']} cases, commit {short(about['commit'])}. "
        + (f"{first} misses {len(missed)} of {len(told['targets'])} targets." if missed else ""),
    )
    page.section("Scoreboard").add(_table(*score_rows(content)), _HOW)
    page.section("Targets").add(_table(*target_rows(told["targets"])))
    page.section("What was said for what was at work").figure(
        figures["confusion"],
        f"{first}: rows are what was at work, columns what was said; pairs are left out.",
    )
    page.section("Probabilities").add(calibration(told["scores"]["reliability"])).figure(
        figures["reliability"],
        "How often the effect ranked first was at work, against the probability claimed.",
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


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]):
    found = open_table(*heads)
    for row in rows:
        found.add_row(*(cell.replace("**", "").replace(" %", "\N{NO-BREAK SPACE}%") for cell in row))
    return found
