"""The two-link arm: its equations of motion, conserved quantities, and coupled stick and slip."""

# pyright: reportAttributeAccessIssue=false

import numpy as np
import pytest
from machines.scipy_reference import integrate_scipy
from machines.twin.twins import ARM, FRICTION, PEAKS, RATIOS, arm, at_rest, at_rest_levels, rigid, sines
from scipy.integrate import solve_ivp

from hybrid_id.machines.physics.friction import AsymmetricStribeck
from hybrid_id.machines.physics.stick_slip import integrate
from hybrid_id.machines.twin.settings import two_link

R_1, R_2 = RATIOS
TIME = 0.002 * np.arange(300)
INPUTS = np.zeros((300, 4))
INPUTS[:, 0] = sines(TIME, 14.0, [1.5, 3.3, 6.1], 1.0)
INPUTS[:, 1] = sines(TIME, 3.0, [1.3, 2.9, 5.1], 2.0)
START = at_rest(two_link(), 2)
NO_FRICTION = {name + motor: 0.0 for name in FRICTION for motor in ("m1", "m2")}


def mass(cos_2: np.ndarray | float) -> np.ndarray:
    """Mass matrix at the links, by the reading notes."""
    p_1, p_2, p_3, p_4 = (ARM[f"P_{i}"] for i in (1, 2, 3, 4))
    coupling = p_4 + p_3 * cos_2
    return np.array([[p_1 + 2 * p_3 * cos_2, coupling], [coupling, p_2 + 0 * cos_2]])


def test_agrees_with_scipy_events_where_both_joints_stick_and_slip() -> None:
    mechanism = arm((5e-5, 13))
    fast = integrate(mechanism, START, INPUTS[:, :, None], TIME, substeps=4)[:, :, 0]
    exact = integrate_scipy(mechanism, START[:, 0], INPUTS, TIME)
    for speed in (exact[:, 1], exact[:, 3]):
        assert np.count_nonzero(np.diff(np.sign(speed))) >= 4 and np.any(speed[10:] == 0)
    assert np.abs(fast - exact)[:, [0, 2]].max() < 1e-6


def test_smoothed_friction_converges_to_the_set_valued() -> None:
    """Eq. (13)-(14) at the links, written out once more, through a stiff solver that knows no events."""
    ratio, width = np.array(RATIOS), 0.01

    def rate(t, x):
        (q_2, v), u = (x[1], x[2:]), INPUTS[min(int(t / 0.002), len(INPUTS) - 1), :2]
        swing = ARM["P_3"] * np.sin(q_2)
        c = np.array([-swing * (2 * v[0] * v[1] + v[1] ** 2), swing * v[0] ** 2])
        torque = np.zeros(2)
        for i, motor in enumerate(("m1", "m2")):
            p, speed = {name: ARM[name + motor] for name in ("P_m1", "P_m2", "f_3")}, v[i] * ratio[i]
            f_1, f_2, f_3, f_4 = (ARM[f"f_{1 if speed > 0 else 2}{j}{motor}"] for j in (1, 2, 3, 4))
            level = f_1 + (f_2 - f_1) * np.exp(-(((abs(speed) - f_3) / f_4) ** 2))
            dry = level * np.tanh(speed / width)
            torque[i] = ratio[i] * (p["P_m1"] * (u[i] - p["P_m2"] * speed) - p["f_3"] * speed - dry)
        return [*v, *np.linalg.solve(mass(np.cos(q_2)), torque - c)]

    end = 150
    smooth = solve_ivp(
        rate, (0, TIME[end]), np.zeros(4), "LSODA", TIME[: end + 1], rtol=1e-7, atol=1e-9, max_step=1e-3
    )
    dry = integrate(arm(), START, INPUTS[:, :, None], TIME[: end + 1], substeps=2)[:, :, 0]
    for i, row in enumerate((0, 2)):
        assert np.abs(ratio[i] * smooth.y[i] - dry[:, row]).max() < 2e-3 * np.ptp(dry[:, row])


def test_without_friction_and_motors_energy_and_momentum_stay() -> None:
    mechanism = arm(P_m1m1=0.0, P_m1m2=0.0, **NO_FRICTION)
    start = np.array([[0.0], [0.8 * R_1], [0.4 * R_2], [-6.0 * R_2]])
    x = integrate(mechanism, start, np.zeros((500, 4, 1)), 0.002 * np.arange(500), substeps=4)[:, :, 0]
    matrices = mass(np.cos(x[:, 2] / R_2))
    v = np.array([x[:, 1] / R_1, x[:, 3] / R_2])
    energy = 0.5 * np.einsum("it,ijt,jt->t", v, matrices, v)
    momentum = matrices[0, 0] * v[0] + matrices[0, 1] * v[1]
    assert np.ptp(v[0]) > 0.5, "the joints exchange momentum"
    assert np.ptp(energy) < 1e-8 * energy[0]
    assert np.ptp(momentum) < 1e-8


def test_sticking_of_both_joints_is_the_solution_of_the_box_problem() -> None:
    """Joints at rest: a = M^-1 (b - f) with f_i in the friction interval, f_i = its end where a_i is not 0."""
    random = np.random.default_rng(0)
    n = 200
    mechanism = arm()
    x = np.zeros((4, n))
    x[2] = random.uniform(-np.pi, np.pi, n) * R_2
    u = np.zeros((4, n))
    u[0], u[1] = random.uniform(-6, 6, n), random.uniform(-1, 1, n)
    _, mode = mechanism.solve_sticking(x, np.zeros((2, n)), u, np.ones((2, n), bool))
    (m_11, m_12), (_, m_22) = (
        mass(np.cos(x[2] / R_2)) / np.array([[R_1**2, R_1 * R_2], [1.0, R_2**2]])[..., None]
    )
    own = [at_rest_levels(mechanism, joint) for joint in (0, 1)]
    levels = np.array([[-one[-1.0], one[1.0]] for one in own])
    applied = np.array([19.25e-3 * u[0], 42.62e-3 * u[1]])
    inverse = np.array([[m_22 + 0 * m_11, -m_12], [-m_12, m_11]]) / (m_11 * m_22 - m_12**2)
    friction = np.zeros((2, n))
    for _ in range(
        3000
    ):  # projected descent on the convex problem, which shares nothing with the enumeration
        a = np.einsum("ijn,jn->in", inverse, applied - friction)
        friction = np.clip(friction + 8e-6 * a, levels[:, :1], levels[:, 1:])
    a = np.einsum("ijn,jn->in", inverse, applied - friction)
    np.testing.assert_array_equal(mode, np.where(np.abs(a) > 1e-6, np.sign(a), 0.0))
    assert {(s, t) for s, t in mode.T} == {(s, t) for s in (-1, 0, 1) for t in (-1, 0, 1)}, "all nine occur"


def test_the_second_joint_shakes_the_first_one_loose() -> None:
    """Joint 1 without voltage: the reaction M_12 / M_22 of joint 2's net torque against its own friction."""
    m = mass(1.0)
    mechanism = arm()
    holds = R_1 * at_rest_levels(mechanism, 0)[-1.0]
    own = R_2 * at_rest_levels(mechanism, 1)[1.0]
    threshold = (holds * m[1, 1] / m[0, 1] + own) / R_2 / ARM["P_m1m2"]
    for share, moves in ((0.999, False), (1.001, True)):
        u = np.array([[0.0], [share * threshold], [0.0], [0.0]])
        _, mode = mechanism.solve_sticking(START, np.zeros((2, 1)), u, np.ones((2, 1), bool))
        assert mode[1, 0] == 1 and (mode[0, 0] == -1) == moves


@pytest.mark.parametrize("sides", [(1, 1), (1, -1), (-1, 1), (-1, -1)])
def test_still_below_breakaway(sides: tuple[int, int]) -> None:
    mechanism = arm()
    inputs = np.zeros((100, 4, 1))
    for i, side in enumerate(sides):
        inputs[:, i] = side * 0.999 * at_rest_levels(mechanism, i)[side] / ARM[f"P_m1m{i + 1}"]
    assert not integrate(mechanism, START, inputs, TIME[:100], substeps=2).any()


def test_with_joint_1_held_link_2_is_one_rigid_link() -> None:
    held = integrate(arm(held=1), START, INPUTS[:, :, None], TIME, substeps=2)[:, :, 0]
    alone = rigid(
        AsymmetricStribeck(**{name: ARM[f"{name}m2"] for name in PEAKS}),
        J=ARM["P_2"] / R_2**2,
        P_m1=ARM["P_m1m2"],
        P_m2=ARM["P_m2m2"],
        f_3=ARM["f_3m2"],
    )
    expected = integrate(alone, START[:2], INPUTS[:, 1::2, None], TIME, substeps=2)[:, :, 0]
    assert not held[:, :2].any()
    np.testing.assert_allclose(held[:, 2:], expected, atol=1e-9)
    assert np.ptp(expected[:, 0]) > 5


def test_mirrored_voltages_mirror_the_motion_of_symmetric_joints() -> None:
    alike = {f"f_2{j}{motor}": ARM[f"f_1{j}{motor}"] for j in (1, 2, 3, 4) for motor in ("m1", "m2")}
    runs = [integrate(arm(**alike), START, sign * INPUTS[:, :, None], TIME, substeps=1) for sign in (1, -1)]
    np.testing.assert_allclose(runs[0], -runs[1], atol=1e-9)
