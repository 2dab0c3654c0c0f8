"""Profile likelihood: exact for a parabola, asymmetric where it must be, open where nothing is told."""

import numpy as np
import pytest

from hybrid_id.statistics.profile import profile_likelihood


def parabola(value, start):
    """Σr² of two correlated parameters, minimised over the second: information [[4, 1], [1, 1]]."""
    return 10 + 3 * (value - 2) ** 2, np.array([value, 1 - (value - 2)])


def test_parabola_gives_the_normal_interval():
    profile = profile_likelihood(parabola, np.array([2.0, 1.0]), 0, minimum=10, step=0.3)
    reach = 1.959964 / np.sqrt(3)
    assert profile.closed == (True, True)
    assert profile.lower == pytest.approx(2 - reach, rel=1e-3)
    assert profile.upper == pytest.approx(2 + reach, rel=1e-3)
    assert np.all(np.diff(profile.values) > 0)


@pytest.mark.parametrize("step", [1e-3, 0.3, 20.0])
def test_asymmetric_cost_gives_an_asymmetric_interval_from_any_step(step):
    profile = profile_likelihood(
        lambda v, start: (10 * np.log(v) ** 2, start), np.array([1.0]), 0, minimum=0, step=step,
        bounds=(1e-9, np.inf),
    )  # fmt: skip
    reach = np.exp(1.959964 / np.sqrt(10))
    assert profile.lower == pytest.approx(1 / reach, rel=1e-3)
    assert profile.upper == pytest.approx(reach, rel=1e-3)


def test_what_levels_off_is_open_above():
    profile = profile_likelihood(
        lambda v, start: (3 * (1 - np.exp(-v)) ** 2 if v > 0 else 100 * v**2, start),
        np.array([0.0]), 0, minimum=0, step=0.1,
    )  # fmt: skip
    assert profile.closed == (True, False) and profile.upper == np.inf
    assert "open above" in profile.message


def test_a_bound_that_is_reached_first_is_the_end_and_not_closed():
    profile = profile_likelihood(parabola, np.array([2.0, 1.0]), 0, minimum=10, step=0.3, bounds=(1.9, 9))
    assert profile.lower == 1.9 and profile.closed == (False, True)
    assert "open below" in profile.message
    at_bound = profile_likelihood(parabola, np.array([2.0, 1.0]), 0, minimum=10, step=0.3, bounds=(2.0, 9))
    assert at_bound.lower == 2.0 and not at_bound.closed[0]


def test_a_better_optimum_is_reported():
    def two_wells(value, start):
        return min(value**2, 20 * (value - 1.5) ** 2 - 1), start

    profile = profile_likelihood(two_wells, np.array([0.0]), 0, minimum=0, step=0.5)
    assert "better optimum" in profile.message


def test_broken_simulations_shorten_the_step():
    profile = profile_likelihood(
        lambda v, start: (3 * (v - 2) ** 2 if abs(v - 2) < 1.5 else np.inf, start),
        np.array([2.0]), 0, minimum=0, step=1.0,
    )  # fmt: skip
    assert profile.upper == pytest.approx(2 + 1.959964 / np.sqrt(3), rel=1e-3)
