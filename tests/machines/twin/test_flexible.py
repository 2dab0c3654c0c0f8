"""The flexible drive: its spring, stick and slip with a link that moves on, and energy."""

# pyright: reportAttributeAccessIssue=false

import numpy as np
import pytest
from machines.scipy_reference import integrate_scipy
from machines.twin.twins import FLEXIBLE, FRICTION, PEAKS, at_rest, at_rest_levels, flexible, rigid, sines
from scipy.integrate import quad, solve_ivp

from hybrid_id.machines.physics.friction import AsymmetricStribeck, AsymmetricTanh
from hybrid_id.machines.physics.law import Push, Signals
from hybrid_id.machines.physics.stick_slip import integrate
from hybrid_id.machines.physics.transmission import BacklashFlexibility
from hybrid_id.machines.twin.settings import ONE_LINK_FLEXIBLE

R = 156.0
TIME = 0.002 * np.arange(300)
VOLTAGE = sines(TIME, 16.0, [1.5, 3.3, 6.1, 9.0], 1.3)
INPUTS = np.stack((VOLTAGE, np.zeros_like(VOLTAGE)), axis=1)
START = at_rest(ONE_LINK_FLEXIBLE, 1)


def test_spring_is_cubic_near_zero_and_linear_far_out() -> None:
    """Eq. (12) and its limits by the reading notes."""
    k, alpha, beta = 380.16, 0.31, 169.34
    spring = BacklashFlexibility(k, alpha, beta)
    near, far, between = np.array([1e-5, 3e-5]), np.array([0.3, 5.0]), np.array([-0.02, 0.004, 0.03])
    np.testing.assert_allclose(spring.torque(near), k * alpha * beta**2 * near**3 / 2, rtol=1e-4)
    np.testing.assert_allclose(spring.torque(far), k * far, rtol=1e-6)
    plain = k * between * (1 - np.cosh(beta * between) ** -alpha)
    np.testing.assert_allclose(spring.torque(between), plain, rtol=1e-12)
    seam = 1e-2 / beta * np.array([1 - 1e-9, 1 + 1e-9])
    np.testing.assert_allclose(*spring.torque(seam), rtol=1e-8)


def test_link_friction_opposes_motion_with_the_level_of_its_side() -> None:
    """Eq. (9)."""
    x, push = Signals(3), Push()
    x.v_a = np.array([1.0, -1.0, 0.01])
    AsymmetricTanh(0.0063, 0.0056).act(push, x)
    np.testing.assert_allclose(push.torque, [-0.0063, 0.0056, -0.0063 * np.tanh(0.7)])


def test_agrees_with_scipy_events_across_stick_and_slip() -> None:
    drive = flexible((1e-4, 13))
    fast = integrate(drive, START, INPUTS[:, :, None], TIME, substeps=10)[:, :, 0]
    exact = integrate_scipy(drive, START[:, 0], INPUTS, TIME)
    speed = exact[:, 1]
    assert np.count_nonzero(np.diff(np.sign(speed))) >= 8 and np.mean(speed[10:] == 0) > 0.03
    assert np.abs(exact[:, 3][speed == 0]).max() > 0.05, "the link moves while the motor sticks"
    assert np.abs(fast - exact)[:, 0].max() < 1e-5


def test_smoothed_friction_converges_to_the_set_valued() -> None:
    """Eq. (5) written out once more, friction as tanh(v / w), through a stiff solver that knows no events."""
    p, width = FLEXIBLE, 0.01

    def rate(t, x):
        q_m, v_m, q_a, v_a = x
        u = VOLTAGE[min(int(t / 0.002), len(VOLTAGE) - 1)]
        d = q_m / R - q_a
        spring = p["k"] * d * (1 - (1 / np.cosh(p["beta"] * d)) ** p["alpha"])
        i = 1 if v_m > 0 else 2
        f_1, f_2, f_3, f_4 = (p[f"f_{i}{j}"] for j in (1, 2, 3, 4))
        level = f_1 + (f_2 - f_1) * np.exp(-(((abs(v_m) - f_3) / f_4) ** 2))
        motor = p["P_m1"] * (u - p["P_m2"] * v_m) - p["f_3"] * v_m - level * np.tanh(v_m / width)
        link = spring - (p["f_a1"] if v_a > 0 else p["f_a2"]) * np.tanh(70 * v_a)
        return [v_m, (motor - spring / R) / p["J_m"], v_a, link / p["J_a"]]

    end = 120
    smooth = solve_ivp(
        rate, (0, TIME[end]), START[:, 0], "LSODA", TIME[: end + 1], rtol=1e-7, atol=1e-8, max_step=5e-4
    )
    dry = integrate(flexible(), START, INPUTS[:, :, None], TIME[: end + 1], substeps=4)[:, :, 0]
    assert np.count_nonzero(np.diff(np.sign(dry[:, 1]))) >= 4
    assert np.abs(smooth.y[0] - dry[:, 0]).max() < 2e-3 * np.ptp(dry[:, 0])
    assert np.abs(smooth.y[2] - dry[:, 2]).max() < 2e-3 * np.ptp(dry[:, 2])


def test_without_friction_and_motor_energy_stays() -> None:
    drive = flexible(P_m1=0.0, f_a1=0.0, f_a2=0.0, **dict.fromkeys(FRICTION, 0.0))
    start = np.array([[0.0], [60.0], [0.05], [-1.0]])
    states = integrate(drive, start, np.zeros((200, 2, 1)), TIME[:200], substeps=10)[:, :, 0]
    q_m, v_m, q_a, v_a = states[::20].T
    kinetic = 0.5 * FLEXIBLE["J_m"] * v_m**2 + 0.5 * FLEXIBLE["J_a"] * v_a**2
    spring = drive.drives[0].spring
    assert isinstance(spring, BacklashFlexibility)
    torque = spring.torque
    stored = [quad(lambda d: torque(d).item(), 0, end)[0] for end in q_m / R - q_a]
    assert np.ptp(kinetic) > 0.1 * kinetic.max(), "the spring takes part"
    assert np.ptp(kinetic + stored) < 1e-6 * kinetic.max()


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_still_below_breakaway_and_off_above_it(side: float) -> None:
    drive = flexible()
    level = at_rest_levels(drive)[side]
    inputs = np.zeros((100, 2, 1))
    inputs[:, 0] = side * 0.999 * level / FLEXIBLE["P_m1"]
    assert not integrate(drive, START, inputs, TIME[:100], substeps=2).any()
    inputs[:, 0] *= 1.002
    assert side * integrate(drive, START, inputs, TIME[:100], substeps=2)[-1, 0, 0] > 0


def test_the_spring_alone_tears_a_stuck_motor_loose() -> None:
    drive = flexible()
    level = R * at_rest_levels(drive)[-1.0]
    deflections = np.linspace(0.0, 0.05, 500)
    spring = drive.drives[0].spring
    assert isinstance(spring, BacklashFlexibility)
    breaking = np.interp(level, spring.torque(deflections), deflections)
    for share, moves in ((0.99, False), (1.01, True)):
        start = np.array([[0.0], [0.0], [-share * breaking], [0.0]])  # the link at rest behind the motor
        speed = integrate(drive, start, np.zeros((2, 2, 1)), TIME[:2], substeps=4)[-1, 1, 0]
        assert bool(speed < 0) == moves


def test_a_stiff_spring_is_a_rigid_gear() -> None:
    p = FLEXIBLE
    friction = AsymmetricStribeck(**{name: p[name] for name in PEAKS})
    motor = {name: p[name] for name in ("P_m1", "P_m2", "f_3")}
    one_body = rigid(friction, J=p["J_m"] + p["J_a"] / R**2, **motor)
    stiff = flexible(k=2e5, beta=1e6, f_a1=0.0, f_a2=0.0)
    time = TIME[:150]
    two = integrate(stiff, START, INPUTS[:150, :, None], time, substeps=10)[:, 0, 0]
    one = integrate(one_body, START[:2], INPUTS[:150, :, None], time, substeps=4)[:, 0, 0]
    assert np.abs(two - one).max() < 5e-3 * np.ptp(
        one
    )  # nothing damps the spring, so that it rattles a little
