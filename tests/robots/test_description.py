"""Descriptions that are read, and those that are refused in one sentence that names the element."""

from pathlib import Path

import pytest

from hybrid_id.errors import InputError
from hybrid_id.robots.description import load_tree
from hybrid_id.systems.builders import robot
from hybrid_id.systems.model_file import load_model

mujoco = pytest.importorskip("mujoco")

SHARED = Path(__file__).parents[3] / "shared" / "data"
BODY = (
    '<body name="{name}">{joint}<inertial mass="1" pos="0 0 0.1" diaginertia="0.1 0.1 0.1"/>{inside}</body>'
)
HINGE = '<joint name="turn" axis="0 1 0"/>'


def described(tmp_path, world, rest=""):
    path = tmp_path / "robot.xml"
    path.write_text(f"<mujoco>{rest}<worldbody>{world}</worldbody></mujoco>")
    return path


def arm(joint=HINGE, inside=""):
    return BODY.format(name="link", joint=joint, inside=inside)


MESH = '<geom type="mesh" mesh="shape"/>'
GONE = '<asset><mesh name="shape" file="gone.stl"/></asset>'
FULL = '<inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>'
BARE = '<body name="tip">{}<joint name="wrist" axis="0 0 1"/><body name="pin"/></body>'


def turning(attributes: str) -> str:
    return arm(f'<joint name="turn" axis="0 1 0" {attributes}/>')


def driven(*actuators: str) -> str:
    return f"<actuator>{''.join(actuators)}</actuator>"


def switched_off(flag: str) -> str:
    return f'<option gravity="0 0 -9.81"><flag {flag}="disable"/></option>'


@pytest.mark.parametrize(
    ("world", "rest", "words"),
    [
        (arm('<joint name="b" type="ball"/>'), "", "joint 'b' of body 'link' is a ball joint.*put hinges in its place"),
        (arm(), '<option viscosity="1"/>', "fluid"),
        (BODY.format(name="stone", joint="", inside=""), "", "no joint that moves"),
        (arm('<joint axis="0 1 0"/>'), "", "joint of body 'link' has no name"),
        (f"<body><freejoint/>{arm()}</body>", "", "the floating base has no name"),
        (f'<body name="turn"><freejoint/>{arm()}</body>', "", "the floating base is called 'turn' as another joint is"),
        ("<body", "", "robot.xml"),
        (arm(), switched_off("frictionloss"), '<flag frictionloss="disable"/> switches off'),
        (arm(), switched_off("actuation"), '<flag actuation="disable"/> switches off'),
        (arm(), switched_off("clampctrl"), '<flag clampctrl="disable"/> switches off'),
        # masses
        (f'<body name="bare">{HINGE}{MESH}</body>', GONE, "mesh 'shape' of body 'bare'"),
        (f"<body>{HINGE}{FULL}{MESH}</body>", '<compiler inertiafromgeom="true"/>' + GONE, "inertiafromgeom asks"),
        (arm().replace('mass="1"', 'mass="-0.03"'), "", "mass of body 'link' is -0.03 kg"),
        (BARE.format(""), "", r"no joint has an inertia to move \(bodies tip, pin\); .*<inertial>"),
        (BARE.format(FULL.replace("1 1 1", "0 0 0")), "", "no joint has an inertia to move"),
        # joints
        (turning('damping="-0.6"'), "", "damping of joint 'turn' is -0.6; give 0 or more"),
        (turning('frictionloss="-1"'), "", "frictionloss of joint 'turn' is -1; give 0 or more"),
        (turning('damping="0.5 2 0"'), "", "damping of joint 'turn' is a polynomial"),
        (turning('stiffness="0.5 2 0"'), "", "stiffness of joint 'turn' is a polynomial"),
        # actuators
        (arm(), driven('<position joint="turn" kp="0"/>'), "kp of the actuator of joint 'turn' is 0; give more"),
        (arm(), driven('<position joint="turn" kp="8"/><motor joint="turn"/>'), "joint 'turn' has 2 actuators"),
        (arm(), driven('<motor joint="turn" damping="0.1 0.2 0"/>'), "damping of the actuator of joint 'turn' is a p"),
        (arm(), driven('<motor joint="turn" damping="-1"/>'), "damping of joint 'turn' is -1; give 0 or more"),
        (arm(), driven('<motor joint="turn" delay="0.01" nsample="5"/>'),
         r"joint 'turn' has a delay.* \{place: turn/input, kind: delay, .*T_d: 0.01\}\}"),
        (arm(), driven('<position joint="turn" kp="9"/><velocity joint="turn" kv="10" forcerange="-1 1"/>'),
         "velocity actuator that brakes joint 'turn' has a forcerange"),
        *[
            (arm(), driven(f"<{kind} joint='turn' {loop}/>"), "actuator of joint 'turn' acts by the angle in another")
            for kind, loop in (
                ("position", 'kp="5" timeconst="0.1"'), ("position", 'kp="5" gear="-1"'),
                ("pid", 'kp="5"'), ("pid", 'kp="5" kv="1" ki="2"'), ("intvelocity", 'kp="5" actrange="-1 1"'),
                ("general", 'gainprm="0" biastype="affine" biasprm="0 -5 0"'),
                ("general", 'gainprm="5" biastype="affine" biasprm="1 -5 0"'),
            )
        ],
    ],
)  # fmt: skip
def test_what_is_not_supported_is_refused(tmp_path, world, rest, words):
    with pytest.raises(InputError, match=words) as error:
        load_tree(described(tmp_path, world, rest))
    assert "\n" not in str(error.value)
    assert str(error.value).startswith(str(tmp_path / "robot.xml"))


def test_a_joint_that_mimics_another_is_named_and_can_be_held(tmp_path):
    link = (
        '<link name="{}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
        "</inertial></link>"
    )
    joint = '<joint name="{}" type="continuous"><parent link="base"/><child link="{}"/><axis xyz="0 1 0"/>{}</joint>'
    mimic = '<mimic joint="thumb" multiplier="2"/>'
    parts = link.format("one") + link.format("two") + joint.format("thumb", "one", "")
    path = tmp_path / "hand.urdf"
    path.write_text(
        f'<robot name="r"><link name="base"/>{parts}{joint.format("finger", "two", mimic)}</robot>'
    )
    tree = load_tree(path)
    assert set(tree.tied) == {"thumb", "finger"}
    with pytest.raises(InputError, match=r"thumb, finger cannot move .*mimic 1.*hold: {thumb: 0, finger: 0}"):
        robot(tree)
    (tmp_path / "model.yaml").write_text("robot: {file: hand.urdf, hold: {finger: 0.0, thumb: 0.2}}\n")
    with pytest.raises(InputError, match="Every joint of the robot is held"):
        load_model(tmp_path / "model.yaml")


TIP = BODY.format(name="tip", joint='<joint name="bend"/>', inside=BODY.format(
    name="jaw", joint='<joint name="grip" type="slide" range="0 1"/>', inside='<site name="end"/>'))  # fmt: skip
FIXED = '<tendon><fixed name="t" {}><joint joint="bend" coef="0.5"/><joint joint="grip" coef="1"/></fixed></tendon>'
SPATIAL = '<tendon><spatial name="t" stiffness="1"><site site="end"/><site site="base"/></spatial></tendon>'


@pytest.mark.parametrize(
    ("rest", "tied", "words"),
    [
        (FIXED.format(""), "", ""),  # which pulls nothing
        (FIXED.format('stiffness="1"'), "bend grip", "tendon 't'"),
        (FIXED.format("") + '<actuator><motor tendon="t"/></actuator>', "bend grip", "tendon 't'"),
        (SPATIAL, "turn bend grip", "tendon 't'"),
        ('<equality><joint name="e" joint1="grip" polycoef="0.3"/></equality>', "grip", "equality 'e'"),
        ('<equality><joint joint1="grip" joint2="bend"/></equality>', "bend grip", "equality 1"),
        ('<equality><joint joint1="grip" active="false"/></equality>', "", ""),
        ('<option><flag equality="disable"/></option><equality><joint joint1="grip"/></equality>', "", ""),
        ('<equality><connect body1="jaw" body2="link" anchor="0 0 0"/></equality>', "bend grip", "equality 1"),
        ('<equality><weld body1="tip"/></equality>', "turn bend", "equality 1"),
        ('<equality><weld site1="end" site2="base"/></equality>', "turn bend grip", "equality 1"),
        (FIXED.format("") + '<equality><tendon name="e" tendon1="t"/></equality>', "bend grip", "equality 'e'"),
    ],
)  # fmt: skip
def test_joints_that_something_ties_may_be_held_alone(tmp_path, rest, tied, words):
    path = described(tmp_path, '<site name="base"/>' + arm(inside=TIP), rest)
    tree, names = load_tree(path), tied.split()
    assert set(tree.tied) == set(names)
    if not names:
        assert len(robot(tree).joints) == 3
        return
    with pytest.raises(InputError, match=words) as error:
        robot(tree)
    hold = ", ".join(f"{name}: {tie.at:g}" for name, tie in tree.tied.items())
    assert f"hold: {{{hold}}}" in str(error.value) and "\n" not in str(error.value)
    assert str(error.value).startswith(str(path))
    if len(names) < 3:
        still = tree.holding({name: 0.0 for name in names})
        assert not still.tied and len(robot(still).joints) == 3 - len(names)


def test_a_floating_base_has_to_be_held_and_what_lies_beside_the_robot_is_left_out(tmp_path):
    cube = '<body name="cube" pos="1 0 0"><freejoint/><geom size="0.1"/></body>'
    for own, name in (('<freejoint name="root"/>', "root"), ("<freejoint/>", "trunk")):
        leg = BODY.format(name="trunk", joint=own, inside=arm(inside=TIP))
        path = described(tmp_path, cube + leg.replace("<body ", '<body pos="0 0 2" ', 1))
        tree = load_tree(path)
        assert tree.names == ("turn", "bend", "grip") and {body.name for body in tree.bodies} == {
            "link",
            "tip",
            "jaw",
        }
        with pytest.raises(
            InputError, match=rf"{name} cannot move freely here \(a floating base\).*hold: {{{name}: 0}}"
        ):
            robot(tree)
        with pytest.raises(
            InputError, match=f"base '{name}' is held as the robot's file draws it; give it 0"
        ):
            tree.holding({name: 0.5})
        still = tree.holding({name: 0.0})
        fixed = load_tree(
            described(tmp_path, leg.replace(own, "").replace("<body ", '<body pos="0 0 2" ', 1))
        )
        assert still == fixed and still.points == fixed.points and still.held == {name: 0.0}
        assert len(robot(still).joints) == 3


def test_a_joint_held_for_a_tie_stands_where_the_description_draws_it(tmp_path):
    slide = '<joint name="grip" type="slide" ref="0.4" axis="1 0 0"/>'
    world = arm(inside=BODY.format(name="jaw", joint=slide, inside=""))
    tree = load_tree(described(tmp_path, world, '<equality><joint joint1="grip" polycoef="0.1"/></equality>'))
    path = tmp_path / "robot.xml"
    path.write_text(path.read_text().replace('ref="0.4"', 'ref="0.4" limited="true" range="0.45 0.48"'))
    assert load_tree(path).tied["grip"].at == pytest.approx(0.48)  # within its range
    assert tree.tied["grip"].at == 0.5  # what the equality says is beside where it is drawn
    assert tree.holding({"grip": 0.4}).points["jaw"].position == (0.0, 0.0, 0.0)


def test_a_missing_mesh_hurts_nothing_where_the_inertia_is_given(tmp_path):
    assert load_tree(described(tmp_path, arm(inside=MESH), GONE)).names == ("turn",)


def test_what_a_drive_starts_from_is_kept(tmp_path):
    joint = '<joint name="turn" axis="0 1 0" armature="0.1" damping="0.2" frictionloss="0.3" range="-1 1" '
    joint += 'limited="true" stiffness="2" springref="0.1"/>'
    (found,) = load_tree(described(tmp_path, arm(joint), '<compiler angle="radian"/>')).joints
    assert (found.armature, found.damping, found.friction_loss, found.stiffness) == (0.1, 0.2, 0.3, 2.0)
    assert found.limits == (-1.0, 1.0)
    assert found.reference == 0.1


@pytest.mark.parametrize("at", ["joint", "jointinparent"])
def test_a_servo_behind_a_gear_is_one_at_the_joint(tmp_path, at):
    limits = 'ctrlrange="-1 3" forcerange="-6 6"'
    actuator = f'<actuator><position {at}="turn" gear="2" kp="5" kv="0.1" {limits}/></actuator>'
    (found,) = load_tree(described(tmp_path, arm(), actuator)).joints
    assert found.servo is not None and found.servo.goals == (-0.5, 1.5)
    assert (found.servo.stiffness, found.servo.damping, found.servo.largest) == (20.0, 0.4, 12.0)
    assert (found.gear, found.torque_limit) == (1.0, 12.0)
    motor = '<actuator><motor joint="turn" gear="50"/></actuator>'
    (found,) = load_tree(described(tmp_path, arm(), motor)).joints
    assert found.servo is None and found.gear == 50.0


@pytest.mark.parametrize(
    ("actuator", "told"),
    [
        ('<motor joint="turn" gear="-2" ctrlrange="-1 3"/>', {"gear": -2.0, "commands": (-1.0, 3.0)}),
        ('<general joint="turn" gainprm="12"/>', {"gain": 12.0}),
        ('<velocity joint="turn" kv="3" ctrlrange="-1 3"/>', {"by_speed": True}),
        ('<general joint="turn" gainprm="3" biastype="affine" biasprm="0 0 -1"/>', {"by_speed": True}),
        ('<position joint="turn" kp="3" kv="1" ctrlrange="-1 3"/>', {}),
    ],
    ids=["motor", "general", "velocity", "back-EMF", "position"],
)
def test_what_an_actuator_makes_of_its_command(tmp_path, actuator, told):
    (found,) = load_tree(described(tmp_path, arm(), f"<actuator>{actuator}</actuator>")).joints
    usual = {"gear": 1.0, "gain": 1.0, "commands": (-float("inf"), float("inf")), "by_speed": False}
    assert {name: getattr(found, name) for name in usual} == usual | told


def test_what_limits_and_damps_a_servo_beside_its_own_element(tmp_path):
    joint = '<joint name="turn" axis="0 1 0" actuatorfrcrange="-5 5"/>'
    pair = '<actuator><position joint="turn" kp="100" forcerange="-8 8"/><velocity joint="turn" kv="10"/></actuator>'
    (found,) = load_tree(described(tmp_path, arm(joint), pair)).joints
    assert found.servo is not None
    assert (found.servo.stiffness, found.servo.damping, found.servo.largest) == (100.0, 10.0, 5.0)


@pytest.mark.parametrize(
    ("actuators", "gear"),
    [
        ('<motor joint="turn" gear="3"/><velocity joint="turn" kv="5" gear="2"/>', 3.0),
        ('<velocity jointinparent="turn" kv="5"/><motor joint="turn"/>', 1.0),
        ('<general joint="turn" gainprm="0" biastype="affine" biasprm="0 0 -5"/>', 1.0),
    ],
    ids=["gear", "first", "alone"],
)
def test_what_brakes_a_joint_that_a_torque_drives_is_damping(tmp_path, actuators, gear):
    path = described(tmp_path, arm(), f"<actuator>{actuators}</actuator>")
    (found,) = load_tree(path).joints
    data = mujoco.MjData(model := mujoco.MjModel.from_xml_path(str(path)))
    data.qvel[:] = 1.0
    mujoco.mj_forward(model, data)
    assert found.servo is None and found.gear == gear
    assert -found.damping == pytest.approx(float(data.qfrc_actuator[0]), rel=1e-12)


@pytest.mark.parametrize(
    ("actuators", "rest"),
    [
        ('<motor joint="turn" armature="0.3" damping="0.2" gear="2"/>', ""),
        (
            '<position joint="turn" kp="5" armature="0.3" damping="0.2"/><velocity joint="turn" armature="0.1"/>',
            "",
        ),
        (
            '<motor joint="turn" class="big"/>',
            '<default class="big"><motor armature="0.3" damping="0.2"/></default>',
        ),
    ],
    ids=["motor", "two", "class"],
)
def test_armature_and_damping_of_actuators_act_at_the_joint_as_in_mujoco(tmp_path, actuators, rest):
    joint = '<joint name="turn" axis="0 1 0" armature="0.05" damping="0.4"/>'
    rest = f"<default>{rest}</default><actuator>{actuators}</actuator>"
    path = described(tmp_path, arm(joint), rest)
    (found,) = load_tree(path).joints
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    data.qvel[:] = 1.0
    mujoco.mj_forward(model, data)
    carried = 0.1 + 1.0 * 0.1**2
    assert carried + found.armature == pytest.approx(float(data.M[0]), rel=1e-12)
    assert -found.damping == pytest.approx(float(data.qfrc_passive[0]), rel=1e-12)


def test_a_damper_that_is_commanded_is_no_loop_of_the_angle(tmp_path):
    actuator = '<actuator><damper joint="turn" kv="5" ctrlrange="0 1"/></actuator>'
    (found,) = load_tree(described(tmp_path, arm(), actuator)).joints
    assert found.servo is None and found.damping == 0.0


def test_gravity_may_be_switched_off(tmp_path):
    gravity = load_tree(described(tmp_path, arm(), switched_off("gravity"))).gravity
    assert [float(g) for g in gravity] == [0.0] * 3


@pytest.mark.parametrize(
    "file",
    ["so101/so101_new_calib.xml", "so101/so101_new_calib.urdf", "staubli_tx40/tx40_mdh_modified.urdf"],
)
def test_known_arms_have_six_joints_under_their_own_names(file):
    if not (SHARED / file).exists():
        pytest.skip("the shared data are not beside the project")
    names = load_tree(SHARED / file).names
    assert len(names) == 6
    if file.startswith("so101"):
        assert names == ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")


def test_no_body_is_lost_to_another_of_the_name_that_it_is_given(tmp_path):
    inside = BODY.format(name="body1", joint="", inside=BODY.format(name="body1_", joint="", inside=""))
    tree = load_tree(described(tmp_path, arm(inside=inside).replace(' name="link"', "")))
    assert [body.name for body in tree.bodies] == ["body1__", "body1", "body1_"]
    assert tree.inertias()[0].mass == 3.0


def test_links_without_a_mass_are_named(tmp_path):
    tree = load_tree(described(tmp_path, arm(inside=BARE.format(""))))
    assert tree.inertias()[1].mass == 0.0 and tree.massless == ("tip", "pin")
    weight = '<inertial mass="0.1" pos="0 0 0" diaginertia="1e-4 1e-4 1e-4"/>'
    assert not load_tree(described(tmp_path, arm(inside=BARE.format(weight)))).massless
    rotor = driven('<motor joint="wrist" armature="0.1"/>')
    assert load_tree(described(tmp_path, BARE.format(""), rotor)).massless == ("tip", "pin")
