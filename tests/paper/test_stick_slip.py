"""The twins' physics: closed forms, equations written out once more, conserved quantities, and scipy's event solver."""

# pyright: reportAttributeAccessIssue=false

import numpy as np
import pytest
from machines.scipy_reference import integrate_scipy
from paper.twins import config, mechanism, rigid, sines
from scipy.integrate import solve_ivp

from hybrid_id.machines.physics.friction import AsymmetricStribeck
from hybrid_id.machines.physics.stick_slip import StickSlip, integrate

DRY = AsymmetricStribeck(0.010, 0.030, 10.541, 53.005, 0.010, 0.031, 11.313, 58.093)
LINK_1 = {"J": 1.97e-5, "P_m1": 19.249e-3, "P_m2": 0.025, "f_3": 5.04e-5}
TIME = 0.002 * np.arange(300)
FLEXIBLE, ARM = config("link1_flexible")["truth"], config("both_links")["truth"]
R_1, R_2 = config("both_links")["gear_ratio"]
VOLTAGE = sines(TIME, 16.0, [1.5, 3.3, 6.1, 9.0], 1.3)
VOLTAGES = np.stack([sines(TIME, 14.0, [1.5, 3.3, 6.1], 1.0), sines(TIME, 3.0, [1.3, 2.9, 5.1], 2.0)], axis=1)


def with_torques(voltages: np.ndarray) -> np.ndarray:
    """Inputs (T, n_inputs) of one run without random torques."""
    voltages = voltages.reshape(len(voltages), -1)
    return np.hstack((voltages, np.zeros_like(voltages)))


def excitation(n_samples: int, runs: int) -> tuple[np.ndarray, np.ndarray]:
    """Time (T,) and inputs (T, 2, runs): sums of sines with many reversals, and random torques."""
    random = np.random.default_rng(3)
    time = 0.002 * np.arange(n_samples)
    tones = np.arange(1, 12)[:, None] * 0.8
    phases = random.uniform(0, 2 * np.pi, (runs, 11, 1))
    inputs = random.normal(scale=5e-5, size=(n_samples, 2, runs))
    inputs[:, 0] = 1.6 * np.cos(2 * np.pi * tones * time + phases).sum(axis=1).T
    return time, inputs


def test_fourth_order_across_stick_and_slip() -> None:
    time, inputs = excitation(400, 3)
    drive, start = rigid(DRY, **LINK_1), np.zeros((2, 3))
    exact = integrate(drive, start, inputs, time, substeps=24)
    errors = [
        np.abs(integrate(drive, start, inputs, time, substeps=n) - exact)[:, 0].max() for n in (1, 2, 4)
    ]
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert np.all(orders > 3.6), (errors, orders)


def test_runs_side_by_side_equal_runs_alone() -> None:
    time, inputs = excitation(200, 4)
    inertias = np.array([1.5e-5, 1.97e-5, 2.4e-5, 3e-5])
    together = integrate(rigid(DRY, **LINK_1 | {"J": inertias}), np.zeros((2, 4)), inputs, time, substeps=2)
    for b, inertia in enumerate(inertias):
        drive = rigid(DRY, **LINK_1 | {"J": inertia})
        alone = integrate(drive, np.zeros((2, 1)), inputs[:, :, b : b + 1], time, substeps=2)
        np.testing.assert_allclose(together[:, :, b], alone[:, :, 0], rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("stage", "voltages", "substeps", "close"),
    [("link1", VOLTAGE, 10, 1e-9), ("link1_flexible", VOLTAGE, 10, 1e-5), ("both_links", VOLTAGES, 4, 1e-6)],
)
def test_every_machine_agrees_with_scipy_events(stage: str, voltages, substeps: int, close: float) -> None:
    machine, start = mechanism(stage, ripple=True)
    inputs = with_torques(voltages)
    fast = integrate(machine, start, inputs[:, :, None], TIME, substeps=substeps)[:, :, 0]
    exact = integrate_scipy(machine, start[:, 0], inputs, TIME)
    for speed in exact[:, 1 : 2 * voltages.ndim : 2].T:
        assert np.count_nonzero(np.diff(np.sign(speed))) >= 4 and np.any(speed[10:] == 0)
    if stage == "link1_flexible":
        assert np.abs(exact[:, 3][exact[:, 1] == 0]).max() > 0.05, "the link moves while the motor sticks"
    assert np.abs(fast - exact)[:, : 2 * voltages.ndim : 2].max() < close


def smooth_friction(p: dict[str, float], motor: str, speed: float) -> float:
    """Eq. (15)-(16) with tanh in place of the sign."""
    side = 1 if speed > 0 else 2
    f_1, f_2, f_3, f_4 = (p[f"f_{side}{j}{motor}"] for j in (1, 2, 3, 4))
    level = f_1 + (f_2 - f_1) * np.exp(-(((abs(speed) - f_3) / f_4) ** 2))
    return p[f"f_3{motor}"] * speed + level * np.tanh(speed / 0.01)


def flexible_rate(t: float, x: np.ndarray) -> list[float]:
    """Eq. (5), (9), (12) written out once more."""
    p, (q_m, v_m, q_a, v_a) = FLEXIBLE, x
    d = q_m / R_1 - q_a
    spring = p["k"] * d * (1 - (1 / np.cosh(p["beta"] * d)) ** p["alpha"])
    motor = p["P_m1"] * (VOLTAGE[min(int(t / 0.002), 299)] - p["P_m2"] * v_m) - smooth_friction(p, "", v_m)
    link = spring - (p["f_a1"] if v_a > 0 else p["f_a2"]) * np.tanh(70 * v_a)
    return [v_m, (motor - spring / R_1) / p["J_m"], v_a, link / p["J_a"]]


def mass(cos_2: np.ndarray | float) -> np.ndarray:
    """Mass matrix at the links, by the reading notes."""
    p_1, p_2, p_3, p_4 = (ARM[f"P_{i}"] for i in (1, 2, 3, 4))
    coupling = p_4 + p_3 * cos_2
    return np.array([[p_1 + 2 * p_3 * cos_2, coupling], [coupling, p_2 + 0 * cos_2]])


def arm_rate(t: float, x: np.ndarray) -> list[float]:
    """Eq. (13)-(14) at the links, written out once more; the state is that of the motors."""
    (q_2, v), u = (x[2] / R_2, x[1::2] / [R_1, R_2]), VOLTAGES[min(int(t / 0.002), 299)]
    swing = ARM["P_3"] * np.sin(q_2)
    c = np.array([-swing * (2 * v[0] * v[1] + v[1] ** 2), swing * v[0] ** 2])
    torque = np.zeros(2)
    for i, (motor, r) in enumerate((("m1", R_1), ("m2", R_2))):
        drive = ARM[f"P_m1{motor}"] * (u[i] - ARM[f"P_m2{motor}"] * x[2 * i + 1])
        torque[i] = r * (drive - smooth_friction(ARM, motor, x[2 * i + 1]))
    a_1, a_2 = np.linalg.solve(mass(np.cos(q_2)), torque - c)
    return [x[1], R_1 * a_1, x[3], R_2 * a_2]


@pytest.mark.parametrize(
    ("stage", "voltages", "rate", "end"),
    [("link1_flexible", VOLTAGE, flexible_rate, 120), ("both_links", VOLTAGES, arm_rate, 150)],
)
def test_smoothed_friction_converges_to_the_set_valued(stage: str, voltages, rate, end: int) -> None:
    """Through a stiff solver that knows no events."""
    machine, start = mechanism(stage)
    time = TIME[: end + 1]
    smooth = solve_ivp(
        rate, (0, TIME[end]), start[:, 0], "LSODA", time, rtol=1e-7, atol=1e-8, max_step=5e-4
    ).y
    dry = integrate(machine, start, with_torques(voltages)[:, :, None], time, substeps=4)[:, :, 0]
    for row in (0, 2):
        assert np.abs(smooth[row] - dry[:, row]).max() < 2e-3 * np.ptp(dry[:, row])


def test_sticking_of_both_joints_is_the_solution_of_the_box_problem() -> None:
    """Joints at rest: a = M^-1 (b - f) with f_i in the friction interval, f_i = its end where a_i is not 0."""
    random = np.random.default_rng(0)
    n = 200
    machine, _ = mechanism("both_links")
    x, u = np.zeros((4, n)), np.zeros((4, n))
    x[2] = random.uniform(-np.pi, np.pi, n) * R_2
    u[0], u[1] = random.uniform(-6, 6, n), random.uniform(-1, 1, n)
    _, mode = machine.solve_sticking(x, np.zeros((2, n)), u, np.ones((2, n), bool))
    scale = np.array([[R_1**2, R_1 * R_2], [1.0, R_2**2]])[..., None]
    (m_11, m_12), (_, m_22) = mass(np.cos(x[2] / R_2)) / scale
    levels = np.array(
        [[sign * drive.rotor_laws[0].levels(np.zeros(1))[side].item() for sign, side in ((-1, 1), (1, 0))]
         for drive in machine.drives]
    )  # fmt: skip
    applied = np.array([ARM["P_m1m1"] * u[0], ARM["P_m1m2"] * u[1]])
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


class Contradiction(StickSlip):
    """Says at every stop that it goes on sliding the way it came."""

    def solve_sticking(self, x, mode, u, at_rest):
        return np.array([x[0], np.where(at_rest[0], 0.0, x[1])]), mode


def test_a_mechanism_that_contradicts_itself_is_an_error() -> None:
    drive = Contradiction(rigid(DRY, **LINK_1).machine)
    with pytest.raises(RuntimeError, match="switches between stick and slip within one step"):
        integrate(drive, np.array([[0.0], [5.0]]), np.zeros((20, 2, 1)), TIME[:20])
