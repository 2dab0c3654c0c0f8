"""Arms of the blind check: what a case holds, that a seed decides it, and that a joint by itself moves as in MuJoCo."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from hybrid_id.errors import InputError
from hybrid_id.machines.arms import case as cases
from hybrid_id.machines.arms import motion, robot
from hybrid_id.machines.arms.effects import KINDS, OUTSIDE, draw_effect
from hybrid_id.machines.arms.refit import Fit, OneByOne
from hybrid_id.machines.further import further_records
from hybrid_id.machines.make import make_case, make_cases
from hybrid_id.records.dataset import Dataset
from hybrid_id.robots.description import load_tree
from hybrid_id.systems.model_file import load_model

pytest.importorskip("mujoco")


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two joints and short records."""
    monkeypatch.setattr(robot, "JOINTS", (2, 2))
    monkeypatch.setattr(motion, "LENGTH", 1.5)


def test_case_holds_records_a_description_and_answers_apart(tmp_path: Path) -> None:
    case = make_case(27203, tmp_path, realism="arms", effect="constant_torque")
    data, model = Dataset.load(case), load_model(case / "model.yaml")
    truth = yaml.safe_load((tmp_path / "answers" / f"{case.name}.yaml").read_text())
    assert (len(data.train), len(data.test), len(model.joints)) == (4, 1, 2)
    first, *small = truth["effects"]
    assert (
        first["name"] == "constant_torque"
        and first["role"] == "dominant"
        and "constant_torque" in first["accept"]
    )
    assert first["where"] in first["accept_where"] and first["where"].split("/")[0] in ("j1", "j2")
    assert min(first["closes"], first["closes_train"]) >= cases.DOMINANT
    assert all(one["role"] == "small" and one["closes_train"] < first["closes_train"] for one in small)
    assert truth["oracle"]["noise_floor"] < truth["oracle"]["refit"] < truth["oracle"]["nominal"]
    assert truth["arm"]["joints"] == 2 and "bias" in first["size"]
    text = (case / "arm.xml").read_text()
    assert "twist" not in text and text.count("<inertial") == 2


def test_seed_decides_an_arm(tmp_path: Path) -> None:
    one, other = (make_case(27204, tmp_path / n, realism="arms", family="parameters") for n in "ab")
    assert {p.name for p in one.iterdir()} == {p.name for p in other.iterdir()} >= {"arm.xml", "model.yaml"}
    for file in one.iterdir():
        assert file.read_bytes() == (other / file.name).read_bytes()
    sheets = [(tmp_path / n / "answers" / f"{one.name}.yaml").read_bytes() for n in "ab"]
    assert sheets[0] == sheets[1] and yaml.safe_load(sheets[0])["effects"] == []


def test_an_arm_is_moved_again_by_a_proposed_experiment(tmp_path: Path) -> None:
    case = make_case(27203, tmp_path, realism="arms", effect="constant_torque")
    sheet = yaml.safe_load((tmp_path / "answers" / f"{case.name}.yaml").read_text())
    data = Dataset.load(case)
    moving = data.train[0]
    command = 0.3 * np.sin(0.06 * np.arange(200))
    asked = {
        "joint": 1,
        "command": command,
        "sample_time": 0.01,
        "held": {"angle2": 0.2},
        "start": {"q_a1": 0.0},
    }
    options = {"realism": "arms", "family": None, "effect": "constant_torque"}
    one, other = further_records(case.name, [asked, asked], sheet, options)
    assert (one.name, other.name, one.role) == ("further", "further_2", "train")
    assert one.inputs.keys() == moving.inputs.keys() and one.outputs.keys() == moving.outputs.keys()
    if "goal1" in moving.inputs:  # else the torques are logged by which its controller followed the goals
        assert np.allclose(one.inputs["goal1"], command)
    assert np.ptp(one.outputs["q_a1"]) > 0.02 and np.abs(one.outputs["q_a2"] - 0.2).max() < 0.2
    assert not np.array_equal(one.outputs["q_a1"], other.outputs["q_a1"])  # noise and friction are new
    with pytest.raises(InputError, match="sample time"):
        further_records(case.name, [asked | {"sample_time": 0.02}], sheet, options)
    sheet["effects"][0]["size"]["bias"] *= 1.01
    with pytest.raises(InputError, match="cannot be made again"):
        further_records(case.name, [asked], sheet, options)


def test_families_are_drawn_as_often_as_they_say() -> None:
    drawn = [cases.family_of(seed, None, None) for seed in range(400)]
    assert 0.08 < drawn.count("unknown") / 400 < 0.17 and 0.06 < drawn.count("parameters") / 400 < 0.14
    assert cases.family_of(1, None, "latch") == "unknown" and cases.family_of(1, None, "delay") == "single"


@pytest.mark.parametrize("servo", [True, False])
def test_one_joint_by_itself_moves_as_in_mujoco(servo: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robot, "SERVOS", float(servo))
    rng = np.random.default_rng(27205)
    bare, moment = robot.draw_arm(rng)
    drives = [
        draw_effect(rng, name, 0, bare.drives[0], moment[0]).on(bare.drives[k])
        for k, name in enumerate(("joint_flexibility", "stribeck_friction"))
    ]
    arm = replace(bare, drives=tuple(drives), jitter=1e-6, count=1e-6)
    motions = [motion.moved(arm, motion.draw_goals(rng, 2), [], np.ones(2), 0.0) for _ in range(2)]
    angles = [motion.counted(arm, one.angle, rng) for one in motions]
    load = motion.carried(arm, [0.0, 0.0], motions)
    joints = OneByOne(arm, motions, angles, load, load.less(load), load.less(load))
    right = joints.fit([Fit(k, own) for k, own in enumerate(drives)], 0)
    lacking = joints.fit([Fit(k, own) for k, own in enumerate(bare.drives)], 4)
    for one, other in zip(right, lacking, strict=True):
        assert one.train < 1e-4 and one.test < 3e-4
        assert other.train > 4 * one.train


def test_effects_outside_the_catalogue_act_and_have_no_name() -> None:
    rng = np.random.default_rng(27206)
    arm, moment = robot.draw_arm(rng)
    goals = motion.draw_goals(rng, 2)
    still = motion.moved(arm, goals, [], np.ones(2), 0.0)
    for formula in OUTSIDE:
        effect = draw_effect(rng, "unknown", 1, arm.drives[1], moment[1], formula)
        effect = replace(effect, values={**effect.values, "other": 0.0})
        found = motion.moved(arm, goals, [effect], np.ones(2), 0.0)
        assert np.ptp(found.torque[:, 1]) > 0 or np.ptp(found.factor[:, 1]) > 0
        assert not found.torque[:, 0].any() and np.allclose(found.factor[:, 0], 1.0)
        assert np.abs(found.angle[:, 1] - still.angle[:, 1]).max() > 1e-3
    assert not set(OUTSIDE) & set(KINDS)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"system": "one_link"}, "arms are of two to seven joints, in MuJoCo; leave --system"),
        ({"level": "strong"}, "leave --system, --level and --engine out"),
        ({"effect": "latsch"}, "'latsch' is not known; did you mean 'latch'"),
        ({"family": "pair"}, "family 'pair' is not known"),
        ({"effect": "latch", "family": "single"}, "outside the catalogue; leave family out"),
    ],
)
def test_what_an_arm_leaves_no_choice_of_is_refused(tmp_path: Path, options: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        make_case(1, tmp_path, realism="arms", **options)


def test_without_mujoco_no_arm_is_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(InputError, match=r"not installed; install it with pip install 'hybrid_id\[robots\]'"):
        make_cases(1, 1, tmp_path, realism="arms")
    assert not list(tmp_path.iterdir())


def test_joints_are_numbered_as_engines_number_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A description nests what branches off: records are logged in its order of the joints."""
    monkeypatch.setattr(robot, "JOINTS", (7, 7))
    orders = set()
    for seed in range(12):
        arm, _ = robot.draw_arm(np.random.default_rng([27, seed, 0]))
        (tmp_path / "arm.xml").write_text(robot.mjcf(arm))
        tree = load_tree(tmp_path / "arm.xml")
        assert list(tree.names) == arm.names
        orders.add(tuple(link.parent for link in arm.links))
    assert any(parents != tuple(range(-1, 6)) for parents in orders)
