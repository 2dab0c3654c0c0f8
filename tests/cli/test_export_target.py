"""`export` of a diagnosis: errors in MuJoCo of its models, and a refusal where the corrected one stays worse."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from drives import make_records, multisine

from hybrid_id.components import LoadDependent
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.study import identify
from hybrid_id.systems import System, one_link
from hybrid_id.systems.model_file import save_model

mujoco = pytest.importorskip("mujoco")


def loaded() -> System:
    """A weight that a motor lifts through teeth that rub the harder the more torque they carry."""
    drive = one_link(100.0, vertical=True).with_values({"J": 2e-5, "F_c": 0.004, "F_v": 5e-5, "G_l": 0.9})
    held = {i.name: replace(i.spec, estimate=i.name in ("F_c", "F_v", "J")) for i in drive.table}
    return drive.with_specs(held).with_component("joint1/motor_friction", LoadDependent(mu=0.15))


@pytest.fixture(scope="module")
def diagnosed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a diagnosis whose corrected model has load-dependent friction, and the records beside it."""
    home = tmp_path_factory.mktemp("loaded")
    voltages = [multisine(seed, samples=800, amplitude=6.0 + seed) for seed in range(5)]
    records = make_records(loaded(), voltages, noise={"q_m1": 0.002})
    records[3:] = [replace(record, role="test") for record in records[3:]]
    channels = (Channel("u1", "V"),), (Channel("q_m1", "rad", 0.002),)
    data = Dataset("lift", *channels, tuple(records), 0.002)
    data.save(home / "data")
    base = loaded().without_component("joint1/motor_friction", "load_dependent_friction")
    save_model(base, home / "data" / "model.yaml")
    gap = home / "gap"
    gap.mkdir()
    save_model(identify(data, base, pooled=True).selected_model, gap / "refit.yaml")
    save_model(loaded(), gap / "model.yaml")
    (gap / "config.yaml").write_text("dataset: ../data\n")
    said = {"program": "hybrid_id 0", "horizon": {"kind": "whole"}, "effects": [{"selected": True}]}
    (gap / "diagnosis.json").write_text(json.dumps(said))
    return home


def test_a_corrected_model_is_as_good_as_the_re_fitted_one(run, diagnosed: Path, tmp_path: Path) -> None:
    out = tmp_path / "robot.xml"
    done = run("export", diagnosed / "gap", "--to", "mjcf", "--out", out)
    assert done.code == 0, done.err
    told = json.loads(out.with_suffix(".json").read_text())["in_mujoco"]
    assert told["role"] == "test" and list(told["models"]) == ["nominal", "re-fitted", "corrected"]
    nominal, refitted, corrected = told["models"].values()
    assert corrected["nrmse_before_refit"] > 2 * refitted["nrmse"], "the failure that is cured"
    assert corrected["nrmse"] < 1.05 * refitted["nrmse"] < nominal["nrmse"]
    assert corrected["nrmse_here"] < 0.2 * refitted["nrmse_here"]
    assert "F_c" in corrected["refitted"] and "mu" not in corrected["refitted"]
    line = "NRMSE in MuJoCo, mean over 2 test records: nominal"
    rmse = f"corrected {corrected['rmse']['q_m1'] / 100:.3g} rad at the joint"
    for text in (out.read_text(), out.with_suffix(".html").read_text()):
        assert line in text and "RMSE of q_m1: nominal" in text and rmse in text
    assert rmse in " ".join(done.out.split())
    assert f"{corrected['nrmse']:.3g}" in done.out and "fits the train records best there" in done.out
    level = mujoco.MjModel.from_xml_path(str(out)).dof_frictionloss.max()
    assert level == pytest.approx(100.0 * corrected["refitted"]["F_c"]["after"])


def test_a_corrected_model_that_stays_worse_is_refused(run, diagnosed: Path, tmp_path: Path) -> None:
    data = Dataset.load(diagnosed / "data")
    replace(data, records=data.test).save(tmp_path / "data")
    (tmp_path / "gap").mkdir()
    for file in (diagnosed / "gap").iterdir():
        (tmp_path / "gap" / file.name).write_bytes(file.read_bytes())
    (tmp_path / "gap" / "config.yaml").write_text(f"dataset: ../data\nmodel: {diagnosed}/data/model.yaml\n")
    out = tmp_path / "out" / "robot.xml"
    done = run("export", tmp_path / "gap", "--to", "mjcf", "--out", out)
    assert done.code == 2 and not out.parent.exists()
    assert "in MuJoCo the corrected model errs by" in done.err and "refit.yaml, or give --worse" in done.err
    done = run("export", tmp_path / "gap" / "refit.yaml", "--to", "mjcf", "--out", out)
    assert done.code == 0, done.err
    done = run("export", tmp_path / "gap", "--to", "mjcf", "--out", out, "--worse")
    assert done.code == 2 and "or --force" in done.err, "a file that exists is another question"
    done = run("export", tmp_path / "gap", "--to", "mjcf", "--out", out, "--force")
    assert done.code == 2 and "re-fitted" in out.read_text() and "corrected" not in out.read_text()
    done = run("export", tmp_path / "gap", "--to", "mjcf", "--out", out, "--force", "--worse")
    assert done.code == 0 and "it is written all the same" in done.err
    assert "corrected" in out.read_text()


def test_without_its_runs_records_a_corrected_model_is_judged_by_those_of_check(
    run, diagnosed: Path, tmp_path: Path
) -> None:
    (tmp_path / "gap").mkdir()
    for file in (diagnosed / "gap").iterdir():
        (tmp_path / "gap" / file.name).write_bytes(file.read_bytes())
    out = tmp_path / "robot.xml"
    done = run("export", tmp_path / "gap", "--to", "mjcf", "--out", out, "--check", diagnosed / "data")
    assert done.code == 2 and "nothing is fitted anew" in done.err and "errs by" in done.err
    done = run("export", tmp_path / "gap", "--to", "mjcf", "--out", out)
    assert done.code == 0 and "give --check DATASET" in done.out and not out.with_suffix(".html").exists()


def test_a_model_outside_its_run_is_said_to_be_compared_with_nothing(
    run, diagnosed: Path, tmp_path: Path
) -> None:
    model = tmp_path / "model.yaml"
    model.write_bytes((diagnosed / "gap" / "model.yaml").read_bytes())
    done = run(
        "export", model, "--to", "mjcf", "--out", tmp_path / "robot.xml", "--check", diagnosed / "data"
    )
    assert done.code == 0 and "neither compared with a re-fitted model nor fitted anew" in done.err
    told = json.loads((tmp_path / "robot.json").read_text())["in_mujoco"]
    assert list(told["models"]) == ["exported"]
