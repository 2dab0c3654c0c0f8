"""Laws by their limiting cases."""

import numpy as np
import pytest

from hybrid_id.machines.effects import Effect, friction
from hybrid_id.machines.effects.motor import DeadZone, HardLimit, InputDelay, SoftLimit, Threshold
from hybrid_id.machines.effects.transmission import FlatTeeth, PlayBeforeSpring, RoundTeeth
from hybrid_id.machines.physics.friction import Coulomb, LuGre, MaxwellSlip
from hybrid_id.machines.physics.law import Push, Signals
from hybrid_id.machines.physics.motor import Motor
from hybrid_id.machines.physics.transmission import Gear
from hybrid_id.machines.robots import draw_robot


def slide(law, path: np.ndarray, step: float = 1e-3) -> np.ndarray:
    """Friction (T,) along a path of angles (T,)."""
    x, found = Signals(1), []
    law.start(1)
    for speed in np.diff(path) / step:
        x.v_m, x.step, push = np.array([speed]), step, Push()
        law.act(push, x)
        found.append(-float(np.squeeze(push.torque)))
    return np.array(found)


@pytest.mark.parametrize("law", [LuGre(2.0, 5.0), LuGre(2.0, 5.0, 0.002), MaxwellSlip(2.0, 5.0)])
def test_bristles_slide_at_coulombs_level_and_turn_with_memory(law) -> None:
    there = np.linspace(0, 6, 1200)
    force = slide(law, np.concatenate([there, there[::-1]]))
    assert force[1198] == pytest.approx(2.0, rel=5e-3)
    assert force[-1] == pytest.approx(-2.0, rel=5e-3)
    assert abs(force[1198 + 50]) < 1.9  # it builds up over a deflection
    assert abs(force[0]) < 0.1


@pytest.mark.parametrize("shape", ["Exponential", "Gaussian", "Lorentzian"])
def test_stribeck_falls_from_breakaway_to_coulomb(shape: str) -> None:
    levels = []
    for speed in (0.0, 5.0, 1e4):
        x, push = Signals(1), Push()
        x.v_m = np.array([speed])
        Coulomb(1.0).act(push, x)
        getattr(friction, f"Stribeck{shape}")(0, {"drop": 0.6, "v_s": 5.0}).act(push, x)
        levels.append(float(np.squeeze(push.plus)))
    assert levels[0] == pytest.approx(1.6)
    assert levels[2] == pytest.approx(1.0, abs=1e-3)
    assert levels[2] < levels[1] < levels[0]


def test_amplifiers() -> None:
    x, volts = Signals(3), np.array([-0.5, 0.8, 3.0])
    assert Threshold(0, {"volts": 0.7}).volts(volts, x) == pytest.approx([0, 0.8, 3.0])
    assert DeadZone(0, {"volts": 0.7}).volts(volts, x) == pytest.approx([0, 0.1, 2.3])
    limits = {"supply": 1.4, "excess": 1.0}
    assert HardLimit(0, limits).volts(volts, x) == pytest.approx([-0.5, 0.7, 0.7])
    soft = SoftLimit(0, limits | {"excess": 0.4}).volts(volts, x)
    assert soft[0] == pytest.approx(-0.5, abs=0.01)
    assert soft[2] == pytest.approx(1.0, abs=0.01)


def test_delay_reads_the_sample_that_was_held_then() -> None:
    x = Signals(1)

    def delayed(delay: float) -> np.ndarray:
        return InputDelay(0, {"delay": delay}).volts(np.array([5.0]), x)

    x.history, x.sample_time, x.time = np.arange(10.0)[:, None], 0.1, 0.55
    x.step = 0.02
    assert delayed(0.0)[0] == pytest.approx(5.0)
    assert delayed(0.25)[0] == pytest.approx(2.5)  # it changes in the middle of the step
    assert delayed(0.2)[0] == pytest.approx(3.0)
    assert delayed(0.6)[0] == pytest.approx(0.0)
    # in one step a sample, too, each fraction of it makes a difference
    x.step = x.sample_time
    late = [delayed(0.1 * share)[0] for share in (0.0, 0.3, 0.7, 1.0, 1.3)]
    assert late == pytest.approx([5.0, 4.7, 4.3, 4.0, 3.7])


def test_lagging_winding_rises_as_one_less_exponential() -> None:
    motor, x = Motor(0.01, 0.0, lag=0.02), Signals(1)
    motor.start(1)
    x.volts, x.step, impulse = np.array([5.0]), 1e-3, 0.0
    for _ in range(30):
        push = Push()
        motor.act(push, x)
        impulse += 1e-3 * float(np.squeeze(push.torque))
    assert impulse == pytest.approx(0.05 * (0.03 - 0.02 * (1 - np.exp(-1.5))), rel=1e-9)


def test_warm_winding_gives_less() -> None:
    motor, x = Motor(0.01, 0.0, heating=1000.0, cooling=0.5), Signals(1)
    motor.start(1)
    x.volts, x.step = np.array([5.0]), 1e-2
    torques = []
    for _ in range(400):
        push = Push()
        motor.act(push, x)
        torques.append(float(np.squeeze(push.torque)))
    end = torques[-1]
    assert torques[0] == pytest.approx(0.05)
    assert 0.05 / end - 1 == pytest.approx(1000.0 * 0.5 * end**2, rel=1e-3)  # its own steady state


@pytest.mark.parametrize("kind", [FlatTeeth, RoundTeeth, PlayBeforeSpring])
def test_teeth_push_beyond_the_gap_only_and_never_pull(kind: type[Effect]) -> None:
    robot = draw_robot(np.random.default_rng(0), "one_link_flexible")
    spring = kind(0, {"gap": 0.02, "contact": 100.0, "loss": 2.0}).law(robot)
    twist = np.array([-0.03, -0.011, -0.009, 0.0, 0.009, 0.011, 0.03])
    still = spring.torque(twist, np.zeros(7), 1e-3)
    assert np.all(still[2:5] == 0)
    assert np.all(np.sign(still) == np.where(np.abs(twist) > 0.01, np.sign(twist), 0))
    assert np.all(spring.torque(twist, -1e3 * np.sign(twist), 1e-3) * twist >= 0)


def test_derivatives_of_a_gear_with_errors() -> None:
    gear, q, h = Gear(50.0, (1e-3, 3e-4), (2.0, 4.0), (0.3, 1.0)), np.linspace(-5, 5, 41), 1e-5
    slope = (gear.angle(q + h) - gear.angle(q - h)) / (2 * h)
    curvature = (np.asarray(gear.slope(q + h)) - np.asarray(gear.slope(q - h))) / (2 * h)
    assert gear.slope(q) == pytest.approx(slope, rel=1e-6)
    assert gear.curvature(q) == pytest.approx(curvature, rel=1e-5, abs=1e-9)
    assert gear.angle(np.zeros(1)) == pytest.approx(0)
