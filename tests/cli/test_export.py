"""`export`: the files, what is said about them, and wrong input."""

from pathlib import Path
from typing import cast

import pytest
import torch

from hybrid_id.cli.folder import write_files


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


def test_folders_above_a_file_are_made_and_go_with_it(run, drive: Path, tmp_path: Path) -> None:
    out = tmp_path / "a" / "b" / "ranges.json"
    assert run("export", drive / "model.yaml", "--to", "ranges", "--out", out).code == 0 and out.exists()
    (tmp_path / "c").mkdir()
    with pytest.raises(TypeError):
        write_files({tmp_path / "c" / "d" / "e.json": cast(str, 7)})
    assert not list((tmp_path / "c").iterdir())


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
