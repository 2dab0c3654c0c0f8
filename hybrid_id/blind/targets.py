"""What the blind check set out to reach, and what of it was seen."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


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
    """Each target of clean or of messy cases with what was seen.

    ``met`` is None where no case speaks of it, ``shown`` tells whether all of the interval meets it, and ``cases`` are
    those to look at.
    """
    rows = []
    for target in MESSY_TARGETS if realism == "messy" else TARGETS:
        group = (
            scores["all"] if target.group is None else scores["by"][target.group[0]].get(target.group[1], {})
        )
        seen = group.get(target.score)
        judged = None if seen is None else seen["high" if target.surely else "value"]
        met = None if judged is None else target.met(judged)
        cases = [] if seen is None or met else seen["wrong"]
        told = {"claim": target.claim, "target": target.words, "score": target.score}
        shown = bool(met and seen is not None and target.shown(seen))
        rows.append(told | {"seen": seen, "met": met, "shown": shown, "cases": cases})
    return rows
