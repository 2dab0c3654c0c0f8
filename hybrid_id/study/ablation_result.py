"""All cells of an ablation side by side: errors, paired changes against physics only, and the answer in words."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hybrid_id.errors import InputError
from hybrid_id.statistics.fit import known_mean
from hybrid_id.statistics.variation import PairedDifference, Variation, paired_difference, variation
from hybrid_id.study.ablation import BLACK_BOX, Arm, CellResult, Rung, Split
from hybrid_id.study.hybrid import DRIFT, OVERLAP, SMALL

SETS = ("validation", "test", "short", "beyond")
"""Records in range that chose, those that no arm has seen, the same over short horizons, and those out of range."""
PHYSICS, HYBRID, OPEN = "physics only", "hybrid", "open"


@dataclass(frozen=True, eq=False)
class Scores:
    """One arm over all repeats.

    Attributes:
        arm: which one.
        seeds: repeats, ``(n,)``.
        errors: weighted RMS error of each repeat by set of records, ``(n,)`` each; 1 is the noise floor, inf diverged.
        change: paired change of ``log(error)`` against physics only on the same records, by set of records.
        share, overlap: of the network, mean over the repeats; nan where there is no network beside physics.
        drift: largest drift of a parameter from physics only in standard errors, mean over the repeats.
    """

    arm: Arm
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
        scores: of each arm, physics only first.
        splits: records by repeat.
        parameters: values over the repeats, of physics only and of the best hybrid.
        level: of the intervals.
        worth: least share of the error that is worth a network.
        failed: why cells came to nothing, by name.
    """

    scores: tuple[Scores, ...]
    splits: Mapping[int, Split]
    parameters: Mapping[Arm, Variation]
    level: float = 0.95
    worth: float = 0.02
    failed: Mapping[str, str] = field(default_factory=dict)

    @property
    def physics(self) -> Scores:
        """Physics only, nothing taken out."""
        return self.scores[0]

    @property
    def best(self) -> Scores | None:
        """The whole physics with the network whose validation error falls most; one that diverges comes last."""
        hybrids = [s for s in self.scores if s.arm.hybrid and not s.arm.without]
        return min(
            hybrids, key=lambda s: (s.diverged("validation"), s.change["validation"].mean), default=None
        )


def gather(
    results: Sequence[CellResult],
    failed: Mapping[str, str] | None = None,
    *,
    level: float = 0.95,
    worth: float = 0.02,
) -> Ablation:
    """Put the cells side by side; a repeat counts for an arm where both it and physics only were done.

    Args:
        results: of the cells that are done.
        failed: why the others are not, by name.
        level: of the intervals.
        worth: least share of the error that is worth a network.

    Raises:
        InputError: no fit of physics only came to an end.
    """
    failed = failed or {}
    cells = {(r.cell.arm, r.cell.seed): r for r in results}
    splits = {r.cell.seed: r.cell.split for r in results}
    base = {seed: r.best for (arm, seed), r in cells.items() if arm == Arm()}
    if not base:
        reason = next(iter(failed.values()), "none was tried")
        raise InputError(f"no fit of physics only came to an end ({reason}); see 'hybrid-id check'")
    arms = list(dict.fromkeys((Arm(), *(arm for arm, _ in cells))))

    def errors(rungs: Mapping[int, Rung], name: str) -> np.ndarray:
        records = "test" if name == "short" else name
        return np.array(
            [r.error(getattr(splits[s], records), short=name == "short") for s, r in rungs.items()]
        )

    def scores(arm: Arm) -> Scores:
        rungs = {seed: cells[arm, seed].best for seed in splits if (arm, seed) in cells}
        pairs = {seed: rung for seed, rung in rungs.items() if seed in base}
        overlap = float(np.mean([splits[seed].overlap for seed in rungs]))
        with np.errstate(divide="ignore", invalid="ignore"):
            logs = {
                name: [np.log(errors(r, name)) for r in (pairs, {seed: base[seed] for seed in pairs})]
                for name in SETS
            }
        drifts = []
        beside = rungs if arm.hybrid else {}  # the others have no network beside physics
        for seed, rung in beside.items():
            physics, drift = cells[arm, seed].rungs[0], math.nan
            for name, value in rung.values.items():
                error = math.hypot(physics.std_errors[name], rung.std_errors[name])
                if 0.0 < error < math.inf:
                    drift = np.fmax(drift, abs(value - physics.values[name]) / error)
            drifts.append(float(drift))
        return Scores(
            arm, tuple(rungs), {name: errors(rungs, name) for name in SETS},
            {name: paired_difference(*both, overlap=overlap, level=level) for name, both in logs.items()},
            known_mean([r.share for r in beside.values()]), known_mean([r.overlap for r in beside.values()]),
            known_mean(drifts),
        )  # fmt: skip

    ablation = Ablation(tuple(map(scores, arms)), splits, {}, level, worth, failed)
    parameters = {}
    for arm in (Arm(), *([] if ablation.best is None else [ablation.best.arm])):
        sets = [cells[arm, seed].best.values for seed in splits if (arm, seed) in cells]
        parameters[arm] = variation(np.array([list(values.values()) for values in sets]), list(sets[0]))
    return replace(ablation, parameters=parameters)


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
    best, outcome = result.best, answer(result)
    if best is None:
        return ["No network beside the whole physics was trained to its end, so that nothing can be said."]
    physics, network, n = result.physics, best.arm.name, len(best.seeds)
    if lost := best.diverged("test"):
        if outcome == OPEN:
            return [
                f"Open: test runs diverged in {lost} of {n} repeats with the {network}, and in "
                f"{physics.diverged('test')} with physics only."
            ]
        return [f"Physics only: with the {network} the test runs diverged in {lost} of {n} repeats."]

    def percent(records: str) -> str:
        pairs, (mid, low, high) = best.change[records].n_pairs, best.percent(records)
        if pairs == 0:
            return "of no finite ratio in any repeat"
        if pairs == 1:
            return f"{signed(mid)} % (one repeat, no interval)"
        interval = f"{100 * result.level:g} % interval {signed(low)} to {signed(high)} %"
        return f"{signed(mid)} % ({interval}), over {pairs} repeats"

    words = f"{network} against physics only: test error {percent('test')}"
    said = [
        {
            HYBRID: f"Hybrid: {words}.",
            PHYSICS: f"Physics only: {words}; a network is not worth its freedom here.",
            OPEN: f"Open: {words}; these records do not show whether a network helps. Keep physics only until more "
            "records or repeats say otherwise.",
        }[outcome]
    ]
    beyond, never = best.change["beyond"], "Do not use it beyond the records that it was trained on."
    if (lost := best.diverged("beyond")) > physics.diverged("beyond"):
        said.append(f"Out of range it harms: its runs diverged in {lost} of {n} repeats. {never}")
    elif math.isfinite(beyond.upper):
        words = f"error {percent('beyond')}"
        if beyond.upper < 0.0:
            said.append(f"Out of range it helps{' as well' * (outcome == HYBRID)}: {words}.")
        elif beyond.lower > 0.0:
            said.append(f"Out of range it harms: {words}. {never}")
        else:
            said.append(f"Out of range these records show no difference: {words}.")
    if best.share > SMALL and best.overlap > OVERLAP:
        said.append(
            f"The network does work that the physics could do: {100 * best.overlap:.0f} % of the accelerations it "
            "causes look like a change of the parameters; do not read these as physical."
        )
    if best.drift > DRIFT:
        said.append(
            f"The parameter that moved most when the network came in moved by {best.drift:.1f} standard errors."
        )
    if count := len(result.failed):
        said.append(f"{count} cell{'s' * (count != 1)} came to nothing and count nowhere.")

    def times(scores: Scores, records: str = "test") -> str:
        change = scores.change[records].mean
        return f"{math.exp(change):.2f} x" if math.isfinite(change) else "no finite multiple of"

    for without in dict.fromkeys(s.arm.without for s in result.scores if s.arm.without):
        of_these = [s for s in result.scores if s.arm.without == without]
        bare = next((s for s in of_these if not s.arm.hybrid), None)
        hybrids = [s for s in of_these if s.arm.hybrid and math.isfinite(s.change["validation"].mean)]
        if bare is not None and hybrids:
            mended = min(hybrids, key=lambda s: s.change["validation"].mean)
            said.append(
                f"Without {' and '.join(without)} physics only has a test error of {times(bare)} that of the whole "
                f"physics; with the {mended.arm.residual} network at {' and '.join(mended.arm.places)} it is "
                f"{times(mended)}."
            )
    if alone := next((s for s in result.scores if s.arm.residual == BLACK_BOX), None):
        words = f"A network alone has a test error of {times(alone)} that of physics only"
        for records, where in (("beyond", "out of range"), ("short", "over short horizons")):
            words += f", {where} {times(alone, records)}" if alone.change[records].n_pairs else ""
        lost = alone.diverged("test")
        said.append(f"{words}; it diverged in {lost} repeats." if lost else f"{words}.")
    return said


def signed(percent: float) -> str:
    """A change in per cent, with a digit after the point where it means something."""
    return f"{percent:+.1f}" if abs(percent) < 100.0 else f"{percent:+.0f}"
