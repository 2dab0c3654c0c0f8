"""A model file that names a robot's description: its drives, their names, what is refused, and a recovery."""

import re
from pathlib import Path

import numpy as np
import pytest
from servo_arm import ARM as SERVO_ARM

from hybrid_id import identify
from hybrid_id.errors import InputError
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.record import Record
from hybrid_id.records.yaml_file import read_yaml
from hybrid_id.robots.description import load_tree
from hybrid_id.simulation.compiled import compiled_for, compiler
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.solvers import OdeEngine
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.model_file import load_model, save_model

pytest.importorskip("mujoco")

ARM = re.sub("<actuator>.*</actuator>", "", SERVO_ARM, flags=re.DOTALL)
ARM = ARM.replace('0.0001"/>', '0.0001"/><site name="hand" pos="0 0 0.2"/>')
ROBOT = "robot: {file: arm.xml}\n"


def written(folder: Path, text: str = ROBOT) -> Path:
    (folder / "arm.xml").write_text(ARM)
    (folder / "model.yaml").write_text(text)
    return folder / "model.yaml"


def test_a_description_is_enough(tmp_path: Path) -> None:
    system = load_model(written(tmp_path))
    assert [info.name for info in system.table if info.spec.estimate] == [
        "F_c_pan", "F_v_pan", "J_m_pan", "F_c_lift", "F_v_lift", "J_m_lift", "F_c_elbow", "F_v_elbow", "J_m_elbow",
    ]  # fmt: skip
    assert system.parameter("F_c_lift").spec.value == pytest.approx(0.04)
    assert system.input_names == ["tau1", "tau2", "tau3"]


def test_a_description_without_rotors_gets_a_start_that_a_fit_can_leave(tmp_path: Path) -> None:
    file = written(tmp_path)
    bare = re.sub(r' (armature|damping|frictionloss)="[^"]*"', "", ARM)
    (tmp_path / "arm.xml").write_text(bare)
    system = load_model(file)
    carried = load_tree(tmp_path / "arm.xml").at_zero
    for name, own in zip(("pan", "lift", "elbow"), carried, strict=True):
        rotor = system.parameter(f"J_m_{name}").spec.value
        assert rotor == pytest.approx(0.1 * max(carried))
        assert system.parameter(f"F_v_{name}").spec.value == pytest.approx((rotor + own) / 0.3)
        assert system.parameter(f"F_c_{name}").spec.value == 0.0
    (tmp_path / "arm.xml").write_text(
        bare.replace('name="lift"', 'name="lift" damping="0.2" armature="0.01"')
    )
    system = load_model(file)
    assert system.parameter("F_v_lift").spec.value == pytest.approx(0.2)
    assert system.parameter("J_m_lift").spec.value == pytest.approx(0.01)


def test_a_chain_that_is_listed_replaces_the_usual_parts(tmp_path: Path) -> None:
    text = """
robot: {file: arm.xml, hold: {}}
gear_ratio: [10, 20, 5]
components:
  - {place: elbow/load, kind: floor_contact, options: {point: hand}, parameters: {z_f: -0.4, k_f: 500}}
  - {place: lift/input, kind: voltage}
  - {place: lift/motor, kind: dc_motor, parameters: {P_m1: 0.02, P_m2: 0.03}}
  - {place: elbow/motor_friction, kind: stribeck_friction, parameters: {F_drop: 0.01, v_s: 0.5}}
"""
    system = load_model(written(tmp_path, text))
    assert system.input_names == ["tau1", "u2", "tau3"]
    assert system.parameter("P_m1_lift").spec.value == 0.02
    assert system.parameter("F_drop_elbow").spec.value == 0.01
    assert system.parameter("J_m_pan").spec.value == pytest.approx(0.02 / 100)
    again = tmp_path / "again.yaml"
    save_model(system, again)
    assert read_yaml(again)["robot"]["file"] == "arm.xml"
    found = load_model(again)
    assert [(i.name, i.spec) for i in found.table] == [(i.name, i.spec) for i in system.table]
    assert found.tree == system.tree


def test_a_parameter_of_the_usual_parts_gets_bounds_and_a_prior(tmp_path: Path) -> None:
    """The line of docs/model.md takes the place of the description's dry friction, at that joint alone."""
    own = "{F_c: {nominal: 0.05, lower: 0.0, upper: 0.3, prior_std: 0.02}}"
    listed = f"components: [{{place: elbow/motor_friction, kind: coulomb_friction, parameters: {own}}}]\n"
    system = load_model(written(tmp_path, "robot: {file: arm.xml}\n" + listed))
    spec = system.parameter("F_c_elbow").spec
    assert (spec.value, spec.lower, spec.upper, spec.prior_mean, spec.prior_std) == (
        0.05,
        0.0,
        0.3,
        0.05,
        0.02,
    )
    assert system.parameter("F_c_lift").spec.value == 0.04


def test_servos_by_name_give_start_values_of_the_data_sheet(tmp_path: Path) -> None:
    text = """
robot: {file: arm.xml}
gear_ratio: [1, 10, 1]
servos: {all: {preset: sts3215, p: 16}, elbow: {preset: sts3215, p: 32, voltage: 6}}
"""
    system = load_model(written(tmp_path, text))
    assert system.input_names == ["goal1", "goal2", "goal3"]
    assert system.parameter("k_p_pan").spec.value == pytest.approx(16 * 0.165 * 2.94)
    assert system.parameter("k_p_elbow").spec.value == pytest.approx(system.parameter("k_p_pan").spec.value)
    assert system.parameter("tau_max_elbow").spec.value == pytest.approx(1.47)
    assert system.parameter("F_v_lift").spec.value == pytest.approx(
        system.parameter("F_v_pan").spec.value / 100
    )


def test_a_joint_that_is_held_has_no_drive(tmp_path: Path) -> None:
    system = load_model(written(tmp_path, "robot: {file: arm.xml, hold: {lift: 0.5}}\n"))
    assert system.input_names == ["tau1", "tau2"]
    save_model(system, tmp_path / "again.yaml")
    found = load_model(tmp_path / "again.yaml")
    assert found.tree == system.tree
    assert found.tree is not None
    assert found.tree.held == {"lift": 0.5}


def test_a_saved_model_and_its_robot_can_be_moved_together(tmp_path: Path) -> None:
    (tmp_path / "mine" / "run").mkdir(parents=True)
    save_model(load_model(written(tmp_path / "mine")), tmp_path / "mine" / "run" / "model.yaml")
    (tmp_path / "mine").rename(tmp_path / "yours")
    assert load_model(tmp_path / "yours" / "run" / "model.yaml").tree is not None


def test_a_model_below_a_moved_folder_finds_the_description_that_came_along(tmp_path: Path) -> None:
    staged, home = tmp_path / "staged", tmp_path / "results"
    (staged / "data").mkdir(parents=True)
    save_model(
        load_model(written(staged / "data")), staged / "models" / "a.yaml", home / "models", moved=staged
    )
    staged.rename(home)
    assert "file: ../data/arm.xml" in (home / "models" / "a.yaml").read_text()
    load_model(home / "models" / "a.yaml")


def test_a_damping_that_a_servo_lacks_is_written_as_zero(tmp_path: Path) -> None:
    path = written(tmp_path)
    servo = '<actuator><position joint="pan" kp="6"/></actuator></mujoco>'
    (tmp_path / "arm.xml").write_text(ARM.replace("</mujoco>", servo))
    system = load_model(path)
    save_model(system, tmp_path / "saved.yaml")
    save_model(system.with_values({"k_d_pan": -0.0}), tmp_path / "given.yaml")
    assert "k_d: {nominal: 0.0" in (tmp_path / "saved.yaml").read_text()
    assert "k_d: {nominal: 0.0" in (tmp_path / "given.yaml").read_text()


def test_a_name_is_the_joints_own_whatever_stands_in_it(tmp_path: Path) -> None:
    text = """
robot: {file: arm.xml}
components:
  - {place: joint 1/x/link_friction, kind: coulomb_friction, parameters: {F_c: 0.02}}
"""
    file = written(tmp_path, text)
    (tmp_path / "arm.xml").write_text(ARM.replace('"pan"', '"joint 1/x"'))
    system = load_model(file)
    assert system.parameter("F_c_joint 1/x_link_friction_coulomb_friction").spec.value == 0.02
    assert system.parameter("F_c_joint 1/x_motor_friction_coulomb_friction").spec.value == 0.05
    save_model(system, tmp_path / "again.yaml")
    assert [i.name for i in load_model(tmp_path / "again.yaml").table] == [i.name for i in system.table]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("system: one_link\nrobot: {file: arm.xml}\ngear_ratio: [1]\n", "do not go together"),
        ("system: robot\ngear_ratio: [1]\n", "name your robot's MJCF"),
        ("robot: {file: none.xml}\n", "none.xml: cannot be read"),
        ("gear_ratio: [1, 2]\n", "a positive number for each of pan, lift, elbow"),
        ("gravity: vertical\n", "'gravity' belongs to the systems"),
        ("parameters: {J: 1.0}\n", "'parameters' belongs to the systems"),
        (
            "components: [{place: hand/motor, kind: dc_motor}]\n",
            "'hand/motor' is not known.*use one of pan, lift, elbow with",
        ),
        (
            "components: [{place: elbw/motor, kind: torque_motor}]\n",
            "'elbw/motor' is not known .did you mean 'elbow/motor'",
        ),
        ("components: [{place: joint1/motor, kind: dc_motor}]\n", "'joint1/motor' is not known"),
        (
            "components: [{place: lift/motor, kind: dc_motor}]\n",
            "torque_command at lift/input gives N m, but dc_motor at lift/motor takes V; put duty_supply or ",
        ),
        ("gear_ratio: 5\n", "a list with one number for each joint; write"),
        ("robot: {file: arm.xml, base: floating}\n", "base"),
        ("servos: {pan: {preset: sts, p: 1}}\n", "servo 'sts' is not known; use one of"),
        ("servos: {pen: {preset: sts3215, p: 1}}\n", "no joint 'pen' .did you mean 'pan'"),
        ("robot: {file: arm.xml, hold: {wrist: 0.0}}\n", "no joint 'wrist' to hold"),
        (
            "joints: {pan: {gear_ratio: 345}}\n",
            "key 'joints' is unknown; list what .* under 'components' .*, a servo .* under 'servos'",
        ),
        ("inertias: {estimate: [hand]}\n", "under 'components' .*body_inertia"),
        ("components: [{place: elbow/load, kind: floor_contact}]\n", "needs one option, point"),
    ],
)
def test_what_does_not_fit_is_refused_in_a_sentence(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(InputError, match=words) as error:
        load_model(written(tmp_path, text if "robot" in text else ROBOT + text))
    assert "\n" not in str(error.value)


def test_an_ode_solver_replays_an_arm_by_its_own_steps(tmp_path: Path) -> None:
    system = load_model(written(tmp_path))
    assert compiled_for(system, OdeEngine()) == OdeEngine()
    assert compiled_for(system, Engine("smooth")).compiled == (compiler() is not None)


def test_three_drives_are_recovered_from_torques_and_angles(tmp_path: Path) -> None:
    truth = load_model(written(tmp_path))
    rng, step, noise = np.random.default_rng(5), 0.004, 1e-4
    time = step * np.arange(1000)
    tones = 2 * np.pi * np.array([0.4, 0.9, 1.7, 2.6])
    records = []
    for k in range(4):
        inputs = {}
        for joint, size in ((1, 0.25), (2, 0.5), (3, 0.2)):
            phases = rng.uniform(0, 2 * np.pi, 4)[:, None]
            inputs[f"tau{joint}"] = (
                size * np.sin(tones[:, None] * time + phases).sum(0) * np.minimum(time / 0.1, 1.0)
            )
        blank = Record(f"run_{k}", time, inputs, {f"q_m{j}": 0.0 * time for j in (1, 2, 3)})
        batch = make_batch(truth, [blank], noise_std={f"q_m{j}": noise for j in (1, 2, 3)})
        angles = simulate(truth, Engine("dry", 8, compiled=True), batch).y[0].numpy()
        outputs = {f"q_m{j}": angles[:, j - 1] + noise * rng.standard_normal(len(time)) for j in (1, 2, 3)}
        records.append(Record(blank.name, time, inputs, outputs, role="test" if k == 3 else "train"))
    data = Dataset(
        "arm",
        tuple(Channel(f"tau{j}", "N m") for j in (1, 2, 3)),
        tuple(Channel(f"q_m{j}", "rad", noise) for j in (1, 2, 3)),
        tuple(records),
        step,
    )
    guess = truth.with_values(
        {info.name: 1.3 * info.spec.value for info in truth.table if info.spec.estimate}
    )
    study = identify(data, guess, pooled=True, engine=Engine("dry", 4))
    values, errors = study.selected.values, study.standard_errors(study.selection.index)
    for name, value, error in zip(study.names, values, errors, strict=True):
        assert abs(value - truth.parameter(name).spec.value) < 4 * error + 1e-6, name
    assert next(iter(study.test_nrmse.values())) < 0.01
