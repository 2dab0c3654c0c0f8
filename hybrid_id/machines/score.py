"""Diagnoses held against their ground truth, the scores of many, each with its interval, and the targets set before."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.stats import binom, norm

Truth = Mapping[str, Any]
Said = Mapping[str, Any]
"""The content of a ``diagnosis.json``."""
SOUND = ("none", "parameters")
"""Families whose structure is right."""
LINK = ("link_friction", "load")
"""Places on the link's side of a gear."""
RIGHT, WRONG = 1.05, 1.2
"""Error of the nominal values over that of the re-fit up to which they are right, and from which they are wrong."""


@dataclass(frozen=True)
class Judged:
    """How one case went; None where a question does not arise.

    Attributes:
        case: its name.
        family, level: of the case.
        realism: clean, messy or arms.
        effect: what was at work, of a messy machine what was dominant; several joined by ``+``.
        broken: why there is no diagnosis, empty where there is one.
        seconds, processor: time that the diagnosis took, and of the processors.
        said: what it stands by, in one word: an effect's name (that of the answer where it is accepted), ``unknown``,
            ``none`` or ``broken``.
        top_1, top_3: whether an accepted name is ranked first, among the first three (single effects; a messy machine's
            dominant ones).
        leads_train: whether a dominant effect of a messy machine explains most on the train records, too: what shows in
            test records alone cannot be found.
        place: whether the first one's place is accepted (likewise).
        top_1_at_place: both together.
        joint: whether its joint is that of a dominant effect, or one that feels it as well (arms).
        tied: whether an accepted name is the first one's or one of those that are said to be indistinguishable from it
            (arms).
        pair: hits, named and true effects of a pair.
        whole: whether exactly what was at work is named: all effects and no other, nothing where nothing was, and
            "unknown" with no name beside it where it is outside the catalogue. Of a messy machine: a dominant effect
            first, no name that was not at work, and "unknown" only where the dominant effect is outside the catalogue.
        false_alarm: whether something is named in a case where the structure is right.
        values: whether the verdict there is that nothing is wrong, or the parameters alone.
        outside: whether something outside the catalogue is detected where it acts.
        outside_at: whether the joint, and the side of its gear, at which it is said to act are right; None where
            neither is claimed.
        false_unknown: whether it is claimed where nothing like it acts.
        claims: probability of each ranked effect, and whether it was at work.
        share_errors: claimed share of the gap of each effect that is rightly named, less the true one [points].
        share_covered: whether the interval of the first one's share holds the true one.
        shrink_error: claimed share of the gap that closes, less the true one [points].
        covered: whether the interval of the share holds the true one.
        closed: share of the closable gap that is closed.
    """

    case: str
    family: str
    level: str
    realism: str
    effect: str
    broken: str
    seconds: float
    said: str
    processor: float = math.nan
    top_1: bool | None = None
    top_3: bool | None = None
    leads_train: bool | None = None
    place: bool | None = None
    top_1_at_place: bool | None = None
    joint: bool | None = None
    tied: bool | None = None
    pair: tuple[int, int, int] | None = None
    whole: bool = False
    false_alarm: bool | None = None
    values: bool | None = None
    outside: bool | None = None
    outside_at: bool | None = None
    false_unknown: bool | None = None
    claims: tuple[tuple[float, bool], ...] = ()
    share_errors: tuple[float, ...] = ()
    share_covered: bool | None = None
    shrink_error: float | None = None
    covered: bool | None = None
    closed: float | None = None

    @property
    def f1(self) -> float | None:
        """Harmonic mean of precision and recall of a pair's effects."""
        return None if self.pair is None else 2 * self.pair[0] / max(self.pair[1] + self.pair[2], 1)


def judge(case: str, answers: Truth, said: Said | None) -> Judged:
    """Hold a diagnosis against its answers; a broken one, or None, has nothing right.

    Args:
        case: its name.
        answers: its answers.
        said: its diagnosis, with what the run tells of itself in ``run``.
    """
    run = (said or {}).get("run", {})
    broken = "not run" if said is None else str(run.get("message") or "")
    said = {} if broken or said is None else said
    family, truth = str(answers["family"]), answers["effects"]
    realism = "arms" if "arm" in answers else "messy" if "messy" in answers else "clean"
    known, messy, of_arm = family != "unknown", realism != "clean", realism == "arms"
    sound = family in SOUND and not broken
    leading = [t for t in truth if t.get("role", "dominant") == "dominant"]
    asked = family == "single" or (messy and family == "pair")
    ranked, unknown = said.get("effects", []), bool(said.get("unknown", False))
    chosen, first = [e for e in ranked if e["selected"]], ranked[0] if ranked else None

    # each true effect serves its most probable name, and what is named; another name that the answers accept for it
    # is neither right nor wrong: of two names of one thing one alone can be probable
    right = np.array([[_right(e, t) for t in truth] for e in ranked], bool).reshape(len(ranked), len(truth))
    chance = np.array([float(e["probability"]) for e in ranked])
    pairs = zip(*linear_sum_assignment(right * chance[:, None], maximize=True), strict=True)
    serves = {row for row, column in pairs if right[row, column]}
    claims = tuple(
        (float(chance[k]), bool(right[k].any()))
        for k, e in enumerate(ranked)
        if k in serves or e["selected"] or not right[k].any()
    )
    named = right[np.array([bool(e["selected"]) for e in ranked], bool)]
    hits = int(named[linear_sum_assignment(named, maximize=True)].sum()) if known or messy else 0
    accepted = [any(e["name"] in t["accept"] for t in leading) for e in ranked[:3]]
    at_place = bool(asked and first and any(_right(first, t) for t in leading))
    whole = len(chosen) == hits and (at_place or not asked if messy else hits == (len(truth) if known else 0))

    word = "broken" if broken else "unknown" if unknown else chosen[0]["name"] if chosen else "none"
    if chosen and not unknown and asked:
        word = next((t["name"] for t in leading if word in t["accept"]), word)
    leads = None
    if asked and messy and all("closes_train" in t for t in truth):
        small = [t["closes_train"] for t in truth if t["role"] == "small"]
        leads = max(t["closes_train"] for t in leading) > max(small, default=-math.inf)
    joint = tied = None
    if asked and of_arm:
        joints = {where.rpartition("/")[0] for where in leading[0]["accept_where"]}
        joint = first is not None and first["where"].rpartition("/")[0] in joints
        names = {first["name"], *(one.split("@")[0] for one in first["tied_with"])} if first else set()
        tied = bool(names & set(leading[0]["accept"]))
    claimed, outside_at = said.get("unknown_location") or {}, None
    if unknown and not known and claimed.get("joint") is not None:
        places = [where.split("/") for where in truth[0]["accept_where"]]
        outside_at = any(
            at == claimed["joint"] and claimed.get("side") in (None, "load" if place in LINK else "motor")
            for at, place in places
        )

    gap, values = said.get("gap") or {}, None
    before, after, shrink = (gap.get(key) for key in ("refit", "with_effect", "shrink"))
    if sound and before is not None:  # a method without a re-fit judges no values
        ratio = answers["oracle"]["nominal"] / answers["oracle"]["refit"]
        if not RIGHT < ratio < WRONG:
            values = said["verdict"] == ("no_gap" if ratio <= RIGHT else "parameters_only")
    # an arm's answers hold joints by themselves over whole records, while a diagnosis simulates all joints, over as
    # long as they follow
    adds = family in ("single", "pair") and not of_arm
    error = covered = closed = None
    # before and after are measured on the test records; what a diagnosis has to guess is the noise floor
    if adds and chosen and before is not None and after is not None and shrink is not None:
        closable = before - answers["oracle"]["noise_floor"]
        if closable > 0:
            true, (low, high) = (before - after) / closable, gap.get("shrink_interval") or (None, None)
            error, covered = 100 * (shrink - true), None if None in (low, high) else bool(low <= true <= high)
    if adds and not broken:
        refit, closable = (
            answers["oracle"]["refit"],
            answers["oracle"]["refit"] - answers["oracle"]["with_effect"],
        )
        if closable > 0:
            closed = 0.0 if after is None or not math.isfinite(after) else (refit - after) / closable
    errors, share_covered = _shares(chosen, truth) if messy else ((), None)
    return Judged(
        case=case,
        family=family,
        level=str(answers["level"]),
        realism=realism,
        effect="+".join(t["name"] for t in leading) or "none",
        broken=broken,
        seconds=float(run.get("seconds", math.nan)),
        processor=float(run.get("processor_seconds", math.nan)),
        said=str(word),
        top_1=any(accepted[:1]) if asked else None,
        top_3=any(accepted) if asked else None,
        leads_train=leads,
        place=bool(first and any(first["where"] in t["accept_where"] for t in leading)) if asked else None,
        top_1_at_place=at_place if asked else None,
        joint=joint,
        tied=tied,
        pair=(hits, len(chosen), len(truth)) if family == "pair" and not messy else None,
        whole=not broken and unknown is not known and whole,
        false_alarm=(bool(chosen) or unknown) if sound else None,
        values=values,
        outside=None if known else unknown,
        outside_at=outside_at,
        false_unknown=unknown if known and not broken else None,
        claims=claims,
        shrink_error=error,
        covered=covered,
        closed=closed,
        share_errors=errors,
        share_covered=share_covered,
    )


def _right(effect: Said, truth: Truth) -> bool:
    """Whether an effect is accepted at its place; answers that do not say which name goes where accept all pairs."""
    if "right" in truth:
        return f"{effect['name']}@{effect['where']}" in truth["right"]
    return effect["name"] in truth["accept"] and effect["where"] in truth["accept_where"]


def _shares(chosen: Sequence[Said], truth: Sequence[Truth]) -> tuple[tuple[float, ...], bool | None]:
    """Errors [points] of the claimed shares of the effects rightly named, and whether the first interval holds its own.

    The true share is what an effect closes after those that are named before it, of the gap on the train records, as
    the claimed one is. The answers know it alone, and after all larger ones; of two dominant effects either may lead.
    """
    matched = [next((t for t in truth if _right(e, t)), None) for e in chosen]
    errors, covered = [], None
    for k, (said, own) in enumerate(zip(chosen, matched, strict=True)):
        if own is None or own in matched[:k] or said.get("share") is None:
            continue
        before = matched[0]
        true = own["closes_train"] if k == 0 else own["share_train"]
        if k and before is not None and own["role"] == "dominant" and own is truth[0]:
            true = own["share_train"] + before["share_train"] - before["closes_train"]
        errors.append(100 * (float(said["share"]) - true))
        interval = said.get("share_interval")
        if k == 0 and interval and None not in interval:
            covered = bool(interval[0] <= true <= interval[1])
    return tuple(errors), covered


LEVEL = 0.95
BINS = 10
"""Bins of the calibration, of equal count."""
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
    "family and level": lambda one: f"{one.family}, {one.level}",
}


def scores(judged: Sequence[Judged]) -> dict[str, Any]:
    """All scores of a method.

    Args:
        judged: its cases.

    Returns:
        Plain data: ``all``; ``by`` dimension and group; ``reliability``.
    """
    by: dict[str, dict[str, Any]] = {}
    for name, key in GROUPS.items():
        groups = sorted({key(one) for one in judged} - {""})
        by[name] = {group: figures([one for one in judged if key(one) == group]) for group in groups}
    return {
        "all": figures(judged),
        "by": by,
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
        found["f1"] = share([value for _, value in f1]) | {"wrong": [case for case, value in f1 if value < 1]}
    sure = [(one.case, right) for one in judged for p, right in one.claims if p >= SURE]
    if sure:
        found["sure"] = share([right for _, right in sure]) | {"wrong": [c for c, right in sure if not right]}
    if (calibration := reliability(_claims(judged)))["n"]:
        value = calibration["expected_error"]
        found["calibration"] = _bare(value, calibration["n"], [])
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
        seconds = found["seconds"]
        found["slowest"] = _bare(seconds["most"], seconds["n"], seconds["wrong"][:1])
    return found


def _bare(value: float, n: int, wrong: Sequence[str]) -> Score:
    """A score without an interval."""
    return {"value": value, "low": None, "high": None, "n": n, "wrong": list(wrong)}


def share(values: Sequence[float]) -> Score:
    """A share with Wilson's interval (E. B. Wilson, J. Am. Stat. Assoc. 22, 1927).

    Of a mean of values from 0 to 1 the interval of a share like it is the widest that it can have.
    """
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
    error = 0.0
    ordered = sorted(claims, key=lambda claim: claim[0])
    for own in np.array_split(np.arange(len(ordered)), BINS):
        if len(own):
            claimed, seen = (float(np.mean([ordered[k][side] for k in own])) for side in (0, 1))
            error += len(own) / len(claims) * abs(claimed - seen)
    brier = float(np.mean([(p - right) ** 2 for p, right in claims])) if claims else None
    return {"expected_error": error if claims else None, "brier": brier, "n": len(claims)}


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
    for aim in {"messy": MESSY_TARGETS, "arms": ARM_TARGETS}.get(realism, TARGETS):
        group = scores["all"] if aim.group is None else scores["by"][aim.group[0]].get(aim.group[1], {})
        seen, unit = group.get(aim.score), UNITS.get(aim.score, "%")
        most = math.inf if aim.most is None else aim.most
        low, high = (-math.inf, aim.bound) if aim.upper else (aim.bound, most)
        percent = 1 if aim.score in UNITS else 100
        words = f"{aim.bound:.2f}" if not unit else f"{percent * aim.bound:g}"
        sign = "≤" if aim.upper else "not surely below" if aim.surely else "≥"
        words = f"{sign} {words}" if aim.most is None else f"{words}-{percent * aim.most:g}"
        judged = None if seen is None else seen["high" if aim.surely else "value"]
        met = None if judged is None else low <= judged <= high
        ends = (seen["low"], seen["high"]) if met and seen else (None, None)
        rows.append(
            {
                "claim": aim.claim,
                "target": f"{words} {unit}".rstrip(),
                "score": aim.score,
                "seen": seen,
                "met": met,
                "shown": all(end is not None and low <= end <= high for end in ends),
                "cases": [] if seen is None or met else seen["wrong"],
            }
        )
    return rows
