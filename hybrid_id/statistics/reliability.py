"""Reliability of each parameter: how far the ways to compute its error agree, and how far single sets do."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

_AGREE = 1.5  # ratio of standard errors that sampling alone explains
_DISAGREE = 3.0  # from here on something is wrong with the model or the excitation
_SMALL = 0.1  # relative standard error up to which a disagreement still leaves a value that one can use
_VAGUE = 0.5  # relative standard error from which a parameter is not known


WORDS = {"A": "good", "B": "good", "C": "doubtful", "D": "not on its own"}
"""What users read of each grade."""


@dataclass(frozen=True)
class Reliability:
    """Grade of one parameter.

    Attributes:
        name: Parameter.
        grade: A: all ways agree. B: the plain covariance is too confident, the others agree. C: the others disagree,
            so take the largest, single sets differ by more than the 30 % rule allows, or a fit has not converged. D: do
            not use the value on its own.
        std_error: The largest of all standard errors, for the grade; inf where it is not identifiable. Intervals take
            `Study.standard_errors`.
        reason: Why, in words.
    """

    name: str
    grade: str
    std_error: float
    reason: str

    @property
    def words(self) -> str:
        """The grade as users read it."""
        return WORDS[self.grade]


def reliability_grades(
    names: Sequence[str],
    estimate: np.ndarray,
    std_errors: Mapping[str, np.ndarray],
    *,
    not_identifiable: Collection[str] = (),
    at_bound: Collection[str] = (),
    held: Collection[str] = (),
    scattered: Mapping[str, float] | None = None,
) -> tuple[Reliability, ...]:
    """Grades A to D from standard errors computed in several ways.

    Args:
        names: Parameters (p).
        estimate: Their values (p,).
        std_errors: Way -> standard errors (p,) of *the same estimate*. "plain" is the one that may be too small
            without harm; the others, say "robust", "bootstrap", "between records" (`variation.error_of_mean`), are
            the ones to agree. Values that are nan are ignored.
        not_identifiable: Names of parameters whose own interval may not be claimed (`identifiability`).
        at_bound: Names of parameters at a bound.
        held: Names of parameters that are fixed or held by a prior.
        scattered: std/mean over the experiments [%] of the parameters that the 30 % rule refuses, by name.
    """
    grades = []
    for k, name in enumerate(names):
        errors = {way: float(values[k]) for way, values in std_errors.items() if not np.isnan(values[k])}
        largest = max(errors.values(), default=np.inf)
        if name in not_identifiable:
            grades.append(Reliability(name, "D", np.inf, "these records do not identify it on its own"))
        elif name in held:
            grades.append(
                Reliability(name, "D", largest, "its prior holds it; the records say next to nothing")
            )
        elif name in at_bound:
            grades.append(Reliability(name, "D", largest, "it lies at a bound; no interval is claimed"))
        else:
            grade, reason = _compare(errors, float(estimate[k]))
            if grade in "AB" and name in (scattered or {}):
                grade, reason = "C", f"single sets differ: std/mean is {(scattered or {})[name]:.0f} %"
            grades.append(Reliability(name, grade, largest, reason))
    return tuple(grades)


def _compare(errors: Mapping[str, float], estimate: float) -> tuple[str, str]:
    """Grade and reason from the standard errors of one parameter."""
    if not errors:
        return "D", "no standard error is known"
    largest_way = max(errors, key=lambda way: errors[way])
    largest = errors[largest_way]
    if not np.isfinite(largest) or largest > _VAGUE * abs(estimate):
        share = 100 * largest / abs(estimate) if estimate else np.inf
        return "D", f"its standard error is {share:.0f} % of its value ({largest_way})"
    others = {way: error for way, error in errors.items() if way != "plain" and error > 0.0}
    if not others:
        return "C", "only the plain covariance is known, and nothing checks it"
    smallest_way = min(others, key=lambda way: others[way])
    ratio = largest / max(others[smallest_way], 1e-300)
    if largest_way != "plain" and ratio > _AGREE:
        grade = "C" if ratio <= _DISAGREE or largest <= _SMALL * abs(estimate) else "D"
        return grade, (
            f"{largest_way} scatter is {ratio:.1f} times what {smallest_way} errors say"
            + (
                ": the model misses something that differs from record to record"
                if "record" in largest_way
                else ""
            )
        )
    plain = errors.get("plain", largest)
    if largest / max(plain, 1e-300) > _AGREE:
        return (
            "B",
            f"residuals are correlated: the plain covariance is {largest / plain:.1f} times too confident",
        )
    if plain / max(others[smallest_way], 1e-300) > _DISAGREE:
        return (
            "C",
            f"{smallest_way} errors are {plain / others[smallest_way]:.1f} times below the plain covariance",
        )
    return "A", "all ways to compute its error agree"
