"""`export`: the files, what is said about them, and wrong input."""

import json
from pathlib import Path

import pytest
import torch


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
        (["--to", "ranges", "--force"], "--force writes a model that is worse in MuJoCo"),
        (["--to", "urdf"], "'urdf' is not one of"),
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


def test_file_is_kept_unless_it_may_be_overwritten(run, drive: Path, tmp_path: Path) -> None:
    (tmp_path / "ranges.json").write_text("mine")
    done = run("export", drive / "model.yaml", "--to", "ranges", "--out", tmp_path / "ranges.json")
    assert done.code == 2 and "--overwrite" in done.err
    assert (tmp_path / "ranges.json").read_text() == "mine"
    done = run(
        "export", drive / "model.yaml", "--to", "ranges", "--out", tmp_path / "ranges.json", "--overwrite"
    )
    assert done.code == 0 and "parameters" in (tmp_path / "ranges.json").read_text()


def test_an_export_replaces_neither_results_nor_its_own_input(run, drive: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "model.yaml").write_text((drive / "model.yaml").read_text())
    (folder / "result.json").write_text("{}")
    for out in ("result.xml", "model.yaml"):
        done = run("export", folder, "--to", "mjcf", "--out", folder / out, "--overwrite")
        assert done.code == 2 and "belongs to earlier results" in done.err
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
