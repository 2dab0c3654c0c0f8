"""Paired differences against scipy, and the correction for training sets that share records."""

import math

import numpy as np
import pytest
from scipy import stats

from hybrid_id.errors import InputError
from hybrid_id.statistics.variation import paired_difference


def test_without_overlap_it_is_the_paired_t_interval(rng: np.random.Generator) -> None:
    first, second = rng.normal(1.0, 0.3, 7), rng.normal(0.7, 0.2, 7)
    found = paired_difference(first, second, level=0.9)
    expected = stats.ttest_rel(first, second).confidence_interval(0.9)
    assert (found.lower, found.upper) == pytest.approx((expected.low, expected.high), rel=1e-12)
    assert found.mean == pytest.approx(np.mean(first - second)) and found.n_pairs == 7


def test_shared_records_widen_it_as_nadeau_and_bengio_say(rng: np.random.Generator) -> None:
    first, second, overlap = rng.normal(size=5), rng.normal(size=5), 0.6
    plain, found = (paired_difference(first, second, overlap=o) for o in (0.0, overlap))
    widths = [p.upper - p.lower for p in (plain, found)]
    assert widths[1] / widths[0] == pytest.approx(math.sqrt((1 / 5 + overlap) / (1 / 5)))


def test_pairs_that_are_not_finite_are_left_out() -> None:
    found = paired_difference(np.array([1.0, np.inf, 3.0]), np.array([0.5, 1.0, np.nan]))
    assert found.n_pairs == 1 and found.mean == 0.5 and math.isnan(found.upper)
    assert math.isnan(paired_difference(np.array([np.nan]), np.array([1.0])).mean)


def test_equal_values_have_an_interval_of_no_width() -> None:
    found = paired_difference(np.ones(5), np.ones(5), overlap=0.5)
    assert (found.lower, found.mean, found.upper) == (0.0, 0.0, 0.0)


def test_what_does_not_pair_up_is_refused() -> None:
    with pytest.raises(InputError, match="no pairs"):
        paired_difference(np.ones(3), np.ones(4))
    with pytest.raises(InputError, match="overlap"):
        paired_difference(np.ones(3), np.ones(3), overlap=-0.1)
