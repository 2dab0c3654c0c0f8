"""A model with some effects added, fitted to the train records."""

from __future__ import annotations

from dataclasses import dataclass

from hybrid_id.diagnosis.criteria import CRITERIA
from hybrid_id.diagnosis.validation import Validation, coloured
from hybrid_id.identification.result import FitResult
from hybrid_id.systems.chain import System

Name = tuple[str, str]
"""An effect's name and where it acts."""


@dataclass(frozen=True, eq=False)
class Model:
    """The nominal model with some effects added, fitted to the train records.

    Attributes:
        effects: what has been added to the nominal model, in the order of their names.
        result: the fit.
        validation: its errors on records left out; those of the fit itself for what has only been fitted coarsely.
        finished: whether it has been fitted to the end.
    """

    effects: tuple[Name, ...]
    result: FitResult
    validation: Validation
    finished: bool = True

    @property
    def system(self) -> System:
        """The fitted system."""
        return self.result.system

    @property
    def error(self) -> float:
        """Mean square of the weighted errors on records left out."""
        return self.validation.error

    @property
    def coloured(self) -> float:
        """Share of what the fit leaves that neighbouring samples have in common."""
        return coloured(self.result.residual)

    @property
    def white(self) -> bool:
        """Whether it leaves next to nothing but white noise, so that no other model can do much better."""
        return self.coloured < CRITERIA.white


def added_effect(richer: Model, simpler: Model) -> Name:
    """The effect that a model has beyond another one."""
    return next(name for name in richer.effects if name not in simpler.effects)
