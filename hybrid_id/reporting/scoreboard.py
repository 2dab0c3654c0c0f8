"""The scoreboard of a blind check as text: one column a contender, intervals, targets, and what fell short."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from hybrid_id.errors import InputError
from hybrid_id.records.whole_file import write_whole
from hybrid_id.reporting.provenance import short
from hybrid_id.reporting.style import save

Scores = Mapping[str, Any]
"""What ``blind score`` keeps in ``scores.json``."""

ROWS = {
    "top_1": "first name right (single effects; a dominant one of a messy machine)",
    "top_3": "among the first three",
    "place": "place of the first right",
    "top_1_at_place": "first name right at the right place",
    "f1": "F1 of the set (pairs)",
    "whole": "exactly what was at work named (all cases)",
    "false_alarms": "false alarms (nothing at work)",
    "values": "nothing wrong or the values alone, as it is (nothing at work)",
    "outside_detected": "outside the catalogue: detected",
    "outside_at": "joint (and side) of it right, where told",
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
    "broken": "broken cases",
}
INDEX = "README.md"
"""List of the scoreboards in the folder where they are published."""
INDEX_HEADS = ("date", "commit", "seed", "cases scored", "methods", "exactly right (first method)")
"""Heads of that list."""
_PLAIN = ("shrink_error", "share_error", "seconds", "slowest")
"""Scores in points or seconds."""
TIES_RESOLVED = 0.7
"""Share of ties that the next experiment is to resolve."""
IN_GROUPS = ("cases", "top_1", "top_3", "place", "f1", "whole", "false_unknown", "sure", "closed", "seconds")
"""Scores that are shown group by group."""
SHORT = {
    "cases": "cases", "top_1": "first name", "top_3": "first three", "place": "place", "f1": "F1",
    "whole": "all right", "false_unknown": "false unknown", "sure": "sure claims right", "closed": "gap closed",
    "seconds": "time [s]",
}  # fmt: skip


def value(name: str, score: Mapping[str, Any] | None, *, interval: bool = True) -> str:
    """A score in words: value, interval and number of cases."""
    if score is None:
        return "–"
    if name == "cases":
        return str(score["value"])
    percent = name not in ("f1", "calibration", *_PLAIN)
    form = "{:.1f}" if name in _PLAIN else "{:.3f}" if name == "calibration" else "{:.2f}"

    def number(x: float) -> str:
        return f"{100 * x:.0f}" if percent else form.format(x)

    text = number(score["value"]) + (" %" if percent else "")
    if not interval or name in ("seconds", "slowest"):
        return text
    if score.get("low") is None:  # of few cases
        return f"{text} ({score['n']})"
    return f"{text} ({number(score['low'])} to {number(score['high'])}; {score['n']})"


def table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table in Markdown."""
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def score_rows(content: Scores) -> tuple[list[str], list[list[str]]]:
    """Heads and rows of the main table: scores against contenders."""
    methods = list(content["methods"])
    rows = []
    for name, words in ROWS.items():
        told = [content["methods"][m]["scores"]["all"].get(name) for m in methods]
        if any(told):
            rows.append([words, *(value(name, one) for one in told)])
    return ["", *methods], rows


def target_rows(targets: Sequence[Mapping[str, Any]]) -> tuple[list[str], list[list[str]]]:
    """Heads and rows of the targets."""
    rows = [
        [
            t["claim"],
            t["target"],
            value(t["score"], t["seen"]),
            "no case" if t["met"] is None else _verdict(t["met"], t["shown"]),
            ", ".join(t["cases"][:12]),
        ]
        for t in targets
    ]
    return ["claim", "target", "seen", "", "cases to look at"], rows


def _verdict(met: bool, shown: bool) -> str:
    """What is said of a target by the figure seen, and by all of its interval."""
    return ("met" if shown else "met; its interval reaches beyond") if met else "**missed**"


def group_rows(groups: Mapping[str, Any]) -> tuple[list[str], list[list[str]]]:
    """Heads and rows of one dimension."""
    shown = [name for name in IN_GROUPS if any(name in figures for figures in groups.values())]
    rows = [[group, *(value(n, f.get(n), interval=False) for n in shown)] for group, f in groups.items()]
    return ["", *(SHORT[name] for name in shown)], rows


def markdown(content: Scores) -> str:
    """The scoreboard as a file of its own.

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
        "\n".join(f"    {line}" for line in about["commands"]),
        table(*score_rows(content)),
        f"Targets, for `{first}`:",
        table(*target_rows(content["methods"][first]["targets"])),
        calibration(content["methods"][first]["scores"]["reliability"]),
    ]
    if content.get("ties"):
        parts.append(ties_line(content["ties"]))
    for dimension, groups in content["methods"][first]["scores"]["by"].items():
        parts += [f"`{first}` by {dimension}:", table(*group_rows(groups))]
    return "\n\n".join(parts) + "\n"


def calibration(told: Mapping[str, Any]) -> str:
    """The calibration of the probabilities in a sentence."""
    if told["expected_error"] is None:
        return "No effect was ranked, so that there is no probability to judge."
    return (
        f"Probabilities of the named effects: expected calibration error {told['expected_error']:.3f} (ten bins of "
        f"equal count; absent names below 0.02 left out), Brier score {told['brier']:.3f} over {told['n']} claims."
    )


def ties_line(told: Mapping[str, Any]) -> str:
    """How many ties the proposed experiment resolves, in a sentence or two."""
    if told["resolved"] is None:
        return "No case had a tie for which an experiment was proposed."
    verdict = _verdict(*(told["resolved"][key] >= TIES_RESOLVED for key in ("value", "low")))
    left = [name for name, one in told["cases"].items() if not one["resolved"]]
    look = f" Not resolved: {', '.join(left[:12])}." if left else ""
    return (
        f"Ties that the proposed next experiment resolves: {value('resolved', told['resolved'])}, target "
        f"≥ {100 * TIES_RESOLVED:.0f} %, {verdict}; resolved to exactly what was at work: "
        f"{value('right', told['right'])}.{look}"
    )


def publish(folder: Path, content: Scores, pictures: Mapping[str, np.ndarray]) -> Path:
    """Write a scoreboard as a file of its own with its pictures beside it, and list it in the folder's README.md.

    A scoreboard that the folder has is not written again: remarks that stand in its file stay.

    Args:
        folder: of published scoreboards; made where it is not there.
        content: what is kept in ``scores.json``.
        pictures: by name, (H, W, 3) uint8.

    Returns:
        The file.
    """
    about, text = content["about"], markdown(content)
    # one commit may take several sets of cases, and with several programs
    digest = hashlib.sha256(text.encode()).hexdigest()[:8]
    name = f"{about['date']}-{short(about['commit'])}-{about['scored']}-{digest}"
    file, index = folder / f"{name}.md", folder / INDEX
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not file.exists():
            for picture, image in pictures.items():
                save(image, folder / f"{name}-{picture}.png")
            links = (f"![{one.capitalize()}]({quote(f'{name}-{one}.png')})\n" for one in pictures)
            write_whole(file, "\n".join([text, *links]))
        before = index.read_text(encoding="utf-8") if index.exists() else ""
        if f"({quote(file.name)})" not in before:
            write_whole(index, _listed(before, _index_row(content, file)))
    except OSError as error:
        raise InputError(f"{folder} cannot be written ({error.strerror}); give another folder") from None
    return file


def _index_row(content: Scores, file: Path) -> list[str]:
    """The line of the list that stands for a scoreboard."""
    about, methods = content["about"], content["methods"]
    whole = next(iter(methods.values()))["scores"]["all"].get("whole")
    cases = f"{about['scored']} of {about['cases']}"
    return [
        f"[{about['date']}]({quote(file.name)})", short(about["commit"]), str(about["seed"]), cases,
        ", ".join(methods), value("whole", whole),
    ]  # fmt: skip


def _listed(before: str, row: Sequence[str]) -> str:
    """A page with one more line in its list of scoreboards, which is begun where there is none; the rest stays."""
    head = table(INDEX_HEADS, [])
    if head not in before:
        before = f"{before.rstrip() or '# Published scoreboards'}\n\n{head}\n"
    start, rest = before.split(head, 1)
    lines = rest.splitlines()[1:]
    rows = next((k for k, line in enumerate(lines) if not line.startswith("|")), len(lines))
    lines.insert(rows, f"| {' | '.join(row)} |")
    return "\n".join([start + head, *lines]) + "\n"
