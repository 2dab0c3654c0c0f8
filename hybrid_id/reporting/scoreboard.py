"""The benchmark report of a blind check, as Markdown."""

from __future__ import annotations

from collections.abc import Mapping
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


def markdown(content: Scores) -> str:
    """The report as a file of its own: scores against methods, and the targets of the first one.

    Args:
        content: what is kept in ``scores.json``.
    """
    about, methods = content["about"], content["methods"]
    first = next(iter(methods))
    hashes = ", ".join(one[:16] for one in about["sha256"])
    others = {m: c for m, c in about.get("commits", {}).items() if c != about["commit"]}
    rows = []
    for name, words in ROWS.items():
        scores = [of["scores"]["all"].get(name) for of in methods.values()]
        if any(scores):
            rows.append([words, *(value(name, score) for score in scores)])
    targets = []
    for target in methods[first]["targets"]:
        met = "met" if target["shown"] else DOUBTFUL
        met = "no case" if target["met"] is None else met if target["met"] else "**missed**"
        seen = value(target["score"], target["seen"])
        targets.append([target["claim"], target["target"], seen, met, ", ".join(target["cases"][:12])])
    claims = methods[first]["scores"]["reliability"]
    parts = [
        f"# {about['date']}, commit {short(about['commit'])}, seed {about['seed']}",
        f"{about['scored']} of {about['cases']} cases scored"
        + (f", {lost} more could not be made" if (lost := about["asked"] - about["cases"]) else "")
        + f"; made at commit {short(about['made_at'])}, hash of the answers {hashes}. "
        + "".join(f"`{method}` was run at commit {short(at)}. " for method, at in others.items())
        + "Shares with Wilson's 95 % interval and the number of cases behind them.",
        f"    {about['command']}",
        markdown_table(["", *methods], rows),
        f"Targets, for `{first}`:",
        markdown_table(["claim", "target", "seen", "", "cases to look at"], targets),
        "No effect was ranked, so that there is no probability to judge."
        if claims["expected_error"] is None
        else f"Probabilities of the named effects: expected calibration error {claims['expected_error']:.3f} (ten bins "
        f"of equal count; absent names below 0.02 left out), Brier score {claims['brier']:.3f} over {claims['n']} "
        "claims.",
    ]
    return "\n\n".join(parts) + "\n"
