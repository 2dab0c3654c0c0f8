"""Coupled motors of a wrist: closed forms, MuJoCo's tendons beside them, both engines, gradients and a recovery."""

from pathlib import Path

import numpy as np
import pytest
import torch

from hybrid_id.cli.diagnose import takes_by_joint
from hybrid_id.components.friction.coulomb import Coulomb
from hybrid_id.components.friction.load_dependent import LoadDependent
from hybrid_id.components.friction.viscous import Viscous
from hybrid_id.components.input.position_servo import PositionServo
from hybrid_id.components.load.payload import Payload
from hybrid_id.components.load.spring import Spring
from hybrid_id.components.sensor.encoder import LinkEncoder
from hybrid_id.components.transmission.linear_spring import LinearSpring
from hybrid_id.errors import InputError
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.record import Record
from hybrid_id.robots.base_parameters import base_parameters, inertial_parameters, whole_regressor
from hybrid_id.robots.couplings import GearCoupling
from hybrid_id.robots.description import load_tree
from hybrid_id.robots.tree import Body, RigidBodyTree, SpatialInertia, TreeJoint
from hybrid_id.simulation.c_code import compiler
from hybrid_id.simulation.compiled import compiled_for
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.step import Engine
from hybrid_id.study import identify
from hybrid_id.systems.builders import robot
from hybrid_id.systems.by_joint import alone, measured_motion
from hybrid_id.systems.model_file import load_model, save_model

pytest.importorskip("mujoco")

IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
WRIST = ((1.0, 0.0), (1.0, 1.0))
"""The second motor turns with both joints, as in a Staubli TX40 (shared/data/staubli_tx40)."""
STEP = 0.002
ARM = """<mujoco><compiler angle="radian"/><option timestep="1e-4" integrator="RK4"/><worldbody>
<body quat="0.9 0.3 0.1 0"><joint name="arm" axis="0 1 0" armature="0.03" damping="0.2" frictionloss="0.0"/>
<inertial mass="0.5" pos="0.02 0 0.1" diaginertia="0.002 0.002 0.001"/>
<body pos="0 0 0.2"><joint name="bend" axis="0 1 0"/>
<inertial mass="0.3" pos="0.01 0 0.05" diaginertia="0.001 0.001 0.0004"/>
<body pos="0 0 0.1"><joint name="roll" axis="0 0 1"/><site name="hand" pos="0.05 0 0.05"/>
<inertial mass="0.2" pos="0.03 0.01 0.04" diaginertia="0.0005 0.0006 0.0003"/>
</body></body></body></worldbody>{more}</mujoco>"""
TENDONS = """<tendon><fixed name="m2" damping="0.1" armature="0.02"><joint joint="bend" coef="1"/></fixed>
<fixed name="m3" damping="0.05" armature="0.01"><joint joint="bend" coef="1"/><joint joint="roll" coef="1"/></fixed>
</tendon><actuator><motor joint="arm"/><motor tendon="m2"/><motor tendon="m3"/></actuator>"""
RATIOS = (10.0, 45.0, 32.0)


def written(folder: Path, more: str = "") -> Path:
    (folder / "arm.xml").write_text(ARM.format(more=""))
    (folder / "model.yaml").write_text(
        f"robot: {{file: arm.xml}}\ngear_ratio: {list(RATIOS)}\n"
        f"couplings: [{{joints: [bend, roll], matrix: [[1, 0], [1, 1]]}}]\n{more}"
    )
    return folder / "model.yaml"


def wrist(folder: Path, friction: float = 0.0):
    """The arm with the rotors and the friction of TENDONS, its dry friction by motor seen behind the gear."""
    system = load_model(written(folder))
    values = {}
    for name, r, inertia, damping in zip(
        ("arm", "bend", "roll"), RATIOS, (0.03, 0.02, 0.01), (0.2, 0.1, 0.05), strict=True
    ):
        values |= {f"J_m_{name}": inertia / r**2, f"F_v_{name}": damping / r**2, f"F_c_{name}": friction / r}
    return system.with_values(values)


def torques(seconds: float = 1.0):
    time = STEP * np.arange(round(seconds / STEP) + 1)
    k = np.arange(3)[:, None]
    return time, np.array([[0.8], [0.4], [0.15]]) * np.sin(2 * np.pi * (0.8 + 0.5 * k) * time + k)


def run(system, engine, seconds: float = 1.0, outputs=("q_m1", "q_m2", "q_m3"), command=None):
    time, torque = torques(seconds) if command is None else command
    n = len(system.joints)
    inputs = {f"tau{k + 1}": torque[k] / system.gear_ratio[k] for k in range(n)}
    record = Record("run", time, inputs, {name: 0.0 * time for name in outputs})
    return simulate(system, engine, make_batch(system, [record], noise_std=dict.fromkeys(outputs, 1.0)))


def test_coupled_motors_move_as_mujocos_tendons(tmp_path: Path) -> None:
    """A fixed tendon with an armature is a rotor that turns with a combination of joints."""
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(ARM.format(more=TENDONS))
    data, (time, torque) = mujoco.MjData(model), torques()
    there = []
    for t in range(len(time)):
        there.append(data.qpos.copy())
        data.ctrl[:] = torque[:, t]
        for _ in range(round(STEP / model.opt.timestep)):
            mujoco.mj_step(model, data)
    system = wrist(tmp_path)
    found = run(
        system, compiled_for(system, Engine("dry", 4)), outputs=("q_a1", "q_a2", "q_a3", "q_m2", "q_m3")
    )
    here = found.y[0].numpy()
    assert np.ptp(there, axis=0).min() > 0.1
    np.testing.assert_allclose(here[:, :3], there, atol=2e-7)
    np.testing.assert_allclose(here[:, 3], 45.0 * here[:, 1], atol=1e-11)
    np.testing.assert_allclose(here[:, 4], 32.0 * (here[:, 1] + here[:, 2]), atol=1e-11)


def planar(matrix=WRIST):
    """Two links about parallel axes, balanced about their joints: a constant mass matrix."""

    def body(name, joint, mass, inertia):
        about = ((0.0, 0.0, 0.0), (0.0, inertia, 0.0), (0.0, 0.0, inertia))
        return Body(name, joint, IDENTITY, (0.0, 0.0, 0.0), SpatialInertia(mass, (0.0, 0.0, 0.0), about))

    joints = (
        TreeJoint("one", "hinge", -1, IDENTITY, (0.0, 0.0, 0.0)),
        TreeJoint("two", "hinge", 0, IDENTITY, (0.3, 0.0, 0.0)),
    )
    tree = RigidBodyTree(joints, (body("a", 0, 1.0, 0.02), body("b", 1, 0.5, 0.01)), (0.0, 0.0, 0.0))
    return tree.coupled([(("one", "two"), matrix)])


def test_a_motor_that_sticks_turns_the_second_joint_against_the_first() -> None:
    """With motor 2 held by dry friction q_2 = -q_1, and motor 1 alone moves: v = v_inf (1 - exp(-t F_v / J))."""
    r, rotor, viscous, dry, push = (20.0, 10.0), 1e-4, 1e-3, 0.02, 0.05
    values = {}
    for name in ("one", "two"):
        values |= {f"J_m_{name}": rotor, f"F_v_{name}": viscous, f"F_c_{name}": dry}
    system = robot(planar(), r).with_values(values)
    time = STEP * np.arange(301)
    command = (time, [np.full(301, push * r[0]), np.full(301, 0.5 * dry * r[1])])
    found = run(system, Engine("dry", 4), outputs=("q_a1", "q_a2", "v_m1", "v_m2"), command=command)
    q_1, q_2, v_1, v_2 = found.y[0].numpy().T
    # M = [[I_1 + I_2 + m_2 l^2, I_2], [I_2, I_2]] with (1, -1): what turns with motor 1 does not turn against the base
    inertia = rotor + (0.02 + 0.5 * 0.3**2) / r[0] ** 2
    exact = (push - dry) / viscous * (1.0 - np.exp(-time * viscous / inertia))
    np.testing.assert_allclose(v_1, exact, atol=1e-8 * exact.max())
    np.testing.assert_allclose(q_2, -q_1, atol=1e-14)
    assert (v_2 == 0.0).all()
    assert q_1[-1] > 0.1


def test_what_acts_at_a_link_does_the_work_of_its_torque(tmp_path: Path) -> None:
    """Springs, viscous friction and weight at the links give the motors tau_m = A^T tau, A = d q / d q_m."""
    system = wrist(tmp_path)
    loaded = system.with_component("joint3/load", Spring(k_s=3.0, q_s=0.2))
    loaded = loaded.with_component("joint2/link_friction", Viscous(F_v=0.7))
    rng = np.random.default_rng(1)
    motors, speeds = rng.normal(size=3) * RATIOS, rng.normal(size=3) * RATIOS
    x = [torch.tensor([v], dtype=torch.float64) for pair in zip(motors, speeds, strict=True) for v in pair]
    u = {f"tau{k}": torch.zeros(1, dtype=torch.float64) for k in (1, 2, 3)}
    smooth = []
    for one in (system, loaded):
        none = [torch.zeros(1, dtype=torch.float64)] * 3
        views = one.views([value[None] for value in one.theta().detach()])
        smooth.append([float(b.smooth) for b in one.balances(x, u, views, none, none).speeds])
    gearing = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 1.0]])
    turn = np.linalg.inv(np.diag(RATIOS) @ gearing)
    q, v = turn @ motors, turn @ speeds
    np.testing.assert_allclose(
        np.subtract(*smooth), turn.T @ [0.0, 0.7 * v[1], 3.0 * (q[2] - 0.2)], atol=1e-12
    )


@pytest.mark.skipif(compiler() is None, reason="there is no C compiler")
def test_both_engines_agree_where_coupled_motors_stick_and_slip(tmp_path: Path) -> None:
    system = wrist(tmp_path, friction=0.21)
    system = system.with_component("joint3/motor_friction", LoadDependent(mu=0.1))
    system = system.with_component("joint3/load", Payload("hand", m_l=0.1))
    plain, fast = (run(system, Engine("dry", 1, compiled=c), 0.4) for c in (False, True))
    still = (plain.x[0, :, 1::2] == 0.0).double().mean(0)
    assert ((still > 0.01) & (still < 0.98)).sum() >= 2, "motors stick at times and move at times"
    np.testing.assert_allclose(fast.x.numpy(), plain.x.numpy(), atol=1e-10)


@pytest.mark.parametrize("side", ["m", "a"])
def test_coupled_drives_are_recovered_from_either_side(tmp_path: Path, side: str) -> None:
    truth = wrist(tmp_path, friction=0.05)
    rng, noise, records = np.random.default_rng(4), 1e-5, []
    names = tuple(f"q_{side}{k}" for k in (1, 2, 3))
    time = 0.004 * np.arange(600)
    for number in range(3):
        phases = rng.uniform(0, 2 * np.pi, (3, 3, 1))
        tones = 2 * np.pi * np.array([0.5, 1.3, 2.9])[:, None]
        torque = np.array([[0.5], [0.25], [0.15]]) * np.sin(tones * time + phases).sum(1)
        torque *= np.minimum(time / 0.2, 1.0)
        inputs = {f"tau{k + 1}": torque[k] / RATIOS[k] for k in range(3)}
        blank = Record(f"r{number}", time, inputs, {name: 0.0 * time for name in names})
        batch = make_batch(truth, [blank], noise_std=dict.fromkeys(names, 1.0))
        y = simulate(truth, Engine("dry", 8, compiled=compiler() is not None), batch).y[0].numpy()
        y = y + noise * rng.standard_normal(y.shape)
        outputs = dict(zip(names, y.T, strict=True))
        records.append(Record(blank.name, time, inputs, outputs, role="train" if number < 2 else "test"))
    data = Dataset(
        "wrist",
        tuple(Channel(f"tau{k}", "N m") for k in (1, 2, 3)),
        tuple(Channel(name, "rad", noise) for name in names),
        tuple(records),
    )
    start = truth.with_values({i.name: 1.3 * i.spec.value for i in truth.table if i.spec.estimate})
    study = identify(data, start, pooled=True)
    for info in truth.table:
        if info.spec.estimate:
            at = study.selected.system.parameter(info.name).spec.value
            assert at == pytest.approx(info.spec.value, rel=0.01), info.name


def test_joints_motion_and_rotors_of_coupled_motors(tmp_path: Path) -> None:
    """A joint's motion from its motors' angles; the regressor gives a rotor the speed C q' of its shaft."""
    system = wrist(tmp_path)
    time = 0.002 * np.arange(400)
    q = np.stack([np.sin((3 + k) * time) for k in range(3)])
    shafts = np.array([q[0], q[1], q[1] + q[2]])
    outputs = {f"q_m{k + 1}": RATIOS[k] * shafts[k] for k in range(3)}
    angle, speed, _ = measured_motion(Record("r", time, {"tau1": time}, outputs), system, 2)
    np.testing.assert_allclose(angle, q[2], atol=1e-4)
    np.testing.assert_allclose(speed[50:-50], 5.0 * np.cos(5 * time)[50:-50], atol=1e-3)
    tree = system.tree
    assert tree is not None
    rng = np.random.default_rng(0)
    at, rates, faster = rng.normal(size=(3, 4, 3))
    moved = whole_regressor(tree, at, rates, faster).reshape(4, 3, 3, 11)[..., -1] @ [0.03, 0.02, 0.01]
    gearing = np.array(tree.gearing)
    expected = np.einsum("ki,k,kj,tj->ti", gearing, [0.03, 0.02, 0.01], gearing, faster)
    np.testing.assert_allclose(moved, expected, atol=1e-14)
    base = base_parameters(tree)
    w = whole_regressor(tree, at, rates, faster)
    phi = inertial_parameters(tree)
    np.testing.assert_allclose(w[..., list(base.independent)] @ (base.grouping @ phi), w @ phi, atol=1e-8)


def test_a_servo_of_a_coupled_gear_closes_its_loop_over_its_own_shaft(tmp_path: Path) -> None:
    system = load_model(written(tmp_path))
    system = system.with_component("joint3/input", PositionServo(k_p=5.0))
    x = [torch.tensor([v], dtype=torch.float64) for v in (0.0, 0.0, 9.0, 0.0, 16.0, 0.0)]
    u = {"goal3": torch.tensor([0.75], dtype=torch.float64)}
    views = system.views([value[None] for value in system.theta().detach()])
    assert float(system.joints[2].drive.torque(x, u, views)) == pytest.approx(5.0 * (0.75 - 0.5) / 32.0)


def test_a_model_file_keeps_its_couplings(tmp_path: Path) -> None:
    system = load_model(written(tmp_path))
    save_model(system, tmp_path / "again.yaml")
    again = load_model(tmp_path / "again.yaml")
    assert again.tree == system.tree
    assert again.tree is not None
    assert again.tree.couplings == (GearCoupling((1, 2), WRIST),)
    assert load_tree(tmp_path / "arm.xml").couplings == ()


@pytest.mark.parametrize(
    ("coupling", "words"),
    [
        ("{joints: [bend, rol], matrix: [[1, 0], [1, 1]]}", "no joint 'rol' .did you mean 'roll'"),
        ("{joints: [bend], matrix: [[1]]}", "two different joints"),
        ("{joints: [bend, bend], matrix: [[1, 0], [1, 1]]}", "two different joints"),
        ("{joints: [bend, roll], matrix: [[1, 0]]}", "a matrix of 2 rows with 2 numbers"),
        ("{joints: [bend, roll], matrix: [[1, 1], [2, 2]]}", "singular"),
        ("{joints: [bend, roll], matrix: [[1, 0], [.nan, 1]]}", "not finite"),
        (
            "{joints: [bend, roll], matrix: [[1, 0], [1, 1]]}, {joints: [arm, roll], matrix: [[1, 0], [1, 1]]}",
            "'roll' stands in two couplings",
        ),
    ],
)
def test_what_a_coupling_cannot_be(tmp_path: Path, coupling: str, words: str) -> None:
    file = written(tmp_path)
    lines = file.read_text().splitlines()
    file.write_text("\n".join([*lines[:2], f"couplings: [{coupling}]"]))
    with pytest.raises(InputError, match=words) as error:
        load_model(file)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("place", "part"),
    [
        ("transmission", LinearSpring()),
        ("link_friction", Coulomb()),
    ],
)
def test_parts_that_coupled_motors_cannot_have(tmp_path: Path, place: str, part) -> None:
    system = load_model(written(tmp_path))
    with pytest.raises(InputError, match="coupled"):
        system.with_component(f"joint2/{place}", part)
    system.with_component(f"joint1/{place}", part)


def test_what_else_is_refused(tmp_path: Path) -> None:
    system = load_model(written(tmp_path))
    servo = system.with_component("joint2/input", PositionServo())
    with pytest.raises(InputError, match="link_encoder at 'joint2/sensor'"):
        servo.with_component("joint2/sensor", LinkEncoder())
    with pytest.raises(InputError, match="motor of roll is coupled with bend"):
        alone(system, 2)
    alone(system, 0)
    assert takes_by_joint(system, tmp_path, None) and takes_by_joint(robot(planar()), tmp_path, None)
    file = tmp_path / "flat.yaml"
    file.write_text(
        "system: one_link\ngear_ratio: [1]\ncouplings: [{joints: [a, b], matrix: [[1, 0], [1, 1]]}]\n"
    )
    with pytest.raises(InputError, match="'couplings' belongs to a robot"):
        load_model(file)


def test_gradients_are_those_of_finite_differences(tmp_path: Path) -> None:
    system = wrist(tmp_path, friction=0.05)
    system = system.with_component("joint3/motor_friction", LoadDependent(mu=0.05))
    system = system.with_component("joint2/load", Spring(k_s=1.0, q_s=0.1))
    x = [torch.tensor([v], dtype=torch.float64) for v in (2.0, 5.0, -4.0, -30.0, 1.0, 7.0)]
    u = {f"tau{k}": torch.tensor([0.01], dtype=torch.float64) for k in (1, 2, 3)}
    dt, engine = torch.tensor([STEP], dtype=torch.float64), Engine("dry", 2)

    def sample(theta):
        return torch.cat(engine.sample(system, x, u, dt, system.views(list(theta[:, None]))))

    theta = system.theta().detach()
    exact = torch.as_tensor(torch.autograd.functional.jacobian(sample, theta))
    for k in range(len(theta)):
        h = 1e-5 * max(float(theta[k].abs()), 1e-6)
        ahead, back = theta.clone(), theta.clone()
        ahead[k] += h
        back[k] -= h
        slope = (sample(ahead) - sample(back)) / (2 * h)
        np.testing.assert_allclose(exact[:, k], slope, rtol=1e-5, atol=1e-8 * float(slope.abs().max()) + 1e-9)
