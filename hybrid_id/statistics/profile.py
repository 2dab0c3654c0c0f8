"""Profile likelihood of one parameter: an interval that need not be symmetric, and shows where it is open."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

MOST_STEPS = 10
"""Steps to each side; they double, so that 10 reach 1000 standard errors."""
CostAt = Callable[[float, np.ndarray], tuple[float, np.ndarray]]


@dataclass(frozen=True, eq=False)
class Profile:
    """Least cost over all other parameters, as a function of one.

    Attributes:
        values, costs: Points that were evaluated, ascending in value.
        lower, upper: Interval; ±inf, or the bound, on a side where the cost never reaches the threshold.
        closed: Whether the threshold was reached below and above.
        threshold: Cost at the ends of the interval.
        message: What was found, in words.
    """

    values: np.ndarray
    costs: np.ndarray
    lower: float
    upper: float
    closed: tuple[bool, bool]
    threshold: float
    message: str


def profile_likelihood(
    cost_at: CostAt,
    estimate: np.ndarray,
    index: int,
    *,
    minimum: float,
    step: float,
    noise_variance: float = 1.0,
    level: float = 0.95,
    bounds: tuple[float, float] = (-np.inf, np.inf),
) -> Profile:
    """Walks from the estimate to both sides until the cost has risen by ``s² χ²_1(level)``.

    Raue et al., "Structural and practical identifiability analysis … by exploiting the profile likelihood",
    Bioinformatics 25, 2009. A side where the cost never rises that far is not identifiable.

    Args:
        cost_at: ``cost_at(value, start)`` -> (least ``Σr²`` over the other parameters with this one held at
            `value`, parameters (p,) there); `start` is the optimum of the neighbouring value.
        estimate: Parameters at the optimum (p,).
        index: Which parameter.
        minimum: ``Σr²`` at the optimum.
        step: First step, about a standard error.
        noise_variance: s² of the weighted residuals; inflate it where they are autocorrelated.
        level: Confidence.
        bounds: Range of the parameter.
    """
    threshold = minimum + noise_variance * float(ndtri(0.5 + level / 2)) ** 2
    points = {float(estimate[index]): minimum}

    def rise(cost: float) -> float:
        # The root of the rise is nearly linear in the value, which suits the false position below.
        return float(np.sqrt(max(cost - minimum, 0.0)) - np.sqrt(threshold - minimum))

    def end(step: float, bound: float) -> tuple[float, bool]:
        """End of the interval on one side, and whether the threshold was reached there."""
        start = np.asarray(estimate, float)
        inner, inner_rise = float(start[index]), rise(minimum)
        for _ in range(MOST_STEPS):
            outer = float(np.clip(inner + step, min(bound, inner), max(bound, inner)))
            cost, parameters = cost_at(outer, start)
            points[outer] = cost
            if not np.isfinite(cost):
                step /= 4  # the simulation broke: closer
                continue
            if cost >= threshold:
                break
            if outer == bound:
                return bound, False
            inner, inner_rise, start, step = outer, rise(cost), parameters, 2 * step
        else:
            return float(np.copysign(np.inf, step)), False
        outer_rise = rise(cost)
        for _ in range(20):
            share = np.clip(inner_rise / (inner_rise - outer_rise), 0.1, 0.9)
            middle = inner + share * (outer - inner)
            cost, parameters = cost_at(middle, start)
            points[middle] = cost
            if abs(rise(cost)) < 1e-3 * np.sqrt(threshold - minimum):
                return middle, True
            if cost < threshold:
                inner, inner_rise, start = middle, rise(cost), parameters
            else:
                outer, outer_rise = middle, rise(cost)
        return inner + (outer - inner) / 2, True

    (lower, below), (upper, above) = end(-step, bounds[0]), end(step, bounds[1])
    values = np.array(sorted(points))
    costs = np.array([points[v] for v in values])
    message = "interval closed on both sides"
    if not (below and above):
        side = "below" if above else "above" if below else "both sides"
        message = f"interval open {side}: these records do not identify the parameter there"
    if costs.min() < minimum - 0.01 * (threshold - minimum):
        message += f"; a better optimum was met at {values[costs.argmin()]:.6g}, so fit again from there"
    return Profile(values, costs, lower, upper, (below, above), threshold, message)
