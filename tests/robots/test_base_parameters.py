"""The regressor against inverse dynamics and MuJoCo, and numbers of base parameters that are known."""

import numpy as np
import pytest
from trees import numbers, random_text, rows

from hybrid_id.robots.base_parameters import base_parameters, inertial_parameters, whole_regressor
from hybrid_id.robots.description import load_tree

mujoco = pytest.importorskip("mujoco")

EXACT = 1e-10


@pytest.mark.parametrize("seed", range(16))
def test_torques_are_the_regressor_times_the_inertial_parameters(tmp_path, seed):
    path = tmp_path / "robot.xml"
    path.write_text(random_text(seed))
    tree, rng = load_tree(path), np.random.default_rng(seed)
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    q, v, a = rng.normal(size=(3, 1, model.nv))
    found = (whole_regressor(tree, q, v, a) @ inertial_parameters(tree))[0]
    data.qpos[:], data.qvel[:], data.qacc[:] = q[0], v[0], a[0]
    mujoco.mj_inverse(model, data)
    size = EXACT * np.abs(data.qfrc_inverse).max()
    np.testing.assert_allclose(found, data.qfrc_inverse, rtol=0, atol=size)
    torque = tree.inverse_dynamics(tree.poses(rows(q[0])), tree.inertias(), rows(v[0]), rows(a[0]))
    armature = np.array([joint.armature for joint in tree.joints])
    np.testing.assert_allclose(found, numbers(torque) + armature * a[0], rtol=0, atol=size)


@pytest.mark.parametrize("seed", range(4))
def test_base_parameters_give_the_same_torques(tmp_path, seed):
    (tmp_path / "robot.xml").write_text(random_text(seed))
    tree, rng = load_tree(tmp_path / "robot.xml"), np.random.default_rng(seed)
    base = base_parameters(tree)
    w = whole_regressor(tree, *rng.normal(size=(3, 20, len(tree.joints))))
    phi = rng.normal(size=len(base.names))
    torque = w @ phi
    found = w[..., list(base.independent)] @ (base.grouping @ phi)
    np.testing.assert_allclose(found, torque, rtol=0, atol=1e-8 * np.abs(torque).max())


def chain(joints, gravity="0 0 -9.81"):
    """A chain of joints, each by its axis and its place in the one before, ``slide`` before the axis of a slide."""
    text, ends = "", ""
    for k, (axis, place) in enumerate(joints):
        kind, axis = ("slide", axis.removeprefix("slide ")) if axis.startswith("slide") else ("hinge", axis)
        text += (
            f'<body pos="{place}"><joint name="j{k + 1}" type="{kind}" axis="{axis}" armature="0.1"/>'
            '<inertial mass="1" pos="0.1 0.02 0.03" diaginertia="0.1 0.12 0.15"/>'
        )
        ends += "</body>"
    return f'<mujoco><option gravity="{gravity}"/><worldbody>{text}{ends}</worldbody></mujoco>'


@pytest.mark.parametrize("limits", ["3.3 5.2", "-5.2 -3.3", "-1 1", "-9 9"])
def test_the_number_does_not_depend_on_where_the_range_lies(tmp_path, limits):
    joints = [("0 1 0", "0 0 0"), ("0 1 0", "0.4 0 0")]
    free = chain(joints)
    within = free.replace('type="hinge"', f'type="hinge" range="{limits}"')
    counts = []
    for text in (free, within.replace("<mujoco>", '<mujoco><compiler angle="radian"/>')):
        (tmp_path / "robot.xml").write_text(text)
        counts.append(len(base_parameters(load_tree(tmp_path / "robot.xml")).independent))
    assert counts[0] == counts[1]


PUMA = [
    ("0 0 1", "0 0 0"), ("0 1 0", "0 0.1 0.3"), ("0 1 0", "0.4 0 0"), ("1 0 0", "0.4 0.05 0.02"), ("0 1 0", "0 0 0"),
    ("1 0 0", "0 0 0"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("joints", "gravity", "links", "rotors"),
    [
        # one link in the plane of gravity: Izz, mx, my
        ([("0 0 1", "0 0 0")], "0 -9.81 0", 3, 0),
        ([("0 0 1", "0 0 0")], "0 0 -9.81", 1, 0),
        # planar arm (Khalil and Dombre, section 9.4): Izz1, mx1, my1, Izz2, mx2, my2; level: Izz1, Izz2, mx2, my2
        ([("0 0 1", "0 0 0"), ("0 0 1", "0.5 0 0")], "0 -9.81 0", 6, 1),
        ([("0 0 1", "0 0 0"), ("0 0 1", "0.5 0 0")], "0 0 -9.81", 4, 1),
        # two masses on one rail: the sum and the second
        ([("slide 1 0 0", "0 0 0"), ("slide 1 0 0", "0 0 0")], "0 0 -9.81", 2, 1),
        # six joints with a spherical wrist (Gautier and Khalil 1990, Puma 560): 36, and rotors 3 to 6
        (PUMA, "0 0 -9.81", 36, 4),
    ],
)
def test_numbers_of_base_parameters_are_the_known_ones(tmp_path, joints, gravity, links, rotors):
    (tmp_path / "robot.xml").write_text(chain(joints, gravity))
    base = base_parameters(load_tree(tmp_path / "robot.xml"))
    symbols = [base.names[k].split("_")[0] for k in base.independent]
    assert len(symbols) - symbols.count("Ia") == links
    assert symbols.count("Ia") == rotors


def test_a_planar_arms_combinations_are_those_of_the_book(tmp_path):
    (tmp_path / "robot.xml").write_text(chain([("0 0 1", "0 0 0"), ("0 0 1", "0.5 0 0")], "0 -9.81 0"))
    base = base_parameters(load_tree(tmp_path / "robot.xml"))
    texts = {base.text(k) for k in range(len(base.independent))}
    assert texts == {
        "Izz_j1 + Ia_j1 + 0.25 m_j2", "mx_j1 + 0.5 m_j2", "my_j1", "Izz_j2", "mx_j2", "my_j2", "Ia_j2",
    }  # fmt: skip
    assert base.text(0, most=1).endswith(" more") or base.text(1, most=1).endswith(" more")
    assert {"m_j1", "mz_j1", "Ixx_j1", "mz_j2", "Ixx_j2"} <= set(base.without_effect)
