"""The twin's physics against closed-form solutions."""

import numpy as np
import pytest
from machines.twin.twins import rigid

from hybrid_id.machines.physics.friction import AsymmetricStribeck, Coulomb, Stribeck
from hybrid_id.machines.physics.stick_slip import StickSlip, integrate

J, P_M1, P_M2, F_C, F_3 = 2e-5, 0.02, 0.025, 0.01, 5e-5
COULOMB = Coulomb(F_C)


def run(drive: StickSlip, voltage: np.ndarray, time: np.ndarray, q_0: float = 0.0, v_0: float = 0.0):
    """Angle and speed of one run without random torque."""
    inputs = np.zeros((len(time), 2, 1))
    inputs[:, 0, 0] = voltage
    states = integrate(drive, np.array([[q_0], [v_0]]), inputs, time)
    return states[:, 0, 0], states[:, 1, 0]


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_coulomb_coast_down_is_a_parabola_that_ends(direction: float) -> None:
    time = np.arange(100) * 0.002
    drive = rigid(COULOMB, J=J, P_m1=P_M1, P_m2=0.0)
    q, v = run(drive, np.zeros(100), time, v_0=direction * 50.0)
    t = np.minimum(time, 50.0 * J / F_C)  # stops here, between two samples
    np.testing.assert_allclose(v, direction * (50.0 - F_C / J * t), atol=1e-11)
    np.testing.assert_allclose(q, direction * (50.0 * t - F_C / J * t**2 / 2), atol=1e-11)
    assert v[-1] == 0.0


def test_reversal_under_coulomb_friction_joins_two_parabolas() -> None:
    time = np.arange(100) * 0.002
    drive = rigid(COULOMB, J=J, P_m1=P_M1, P_m2=0.0)
    torque = -2.5 * F_C
    _, v = run(drive, np.full(100, torque / P_M1), time, v_0=40.0)
    crossing = 40.0 * J / (3.5 * F_C)
    expected = np.where(time < crossing, 3.5, 1.5) * (-F_C / J) * (time - crossing)
    np.testing.assert_allclose(v, expected, atol=1e-10)


def test_step_response_with_viscous_friction_is_exponential() -> None:
    time = np.arange(300) * 0.002
    drive = rigid(COULOMB, J=J, P_m1=P_M1, P_m2=P_M2, f_3=F_3)
    _, v = run(drive, np.full(300, 6.0), time)
    damping = P_M1 * P_M2 + F_3
    steady = (P_M1 * 6.0 - F_C) / damping
    np.testing.assert_allclose(v, steady * (1 - np.exp(-damping / J * time)), atol=1e-8)


def test_no_load_speed_with_asymmetric_stribeck_balances_the_torques() -> None:
    dry = AsymmetricStribeck(0.010, 0.030, 10.541, 53.005, 0.010, 0.031, 11.313, 58.093)
    drive = rigid(dry, J=J, P_m1=P_M1, P_m2=P_M2, f_3=F_3)
    time = np.arange(400) * 0.002
    for voltage in (10.0, -10.0):
        side = np.sign(voltage)
        _, v = run(drive, np.full(400, voltage), time)
        balance = (
            P_M1 * (voltage - P_M2 * v[-1]) - F_3 * v[-1] - side * dry.levels(v[-1])[0 if side > 0 else 1]
        )
        assert abs(balance) < 1e-9
        assert side * v[-1] > 300


def test_each_side_breaks_away_at_its_own_level_at_rest() -> None:
    dry = AsymmetricStribeck(0.010, 0.030, 10.0, 50.0, 0.010, 0.035, 10.0, 50.0)
    drive = rigid(dry, J=J, P_m1=P_M1, P_m2=P_M2, f_3=F_3)
    time = np.arange(50) * 0.002
    rest = np.exp(-((10.0 / 50.0) ** 2))  # eq. (15) at zero speed lies under its peak
    for side, level in ((1.0, 0.010 + 0.020 * rest), (-1.0, 0.010 + 0.025 * rest)):
        q, v = run(drive, np.full(50, side * level / P_M1 * 0.9999), time)
        assert not q.any() and not v.any()
        _, v = run(drive, np.full(50, side * level / P_M1 * 1.0001), time)
        assert side * v[-1] > 0


def test_pendulum_without_friction_keeps_its_energy() -> None:
    r, G_l = 50.0, 3.0
    drive = rigid(J=J, P_m1=0.0, P_m2=0.0, G_l=G_l, r=r)
    time = np.arange(1000) * 0.002
    q, v = run(drive, np.zeros(1000), time, q_0=1.5 * r)
    energy = 0.5 * J * v**2 - G_l * np.cos(q / r)
    assert np.ptp(energy) < 1e-9 * G_l
    assert np.ptp(q) > 2.9 * r


def test_pendulum_with_coulomb_friction_sticks_where_friction_holds_it() -> None:
    r, G_l = 50.0, 3.0
    drive = rigid(COULOMB, J=J, P_m1=0.0, P_m2=0.0, G_l=G_l, r=r)
    time = np.arange(1000) * 0.002
    q, v = run(drive, np.zeros(1000), time, q_0=1.2 * r)
    assert not v[-100:].any()
    assert abs(G_l / r * np.sin(q[-1] / r)) < F_C
    lost = G_l * (np.cos(q[-1] / r) - np.cos(1.2))
    np.testing.assert_allclose(lost, F_C * np.abs(np.diff(q)).sum(), rtol=2e-3)  # path length by samples


def test_symmetric_drive_mirrors() -> None:
    drive = rigid(COULOMB, Stribeck(F_C, 20.0), J=J, P_m1=P_M1, P_m2=P_M2, f_3=F_3)
    time = np.arange(400) * 0.002
    voltage = 5 * np.sin(2 * np.pi * 4 * time)
    np.testing.assert_array_equal(run(drive, voltage, time)[0], -run(drive, -voltage, time)[0])
