"""Motions of whole drives that are known in closed form."""

import numpy as np
import pytest
import torch
from drives import STEP, flexible_drive, measure, rigid_drive, run, stored

from hybrid_id.components import (
    Coulomb,
    CurrentCommand,
    CurrentMotor,
    DutySupply,
    LoadDependent,
    LoggedLoad,
    MotorEncoder,
    TorqueCommand,
    TorqueMotor,
)
from hybrid_id.errors import InputError
from hybrid_id.records.record import Record
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.step import Engine
from hybrid_id.systems import System, one_link, one_link_flexible

MOTOR, FRICTION = "joint1/motor", "joint1/motor_friction"
COASTING = {"P_m1": 1e-9, "P_m2": 0.0}
"""Values of a motor that does nothing."""


def coasting(**values: float) -> System:
    return one_link(100.0).with_values(COASTING | {"J": 2e-5, "F_c": 0.01, "F_v": 0.0} | values)


def zeros(samples: int) -> np.ndarray:
    return np.zeros(samples)


def test_step_response_of_the_motor_is_exponential() -> None:
    system = coasting(P_m1=0.019, P_m2=0.0254, F_c=0.0, F_v=5e-5)
    x = run(system, {"u1": 12.0}, samples=100)
    pole = (0.019 * 0.0254 + 5e-5) / 2e-5
    time = STEP * np.arange(100)
    np.testing.assert_allclose(x["v_m1"], 0.019 * 12 / 2e-5 / pole * (1 - np.exp(-pole * time)), rtol=1e-6)


def test_coulomb_coast_down_is_a_parabola_and_ends_at_rest() -> None:
    v0, slope = 17.3, 0.01 / 2e-5
    x = run(coasting(), {"u1": zeros(60)}, start={"v_m1": v0})
    time = STEP * np.arange(60)
    stop = v0 / slope
    assert 10 < stop / STEP < 50
    t = np.minimum(time, stop)
    np.testing.assert_allclose(x["q_m1"], v0 * t - 0.5 * slope * t**2, rtol=1e-12)
    np.testing.assert_allclose(x["v_m1"], v0 - slope * t, atol=1e-12)
    assert (x["v_m1"][time > stop] == 0.0).all(), "at rest means at rest"


def test_two_masses_swing_at_their_eigenfrequency() -> None:
    r, j_m, j_a, k = 50.0, 2e-5, 0.03, 80.0
    values = {"J_m": j_m, "J_a": j_a, "k": k, "d": 0.0, "F_cm": 0.0, "F_vm": 0.0, "F_va": 0.0}
    system = one_link_flexible(r).with_values(values | COASTING)
    x = run(
        system,
        {"u1": zeros(500)},
        start={"q_m1": 0.01 * r * j_a / (j_a + r**2 * j_m), "q_a1": -0.01 * r**2 * j_m / (j_a + r**2 * j_m)},
    )
    deflection = x["q_m1"] / r - x["q_a1"]
    frequency = np.sqrt(k * (1 / (r**2 * j_m) + 1 / j_a))
    np.testing.assert_allclose(deflection, 0.01 * np.cos(frequency * STEP * np.arange(500)), atol=2e-6)
    momentum = r * j_m * x["v_m1"] + j_a * x["v_a1"]  # no torque from outside
    np.testing.assert_allclose(momentum, 0.0, atol=1e-10)


def test_link_friction_of_a_rigid_gear_is_seen_through_the_gear() -> None:
    r, u = 50.0, 8.0 * np.sin(2 * np.pi * 2 * STEP * np.arange(300))
    at_motor = one_link(r).with_values({"F_c": 0.012})
    at_link = (
        one_link(r).without_component(FRICTION, "coulomb_friction")
        .with_component("joint1/link_friction", Coulomb(F_c=0.012 * r))
    )  # fmt: skip
    np.testing.assert_allclose(
        run(at_link, {"u1": u})["q_m1"], run(at_motor, {"u1": u})["q_m1"], rtol=1e-9, atol=1e-12
    )


@pytest.mark.parametrize("share", [0.1, 0.5, 1.0])
def test_load_dependent_friction_solves_its_loop(share: float) -> None:
    mu, f_c, r, g_l, inertia = 0.3, 0.004, 20.0, 1.5, 2e-5
    values = {
        "J": inertia,
        "rotor_share": share,
        "F_c": f_c,
        "F_v": 0.0,
        "P_m1": 0.02,
        "P_m2": 0.0,
        "G_l": g_l,
    }
    system = rigid_drive(vertical=True, ratio=r).with_values(values)
    system = system.with_component(FRICTION, LoadDependent(mu=mu))
    for u in (-9.0, -3.0, 3.0, 9.0):
        for q in (-25.0, 0.0, 12.0):
            for v in (-40.0, 40.0):
                x = [torch.tensor([value], dtype=torch.float64) for value in (q, v)]
                p = system.views(list(stored(system)))
                _, rate = system.rates(x, {"u1": torch.tensor([u])}, p, [x[1].sign()])
                load, a = g_l / r * np.sin(q / r), 0.0
                for _ in range(200):  # fixed-point iteration of friction and transmitted torque
                    transmitted = (1 - share) * inertia * a + load
                    a = (0.02 * u - load - np.sign(v) * (f_c + mu * abs(transmitted))) / inertia
                assert rate.item() == pytest.approx(a, rel=1e-9)


def test_motor_that_is_switched_off_is_an_open_circuit() -> None:
    system = rigid_drive().with_values({"F_c": 0.0, "F_v": 0.0})
    enable = np.r_[np.ones(50), np.zeros(50)]
    y = measure(system, {"u1": 10.0, "enable1": enable}, outputs=("v_m1", "i1", "tau1"))
    assert (y["i1"][50:] == 0.0).all() and (y["tau1"][50:] == 0.0).all()
    assert np.ptp(y["v_m1"][50:]) == 0.0 and y["v_m1"][50] > 100.0  # no back-EMF: nothing slows it down


def test_outputs_of_a_rigid_drive() -> None:
    system, u = rigid_drive(), 10.0 * np.sin(2 * np.pi * 3 * STEP * np.arange(200))
    y = measure(system, {"u1": u}, outputs=("q_m1", "v_m1", "q_a1", "v_a1", "i1", "tau1"))
    np.testing.assert_allclose(y["q_a1"], y["q_m1"] / 156.0)
    np.testing.assert_allclose(y["v_a1"], y["v_m1"] / 156.0)
    np.testing.assert_allclose(y["tau1"], 0.019 * (u - 0.0254 * y["v_m1"]))
    np.testing.assert_allclose(y["i1"], y["tau1"] / 0.0254)


def test_outputs_of_a_flexible_drive_and_an_encoder_offset() -> None:
    u = 10.0 * np.sin(2 * np.pi * 3 * STEP * np.arange(200))
    system = flexible_drive()
    y = measure(system, {"u1": u}, outputs=("q_m1", "q_a1", "v_a1"))
    x = run(system, {"u1": u})
    np.testing.assert_allclose(y["q_a1"], x["q_a1"], atol=1e-9)
    np.testing.assert_allclose(y["v_a1"], x["v_a1"], atol=1e-9)
    shifted = measure(system.with_component("joint1/sensor", MotorEncoder(offset=0.25)), {"u1": u})
    np.testing.assert_allclose(shifted["q_m1"], y["q_m1"] + 0.25)


@pytest.mark.parametrize("name", ["q_m2", "q_m", "x1", "temperature1", "1"])
def test_unknown_output_is_refused(name: str) -> None:
    with pytest.raises(InputError, match=f"'{name}'"):
        measure(rigid_drive(), {"u1": zeros(5)}, outputs=(name,))


def test_torque_and_current_commands_drive_the_rotor() -> None:
    base = coasting()
    by_torque = base.with_component(MOTOR, TorqueMotor()).with_component("joint1/input", TorqueCommand())
    by_current = base.with_component(MOTOR, CurrentMotor(k_t=0.05)).with_component(
        "joint1/input", CurrentCommand()
    )
    expected = (0.03 - 0.01) / 2e-5 * STEP * np.arange(40)
    np.testing.assert_allclose(run(by_torque, {"tau1": 0.03}, samples=40)["v_m1"], expected)
    np.testing.assert_allclose(run(by_current, {"i1": 0.6}, samples=40)["v_m1"], expected)
    wound = base.with_component(MOTOR, TorqueMotor(k_t=0.05)).with_component("joint1/input", TorqueCommand())
    seen = measure(wound, {"tau1": 0.03}, samples=5, outputs=("i1",))["i1"]
    np.testing.assert_allclose(seen, 0.6)


def test_duty_times_supply_equals_its_voltage() -> None:
    t = STEP * np.arange(200)
    duty, supply = np.sin(9 * t), 12.0 - t
    x = run(rigid_drive().with_component("joint1/input", DutySupply()), {"duty1": duty, "supply1": supply})
    np.testing.assert_array_equal(x["q_m1"], run(rigid_drive(), {"u1": duty * supply})["q_m1"])


def test_logged_load_acts_at_the_link() -> None:
    # a constant torque of 3 N m at the link opposes the motor: 0.03 N m at the rotor behind a gear of 100
    load = LoggedLoad(c_w=1.5)
    rigid = coasting(F_c=0.0).with_component("joint1/load", load)
    assert rigid.input_names == ["u1", "w1"]
    x = run(rigid, {"u1": zeros(40), "w1": 2.0})
    np.testing.assert_allclose(x["v_m1"], -0.03 / 2e-5 * STEP * np.arange(40))
    values = {"J_m": 1e-5, "J_a": 0.1, "k": 400.0, "d": 2.0, "F_cm": 0.0, "F_vm": 0.0, "F_va": 0.0}
    flexible = one_link_flexible(100.0).with_values(values | COASTING).with_component("joint1/load", load)
    x = run(flexible, {"u1": zeros(150), "w1": 2.0})
    momentum = 100.0 * 1e-5 * x["v_m1"] + 0.1 * x["v_a1"]
    np.testing.assert_allclose(momentum, -3.0 * STEP * np.arange(150), rtol=1e-9, atol=1e-12)


def test_a_record_without_the_load_is_refused() -> None:
    system = coasting().with_component("joint1/load", LoggedLoad())
    record = Record("r", STEP * np.arange(5), {"u1": zeros(5)}, {"q_m1": zeros(5)})
    with pytest.raises(InputError, match="w1"):
        make_batch(system, [record])


def test_pendulum_keeps_its_energy_to_the_order_of_the_integrator() -> None:
    r, g_l, inertia = 10.0, 2.0, 2e-3
    system = one_link(r, vertical=True).with_values(
        COASTING | {"J": inertia, "F_c": 0.0, "F_v": 0.0, "G_l": g_l}
    )
    drift = []
    for substeps in (1, 2, 4):
        x = run(system, {"u1": zeros(200)}, step=0.02, start={"q_m1": 15.0}, engine=Engine(substeps=substeps))
        energy = 0.5 * inertia * x["v_m1"] ** 2 - g_l * np.cos(x["q_m1"] / r)
        drift.append(np.abs(energy - energy[0]).max())
    assert drift[0] / drift[1] > 12 and drift[1] / drift[2] > 12
    assert drift[2] < 1e-6 * g_l
    small = run(system, {"u1": zeros(200)}, start={"q_m1": 0.01}, step=0.01)
    frequency = np.sqrt(g_l / (inertia * r**2))
    np.testing.assert_allclose(small["q_m1"], 0.01 * np.cos(frequency * 0.01 * np.arange(200)), atol=1e-7)
