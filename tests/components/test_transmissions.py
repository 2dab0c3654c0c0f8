"""Play, compliance and hardening between rotor and link: equations and what they do in a drive."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from drives import STEP, batch_of, run, stored
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from hybrid_id.components import (
    AsymmetricTanh,
    Backlash,
    BacklashFlexibility,
    ConstantTorque,
    Coulomb,
    HardeningSpring,
    JointFlexibility,
    LinearSpring,
    TwoInertias,
)
from hybrid_id.components.base import Component, Transmission
from hybrid_id.components.transmission.flexibility import STIFFEST
from hybrid_id.simulation.stability import fastest_rate, with_substeps
from hybrid_id.simulation.step import Engine
from hybrid_id.systems import System, one_link, one_link_flexible

PLACE = "joint1/transmission"
TABLE_4 = {"k": 380.16, "alpha": 0.31, "beta": 169.34}


def tensor(values: object) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


def view(part: Component) -> SimpleNamespace:
    return SimpleNamespace(**{n: v.detach() for n, v in vars(part.view()).items()})


def torque(part: Transmission, deflection, rate=0.0, inertia: float = 0.05) -> np.ndarray:
    delta = tensor(np.atleast_1d(deflection))
    return part.torque(view(part), delta, torch.zeros_like(delta) + tensor(rate), tensor([inertia])).numpy()


def test_eq_12_with_table_4() -> None:
    delta = np.array([-0.05, -0.01, 0.003, 0.02, 0.1])
    expected = 380.16 * delta * (1 - (1 / np.cosh(169.34 * delta)) ** 0.31)
    np.testing.assert_allclose(torque(BacklashFlexibility(**TABLE_4), delta), expected, rtol=1e-12)


def test_eq_12_is_cubic_near_zero_and_linear_far_out() -> None:
    spring = BacklashFlexibility(**TABLE_4)
    near = np.array([1e-12, 1e-9, -1e-7, 1e-6])
    np.testing.assert_allclose(torque(spring, near), 380.16 * 0.31 * 169.34**2 * near**3 / 2, rtol=1e-7)
    far = np.array([0.5, -3.0, 1e3, -1e6])  # cosh overflows beyond 710
    np.testing.assert_allclose(torque(spring, far), 380.16 * far, rtol=1e-11)


@given(exponent=st.floats(-12.0, 6.0), sign=st.sampled_from([-1.0, 1.0]), beta=st.floats(1e-2, 1e6))
@settings(max_examples=50)
def test_eq_12_and_its_gradients_are_finite_everywhere(exponent: float, sign: float, beta: float) -> None:
    values = {"k": 380.16, "alpha": 0.31, "beta": beta, "d": 0.3}
    p = {name: tensor([value]).requires_grad_() for name, value in values.items()}
    delta = tensor([sign * 10.0**exponent, 0.0]).requires_grad_()
    found = BacklashFlexibility().torque(SimpleNamespace(**p), delta, tensor([1.0, 1.0]), tensor([0.05]))
    assert torch.isfinite(found).all() and found[1] == 0.0
    grads = torch.autograd.grad(found.sum(), [delta, *p.values()])
    assert all(bool(torch.isfinite(g).all()) for g in grads)


def test_dead_zone_is_as_wide_as_its_gap_and_linear_beyond() -> None:
    play, compliance = Backlash(gap=0.02, compliance=1 / 400.0), 1 / 400.0
    stiff = 1.0 / (compliance + 1.0 / (0.05 * STIFFEST**2))
    delta = np.array([-0.03, -0.0101, -0.01, 0.0, 0.0099, 0.01, 0.015])
    expected = stiff * (delta - np.clip(delta, -0.01, 0.01))
    np.testing.assert_allclose(torque(play, delta), expected, rtol=1e-12, atol=1e-13)
    assert (torque(play, [-0.009, 0.0, 0.009], 5.0) == 0.0).all(), "no damping in the play"


@given(
    delta=st.floats(-0.05, 0.05),
    rate=st.floats(-20.0, 20.0),
    zeta=st.floats(0.0, 2.0),
    gap=st.floats(1e-3, 0.04),
)
@settings(max_examples=80)
def test_contact_never_pulls_and_takes_energy(delta: float, rate: float, zeta: float, gap: float) -> None:
    found = torque(Backlash(gap=gap, compliance=1e-3, zeta=zeta), delta, rate)[0]
    spring = torque(Backlash(gap=gap, compliance=1e-3, zeta=0.0), delta)[0]
    assert found * delta >= 0.0
    assert (found - spring) * rate >= 0.0
    assert abs(found) <= 2 * abs(spring) * (1 + 1e-12), "teeth meet without a jump of torque"


def test_gradient_to_the_gap_does_not_vanish_where_a_nested_fit_starts() -> None:
    gap = tensor([0.0]).requires_grad_()
    delta = tensor([0.001, -0.001, 0.0]).requires_grad_()
    p = SimpleNamespace(gap=gap, compliance=tensor([1e-3]), zeta=tensor([0.3]))
    found = Backlash().torque(p, delta, tensor([0.0, 0.0, 0.0]), tensor([0.05]))
    by_gap, by_delta = torch.autograd.grad(found[0] - found[1] + found[2], [gap, delta])
    assert by_gap.item() < -100.0
    assert by_delta[2] > 100.0, "without play the spring acts at zero deflection too"


def test_compliance_and_damping_ratio_are_a_linear_spring() -> None:
    stiffness, inertia, zeta = 250.0, 0.04, 0.2
    compliance = 1 / stiffness - 1 / (inertia * STIFFEST**2)
    linear = LinearSpring(k=stiffness, d=2 * zeta * np.sqrt(stiffness * inertia))
    delta, rate = np.array([-0.02, 0.0, 0.01]), np.array([0.3, -1.0, 2.0])
    np.testing.assert_allclose(
        torque(JointFlexibility(compliance=compliance, zeta=zeta), delta, rate, inertia),
        torque(linear, delta, rate, inertia), rtol=1e-12,
    )  # fmt: skip


def test_hardening_spring_is_cubic_and_linear_without_its_cube() -> None:
    delta = np.array([-0.05, 0.01, 0.2])
    found = torque(HardeningSpring(k=158.0, h=8261.0 / 158.0, d=0.6), delta, 0.5)
    np.testing.assert_allclose(found, 158.0 * delta + 8261.0 * delta**3 + 0.3, rtol=1e-13)
    linear = torque(HardeningSpring(k=158.0, d=0.6), delta, 0.5)
    np.testing.assert_array_equal(linear, torque(LinearSpring(k=158.0, d=0.6), delta, 0.5))


def test_link_friction_of_eq_9_opposes_motion_on_both_sides() -> None:
    law, v = AsymmetricTanh(f_a1=0.0063, f_a2=0.0056), np.array([-2.0, -0.01, 0.0, 0.01, 2.0])
    expected = np.where(v > 0, 0.0063, 0.0056) * np.tanh(70 * v)
    found = law.smooth(view(law), tensor(v)).numpy()
    np.testing.assert_allclose(found, expected, rtol=1e-14)
    assert (found * v >= 0).all()


def drive(transmission: Transmission, *, friction: float = 0.5) -> System:
    """A rotor and a link with dry friction, without motor friction, behind a gear of 50."""
    values = {"P_m1": 0.02, "P_m2": 0.05, "F_vm": 1e-4, "F_cm": 0.0, "F_va": 0.0}
    system = one_link_flexible(50.0).with_values(values)
    system = system.with_component("joint1/load", TwoInertias(J_m=1e-5, J_a=0.02))
    return system.with_component("joint1/link_friction", Coulomb(F_c=friction)).with_component(
        PLACE, transmission
    )


def free_run(system: System, u: np.ndarray, substeps: int = 0) -> dict[str, np.ndarray]:
    engine = with_substeps(system, Engine(), batch_of(system, {"u1": u}), stored(system))
    return run(system, {"u1": u}, engine=Engine(substeps=substeps or engine.substeps))


def test_lost_motion_of_a_reversal_is_the_gap() -> None:
    gap, friction = 0.03, 1.5
    u = np.concatenate([np.full(100, 3.0), np.full(100, -3.0)])
    x = free_run(drive(Backlash(gap=gap), friction=friction), u)
    deflection = x["q_m1"] / 50.0 - x["q_a1"]
    wound = 2 * friction / (STIFFEST**2 * 0.01)  # what the stiffest contact bends under the link's friction
    assert deflection[99] - deflection[199] == pytest.approx(gap, abs=wound)
    moved = np.flatnonzero(np.diff(x["q_a1"][100:]) < 0)[0] + 100
    rested = np.flatnonzero(x["v_a1"][100:] == 0.0) + 100
    assert rested.size > 5 and rested.max() <= moved + 1
    lost = (x["q_m1"][rested[0]] - x["q_m1"][rested[-1]]) / 50.0
    sample = STEP * np.abs(x["v_m1"]).max() / 50.0
    assert lost == pytest.approx(gap, abs=2 * sample + wound), "it rests while the rotor crosses the play"


@pytest.mark.parametrize("place", [True, False], ids=["compliance", "linear"])
def test_static_deflection_is_torque_over_stiffness(place: bool) -> None:
    k, load = 80.0, 4.0
    compliance = 1 / k
    spring = JointFlexibility(compliance=compliance, zeta=0.5) if place else LinearSpring(k=k, d=1.0)
    system = drive(spring, friction=0.0).with_values({"F_cm": 0.2}).with_component(
        "joint1/load", ConstantTorque(T_0=load)
    )  # fmt: skip
    x = free_run(system, np.zeros(250))
    assert (x["v_m1"] == 0.0).all(), "the rotor holds"
    series = 50.0**2 * 1e-5 * 0.02 / (50.0**2 * 1e-5 + 0.02)
    least = 1 / (series * STIFFEST**2) if place else 0.0
    assert x["q_m1"][-1] / 50.0 - x["q_a1"][-1] == pytest.approx(load * (compliance + least), rel=1e-5)


@pytest.mark.parametrize("part", [JointFlexibility(), Backlash()], ids=["flexibility", "backlash"])
def test_zero_compliance_and_zero_gap_are_the_rigid_gear(part: Transmission) -> None:
    k = np.arange(200)
    u = 6.0 * np.sin(0.03 * k) + 3.0 * np.sin(0.11 * k)
    rigid = one_link(100.0).with_values({"J": 2e-5, "P_m1": 0.02, "P_m2": 0.03, "F_c": 0.01})
    x = free_run(rigid.with_component(PLACE, part), u)
    reference = run(rigid, {"u1": u})
    error = np.abs(x["q_m1"] - reference["q_m1"])
    assert error.max() < 2e-3 * np.ptp(reference["q_m1"])


@pytest.mark.parametrize(
    "part",
    [Backlash(gap=0.04), BacklashFlexibility(**TABLE_4, d=0.4), HardeningSpring(k=100.0, h=300.0, d=0.3)],
    ids=lambda part: part.kind,
)
def test_steps_suit_the_loaded_spring_although_records_start_unloaded(part: Transmission) -> None:
    system, u = drive(part), 9.0 * np.sin(0.1 * np.arange(90))
    batch = batch_of(system, {"u1": u})
    loaded = fastest_rate(system, Engine(), batch, stored(system))
    assert loaded > 50.0
    coarse, fine = free_run(system, u), free_run(system, u, 24)
    for name in ("q_m1", "q_a1"):
        assert np.abs(coarse[name] - fine[name]).max() < 2e-3 * np.ptp(fine[name])
