"""Accuracy of the fast integrator across stick and slip."""

import numpy as np
import pytest
from machines.scipy_reference import integrate_scipy
from machines.twin.twins import rigid

from hybrid_id.machines.physics.friction import AsymmetricStribeck
from hybrid_id.machines.physics.stick_slip import StickSlip, integrate

DRY = AsymmetricStribeck(0.010, 0.030, 10.541, 53.005, 0.010, 0.031, 11.313, 58.093)
LINK_1 = {"J": 1.97e-5, "P_m1": 19.249e-3, "P_m2": 0.025, "f_3": 5.04e-5}
DRIVE = rigid(DRY, **LINK_1)
ENCODER_QUANTUM = 2 * np.pi / 2000  # a fine one


def excitation(n_samples: int, runs: int) -> tuple[np.ndarray, np.ndarray]:
    """Time (T,) and inputs (T, 2, runs): sums of sines with many reversals, and random torques."""
    random = np.random.default_rng(3)
    time = 0.002 * np.arange(n_samples)
    tones = np.arange(1, 12)[:, None] * 0.8
    phases = random.uniform(0, 2 * np.pi, (runs, 11, 1))
    inputs = random.normal(scale=5e-5, size=(n_samples, 2, runs))
    inputs[:, 0] = 1.6 * np.cos(2 * np.pi * tones * time + phases).sum(axis=1).T
    return time, inputs


def test_agrees_with_scipy_events_far_below_the_encoder() -> None:
    time, inputs = excitation(500, 1)
    fast = integrate(DRIVE, np.zeros((2, 1)), inputs, time)[:, :, 0]
    exact = integrate_scipy(DRIVE, np.zeros(2), inputs[:, :, 0], time)
    assert np.count_nonzero(np.diff(np.sign(exact[:, 1]))) >= 8, "the test needs stick and slip"
    assert np.any(exact[5:, 1] == 0), "the test needs sticking"
    assert np.abs(fast - exact)[:, 0].max() < 1e-7 * ENCODER_QUANTUM
    assert np.abs(fast - exact)[:, 1].max() < 1e-8


def test_fourth_order_across_stick_and_slip() -> None:
    time, inputs = excitation(400, 3)
    start = np.zeros((2, 3))
    exact = integrate(DRIVE, start, inputs, time, substeps=24)
    errors = [
        np.abs(integrate(DRIVE, start, inputs, time, substeps=n) - exact)[:, 0].max() for n in (1, 2, 4)
    ]
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert np.all(orders > 3.6), (errors, orders)


def test_runs_side_by_side_equal_runs_alone() -> None:
    time, inputs = excitation(200, 4)
    inertias = np.array([1.5e-5, 1.97e-5, 2.4e-5, 3e-5])
    together = integrate(rigid(DRY, **{**LINK_1, "J": inertias}), np.zeros((2, 4)), inputs, time, substeps=2)
    for b, inertia in enumerate(inertias):
        drive = rigid(DRY, **{**LINK_1, "J": inertia})
        alone = integrate(drive, np.zeros((2, 1)), inputs[:, :, b : b + 1], time, substeps=2)
        np.testing.assert_allclose(together[:, :, b], alone[:, :, 0], rtol=0, atol=1e-12)


def test_uneven_time_stamps_hold_the_input_over_each_step() -> None:
    time, inputs = excitation(200, 1)
    whole = integrate(DRIVE, np.zeros((2, 1)), inputs, time, substeps=20)
    repeated = np.repeat(inputs, 2, axis=0)[:-1]
    split = np.sort(np.concatenate((time, time[:-1] + 0.0007)))
    parts = integrate(DRIVE, np.zeros((2, 1)), repeated, split, substeps=10)
    np.testing.assert_allclose(parts[::2], whole, rtol=0, atol=1e-9)


class Contradiction(StickSlip):
    """Says at every stop that it goes on sliding the way it came."""

    def solve_sticking(self, x, mode, u, at_rest):
        stopped = np.array([x[0], np.where(at_rest[0], 0.0, x[1])])
        return stopped, mode


def test_a_mechanism_that_contradicts_itself_is_an_error() -> None:
    time, inputs = excitation(20, 1)
    inputs[:] = 0.0
    drive = Contradiction(DRIVE.machine)
    with pytest.raises(RuntimeError, match="switches between stick and slip within one step"):
        integrate(drive, np.array([[0.0], [5.0]]), inputs, time)
    with pytest.raises(RuntimeError, match="switches between stick and slip within one sample"):
        integrate_scipy(drive, np.array([0.0, 5.0]), inputs[:, :, 0], time)
