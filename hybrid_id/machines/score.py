"""Scores of many judged cases, each with its interval, and the targets that were set before the first run."""

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import binom, norm

from hybrid_id.machines.judge import Judged

LEVEL = 0.95
BINS = 10
"""Bins of the reliability curve, of equal count."""
TRIVIAL, SURE = 0.02, 0.95
"""Probability below which absent names are left out of the calibration, and from which a claim is sure."""
Score = dict[str, Any]
"""``value``, ``low``, ``high``, the number ``n`` of cases behind it, and the ``wrong`` ones by name."""

SHARES = {"false_alarms": "false_alarm", "outside_detected": "outside"} | {
    name: name
    for name in (
        *("top_1", "top_3", "leads_train", "place", "top_1_at_place", "joint", "tied", "whole", "values"),
        *("outside_at", "false_unknown", "covered", "share_covered", "broken"),
    )
}
"""Shares of answers of a `Judged`, by score."""
BAD = ("false_alarms", "false_unknown", "broken")
"""Shares where fewer is better."""
GROUPS: Mapping[str, Callable[[Judged], str]] = {
    "family": lambda one: one.family,
    "level": lambda one: one.level,
    "family and level": lambda one: f"{one.family}, {one.level}",
    "system": lambda one: one.system,
    "train records": lambda one: str(one.records or ""),
    "engine": lambda one: one.engine,
    "effect": lambda one: one.effect,
}


def scores(judged: Sequence[Judged]) -> dict[str, Any]:
    """All scores of a method.

    Args:
        judged: its cases.

    Returns:
        Plain data: ``all``; ``by`` dimension and group; ``confusion``; ``reliability``.
    """
    by: dict[str, dict[str, Any]] = {}
    for name, key in GROUPS.items():
        groups = sorted({key(one) for one in judged} - {""})
        by[name] = {group: figures([one for one in judged if key(one) == group]) for group in groups}
    return {
        "all": figures(judged),
        "by": by,
        "confusion": confusion(judged),
        "reliability": reliability(_claims(judged)),
    }


def figures(judged: Sequence[Judged]) -> dict[str, Score]:
    """Scores of a group of cases; those without a case to speak of are left out."""
    found: dict[str, Score] = {"cases": {"value": len(judged), "n": len(judged)}}
    for name, question in SHARES.items():
        known = [(one.case, getattr(one, question)) for one in judged]
        known = [(case, bool(answer)) for case, answer in known if answer is not None]
        if known:
            wrong = [case for case, answer in known if answer == (name in BAD)]
            found[name] = share([answer for _, answer in known]) | {"wrong": wrong}
    f1 = [(one.case, one.f1) for one in judged if one.f1 is not None]
    if f1:
        found["f1"] = mean([value for _, value in f1]) | {"wrong": [case for case, value in f1 if value < 1]}
    sure = [(one.case, right) for one in judged for p, right in one.claims if p >= SURE]
    if sure:
        found["sure"] = share([right for _, right in sure]) | {"wrong": [c for c, right in sure if not right]}
    if (calibration := reliability(_claims(judged)))["n"]:
        found["calibration"] = {
            "value": calibration["expected_error"],
            "low": None,
            "high": None,
            "n": calibration["n"],
            "wrong": [],
        }
    for name, values in (
        ("share_error", [(one.case, error) for one in judged for error in one.share_errors]),
        ("closed", [(one.case, one.closed) for one in judged]),
        ("shrink_error", [(one.case, one.shrink_error) for one in judged]),
        ("seconds", [(one.case, one.seconds) for one in judged]),
        ("processor", [(one.case, one.processor) for one in judged]),
    ):
        known = [(case, abs(v) if name.endswith("_error") else v) for case, v in values if v is not None]
        known = [(case, v) for case, v in known if math.isfinite(v)]
        if known:
            worst = sorted(known, key=lambda pair: pair[1], reverse=name != "closed")[:5]
            found[name] = median([v for _, v in known]) | {"wrong": [case for case, _ in worst]}
    if "seconds" in found:
        most = {"value": found["seconds"]["most"], "low": None, "high": None, "n": found["seconds"]["n"]}
        found["slowest"] = most | {"wrong": found["seconds"]["wrong"][:1]}
    return found


def share(answers: Sequence[bool]) -> Score:
    """A share with Wilson's interval (E. B. Wilson, J. Am. Stat. Assoc. 22, 1927)."""
    return mean([float(answer) for answer in answers])


def mean(values: Sequence[float]) -> Score:
    """A mean of values from 0 to 1 with Wilson's interval of a share like it, which is the widest that it can have."""
    value, n, z = float(np.mean(values)), len(values), float(norm.ppf((1 + LEVEL) / 2))
    middle, half = value + z**2 / (2 * n), z * math.sqrt(value * (1 - value) / n + (z / (2 * n)) ** 2)
    low, high = ((middle + side * half) / (1 + z**2 / n) for side in (-1, 1))
    return {"value": value, "low": max(low, 0.0), "high": min(high, 1.0), "n": n}


def median(values: Sequence[float]) -> Score:
    """A median with its distribution-free interval from order statistics, and the greatest value."""
    ordered, n = np.sort(values), len(values)
    rank = int(binom.ppf((1 - LEVEL) / 2, n, 0.5))
    known = rank >= 1
    return {
        "value": float(np.median(ordered)),
        "low": float(ordered[rank - 1]) if known else None,
        "high": float(ordered[n - rank]) if known else None,
        "n": n,
        "least": float(ordered[0]),
        "most": float(ordered[-1]),
    }


def _claims(judged: Sequence[Judged]) -> list[tuple[float, bool]]:
    """Probability and truth of every name that was ranked, without those that are trivially absent."""
    return [(p, right) for one in judged for p, right in one.claims if right or p >= TRIVIAL]


def reliability(claims: Sequence[tuple[float, bool]]) -> dict[str, Any]:
    """How often a named effect is at work, against the probability that was claimed.

    The expected calibration error is the mean distance of the two over bins of equal count (C. Guo et al., On
    calibration of modern neural networks, ICML 2017, has bins of equal width).

    Args:
        claims: claimed probability and truth of each claim.
    """
    bins, error = [], 0.0
    ordered = sorted(claims, key=lambda claim: claim[0])
    for own in np.array_split(np.arange(len(ordered)), BINS):
        if len(own):
            claimed = float(np.mean([ordered[k][0] for k in own]))
            seen = share([ordered[k][1] for k in own])
            bins.append({"claimed": claimed, **seen})
            error += len(own) / len(claims) * abs(claimed - seen["value"])
    brier = float(np.mean([(p - right) ** 2 for p, right in claims])) if claims else None
    return {"bins": bins, "expected_error": error if claims else None, "brier": brier, "n": len(claims)}


def confusion(judged: Sequence[Judged]) -> dict[str, Any]:
    """Counts of what was said (columns) for what was at work (rows), pairs apart.

    An accepted equivalent counts as the effect itself.
    """
    pairs = Counter((_row(one), one.said) for one in judged if one.family != "pair")
    last = ("none", "unknown", "broken")
    rows = {row for row, _ in pairs}
    effects = sorted((rows | {said for _, said in pairs}) - set(last))
    names = [*[e for e in effects if e in rows], *[e for e in ("none", "unknown") if e in rows]]
    columns = [*effects, *[e for e in last if any(said == e for _, said in pairs)]]
    return {"rows": names, "columns": columns, "counts": [[pairs[(r, c)] for c in columns] for r in names]}


def _row(one: Judged) -> str:
    return one.family if one.family in ("none", "unknown") else one.effect


@dataclass(frozen=True)
class Target:
    """One figure that was aimed at before the first run.

    Attributes:
        claim: in words.
        group: of `scores`: ``all``, or a dimension and a group of it.
        score: its name.
        bound: the figure.
        upper: whether it is an upper one.
        most: a second bound above it.
        surely: whether it is missed only where all of the interval lies below it.
    """

    claim: str
    group: tuple[str, str] | None
    score: str
    bound: float
    upper: bool = False
    most: float | None = None
    surely: bool = False

    @property
    def words(self) -> str:
        """The bound as it is printed."""
        unit = 1 if self.score in UNITS else 100
        sign = "≤" if self.upper else "not surely below" if self.surely else "≥"
        text = f"{self.bound:.2f}" if UNITS.get(self.score) == "" else f"{unit * self.bound:g}"
        ending = f" {UNITS.get(self.score, '%')}".rstrip()
        return f"{text}-{unit * self.most:g}{ending}" if self.most is not None else f"{sign} {text}{ending}"

    def met(self, value: float) -> bool:
        """Whether a value reaches it."""
        if self.most is not None:
            return self.bound <= value <= self.most
        return value <= self.bound if self.upper else value >= self.bound

    def shown(self, score: Mapping[str, Any]) -> bool:
        """Whether all of a score's interval reaches it."""
        ends = (score["low"], score["high"])
        return all(end is not None and self.met(end) for end in ends)


UNITS = {
    "shrink_error": "points",
    "share_error": "points",
    "seconds": "s",
    "processor": "s",
    "slowest": "s",
    "f1": "",
    "calibration": "",
}
"""Units of the scores that are no percentages."""
_BY = "family and level"
MESSY_TARGETS = (
    Target("a dominant effect first", None, "top_1", 0.90),
    Target("its place", None, "place", 0.90),
    Target("dominant effect outside the catalogue: detected", None, "outside_detected", 0.75),
    Target("false 'unknown'", None, "false_unknown", 0.10, upper=True),
    Target("false alarms where the structure is right", None, "false_alarms", 0.05, upper=True),
    Target("error of the claimed shares, median", None, "share_error", 10.0, upper=True),
    Target("expected calibration error", None, "calibration", 0.05, upper=True),
    *(
        Target(f"claims of 0.95 or more right: {family}", ("family", family), "sure", 0.95, surely=True)
        for family in ("single", "pair", "unknown", "none", "parameters")
    ),
    Target("time per case, median", None, "seconds", 60.0, upper=True),
    Target("time per case, most", None, "slowest", 300.0, upper=True),
)
ARM_TARGETS = (
    Target("joint of the dominant effect", None, "joint", 0.90),
    Target("its place", None, "place", 0.90),
    Target("its name", None, "top_1", 0.85),
    Target("false alarms where the structure is right", None, "false_alarms", 0.05, upper=True),
    Target("expected calibration error", None, "calibration", 0.05, upper=True),
    Target("time per case, median", None, "seconds", 240.0, upper=True),
)
TARGETS = (
    Target("strong effects: first name right", (_BY, "single, strong"), "top_1", 0.95),
    Target("medium effects: first name right", (_BY, "single, medium"), "top_1", 0.85),
    Target("strong effects: place right", (_BY, "single, strong"), "place", 0.95),
    Target("medium effects: place right", (_BY, "single, medium"), "place", 0.90),
    Target("strong pairs: F1 of the set", (_BY, "pair, strong"), "f1", 0.85),
    Target("medium pairs: F1 of the set", (_BY, "pair, medium"), "f1", 0.65),
    Target("false alarms where the structure is right", None, "false_alarms", 0.05, upper=True),
    Target("outside the catalogue: detected", None, "outside_detected", 0.75),
    Target("false 'unknown'", None, "false_unknown", 0.10, upper=True),
    Target("error of the claimed shrink, median", None, "shrink_error", 5.0, upper=True),
    Target("95 % intervals that hold the true shrink", None, "covered", 0.90, most=0.99),
    Target("closable gap that is closed, median", None, "closed", 0.90),
)


def against_targets(scores: Mapping[str, Any], realism: str = "clean") -> list[dict[str, Any]]:
    """Each target of clean, messy or arms' cases with what was seen.

    ``met`` is None where no case speaks of it, ``shown`` tells whether all of the interval meets it, and ``cases`` are
    those to look at.
    """
    rows = []
    for target in {"messy": MESSY_TARGETS, "arms": ARM_TARGETS}.get(realism, TARGETS):
        group = (
            scores["all"] if target.group is None else scores["by"][target.group[0]].get(target.group[1], {})
        )
        seen = group.get(target.score)
        judged = None if seen is None else seen["high" if target.surely else "value"]
        met = None if judged is None else target.met(judged)
        cases = [] if seen is None or met else seen["wrong"]
        row = {"claim": target.claim, "target": target.words, "score": target.score}
        shown = bool(met and seen is not None and target.shown(seen))
        rows.append(row | {"seen": seen, "met": met, "shown": shown, "cases": cases})
    return rows
