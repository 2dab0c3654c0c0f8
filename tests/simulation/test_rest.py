"""A link that nobody has measured begins where its load lets it rest."""

import numpy as np
import pytest
import torch
from drives import flexible_drive, rigid_drive

from hybrid_id.components import (
    Backlash,
    ConstantTorque,
    Coulomb,
    Gravity,
    JointFlexibility,
    KinematicError,
    MotorEncoder,
    PositionLoop,
)
from hybrid_id.records.record import Record
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.step import Engine
from hybrid_id.systems import System

NOISE = {"q_m1": 1e-4}
RATIO = 156.0


def standing(system: System, angle: float = 0.0, samples: int = 300):
    """A record in which nothing moves, and its free run."""
    time = 0.002 * np.arange(samples)
    motor = np.full(samples, angle * RATIO)
    u = {name: np.zeros(samples) for name in system.input_names}
    batch = make_batch(system, [Record("still", time, u, {"q_m1": motor})], noise_std=NOISE)
    return batch, simulate(system, Engine(substeps=8), batch)


SOFT = rigid_drive(Coulomb(F_c=0.05)).with_component(
    "joint1/transmission", JointFlexibility(compliance=1e-3, zeta=0.05)
)


@pytest.mark.parametrize(
    "system, angle, twist",
    [
        (SOFT.with_component("joint1/load", ConstantTorque(T_0=2.0)), 0.0, None),
        (SOFT.with_component("joint1/load", Gravity(G_l=1.5)), 0.5, None),
        (rigid_drive(Coulomb(F_c=0.05)).with_component("joint1/transmission", Backlash(gap=0.02))
            .with_component("joint1/load", ConstantTorque(T_0=0.5)), 0.0, 0.01),
        (flexible_drive().with_component("joint1/load", ConstantTorque(T_0=1.0)), 0.0, None),
    ],
    ids=["torque on a soft gear", "weight on a soft gear", "play on one side", "spring"],
)  # fmt: skip
def test_nothing_moves_where_nothing_moved(system: System, angle: float, twist: float | None) -> None:
    batch, run = standing(system, angle)
    joint = system.joints[0]
    motor, link = joint.positions
    start = float(batch.x[0, 0, link] - batch.x[0, 0, motor] / RATIO)
    assert abs(start) > 1e-4
    if twist is not None:
        assert abs(start) == pytest.approx(twist, rel=1e-2)
    assert float((run.x[0, :, link] - batch.x[0, 0, link]).abs().max()) < 0.02 * abs(start)
    assert float(batch.x0_std[0, link]) >= abs(start)


def test_without_a_load_it_is_where_the_rotor_is() -> None:
    batch, _ = standing(SOFT)
    motor, link = SOFT.joints[0].positions
    assert torch.equal(batch.x[..., link], batch.x[..., motor] / RATIO)


def test_friction_at_the_link_may_hold_its_load() -> None:
    held = SOFT.with_component("joint1/load", ConstantTorque(T_0=0.5)).with_component(
        "joint1/link_friction", Coulomb(F_c=1.0)
    )
    batch, _ = standing(held)
    motor, link = held.joints[0].positions
    assert torch.equal(batch.x[..., link], batch.x[..., motor] / RATIO)


def test_an_error_of_the_gear_puts_the_link_where_it_is_unloaded() -> None:
    bent = SOFT.with_component("joint1/transmission", KinematicError(E_c=0.01, E_s=0.0, n=1.0))
    batch, _ = standing(bent, 0.3)
    motor, link = bent.joints[0].positions
    p = bent.views(list(bent.theta().detach()[:, None]))
    wanted = bent.joints[0].gear.map(batch.x[0, :1, motor], p)[0]
    assert float(batch.x[0, 0, link]) == pytest.approx(float(wanted), abs=1e-6)
    assert float(batch.x[0, 0, link]) != pytest.approx(0.3, abs=1e-4)


def test_a_position_loop_compares_its_goal_with_what_its_encoder_reads() -> None:
    servo = rigid_drive(ratio=1.0).with_component("joint1/input", PositionLoop())
    servo = servo.with_component("joint1/sensor", MotorEncoder(offset=0.7))
    ones = np.ones(200)
    u = {"goal1": 0.9 * ones, "gain1": 400.0 * ones, "supply1": 12.0 * ones}
    batch = make_batch(
        servo, [Record("held", 0.002 * np.arange(200), u, {"q_m1": 0.9 * ones})], noise_std=NOISE
    )
    run = simulate(servo, Engine(substeps=8), batch)
    assert float((run.y[0, :, 0] - 0.9).abs().max()) < 1e-9  # at its goal: no duty
