"""Hierarchical parameters of robots of one kind: the fleet's mean, its spread, and the robots that stand out.

Three levels: a record's estimate scatters around its robot's parameters by its own error (known) and by what varies
between records; a robot's parameters scatter around the fleet's mean. Both scatters are normal, independent between
parameters, and estimated by restricted maximum likelihood (R. DerSimonian, N. Laird, Control. Clin. Trials 7, 1986, for
the model; D. A. Harville, JASA 72, 1977, for the likelihood). Estimates enter by their information matrices, so that a
record that does not identify a direction says nothing of it, and its robot takes it from the fleet.

Priors pull all estimates towards one mean, and robots together that differ: what they pull is taken back first. A
parameter that its prior holds is taken as the same in all robots: the records alone do not identify it, and what they
say of the others is relative to it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from scipy.optimize import brentq, minimize
from scipy.special import stdtr, stdtrit

from hybrid_id.errors import InputError
from hybrid_id.statistics.uncertainty import scaled_eigen, scaled_inverse

FEWEST = 3
"""Robots below which nothing can be said of their spread."""
HELD = 0.5
"""Share of a parameter's information from which on its prior holds it."""
FAR = 3.5
"""Robust standard deviations from the median beyond which a robot is kept out of the first fit of mean and spread."""
LEVEL = 0.05
"""Chance that any robot of a fleet of equals is called odd."""
WORSE = 1.25
"""Times the fleet's median error from which on a robot's error of fit is called odd; less is a matter of its motion."""
ROUNDS = 20
"""Of setting odd robots aside and taking them back."""
WITHIN = 1e-4
"""Variance between records of one robot that its estimation starts from, as a share of the parameter squared."""
_NONE, _HUGE = 1e-7, 1e3
"""Spreads, as a share of a parameter's size, that stand for none at all, and for one beyond all bounds."""
_DROP = 1.92
"""Of the log-likelihood at the ends of a 95 % interval (Hardy and Thompson, Stat. Med. 15, 1996)."""


@dataclass(frozen=True, eq=False)
class Fleet:
    """Mean, spread and robots of a fleet of n, with p parameters.

    Attributes:
        mean, mean_error: of the robots that do not stand out, and its standard error (p,); nan where no interval may be
            claimed because the records do not identify the parameter.
        mean_interval: 95 %, by Student's distribution (p, 2).
        spread, spread_interval: standard deviation between robots (p,), and its 95 % interval (p, 2).
        record_spread: standard deviation between records of one robot beyond their own errors (p,); nan where no robot
            has two records.
        own, own_error: of each robot by its own records (n, p); infinite errors where they do not identify it.
        values, errors: of each robot with what the fleet knows, and their standard errors (n, p).
        deviation: of each robot from the others' mean, in standard deviations of what is expected (n, p).
        odd: robots and parameters that stand out (n, p) bool.
        odd_fit: robots whose error of fit stands out (n,) bool.
        misfit: error of fit of each robot over the fleet's median (n,).
        held: parameters that their priors hold (p,) bool; of them only the mean of the estimates that count is said.
    """

    mean: np.ndarray
    mean_error: np.ndarray
    mean_interval: np.ndarray
    spread: np.ndarray
    spread_interval: np.ndarray
    record_spread: np.ndarray
    own: np.ndarray
    own_error: np.ndarray
    values: np.ndarray
    errors: np.ndarray
    deviation: np.ndarray
    odd: np.ndarray
    odd_fit: np.ndarray
    misfit: np.ndarray
    held: np.ndarray

    @property
    def stands_out(self) -> np.ndarray:
        """Robots that are odd in a parameter or in their error of fit (n,) bool."""
        return self.odd.any(1) | self.odd_fit


def fleet(
    values: Sequence[np.ndarray],
    hessians: Sequence[np.ndarray],
    covariances: Sequence[np.ndarray],
    prior_precision: np.ndarray,
    misfit: np.ndarray,
    prior_mean: np.ndarray | None = None,
) -> Fleet:
    """Mean, spread and odd robots from the estimates of each record of each robot.

    A robot is odd in a parameter where its deviation from the others' mean is improbable (Student's test with
    Bonferroni's correction over robots and parameters). Such robots, and those whose error of fit is odd, are left out
    of mean and spread, so that they hide neither themselves nor each other.

    Args:
        values: of each robot, estimates of its records ``(r, p)``, with priors.
        hessians: of each robot, ``JᵀJ`` of its records without priors ``(r, p, p)``.
        covariances: of those estimates, without what all share, the error of the priors ``(r, p, p)``.
        prior_precision: of each parameter, 0 where it has no prior (p,).
        misfit: error of fit of each robot (n,), in any unit.
        prior_mean: of each parameter that has a prior (p,).

    Raises:
        InputError: fewer than three robots.
    """
    if len(values) < FEWEST:
        raise InputError(
            f"{len(values)} robots are no fleet; give at least {FEWEST}, for their spread is sought"
        )
    theta, hessian, covariance = (
        np.concatenate([np.asarray(of_robot, float) for of_robot in each])
        for each in (values, hessians, covariances)
    )
    shares = [prior_precision * np.diag(scaled_inverse(h + np.diag(prior_precision))[0]) for h in hessian]
    held = np.median(shares, axis=0) > HELD
    free = ~held
    if prior_mean is not None:
        # H (theta - theta_0) + P (theta - m) = 0 gives the estimates theta_0 without their priors' pull
        at = np.ix_(free, free)
        for k in range(len(theta) if prior_precision[free].any() else 0):
            pull = np.zeros_like(hessian[k])
            pull[at] = scaled_inverse(hessian[k][at])[0] * prior_precision[free]
            theta[k] += pull @ (theta[k] - prior_mean)
            back = np.eye(len(pull)) + pull
            covariance[k] = back @ covariance[k] @ back.T
        prior_precision = np.where(held, prior_precision, 0.0)
    typical, largest = np.median(np.abs(theta), axis=0), np.abs(theta).max(0)
    size = np.where(typical > 0.0, typical, np.where(largest > 0.0, largest, 1.0))
    precisions = hessian + np.diag(prior_precision)
    information = [_information(h, c, free) for h, c in zip(precisions, covariance, strict=True)]
    levels = _Levels(
        (theta / size)[:, free],
        np.array(information) * np.outer(size[free], size[free]),
        np.array([len(of_robot) for of_robot in values]),
    )
    relative = misfit / np.median(misfit)
    logs = np.log(np.maximum(relative, 1e-12))
    scale = max(1.4826 * float(np.median(np.abs(logs))), 1e-12)
    odd_fit = (stdtr(len(logs) - 1, -logs / scale) * len(logs) < LEVEL) & (relative > WORSE)
    # robots that stand out are set aside, until those that are kept call the same ones odd again
    kept, seen = ~odd_fit & ~levels.far(), list[np.ndarray]()
    for enough in (~odd_fit, np.ones_like(odd_fit)):
        kept = kept if kept.sum() >= FEWEST else enough
    while True:
        some = levels.select(kept)
        variances = some.fit()
        of_free = levels.compared(*variances, kept)
        seen.append(kept)
        others = ~odd_fit & ~of_free["odd"].any(1)
        if others.sum() < FEWEST or any((others == mask).all() for mask in seen) or len(seen) == ROUNDS:
            break
        kept = others
    known = np.isfinite(of_free["mean_error"])
    of_free["spread_interval"] = np.where(known[:, None], some.spread_intervals(*variances), np.nan).T
    # the free parameters among all of them, in their units
    own = np.array([np.mean(of_robot, 0) for of_robot in values])
    held_have = {"mean": own[kept].mean(0), "own": own, "values": own, "deviation": 0.0, "odd": False}
    of_all = {}
    for name, found in of_free.items():
        of_all[name] = np.empty((*found.shape[:-1], len(size)), found.dtype)
        of_all[name][...] = held_have.get(name, np.nan)
        of_all[name][..., free] = found if name in ("deviation", "odd") else found * size[free]
    for name in ("mean_interval", "spread_interval"):
        of_all[name] = of_all[name].T
    return Fleet(**of_all, odd_fit=odd_fit, misfit=relative, held=held)


def _information(hessian: np.ndarray, covariance: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Inverse covariance of the free parameters, zero in directions that neither records nor priors identify."""
    scale, _, vectors, identified = scaled_eigen(hessian)
    unknown = vectors[free][:, ~identified]
    axes = (
        np.linalg.qr(unknown, mode="complete")[0][:, unknown.shape[1] :]
        if unknown.size
        else np.eye(free.sum())
    )
    scaled = (covariance * np.outer(scale, scale))[np.ix_(free, free)]
    inverse = axes @ np.linalg.pinv(axes.T @ scaled @ axes, hermitian=True) @ axes.T
    return inverse * np.outer(scale[free], scale[free])


@dataclass(frozen=True, eq=False)
class _Levels:
    """Records below robots: estimates (R, p) with information (R, p, p), and how many records each robot has (n,).

    All in units of the parameters' sizes. t and c are the variances between robots and between records of one (p,).
    """

    theta: np.ndarray
    information: np.ndarray
    records: np.ndarray

    @property
    def repeated(self) -> bool:
        """Whether any robot has two records."""
        return bool((self.records > 1).any())

    def by_robot(self, of_record: np.ndarray) -> np.ndarray:
        """Sums over the records of each robot."""
        return np.add.reduceat(of_record, np.cumsum(self.records) - self.records, axis=0)

    def select(self, kept: np.ndarray) -> _Levels:
        """Some of the robots."""
        rows = np.repeat(kept, self.records)
        return _Levels(self.theta[rows], self.information[rows], self.records[kept])

    def marginal(self, c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Inverse covariance of each record around its robot (R, p, p), and that times the estimate (R, p)."""
        right = np.concatenate([self.information, self.information @ self.theta[..., None]], -1)
        both = np.linalg.solve(np.eye(self.theta.shape[1]) + self.information * c, right)
        return both[..., :-1], both[..., -1]

    def own(self, c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Estimates of each robot by its own records, and their standard errors (n, p)."""
        weight, weighted = self.marginal(c)
        own, errors = [], []
        for total, right in zip(self.by_robot(weight), self.by_robot(weighted), strict=True):
            inverse, determined = scaled_inverse(total)
            own.append(inverse @ right)
            errors.append(np.where(determined, np.sqrt(np.maximum(np.diag(inverse), 0.0)), np.inf))
        return np.array(own), np.array(errors)

    def around_median(self, c: float) -> tuple[np.ma.MaskedArray, ...]:
        """Distances of the robots' own estimates from their median (n, p), their errors, and robust scatter (p,)."""
        own, error = (
            np.ma.masked_invalid(found)
            for found in self.own(np.full(self.theta.shape[1], c if self.repeated else 0.0))
        )
        own = np.ma.masked_where(error.mask, own)
        apart = abs(own - np.ma.median(own, axis=0))
        return apart, error, 1.4826 * np.ma.median(apart, axis=0)

    def far(self) -> np.ndarray:
        """Robots far from the median in some parameter (n,) bool; nothing is far where nothing is known."""
        apart, error, scatter = self.around_median(WITHIN)
        return np.asarray((apart > FAR * np.ma.maximum(scatter, error)).filled(False).any(1))

    def around_mean(self, t: np.ndarray, c: np.ndarray) -> tuple[np.ndarray, ...]:
        """Of each robot with the fleet's spread: what it says of the mean.

        Inverse covariance L by its own records (n, p, p), that times its estimate (n, p), (I + L T)^-1 (n, p, p), what
        it says of the mean, (I + L T)^-1 L (n, p, p), and that times its estimate (n, p).
        """
        weight, weighted = self.marginal(c)
        total, right = self.by_robot(weight), self.by_robot(weighted)
        back = np.linalg.inv(np.eye(len(t)) + total * t)
        return total, right, back, back @ total, np.einsum("nij,nj->ni", back, right)

    def likelihood(self, t: np.ndarray, c: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """Restricted log-likelihood without its constant, and its derivatives by both variances' logarithms (p,)."""
        one = np.eye(len(t))
        weight, weighted = self.marginal(c)
        total, right, back, precision, known = self.around_mean(t, c)
        covariance, _ = scaled_inverse(precision.sum(0))
        mean = covariance @ known.sum(0)
        pull = known - precision @ mean  # V^-1 times the deviation, summed over a robot's records
        drop = precision - precision @ covariance @ precision
        by_robots = 0.5 * t * ((pull**2).sum(0) - np.einsum("nii->i", drop))
        shrink = t[:, None] * back  # (L + T^-1)^-1
        row = np.repeat(np.arange(len(self.records)), self.records)
        moved = weighted - np.einsum("rij,rj->ri", weight, (mean + t * pull)[row])
        cross = weight @ (one - t[:, None] * precision)[row]
        held = weight - weight @ shrink[row] @ weight - cross @ covariance @ np.swapaxes(cross, -1, -2)
        by_records = 0.5 * c * ((moved**2).sum(0) - np.einsum("rii->i", held))
        quadratic = (
            float(np.sum(self.theta * weighted))
            - float(np.einsum("ni,nij,nj->", right, shrink, right))
            - float(known.sum(0) @ mean)
        )
        spectrum = np.linalg.eigvalsh(precision.sum(0))
        spectrum = spectrum[spectrum > 1e-12 * spectrum.max()]
        logs = (
            np.linalg.slogdet(one + self.information * c)[1].sum()
            + np.linalg.slogdet(one + total * t)[1].sum()
            + np.log(spectrum).sum()
        )
        return -0.5 * (float(logs) + quadratic), by_robots, by_records

    def fit(self) -> tuple[np.ndarray, np.ndarray]:
        """Variances of largest restricted likelihood, between robots and between records of one (p,) each."""
        p = self.theta.shape[1]

        def variances(logs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            return np.exp(logs[:p]), np.exp(logs[p:]) if self.repeated else np.zeros(p)

        def cost(logs: np.ndarray) -> tuple[float, np.ndarray]:
            value, *slopes = self.likelihood(*variances(logs))
            return -value, -np.concatenate(slopes)[: len(logs)]

        scatter = np.clip(np.ma.filled(self.around_median(0.0)[2], 0.1), 1e-4, 1.0)
        first = np.log(np.concatenate([scatter**2, np.full(p if self.repeated else 0, WITHIN)]))
        bounds = [(2 * np.log(_NONE), 2 * np.log(_HUGE))] * len(first)
        return variances(minimize(cost, first, jac=True, method="L-BFGS-B", bounds=bounds).x)

    def compared(self, t: np.ndarray, c: np.ndarray, kept: np.ndarray) -> dict[str, np.ndarray]:
        """Mean of the robots that are kept, every robot beside it and against the others: fields of :class:`Fleet`.

        Intervals are (2, p); what the kept robots do not identify is nan.
        """
        total, right, back, precisions, known = self.around_mean(t, c)
        precision = precisions[kept].sum(0)
        covariance, determined = scaled_inverse(precision)
        mean = covariance @ known[kept].sum(0)
        own, own_error = self.own(c)
        shrink = t[:, None] * back
        # errors of the mean move a robot as far as its own records leave it to the fleet
        left = np.eye(len(t)) - shrink @ total
        spreads = shrink + left @ covariance @ np.swapaxes(left, -1, -2)
        # of each from the others' mean, in standard deviations of what is expected
        deviation = np.zeros_like(own)
        for k, counts in enumerate(kept):
            rest, certain = scaled_inverse(precision - counts * precisions[k])
            others = rest @ (precision @ mean - counts * known[k])
            error = np.sqrt(own_error[k] ** 2 + t + np.diag(rest))
            deviation[k] = np.where(certain & np.isfinite(error), (own[k] - others) / error, 0.0)
        tests, freedom = len(own) * max(int(determined.sum()), 1), max(int(kept.sum()) - 1, 1)
        claimed = np.where(determined, 1.0, np.nan)
        mean_error = claimed * np.sqrt(np.diag(covariance))
        reach = float(stdtrit(freedom, 0.975)) * mean_error
        between, within = (claimed * np.sqrt(np.where(v > 10.0 * _NONE**2, v, 0.0)) for v in (t, c))
        return {
            "mean": claimed * mean,
            "mean_error": mean_error,
            "mean_interval": np.array([mean - reach, mean + reach]),
            "spread": between,
            "record_spread": within if self.repeated else np.full(len(c), np.nan),
            "own": own,
            "own_error": own_error,
            "values": mean + np.einsum("nij,nj->ni", shrink, right - total @ mean),
            "errors": np.sqrt(np.maximum(np.einsum("nii->ni", spreads), 0.0)),
            "deviation": deviation,
            "odd": 2.0 * stdtr(freedom, -np.abs(deviation)) * tests < LEVEL,
        }

    def spread_intervals(self, t: np.ndarray, c: np.ndarray) -> np.ndarray:
        """95 % interval of each standard deviation between robots (p, 2): where the likelihood falls, all else held."""
        ends, top = np.zeros((len(t), 2)), self.likelihood(t, c)[0]
        for k, value in enumerate(t):

            def above(log: float, k: int = k) -> float:
                return self.likelihood(np.where(np.arange(len(t)) == k, np.exp(log), t), c)[0] - top + _DROP

            for side, (end, beyond) in enumerate(((2 * np.log(_NONE), 0.0), (2 * np.log(_HUGE), np.inf))):
                if above(end) > 0.0:
                    ends[k, side] = beyond
                else:
                    ends[k, side] = math.exp(
                        0.5 * cast(float, brentq(above, *sorted((end, np.log(value))), xtol=1e-3))
                    )
        return ends
