"""A study held against known values, as a simulated drive has them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from scipy.special import ndtri

from hybrid_id.study.result import Study


@dataclass(frozen=True)
class Recovery:
    """A parameter of the selected set beside its truth.

    Attributes:
        name: of the parameter; unit: its unit.
        truth, estimate: in that unit.
        half_width: half of the interval; inf where none may be claimed.
    """

    name: str
    unit: str
    truth: float
    estimate: float
    half_width: float

    @property
    def relative_error(self) -> float:
        """Estimate less truth, over the truth."""
        return (self.estimate - self.truth) / abs(self.truth)

    @property
    def inside(self) -> bool | None:
        """Whether the interval holds the truth; None where none may be claimed."""
        return abs(self.estimate - self.truth) <= self.half_width if math.isfinite(self.half_width) else None


def against_truth(study: Study, truth: Mapping[str, float], level: float = 0.95) -> list[Recovery]:
    """The parameters of the selected set whose truth is known, with intervals of a level."""
    chosen, errors = study.selected, study.standard_errors(study.selection.index)
    reach = float(ndtri(0.5 + level / 2))
    rows = zip(study.names, chosen.units, chosen.values, reach * errors, strict=True)
    return [
        Recovery(name, unit, truth[name], float(value), float(half))
        for name, unit, value, half in rows
        if name in truth
    ]
