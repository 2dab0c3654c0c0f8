"""Every formula of every effect changes the motion, scales, and knows its place."""

import numpy as np
import pytest

from hybrid_id.machines.effects import CATALOGUE, OUTSIDE, Effect
from hybrid_id.machines.effects.load import WithheldCoupling
from hybrid_id.machines.effects.transmission import SoftGear
from hybrid_id.machines.physics.bench import replay
from hybrid_id.machines.robots import SYSTEMS, Robot, draw_robot

NAMES = {
    "delay": "input",
    "voltage_deadband": "input",
    "voltage_saturation": "input",
    "supply_sag": "input",
    "electrical_lag": "motor",
    "cogging": "motor",
    "thermal_derating": "motor",
    "coulomb_friction": "motor_friction link_friction",
    "viscous_friction": "link_friction",
    "stribeck_friction": "motor_friction",
    "asymmetric_friction": "motor_friction",
    "presliding_friction": "motor_friction",
    "quadratic_drag": "motor_friction link_friction",
    "load_dependent_friction": "motor_friction",
    "position_dependent_friction": "motor_friction link_friction",
    "backlash": "transmission",
    "joint_flexibility": "transmission",
    "hardening_flexibility": "transmission",
    "kinematic_error": "transmission",
    "gravity_load": "load",
    "spring_load": "load",
    "constant_torque": "load",
    "joint_coupling": "load",
}
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


def test_every_name_has_formulas_in_its_places() -> None:
    places = {
        name: dict.fromkeys(k.place for k in kinds if k in FORMULAS) for name, kinds in CATALOGUE.items()
    }
    assert {name: " ".join(one) for name, one in places.items() if one} == NAMES
    assert places.keys() - NAMES.keys() == {"encoder_zero", "goal_rate_limit", "link_mass"}  # of arms
    assert all(kind.name == "unknown" for kind in OUTSIDE)
    assert len([kind for kind in OUTSIDE if kind in FORMULAS]) >= 12
    assert len({kind.__name__ for kind in FORMULAS}) == len(FORMULAS)


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


def test_formulas_of_one_name_differ() -> None:
    for name, kinds in CATALOGUE.items():
        if name == "delay":  # before the amplifier or behind the encoder: the same without a controller
            continue
        kinds = [k for k in kinds if k in FORMULAS]
        here = [k for k in kinds if k.systems == kinds[0].systems and k.place == kinds[0].place]
        if not here:
            continue
        robot = robot_for(here[0])
        if len(here) > 1 and set(here[0].sized) == set(here[1].sized):
            effect = here[0].draw(np.random.default_rng(2), robot, robot.joints - 1)
            try:
                other = here[1](effect.joint, effect.values)
                assert np.abs(motion(robot, effect) - motion(robot, other)).max() > 1e-4
            except KeyError:
                pass  # they do not share their values


def test_an_uncoupled_second_link_has_no_inertia_to_be_parted_from_its_rotor() -> None:
    robot = draw_robot(np.random.default_rng(0), "two_link")
    uncoupled = WithheldCoupling.draw(np.random.default_rng(0), robot, 0).alter(robot)
    assert not SoftGear.acts_at(uncoupled, 1)
    assert SoftGear.acts_at(uncoupled, 0) and SoftGear.acts_at(robot, 1)
