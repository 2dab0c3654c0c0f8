"""Autocorrelation of residuals against processes whose correlation is known."""

import numpy as np
import pytest

from hybrid_id.statistics.residuals import whiteness


def test_white_residuals_stay_in_the_band(rng: np.random.Generator) -> None:
    white = whiteness([rng.standard_normal((4000, 2)), rng.standard_normal((3000, 2))])
    assert white.correlation[0] == pytest.approx([1.0, 1.0])
    assert white.band == pytest.approx(2.576 / np.sqrt(7000), rel=1e-3)
    assert np.all(white.outside <= 0.05)


def test_autoregression_has_its_geometric_correlation(rng: np.random.Generator) -> None:
    noise, series = rng.standard_normal(60_000), np.zeros(60_000)
    for k in range(1, noise.size):
        series[k] = 0.8 * series[k - 1] + noise[k]
    white = whiteness([series[:, None]], lags=5)
    assert white.correlation[:, 0] == pytest.approx(0.8 ** np.arange(6), abs=0.03)
    assert white.outside == pytest.approx([1.0])


def test_short_and_silent_records_are_borne() -> None:
    white = whiteness([np.zeros((8, 1))], lags=100)
    assert white.lags[-1] == 2
    assert np.all(white.correlation == 0.0)
