"""What a study ends with: parameter sets, how reliable they are, which one to use, and the truth where it is known."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from hybrid_id.identification.horizons import WHOLE, Horizon
from hybrid_id.identification.result import FitResult
from hybrid_id.records.dataset import Channel
from hybrid_id.statistics.cross_validation import CrossValidation, Selection
from hybrid_id.statistics.fit import known_mean
from hybrid_id.statistics.identifiability import Identifiability
from hybrid_id.statistics.profile import Profile
from hybrid_id.statistics.reliability import Reliability
from hybrid_id.statistics.residuals import Whiteness, whiteness
from hybrid_id.statistics.uncertainty import Covariance, normal_interval
from hybrid_id.statistics.variation import Variation, variation
from hybrid_id.study.replay import BesideNominal, OutputError
from hybrid_id.systems.chain import System

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False)
class Combinations:
    """What the records do identify where parameters alone are not: functions of the parameters, c of them.

    Attributes:
        names: each as people write it, ``J/P_m1``.
        values: of every set, ``(n_sets, c)``.
        std_error: of every set, the larger of plain and robust, ``(n_sets, c)``.
        variation: over the experiments; None with fewer than two sets.
    """

    names: tuple[str, ...]
    values: np.ndarray
    std_error: np.ndarray
    variation: Variation | None


@dataclass(frozen=True, eq=False)
class Study:
    """Result of :func:`identify`.

    Attributes:
        system: the model that the study started from.
        sets: one fit a record, or one over all.
        pooled: whether it is one over all.
        variation: std/mean of each parameter over the experiments; None with fewer than two sets.
        covariances: plain covariance of each set.
        robust: of each set the larger of the covariance that allows for autocorrelation and the block jackknife, see
            :func:`hybrid_id.statistics.uncertainty.autocorrelation_robust`.
        identifiability: what the records of the selected set tell.
        reliability: grade of each parameter, A to D, from standard errors of the mean of the sets, where there are
            several; intervals are of one set.
        cross_validation: fit % of every set on every record, measured signals and speeds.
        selection: the set to use.
        test_nrmse: normalised RMSE of the selected set on each test record, by name; empty without test records.
        engine_error: largest change of an estimate in standard errors when the step is halved.
        beside_nominal: errors of the selected set and of the nominal values on the same records.
        horizon: how long the free runs are that were fitted and compared with the records.
        profiles: profile likelihoods of the selected set's parameters, by name, as far as they were asked for.
        level: confidence of all intervals.
        test_errors: error of the selected set in each output on the test records, by name; empty without them.
        outputs: channels of the records, which know the units that were logged.
        input_error: what noise of measured inputs may have moved each parameter of each set by, ``(n_sets,
            n_parameters)``; None where that was not asked for.
    """

    system: System
    sets: tuple[FitResult, ...]
    pooled: bool
    variation: Variation | None
    covariances: tuple[Covariance, ...]
    robust: tuple[Covariance, ...]
    identifiability: Identifiability
    reliability: tuple[Reliability, ...]
    cross_validation: CrossValidation
    selection: Selection
    test_nrmse: dict[str, float]
    engine_error: float
    beside_nominal: BesideNominal
    horizon: Horizon = WHOLE
    profiles: Mapping[str, Profile] = field(default_factory=dict)
    level: float = 0.95
    test_errors: Mapping[str, OutputError] = field(default_factory=dict)
    outputs: tuple[Channel, ...] = ()
    input_error: np.ndarray | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the estimated parameters."""
        return self.sets[0].names

    @property
    def values(self) -> np.ndarray:
        """Estimates, ``(n_sets, n_parameters)``."""
        return np.array([result.values for result in self.sets])

    @property
    def selected(self) -> FitResult:
        """The selected set."""
        return self.sets[self.selection.index]

    @property
    def selected_model(self) -> System:
        """The system with the selected set's values."""
        return self.selected.system

    def standard_errors(self, index: int) -> np.ndarray:
        """Standard errors of a set: the larger of plain and robust, with that of inputs; inf where none may be claimed.

        None may for a parameter that the records do not tell alone or that lies at a bound, nor for any of a set that
        was stopped on its way.
        """
        if self.sets[index].left_early:
            return np.full(len(self.names), np.inf)
        free = [name not in self.sets[index].at_bound for name in self.names]
        return np.where(self.identifiability.claimable & np.array(free), self.errors_of_fit(index), np.inf)

    def errors_of_fit(self, index: int) -> np.ndarray:
        """The same of every parameter of a set, whether it may be claimed or not, ``(n_parameters,)``."""
        larger = np.maximum(self.covariances[index].std_error, self.robust[index].std_error)
        return larger if self.input_error is None else np.hypot(larger, self.input_error[index])

    def intervals(self, index: int | None = None) -> np.ndarray:
        """Intervals of a set (default: the selected one), within the bounds of the parameters, ``(n_parameters, 2)``.

        NaN where none may be claimed. A parameter of the selected set whose profile likelihood was computed has that
        interval, whose ends may be infinite.
        """
        index = self.selection.index if index is None else index
        result = self.sets[index]
        specs = [result.system.parameter(name).spec for name in self.names]
        bounds = np.array([(spec.lower, spec.upper) for spec in specs])
        ends = normal_interval(result.values, self.standard_errors(index), self.level)
        ends = np.clip(ends, bounds[:, :1], bounds[:, 1:])
        for name, profile in self.profiles.items() if index == self.selection.index else ():
            ends[self.names.index(name)] = profile.lower, profile.upper
        return ends

    @property
    def test_error(self) -> float:
        """Mean of the normalised RMSE over the test records that move; NaN where none does."""
        return known_mean(self.test_nrmse.values())

    @property
    def whiteness(self) -> Whiteness:
        """Autocorrelation of what the selected set leaves of the records that it was fitted to."""
        return whiteness(self.selected.residual)

    @property
    def combinations(self) -> Combinations:
        """The identifiable combinations of the selected set's records, for every set; c = 0 where there is none."""
        found = self.identifiability.combinations
        shape = (len(self.sets), len(found))
        with np.errstate(divide="ignore", invalid="ignore"):  # a parameter at zero has no relative error
            errors = np.array(
                [
                    [max(c.std_error(r.values, cov.matrix) for cov in pair) for c in found]
                    for r, *pair in zip(self.sets, self.covariances, self.robust, strict=True)
                ]
            ).reshape(shape)
        errors = np.where(np.isnan(errors), np.inf, errors)
        errors[[result.left_early for result in self.sets]] = np.inf
        values = np.array([c.evaluate(self.values) for c in found]).reshape(shape[::-1]).T
        values[[result.status == "diverged" for result in self.sets]] = np.nan  # which are no estimates
        names = tuple(c.text for c in found)
        return Combinations(names, values, errors, variation(values, names) if len(self.sets) > 1 else None)

    def table(self) -> pd.DataFrame:
        """Parameters of the selected set, one row each by name, in SI.

        Columns: ``meaning``, ``value``, ``lower`` and ``upper`` end of the interval (NaN where none may be claimed),
        ``unit``, ``mean`` and ``std_over_mean`` of the sets (with several), ``reliability`` and the ``reason`` for it.
        """
        import pandas as pd

        infos = [self.selected_model.parameter(name) for name in self.names]
        lower, upper = self.intervals().T
        columns: dict[str, object] = {
            "meaning": [info.doc for info in infos],
            "value": self.selected.values,
            "lower": lower,
            "upper": upper,
            "unit": [info.unit for info in infos],
        }
        if self.variation is not None:
            columns |= {"mean": self.variation.mean, "std_over_mean": self.variation.percent / 100.0}
        columns["reliability"] = [one.words for one in self.reliability]
        columns["reason"] = [one.reason for one in self.reliability]
        return pd.DataFrame(columns, index=pd.Index(self.names, name="parameter"))

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        shown = self.table().drop(columns="reason")
        return as_html(self._heading, shown, self._remarks)

    @property
    def _heading(self) -> str:
        kind = "pooled" if self.pooled else "selected"
        return f"{kind} set: {self.selected.summary().splitlines()[0]}"

    def summary(self) -> str:
        """The study in a page: parameters with intervals and grades, variation, cross-validation, selection."""
        grades = {t.name: t for t in self.reliability}
        lines = [self._heading]
        width = max(map(len, self.names))
        rows = zip(self.names, self.selected.values, self.intervals(), self.selected.units, strict=True)
        for k, (name, value, (low, high), unit) in enumerate(rows):
            interval = f"{low:.4g} to {high:.4g}" if np.isfinite(low) else "(no interval)"
            spread = "" if self.variation is None else f"  std/mean {self.variation.percent[k]:.2f} %"
            lines.append(
                f"  {name:<{width}}  {value:11.5g}  {interval:<24} {unit:<10}{spread}  {grades[name].words}"
            )
        return "\n".join([*lines, *self._remarks])

    @property
    def _remarks(self) -> list[str]:
        """What a page says below the parameters."""
        lines = [] if self.horizon.kind == "whole" else [f"horizon: {self.horizon}"]
        lines += [self.beside_nominal.words] if self.beside_nominal.worse else []
        lines += self.identifiability.summary().splitlines()
        lines.append(self.selection.summary())
        if self.test_nrmse:
            plural = "s" * (len(self.test_nrmse) > 1)
            lines.append(
                f"normalised RMSE on {len(self.test_nrmse)} test record{plural}: {self.test_error:.4g}"
            )
        lines.append(f"integration error (step halved): {self.engine_error:.2g} standard errors at most")
        return lines


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


def as_html(heading: str, table: pd.DataFrame, remarks: Iterable[str]) -> str:
    """A heading, a table and a line for each remark; all words are escaped."""
    lines = "".join(f"<div>{escape(line)}</div>" for line in remarks)
    cells = table.to_html(escape=True, na_rep="", float_format="{:.5g}".format, border=0)
    return f"<div><b>{escape(heading)}</b>{cells}{lines}</div>"
