"""`export`: the files, what is said about them, and wrong input."""

import json
from pathlib import Path

import pytest
import torch
from drives import rigid_drive

from hybrid_id.cli.export import _label as label_of
from hybrid_id.cli.export import _run_of as run_of
from hybrid_id.cli.folder import result_file
from hybrid_id.components.load.residual_torque import ResidualTorque


def test_mjcf_with_check(run, drive: Path, tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    file = tmp_path / "robot.xml"
    done = run("export", drive / "model.yaml", "--to", "mjcf", "--out", file, "--check", drive)
    assert done.code == 0, done.err
    assert "MuJoCo replays these records within" in done.out
    assert mujoco.MjModel.from_xml_path(str(file)).nu == 1
    told = json.loads((tmp_path / "robot.json").read_text())
    assert told["program"].startswith("hybrid_id ") and told["left_out"] == []
    assert max(row["apart"] for row in told["check"]) < 2e-3
    assert len(told["check"]) == 4
    (test,) = (row for row in told["check"] if row["role"] == "test")
    words = " ".join(done.out.split())
    assert f"exported {test['there']:.3g} {test['here']:.3g}" in words and "mean over 1 test record:" in words
    assert "nothing is left out" in done.out and (tmp_path / "robot.html").exists()


def test_ranges_as_json(run, drive: Path, tmp_path: Path) -> None:
    done = run("export", drive / "model.yaml", "--to", "ranges", "--out", tmp_path / "ranges.json", "--json")
    assert done.code == 0, done.err
    assert json.loads(done.out) == json.loads((tmp_path / "ranges.json").read_text())
    assert "only its priors say" in done.err
    assert json.loads(done.out)["parameters"]["J"]["unit"] == "kg m^2"


def test_torch_program(run, drive: Path, tmp_path: Path) -> None:
    done = run("export", drive / "model.yaml", "--to", "torch", "--out", tmp_path / "step.pt2")
    assert done.code == 0, done.err
    assert "differs from the model's own step by 0.0e+00" in done.out
    assert "friction is smoothed" in done.err
    assert torch.export.load(tmp_path / "step.pt2").module()(
        torch.zeros(1, 2).double(), torch.ones(1, 1).double()
    ).shape == (1, 2)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--to", "torch", "--check", "x"], "--check replays records in MuJoCo"),
        (["--to", "mjcf", "--sample-time", "0.01"], "are of the torch program"),
        (["--to", "mjcf", "--out", "{}/m.json"], "description beside it; take another ending"),
        (["--to", "mjcf", "--out", "{}/m.html"], "page beside it; take another ending"),
        (["--to", "ranges", "--worse"], "--worse writes a model that is worse in MuJoCo"),
        (["--to", "urdf"], "'urdf' is not one of"),
        (["--to", "mjcf", "--out", "{}/m.urdf"], "give a file that ends in .xml"),
        (["--to", "mjcf", "--out", "{}"], "is a folder"),
    ],
)
def test_wrong_input(run, drive: Path, tmp_path: Path, options: list[str], words: str) -> None:
    given = [option.format(tmp_path) for option in options]
    given += [] if "--out" in given else ["--out", str(tmp_path / "file.xml")]
    done = run("export", drive / "model.yaml", *given)
    assert done.code == 2
    assert words in done.err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("ending", "words"), [("json", "the description that goes"), ("html", "the page that goes")]
)
def test_a_file_that_nobody_named_is_said_to_go_with_the_named_one(
    run, drive: Path, tmp_path: Path, ending: str, words: str
) -> None:
    (tmp_path / f"robot.{ending}").write_text("mine")
    done = run("export", drive / "model.yaml", "--to", "mjcf", "--out", tmp_path / "robot.xml")
    said = " ".join(done.err.split())
    assert done.code == 2 and f"{words} with robot.xml, exists; give another name than robot.xml" in said
    assert "or --force to replace both" in said
    assert [one.name for one in tmp_path.iterdir()] == [f"robot.{ending}"]


def test_the_page_of_an_earlier_model_goes_with_it(run, drive: Path, tmp_path: Path) -> None:
    (tmp_path / "robot.html").write_text("errors of another model")
    done = run("export", drive / "model.yaml", "--to", "mjcf", "--out", tmp_path / "robot.xml", "--force")
    assert done.code == 0, done.err  # without records there is no page
    assert sorted(one.name for one in tmp_path.iterdir()) == ["robot.json", "robot.xml"]


def test_ranges_of_a_diagnosis_are_refused(run, drive: Path, tmp_path: Path) -> None:
    """Its one parameter set for all records would pass for what scatters between them."""
    folder = tmp_path / "gap"
    folder.mkdir()
    (folder / "diagnosis.json").write_text("{}")
    for name in ("model.yaml", "refit.yaml"):
        (folder / name).write_text((drive / "model.yaml").read_text())
        done = run("export", folder / name, "--to", "ranges", "--out", tmp_path / "ranges.json")
        said = " ".join(done.err.split())
        assert done.code == 2 and "holds a diagnosis" in said
        assert f"'hybrid-id identify DATASET --model {folder / name} --out DIR'" in said
    assert run("export", folder, "--to", "ranges", "--out", tmp_path / "ranges.json").code == 2
    assert not (tmp_path / "ranges.json").exists()


@pytest.mark.parametrize(("effects", "words"), [([{"selected": True}], "corrected"), ([], "re-fitted")])
def test_a_diagnosis_without_effects_has_corrected_no_model(
    tmp_path: Path, effects: list, words: str
) -> None:
    result = {"program": "hybrid_id 1", "effects": effects}
    (tmp_path / "diagnosis.json").write_text(json.dumps(result))
    assert label_of(tmp_path / "model.yaml", rigid_drive()) == words
    assert label_of(tmp_path / "refit.yaml", rigid_drive()) == "re-fitted"


def test_a_model_is_called_after_what_made_it(tmp_path: Path) -> None:
    model = tmp_path / "model.yaml"
    for command, name in (("identify", "identified"), ("train", "trained")):
        (tmp_path / "result.json").write_text(json.dumps({"program": "hybrid_id 1", "command": command}))
        assert label_of(model, rigid_drive()) == name
    (tmp_path / "physics.yaml").write_text("")
    assert label_of(model, rigid_drive()) == "re-fitted"  # the network has not stayed
    assert label_of(tmp_path / "physics.yaml", rigid_drive()) == "re-fitted"
    learnt = rigid_drive().with_component("joint1/load", ResidualTorque())
    assert label_of(model, learnt) == "hybrid"


def test_a_joints_folder_is_one_of_results(tmp_path: Path) -> None:
    joints = {
        "joint 1/x": {"verdict": "effects", "effects": [{"selected": True}], "horizon": {"kind": "strokes"}},
        "tip": {"verdict": "no_gap", "effects": []},
    }
    (tmp_path / "diagnosis.json").write_text(json.dumps({"program": "hybrid_id 1", "joints": joints}))
    for folder, name in (("joint_1_x", "corrected"), ("tip", "re-fitted")):
        file = tmp_path / folder / "model.yaml"
        file.parent.mkdir()
        assert label_of(file, rigid_drive()) == name
        file.with_name("config.yaml").write_text("dataset: data\n")
    run = run_of(tmp_path / "joint_1_x" / "model.yaml")
    assert run is not None and run[1].kind == "strokes"
    assert run_of(tmp_path / "joint_1_x" / "more" / "model.yaml") is None


def test_folders_above_a_file_are_made_and_go_with_it(run, drive: Path, tmp_path: Path) -> None:
    out = tmp_path / "a" / "b" / "ranges.json"
    assert run("export", drive / "model.yaml", "--to", "ranges", "--out", out).code == 0 and out.exists()
    (tmp_path / "c").mkdir()
    with pytest.raises(ZeroDivisionError), result_file(tmp_path / "c" / "d" / "e.json", force=False):
        raise ZeroDivisionError
    assert not list((tmp_path / "c").iterdir())


def test_file_is_kept_unless_it_may_be_overwritten(run, drive: Path, tmp_path: Path) -> None:
    (tmp_path / "ranges.json").write_text("mine")
    done = run("export", drive / "model.yaml", "--to", "ranges", "--out", tmp_path / "ranges.json")
    assert done.code == 2 and "--force" in done.err
    assert (tmp_path / "ranges.json").read_text() == "mine"
    done = run("export", drive / "model.yaml", "--to", "ranges", "--out", tmp_path / "ranges.json", "--force")
    assert done.code == 0 and "parameters" in (tmp_path / "ranges.json").read_text()


def test_an_export_replaces_neither_results_nor_its_own_input(run, drive: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "model.yaml").write_text((drive / "model.yaml").read_text())
    (folder / "result.json").write_text("{}")
    for out in ("result.xml", "model.yaml"):
        done = run("export", folder, "--to", "mjcf", "--out", folder / out, "--force")
        assert done.code == 2 and "which nothing replaces" in done.err
    assert (folder / "result.json").read_text() == "{}"
    for out in (".", "/"):
        done = run("export", folder, "--to", "mjcf", "--out", out)
        assert done.code == 2 and "give the name of a file" in done.err
    done = run("export", folder, "--to", "mjcf", "--out", tmp_path / ("x" * 300 + ".xml"))
    assert done.code == 2 and "too long" in done.err


def test_results_cannot_take_the_place_of_the_folder_that_one_is_in(
    run, drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for out in (".", ".."):
        done = run("identify", drive, "--pooled", "--out", out)
        assert done.code == 2 and "the folder that you are in" in done.err
