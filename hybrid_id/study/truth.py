"""A study held against known values, as a simulated drive has them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from hybrid_id.study.result import Study


@dataclass(frozen=True)
class Recovery:
    """A parameter of the selected set beside its truth.

    Attributes:
        name: of the parameter; unit: its unit.
        truth, estimate: in that unit.
        interval: its ends; NaN where none may be claimed.
    """

    name: str
    unit: str
    truth: float
    estimate: float
    interval: tuple[float, float]

    @property
    def relative_error(self) -> float:
        """Estimate less truth, over the truth."""
        return (self.estimate - self.truth) / abs(self.truth)

    @property
    def inside(self) -> bool | None:
        """Whether the interval holds the truth; None where none may be claimed."""
        low, high = self.interval
        return low <= self.truth <= high if math.isfinite(low) else None


def against_truth(study: Study, truth: Mapping[str, float]) -> list[Recovery]:
    """The parameters of the selected set whose truth is known, with the study's intervals."""
    chosen = study.selected
    rows = zip(study.names, chosen.units, chosen.values, study.intervals(), strict=True)
    return [
        Recovery(name, unit, truth[name], float(value), (float(low), float(high)))
        for name, unit, value, (low, high) in rows
        if name in truth
    ]
