"""A problem whose covariance is known: linear regression with white or autocorrelated noise."""

import numpy as np
import pytest


def _regression(n_samples=4000, correlation=0.0, seed=0, replicates=1):
    """Design (T, 2) of slow sines, noise (replicates, T) of variance 1, true covariance of least squares."""
    rng = np.random.default_rng(seed)
    time = np.arange(n_samples)
    design = np.stack([1 + 0.5 * np.sin(2 * np.pi * time / 800), np.cos(2 * np.pi * time / 1000)], axis=1)
    noise = rng.standard_normal((replicates, n_samples))
    if correlation:
        noise *= np.sqrt(1 - correlation**2)
        noise[:, 0] /= np.sqrt(1 - correlation**2)
        for k in range(1, n_samples):
            noise[:, k] += correlation * noise[:, k - 1]
    lags = np.abs(time[:, None] - time)
    inner = design.T @ (correlation**lags if correlation else np.eye(n_samples)) @ design
    inverse = np.linalg.inv(design.T @ design)
    return design, noise, inverse @ inner @ inverse


def _least_squares(design, y):
    estimate = np.linalg.lstsq(design, y, rcond=None)[0]
    return estimate, y - design @ estimate


@pytest.fixture(scope="session")
def regression():
    """Function that makes design, noise and true covariance."""
    return _regression


@pytest.fixture(scope="session")
def least_squares():
    """Function that gives estimate and residual."""
    return _least_squares
