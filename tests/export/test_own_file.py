"""A robot's own description with the drives put in: what changes, what stays, and that it moves as the model does."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hybrid_id.components import PositionServo
from hybrid_id.errors import InputError
from hybrid_id.export.mjcf import to_mjcf
from hybrid_id.export.own_file import mujoco_model
from hybrid_id.export.replay import agreement
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.record import Record
from hybrid_id.systems.chain import System
from hybrid_id.systems.model_file import load_model

mujoco = pytest.importorskip("mujoco")

ARM = """<?xml version="1.0"?>
<!-- my arm > the second -->
<mujoco model="mine">
  <compiler angle="degree"/>
  <option timestep="0.00025"/>
  <default>
    <default class="big"><joint armature="0.02" damping="0.1" frictionloss="0.05"/></default>
  </default>
  <worldbody>
    <body name="upper">
      <joint name='lift' class="big"
             axis="0 1 0" range="-170 170"/>  <!-- of 'steel' -->
      <inertial mass="0.5" pos="0 0 -0.1" diaginertia="0.001 0.001 0.0003"/>
      <body name="lower" pos="0 0 -0.2">
        <joint name="elbow" axis="0 1 0" armature="0.01" damping="0.05" stiffness="0.3" springref="20" />
        <inertial mass="0.2" pos="0 0 -0.08" diaginertia="0.0004 0.0004 0.0001"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="servo" joint="lift" kp="50" ctrlrange="-90 90"/>
  </actuator>
</mujoco>
"""


def arm(folder: Path, model: str = "robot: {file: arm.xml}\n", text: str = ARM) -> System:
    (folder / "arm.xml").write_text(text)
    (folder / "model.yaml").write_text(model)
    return load_model(folder / "model.yaml")


def changed(before: str, after: str) -> dict[str, str]:
    """Lines that differ, in files of which one has lines more at its end."""
    one, other = (text.splitlines() for text in (before, after))
    new = [line for line in other if line not in one]
    assert all(line in other for line in one if not re.search("lift|elbow|axis=", line))
    return {re.search(r"<(\S+)|axis", line)[0]: line for line in new}  # type: ignore[index]


def waves(system: System, sizes: list[float], channels: list[str]) -> Dataset:
    time = 0.004 * np.arange(400)
    inputs = {
        name: size * np.where(time < 0.05, 0.0, np.sin(2 * np.pi * (0.6 + 0.3 * k) * time))
        for k, (name, size) in enumerate(zip(channels, sizes, strict=True))
    }
    outputs = {f"q_m{joint.number}": 0.0 * time for joint in system.joints}
    return Dataset(
        "waves",
        tuple(Channel(name, {"u": "V", "t": "N m", "g": "rad", "i": "A"}[name[0]]) for name in inputs),
        tuple(Channel(name, "rad", 1e-4) for name in outputs),
        (Record("run", time, inputs, outputs),),
        0.004,
    )


def apart(system: System, data: Dataset) -> float:
    return max(row.apart for row in agreement(system, to_mjcf(system), data))


def test_only_what_the_drives_change_is_written(tmp_path: Path) -> None:
    system = arm(tmp_path).with_values({"F_c_lift": 0.07, "J_m_elbow": 0.03, "k_p_lift": 40.0})
    exported = to_mjcf(system)
    new = changed(ARM, exported.text)
    assert set(new) == {"axis", "<joint", "<position", "<general", "<!--"}
    stiff = 'solreffriction="0.0005 1" solimpfriction="0.9999 0.9999 0.001"'
    assert new["axis"] == (
        f'             axis="0 1 0" range="-170 170" frictionloss="0.07" {stiff}/>  <!-- of \'steel\' -->'
    )
    assert '<joint name="elbow" axis="0 1 0" armature="0.03" damping="0.05" stiffness="0.3"' in new["<joint"]
    model = mujoco_model(exported)
    assert model.dof_armature.tolist() == pytest.approx([0.02, 0.03])
    assert np.ravel(model.dof_frictionloss).tolist() == pytest.approx([0.07, 0.0])
    assert exported.motors == ("servo", "motor_elbow") and exported.joints == ("lift", "elbow")
    assert exported.notes == () and 'kp="40" ctrlrange="-90 90" kv="0"' in new["<position"]
    assert apart(system, waves(system, [0.4, 0.2], ["goal1", "tau2"])) < 2e-3


def test_what_dry_friction_holds_does_not_creep(tmp_path: Path) -> None:
    """The upper arm's weight stays below its friction: at MuJoCo's 2 ms it moves by less than a count in 20 s."""
    system = arm(tmp_path, text=ARM.replace("0.00025", "0.002"))
    model = mujoco_model(to_mjcf(system.with_values({"F_c_lift": 0.6, "F_c_elbow": 0.1, "k_p_lift": 1e-3})))
    data = mujoco.MjData(model)
    data.qpos[:] = 0.4, -0.4
    mujoco.mj_step(model, data, 500)
    start = data.qpos.copy()
    mujoco.mj_step(model, data, 10_000)
    assert abs(data.qfrc_bias[0]) > 0.2
    np.testing.assert_allclose(data.qpos, start, atol=1e-3)


def test_a_joint_that_is_held_is_held_there(tmp_path: Path) -> None:
    text = ARM.replace(' springref="20"', ' springref="20" ref="10"')
    system = arm(tmp_path, "robot: {file: arm.xml, hold: {elbow: 1.2}}\n", text)
    exported = to_mjcf(system)
    assert "elbow: held still in the model; here as the file has it" in exported.notes
    assert "equality" not in exported.text and exported.held == {"elbow": 1.2}
    assert apart(system, waves(system, [0.4], ["goal1"])) < 5e-3
    model = mujoco_model(exported)
    data = mujoco.MjData(model)
    data.joint("elbow").qpos[:] = 1.2
    mujoco.mj_step(model, data, 4000)
    assert float(data.joint("elbow").qpos[0]) == pytest.approx(1.2, abs=2e-3)


def test_a_gripper_is_held_in_the_model_and_grips_in_the_file(tmp_path: Path) -> None:
    finger = '<body name="{0}" pos="0 0 -0.2"><joint name="{0}" type="slide" axis="{1} 0 0" range="0 0.04"/>'
    finger += '<inertial mass="0.02" pos="0 0 -0.02" diaginertia="1e-5 1e-5 1e-5"/></body>'
    fingers = finger.format("left", 1) + finger.format("right", -1)
    wraps = "".join(f'<joint joint="{name}" coef="0.5"/>' for name in ("left", "right"))
    tendon = f'<tendon><fixed name="split">{wraps}</fixed></tendon>'
    tied = f'{tendon}<equality><joint joint1="left" joint2="right"/></equality>'
    text = ARM.replace('0.0001"/>', f'0.0001"/>{fingers}', 1).replace("  <actuator>", f"  {tied}<actuator>")
    pull = '<general name="grip" tendon="split" biastype="affine" gainprm="0.5" biasprm="0 -100 -10"/>'
    text = text.replace("  </actuator>", f"  {pull}</actuator>")
    with pytest.raises(InputError, match=r"left, right cannot .*tendon 'split'.*hold: {left: 0, right: 0}"):
        arm(tmp_path, text=text)
    model = "robot: {file: arm.xml, hold: {left: 0.01, right: 0.01}}\n"
    exported = to_mjcf(system := arm(tmp_path, model, text))
    assert tied in exported.text and pull in exported.text and exported.held == {"left": 0.01, "right": 0.01}
    assert apart(system, waves(system, [0.4, 0.2], ["goal1", "tau2"])) < 2e-3
    free = mujoco.MjModel.from_xml_string(exported.text)
    data = mujoco.MjData(free)
    data.actuator("grip").ctrl = 4.0
    mujoco.mj_step(free, data, 4000)
    assert float(data.joint("left").qpos[0]) == pytest.approx(0.02, abs=2e-3)


@pytest.mark.parametrize("own", ['<freejoint name="root"/>', "<freejoint/>"])
def test_a_robot_on_a_rack_floats_again_in_its_file(tmp_path: Path, own: str) -> None:
    base = f'<body name="trunk" pos="0 0 1">{own}<inertial mass="4" pos="0 0 0" diaginertia="0.1 0.1 0.1"/>'
    text = ARM.replace('<body name="upper">', f'{base}<body name="upper">').replace(
        "</worldbody>", "</body></worldbody>"
    )
    name = "root" if "name" in own else "trunk"
    system = arm(tmp_path, f"robot: {{file: arm.xml, hold: {{{name}: 0}}}}\n", text).with_values(
        {"F_c_lift": 0.07}
    )
    exported = to_mjcf(system)
    assert own in exported.text and exported.held == {name: 0.0}
    assert apart(system, waves(system, [0.4, 0.2], ["goal1", "tau2"])) < 2e-3
    free = mujoco.MjModel.from_xml_string(exported.text)
    assert free.nq == 9 and free.dof_armature[:6].tolist() == [0.0] * 6


def test_no_default_of_the_file_reaches_into_the_drives(tmp_path: Path) -> None:
    """MuJoCo has one default for all actuators, whatever their element is called."""
    limits = 'ctrlrange="-1 1" ctrllimited="true" forcerange="-0.02 0.02"'
    reach = f'{limits} gear="100" damping="2" armature="1" delay="0.05" nsample="200" actlimited="true" actdim="2"'
    drives = """
robot: {file: arm.xml}
gear_ratio: [50, 1]
components:
  - {place: lift/input, kind: voltage}
  - {place: lift/motor, kind: dc_motor, parameters: {P_m1: 0.004, P_m2: 0.01}}
  - {place: elbow/motor_friction, kind: lugre, parameters: {sigma_0: 100, sigma_1: 0.1}}
  - {place: elbow/load, kind: constant_torque, parameters: {T_0: 0.1}}
"""
    own = 'kp="50" gear="1" damping="0" armature="0" delay="0" nsample="0"'
    text = ARM.replace("<default>", f"<default><general {reach}/>", 1).replace('kp="50"', own)
    system = arm(tmp_path, drives, text)
    system = system.with_values({"F_c_elbow": 0.05})
    assert apart(system, waves(system, [6.0, 0.3], ["u1", "tau2"])) < 5e-3


def test_an_export_is_exported_once_more(tmp_path: Path) -> None:
    first = to_mjcf(arm(tmp_path, text=ARM.replace("<default>", '<default><motor ctrlrange="-1 1"/>', 1)))
    bias = "components: [{place: lift/load, kind: constant_torque, parameters: {T_0: 0.5}}]\n"
    again = to_mjcf(arm(tmp_path, f"robot: {{file: arm.xml}}\n{bias}", first.text))
    assert mujoco_model(again).nu == mujoco_model(first).nu + 1
    assert again.text.count('<default class="hybrid_id">') == 1


def test_angles_are_in_the_unit_that_an_included_file_gives(tmp_path: Path) -> None:
    (tmp_path / "common.xml").write_text('<mujocoinclude><compiler angle="radian"/></mujocoinclude>')
    text = ARM.replace('<compiler angle="degree"/>', '<include file="common.xml"/>').replace('"20"', '"0.35"')
    text = text.replace('range="-170 170"', 'range="-3 3"').replace('ctrlrange="-90 90"', "")
    system = arm(tmp_path, text=text)
    (name,) = (i.name for i in system.table if i.symbol == "q_s")
    model = mujoco_model(to_mjcf(system.with_values({name: 0.3})))
    assert float(model.qpos_spring[1]) == pytest.approx(0.3)


def test_the_base_of_a_urdf_does_not_touch_the_first_link(tmp_path: Path) -> None:
    """Links that a joint connects do not touch; MuJoCo makes the base a part of the world, which touches all."""
    body = '<inertial><mass value="0.4"/><inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial>'
    shape = '<collision><geometry><box size="0.2 0.2 0.2"/></geometry></collision>'
    (tmp_path / "arm.urdf").write_text(
        f'<robot name="r"><link name="base">{body}{shape}</link><link name="l1">{body}{shape}</link>'
        '<joint name="j1" type="continuous"><parent link="base"/><child link="l1"/><origin xyz="0 0 0.1"/>'
        '<axis xyz="0 1 0"/></joint></robot>'
    )
    (tmp_path / "model.yaml").write_text("robot: {file: arm.urdf}\n")
    model = mujoco_model(to_mjcf(load_model(tmp_path / "model.yaml")))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert data.ncon == 0


@pytest.mark.parametrize("element", ["position", "general", "motor"])
def test_a_position_loop_is_closed_by_mujoco(tmp_path: Path, element: str) -> None:
    own = {
        "position": '<position name="servo" joint="lift" kp="50"/>',
        "general": '<general name="servo" joint="lift" biastype="affine" gainprm="50" biasprm="0 -50"/>',
        "motor": '<motor name="servo" joint="lift" gear="3"/>',
    }[element]
    system = arm(
        tmp_path,
        """
robot: {file: arm.xml}
gear_ratio: [50, 1]
components:
  - place: lift/input
    kind: position_servo
    parameters: {k_p: 20, k_d: 0.4, tau_max: 1.5, e_0: 0.001, goal_min: -0.5, goal_max: 0.6}
  - {place: lift/input, kind: delay, parameters: {T_d: 0.008}}
""",
        text=re.sub("<position.*/>", own, ARM),
    )
    exported = to_mjcf(system)
    replaced = [n for n in exported.notes if "in the place of a motor the actuator takes the goal [rad]" in n]
    assert len(replaced) == (element == "motor")
    assert any("lift/input: position_servo is carried without its dead band" in n for n in exported.notes)
    model = mujoco_model(exported)
    assert model.actuator("servo").biasprm[:3].tolist() == [0.0, -20.0, -0.4]
    assert model.actuator("servo").forcerange.tolist() == [-1.5, 1.5]
    data = waves(system, [0.8, 0.2], ["goal1", "tau2"])
    assert apart(system, data) < 1e-2
    (record,) = data.records
    off = {**record.inputs, "enable1": (record.time < 0.8).astype(float)}
    switched = replace(
        data, inputs=(*data.inputs, Channel("enable1", "1")), records=(replace(record, inputs=off),)
    )
    assert apart(system, switched) < 1e-2


def test_a_goal_that_is_limited_on_one_side_is_limited_there(tmp_path: Path) -> None:
    one_side = "components: [{place: lift/input, kind: position_servo, parameters: {k_p: 20, k_d: 1, goal_min: -0.2}}]"
    system = arm(tmp_path, "robot: {file: arm.xml}\n" + one_side, ARM.replace(' ctrlrange="-90 90"', ""))
    assert mujoco_model(to_mjcf(system)).actuator("servo").ctrlrange.tolist() == [-0.2, 1e4]
    assert apart(system, waves(system, [0.8, 0.2], ["goal1", "tau2"])) < 2e-3


@pytest.mark.parametrize(
    "default",
    ['<position dampratio="1"/>', '<general biastype="affine" biasprm="0 -50 1"/>'],
    ids=["position", "general"],
)
def test_a_damping_ratio_of_a_default_gives_no_other_damping_to_another_rotor(
    tmp_path: Path, default: str
) -> None:
    system = arm(tmp_path, text=ARM.replace("<default>", f"<default>{default}", 1))
    damping = float(mujoco_model(to_mjcf(system)).actuator("servo").biasprm[2])
    heavier = system.with_values({"J_m_lift": 0.08})
    assert damping < -0.1
    assert float(mujoco_model(to_mjcf(heavier)).actuator("servo").biasprm[2]) == pytest.approx(damping)
    assert apart(heavier, waves(heavier, [0.4, 0.2], ["goal1", "tau2"])) < 2e-3


@pytest.mark.parametrize(
    ("actuator", "ratio", "commands", "forces"),
    [
        ('<motor joint="lift" gear="50" ctrlrange="-2 2"/>', 50, 2, 0),  # the gear is the drive's
        # torque at the joint: limits are those of the same torque there
        ('<motor joint="lift" gear="50" ctrlrange="-2 2" forcerange="-1 1"/>', 1, 100, 50),
        ('<velocity joint="lift" kv="5" gear="2" forcerange="-3 3"/>', 1, 0, 6),
        ('<position joint="lift" kp="5" kv="1" gear="2" ctrlrange="-1 1" forcerange="-3 3"/>', 1, 0.5, 6),
    ],
)
def test_gear_and_limits_of_an_actuator_are_kept(
    tmp_path: Path, actuator: str, ratio: float, commands: float, forces: float
) -> None:
    text = re.sub("<position.*/>", actuator, ARM)
    system = arm(tmp_path, f"robot: {{file: arm.xml}}\ngear_ratio: [{ratio}, 1]\n", text)
    model = mujoco_model(to_mjcf(system))
    assert model.nu == 2 and model.actuator_gear[0, 0] == ratio
    assert model.actuator_ctrlrange[0].tolist() == [-commands, commands]
    assert model.actuator_forcerange[0].tolist() == [-forces, forces]
    command = "goal1" if actuator.startswith("<position") else "tau1"
    assert apart(system, waves(system, [0.3 / ratio, 0.1], [command, "tau2"])) < 2e-3


@pytest.mark.parametrize(
    "actuator",
    ['<motor name="m" joint="lift" gear="2"/>', '<position name="m" joint="lift" gear="2" kp="5" kv="1"/>'],
)
def test_rotor_and_damping_of_an_actuator_are_once_in_the_file(tmp_path: Path, actuator: str) -> None:
    own = actuator.replace("/>", ' armature="0.01" damping="0.02"/>')
    system = arm(tmp_path, text=re.sub("<position.*/>", own, ARM))
    exported = to_mjcf(system)
    model = mujoco_model(exported)
    assert 'armature="0" damping="0"' in exported.text and not model.actuator_armature.any()
    assert model.dof_armature[0] == pytest.approx(0.02 + 4 * 0.01)
    assert np.ravel(model.dof_damping[0])[0] == pytest.approx(0.1 + 4 * 0.02)
    command = "goal1" if "position" in actuator else "tau1"
    assert apart(system, waves(system, [0.3, 0.1], [command, "tau2"])) < 2e-3


@pytest.mark.parametrize("apart", ['<position joint="lift" kp="5"/>', '<motor joint="lift" armature="0.1"/>'])
def test_an_included_actuator_that_acts_by_itself_is_refused(tmp_path: Path, apart: str) -> None:
    (tmp_path / "act.xml").write_text(f"<mujocoinclude><actuator>{apart}</actuator></mujocoinclude>")
    text = re.sub("<position.*/>", "", ARM).replace("<option", '<include file="act.xml"/><option')
    with pytest.raises(InputError, match="actuator of joint 'lift' stands in a file that this one includes"):
        to_mjcf(arm(tmp_path, text=text))


@pytest.mark.parametrize(
    "driven", ['<motor name="m" joint="lift"/>', '<position name="m" joint="lift" kp="5"/>']
)
@pytest.mark.parametrize("first", [True, False], ids=["drive first", "brake first"])
def test_a_brake_is_part_of_the_drive_and_all_keep_their_places_in_ctrl(
    tmp_path: Path, driven: str, first: bool
) -> None:
    brake, elbow = (
        '<velocity name="brake" joint="lift" kv="0.5" gear="2"/>',
        '<motor name="e" joint="elbow"/>',
    )
    text = re.sub("<position.*/>", (driven + brake if first else brake + driven) + elbow, ARM)
    more = '<keyframe><key ctrl="0 0 0"/></keyframe><sensor><actuatorpos actuator="brake"/></sensor></mujoco>'
    text = text.replace("</mujoco>", more)
    system = arm(tmp_path, text=text)
    exported = to_mjcf(system)
    model = mujoco_model(exported)
    assert model.actuator("e").id == 2 and model.actuator("brake").id == int(first)
    assert exported.motors == ("m", "e")
    assert any("it stays without effect, so that all keep their places in ctrl" in n for n in exported.notes)
    data = mujoco.MjData(model)
    data.qvel[0], data.ctrl[model.actuator("brake").id] = 1.0, 1.0
    mujoco.mj_forward(model, data)
    assert data.actuator("brake").force[0] == 0.0
    if "motor" in driven:
        assert np.ravel(model.dof_damping[0])[0] == pytest.approx(0.1 + 4 * 0.5)
    command = "tau1" if "motor" in driven else "goal1"
    assert apart(system, waves(system, [0.3, 0.1], [command, "tau2"])) < 2e-3
    again = to_mjcf(arm(tmp_path, text=exported.text))  # what has no effect counts for nothing
    assert again.notes == () and mujoco_model(again).nu == 3


def test_an_actuator_that_is_kept_says_that_it_takes_a_current(tmp_path: Path) -> None:
    driven = "{place: lift/input, kind: current_command}, "
    driven += "{place: lift/motor, kind: current_motor, parameters: {k_t: 2}}"
    text = re.sub("<position.*/>", '<motor name="m" joint="lift" ctrlrange="-3 3"/>', ARM)
    system = arm(tmp_path, f"robot: {{file: arm.xml}}\ncomponents: [{driven}]\n", text)
    exported = to_mjcf(system)
    (note,) = exported.notes
    assert "the gear 2 in the place of 1, and takes the motor's current [A]" in note
    assert apart(system, waves(system, [0.1, 0.1], ["i1", "tau2"])) < 2e-3


def test_a_compliant_gear_is_rigid_there_and_replays_all_the_same(tmp_path: Path) -> None:
    spring = (
        "components:\n  - {place: elbow/transmission, kind: linear_spring, parameters: {k: %g, d: 0.05}}\n"
    )
    far = []
    for stiffness in (5.0, 500.0):
        system = arm(tmp_path, "robot: {file: arm.xml}\n" + spring % stiffness)
        assert not system.joints[1].rigid
        exported = to_mjcf(system)
        assert any("the joint stays rigid" in note for note in exported.notes)
        data = waves(system, [0.5, 0.0], ["goal1", "tau2"])
        rows = agreement(system, exported, data)
        assert [row.output for row in rows] == ["q_m1", "q_m2"]
        far.append(max(row.apart for row in rows))
    assert far[1] < 0.02 < far[0], "what is left out matters where the spring is soft"


def test_a_urdf_becomes_an_mjcf(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(
        """<robot name="r"><link name="base"/><link name="rod"><inertial><origin xyz="0 0 -0.1"/><mass value="0.4"/>
<inertia ixx="0.001" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.0003"/></inertial></link>
<joint name="lift" type="continuous"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/>
<limit effort="1" velocity="5"/></joint></robot>"""
    )
    (tmp_path / "model.yaml").write_text("robot: {file: arm.urdf}\n")
    system = load_model(tmp_path / "model.yaml")
    exported = to_mjcf(system)
    finer = exported.text.replace("</mujoco>", '<option timestep="2.5e-4"/></mujoco>')
    assert "MuJoCo made an MJCF of it" in exported.notes[0]
    assert "lift: its actuatorfrcrange, -1 to 1 N m, stays" in exported.notes[1]
    assert mujoco_model(exported).dof_armature[0] == pytest.approx(system.parameter("J_m_lift").spec.value)
    data = waves(system, [0.3], ["tau1"])
    assert max(row.apart for row in agreement(system, replace(exported, text=finer), data)) < 2e-3


def test_a_joints_own_limit_of_torque_is_said(tmp_path: Path) -> None:
    text = ARM.replace('armature="0.01"', 'armature="0.01" actuatorfrcrange="-0.1 0.1"')
    exported = to_mjcf(arm(tmp_path, text=text))
    assert "elbow: its actuatorfrcrange, -0.1 to 0.1 N m, stays" in exported.notes[0]
    loop = "components: [{place: elbow/input, kind: position_servo, parameters: {k_p: 5, k_d: 0.2, tau_max: %s}}]"
    for largest, off in ((0.1, False), (0.3, True)):
        system = arm(tmp_path, "robot: {file: arm.xml}\n" + loop % largest, text)
        exported = to_mjcf(system)
        assert [off] == [any("is switched off, the servo's own limit" in one for one in exported.notes)]
        assert off == ('actuatorfrclimited="false"' in exported.text)
        assert apart(system, waves(system, [0.4, 0.5], ["goal1", "goal2"])) < 2e-3


def test_an_included_joint_is_refused_and_an_included_rest_is_kept(tmp_path: Path) -> None:
    (tmp_path / "model.yaml").write_text("robot: {file: scene.xml}\n")
    (tmp_path / "arm.xml").write_text(ARM)
    (tmp_path / "scene.xml").write_text('<mujoco><include file="arm.xml"/></mujoco>')
    with pytest.raises(InputError, match=r"'lift' stands in a file that this one includes.*model.yaml"):
        to_mjcf(load_model(tmp_path / "model.yaml"))
    (tmp_path / "floor.xml").write_text(
        '<mujoco><worldbody><geom name="f" type="plane" size="1 1 1"/></worldbody></mujoco>'
    )
    text = ARM.replace("  <option", '  <include file="floor.xml"/>\n  <option')
    exported = to_mjcf(arm(tmp_path, text=text))
    assert exported.home == tmp_path.resolve() and '<include file="floor.xml"/>' in exported.text
    assert mujoco_model(exported).ngeom == 1


COUPLED = """
robot: {file: arm.xml}
gear_ratio: [50, 20]
couplings: [{joints: [lift, elbow], matrix: [[1, 0], [0.5, 1]]}]
"""


def test_coupled_motors_become_tendons(tmp_path: Path) -> None:
    text = re.sub("<position.*/>", '<motor name="drive" joint="elbow" gear="3"/>', ARM)
    system = arm(tmp_path, COUPLED, text)
    system = system.with_values({"F_c_lift": 0.001, "F_c_elbow": 0.001, "J_m_elbow": 3e-5, "F_v_elbow": 2e-4})
    exported = to_mjcf(system)
    model = mujoco_model(exported)
    assert exported.motors == ("motor_lift", "drive") and exported.joints == ("lift", "elbow")
    assert model.tendon_armature.tolist() == pytest.approx([0.02, 3e-5 * 400])
    assert np.ravel(model.tendon_frictionloss).tolist() == pytest.approx([0.05, 0.02])
    assert not model.dof_armature.any() and not np.any(model.dof_frictionloss)
    data = mujoco.MjData(model)
    data.qpos[:] = 0.4, 0.3
    mujoco.mj_forward(model, data)
    assert data.ten_length.tolist() == pytest.approx([0.4, 0.5])
    assert apart(system, waves(system, [0.02, 0.02], ["tau1", "tau2"])) < 2e-3


def test_a_coupled_servo_closes_its_loop_over_its_own_shaft(tmp_path: Path) -> None:
    system = arm(tmp_path, COUPLED.replace("50, 20", "1, 1")).with_component(
        "joint2/input", PositionServo(k_p=20.0, k_d=0.2, tau_max=4.0)
    )
    exported = to_mjcf(system)
    assert exported.motors == ("servo", "motor_elbow")
    assert apart(system, waves(system, [0.4, 0.3], ["goal1", "goal2"])) < 2e-3
