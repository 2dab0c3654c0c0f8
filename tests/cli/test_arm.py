"""An arm of many joints on the command line: what works on it, and what is refused in one sentence."""

import gzip
import json
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from browser import look_at
from gapcase import only
from servo_arm import described, records_of

from hybrid_id.cli.ablate import planned
from hybrid_id.cli.check import joint_alone
from hybrid_id.cli.diagnose import joint_folders
from hybrid_id.cli.options import config_of
from hybrid_id.components import REGISTRY
from hybrid_id.errors import InputError
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.record import Record
from hybrid_id.records.yaml_file import read_yaml, write_yaml
from hybrid_id.reporting.diagnosis_figures import diagnosis_figures
from hybrid_id.study.ablation import run_cells
from hybrid_id.study.replay import replay
from hybrid_id.systems.model_file import load_model

pytest.importorskip("mujoco")


@pytest.fixture
def few() -> Iterator[None]:
    """A catalogue of two effects, so that a search takes a second."""
    with only("spring_load", "constant_torque"):
        yield


NAMES = ("base", "joint 1/x", "tip")


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Dataset and model of three joints; the records are the model's own, with noise."""
    folder = tmp_path_factory.mktemp("arm") / "arm"
    bodies = "".join(
        f'<body pos="0 0 {-0.1 * k}"><joint name="{name}" axis="{k % 2} {1 - k % 2} 0" armature="0.01" damping="0.1" '
        'frictionloss="0.01"/><inertial mass="0.1" pos="0 0 -0.05" diaginertia="1e-4 1e-4 1e-4"/>'
        for k, name in enumerate(NAMES)
    )
    text = f"<mujoco><worldbody>{bodies}{'</body>' * 3}</worldbody></mujoco>"
    files = {"arm.xml": text, "model.yaml": "robot: {file: arm.xml}\ngear_ratio: [2, 3, 4]\n"}
    for name, content in files.items():
        (folder.parent / name).write_text(content)
    time, rng = 0.01 * np.arange(100), np.random.default_rng(0)
    blanks = [
        Record(
            f"run_{n}",
            time,
            {f"tau{k}": 0.1 * np.sin((3 + k + n) * time) for k in (1, 2, 3)},
            {f"q_m{k}": 0.0 * time for k in (1, 2, 3)},
            role="test" if n else "train",
        )
        for n in range(2)
    ]
    channels = (
        tuple(Channel(f"tau{k}", "N m") for k in (1, 2, 3)),
        tuple(Channel(f"q_m{k}", "rad", 1e-3) for k in (1, 2, 3)),
    )
    runs = replay(Dataset("arm", *channels, tuple(blanks), 0.01), load_model(folder.parent / "model.yaml"))
    records = [
        replace(blank, outputs={k: v + 1e-3 * rng.standard_normal(len(time)) for k, v in run.outputs.items()})
        for blank, run in zip(blanks, runs, strict=True)
    ]
    Dataset("arm", *channels, tuple(records), 0.01).save(folder)
    for name in files:
        (folder.parent / name).rename(folder / name)
    return folder


def test_a_diagnosis_takes_joint_by_joint_and_writes_each(run, arm: Path, tmp_path: Path, few: None) -> None:
    out = tmp_path / "out"
    done = run(
        "diagnose", arm, "--model", arm / "model.yaml", "--out", out, "--joint", "tip", "--joint", "joint 1/x"
    )
    assert done.code == 0, done.err
    words = " ".join(done.out.split())
    assert "not diagnosed: base (not asked for)" in words
    said = json.loads((out / "diagnosis.json").read_text())
    assert set(said["joints"]) == {"joint 1/x", "tip"} and said["gap"]["by_output"].keys() == {
        "q_m1",
        "q_m2",
        "q_m3",
    }
    for name in ("joint_1_x", "tip"):
        assert (out / name / "report.html").exists()
        assert f'href="{name}/report.html"' in (out / "report.html").read_text()
        assert 'href="../report.html"' in (out / name / "report.html").read_text()
    assert "joint 1," not in (out / "tip" / "report.html").read_text()  # it is called as the robot calls it
    for name in ("model.yaml", "refit.yaml"):
        assert len(load_model(out / name).joints) == 3
    assert load_model(out / "tip" / "model.yaml").tree is not None

    again = run("diagnose", arm, "--model", arm / "model.yaml", "--out", out, "--joint", "tip", "--force")
    assert again.code == 0, again.err
    assert not (out / "joint_1_x").exists() and (out / "tip" / "report.html").exists()

    wrong = run("diagnose", arm, "--model", arm / "model.yaml", "--out", tmp_path / "o", "--joint", "tpi")
    assert wrong.code == 2 and "no joint 'tpi'" in wrong.err and "tip" in wrong.err
    assert not (tmp_path / "o").exists()


def test_folders_of_joints_bear_any_name() -> None:
    names = ("a b", "a/b", "A b", "Models", "fits", "..", "elbow.1", "Ellbogen ä", "x" * 300)
    folders = list(joint_folders(names).values())
    assert folders[:8] == ["a_b", "a_b_2", "A_b_3", "Models_2", "fits_2", "_", "elbow.1", "Ellbogen_ä"]
    assert len(folders[8]) < 100


def test_ctrl_c_between_the_pages_of_a_robot_says_which_are_written(
    run, arm: Path, tmp_path: Path, few: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, calls = tmp_path / "out", []
    command = (
        "diagnose",
        arm,
        "--model",
        arm / "model.yaml",
        "--out",
        out,
        "--joint",
        "tip",
        "--joint",
        "joint 1/x",
    )

    def second_stops(found):
        calls.append(found)
        if len(calls) > 1:
            raise KeyboardInterrupt
        return diagnosis_figures(found)

    with monkeypatch.context() as patch:
        patch.setattr("hybrid_id.reporting.diagnosis_figures.diagnosis_figures", second_stops)
        cut = run(*command)
    words = " ".join(cut.err.split())
    assert cut.code == 130
    assert "pictures and page of tip are not written (those of the robot, joint 1/x are)" in words
    assert (out / "joint_1_x" / "report.html").exists() and not (out / "tip" / "report.html").exists()
    assert run(*command, "--resume").code == 0
    assert (out / "tip" / "report.html").exists()


def test_an_ablation_names_joints_as_the_robot_does(arm: Path, tmp_path: Path) -> None:
    study = tmp_path / "study.yaml"
    text = (
        f"dataset: {arm}\nmodel: {arm / 'model.yaml'}\n"
        "training: {max_iterations: 1, windows: [[0.2, 8]], width: 0.5, fine: 2}\n"
        "hybrid: {price: 0.1, windows: [[0.2, 8]], max_iterations: 1, patience: 1}\n"
        "ablation:\n  residual: [static, black_box]\n  place: [['joint 1/x/motor', tip/motor]]\n  reads: [own, all]\n"
        "  physics: [[tip/motor_friction/coulomb_friction]]\n  width: [2]\n  black_box_width: 2\n"
    )
    study.write_text(text)
    config = config_of(study, None, None)
    dataset, system = Dataset.load(arm), load_model(arm / "model.yaml")
    several = [replace(dataset.records[0], name=f"run_{k}") for k in range(3)]
    dataset = replace(dataset, records=tuple(several))
    task, cells = planned(config, dataset, system)
    hybrid, knowing, bare, alone = cells[1], cells[2], cells[3], cells[6]
    assert "joint 1/x/motor and tip/motor" in hybrid.arm.name
    networks = [key for key in task.model(hybrid.arm, 0).components if "residual" in key]
    assert networks == ["joint2/motor/residual_network", "joint3/motor/residual_network"]
    assert "reading all joints" in knowing.arm.name and hybrid.arm.name not in knowing.name
    left = [key for key in task.model(bare.arm, 0).components if "coulomb" in key]
    assert left == ["joint1/motor_friction/coulomb_friction", "joint2/motor_friction/coulomb_friction"]
    ((found,), _) = run_cells(task, [alone], lambda name: tmp_path / f"{name}.json")
    assert not found.model  # for no model file holds a network in an arm's place

    study.write_text(text.replace("tip/motor]", "tp/motor]"))
    with pytest.raises(InputError, match=r"key 'ablation.place\[0\]': Place 'tp/motor' is not known"):
        planned(config_of(study, None, None), dataset, system)


def test_an_arm_is_trained_with_a_network_at_a_joint_by_its_name(run, arm: Path, tmp_path: Path) -> None:
    study, dataset = tmp_path / "study.yaml", Dataset.load(arm)
    short = tuple(record.between(0.0, 0.4) for record in dataset.records)
    replace(dataset, records=short).save(tmp_path / "short")
    study.write_text(
        f"dataset: short\nmodel: {arm / 'model.yaml'}\n"
        "training: {max_iterations: 1, windows: [], width: 0.5, fine: 2}\n"
        "hybrid:\n"
        "  networks: [{place: 'joint 1/x/motor_friction', inputs: [speed, angle3], hidden: [2]}]\n"
        "  price: 0.1\n  windows: []\n  max_iterations: 1\n  patience: 1\n"
        "output: {folder: out, tensorboard: false}\n"
    )
    done = run("train", study)
    assert done.code == 0, done.err
    assert "training 3 joints takes minutes" in " ".join(done.err.split())
    (network,) = json.loads((tmp_path / "out" / "result.json").read_text())["networks"]
    assert "joint2/motor_friction" in network.values()
    load_model(tmp_path / "out" / "model.yaml")


def test_networks_are_learnt_joint_by_joint(run, tmp_path: Path) -> None:
    machine = described(tmp_path).with_component("joint3/load", REGISTRY["spring_load"](k_s=0.8, q_s=0.4))
    records_of(machine, 6).save(tmp_path / "records")
    source = ("train", tmp_path / "records", "--model", tmp_path / "model.yaml")
    done = run(*source, "--joint", "elbow", "--out", tmp_path / "out")
    assert done.code == 0, done.err
    assert "A network earns its place at elbow." in " ".join(done.out.split())
    assert json.loads((tmp_path / "out" / "result.json").read_text())["joints"]["elbow"]["network"]
    look_at(tmp_path / "out" / "report.html", tmp_path, figures=1)
    load_model(tmp_path / "out" / "model.yaml")
    rows = pd.read_csv(tmp_path / "out" / "parameters.csv")
    assert set(rows["set"]) == {"elbow: physics alone", "elbow: with network"}
    assert rows[rows.parameter == "J_m_elbow"].selected.tolist() == [0, 1]
    for more, words in (
        (("--joint", "hand"), "The robot has no joint 'hand'"),
        (("--joint", "all", "--resume"), "leave --resume out"),
    ):
        done = run(*source, *more, "--out", tmp_path / "other")
        assert done.code == 2 and words in " ".join(done.err.split())
        assert not (tmp_path / "other").exists()


def test_training_refuses_a_torque_that_jumps_with_dry_friction(run, arm: Path, tmp_path: Path) -> None:
    folder = tmp_path / "arm"
    shutil.copytree(arm, folder)
    file = folder / "dataset.yaml"
    content = read_yaml(file)
    content["outputs"].append({"name": "tau_a1", "unit": "N m"})
    for one in folder.glob("*.csv.gz"):
        head, *rows = gzip.decompress(one.read_bytes()).decode().splitlines()
        text = "\n".join([f"{head},tau_a1", *(f"{row},{0.01 * (k % 7)}" for k, row in enumerate(rows))])
        one.write_bytes(gzip.compress(f"{text}\n".encode()))
    write_yaml(file, content)
    done = run("train", folder, "--model", folder / "model.yaml", "--out", tmp_path / "out")
    assert done.code == 2, done.out
    assert "the torque at the link (tau_a) jumps" in " ".join(done.err.split())


def test_results_name_the_file_from_their_own_folder(run, arm: Path, tmp_path: Path) -> None:
    out = arm.parent / "runs" / "found"
    done = run("identify", arm, "--model", arm / "model.yaml", "--pooled", "--out", out)
    assert done.code == 0, done.err
    assert "{file: ../../arm/arm.xml}" in (out / "model.yaml").read_text()
    assert load_model(out / "model.yaml").parameter("F_c_joint 1/x")
    both = ("--model", arm / "model.yaml", "--model", out / "model.yaml", "--out", tmp_path / "both")
    done = run("compare", arm, *both)
    assert done.code == 0, done.err
    done = run("export", out, "--to", "mjcf", "--out", tmp_path / "arm.xml", "--check", arm)
    assert done.code == 0, done.err
    assert (
        "MuJoCo replays these records" in done.out
        and 'name="motor_tip"' in (tmp_path / "arm.xml").read_text()
    )


def test_rotors_and_masses_that_a_description_lacks_are_said(run, arm: Path) -> None:
    text = (arm / "arm.xml").read_text()
    last = text.rindex("<inertial")
    changed = {
        "bare": (text.replace('armature="0.01"', ""), "bare.xml gives no armature for base, joint 1/x, tip"),
        "light": (text[:last] + text[text.index("/>", last) + 2 :], "light.xml gives no mass for body3"),
    }
    for name, (content, words) in changed.items():
        (arm / f"{name}.xml").write_text(content)
        (arm / f"{name}.yaml").write_text(f"robot: {{file: {name}.xml}}\n")
        assert words in " ".join(run("check", arm, "--model", arm / f"{name}.yaml").err.split())
    assert "gives no" not in run("check", arm, "--model", arm / "model.yaml").err


def test_check_counts_base_parameters_and_says_how_they_are_excited(run, arm: Path) -> None:
    done = run("check", arm, "--model", arm / "model.yaml")
    assert "33 inertial parameters" in " ".join(done.out.split()) and "the worst first" in done.out
    assert "the worst first" not in run("check", arm, "--model", arm / "model.yaml", "--full").out
    found = json.loads(run("check", arm, "--model", arm / "model.yaml", "--json").out)["base_parameters"]
    assert found["inertial_parameters"] == 33 and found["condition_number"] > 1
    assert all(row["coefficients"] and row["std_error"] > 0 for row in found["parameters"])


def test_check_takes_a_joint_by_itself(run, arm: Path, tmp_path: Path) -> None:
    said = json.loads(run("check", arm, "--joint", "tip", "--json").out)
    known = [one["text"] for one in said["identifiability"]["combinations"]]
    assert known and not any("base" in text or "1/x" in text for text in known)
    assert any("_tip" in text for text in known) and said["base_parameters"] is None
    for more, words in (
        (("--joint", "tpi"), "The robot has no joint 'tpi' (did you mean 'tip'?)"),
        (("--joint", "tip", "--model", tmp_path / "none.yaml"), "none.yaml"),
    ):
        done = run("check", arm, *more)
        assert done.code == 2 and words in " ".join(done.err.split()), done.err
    data = Dataset.load(arm)
    still = [replace(r, outputs={**r.outputs, "q_m3": np.full(r.n_samples, 0.1)}) for r in data]
    with pytest.raises(InputError, match="Joint 'tip' stands still in all train records"):
        joint_alone(replace(data, records=tuple(still)), arm / "model.yaml", arm, "tip")
    with pytest.raises(InputError, match="--joint needs the robot's model"):
        joint_alone(data, None, arm, "tip")
