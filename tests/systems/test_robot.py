"""Drives at the joints of a rigid-body tree: the planar arm it contains, MuJoCo beside it, stick and slip of six."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from hybrid_id.components.friction.coulomb import Coulomb
from hybrid_id.components.friction.load_dependent import LoadDependent
from hybrid_id.components.load.rotor_inertia import RotorInertia
from hybrid_id.components.load.two_link import JointCoupling
from hybrid_id.components.transmission.backlash import Backlash
from hybrid_id.components.transmission.linear_spring import LinearSpring
from hybrid_id.errors import InputError
from hybrid_id.records.record import Record
from hybrid_id.robots.description import load_tree
from hybrid_id.robots.tree import Body, RigidBodyTree, SpatialInertia, TreeJoint
from hybrid_id.simulation.c_code import compiler
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.builders import robot
from hybrid_id.systems.chain import System

IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
STEP = 0.002


def planar(first=(1.2, 0.15, 0.02), second=(0.8, 0.2, 0.015), length=0.4):
    """Two links about parallel axes; mass [kg], distance of the centre [m], inertia about it [kg m^2] of each."""

    def body(name, joint, mass, distance, inertia):
        about = ((0.0, 0.0, 0.0), (0.0, inertia, 0.0), (0.0, 0.0, inertia))
        return Body(name, joint, IDENTITY, (distance, 0.0, 0.0), SpatialInertia(mass, (0.0, 0.0, 0.0), about))

    joints = (
        TreeJoint("shoulder", "hinge", -1, IDENTITY, (0.0, 0.0, 0.0)),
        TreeJoint("elbow", "hinge", 0, IDENTITY, (length, 0.0, 0.0)),
    )
    return RigidBodyTree(joints, (body("upper", 0, *first), body("lower", 1, *second)), (0.0, 0.0, 0.0))


ARM = """
<mujoco><compiler angle="radian"/><option timestep="1e-4" integrator="RK4"/><worldbody>{bodies}</worldbody></mujoco>
"""


def serial(count=6, friction=0.0):
    """A serial arm of small links whose axes alternate."""
    text = ""
    for k in reversed(range(count)):
        axis = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "0 0 1")[k % 6]
        text = (
            f'<body name="b{k}" pos="0 0 {0.05 if k else 0.0}"><joint name="j{k}" axis="{axis}" armature="0.02" '
            f'damping="0.3" frictionloss="{friction}"/><inertial mass="{0.4 / (k + 1):.17g}" pos="0.01 0.005 0.06" '
            f'diaginertia="0.001 0.0012 0.0008"/>{text}</body>'
        )
    return ARM.format(bodies=text)


def torques(count, seconds=1.0):
    time = STEP * np.arange(round(seconds / STEP) + 1)
    k = np.arange(count)[:, None]
    return time, 0.6 / (1 + k) * np.sin(2 * np.pi * (0.7 + 0.4 * k) * time + k)


def rollout(system, count, engine, seconds=1.0):
    time, torque = torques(count, seconds)
    inputs = {f"tau{k + 1}": torque[k] for k in range(count)}
    record = Record("run", time, inputs, {f"q_m{k + 1}": 0.0 * time for k in range(count)})
    batch = make_batch(system, [record], noise_std={f"q_m{k + 1}": 1.0 for k in range(count)})
    return simulate(system, engine, batch)


def arm(tmp_path, friction=0.0, count=6):
    pytest.importorskip("mujoco")
    path = tmp_path / "arm.xml"
    path.write_text(serial(count, friction))
    return path, robot(load_tree(path))


def test_a_torque_driven_arm_moves_as_in_mujoco(tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    path, system = arm(tmp_path)
    model = mujoco.MjModel.from_xml_path(str(path))
    data, (time, torque) = mujoco.MjData(model), torques(6)
    there = []
    for t in range(len(time)):
        there.append(data.qpos.copy())
        data.qfrc_applied[:] = torque[:, t]
        for _ in range(round(STEP / model.opt.timestep)):
            mujoco.mj_step(model, data)
    here = rollout(system, 6, Engine("dry", 4, compiled=compiler() is not None)).y[0].numpy()
    assert np.ptp(there, axis=0).min() > 0.02
    np.testing.assert_allclose(here, there, atol=2e-7)


def test_six_joints_stick_and_slip_alike_in_both_engines(tmp_path: Path) -> None:
    if compiler() is None:
        pytest.skip("there is no C compiler")
    _, system = arm(tmp_path, friction=0.12)
    plain, fast = (rollout(system, 6, Engine("dry", 1, compiled=c), 0.06) for c in (False, True))
    speeds = plain.x[0, :, 1::2].numpy()
    resting = (speeds == 0.0).mean(0)
    assert ((resting > 0.02) & (resting < 0.98)).sum() >= 4, "most joints stick at times and move at times"
    np.testing.assert_allclose(fast.x.numpy(), plain.x.numpy(), atol=1e-11)


def apart(system: System, substeps: int, fine: int) -> float:
    """Largest difference [rad] of six joints' angles in a second between steps of two sizes."""
    coarse, ref = (rollout(system, 6, Engine("dry", n, compiled=True)).y for n in (substeps, fine))
    return float((coarse - ref).abs().max())


def test_stick_and_slip_of_six_joints_is_that_of_64_times_finer_steps(tmp_path: Path) -> None:
    """One step a sample of 2 ms: 1.7e-10 rad under Coulomb friction, 3e-7 rad where it grows with the load."""
    if compiler() is None:
        pytest.skip("there is no C compiler")
    _, system = arm(tmp_path, friction=0.12)
    assert apart(system, 1, 64) < 5e-10
    assert apart(system, 2, 64) < apart(system, 1, 64) / 10, "of fourth order, events included"
    for joint in (2, 3):
        system = system.with_component(f"joint{joint}/motor_friction", LoadDependent(mu=0.2))
    assert apart(system, 1, 64) < 1e-6
    assert apart(system, 8, 64) < 1e-8


def test_springs_and_play_at_several_of_six_joints_are_those_of_finer_steps(tmp_path: Path) -> None:
    if compiler() is None:
        pytest.skip("there is no C compiler")
    _, system = arm(tmp_path, friction=0.05)
    gears = LinearSpring(k=60.0, d=0.2), Backlash(gap=0.01), LinearSpring(k=40.0, d=0.2), Backlash(gap=0.02)
    for joint, gear in enumerate(gears, 1):
        system = system.with_component(f"joint{joint}/transmission", gear)
    motion = rollout(system, 6, Engine("dry", 8, compiled=True)).y[0].numpy()
    assert np.ptp(motion, axis=0)[:5].min() > 0.05
    assert apart(system, 8, 128) < 1e-5
    assert apart(system, 16, 128) < 2e-6


def test_a_coupling_beside_a_tree_is_refused() -> None:
    with pytest.raises(InputError, match="the robot's own tree couples"):
        robot(planar()).with_component("joint1/load", JointCoupling())


def test_a_drive_for_every_joint() -> None:
    system = robot(planar(), (10.0, 5.0))
    assert [type(part) for part in system.components.values()].count(RotorInertia) == 2
    assert [type(part) for part in system.components.values()].count(Coulomb) == 2
    with pytest.raises(InputError, match="2 joints and the system 1"):
        type(system)([1.0], [(k.rsplit("/", 1)[0], c) for k, c in system.components.items() if "joint1" in k],
                     tree=system.tree)  # fmt: skip


def test_dry_friction_takes_energy_and_never_gives_any(tmp_path: Path) -> None:
    """Without gravity and drive, an arm that was set in motion loses kinetic energy until all joints rest."""
    pytest.importorskip("mujoco")
    path = tmp_path / "arm.xml"
    path.write_text(serial(6, 0.05).replace('damping="0.3"', ""))
    tree = replace(load_tree(path), gravity=(0.0, 0.0, 0.0))
    system, (time, torque) = robot(tree), torques(6, 3.0)
    driven = np.where(time < 0.3, torque, 0.0)
    record = Record(
        "run",
        time,
        {f"tau{k + 1}": driven[k] for k in range(6)},
        {f"q_m{k + 1}": 0.0 * time for k in range(6)},
    )
    batch = make_batch(system, [record], noise_std={f"q_m{k + 1}": 1.0 for k in range(6)})
    x = simulate(system, Engine("dry", 2, compiled=compiler() is not None), batch).x[0]
    q, v = x[:, 0::2], x[:, 1::2]
    mass = tree.mass_matrix(tree.poses(list(q.T)), tree.inertias())
    for k, joint in enumerate(tree.joints):
        mass[k][k] = mass[k][k] + joint.armature
    whole = torch.stack([torch.stack([torch.as_tensor(m).expand(len(q)) for m in row]) for row in mass])
    energy = 0.5 * torch.einsum("ti,ijt,tj->t", v, whole, v).numpy()[round(0.3 / STEP) + 1 :]
    assert energy[0] > 1e-3
    assert energy[-1] == 0.0
    assert np.diff(energy).max() <= 1e-9 * energy[0]


def test_gradients_of_a_sample_are_those_of_finite_differences(tmp_path: Path) -> None:
    _, system = arm(tmp_path, friction=0.05, count=3)
    system = system.with_component("joint2/motor_friction", LoadDependent(mu=0.05))
    x = [torch.tensor([v], dtype=torch.float64) for v in (0.2, 0.5, -0.4, -0.3, 0.1, 0.7)]
    u = {f"tau{k + 1}": torch.tensor([0.2], dtype=torch.float64) for k in range(3)}
    dt, engine = torch.tensor([STEP], dtype=torch.float64), Engine("dry", 2)

    def sample(theta):
        return torch.cat(engine.sample(system, x, u, dt, system.views(list(theta[:, None]))))

    theta = system.theta().detach()
    exact = torch.as_tensor(torch.autograd.functional.jacobian(sample, theta))
    for k in range(len(theta)):
        h = 1e-5 * max(float(theta[k].abs()), 1e-3)
        ahead, back = theta.clone(), theta.clone()
        ahead[k] += h
        back[k] -= h
        slope = (sample(ahead) - sample(back)) / (2 * h)
        np.testing.assert_allclose(exact[:, k], slope, rtol=1e-6, atol=1e-9 * float(exact.abs().max()))
