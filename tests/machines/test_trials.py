"""Trials: machines side by side, their re-fits, and that a joint by itself moves as in MuJoCo."""

from dataclasses import replace

import numpy as np
import pytest

from hybrid_id.machines import arm as arms
from hybrid_id.machines import draw, draw_arm, experiments
from hybrid_id.machines.effects import CATALOGUE, OUTSIDE, Effect
from hybrid_id.machines.effects.arm import ArmOutside, ArmSoftGear, ArmStribeck, GoalRateLimit
from hybrid_id.machines.effects.friction import PreslidingDahl, StribeckGaussian, UnevenBoth, WithheldCoulomb
from hybrid_id.machines.effects.load import Bias
from hybrid_id.machines.effects.transmission import SoftGear
from hybrid_id.machines.joint import JointTrials
from hybrid_id.machines.physics.bench import Encoders, Flaws
from hybrid_id.machines.physics.law import Push, Signals
from hybrid_id.machines.robots import SYSTEMS, Robot, draw_robot
from hybrid_id.machines.trials import Simulator, Trials

RNG = np.random.default_rng(0)
ROBOT = draw_robot(RNG, "one_link")


def trials_of(robot: Robot, effects: list[Effect], seed: int = 4) -> Trials:
    campaign = experiments.draw_campaign(np.random.default_rng(seed), robot, lengths=(300, 400))
    return Trials(robot, effects, campaign)


def test_lanes_are_the_machines_one_by_one_and_the_right_simulator_fits_to_the_floor() -> None:
    rng = np.random.default_rng(4)
    robot = draw_robot(rng, "one_link")
    trials = trials_of(robot, [kind.draw(rng, robot, 0) for kind in (StribeckGaussian, Bias, SoftGear)])
    drift = np.full((1, 8), 1.02)
    sizes = [(0.0, 0.0, 0.0), (0.7, 0.0, 0.0), (0.5, 0.4, 0.0), (0.5, 0.0, 1.0)]
    together = trials.record(sizes, drift)
    for own, measured in zip(sizes, together, strict=True):
        np.testing.assert_allclose(measured.angles, trials.record([own], drift)[0].angles, atol=1e-9)
    wrong = {name: 1.2 * value for name, value in trials.true.items()}
    right = Simulator(2, (0.8, 0.2, 0.0), wrong, free=(0, 1))
    lacking = Simulator(2, sizes[0], trials.true)
    fits = trials.fit([right, lacking], together, rounds=40)
    floor = trials.floors([sizes[2]], [together[2]])[0]
    assert fits[0].train < fits[1].train and fits[0].test < 1.3 * floor.test
    assert trials.with_values(fits[0], 1).values["bias"] == pytest.approx(
        0.4 * trials.effects[1].values["bias"], rel=0.1
    )


@pytest.mark.parametrize(
    "kind", [k for k in OUTSIDE if set(k.systems) & set(SYSTEMS)], ids=lambda kind: kind.__name__
)
def test_every_effect_without_a_name_can_be_fitted(kind: type[Effect]) -> None:
    rng = np.random.default_rng(3)
    robot = draw_robot(rng, next(name for name in ("one_link", "one_link_flexible") if name in kind.systems))
    trials = trials_of(robot, [kind.draw(rng, robot, 0)])
    made = trials.record([(1.0,)], np.ones((1, 8)))
    fit = trials.fit([Simulator(0, (1.5,), trials.true, free=(0,))], made, rounds=3)[0]
    assert np.isfinite(fit.train) and np.isfinite(fit.test)


def test_friction_of_any_size_takes_energy_and_wind_lets_the_joint_rest() -> None:
    push, x = Push(), Signals(1)
    x.v_m = np.array([100.0])
    UnevenBoth.draw(RNG, ROBOT, 0).scaled(8.0).law(ROBOT).act(push, x)
    assert 0 < abs(push.torque) < 100.0 * ROBOT.value(0, "F_v")
    assert max(push.plus, push.minus) < ROBOT.value(0, "F_c")


def test_nominal_arms_have_a_mass_matrix() -> None:
    for seed in range(300):
        rng = np.random.default_rng(seed)
        arm = draw_robot(rng, "two_link").model(rng, 0.3)["parameters"]
        P_1, P_2, P_3, P_4 = (arm[f"P_{k}"]["nominal"] for k in (1, 2, 3, 4))
        assert P_4 < P_2
        for cosine in (-1.0, 0.0, 1.0):
            assert (P_1 + 2 * cosine * P_3) * P_2 > (P_4 + cosine * P_3) ** 2


def test_effects_that_exclude_each_other_never_meet() -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        robot = draw_robot(rng, "one_link")
        leaders = draw._draw_leaders(rng, robot, "pair", [], messy=True)
        effects = [*leaders, *draw._draw_small(rng, robot, leaders)]
        assert len(leaders) >= draw.LEADERS["pair"] and len(effects) >= len(leaders) + draw.FEWEST
        assert sum(effect.replaces for effect in effects) <= 1
        assert sum(isinstance(effect, PreslidingDahl | WithheldCoulomb) for effect in effects) <= 1
        assert len({type(effect) for effect in effects}) == len(effects)


def test_encoders_miss_counts_and_are_eccentric_and_late() -> None:
    true, before = np.array([[1.0], [2.0]]), np.array([[0.8], [1.0]])
    lost = np.zeros((3, 2, 1))
    lost[1, 0] = 0.5
    flaws = Flaws(np.array([0.0, 0.1]), np.array([0.0, 0.3]), np.array([0.25, 0.0]), lost)
    seen = Encoders(np.full(2, 1e-9), np.zeros((3, 2, 1)), flaws=flaws).read(1, true, before)
    assert seen[:, 0] == pytest.approx([1.0 - 0.25 * 0.2 + 0.5, 2.0 + 0.1 * (np.sin(2.3) - np.sin(0.3))])


@pytest.fixture
def short_arm(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("mujoco")
    monkeypatch.setattr(arms, "JOINTS", (2, 2))
    monkeypatch.setattr(draw_arm, "LENGTH", 1.5)
    monkeypatch.setattr(draw_arm, "TRAIN", 1)


@pytest.mark.parametrize("servo", [True, False])
def test_one_joint_by_itself_moves_as_in_mujoco(
    servo: bool, short_arm: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(arms, "SERVOS", float(servo))
    rng = np.random.default_rng(27205)
    arm = replace(arms.draw_arm(rng), jitter=1e-6, count=1e-6)
    effects = [ArmSoftGear.draw(rng, arm, 0), (GoalRateLimit if servo else ArmStribeck).draw(rng, arm, 1)]
    moved = draw_arm._moved(arm, effects, np.ones((2, 2)), draw_arm._campaign(rng, arm))
    assert moved is not None
    load = moved.carried(arm, [0.0, 0.0])
    for k, effect in enumerate(effects):
        joint = JointTrials(arm, k, [effect], moved, (load, 0.0 * load, 0.0 * load))
        right = joint.errors([Simulator(0, (1.0,), joint.true)], joint.measured)[0]
        lacking = joint.fit([Simulator(0, (0.0,), joint.true)], joint.measured, rounds=6)[0]
        assert joint.gap(right, "train") < 1e-4 and joint.gap(right, "test") < 3e-4
        assert joint.gap(lacking, "train") > 4 * joint.gap(right, "train")


@pytest.mark.parametrize("servo", [True, False])
def test_every_effect_of_an_arm_changes_its_motion(
    servo: bool, short_arm: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(draw_arm, "LENGTH", 0.5)
    monkeypatch.setattr(arms, "SERVOS", float(servo))
    rng = np.random.default_rng(27206)
    arm = replace(arms.draw_arm(rng), phase=np.zeros(2))
    campaign = draw_arm._campaign(rng, arm)
    still = draw_arm._moved(arm, [], np.ones((2, 2)), campaign)
    kinds = [k for kinds in (*CATALOGUE.values(), OUTSIDE) for k in kinds if k.fits(arm)]  # type: ignore[arg-type]
    assert len(kinds) == (15 if servo else 12)
    for kind in kinds:
        moved = draw_arm._moved(arm, [kind.draw(rng, arm, 1)], np.ones((2, 2)), campaign)  # type: ignore[arg-type]
        assert still is not None and moved is not None
        assert np.abs(moved.measured[:, 1] - still.measured[:, 1]).max() > 1e-4, kind
        assert issubclass(kind, ArmOutside) == (np.ptp(moved.trace[0]) > 0 or np.ptp(moved.trace[1]) > 0), (
            kind
        )
