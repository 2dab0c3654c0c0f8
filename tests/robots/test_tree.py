"""Rigid-body trees against MuJoCo and pinocchio, and against a pendulum by hand."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from trees import numbers, random_text, rows

from hybrid_id.errors import InputError
from hybrid_id.robots.description import load_tree
from hybrid_id.robots.rows import constant
from hybrid_id.robots.tree import Body, Carried, RigidBodyTree, SpatialInertia, TreeJoint, frame

EXACT = 1e-10
IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def dynamics(tree, q, v, bodies=()):
    """Mass matrix with the rotors' armature, and bias: ``M a + bias`` are the torques at the joints."""
    poses, inertias = tree.poses(q), tree.inertias(bodies)
    mass = tree.mass_matrix(poses, inertias)
    for k, joint in enumerate(tree.joints):
        mass[k][k] = mass[k][k] + joint.armature
    return mass, tree.inverse_dynamics(poses, inertias, v)


def matrix(found):
    return np.array([numbers(row) for row in found])


def mujoco_dynamics(path, seed):
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_path(str(path))
    data, rng = mujoco.MjData(model), np.random.default_rng(seed)
    data.qpos[:], data.qvel[:] = rng.normal(size=model.nq), rng.normal(size=model.nv)
    data.qfrc_applied[:] = rng.normal(size=model.nv)
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    names = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, j) for j in range(model.njnt)]
    return names, data, mass


@pytest.mark.parametrize("seed", range(24))
def test_random_trees_move_as_mujoco_has_them(tmp_path, seed):
    path = tmp_path / "robot.xml"
    path.write_text(random_text(seed))
    tree = load_tree(path)
    names, data, mass = mujoco_dynamics(path, seed)
    assert list(tree.names) == names
    found, bias = dynamics(tree, rows(data.qpos), rows(data.qvel))
    np.testing.assert_allclose(matrix(found), mass, rtol=0, atol=EXACT * np.abs(mass).max())
    np.testing.assert_allclose(
        numbers(bias), data.qfrc_bias, rtol=0, atol=EXACT * np.abs(data.qfrc_bias).max()
    )
    a = np.linalg.solve(matrix(found), data.qfrc_applied - numbers(bias))
    np.testing.assert_allclose(a, data.qacc, rtol=0, atol=EXACT * np.abs(data.qacc).max())


@pytest.mark.parametrize("seed", range(12))
def test_random_trees_move_as_pinocchio_has_them(tmp_path, seed):
    pin = pytest.importorskip("pinocchio")
    pytest.importorskip("mujoco")
    path = tmp_path / "robot.xml"
    path.write_text(random_text(100 + seed))
    tree = load_tree(path)
    model = pin.Model()
    model.gravity.linear = np.array(tree.gravity)
    for joint, inertia in zip(tree.joints, tree.inertias(), strict=True):
        kind = pin.JointModelRZ() if joint.kind == "hinge" else pin.JointModelPZ()
        place = pin.SE3(np.array(joint.rotation), np.array(joint.position))
        number = model.addJoint(joint.parent + 1, kind, place, joint.name)
        centre = np.array(inertia.moment) / inertia.mass
        skew = np.array([[0, -centre[2], centre[1]], [centre[2], 0, -centre[0]], [-centre[1], centre[0], 0]])
        about = np.array(inertia.inertia) + inertia.mass * skew @ skew
        model.appendBodyToJoint(number, pin.Inertia(inertia.mass, centre, about), pin.SE3.Identity())
    data, rng, n = model.createData(), np.random.default_rng(seed), len(tree.joints)
    q, v, a = rng.normal(size=(3, n))
    poses, inertias = tree.poses(rows(q)), tree.inertias()
    mass = pin.crba(model, data, q)
    mass = np.triu(mass) + np.triu(mass, 1).T
    np.testing.assert_allclose(
        matrix(tree.mass_matrix(poses, inertias)), mass, rtol=0, atol=EXACT * np.abs(mass).max()
    )
    torque = pin.rnea(model, data, q, v, a)
    found = numbers(tree.inverse_dynamics(poses, inertias, rows(v), rows(a)))
    np.testing.assert_allclose(found, torque, rtol=0, atol=EXACT * np.abs(torque).max())


def pendulum(mass=2.0, length=0.5, inertia=0.1):
    """About the y axis, hanging down along -z at zero."""
    body = SpatialInertia.about_centre(
        mass, (0.0, 0.0, 0.0), tuple(tuple(inertia * e for e in r) for r in IDENTITY)
    )
    rotation = frame((0.0, 1.0, 0.0))
    back = constant(np.array(rotation).T.tolist())
    position = tuple(float(x) for x in np.array(back) @ np.array([0.0, 0.0, -length]))
    return RigidBodyTree(
        (TreeJoint("swing", "hinge", -1, rotation, (0.0, 0.0, 0.0)),), (Body("bob", 0, back, position, body),)
    )


def test_a_pendulum_is_the_textbooks():
    angle = torch.linspace(-3.0, 3.0, 7, dtype=torch.float64)
    mass, bias = dynamics(pendulum(), [angle], [torch.ones_like(angle)])
    assert mass[0][0] == pytest.approx(0.1 + 2.0 * 0.25)
    torch.testing.assert_close(bias[0], 2.0 * 9.81 * 0.5 * torch.sin(angle))


def test_the_torque_is_the_energys_derivative():
    """Kinetic energy 1/2 v' M v stays where no torque acts and there is no gravity."""
    tree = pendulum()
    chain = RigidBodyTree(
        (*tree.joints, TreeJoint("second", "hinge", 0, frame((1.0, 0.0, 0.0)), (0.1, 0.4, -0.2))),
        (*tree.bodies, Body("end", 1, IDENTITY, (0.3, 0.1, 0.0), tree.bodies[0].inertia)),
        gravity=(0.0, 0.0, 0.0),
    )
    q = torch.tensor([0.3, -0.8], dtype=torch.float64, requires_grad=True)
    v = torch.tensor([1.1, -0.7], dtype=torch.float64)

    def energy(q, v):
        mass, _ = dynamics(chain, [q[:1], q[1:]], [v[:1], v[1:]])
        whole = torch.stack([torch.stack([torch.as_tensor(e).reshape(()) for e in row]) for row in mass])
        return 0.5 * v @ whole @ v, whole

    kinetic, whole = energy(q, v)
    (slope,) = torch.autograd.grad(kinetic, q)
    _, bias = dynamics(chain, [q[:1], q[1:]], [v[:1], v[1:]])
    torque = torch.stack([torch.as_tensor(b).reshape(()) for b in bias])
    # with no torque applied, M a = -bias, and the energy stays: v . M a + dT/dq . v = 0
    assert float((-torque @ v + slope @ v).detach()) == pytest.approx(0.0, abs=1e-12)
    assert whole.shape == (2, 2)


def test_free_inertias_take_the_place_of_the_descriptions():
    tree = pendulum()
    heavy = SpatialInertia.about_centre(torch.tensor([4.0], dtype=torch.float64), (0.0, 0.0, 0.0), IDENTITY)
    mass, _ = dynamics(tree, rows([0.0]), rows([0.0]), [replace(tree.bodies[0], inertia=heavy)])
    assert float(mass[0][0]) == pytest.approx(1.0 + 4.0 * 0.25)


def test_lanes_are_batched():
    tree = pendulum()
    q = torch.linspace(-1, 1, 5, dtype=torch.float64)
    _, bias = dynamics(tree, [q], [q])
    each = [float(dynamics(tree, [one[None]], [one[None]])[1][0]) for one in q]
    np.testing.assert_allclose(torch.as_tensor(bias[0]).numpy(), each)


def test_a_joint_stands_after_its_parent():
    one = TreeJoint("one", "hinge", 1, IDENTITY, (0.0, 0.0, 0.0))
    with pytest.raises(InputError, match="'one' stands before"):
        RigidBodyTree((one, TreeJoint("two", "hinge", -1, IDENTITY, (0.0, 0.0, 0.0))), ())


def test_an_axis_is_the_third_column_of_its_frame():
    rng = np.random.default_rng(0)
    for axis in [*np.eye(3), *-np.eye(3), *rng.normal(size=(20, 3))]:
        unit = axis / math.sqrt(float(axis @ axis))
        found = np.array(frame(unit.tolist()))
        np.testing.assert_allclose(found[:, 2], unit, atol=1e-15)
        np.testing.assert_allclose(found @ found.T, np.eye(3), atol=1e-14)
        assert np.linalg.det(found) == pytest.approx(1.0)


@pytest.mark.parametrize("seed", range(6))
def test_held_joints_are_part_of_what_carries_them(tmp_path, seed):
    path = tmp_path / "robot.xml"
    path.write_text(random_text(seed))
    tree = load_tree(path)
    rng = np.random.default_rng(seed)
    held = {name: float(rng.normal()) for name in tree.names if rng.random() < 0.5}
    held.pop(tree.names[-1], None)
    less = tree.holding(held)
    assert less.held == held
    moving = [k for k, name in enumerate(tree.names) if name not in held]
    q, v = rng.normal(size=len(tree.names)), rng.normal(size=len(tree.names))
    for k, name in enumerate(tree.names):
        q[k], v[k] = held.get(name, q[k]), 0.0 if name in held else v[k]
    mass, bias = dynamics(tree, rows(q), rows(v))
    found_mass, found_bias = dynamics(less, rows(q[moving]), rows(v[moving]))
    np.testing.assert_allclose(matrix(found_mass), matrix(mass)[np.ix_(moving, moving)], atol=EXACT)
    np.testing.assert_allclose(numbers(found_bias), numbers(bias)[moving], atol=EXACT)


def test_holding_refuses_an_unknown_joint_and_all_of_them(tmp_path):
    path = tmp_path / "robot.xml"
    path.write_text(random_text(3))
    tree = load_tree(path)
    with pytest.raises(InputError, match="no joint 'elbow' to hold"):
        tree.holding({"elbow": 0.0})
    with pytest.raises(InputError, match="Every joint"):
        tree.holding(dict.fromkeys(tree.names, 0.0))
    short = replace(tree, joints=tuple(replace(joint, limits=(-0.1, 1.4)) for joint in tree.joints))
    for far in (40.0, float("nan"), float("inf")):
        with pytest.raises(InputError, match=r"cannot be held at .*reaches from -0.1 to 1.4"):
            short.holding({tree.names[0]: far})


@pytest.mark.parametrize("seed", range(6))
def test_pushes_act_as_mujoco_has_them(tmp_path, seed):
    mujoco = pytest.importorskip("mujoco")
    path = tmp_path / "robot.xml"
    path.write_text(random_text(seed))
    tree, rng = load_tree(path), np.random.default_rng(seed)
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    data.qpos[:] = rng.normal(size=model.nq)
    mujoco.mj_forward(model, data)
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, f"f{len(tree.names) - 1}")
    force, jacobian = rng.normal(size=3), np.zeros((3, model.nv))
    mujoco.mj_jac(model, data, jacobian, None, data.xpos[body], body)
    names = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, j) for j in range(model.njnt)]
    order = [names.index(name) for name in tree.names]
    point = tree.points[f"f{len(tree.names) - 1}"]
    poses, still = tree.poses(rows(data.qpos[order])), [0.0] * len(order)
    np.testing.assert_allclose(numbers(tree.place(poses, point)), data.xpos[body], atol=EXACT)
    push = tuple(rows(force))
    alone = tree.inverse_dynamics(poses, tree.inertias(), still)
    pushed = tree.inverse_dynamics(poses, tree.inertias(), still, pushes=[(point, push)])
    np.testing.assert_allclose(numbers(alone) - numbers(pushed), (jacobian.T @ force)[order], atol=EXACT)


@pytest.mark.parametrize("seed", range(6))
def test_one_joint_alone_moves_as_the_whole_tree_has_it(tmp_path, seed):
    path = tmp_path / "robot.xml"
    path.write_text(random_text(seed))
    tree, rng = load_tree(path), np.random.default_rng(seed)
    n, points, fall = len(tree.joints), list(tree.points.values()), (1.0, 0.5, -9.0)
    q, v, a = ([torch.tensor(one) for one in rng.normal(size=(n, 3))] for _ in range(3))

    def force(height):
        return 300.0 * (0.1 - height).clamp_min(0.0)

    # every body has another mass and centre, and one is added
    bodies = [
        replace(body, inertia=body.inertia.deviating(1.3, (0.02, -0.01, 0.03), IDENTITY))
        for body in tree.bodies
    ]
    bodies.append(replace(bodies[-1], name="payload"))
    poses, inertias = tree.poses(q), tree.inertias(bodies)
    pushes = [(point, (0.0, 0.0, force(tree.place(poses, point)[2]))) for point in points]
    for k in range(n):
        bias = tree.inverse_dynamics(
            poses, inertias, v, [0.0 * x if j == k else x for j, x in enumerate(a)], pushes, fall
        )
        load = tree.carried(k, q, v, a, tree.inertias(), points)
        load = Carried.of(tree.joints[k].kind, load.groups)
        for body in bodies:
            load = load.heavier(body.joint, tree.deviation(body)) if tree.carries(k, body.joint) else load
        load = load.falling(tuple(new - old for new, old in zip(fall, tree.gravity, strict=True)))
        found = tree.opposing(k, load, q[k], v[k], [force] * len(load.places))
        expected = tree.mass_matrix(poses, inertias)[k][k], bias[k]
        for one, other in zip(found, expected, strict=True):
            torch.testing.assert_close(
                torch.as_tensor(one), torch.as_tensor(other), rtol=1e-11, atol=1e-11, check_dtype=False
            )
