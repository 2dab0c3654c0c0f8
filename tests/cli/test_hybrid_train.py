"""`train` with a hybrid section: results, figures, warnings, and what happens to a run that is killed."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from browser import look_at
from drives import make_records, multisine, rigid_drive

from hybrid_id.cli.inputs import remark_uneven
from hybrid_id.components import Cogging
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.record import Record
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.model_file import load_model, save_model

HYBRID = """
dataset: {data}
training: {{width: 2.0, fine: 4}}
hybrid:
  networks: [{{place: joint1/motor, inputs: [speed, sin 3, cos 3], hidden: [4]}}]
  price: 1.0
  windows: []
  max_iterations: 5
"""


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study file for a drive whose cogging the model lacks."""
    physics = rigid_drive(ratio=20.0).with_values({"F_c": 0.005})
    physics = physics.with_specs({"P_m1": replace(physics.parameter("P_m1").spec, estimate=False)})
    truth = physics.with_component("joint1/motor", Cogging(T_c=0.0, T_s=2.5e-3, n=3.0))
    voltages = [multisine(k, samples=160, rest=10, amplitude=2.5, step=0.004) for k in range(4)]
    engine = Engine("smooth", 4, width=2.0)
    records = make_records(truth, voltages, noise={"q_m1": 0.02}, engine=engine, step=0.004)
    records[3] = replace(records[3], role="test")
    folder = tmp_path_factory.mktemp("hybrid")
    channels = (Channel("u1", "V"),), (Channel("q_m1", "rad", 0.02),)
    Dataset("cogging drive", *channels, tuple(records), 0.004).save(folder / "data")
    save_model(physics, folder / "data" / "model.yaml")
    (folder / "study.yaml").write_text(HYBRID.format(data=folder / "data"))
    return folder / "study.yaml"


def test_train_with_networks(run, study: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    shown = run("train", study, "--out", out)
    assert shown.code == 0 and "left out" not in shown.err
    assert all(
        words in shown.out for words in ("drift", "share of torque", "overlap", "physics alone", "chosen")
    )
    result = json.loads((out / "result.json").read_text())
    assert result["validation_records"] == ["run_1"] or result["validation_records"] == ["run_2"]
    (network,) = result["networks"]
    assert (
        network["where"] == "joint1/motor"
        and 0.0 < network["share"] < 1.0
        and 0.0 <= network["overlap"] <= 1.0
    )
    assert set(result["parameters"]) == {"P_m2", "F_c", "F_v", "J"}
    assert list(result["models"]) == ["physics", "hybrid"] and result["price"] == 1.0
    assert any("could do the work of P_m2" in warning for warning in result["warnings"])  # it reads the speed
    assert not any("work of J" in warning for warning in result["warnings"])
    back_emf = result["parameters"]["P_m2"]
    assert back_emf["unpriced_std_error"] > back_emf["hybrid_std_error"]
    errors = result["weighted_error"]["run_0"]
    assert errors["hybrid"] < 0.5 * errors["physics"]
    model = load_model(out / "model.yaml")
    assert (
        set(model.networks) == {"joint1/motor/residual_network"}
        and not load_model(out / "physics.yaml").networks
    )
    assert list(result["residual_tests"]) == ["physics", "hybrid"]
    before, after = (one["rms_over_noise"] for (one,) in result["residual_tests"].values())
    assert after < before
    assert (out / "map_joint1_motor.png").stat().st_size > 1000

    again = run("train", out / "config.yaml", "--out", out, "--resume", "--json")
    assert again.code == 0 and json.loads(again.out)["networks"] == result["networks"]
    kept = (out / "config.yaml").read_text()
    wider = out / "wider.yaml"
    wider.write_text(kept.replace("- 4\n", "- 5\n").replace("hidden: [4]", "hidden: [5]"))
    assert wider.read_text() != kept
    refused = run("train", wider, "--out", out, "--resume")
    assert refused.code == 2 and "another model or other settings" in refused.err
    assert (out / "config.yaml").read_text() == kept, "what the checkpoint belongs to is still there"
    assert (
        run(
            "simulate", study.parent / "data", "--model", out / "model.yaml", "--out", tmp_path / "replay"
        ).code
        == 0
    )
    look_at(out / "report.html", tmp_path, figures=1)


def test_identify_says_who_uses_the_section(run, study: Path, tmp_path: Path) -> None:
    text = study.read_text().replace("hybrid:", "identification: {max_iterations: 1}\nhybrid:")
    (tmp_path / "study.yaml").write_text(
        text + "output: {figures: false, tensorboard: false, report: false}\n"
    )
    told = run("identify", tmp_path / "study.yaml", "--out", tmp_path / "out", "--pooled")
    assert told.code == 0 and told.err.count("'train' uses the section 'hybrid'") == 1


def test_faults_of_the_section_are_told(run, study: Path, tmp_path: Path) -> None:
    text = study.read_text()
    for old, new, words in (
        ("hidden: [4]", "hiden: [4]", "hiden"),
        ("inputs: [speed, sin 3, cos 3]", "inputs: [speeed]", "'hybrid.networks[0].inputs'"),
        ("sin 3", "speed2", "'hybrid.networks[0].inputs'"),
        ("joint1/motor", "joint1/sensor", "'hybrid.networks[0].place'"),
        ("joint1/motor", "joint1/motr", "did you mean 'joint1/motor'?"),
        ("joint1/motor", "joint1/transmission", "'hybrid.networks[0].place'"),
        ("networks: [", "networks: [{place: joint1/motor}, ", "'hybrid.networks'"),
        ("price: 1.0", "price: -1.0", "'hybrid.price'"),
        ("max_iterations: 5", "validation: [run_1, run_1]", "'hybrid.validation'"),
        ("max_iterations: 5", "validation: [run_9]", "'hybrid.validation'"),
        ("windows: []", "windows: [[0.2, 2], [0.5, 1]]", "'hybrid.windows'"),
    ):
        assert old in text
        (tmp_path / "study.yaml").write_text(text.replace(old, new))
        told = run("train", tmp_path / "study.yaml", "--out", tmp_path / "out")
        assert told.code == 2 and words in told.err and not (tmp_path / "out").exists()


def test_stages_that_the_records_are_too_short_for_are_said(run, study: Path, tmp_path: Path) -> None:
    quiet = "\noutput: {report: false, figures: false, tensorboard: false}\n"
    text = (
        study.read_text().replace("max_iterations: 5", "max_iterations: 1").replace("fine: 4", "fine: 1")
        + quiet
    )
    defaults = "[[0.1, 4], [0.4, 2], [1.6, 1]]"
    for windows, words in (
        ("[[0.1, 1], [0.2, 2]]", "windows of 0.2 s"),
        (defaults, "windows of 0.4 s, 1.6 s"),
    ):
        (tmp_path / "study.yaml").write_text(text.replace("windows: []", f"windows: {windows}"))
        told = run("train", tmp_path / "study.yaml", "--out", tmp_path / "out", "--force")
        assert told.code == 0 and told.err.count("left out") == 1 and words in told.err


def test_windows_of_a_training_without_networks_are_checked_too(run, drive: Path, tmp_path: Path) -> None:
    text = f"dataset: {drive}\ntraining: {{windows: [[0.9, 1]]}}\n"
    (tmp_path / "study.yaml").write_text(text)
    told = run("train", tmp_path / "study.yaml", "--out", tmp_path / "out")
    assert told.code == 2 and "study.yaml: key 'training.windows': windows of 0.9 s are too long" in told.err
    assert not (tmp_path / "out").exists()


def test_windows_over_records_of_other_sample_times_are_said(capsys: pytest.CaptureFixture[str]) -> None:
    def record(step: float) -> Record:
        time = step * np.arange(5)
        return Record("r", time, {"u1": time}, {"q_m1": time})

    remark_uneven([record(0.001), record(0.0012)])
    assert not capsys.readouterr().err
    remark_uneven([record(0.001), record(0.01)])
    assert "sample times differ between records (0.001 to 0.01 s)" in " ".join(
        capsys.readouterr().err.split()
    )
