"""Sub-steps follow the stiffness of the equations."""

import math

import numpy as np
import pytest
import torch
from drives import STEP, batch_of, flexible_drive, multisine, rigid_drive, stored

from hybrid_id.components import (
    Coulomb,
    CurrentCommand,
    CurrentMotor,
    Dahl,
    ElectricalLag,
    LuGre,
    ResidualNetwork,
)
from hybrid_id.simulation.solvers import memory_rate
from hybrid_id.simulation.stability import LIMIT, fastest_rate, with_substeps
from hybrid_id.simulation.step import MAX_SUBSTEPS, Engine
from hybrid_id.systems import System

FRICTION, LINK = "joint1/motor_friction", "joint1/link_friction"


def chosen(system: System, engine: Engine, step: float = STEP) -> int:
    batch = batch_of(system, {"u1": multisine(1, samples=200)}, step=step, start={"v_m1": 40.0})
    return with_substeps(system, engine, batch, stored(system)).substeps


def rate(system: System, engine: Engine) -> float:
    batch = batch_of(system, {"u1": multisine(1, samples=200)}, start={"v_m1": 40.0})
    return fastest_rate(system, engine, batch, stored(system))


def test_rate_of_a_rigid_drive_is_its_mechanical_pole() -> None:
    assert rate(rigid_drive(), Engine()) == pytest.approx((0.019 * 0.0254 + 5e-5) / 2e-5, rel=1e-6)


def test_rate_of_a_flexible_drive_is_its_eigenfrequency() -> None:
    system = flexible_drive().with_values({"d": 0.0, "F_va": 0.0, "F_vm": 0.0, "P_m2": 0.0})
    expected = math.sqrt(300.0 * (1 / (156.0**2 * 1.3e-5) + 1 / 0.09))
    assert rate(system, Engine()) == pytest.approx(expected, rel=1e-3)


def test_stiffer_smoothing_takes_more_sub_steps() -> None:
    # slope of tanh at rest: F_c / (J width) = 1000 1/s at 0.5 rad/s
    assert rate(rigid_drive(), Engine("smooth", width=0.5)) == pytest.approx(1000 + 26.6, rel=0.01)
    found = [chosen(rigid_drive(), Engine("smooth", width=w)) for w in (2.0, 0.5, 0.1, 0.02)]
    assert found == sorted(found) and found[0] < found[-1]
    assert found[1] == math.ceil(STEP * 1026.6 / LIMIT["smooth"])
    assert chosen(rigid_drive(), Engine("dry")) == 1


def test_sub_steps_follow_the_step_and_the_spring() -> None:
    stiff = flexible_drive().with_values({"k": 3e4})
    assert chosen(stiff, Engine()) > chosen(flexible_drive(), Engine())
    assert chosen(stiff, Engine(), step=4 * STEP) >= 3 * chosen(stiff, Engine())
    assert chosen(flexible_drive().with_values({"k": 1e9}), Engine()) == MAX_SUBSTEPS


@pytest.mark.parametrize("law", [Dahl(sigma=20.0), LuGre(sigma_0=20.0, sigma_1=0.0)])
def test_bristle_counts_as_the_spring_that_it_is_at_rest(law) -> None:
    system = rigid_drive(Coulomb(F_c=0.01)).with_component(FRICTION, law)
    assert rate(system, Engine()) == pytest.approx(math.sqrt(20.0 / 2e-5), rel=0.05)


def test_bristle_on_the_link_couples_to_the_link() -> None:
    law = LuGre(sigma_0=9e4, sigma_1=0.0)
    system = flexible_drive().with_component(LINK, Coulomb(F_c=0.5)).with_component(LINK, law)
    assert rate(system, Engine()) == pytest.approx(math.sqrt((9e4 + 300.0) / 0.09), rel=0.1)


def test_more_sub_steps_are_kept() -> None:
    assert chosen(rigid_drive(), Engine(substeps=7)) == 7


def test_a_rate_that_is_no_number_takes_the_most() -> None:
    system = rigid_drive()
    theta = torch.full_like(stored(system), math.nan)
    batch = batch_of(system, {"u1": np.ones(20)})
    assert with_substeps(system, Engine(), batch, theta).substeps == MAX_SUBSTEPS


def test_hidden_states_of_a_network_share_their_cell() -> None:
    system = rigid_drive().with_component("joint1/motor", ResidualNetwork(memory=2))
    assert rate(system, Engine()) == pytest.approx(rate(rigid_drive(), Engine()), rel=1e-6)
    batch = batch_of(system, {"u1": multisine(1, samples=200)}, start={"v_m1": 40.0})
    assert memory_rate(system, batch, stored(system)) == pytest.approx(100.0)


def test_a_lag_behind_a_current_command_adds_no_coupling() -> None:
    drive = rigid_drive().with_component("joint1/input", CurrentCommand())
    drive = drive.with_component("joint1/motor", CurrentMotor()).with_component(
        "joint1/motor", ElectricalLag()
    )
    batch = batch_of(drive, {"i1": 0.1 * multisine(1, samples=200)}, start={"v_m1": 40.0})
    assert math.isfinite(fastest_rate(drive, Engine(), batch, stored(drive)))
