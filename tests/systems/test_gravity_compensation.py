"""A controller that holds the links' weight: as MuJoCo's gravcomp, what it does not know, one joint by itself."""

from pathlib import Path

import numpy as np
import pytest
import torch
from servo_arm import ARM, records_of

from hybrid_id.components import BaseTilt, BodyInertia, GravityCompensation, LoadDependent, Payload
from hybrid_id.components.base import Component
from hybrid_id.errors import InputError
from hybrid_id.export.mjcf import to_mjcf
from hybrid_id.export.own_file import mujoco_model
from hybrid_id.export.replay import agreement
from hybrid_id.identification.keep import digest_of, digest_of_tree
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.by_joint import alone, with_others_measured
from hybrid_id.systems.chain import System
from hybrid_id.systems.model_file import load_model, save_model

mujoco = pytest.importorskip("mujoco")

LYING = ARM.replace(
    '<body quat="0 1 0 0">', '<body name="first" euler="1.2 0.3 0">'
)  # every joint has weight to hold
LYING = LYING.replace('<body pos="0 0 0.1">', '<body name="upper" pos="0 0 0.1">')
HELD_UP = LYING.replace('name="upper"', 'name="upper" gravcomp="0.6"')
HELD_UP = HELD_UP.replace('name="elbow_link"', 'name="elbow_link" gravcomp="1"')
STEP = '<option timestep="0.0005"/>'


def described(folder: Path, text: str, *parts: tuple[str, Component]) -> System:
    (folder / "arm.xml").write_text(text.replace("<worldbody>", f"{STEP}<worldbody>"))
    (folder / "model.yaml").write_text("robot: {file: arm.xml}\n")
    system = load_model(folder / "model.yaml")
    for place, part in parts:
        system = system.with_component(place, part)
    return system


def holding(system: System, q: np.ndarray) -> np.ndarray:
    """Torque of the motors that keeps the arm where it is, (3,)."""
    views = system.views([value[None] for value in system.theta().detach()])
    x = [torch.tensor([value]) for angle in q for value in (angle, 0.0)]
    links = system.arm.needed(x, [torch.zeros(1, dtype=torch.float64)] * 3, {}, views)
    held = system.arm._held_up([row for row in x[::2]], {}, views)
    needed = [float(torch.as_tensor(n)) for n in links]
    return np.array(needed) - [float(torch.as_tensor(h)) for h in held or [0.0] * 3]


def of_mujoco(model, q: np.ndarray) -> np.ndarray:
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_forward(model, data)
    return data.qfrc_bias - data.qfrc_gravcomp


def test_the_weight_that_is_held_is_mujocos(tmp_path: Path) -> None:
    system = described(tmp_path, HELD_UP)
    (key,) = system.arm.compensations
    assert key == "joint1/load/gravity_compensation"
    (info,) = (info for info in system.table if info.symbol == "c_g")
    assert info.spec.value == 1.0 and not info.spec.estimate  # as the file says
    model = mujoco_model(to_mjcf(system))
    for q in np.random.default_rng(0).normal(size=(5, 3)):
        np.testing.assert_allclose(holding(system, q), of_mujoco(model, q), atol=1e-10)
    moved = records_of(system, 1)
    assert max(row.apart for row in agreement(system, to_mjcf(system), moved)) < 5e-3


def test_a_share_is_written_into_the_file(tmp_path: Path) -> None:
    own = GravityCompensation(c_g=0.8)
    for text, shares in ((LYING, (0.8, 0.8, 0.8)), (HELD_UP, (0.0, 0.48, 0.8))):
        system = described(tmp_path, text)
        held = system.arm.compensations
        system = system.with_values({"c_g_pan": 0.8}) if held else system.with_component("joint2/load", own)
        exported = to_mjcf(system)
        model = mujoco_model(exported)
        assert model.body_gravcomp[1:].tolist() == pytest.approx(list(shares)) and exported.notes == ()
        q = np.array([0.3, -0.5, 0.9])
        np.testing.assert_allclose(holding(system, q), of_mujoco(model, q), atol=1e-10)
        save_model(system, tmp_path / "again.yaml")
        assert load_model(tmp_path / "again.yaml").theta().tolist() == system.theta().tolist()
        (tmp_path / "exported.xml").write_text(exported.text)
        (tmp_path / "exported.yaml").write_text("robot: {file: exported.xml}\n")
        np.testing.assert_allclose(
            holding(load_model(tmp_path / "exported.yaml"), q), holding(system, q), atol=1e-9
        )


def test_the_controller_knows_no_payload_and_no_tilt(tmp_path: Path) -> None:
    q = np.array([0.3, -0.5, 0.9])
    full = ("joint1/load", GravityCompensation())
    np.testing.assert_allclose(holding(described(tmp_path, LYING, full), q), 0.0, atol=1e-12)
    for part in (Payload("elbow_link", m_l=0.3), BaseTilt(e_x=0.2, e_y=-0.1)):
        without = holding(described(tmp_path, LYING), q)
        felt = holding(described(tmp_path, LYING, ("joint3/load", part)), q) - without
        assert np.abs(felt).max() > 0.05
        with_it = described(tmp_path, LYING, full, ("joint3/load", part))
        np.testing.assert_allclose(holding(with_it, q), felt, atol=1e-12)
    with pytest.raises(InputError, match="gravity_compensation is listed twice; keep one of them"):
        described(tmp_path, LYING, full, ("joint2/load", GravityCompensation()))
    with pytest.raises(InputError, match="listed twice; the robot's file brings one at pan by its gravcomp"):
        described(tmp_path, HELD_UP, ("joint2/load", GravityCompensation()))


def test_what_mujocos_gravcomp_knows_and_the_controller_does_not_is_said(tmp_path: Path) -> None:
    def notes(*parts: tuple[str, Component], text: str = HELD_UP) -> list[str]:
        return list(to_mjcf(described(tmp_path, text, *parts)).notes)

    assert (
        notes(("joint3/load", Payload("elbow_link", m_l=0.3))) == []
    )  # a body of its own, which nothing holds
    assert "with the tilt, which" in notes(("joint3/load", BaseTilt(e_x=0.2)))[0]
    assert "with changed masses, which" in notes(("joint3/load", BodyInertia("elbow_link", c_m=1.5)))[0]


def test_a_body_without_a_name_is_found_by_its_place(tmp_path: Path) -> None:
    unnamed = HELD_UP.replace('<body name="upper" ', "<body ")
    exported = to_mjcf(described(tmp_path, unnamed).with_values({"c_g_pan": 0.5}))
    model = mujoco.MjModel.from_xml_string(exported.text)
    assert model.body_gravcomp[1:].tolist() == pytest.approx([0.0, 0.3, 0.5])
    assert not any("left out" in note for note in exported.notes)


def test_a_joint_by_itself_is_held_up_as_in_the_robot(tmp_path: Path) -> None:
    parts = ("joint3/load", Payload("elbow_link", m_l=0.2)), ("joint3/motor_friction", LoadDependent(mu=0.1))
    system = described(tmp_path, HELD_UP, *parts)
    data = records_of(system, 1)
    batch = make_batch(system, data.records, noise_std={f"q_m{j}": 1e-3 for j in (1, 2, 3)})
    whole = simulate(system, Engine("dry", 4, compiled=True), batch).y[0].numpy()
    one = alone(system, 2)
    measured = with_others_measured(data, system, 2)
    own = make_batch(one, measured.records, noise_std={"q_m3": 1e-3})
    found = simulate(one, Engine("dry", 4, compiled=True), own).y[0, :, 0].numpy()
    assert np.abs(found - whole[:, 2]).max() < 0.015  # the others' motion is smoothed, and noisy
    bare = alone(system.with_values({"c_g_pan": 0.0}), 2)
    lost = simulate(bare, Engine("dry", 4, compiled=True), own).y[0, :, 0].numpy()
    assert np.abs(lost - whole[:, 2]).max() > 2e-2


def test_what_is_kept_of_another_share_is_not_taken(tmp_path: Path) -> None:
    trees = [described(tmp_path, text).tree for text in (LYING, HELD_UP, HELD_UP.replace("0.6", "0.7"))]
    assert len({digest_of_tree(tree) for tree in trees if tree is not None}) == 3
    systems = [digest_of(described(tmp_path, text)) for text in (HELD_UP, HELD_UP.replace("0.6", "0.7"))]
    assert systems[0] != systems[1]
