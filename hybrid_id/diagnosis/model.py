"""A model with some effects added, fitted to the train records."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.stats import norm, t

from hybrid_id.diagnosis.criteria import CRITERIA
from hybrid_id.diagnosis.validation import Validation, autocorrelation, mean_square
from hybrid_id.identification.result import FitResult
from hybrid_id.systems.chain import System

Name = tuple[str, str]
"""An effect's name and where it acts."""


@dataclass(frozen=True, eq=False)
class FittedModel:
    """The nominal model with some effects added, fitted to the train records.

    Attributes:
        effects: what has been added to the nominal model, in the order of their names.
        result: the fit.
        validation: its errors on records left out where it is judged; those of the fit itself elsewhere.
        judged: whether records left out have judged it: only what has been fitted to the end is.
    """

    effects: tuple[Name, ...]
    result: FitResult
    validation: Validation
    judged: bool = True

    @property
    def system(self) -> System:
        """The fitted system."""
        return self.result.system

    def at(self, system: System) -> FittedModel:
        """The same fit standing at another system, not fitted there."""
        return replace(self, result=replace(self.result, system=system))

    @property
    def error(self) -> float:
        """Mean square of the weighted errors on records left out, in noise variances; of the fit's own until judged."""
        return self.validation.error

    @property
    def trained(self) -> float:
        """Mean square of the weighted errors of the fit itself, in noise variances."""
        return mean_square(self.result.residual)

    def fall(self, before: FittedModel) -> float:
        """Share of another model's mean square by which this one's is lower, on records left out where it has them."""
        if self.judged:
            return self.validation.fall(before.validation)
        return 1.0 - self.trained / max(before.trained, 1e-300)

    @property
    def autocorrelation(self) -> float:
        """Share of what the fit leaves that neighbouring samples have in common (lag one)."""
        return autocorrelation(self.result.residual)

    @property
    def white(self) -> bool:
        """Whether it leaves next to nothing but white noise, so that no other model can do much better."""
        return self.autocorrelation < CRITERIA.white

    def ahead_of(self, other: FittedModel) -> float:
        """By how many standard errors this model predicts better than another.

        Where this one leaves no structure, what is left is noise and every block of time a witness of its own. Where it
        leaves some, the reasons why either errs last as long as a record, and records are the witnesses, so few that
        Student's distribution is taken for a normal one of the same probability.
        """
        if self.no_structure:
            return self.validation.z(other.validation)
        surplus, count = self.validation.over_records(other.validation)
        return float(np.sign(surplus) * norm.isf(t.sf(abs(surplus), count - 1)))

    @property
    def no_structure(self) -> bool:
        """Whether what it leaves is too close to white noise for anything to be missing."""
        return self.autocorrelation <= CRITERIA.coloured


@dataclass(frozen=True)
class Unfitted:
    """A model that could not be fitted.

    Attributes:
        effects: what has been added to the nominal model.
        reason: why not, in a sentence.
    """

    effects: tuple[Name, ...]
    reason: str


@dataclass(eq=False)
class Tally:
    """How many fits a search has tried, and which of them failed.

    Attributes:
        tried: fits.
        failed: what could not be fitted -> how often.
    """

    tried: int = 0
    failed: Counter[Unfitted] = field(default_factory=Counter)


def added_effect(richer: FittedModel, simpler: FittedModel) -> Name:
    """The effect that a model has beyond another one."""
    return next(name for name in richer.effects if name not in simpler.effects)
