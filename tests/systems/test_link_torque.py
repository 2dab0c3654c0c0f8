"""The torque that passes the gear to the link, as an output: both sides of the gear, arms, rest, lag, a recovery."""

from pathlib import Path

import numpy as np
import pytest
import torch

from hybrid_id.components.friction.coulomb import Coulomb
from hybrid_id.components.friction.viscous import Viscous
from hybrid_id.components.sensor.torque_lag import TorqueLag
from hybrid_id.components.sensor.torque_sensor import TorqueSensor
from hybrid_id.components.transmission.kinematic_error import KinematicError
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.record import Record
from hybrid_id.simulation.c_code import compiler
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.step import Engine
from hybrid_id.study import identify
from hybrid_id.systems import one_link, one_link_flexible
from hybrid_id.systems.model_file import load_model

R, STEP = 50.0, 0.002
VALUES = {"J": 4e-5, "rotor_share": 0.4, "F_c": 0.01, "F_v": 5e-5}


def rows(*values):
    return [torch.tensor([v], dtype=torch.float64) for v in values]


def drive():
    return one_link(R, vertical=True).with_values({**VALUES, "G_l": 1.2})


def at(system, names, x, u):
    views = system.views([value[None] for value in system.theta().detach()])
    return [float(y) for y in system.outputs(names, x, u, views)], views


@pytest.mark.parametrize("speed", [12.0, -7.0, 0.0])
def test_both_sides_of_a_rigid_gear_tell_the_same_torque(speed: float) -> None:
    system = drive().with_component("joint1/link_friction", Viscous(F_v=0.3))
    x, u = rows(20.0, speed), {"u1": rows(6.0)[0]}
    (torque, motor), p = at(system, ["tau_a1", "tau1"], x, u)
    rates = system.rates(x, u, p, system.directions(x, u, p))
    a, moving = float(rates[1]), np.sign(float(rates[1])) if speed == 0.0 else np.sign(speed)
    by_motor = R * (motor - 0.01 * moving - 5e-5 * speed - 0.4 * 4e-5 * a)
    by_link = 0.6 * 4e-5 * R**2 * a / R + 1.2 * np.sin(20.0 / R) + 0.3 * speed / R
    assert torque == pytest.approx(by_motor, rel=1e-12)
    assert torque == pytest.approx(by_link, rel=1e-12)


def test_at_rest_a_gear_carries_the_weight_whatever_the_motor_does() -> None:
    for volts in (0.0, 0.03, -0.03):  # too little to overcome dry friction
        (torque,), _ = at(drive(), ["tau_a1"], rows(20.0, 0.0), {"u1": rows(volts)[0]})
        assert torque == pytest.approx(1.2 * np.sin(0.4), rel=1e-12)


def test_dry_friction_of_the_link_passes_the_gear() -> None:
    system = drive().with_component("joint1/link_friction", Coulomb(F_c=0.2))
    x, u = rows(20.0, 5.0), {"u1": rows(6.0)[0]}
    (torque, motor), p = at(system, ["tau_a1", "tau1"], x, u)
    a = float(system.rates(x, u, p, system.directions(x, u, p))[1])
    assert torque == pytest.approx(R * (motor - 0.01 - 5e-5 * 5.0 - 0.4 * 4e-5 * a), rel=1e-12)


def test_an_error_of_the_gear_changes_the_lever() -> None:
    system = drive().with_component("joint1/transmission", KinematicError(E_c=0.002, E_s=0.001, n=1.0))
    x, u = rows(20.0, 9.0), {"u1": rows(6.0)[0]}
    (torque, motor), p = at(system, ["tau_a1", "tau1"], x, u)
    a = float(system.rates(x, u, p, system.directions(x, u, p))[1])
    slope = 1 / R - 0.002 * np.sin(20.0) + 0.001 * np.cos(20.0)
    assert torque * slope == pytest.approx(motor - 0.01 - 5e-5 * 9.0 - 0.4 * 4e-5 * a, rel=1e-10)


def test_behind_a_spring_it_is_the_springs() -> None:
    system = one_link_flexible(R).with_values({"k": 300.0, "d": 2.0})
    x = rows(20.0, 3.0, 0.39, 0.05)
    (torque,), _ = at(system, ["tau_a1"], x, {"u1": rows(1.0)[0]})
    assert torque == pytest.approx(300.0 * (20.0 / R - 0.39) + 2.0 * (3.0 / R - 0.05))


ARM = """<mujoco><compiler angle="radian"/><worldbody>
<body quat="0.9 0.3 0.1 0"><joint name="arm" axis="0 1 0" armature="0.03" damping="0.2" frictionloss="0.1"/>
<inertial mass="0.5" pos="0.02 0 0.1" diaginertia="0.002 0.002 0.001"/>
<body pos="0 0 0.2"><joint name="bend" axis="0 1 0" armature="0.02" damping="0.1" frictionloss="0.05"/>
<inertial mass="0.3" pos="0.01 0 0.05" diaginertia="0.001 0.001 0.0004"/>
<body pos="0 0 0.1"><joint name="roll" axis="0 0 1" armature="0.01" damping="0.05" frictionloss="0.03"/>
<inertial mass="0.2" pos="0.03 0.01 0.04" diaginertia="0.0005 0.0006 0.0003"/>
</body></body></body></worldbody></mujoco>"""
WRIST = "couplings: [{joints: [bend, roll], matrix: [[1, 0], [1, 1]]}]\n"


def arm(folder: Path, more: str = ""):
    pytest.importorskip("mujoco")
    (folder / "arm.xml").write_text(ARM)
    (folder / "model.yaml").write_text(f"robot: {{file: arm.xml}}\ngear_ratio: [10, 45, 32]\n{more}")
    return load_model(folder / "model.yaml")


@pytest.mark.parametrize("more", ["", WRIST])
def test_of_an_arm_it_is_the_inverse_dynamics(tmp_path: Path, more: str) -> None:
    """tau = M(q) a + h(q, v) of the links at the accelerations that the drives give, coupled motors or not."""
    system = arm(tmp_path, more)
    tree = system.tree
    assert tree is not None
    rng = np.random.default_rng(3)
    ratios, gearing = np.array(system.gear_ratio), np.array(tree.gearing)
    for _ in range(3):
        q, v = rng.normal(size=(2, 3))
        motors = [ratios * (gearing @ q), ratios * (gearing @ v)]
        x = rows(*(value for pair in zip(*motors, strict=True) for value in pair))
        u = {f"tau{k}": rows(rng.normal() * 0.02)[0] for k in (1, 2, 3)}
        found, p = at(system, ["tau_a1", "tau_a2", "tau_a3"], x, u)
        rates = system.rates(x, u, p, system.directions(x, u, p))
        a = np.linalg.solve(ratios[:, None] * gearing, [float(rates[row]) for row in system.speed_rows])
        needed = tree.inverse_dynamics(tree.poses(list(q)), tree.inertias(), list(v), list(a))
        np.testing.assert_allclose(found, [float(one) for one in needed], rtol=1e-9, atol=1e-12)


@pytest.mark.skipif(compiler() is None, reason="there is no C compiler")
def test_a_sensor_with_gain_offset_and_lag_in_both_engines(tmp_path: Path) -> None:
    system = arm(tmp_path).with_component("joint2/sensor", TorqueSensor(g=1.1, tau_0=0.05))
    late = system.with_component("joint2/sensor", TorqueLag(T_s=0.01))
    time = STEP * np.arange(300)
    inputs = {f"tau{k}": 0.05 / k * np.sin((3 + 2 * k) * time) for k in (1, 2, 3)}
    names = ("q_m1", "q_m2", "q_m3", "tau_a2")
    record = Record("r", time, inputs, {name: 0.0 * time for name in names})

    def run(one, engine):
        return simulate(one, engine, make_batch(one, [record], noise_std=dict.fromkeys(names, 1.0)))

    plain, fast = (run(late, Engine("dry", 2, compiled=c)) for c in (False, True))
    np.testing.assert_allclose(fast.x.numpy(), plain.x.numpy(), atol=1e-11)
    direct = run(system, Engine("dry", 2, compiled=True)).y[0, :, 3].numpy()
    clean = run(arm(tmp_path), Engine("dry", 2, compiled=True)).y[0, :, 3].numpy()
    np.testing.assert_allclose(direct, 1.1 * clean + 0.05, atol=1e-12)
    fine = run(late, Engine("dry", 16, compiled=True)).y[0, :, 3].numpy()
    filtered, z = [], clean[0]
    for k in range(len(time)):  # the filter along lines from sample to sample; commands are held, so nearly
        filtered.append(z)
        if k + 1 < len(time):
            slope, decay = (clean[k + 1] - clean[k]) / STEP, np.exp(-STEP / 0.01)
            z = clean[k + 1] - 0.01 * slope + (z - clean[k] + 0.01 * slope) * decay
    apart = np.abs(fine - (1.1 * np.array(filtered) + 0.05))
    assert np.median(apart) < 0.01 * np.ptp(clean)
    assert apart.max() < 0.05 * np.ptp(clean)  # at reversals torques jump with dry friction


def test_a_measured_torque_gives_voltages_their_scale() -> None:
    """From voltage and angle no torque has a scale; the torque at the link gives it to inertia, motor and friction."""
    truth = one_link(R).with_values(VALUES)
    truth = truth.with_component("joint1/sensor", TorqueSensor(tau_0=0.2))
    rng, records, time = np.random.default_rng(0), [], STEP * np.arange(1000)
    noise = {"q_m1": 1e-3, "tau_a1": 0.02}
    for number in range(3):
        phases = rng.uniform(0, 2 * np.pi, (4, 1))
        volts = 3.0 * np.sin(2 * np.pi * np.array([[0.7], [1.9], [3.1], [5.3]]) * time + phases).sum(0)
        volts *= np.minimum(time / 0.1, 1.0)
        blank = Record(f"r{number}", time, {"u1": volts}, dict.fromkeys(noise, 0.0 * time))
        y = simulate(
            truth, Engine("dry", 4), make_batch(truth, [blank], noise_std=dict.fromkeys(noise, 1.0))
        ).y[0]
        outputs = {
            n: y[:, k].numpy() + s * rng.standard_normal(1000) for k, (n, s) in enumerate(noise.items())
        }
        records.append(
            Record(blank.name, time, {"u1": volts}, outputs, role="train" if number < 2 else "test")
        )
    channels = tuple(Channel(n, u, noise[n]) for n, u in (("q_m1", "rad"), ("tau_a1", "N m")))
    data = Dataset("torque", (Channel("u1", "V"),), channels, tuple(records))
    free = {i.name: i.spec.value for i in truth.table if i.spec.estimate}
    assert set(free) == {"J", "P_m1", "P_m2", "F_c", "F_v", "tau_0"}
    start = truth.with_values({name: 1.4 * value for name, value in free.items()})
    found = identify(data, start, pooled=True).selected.system
    at = {name: found.parameter(name).spec.value for name in free}
    for name in ("J", "P_m1", "F_c", "tau_0"):
        assert at[name] == pytest.approx(free[name], rel=0.03), name
    # back-EMF and viscous friction damp alike
    damping = free["P_m1"] * free["P_m2"] + free["F_v"]
    assert at["P_m1"] * at["P_m2"] + at["F_v"] == pytest.approx(damping, rel=0.03)
