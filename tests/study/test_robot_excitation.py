"""Motions of an arm: inside every limit, with torques that are MuJoCo's, and more informative than chance."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hybrid_id.errors import InputError
from hybrid_id.robots.description import load_tree
from hybrid_id.study.excitation import ArmExcitation, JointLimits, design_arm_motion, joint_limits
from hybrid_id.systems.builders import robot

mujoco = pytest.importorskip("mujoco")

ARM = """<mujoco><option gravity="0 0 -9.81"/><worldbody>
<body><joint name="swing" axis="0 1 0" range="-100 60" armature="0.02" damping="0.3" frictionloss="0.1"/>
<inertial mass="0.4" pos="0.1 0 0" diaginertia="1e-3 1e-3 1e-3"/>
<body pos="0.2 0 0"><joint name="bend" axis="0 1 0" range="-90 90" armature="0.01" damping="0.2" frictionloss="0.05"/>
<inertial mass="0.2" pos="0.1 0 0" diaginertia="5e-4 5e-4 5e-4"/></body></body></worldbody>
<actuator><position joint="swing" kp="20" forcerange="-2.5 2.5"/><motor joint="bend"/></actuator></mujoco>"""
URDF = """<robot name="one"><link name="base"/><link name="arm"><inertial><mass value="1"/><origin xyz="0.1 0 0"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="turn" type="revolute">
<parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>{limit}</joint></robot>"""
SPEEDS, TORQUES = {"swing": 3.0, "bend": 4.0}, {"bend": 1.0}
SETTINGS = {"sample_time": 0.01, "duration": 5.0, "tones": 6, "starts": 2}


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("arm") / "arm.xml"
    path.write_text(ARM)
    return path


@pytest.fixture(scope="module")
def design(arm: Path) -> ArmExcitation:
    system = robot(load_tree(arm))
    return design_arm_motion(system, joint_limits(system, SPEEDS, TORQUES), (0.2, 2.0), **SETTINGS)


def test_every_limit_holds_and_one_is_reached(design: ArmExcitation) -> None:
    for k, one in enumerate(design.limits):
        assert (
            one.position[0] <= design.position[:, k].min() and design.position[:, k].max() <= one.position[1]
        )
    shares = [
        np.abs(part).max(0) / [getattr(one, name) for one in design.limits]
        for name, part in (("speed", design.speed), ("torque", design.torque))
    ]
    assert np.max(shares) <= 1.0 + 1e-9
    assert np.max(shares) > 0.98
    assert design.std_ratio < 1.0


def test_it_begins_and_ends_at_rest_in_the_middle(design: ArmExcitation) -> None:
    middle = [0.5 * sum(one.position) for one in design.limits]
    for end in (0, -1):
        np.testing.assert_allclose(design.position[end], middle, atol=1e-6)
        np.testing.assert_allclose(design.speed[end], 0.0, atol=1e-6)
    np.testing.assert_allclose(
        np.gradient(design.position, design.time, axis=0)[1:-1], design.speed[1:-1], atol=0.02
    )


def test_torques_are_those_of_mujoco(arm: Path, design: ArmExcitation) -> None:
    model = mujoco.MjModel.from_xml_path(str(arm))
    data, friction = mujoco.MjData(model), np.array(model.dof_frictionloss)
    model.dof_frictionloss[:] = 0.0
    acceleration = np.gradient(design.speed, design.time, axis=0)
    for t in range(10, len(design.time) - 10, 50):
        data.qpos, data.qvel, data.qacc = design.position[t], design.speed[t], acceleration[t]
        mujoco.mj_inverse(model, data)
        needed = data.qfrc_inverse + friction * np.sign(design.speed[t])
        np.testing.assert_allclose(design.torque[t], needed, atol=0.02)


def test_weak_motors_are_refused(arm: Path) -> None:
    system = robot(load_tree(arm))
    with pytest.raises(InputError, match="cannot hold the robot"):
        design_arm_motion(
            system, joint_limits(system, SPEEDS, {"bend": 1.0, "swing": 0.1}), (0.2, 2.0), **SETTINGS
        )


def test_limits_come_from_urdf_or_are_asked_for(arm: Path, tmp_path: Path) -> None:
    file = tmp_path / "one.urdf"
    file.write_text(URDF.format(limit='<limit lower="-1" upper="2" effort="5" velocity="3"/>'))
    (found,) = joint_limits(robot(load_tree(file)))
    assert found == JointLimits("turn", (-1.0, 2.0), 3.0, 5.0)
    shrunk = found.within(0.5)
    assert (shrunk.speed, shrunk.torque) == (1.5, 2.5)
    np.testing.assert_allclose(shrunk.position, (-0.25, 1.25))
    with pytest.raises(InputError, match="'swing' has no largest speed"):
        joint_limits(robot(load_tree(arm)))
    with pytest.raises(InputError, match="'bend' has no largest torque"):
        joint_limits(robot(load_tree(arm)), SPEEDS)
    tree = load_tree(file)
    endless = replace(tree, joints=tuple(replace(j, limits=(-np.inf, np.inf)) for j in tree.joints))
    with pytest.raises(InputError, match="'turn' has no position limits"):
        joint_limits(robot(endless))
    file.write_text(URDF.format(limit='<limit lower="-1" upper="2" effort="5" velocity="fast"/>'))
    with pytest.raises(InputError, match="velocity 'fast'"):
        load_tree(file)
