"""What a fit of a candidate comes to: a model with effects added, and how well it predicts."""

from __future__ import annotations

from dataclasses import dataclass

from hybrid_id.diagnosis.evidence import Evidence
from hybrid_id.identification.result import FitResult
from hybrid_id.systems.chain import System

Name = tuple[str, str]
"""An effect's name and where it acts."""


@dataclass(frozen=True, eq=False)
class Explanation:
    """A model with some effects added, fitted to the train records.

    Attributes:
        effects: what has been added to today's model, in the order of their names.
        result: the fit.
        evidence: its errors on records left out.
        finished: whether it has been fitted to the end.
    """

    effects: tuple[Name, ...]
    result: FitResult
    evidence: Evidence
    finished: bool = True

    @property
    def system(self) -> System:
        """The fitted model."""
        return self.result.system


def new_effect(richer: Explanation, simpler: Explanation) -> Name:
    """The effect that a model has beyond another one."""
    return next(name for name in richer.effects if name not in simpler.effects)
