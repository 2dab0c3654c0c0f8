"""Laws against their equations worked out by hand; equation numbers are the paper's."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from torch import Tensor

from hybrid_id.components import (
    AsymmetricStribeck,
    AsymmetricStribeckEq8,
    ConstantTorque,
    Coulomb,
    CurrentCommand,
    CurrentMotor,
    DCMotor,
    DutySupply,
    FloorContact,
    Gravity,
    LinearSpring,
    LoadDependent,
    LocalFriction,
    MaxwellSlip,
    MotorEncoder,
    OneLink,
    PositionDependent,
    PositionLoop,
    PositionServo,
    Saturation,
    SoftSaturation,
    Spring,
    Stribeck,
    TorqueCommand,
    TorqueMotor,
    TwoInertias,
    UnsignedCurrent,
    Viscous,
)
from hybrid_id.components.base import Component
from hybrid_id.components.bristle import relax
from hybrid_id.components.friction.dahl import Dahl
from hybrid_id.components.friction.lugre import LuGre
from hybrid_id.components.motor.free_rotor import FreeRotor
from hybrid_id.errors import InputError

SPEED = np.array([-400.0, -60.0, -8.0, -0.5, 0.5, 8.0, 60.0, 400.0])
TABLE_2 = {
    "f_11": 0.0121, "f_12": 0.0293, "f_13": 5.0, "f_14": 53.0,
    "f_21": 0.0132, "f_22": 0.0311, "f_23": 6.5, "f_24": 49.0, "f_3": 5.04e-5,
}  # fmt: skip


def tensor(values: object) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


def view(part: Component) -> SimpleNamespace:
    return SimpleNamespace(**{n: v.detach() for n, v in vars(part.view()).items()})


def sliding(part: Component, speed: np.ndarray) -> np.ndarray:
    """Friction torque of a law in motion."""
    v, p = tensor(speed), view(part)
    dry = part.dry(p, v.abs(), (v > 0).double())  # type: ignore[operator]
    smooth = part.smooth(p, v)  # type: ignore[operator]
    return sum(t.numpy() for t in (smooth, None if dry is None else dry * v.sign()) if t is not None)


@pytest.mark.parametrize("form", [AsymmetricStribeck, AsymmetricStribeckEq8])
def test_asymmetric_stribeck_eq_8_and_15(form: type[AsymmetricStribeck]) -> None:
    f = TABLE_2 if form is AsymmetricStribeck else TABLE_2 | {"f_14": 53.0**2, "f_24": 49.0**2}
    expected = []
    for v in SPEED:
        far, peak, centre, width = (f[f"f_{1 if v > 0 else 2}{k}"] for k in (1, 2, 3, 4))
        fall = (
            ((abs(v) - centre) / width) ** 2 if form is AsymmetricStribeck else (abs(v) - centre) ** 2 / width
        )
        expected.append(np.sign(v) * (far + (peak - far) * np.exp(-fall)) + f["f_3"] * v)  # eq. (11), (16)
    np.testing.assert_allclose(sliding(form(**f), SPEED), expected, rtol=1e-13)


@pytest.mark.parametrize("exponent", [0.5, 1.0, 2.0])
def test_coulomb_stribeck_viscous_make_eq_6(exponent: float) -> None:
    law = [Coulomb(F_c=0.01), Stribeck(F_drop=0.006, v_s=12.0, p=exponent), Viscous(F_v=5e-5)]
    level = 0.01 + (0.016 - 0.01) * np.exp(-(np.abs(SPEED / 12.0) ** exponent))
    np.testing.assert_allclose(
        sum(sliding(p, SPEED) for p in law), level * np.sign(SPEED) + 5e-5 * SPEED, rtol=1e-11
    )


def test_dahl_eq_7_rises_from_rest_to_coulomb() -> None:
    # at constant speed dF/dx = sigma (1 - F / F_c), so F = F_c (1 - exp(-sigma x / F_c)) whatever the speed
    law, level, steps = Dahl(sigma=1.5), tensor([0.02, 0.02]), 40
    v, h, force = tensor([0.1, 3.0]), tensor([0.01, 0.01 / 30]), tensor([0.0, 0.0])
    for k in range(1, steps + 1):
        force = relax(force, *law.state_updates(view(law), [force], v, level)[0], h)
        expected = 0.02 * (1 - np.exp(-1.5 * 0.001 * k / 0.02))
        np.testing.assert_allclose(force.numpy(), expected, rtol=1e-12)
    force = relax(force, *law.state_updates(view(law), [force], v, level)[0], h * 1e4)
    np.testing.assert_allclose(force.numpy(), 0.02, rtol=1e-12)


def test_lugre_steady_state_is_the_stribeck_curve() -> None:
    level = sliding(Coulomb(F_c=0.01), SPEED) + sliding(Stribeck(F_drop=0.02, v_s=20.0), SPEED)
    law, v = LuGre(sigma_0=2.0, sigma_1=1e-3), tensor(SPEED)
    (pair,) = law.state_updates(view(law), [0 * v], v, tensor(np.abs(level)))
    state = relax(0 * v, *pair, tensor(10.0))
    np.testing.assert_allclose(
        law.torque(view(law), [state], v, tensor(np.abs(level))).numpy(), level, rtol=1e-12
    )


def test_maxwell_slip_against_springs_that_slide_at_once() -> None:
    # Iwan's springs, each clipped at its level; the law's go over smoothly within 0.3 of theirs
    law, level, h = MaxwellSlip(sigma=0.04), tensor([0.02]), 1e-3
    limits, speeds = 0.02 * np.array([1, 2, 3]) / 6, 8.0 * np.cos(2 * np.pi * 0.7 * np.arange(0, 4, h))
    states, forces, found, expected = [tensor([0.0])] * 3, np.zeros(3), [], []
    for speed in speeds:
        pairs = law.state_updates(view(law), states, tensor([speed]), level)
        states = [relax(own, *pair, tensor([h])) for own, pair in zip(states, pairs, strict=True)]
        forces = np.clip(forces + 0.04 / 3 * speed * h, -limits, limits)
        found.append(law.torque(view(law), states, tensor([speed]), level).item())
        expected.append(forces.sum())
    assert np.abs(np.subtract(found, expected)).max() < 0.1 * 0.02
    assert max(found) > 0.99 * 0.02 and min(found) < -0.99 * 0.02
    # a turn below the first spring's level gives its energy back
    held = [tensor([0.001])] * 3
    for speed in (0.1, -0.1):
        pairs = law.state_updates(view(law), held, tensor([speed]), level)
        held = [relax(own, *pair, tensor([h])) for own, pair in zip(held, pairs, strict=True)]
    assert [force.item() for force in held] == pytest.approx([0.001] * 3, rel=1e-12)


def test_dc_motor_eq_3_with_table_1() -> None:
    # Table 1: k_m = 0.0254 N m/A and R = 1.333 Ohm give P_m1 = 19.06 mN m/V; no-load speed at 24 V is 945 rad/s
    motor = DCMotor(P_m1=0.0254 / 1.333, P_m2=0.0254)
    p, u = view(motor), tensor([24.0])
    assert motor.torque(p, u, tensor([0.0])).item() == pytest.approx(24 * 0.019055, rel=1e-4)
    no_load = tensor([24 / 0.0254])
    assert no_load.item() == pytest.approx(945, abs=0.5)
    assert motor.torque(p, u, no_load).item() == pytest.approx(0.0, abs=1e-15)
    current = motor.current(p, motor.torque(p, u, tensor([300.0])))
    assert current.item() == pytest.approx((24.0 - 0.0254 * 300.0) / 1.333)
    assert motor.torque(p, u, tensor([300.0])).item() == pytest.approx(0.0254 * current.item())


def test_motors_behind_current_and_torque_loops() -> None:
    command, speed = tensor([0.8]), tensor([100.0])
    motor = CurrentMotor(k_t=0.05)
    assert motor.torque(view(motor), command, speed).item() == pytest.approx(0.04)
    assert motor.current(view(motor), tensor([0.04])).item() == pytest.approx(0.8)
    ideal = TorqueMotor()
    assert ideal.torque(view(ideal), command, speed).item() == 0.8
    assert ideal.current(view(TorqueMotor(k_t=0.05)), tensor([0.04])).item() == pytest.approx(0.8)
    with pytest.raises(InputError, match="free_rotor has no current output"):
        FreeRotor().current(view(FreeRotor()), command)


def test_inputs_turn_channels_into_the_command() -> None:
    angle, speed = tensor([0.2]), tensor([7.0])
    channels = {"duty": tensor([-0.5]), "supply": tensor([11.0]), "tau": tensor([0.3]), "i": tensor([2.0])}
    for part, expected in ((DutySupply(), -5.5), (TorqueCommand(), 0.3), (CurrentCommand(), 2.0)):
        assert part.command(view(part), channels, angle, speed).item() == expected


def test_position_loop_is_proportional_and_clips() -> None:
    part = PositionLoop(duty_per_rad=0.003)
    goal, supply = tensor([0.3, 9.0, -9.0]), tensor([12.0, 12.0, 12.0])
    channels = {"goal": goal, "gain": tensor([100.0, 100.0, 100.0]), "supply": supply}
    command = part.command(view(part), channels, tensor([0.1, 0.1, 0.1]), 0 * goal)
    np.testing.assert_allclose(command, [0.003 * 100 * 0.2 * 12.0, 12.0, -12.0], rtol=1e-14)


def test_position_servo_has_a_dead_band_a_limit_and_goals_within_its_angles() -> None:
    part = PositionServo(k_p=8.0, k_d=0.5, tau_max=2.0, e_0=0.01, goal_min=-1.0, goal_max=1.0)
    goal, angle, speed = (
        tensor([0.105, 0.11, 0.6, -3.0]),
        tensor([0.1, 0.0, 0.0, -0.9]),
        tensor([0, 1.0, 0, 0]),
    )
    torque = part.command(view(part), {"goal": goal}, angle, speed)
    np.testing.assert_allclose(torque, [0.0, 8.0 * 0.1 - 0.5, 2.0, -8.0 * 0.09], atol=1e-14)


def test_a_floor_pushes_upwards_only() -> None:
    floor = FloorContact("hand", z_f=-0.03, k_f=500.0)
    force = floor.force(view(floor), tensor([0.1, -0.03, -0.04]))
    np.testing.assert_allclose(force, [0.0, 0.0, 5.0], atol=1e-12)


def test_loads_springs_and_sensors() -> None:
    r, p = 10.0, view(OneLink(J=3e-5, rotor_share=0.25))
    assert OneLink().rotor(p, r).item() == pytest.approx(0.75e-5)
    assert OneLink().link(p, r).item() == pytest.approx(2.25e-5 * r**2)
    two = TwoInertias(J_m=1e-5, J_a=0.02)
    assert (two.rotor(view(two), r).item(), two.link(view(two), r).item()) == (1e-5, 0.02)
    gravity, spring = Gravity(G_l=2.0), LinearSpring(k=100.0, d=0.5)
    assert gravity.torque(view(gravity), tensor([np.pi / 6]), tensor([9.0])).item() == pytest.approx(1.0)
    assert spring.torque(view(spring), tensor([0.01]), tensor([0.2]), tensor([0.1])).item() == pytest.approx(
        1.1
    )
    pull, bias = Spring(k_s=3.0, q_s=0.5), ConstantTorque(T_0=-0.2)
    assert pull.torque(view(pull), tensor([0.7]), tensor([9.0])).item() == pytest.approx(0.6)
    assert bias.torque(view(bias), tensor([0.7, 0.8]), tensor([9.0, 1.0])).tolist() == [-0.2, -0.2]
    assert MotorEncoder().read(view(MotorEncoder(offset=0.3)), tensor([1.0])).item() == pytest.approx(1.3)
    assert LoadDependent(mu=0.2).load_factor(view(LoadDependent(mu=0.2))).item() == 0.2
    amperes = UnsignedCurrent(i_0=0.1)
    assert amperes.read(view(amperes), tensor([-0.5, 0.5])).tolist() == pytest.approx([0.6, 0.6])


def test_friction_over_the_angle() -> None:
    angle = tensor([0.0, 0.3, np.pi / 2])
    waves = PositionDependent(A_0=0.02, A_c=0.01, A_s=-0.005, n=2.0)
    expected = 0.02 + 0.01 * np.cos(2 * angle.numpy()) - 0.005 * np.sin(2 * angle.numpy())
    np.testing.assert_allclose(waves.dry_over(view(waves), angle), expected, rtol=1e-14)
    spot = LocalFriction(A=0.03, q_0=0.3, w=0.1)
    level = spot.dry_over(view(spot), tensor([0.3, 0.4, 0.2, 2.0])).numpy()
    np.testing.assert_allclose(level, [0.03, 0.03 / np.e, 0.03 / np.e, 0.0], atol=1e-12)


def test_a_soft_limit_is_hard_at_large_sharpness_and_transparent_below() -> None:
    u = tensor([-30.0, -10.0, -1.0, 0.0, 1.0, 10.0, 30.0, 1e6])
    soft, speed = SoftSaturation(V_max=10.0, n=8.0), torch.zeros_like(u)
    found = soft.map(view(soft), u, speed)
    np.testing.assert_allclose(found, u / (1 + (u / 10.0).abs() ** 8) ** (1 / 8), rtol=1e-12, atol=1e-12)
    assert found[5].item() == pytest.approx(10.0 * 2 ** (-1 / 8))
    sharp, hard = SoftSaturation(V_max=10.0, n=50.0), Saturation(V_max=10.0)
    np.testing.assert_allclose(
        sharp.map(view(sharp), u, speed), hard.map(view(hard), u, speed), rtol=0.015, atol=1e-12
    )
