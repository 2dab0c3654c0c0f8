"""Every formula of every effect changes the motion, scales, and knows its place."""

import numpy as np
import pytest

from hybrid_id.machines.effects import CATALOGUE, OUTSIDE, Effect
from hybrid_id.machines.effects.load import WithheldCoupling
from hybrid_id.machines.effects.transmission import SoftGear
from hybrid_id.machines.physics.bench import replay
from hybrid_id.machines.robots import SYSTEMS, Robot, draw_robot

FORMULAS = [k for kinds in (*CATALOGUE.values(), OUTSIDE) for k in kinds if set(k.systems) & set(SYSTEMS)]
"""Those of drives; the arms' are met in test_make.py and test_trials.py."""


def robot_for(kind: type[Effect]) -> Robot:
    """The simplest machine that can have an effect."""
    for seed in range(20):
        for system in SYSTEMS:
            robot = draw_robot(np.random.default_rng(seed), system)
            if system in kind.systems and kind.fits(robot):
                return robot
    raise AssertionError(f"{kind.__name__} fits no machine")


def motion(robot: Robot, *effects: Effect) -> np.ndarray:
    """Rotor angles (T, n_joints) of a machine that is driven hard, with reversals and a rest."""
    time = 0.004 * np.arange(450)
    wave = np.sin(2 * np.pi * 0.7 * time) + 0.5 * np.sin(2 * np.pi * 2.3 * time + 1)
    wave = np.where((time < 0.1) | (time > 1.6), 0.0, wave)
    volts = np.repeat(0.8 * robot.supply * wave[:, None, None], robot.joints, axis=1)
    for effect in effects:
        robot = effect.alter(robot)
    machine = robot.assemble(substeps=4)
    for effect in effects:
        effect.install(machine, robot)
    return replay(machine, volts, sample_time=0.004)[:, :, 0]


@pytest.mark.parametrize("kind", FORMULAS, ids=lambda kind: kind.__name__)
def test_formula_changes_the_motion_more_when_it_is_larger(kind: type[Effect]) -> None:
    robot = robot_for(kind)
    effect = kind.draw(np.random.default_rng(2), robot, robot.joints - 1)
    truth = effect.alter(robot)
    lacking = truth.with_values(dict.fromkeys(truth.lacks, 0.0))
    base = motion(lacking if effect.alter(robot) is not robot else robot)
    changes = [np.abs(motion(robot, effect.scaled(f)) - base).max() for f in (0.3, 1.0)]
    assert np.isfinite(changes).all()
    assert changes[1] > changes[0] > 0
    assert changes[1] > 0.02  # rad of the rotor; encoders count 0.1 rad and more
    assert effect.where.startswith("joint")
    assert all(np.isfinite(value) for value in effect.size().values())


def test_an_uncoupled_second_link_has_no_inertia_to_be_parted_from_its_rotor() -> None:
    robot = draw_robot(np.random.default_rng(0), "two_link")
    uncoupled = WithheldCoupling.draw(np.random.default_rng(0), robot, 0).alter(robot)
    assert not SoftGear.acts_at(uncoupled, 1)
    assert SoftGear.acts_at(uncoupled, 0) and SoftGear.acts_at(robot, 1)
