"""Physics only or hybrid? The answer of an ablation, in words, and what goes with it."""

from __future__ import annotations

import math

from hybrid_id.study.ablation_plan import BLACK_BOX
from hybrid_id.study.ablation_result import Ablation, Scores
from hybrid_id.study.hybrid import DRIFT, OVERLAP, SMALL

PHYSICS, HYBRID, OPEN = "physics only", "hybrid", "open"


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
            f"Open: {words}; these records cannot tell whether a network helps. "
            "Keep physics only until more records or repeats say otherwise."
        ]
    return [*lines, *_beyond(result, best), *_caution(result, best), *_missing(result), *_alone(result)]


def _beyond(result: Ablation, best: Scores) -> list[str]:
    """Whether it holds out of range."""
    change = best.change["beyond"]
    if not math.isfinite(change.upper):
        return []
    words = f"error {_percent(best, 'beyond', result)}"
    if change.upper < 0.0:
        return [f"Out of range it helps{' as well' * (answer(result) == HYBRID)}: {words}."]
    if change.lower > 0.0:
        return [f"Out of range it harms: {words}. Do not use it beyond the records that it was trained on."]
    return [f"Out of range no difference can be told: {words}."]


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
