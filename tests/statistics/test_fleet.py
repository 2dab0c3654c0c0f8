"""Fleets of drawn robots: mean and spread with their intervals, robots that stand out, and what records do not say."""

import numpy as np
import pytest

from hybrid_id.errors import InputError
from hybrid_id.statistics.fleet import Fleet, fleet
from hybrid_id.statistics.uncertainty import scaled_inverse

MEAN = np.array([1.0, 2e-5, 0.01, 5.0])
SPREAD, WITHIN = np.array([0.1, 0.05, 0.3, 0.0]) * MEAN, np.array([0.02, 0.0, 0.1, 0.0]) * MEAN
TOGETHER = np.array([1.0, 1.0, 0.0, 0.0])
"""Direction, in units of the means, that a fleet without it cannot identify."""


class Drawn:
    """A fleet with a known truth; the seventh robot's first parameter may be off by a factor."""

    def __init__(
        self, seed: int, robots: int = 20, records: int = 4, *, factor: float = 1.0, blind: bool = False
    ):
        random = np.random.default_rng(seed)
        self.truth = MEAN + SPREAD * random.standard_normal((robots, 4))
        self.truth[6 % robots, 0] *= factor
        axis = TOGETHER / np.sqrt(2)
        across = np.eye(4) - np.outer(axis, axis) if blind else np.eye(4)
        self.values, self.hessians, self.covariances = [], [], []
        for truth in self.truth:
            rows = random.standard_normal((records, 7, 4)) / 0.06
            hessians = np.einsum("ij,rkj,rkl,lm->rim", across, rows, rows, across) / np.outer(MEAN, MEAN)
            covariances = np.array([scaled_inverse(one)[0] for one in hessians])
            errors = np.array(
                [random.multivariate_normal(np.zeros(4), c / np.outer(MEAN, MEAN)) for c in covariances]
            )
            within = WITHIN * random.standard_normal((records, 4))
            self.values.append(truth + within + MEAN * errors)
            self.hessians.append(hessians)
            self.covariances.append(covariances)
        self.misfit = np.exp(0.1 * random.standard_normal(robots))

    def found(self, precision: np.ndarray | None = None) -> Fleet:
        precision = np.zeros(4) if precision is None else precision
        return fleet(self.values, self.hessians, self.covariances, precision, self.misfit)


def test_intervals_hold_the_truth_and_a_fleet_of_equals_has_no_odd_robot() -> None:
    mean, spread, robots, odd, fleets = 0, 0, 0, 0, 25
    for seed in range(fleets):
        drawn = Drawn(seed)
        found = drawn.found()
        mean += ((found.mean_interval[:, 0] <= MEAN) & (found.mean_interval[:, 1] >= MEAN)).sum()
        spread += ((found.spread_interval[:, 0] <= SPREAD) & (found.spread_interval[:, 1] >= SPREAD)).sum()
        robots += (np.abs(found.values - drawn.truth) <= 1.96 * found.errors).sum()
        odd += found.stands_out.any()
    assert 0.90 <= mean / (4 * fleets) <= 0.99
    assert 0.88 <= spread / (4 * fleets) <= 0.99
    assert robots / (4 * 20 * fleets) >= 0.92
    assert odd <= 4  # 1 is expected


def test_spreads_between_robots_and_between_records_are_distinguished() -> None:
    found = [Drawn(seed, robots=60).found() for seed in range(4)]
    np.testing.assert_allclose(np.mean([one.spread for one in found], 0)[:3], SPREAD[:3], rtol=0.12)
    np.testing.assert_allclose(
        np.mean([one.record_spread for one in found], 0)[[0, 2]], WITHIN[[0, 2]], rtol=0.25
    )
    assert np.isnan(Drawn(0, records=1).found().record_spread).all()


def test_priors_pull_no_robots_together() -> None:
    """Half as well known as by its records, a parameter's spread was a third too small."""
    shrunk = []
    for seed in range(4):
        drawn = Drawn(seed, robots=60)
        centre, precision = 1.2 * MEAN, 30.0 / (0.06 * MEAN) ** 2 * np.array([0.1, 0.0, 0.1, 0.0])
        for hessians, values, covariances in zip(
            drawn.hessians, drawn.values, drawn.covariances, strict=True
        ):
            for k, hessian in enumerate(hessians):
                inverse = scaled_inverse(hessian + np.diag(precision))[0]
                values[k] = inverse @ (hessian @ values[k] + precision * centre)
                covariances[k] = inverse @ hessian @ inverse
        given = drawn.values, drawn.hessians, drawn.covariances, precision, drawn.misfit
        shrunk.append([fleet(*given, centre), fleet(*given)])
    unpulled, pulled = (np.mean([one[k].spread for one in shrunk], 0)[[0, 2]] for k in (0, 1))
    np.testing.assert_allclose(unpulled, SPREAD[[0, 2]], rtol=0.15)
    assert (pulled < 0.8 * unpulled).all()
    inside = [(one.mean_interval[:, 0] <= MEAN) & (one.mean_interval[:, 1] >= MEAN) for one, _ in shrunk]
    assert np.mean(inside) >= 0.8


def test_a_balanced_fleet_of_one_parameter_has_the_closed_form() -> None:
    random = np.random.default_rng(2)
    values = 1.0 + 0.2 * random.standard_normal((30, 1))
    sharp = np.full((30, 1, 1), 1e-8)
    found = fleet(
        list(values[:, None]), list(1 / sharp[:, None]), list(sharp[:, None]), np.zeros(1), np.ones(30)
    )
    assert found.mean[0] == pytest.approx(values.mean(), rel=1e-9)
    assert found.spread[0] ** 2 == pytest.approx(values.var(ddof=1) - 1e-8, rel=1e-3)


@pytest.mark.parametrize("robots", [8, 40])
def test_an_odd_robot_is_found_and_leaves_mean_and_spread_alone(robots: int) -> None:
    for seed in range(3):
        found = Drawn(seed, robots, factor=2.5).found()
        assert found.odd[6, 0]
        assert np.flatnonzero(found.stands_out).tolist() == [6]
        assert found.spread_interval[0, 0] <= SPREAD[0] <= found.spread_interval[0, 1]


def test_an_odd_error_of_fit_is_found_and_a_small_one_is_not() -> None:
    drawn = Drawn(2)
    drawn.misfit[4] = 3.0
    assert np.flatnonzero(drawn.found().odd_fit).tolist() == [4]
    drawn.misfit[:] = 1.0 + 1e-6 * np.arange(20)
    drawn.misfit[4] = 1.1
    assert not drawn.found().odd_fit.any()


def test_what_records_do_not_identify_is_not_claimed() -> None:
    found = Drawn(1, blind=True).found()
    assert np.isnan(found.mean_error[:2]).all() and np.isnan(found.spread[:2]).all()
    assert np.isfinite(found.mean_error[2:]).all()
    assert np.isinf(found.own_error[:, :2]).all() and not found.odd[:, :2].any()


def test_a_parameter_that_its_prior_holds_takes_no_part() -> None:
    drawn = Drawn(1)
    found = drawn.found(np.array([1e12, 0.0, 0.0, 0.0]))
    assert found.held.tolist() == [True, False, False, False]
    assert np.isnan(found.spread[0]) and not found.odd[:, 0].any()
    counts = [one.mean(0)[0] for one, odd in zip(drawn.values, found.stands_out, strict=True) if not odd]
    assert 0 < len(counts) < len(drawn.values) and found.mean[0] == pytest.approx(np.mean(counts))
    assert np.isfinite(found.spread[1:]).all()


def test_two_robots_are_no_fleet() -> None:
    with pytest.raises(InputError, match="2 robots are no fleet; give at least 3"):
        Drawn(0, robots=2).found()
