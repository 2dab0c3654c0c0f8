"""One diagnosis held against its ground truth: what it has right, in plain figures."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

Truth = Mapping[str, Any]
Said = Mapping[str, Any]
"""The content of a ``diagnosis.json``."""
SOUND = ("none", "parameters")
"""Families whose structure is right; in those of earlier generators, ``none`` has wrong values, too."""
LINK = ("link_friction", "load")
"""Places on the link's side of a gear."""
RIGHT, WRONG = 1.05, 1.2
"""Error of the nominal values over that of the re-fit up to which they are right, and from which they are wrong."""


@dataclass(frozen=True)
class Judged:
    """How one case went; None where a question does not arise.

    Attributes:
        case: its name.
        family, level, system, engine: of the case.
        realism: clean, messy or arms.
        effect: what was at work, of a messy machine what was dominant; several joined by ``+``.
        records: train records that the diagnosis had.
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
    system: str
    engine: str
    realism: str
    effect: str
    records: int
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
    if broken or said is None:
        said = {}
    family, truth = str(answers["family"]), answers["effects"]
    realism = "arms" if "arm" in answers else "messy" if "messy" in answers else "clean"
    leading = [t for t in truth if t.get("role", "dominant") == "dominant"]
    ranked: Sequence[Said] = said.get("effects", [])
    chosen = [e for e in ranked if e["selected"]]
    unknown = bool(said.get("unknown", False))
    known, messy, of_arm = family != "unknown", realism != "clean", realism == "arms"
    asked = family == "single" or (messy and family == "pair")
    hits = _hits(chosen, truth) if known or messy else 0
    first = ranked[0] if ranked else None
    named = [any(_named(e, t) for t in leading) for e in ranked[:3]] if asked else []
    at_place = bool(asked and first and any(_right(first, t) for t in leading))
    if messy:
        whole = len(chosen) == hits and (at_place if asked else True)
    else:
        whole = len(chosen) == hits == (len(truth) if known else 0)
    error, covered = _shrink(said, answers)
    errors, share_covered = _shares(chosen, truth) if messy else ((), None)
    return Judged(
        case=case,
        family=family,
        level=str(answers["level"]),
        system=str(run.get("system") or answers.get("made_by", {}).get("system", "")),
        engine=str(answers.get("made_by", {}).get("engine", "")),
        realism=realism,
        effect="+".join(t["name"] for t in leading) or "none",
        records=int(run.get("train_records", 0)),
        broken=broken,
        seconds=float(run.get("seconds", math.nan)),
        processor=float(run.get("processor_seconds", math.nan)),
        said="broken" if broken else _in_a_word(leading if asked else [], chosen, unknown),
        top_1=any(named[:1]) if asked else None,
        top_3=any(named) if asked else None,
        leads_train=_leads_train(truth) if asked else None,
        place=bool(first and any(first["where"] in t["accept_where"] for t in leading)) if asked else None,
        top_1_at_place=at_place if asked else None,
        joint=_at_joint(first, leading[0]) if asked and of_arm else None,
        tied=_among_ties(first, leading[0]) if asked and of_arm else None,
        pair=(hits, len(chosen), len(truth)) if family == "pair" and not messy else None,
        whole=not broken and unknown is not known and whole,
        false_alarm=(bool(chosen) or unknown) if family in SOUND and not broken else None,
        values=_values(said, answers) if family in SOUND and not broken else None,
        outside=unknown if not known else None,
        outside_at=_acts_there(said.get("unknown_location") or {}, truth[0]) if unknown and not known else None,
        false_unknown=unknown if known and not broken else None,
        claims=_claims(ranked, truth),
        shrink_error=error,
        covered=covered,
        closed=None if broken or of_arm else _closed(said, answers),
        share_errors=errors,
        share_covered=share_covered,
    )  # fmt: skip


def _leads_train(truth: Sequence[Truth]) -> bool | None:
    """Whether a dominant effect closes more on the train records than any small one; None where answers do not tell."""
    if not all("closes_train" in one for one in truth):
        return None
    roles = {role: [t["closes_train"] for t in truth if t["role"] == role] for role in ("dominant", "small")}
    return max(roles["dominant"]) > max(roles["small"], default=-math.inf)


def _named(effect: Said, truth: Truth) -> bool:
    return effect["name"] in truth["accept"]


def _right(effect: Said, truth: Truth) -> bool:
    """Whether an effect is accepted at its place; answers that do not say which name goes where accept all pairs."""
    if "right" in truth:
        return f"{effect['name']}@{effect['where']}" in truth["right"]
    return _named(effect, truth) and effect["where"] in truth["accept_where"]


def _at_joint(effect: Said | None, truth: Truth) -> bool:
    """Whether an effect is at a joint that the true one acts at."""
    joints = {where.rpartition("/")[0] for where in truth["accept_where"]}
    return effect is not None and effect["where"].rpartition("/")[0] in joints


def _among_ties(effect: Said | None, truth: Truth) -> bool:
    """Whether an accepted name is that of an effect or of one that it is said to be indistinguishable from."""
    if effect is None:
        return False
    return bool({effect["name"], *(one.split("@")[0] for one in effect["tied_with"])} & set(truth["accept"]))


def _hits(chosen: Sequence[Said], truth: Sequence[Truth]) -> int:
    """How many of the true effects are among the chosen ones, each of which serves once."""
    right = _rights(chosen, truth)
    return int(right[linear_sum_assignment(right, maximize=True)].sum())


def _claims(ranked: Sequence[Said], truth: Sequence[Truth]) -> tuple[tuple[float, bool], ...]:
    """Probability of each ranked effect, and whether it was at work.

    Each true effect serves its most probable name, and what is named. Another name that the answers accept for it is
    neither right nor wrong: of two names of one thing one alone can be probable.
    """
    right, chance = _rights(ranked, truth), [float(one["probability"]) for one in ranked]
    rows, columns = linear_sum_assignment(right * np.array(chance)[:, None], maximize=True)
    serves = {row for row, column in zip(rows, columns, strict=True) if right[row, column]}
    return tuple(
        (chance[k], bool(right[k].any()))
        for k, one in enumerate(ranked)
        if k in serves or one["selected"] or not right[k].any()
    )


def _rights(said: Sequence[Said], truth: Sequence[Truth]) -> np.ndarray:
    """Which effect is right for which true one, ``(n, m)``."""
    return np.array([[_right(one, t) for t in truth] for one in said], bool).reshape(len(said), len(truth))


def _in_a_word(leading: Sequence[Truth], chosen: Sequence[Said], unknown: bool) -> str:
    if unknown:
        return "unknown"
    if not chosen:
        return "none"
    return str(next((t["name"] for t in leading if _named(chosen[0], t)), chosen[0]["name"]))


def _shares(chosen: Sequence[Said], truth: Sequence[Truth]) -> tuple[tuple[float, ...], bool | None]:
    """Errors [points] of the claimed shares of the effects rightly named, and whether the first interval holds its own.

    The true share is what an effect closes after those that are named before it, of the gap on the train records, as
    the claimed one is. The answers know it alone, and after all larger ones; of two dominant effects either may lead.
    """
    if not all("share_train" in one for one in truth):
        return (), None  # answers of an earlier generator
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


def _acts_there(claimed: Said, truth: Truth) -> bool | None:
    """Whether a joint, and a side where one is claimed, hold what acts outside the catalogue."""
    if claimed.get("joint") is None:
        return None
    places = [where.split("/") for where in truth["accept_where"]]
    return any(
        joint == claimed["joint"] and claimed.get("side") in (None, "load" if place in LINK else "motor")
        for joint, place in places
    )


def _values(said: Said, answers: Truth) -> bool | None:
    """Whether the verdict is right about the nominal values, right or wrong; None of a method without a re-fit."""
    ratio = answers["oracle"]["nominal"] / answers["oracle"]["refit"]
    if RIGHT < ratio < WRONG or (said.get("gap") or {}).get("refit") is None:
        return None
    return said["verdict"] == ("no_gap" if ratio <= RIGHT else "parameters_only")


def _shrink(said: Said, answers: Truth) -> tuple[float | None, bool | None]:
    """Error [points] and coverage of the share of the gap that closes, where a diagnosis adds something.

    Errors before and after are measured on the test records; what the diagnosis has to guess is the noise floor, which
    the answers know.
    """
    gap = said.get("gap") or {}
    before, after, claimed = gap.get("refit"), gap.get("with_effect"), gap.get("shrink")
    closes = any(e["selected"] for e in said.get("effects", [])) and answers["family"] in ("single", "pair")
    if _of_other_errors(said, answers):
        return None, None
    if not closes or before is None or after is None or claimed is None:
        return None, None
    closable = before - answers["oracle"]["noise_floor"]
    if closable <= 0:
        return None, None
    true = (before - after) / closable
    interval = gap.get("shrink_interval")
    low, high = interval or (None, None)  # numbers that are none are kept as nothing
    covered = None if low is None or high is None else bool(low <= true <= high)
    return 100 * (claimed - true), covered


def _of_other_errors(said: Said, answers: Truth) -> bool:
    """Whether a diagnosis and the answers do not tell of the same errors.

    Those of further test records; and of an arm, whose answers hold joints by themselves over whole records, while all
    joints are simulated by a diagnosis, over as long as they follow.
    """
    return bool(said.get("opened")) or "arm" in answers


def _closed(said: Said, answers: Truth) -> float | None:
    """Share of the oracle's closable gap that is closed; nothing where there is no corrected model."""
    oracle = answers["oracle"]
    closable = oracle["refit"] - oracle["with_effect"]
    if answers["family"] not in ("single", "pair") or closable <= 0 or _of_other_errors(said, answers):
        return None
    after = (said.get("gap") or {}).get("with_effect")
    return 0.0 if after is None or not math.isfinite(after) else (oracle["refit"] - after) / closable
