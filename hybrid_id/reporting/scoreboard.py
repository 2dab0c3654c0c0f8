"""The benchmark report of a blind check, as Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from hybrid_id.reporting.provenance import short
from hybrid_id.reporting.tables import markdown_table

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


def value(name: str, score: Mapping[str, Any] | None) -> str:
    """A score in words: value, interval and number of cases."""
    if score is None:
        return "–"
    percent = name not in ("f1", "calibration", *_PLAIN)
    form = "{:.1f}" if name in _PLAIN else "{:.3f}" if name == "calibration" else "{:.2f}"

    def number(x: float) -> str:
        return f"{100 * x:.0f}" if percent else form.format(x)

    text = number(score["value"]) + (" %" if percent else "")
    if name in ("seconds", "slowest", "processor"):
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
