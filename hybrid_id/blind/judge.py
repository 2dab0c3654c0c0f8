"""One diagnosis held against its answer sheet: what it has right, in plain figures."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, permutations
from typing import Any

Sheet = Mapping[str, Any]
Said = Mapping[str, Any]
"""The content of a ``diagnosis.json``."""
SOUND = ("none", "parameters")
"""Families whose structure is right; on sheets of earlier generators, ``none`` has wrong values, too."""
LINK = ("link_friction", "load")
"""Places on the link's side of a gear."""
RIGHT, WRONG = 1.05, 1.2
"""Error of today's values over that of the re-fit up to which they are right, and from which they are wrong."""


@dataclass(frozen=True)
class Judged:
    """How one case went; None where a question does not arise.

    Attributes:
        case: its name.
        family, level, system, engine: of the case.
        effect: what was at work, by name; several joined by ``+``.
        records: train records that the diagnosis had.
        broken: why there is no diagnosis, empty where there is one.
        seconds: time that the diagnosis took.
        said: what it stands by, in one word: an effect's name (that of the answer where it is accepted), ``unknown``,
            ``none`` or ``broken``.
        top_1, top_3: whether an accepted name is ranked first, among the first three (single effects).
        place: whether the first one's place is accepted (single effects).
        top_1_at_place: both together.
        pair: hits, named and true effects of a pair.
        whole: whether exactly what was at work is named: all effects and no other, nothing where nothing was, and
            "unknown" with no name beside it where it is outside the catalogue.
        false_alarm: whether something is named in a case where the structure is right.
        values: whether it is told there that nothing is wrong, or the parameters alone.
        outside: whether something outside the catalogue is detected where it acts.
        outside_at: whether the joint, and the side of its gear, at which it is said to act are right; None where
            neither is told.
        false_unknown: whether it is claimed where nothing like it acts.
        confidence: probability of the effect that is ranked first, and whether that one was at work.
        shrink_error: claimed share of the gap that closes, less the true one [points].
        covered: whether the interval of the share holds the true one.
        closed: share of the closable gap that is closed.
    """

    case: str
    family: str
    level: str
    system: str
    engine: str
    effect: str
    records: int
    broken: str
    seconds: float
    said: str
    top_1: bool | None = None
    top_3: bool | None = None
    place: bool | None = None
    top_1_at_place: bool | None = None
    pair: tuple[int, int, int] | None = None
    whole: bool = False
    false_alarm: bool | None = None
    values: bool | None = None
    outside: bool | None = None
    outside_at: bool | None = None
    false_unknown: bool | None = None
    confidence: tuple[float, bool] | None = None
    shrink_error: float | None = None
    covered: bool | None = None
    closed: float | None = None

    @property
    def f1(self) -> float | None:
        """Harmonic mean of precision and recall of a pair's effects."""
        return None if self.pair is None else 2 * self.pair[0] / max(self.pair[1] + self.pair[2], 1)


def judge(case: str, sheet: Sheet, said: Said | None) -> Judged:
    """Hold a diagnosis against its answers; a broken one, or None, has nothing right.

    Args:
        case: its name.
        sheet: its answers.
        said: its diagnosis, with what the run tells of itself in ``run``.
    """
    run = (said or {}).get("run", {})
    broken = "not run" if said is None else str(run.get("message") or "")
    if broken or said is None:
        said = {}
    family, truth = str(sheet["family"]), sheet["effects"]
    ranked: Sequence[Said] = said.get("effects", [])
    chosen = [e for e in ranked if e["selected"]]
    unknown = bool(said.get("unknown", False))
    hits = _hits(chosen, truth) if family in ("single", "pair") else 0
    first = ranked[0] if ranked else None
    known, single = family != "unknown", family == "single"
    named = [_named(e, truth[0]) for e in ranked[:3]] if single else []
    placed = bool(single and first and first["where"] in truth[0]["accept_where"])
    error, covered = _shrink(said, sheet)
    return Judged(
        case=case,
        family=family,
        level=str(sheet["level"]),
        system=str(run.get("system") or sheet.get("made_by", {}).get("system", "")),
        engine=str(sheet.get("made_by", {}).get("engine", "")),
        effect="+".join(t["name"] for t in truth) or "none",
        records=int(run.get("train_records", 0)),
        broken=broken,
        seconds=float(run.get("seconds", math.nan)),
        said="broken" if broken else _in_a_word(family, truth, chosen, unknown),
        top_1=any(named[:1]) if single else None,
        top_3=any(named) if single else None,
        place=placed if single else None,
        top_1_at_place=bool(first and _right(first, truth[0])) if single else None,
        pair=(hits, len(chosen), len(truth)) if family == "pair" else None,
        whole=not broken and unknown is not known and len(chosen) == hits == (len(truth) if known else 0),
        false_alarm=(bool(chosen) or unknown) if family in SOUND and not broken else None,
        values=_values(said, sheet) if family in SOUND and not broken else None,
        outside=unknown if not known else None,
        outside_at=_acts_there(said.get("unknown_at") or {}, truth[0]) if unknown and not known else None,
        false_unknown=unknown if known and not broken else None,
        confidence=None if first is None else (float(first["probability"]), bool(_hits([first], truth))),
        shrink_error=error,
        covered=covered,
        closed=None if broken else _closed(said, sheet),
    )  # fmt: skip


def _named(effect: Said, truth: Sheet) -> bool:
    return effect["name"] in truth["accept"]


def _right(effect: Said, truth: Sheet) -> bool:
    """Whether an effect is accepted at its place; sheets that do not say which name goes where accept all pairs."""
    if "right" in truth:
        return f"{effect['name']}@{effect['where']}" in truth["right"]
    return _named(effect, truth) and effect["where"] in truth["accept_where"]


def _hits(chosen: Sequence[Said], truth: Sequence[Sheet]) -> int:
    """How many of the true effects are among the chosen ones, each of which serves once."""
    if len(truth) > len(chosen):
        return max((_hits(chosen, some) for some in combinations(truth, len(chosen))), default=0)
    orders = permutations(chosen, len(truth))
    return max(sum(map(_right, order, truth)) for order in orders)


def _in_a_word(family: str, truth: Sequence[Sheet], chosen: Sequence[Said], unknown: bool) -> str:
    if unknown:
        return "unknown"
    if not chosen:
        return "none"
    if family == "single" and _named(chosen[0], truth[0]):
        return str(truth[0]["name"])
    return str(chosen[0]["name"])


def _acts_there(told: Said, truth: Sheet) -> bool | None:
    """Whether a joint, and a side where one is told, hold what acts outside the catalogue."""
    if told.get("joint") is None:
        return None
    places = [where.split("/") for where in truth["accept_where"]]
    return any(
        joint == told["joint"] and told.get("place") in (None, "load" if place in LINK else "motor")
        for joint, place in places
    )


def _values(said: Said, sheet: Sheet) -> bool | None:
    """Whether the verdict has it right that today's values are right, or wrong; None of a method without a re-fit."""
    ratio = sheet["oracle"]["nominal"] / sheet["oracle"]["refit"]
    if RIGHT < ratio < WRONG or (said.get("gap") or {}).get("refit") is None:
        return None
    return said["verdict"] == ("no_gap" if ratio <= RIGHT else "parameters_only")


def _shrink(said: Said, sheet: Sheet) -> tuple[float | None, bool | None]:
    """Error [points] and coverage of the share of the gap that closes, where a diagnosis adds something.

    Errors before and after are measured on the test records; what the diagnosis has to guess is the noise floor, which
    the answers know.
    """
    gap = said.get("gap") or {}
    before, after, claimed = gap.get("refit"), gap.get("with_effect"), gap.get("shrink")
    closes = any(e["selected"] for e in said.get("effects", [])) and sheet["family"] in ("single", "pair")
    if said.get("opened"):  # its errors are those of other test records than the answers'
        return None, None
    if not closes or before is None or after is None or claimed is None:
        return None, None
    closable = before - sheet["oracle"]["noise_floor"]
    if closable <= 0:
        return None, None
    true = (before - after) / closable
    interval = gap.get("shrink_interval")
    low, high = interval or (None, None)  # numbers that are none are kept as nothing
    covered = None if low is None or high is None else bool(low <= true <= high)
    return 100 * (claimed - true), covered


def _closed(said: Said, sheet: Sheet) -> float | None:
    """Share of the oracle's closable gap that is closed; nothing where there is no corrected model."""
    oracle = sheet["oracle"]
    closable = oracle["refit"] - oracle["with_effect"]
    if sheet["family"] not in ("single", "pair") or closable <= 0 or said.get("opened"):
        return None
    after = (said.get("gap") or {}).get("with_effect")
    return 0.0 if after is None or not math.isfinite(after) else (oracle["refit"] - after) / closable
