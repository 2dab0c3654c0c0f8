"""A search's chosen model held against the test records."""

from __future__ import annotations

import math
from dataclasses import dataclass

from hybrid_id.diagnosis.attribute import Attribution
from hybrid_id.diagnosis.evidence import coloured
from hybrid_id.diagnosis.explanation import Explanation
from hybrid_id.diagnosis.locate import Location, locate
from hybrid_id.diagnosis.measure import Errors, errors
from hybrid_id.diagnosis.refit import Refit
from hybrid_id.diagnosis.remainder import halted_elsewhere, no_noise, outside
from hybrid_id.diagnosis.shrink import Shrink, shrink


@dataclass(frozen=True, eq=False)
class Judged:
    """A search's chosen model on the test records.

    Attributes:
        search: it.
        after: torques that would explain what it leaves.
        last: its errors.
        gap: how far it shrinks.
        left: share of what it leaves that has a cause.
        halted: whether its free runs halt elsewhere than the machine.
        unknown: whether it leaves something that the catalogue lacks.
    """

    search: Attribution
    after: tuple[Location, ...]
    last: Errors | None
    gap: Shrink | None
    left: float
    halted: bool
    unknown: bool

    @property
    def borne_out(self) -> bool:
        """Whether the test records surely gain by it, or by all that a free run may tell."""
        return self.halted or (self.gap is not None and self.gap.interval[0] > 0.0)


class Judge:
    """Holds models against the test records, beside today's model as it was re-fitted.

    Args:
        refit: holds the records.
        base: today's model, re-fitted.
        whole: errors of that on all test records, where one of these has joined the train records: what is left is held
            against that gap.
        seed: of the resampling.
    """

    def __init__(self, refit: Refit, base: Explanation, whole: Errors | None, seed: int) -> None:
        self.refit, self.base, self.whole, self.seed = refit, base, whole, seed
        self.before = tuple(locate(refit, base))
        self.first = self._errors(base)

    def _errors(self, one: Explanation) -> Errors | None:
        share = self.refit.signal_share
        return errors(self.refit.dataset, one.system, one.result.engine, signal_share=share)

    def __call__(self, search: Attribution) -> Judged:
        """A search's chosen model."""
        chosen, first = search.chosen, self.first
        same = chosen is self.base
        after = self.before if same else tuple(locate(self.refit, chosen))
        last = first if same else self._errors(chosen)
        gap, left = None, coloured(chosen.result.residual)
        if first is not None and last is not None:
            left = no_noise(chosen, after, last)
            floor = max(last.noise, last.nrmse * math.sqrt(1.0 - left))
            gap = shrink(first, last, min(floor, last.nrmse), seed=self.seed)
        halted = halted_elsewhere(self.refit, self.base, chosen, last)
        unknown = outside(chosen, self.whole or first, last, halted)
        return Judged(search, after, last, gap, left, halted, unknown)
