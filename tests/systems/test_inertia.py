"""Payloads and inertias that differ from the description: against MuJoCo, physical, in both engines, recovered."""

import re
from pathlib import Path

import numpy as np
import pytest
import torch

from hybrid_id.components import BaseTilt, BodyInertia, Payload
from hybrid_id.errors import InputError
from hybrid_id.export.mjcf import to_mjcf
from hybrid_id.export.own_file import mujoco_model
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.record import Record
from hybrid_id.robots.description import load_tree
from hybrid_id.simulation.c_code import compiler
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.step import Engine
from hybrid_id.study import identify
from hybrid_id.systems.builders import one_link
from hybrid_id.systems.by_joint import alone, together
from hybrid_id.systems.chain import System
from hybrid_id.systems.model_file import load_model, save_model

mujoco = pytest.importorskip("mujoco")

ARM = """<mujoco><compiler angle="radian"/><worldbody>
<body name="base" quat="0 1 0 0"><joint name="pan" axis="0 0 1" armature="0.02" damping="0.1" frictionloss="0.05"/>
<inertial mass="0.5" pos="0.02 0 0.05" diaginertia="0.001 0.001 0.001"/>
<body name="upper" pos="0 0 0.1"><joint name="lift" axis="0 1 0" armature="0.015" damping="0.08" frictionloss="0.04"/>
<inertial mass="0.4" pos="0 0.01 0.1" quat="0.9 0.3 0.2 0.1" diaginertia="0.001 0.0012 0.0005"/>
<body name="lower" pos="0 0 0.2"><joint name="elbow" axis="0 1 0" armature="0.01" damping="0.05" frictionloss="0.03"/>
<inertial mass="0.2" pos="0 0 0.08" diaginertia="0.0004 0.0004 0.0001"/>
<site name="hand" pos="0.01 0 0.2" quat="0.8 0 0.6 0"/></body></body></body>
</worldbody></mujoco>"""
MODEL = """
robot: {file: arm.xml}
components:
  - {place: elbow/load, kind: payload, options: {point: hand}, parameters: {m_l: 0.15, x_l: 0.03, z_l: -0.02}}
  - {place: lift/load, kind: body_inertia, options: {body: upper}}
"""
DEVIATION = {
    "c_m": 1.3, "x_c": 0.02, "y_c": -0.01, "z_c": 0.03, "s_x": 1.2, "s_y": 0.7, "s_z": 1.1, "s_xy": 0.2,
    "s_xz": -0.3, "s_yz": 0.1,
}  # fmt: skip


def arm(folder: Path, model: str = MODEL) -> System:
    (folder / "arm.xml").write_text(ARM)
    (folder / "model.yaml").write_text(model)
    return load_model(folder / "model.yaml")


def deviating(folder: Path) -> System:
    return arm(folder).with_values({f"{name}_lift": value for name, value in DEVIATION.items()})


def of_the_tree(system: System, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mass matrix and bias of a system's tree, its rotors left out."""
    assert system.tree is not None
    bodies = tuple(
        system.arm.bodies(system.views([value[None] for value in system.theta().detach()])).values()
    )
    poses, inertias = system.tree.poses(q.tolist()), system.tree.inertias(bodies)
    mass = system.tree.mass_matrix(poses, inertias)
    bias = system.tree.inverse_dynamics(poses, inertias, v.tolist())
    return np.array([[float(m) for m in row] for row in mass]), np.array([float(b) for b in bias])


def of_mujoco(model, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    data, mass = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    data.qpos[:], data.qvel[:] = q, v
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, mass)
    return mass - np.diag(model.dof_armature), data.qfrc_bias.copy()


def pseudo_inertia(system: System) -> np.ndarray:
    """Of the upper link about its centre: second moments, and its mass."""
    views = system.views([value[None] for value in system.theta().detach()])
    mass, _, inertia = system.arm.bodies(views)["joint2/load/body_inertia"].held().inertia.at_centre()
    about = np.array(inertia)
    return np.block([[0.5 * np.trace(about) * np.eye(3) - about, np.zeros((3, 1))], [np.zeros((1, 3)), mass]])


def test_a_payload_is_a_mass_at_its_point(tmp_path: Path) -> None:
    system = arm(tmp_path)
    body = (
        '<body pos="{}"><inertial mass="0.15" pos="0 0 0" diaginertia="0 0 0"/></body></body></body></body>'
    )
    turn = 2 * np.arctan2(0.6, 0.8)  # of the site about y
    x, z = 0.03 * np.cos(turn) - 0.02 * np.sin(turn), -0.03 * np.sin(turn) - 0.02 * np.cos(turn)
    model = mujoco.MjModel.from_xml_string(
        ARM.replace("</body></body></body>", body.format(f"{0.01 + x} 0 {0.2 + z}"))
    )
    for q, v in np.random.default_rng(1).normal(size=(3, 2, 3)):
        for here, there in zip(of_the_tree(system, q, v), of_mujoco(model, q, v), strict=True):
            np.testing.assert_allclose(here, there, rtol=0, atol=1e-10 * np.abs(there).max())


def test_deviations_are_those_of_the_pseudo_inertia(tmp_path: Path) -> None:
    before, after = pseudo_inertia(arm(tmp_path)), pseudo_inertia(deviating(tmp_path))
    d = DEVIATION
    stretch = np.array(
        [[d["s_x"], d["s_xy"], d["s_xz"], 0], [0, d["s_y"], d["s_yz"], 0], [0, 0, d["s_z"], 0], [0, 0, 0, 1]]
    )
    np.testing.assert_allclose(after, 1.3 * stretch @ before @ stretch.T, atol=1e-15)
    rng = np.random.default_rng(2)
    for _ in range(20):  # physical wherever the bounds let it go
        drawn = {f"{name}_lift": rng.uniform(0.05, 3.0) if name[:2] != "s_" or len(name) == 3 else rng.normal(0, 3)
                 for name in DEVIATION}  # fmt: skip
        assert np.linalg.eigvalsh(pseudo_inertia(arm(tmp_path).with_values(drawn))).min() > 0


def test_the_files_own_inertial_says_what_was_found(tmp_path: Path) -> None:
    system = deviating(tmp_path)
    exported = to_mjcf(system)
    assert exported.notes == ()
    assert 'name="payload_hand"' in exported.text and exported.text.count("<inertial") == 4
    assert '<inertial mass="0.2" pos="0 0 0.08" diaginertia="0.0004 0.0004 0.0001"/>' in exported.text
    model = mujoco_model(exported)
    for q, v in np.random.default_rng(3).normal(size=(3, 2, 3)):
        for here, there in zip(of_the_tree(system, q, v), of_mujoco(model, q, v), strict=True):
            np.testing.assert_allclose(
                here, there, rtol=0, atol=1e-7 * np.abs(there).max()
            )  # 9 digits are written
    (tmp_path / "exported.xml").write_text(exported.text)
    again = load_tree(tmp_path / "exported.xml")
    assert {body.name for body in again.bodies} == {"base", "upper", "lower", "payload_hand"}
    same = to_mjcf(arm(tmp_path, "robot: {file: arm.xml}\ncomponents:\n" + MODEL.splitlines()[-1]))
    assert same.text.count("<inertial") == 3 and "fullinertia" not in same.text


def test_a_tilted_base_turns_gravity_and_the_file_says_so(tmp_path: Path) -> None:
    system = arm(tmp_path, "robot: {file: arm.xml}\n").with_component(
        "joint2/load", BaseTilt(e_x=0.2, e_y=-0.1)
    )
    about_x = np.array([[1, 0, 0], [0, np.cos(0.2), -np.sin(0.2)], [0, np.sin(0.2), np.cos(0.2)]])
    about_y = np.array([[np.cos(0.1), 0, -np.sin(0.1)], [0, 1, 0], [np.sin(0.1), 0, np.cos(0.1)]])
    pull = (about_x @ about_y).T @ [0, 0, -9.81]
    model = mujoco_model(to_mjcf(system))
    np.testing.assert_allclose(model.opt.gravity, pull, atol=1e-8)
    q, v = np.random.default_rng(5).normal(size=(2, 3))
    x = [torch.tensor([value]) for pair in zip(q, v, strict=True) for value in pair]
    views = system.views([value[None] for value in system.theta().detach()])
    needed = system.arm.needed(x, [torch.zeros(1, dtype=torch.float64)] * 3, {}, views)
    np.testing.assert_allclose(
        [float(torch.as_tensor(n)) for n in needed], of_mujoco(model, q, v)[1], atol=1e-7
    )
    alone_and_held = alone(system, 2)  # its tilt is the lift's to estimate
    assert alone_and_held.tree is not None
    np.testing.assert_allclose(np.array(alone_and_held.tree.gravity, float), pull, atol=1e-12)
    save_model(system, tmp_path / "tilted.yaml")
    assert load_model(tmp_path / "tilted.yaml").theta().tolist() == system.theta().tolist()
    with pytest.raises(InputError, match="base_tilt is listed twice"):
        system.with_component("joint3/load", BaseTilt())
    with pytest.raises(InputError, match="base_tilt at 'joint1/load' acts only on a robot"):
        one_link(50.0).with_component("joint1/load", BaseTilt())


def test_a_body_whose_mass_its_shapes_give_gets_an_inertial(tmp_path: Path) -> None:
    shapes = re.sub(r'<inertial mass="0.4"[^>]*>', '<geom size="0.05" pos="0 0 0.1" mass="0.4"/>', ARM)
    (tmp_path / "arm.xml").write_text(shapes)
    (tmp_path / "model.yaml").write_text(MODEL)
    system = load_model(tmp_path / "model.yaml").with_values({"c_m_lift": 1.5})
    assert mujoco_model(to_mjcf(system)).body("upper").mass[0] == pytest.approx(0.6)
    text = shapes.replace("<compiler", '<compiler inertiafromgeom="true"')
    text = re.sub(r"<inertial[^>]*>", '<geom size="0.05" mass="0.3"/>', text)
    (tmp_path / "arm.xml").write_text(text)
    notes = to_mjcf(load_model(tmp_path / "model.yaml").with_values({"c_m_lift": 1.5})).notes
    assert [n for n in notes if n.startswith("lift/load") and 'inertiafromgeom="true"' in n]


def records_of(system: System, noise: float) -> Dataset:
    rng, step = np.random.default_rng(5), 0.004
    time, tones, records = step * np.arange(800), 2 * np.pi * np.array([0.4, 0.9, 1.7, 2.6]), []
    for k in range(3):
        inputs = {}
        for joint, size in ((1, 0.25), (2, 0.5), (3, 0.3)):
            waves = np.sin(tones[:, None] * time + rng.uniform(0, 2 * np.pi, 4)[:, None]).sum(0)
            inputs[f"tau{joint}"] = size * waves * np.minimum(time / 0.1, 1.0)
        blank = Record(f"run_{k}", time, inputs, {f"q_m{j}": 0.0 * time for j in (1, 2, 3)})
        batch = make_batch(system, [blank], noise_std={f"q_m{j}": noise for j in (1, 2, 3)})
        angles = simulate(system, Engine("dry", 8, compiled=True), batch).y[0].numpy()
        outputs = {f"q_m{j}": angles[:, j - 1] + noise * rng.standard_normal(len(time)) for j in (1, 2, 3)}
        records.append(Record(blank.name, time, inputs, outputs))
    inputs = tuple(Channel(f"tau{j}", "N m") for j in (1, 2, 3))
    return Dataset(
        "arm", inputs, tuple(Channel(f"q_m{j}", "rad", noise) for j in (1, 2, 3)), tuple(records), step
    )


def test_a_payload_and_a_links_mass_are_recovered_with_the_drives(tmp_path: Path) -> None:
    if compiler() is None:
        pytest.skip("there is no C compiler")
    truth = arm(tmp_path).with_values({"c_m_lift": 1.4})
    data = records_of(truth, 1e-4)
    start = {i.name: 1.3 * i.spec.value for i in truth.table if i.spec.estimate}
    study = identify(data, truth.with_values(start | {"m_l_elbow": 0.0, "c_m_lift": 1.0}), pooled=True)
    errors = dict(zip(study.names, study.standard_errors(study.selection.index), strict=True))
    values = dict(zip(study.names, study.selected.values, strict=True))
    for name in ("m_l_elbow", "c_m_lift", "J_m_elbow"):
        value = truth.parameter(name).spec.value
        assert abs(values[name] - value) < 4 * errors[name] + 1e-6, name
        assert errors[name] < 0.05 * value, name


def test_a_joint_by_itself_keeps_what_the_others_carry(tmp_path: Path) -> None:
    system = deviating(tmp_path)
    one = alone(system, 1)
    assert one.tree is not None and "m_l_elbow" not in {i.name for i in one.table}
    assert {b.name for b in one.tree.bodies} == {"base", "upper", "lower", "payload hand"}
    q, v = np.random.default_rng(6).normal(size=(2, 3))
    for here, there in zip(of_the_tree(one, q, v), of_the_tree(system, q, v), strict=True):
        np.testing.assert_allclose(here, there, atol=1e-14)
    found = together(one.with_values({"c_m_lift": 2.0}))
    assert found.parameter("c_m_lift").spec.value == 2.0
    assert found.parameter("m_l_elbow").spec.value == 0.15 and found.tree == system.tree


def test_a_model_file_says_all_of_it(tmp_path: Path) -> None:
    system = deviating(tmp_path)
    save_model(system, tmp_path / "again.yaml")
    again = load_model(tmp_path / "again.yaml")
    assert [(i.name, i.spec) for i in again.table] == [(i.name, i.spec) for i in system.table]
    assert [n for n in (i.name for i in system.table if i.spec.estimate) if n[:3] in ("m_l", "c_m")] == [
        "c_m_lift", "m_l_elbow",
    ]  # fmt: skip


def test_what_cannot_be_is_refused(tmp_path: Path) -> None:
    system = arm(tmp_path, "robot: {file: arm.xml}\n")
    for part, words in (
        (Payload("tip"), "'tip', which the robot does not have; give one of base, upper, lower, hand"),
        (BodyInertia("hand"), "'hand', which is no body of it with a mass; give one of base, upper, lower"),
        (Payload("upper"), "which that joint does not carry; list it at pan, lift"),
    ):
        with pytest.raises(InputError, match=words):
            system.with_component("joint3/load", part)
    with pytest.raises(InputError, match="payload is listed twice at 'hand'"):
        system.with_component("joint3/load", Payload("hand")).with_component("joint1/load", Payload("hand"))
    with pytest.raises(InputError, match="body_inertia needs one option, body"):
        arm(tmp_path, "robot: {file: arm.xml}\ncomponents: [{place: lift/load, kind: body_inertia}]\n")
