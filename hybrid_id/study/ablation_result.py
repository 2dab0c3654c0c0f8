"""All cells of an ablation side by side: errors, paired changes against physics only, and the answer in words."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hybrid_id.statistics.fit import known_mean
from hybrid_id.statistics.variation import PairedDifference, Variation, paired_difference, variation
from hybrid_id.study.ablation import DONE, CellResult, Rung
from hybrid_id.study.ablation_plan import BLACK_BOX, Arm, Split
from hybrid_id.study.hybrid import DRIFT, OVERLAP, SMALL

SETS = ("validation", "test", "short", "beyond")
"""Records in range that chose, those that no arm has seen, the same over short horizons, and those out of range."""
PHYSICS, HYBRID, OPEN = "physics only", "hybrid", "open"


@dataclass(frozen=True, eq=False)
class Scores:
    """One arm at one price over all repeats.

    Attributes:
        arm: which one.
        price: of the network's output; None for the price that the validation records choose in each repeat.
        seeds: repeats, ``(n,)``.
        errors: weighted RMS error of each repeat by set of records, ``(n,)`` each; 1 is the noise floor, inf diverged.
        change: paired change of ``log(error)`` against physics only on the same records, by set of records.
        share, overlap: of the network, mean over the repeats; nan where there is no network beside physics.
        drift: largest drift of a parameter from physics only in standard errors, mean over the repeats.
    """

    arm: Arm
    price: float | None
    seeds: tuple[int, ...]
    errors: Mapping[str, np.ndarray]
    change: Mapping[str, PairedDifference]
    share: float
    overlap: float
    drift: float

    def error(self, records: str) -> float:
        """Geometric mean of the error over the repeats that did not diverge; nan where all did."""
        finite = self.errors[records][np.isfinite(self.errors[records])]
        return float(np.exp(np.log(finite).mean())) if finite.size else math.nan

    def diverged(self, records: str) -> int:
        """Repeats in which a free run on these records left the world."""
        return int(np.isinf(self.errors[records]).sum())

    def percent(self, records: str) -> tuple[float, float, float]:
        """Change of the error against physics only and its interval [%]."""
        change = self.change[records]
        low, mid, high = (100.0 * math.expm1(v) for v in (change.lower, change.mean, change.upper))
        return mid, low, high


@dataclass(frozen=True, eq=False)
class Ablation:
    """Result of an ablation.

    Attributes:
        scores: of each arm at its chosen price, physics only first.
        ladder: of each arm with a network beside physics at each price.
        splits: records by repeat.
        failed: cells that came to nothing.
        parameters: values over the repeats, of physics only and of the best hybrid.
        level: of the intervals.
        worth: least share of the error that is worth a network.
    """

    scores: tuple[Scores, ...]
    ladder: tuple[Scores, ...]
    splits: Mapping[int, Split]
    failed: tuple[CellResult, ...]
    parameters: Mapping[Arm, Variation]
    level: float
    worth: float

    @property
    def physics(self) -> Scores:
        """Physics only, nothing taken out."""
        return self.scores[0]

    @property
    def best(self) -> Scores | None:
        """The whole physics with the network that the validation records like best; None without one."""
        return _best(self.scores)


def gather(results: Sequence[CellResult], *, level: float = 0.95, worth: float = 0.02) -> Ablation:
    """Put the cells side by side; a repeat counts for an arm where both it and physics only were done."""
    done = [r for r in results if r.status == DONE]
    arms = list(dict.fromkeys(r.cell.arm for r in results))
    cells = {(r.cell.arm, r.cell.seed): r for r in done}
    splits = {r.cell.seed: r.split for r in done if r.split is not None}
    base = {r.cell.seed: r.best for r in done if r.cell.arm == Arm()}

    def scores(arm: Arm, price: float | None) -> Scores | None:
        found = {s: _at(cells[arm, s], price) for s in splits if (arm, s) in cells}
        rungs = {s: rung for s, rung in found.items() if rung is not None}
        if not rungs:
            return None
        errors = {name: _errors(rungs, splits, name) for name in SETS}
        reference = {name: _errors({s: base[s] for s in rungs if s in base}, splits, name) for name in SETS}
        paired = [k for k, s in enumerate(rungs) if s in base]
        overlap = float(np.mean([splits[s].overlap for s in rungs]))
        with np.errstate(divide="ignore", invalid="ignore"):
            change = {
                n: paired_difference(
                    np.log(errors[n][paired]), np.log(reference[n]), overlap=overlap, level=level
                )
                for n in SETS
            }
        beside = rungs if arm.hybrid else {}  # the others have no network beside physics
        share, alike = ([getattr(r, what) for r in beside.values()] for what in ("share", "overlap"))
        drift = [_drift(cells[arm, s].rungs[0], r) for s, r in beside.items()]
        return Scores(arm, price, tuple(rungs), errors, change, _mean(share), _mean(alike), _mean(drift))

    chosen = [s for arm in arms if (s := scores(arm, None)) is not None]
    prices = {arm: _prices(cells, arm) for arm in arms if arm.hybrid}
    ladder = [s for arm, ladder in prices.items() for p in ladder if (s := scores(arm, p)) is not None]
    best, parameters = _best(chosen), {}
    for arm in [Arm(), *([] if best is None else [best.arm])]:
        sets = [cells[arm, s].best.values for s in splits if (arm, s) in cells]
        if sets:
            values = np.array([list(v.values()) for v in sets])
            parameters[arm] = variation(values, list(sets[0]))
    failed = tuple(r for r in results if r.status != DONE)
    return Ablation(tuple(chosen), tuple(ladder), splits, failed, parameters, level, worth)


def _best(scores: Sequence[Scores]) -> Scores | None:
    """The whole physics with the network whose validation error falls most; one that diverges comes last."""
    hybrids = [s for s in scores if s.arm.hybrid and not s.arm.without]
    return min(hybrids, key=lambda s: (s.diverged("validation"), s.change["validation"].mean), default=None)


def _at(result: CellResult, price: float | None) -> Rung | None:
    if price is None:
        return result.best
    return next((rung for rung in result.rungs if rung.price == price), None)


def _prices(cells: Mapping[tuple[Arm, int], CellResult], arm: Arm) -> list[float]:
    found = {rung.price for (a, _), r in cells.items() if a == arm for rung in r.rungs}
    return sorted(found - {math.inf}, reverse=True)


def _errors(rungs: Mapping[int, Rung], splits: Mapping[int, Split], records: str) -> np.ndarray:
    """Error of each repeat on a set of records, ``(n,)``; nan where it has none."""
    found = []
    for seed, rung in rungs.items():
        names = getattr(splits[seed], "test" if records == "short" else records)
        of = rung.short if records == "short" else rung.errors
        square = [of[name] ** 2 for name in names if name in of]
        found.append(math.sqrt(sum(square) / len(square)) if square else math.nan)
    return np.array(found)


def _drift(physics: Rung, hybrid: Rung) -> float:
    """Largest change of a parameter when the network came in, in its standard errors; NaN where none is known."""
    found = []
    for name, value in hybrid.values.items():
        error = math.hypot(physics.std_errors[name], hybrid.std_errors[name])
        if 0.0 < error < math.inf:
            found.append(abs(value - physics.values[name]) / error)
    return max(found, default=math.nan)


def _mean(values: Sequence[float]) -> float:
    return known_mean(values)


def answer(result: Ablation) -> str:
    """Hybrid, physics only, or open.

    The validation records choose the network; test records, which have chosen nothing, judge it. It has to lower the
    error for certain (the whole interval below zero) and by a share that is worth it. Physics only stays where the
    interval leaves no such gain, or where the network let a single test run diverge; in between these repeats cannot
    tell.
    """
    best = result.best
    if best is not None and best.diverged("test"):
        return PHYSICS if not result.physics.diverged("test") else OPEN
    if best is None or not math.isfinite(best.change["test"].upper):
        return OPEN
    change, worth = best.change["test"], math.log1p(-result.worth)
    if change.upper < 0.0 and change.mean <= worth:
        return HYBRID
    return PHYSICS if change.lower > worth else OPEN


def verdict(result: Ablation) -> list[str]:
    """The answer in sentences, the outcome first."""
    best, found = result.best, answer(result)
    if best is None:
        return ["No network beside the whole physics was trained to its end, so that nothing can be said."]
    if best.diverged("test") and found == OPEN:
        return [
            f"Open: test runs diverged in {best.diverged('test')} of {len(best.seeds)} repeats with the "
            f"{best.arm.name}, and in {result.physics.diverged('test')} with physics only."
        ]
    if best.diverged("test"):
        return [
            f"Physics only: with the {best.arm.name} the test runs diverged in {best.diverged('test')} of "
            f"{len(best.seeds)} repeats."
        ]
    words = f"{best.arm.name} against physics only: test error {_percent(best, 'test', result)}"
    if found == HYBRID:
        lines = [f"Hybrid: {words}."]
    elif found == PHYSICS:
        lines = [f"Physics only: {words}; a network is not worth its freedom here."]
    else:
        lines = [
            f"Open: {words}; these records do not show whether a network helps. "
            "Keep physics only until more records or repeats say otherwise."
        ]
    return [*lines, *_beyond(result, best), *_caution(result, best), *_missing(result), *_alone(result)]


def _beyond(result: Ablation, best: Scores) -> list[str]:
    """Whether it holds out of range."""
    change = best.change["beyond"]
    if (more := best.diverged("beyond")) > result.physics.diverged("beyond"):
        return [
            f"Out of range it harms: its runs diverged in {more} of {len(best.seeds)} repeats. Do not use it beyond "
            "the records that it was trained on."
        ]
    if not math.isfinite(change.upper):
        return []
    words = f"error {_percent(best, 'beyond', result)}"
    if change.upper < 0.0:
        return [f"Out of range it helps{' as well' * (answer(result) == HYBRID)}: {words}."]
    if change.lower > 0.0:
        return [f"Out of range it harms: {words}. Do not use it beyond the records that it was trained on."]
    return [f"Out of range these records show no difference: {words}."]


def _caution(result: Ablation, best: Scores) -> list[str]:
    """What the network does to the meaning of the parameters."""
    found = []
    if best.share > SMALL and best.overlap > OVERLAP:
        found.append(
            f"The network does work that the physics could do: {100 * best.overlap:.0f} % of the accelerations it "
            "causes look like a change of the parameters; do not read these as physical."
        )
    if best.drift > DRIFT:
        found.append(
            f"The parameter that moved most when the network came in moved by {best.drift:.1f} standard errors."
        )
    if result.failed:
        found.append(
            f"{len(result.failed)} cell{'s' * (len(result.failed) != 1)} came to nothing and count nowhere."
        )
    return found


def _missing(result: Ablation) -> list[str]:
    """What a network wins back where physics was taken out on purpose."""
    found = []
    for without in dict.fromkeys(s.arm.without for s in result.scores if s.arm.without):
        arms = [s for s in result.scores if s.arm.without == without]
        alone = next((s for s in arms if not s.arm.hybrid), None)
        hybrids = [s for s in arms if s.arm.hybrid and math.isfinite(s.change["validation"].mean)]
        if alone is None or not hybrids:
            continue
        best = min(hybrids, key=lambda s: s.change["validation"].mean)
        found.append(
            f"Without {' and '.join(without)} physics only has a test error of {_times(alone)} that of the whole "
            f"physics; with the {best.arm.residual} network at {' and '.join(best.arm.places)} it is {_times(best)}."
        )
    return found


def _alone(result: Ablation) -> list[str]:
    """The network without physics."""
    alone = next((s for s in result.scores if s.arm.residual == BLACK_BOX), None)
    if alone is None:
        return []
    words = f"A network alone has a test error of {_times(alone)} that of physics only"
    if alone.change["beyond"].n_pairs:
        words += f", out of range {_times(alone, 'beyond')}"
    if alone.change["short"].n_pairs:
        words += f", over short horizons {_times(alone, 'short')}"
    diverged = alone.diverged("test")
    return [f"{words}; it diverged in {diverged} repeats." if diverged else f"{words}."]


def _times(scores: Scores, records: str = "test") -> str:
    change = scores.change[records].mean
    return f"{math.exp(change):.2f} x" if math.isfinite(change) else "no finite multiple of"


def _percent(scores: Scores, records: str, result: Ablation) -> str:
    n, (mid, low, high) = scores.change[records].n_pairs, scores.percent(records)
    if n == 0:
        return "of no finite ratio in any repeat"
    if n == 1:
        return f"{signed(mid)} % (one repeat, no interval)"
    return f"{signed(mid)} % ({100 * result.level:g} % interval {signed(low)} to {signed(high)} %), over {n} repeats"


def signed(percent: float) -> str:
    """A change in per cent, with a digit after the point where it means something."""
    return f"{percent:+.1f}" if abs(percent) < 100.0 else f"{percent:+.0f}"
