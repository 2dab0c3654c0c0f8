"""The commands on sound input: what they print and write."""

import json
import os
import re
import shutil
import signal
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import click
import numpy as np
import pandas as pd
import pytest
import yaml
from browser import look_at
from command_line import whole
from drives import make_record, rigid_drive

from hybrid_id import __version__
from hybrid_id.cli.console import FitProgress
from hybrid_id.cli.folder import (
    BEGUN,
    CHECKPOINT,
    EVENTS,
    added_results,
    files_to_write,
    live_folder,
    refuse_foreign,
    refuse_taken,
    results_folder,
)
from hybrid_id.config import StudyConfig, load_config, study_config
from hybrid_id.errors import InputError
from hybrid_id.identification.horizons import WHOLE
from hybrid_id.identification.least_squares import Options
from hybrid_id.paper.demo import DEMO
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.simulation.step import Engine
from hybrid_id.study.run import fit_share
from hybrid_id.systems.model_file import load_model


@pytest.fixture(scope="module")
def identified(run, drive: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Folder and summary of one identification."""
    out = tmp_path_factory.mktemp("identify") / "runs" / "small"
    outcome = run("identify", drive, "--out", out)
    assert outcome.code == 0
    return out, outcome.out


def test_version_and_help(run) -> None:
    assert run("--version").out.strip() == f"hybrid_id {__version__}"
    words = run().out
    for command in ("check", "excite", "identify", "train", "simulate", "compare", "demo", "components"):
        assert command in words
        assert run(command, "--help").code == 0


def helps(command: click.Command) -> Iterator[str]:
    """Every help of a command and of those below it."""
    yield command.help or ""
    for parameter in command.params:
        yield getattr(parameter, "help", None) or ""
    for below in getattr(command, "commands", {}).values():
        yield from helps(below)


def test_no_help_has_what_the_terminal_takes_for_markup() -> None:
    words = list(helps(whole()))
    assert len(words) > 100
    for one in words:
        assert not re.search(r"\[[a-z/]", one), f"what stands in brackets is not printed: {one}"


def test_a_dataset_without_a_model_says_where_one_is_described(run, drive: Path, tmp_path: Path) -> None:
    shutil.copytree(drive, tmp_path / "bare")
    (tmp_path / "bare" / "model.yaml").unlink()
    said = run("check", tmp_path / "bare")
    assert said.code == 0 and "nothing to warn of" in said.out and "docs/formats.md" in said.out
    for command in ("identify", "train", "diagnose"):
        told = run(command, tmp_path / "bare", "--out", tmp_path / "out")
        assert told.code == 2 and "model.yaml does not exist; write it (docs/formats.md" in told.err
        assert not (tmp_path / "out").exists()


def test_check_refuses_records_that_tell_nothing(run, drive: Path, tmp_path: Path) -> None:
    stuck = make_record(rigid_drive(), np.linspace(0.0, 1e-3, 10), seed=0, noise={"q_m1": 0.01}, name="stuck")
    channels = (Channel("u1", "V"),), (Channel("q_m1", "rad", 0.01),)
    Dataset("stuck drive", *channels, (stuck,), 0.002).save(tmp_path / "stuck")
    said = run("check", tmp_path / "stuck", "--model", drive / "model.yaml")
    assert said.code == 2 and "nothing of a drive at rest can be identified" in said.err


def test_check_refuses_model_without_unknowns(run, drive: Path, tmp_path: Path) -> None:
    fixed = tmp_path / "fixed.yaml"
    fixed.write_text((drive / "model.yaml").read_text().replace("estimate: true", "estimate: false"))
    said = run("check", drive, "--model", fixed)
    assert said.code == 2
    assert "no parameter to estimate" in said.err


@pytest.mark.parametrize(("channel", "change"), [("u1", {"unit": "mV"}), ("q_m1", {"scale": -1})])
def test_wrong_units_and_signs_do_not_pass_silently(
    run, drive: Path, tmp_path: Path, channel: str, change: dict
) -> None:
    shutil.copytree(drive, tmp_path / "wrong")
    file = tmp_path / "wrong" / "dataset.yaml"
    values = yaml.safe_load(file.read_text()) | {"columns": {channel: {"column": channel, **change}}}
    file.write_text(yaml.safe_dump(values))
    words = run("check", tmp_path / "wrong", "--json").out
    assert "the model's start values explain less than the mean of the records (normalised RMSE" in words
    assert ("q_m1 turns the other way than with the model's start values" in words) == ("scale" in change)
    assert "start values explain" not in run("check", drive, "--json").out


def with_column(drive: Path, folder: Path, channel: str, scale: float) -> Path:
    """The drive's records with a column whose unit was forgotten."""
    shutil.copytree(drive, folder)
    values = yaml.safe_load((folder / "dataset.yaml").read_text())
    values |= {"columns": {channel: {"column": channel, "scale": scale}}, "sample_time": None}
    (folder / "dataset.yaml").write_text(yaml.safe_dump(values))
    return folder


def test_time_in_another_unit_is_refused_before_anything_is_simulated(
    run, drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = "unit: ms"
    monkeypatch.setattr("hybrid_id.study.check_model", None)
    folder = with_column(drive, tmp_path / "wrong", "t", 1e3)
    said = run("check", folder)
    assert said.code == 2 and words in said.err and "run_0.csv.gz" in said.err
    assert "run_3   test" in said.out and "identif" not in said.out
    for command in ("identify", "diagnose", "simulate"):
        assert words in run(command, folder, "--out", tmp_path / "out").err
    to_mujoco = ("--to", "mjcf", "--out", tmp_path / "robot.xml", "--check", folder)
    assert words in run("export", drive / "model.yaml", *to_mujoco).err


def test_no_confident_table_follows_degrees_for_radians(run, drive: Path, tmp_path: Path) -> None:
    said = run("check", with_column(drive, tmp_path / "wrong", "q_m1", 180.0 / np.pi))
    assert said.code == 2 and "check its unit" in said.err
    assert "identifiable" not in said.out and "records and model contradict each other" in said.out


def test_warnings_are_said_before_the_model_is_read(run, drive: Path, tmp_path: Path) -> None:
    (tmp_path / "model.yaml").write_text(
        (drive / "model.yaml").read_text().replace("gear_ratio: [156.0]", "gear_ratio: [0.001]")
    )
    said = run("check", drive, "--model", tmp_path / "model.yaml")
    assert said.code == 2 and "run_3   test" in said.out
    assert "model.yaml: gear_ratio 0.001 is none of a drive" in said.err and "turns of the motor" in said.err


def test_records_of_more_joints_than_the_model_has(run, drive: Path, tmp_path: Path) -> None:
    data = Dataset.load(drive)
    records = tuple(replace(r, outputs=r.outputs | {"q_m2": r.outputs["q_m1"]}) for r in data.records)
    replace(data, outputs=(*data.outputs, Channel("q_m2", "rad")), records=records).save(tmp_path / "two")
    said = run("simulate", tmp_path / "two", "--model", drive / "model.yaml", "--out", tmp_path / "out")
    assert said.code == 2
    for words in ("model.yaml: ", "'q_m2'", "take a model of that joint"):
        assert words in said.err


def test_identify_writes_everything(identified: tuple[Path, str], tmp_path: Path) -> None:
    out, words = identified
    assert len(words.splitlines()) <= 25
    assert "results are in" in words
    names = {path.name for path in out.iterdir()}
    pictures = {
        "parameters.png",
        "cross_validation.png",
        "residuals.png",
        *(f"fit_run_{k}.png" for k in range(4)),
    }
    assert names == pictures | {
        ".written",
        "result.json",
        "parameters.csv",
        "model.yaml",
        "models",
        "config.yaml",
        "tensorboard",
        "report.html",
    }
    assert not any(path.name.startswith(".") for path in out.parent.iterdir())
    look_at(out / "report.html", tmp_path, figures=len(pictures))


def test_saved_config_gives_the_same_again(run, identified: tuple[Path, str], tmp_path: Path) -> None:
    out, _ = identified
    saved = yaml.safe_load((out / "config.yaml").read_text())
    saved["output"] |= {"figures": False, "tensorboard": False, "report": False}  # no part of the numbers
    study = out.parent / "again" / "config.yaml"  # its paths begin at its folder
    study.parent.mkdir()
    study.write_text(yaml.safe_dump(saved))
    outcome = run("identify", study, "--out", tmp_path / "again", "--json")
    again, first = json.loads(outcome.out), json.loads((out / "result.json").read_text())
    assert again == first
    assert json.loads((tmp_path / "again" / "result.json").read_text()) == first


def test_options_stand_in_for_the_config(run, drive: Path, tmp_path: Path) -> None:
    config = tmp_path / "study.yaml"
    text = f"dataset: {drive}\nidentification: {{loss: huber, starts: 2}}\n"
    text += "output: {folder: here, figures: false, tensorboard: false, report: false}\n"
    config.write_text(text)
    outcome = run("identify", config, "--pooled", "--starts", 1)
    assert outcome.code == 0, outcome.err
    saved = load_config(tmp_path / "here" / "config.yaml").identification
    assert (saved.pooled, saved.loss, saved.starts) == (True, "huber", 1)
    assert not list((tmp_path / "here").glob("*.png"))
    assert not (tmp_path / "here" / "models").exists()
    assert "pooled set" in outcome.out


def test_processes_share_the_records(run, plain: Path, identified: tuple[Path, str], tmp_path: Path) -> None:
    outcome = run("identify", plain, "--jobs", 2, "--out", tmp_path / "out", "--json")
    sets = json.loads(outcome.out)["sets"]
    first = json.loads((identified[0] / "result.json").read_text())["sets"]
    assert [one["set"] for one in sets] == ["run_0", "run_1", "run_2"]
    for one, same in zip(sets, first, strict=True):
        np.testing.assert_allclose(one["values"], same["values"], rtol=1e-6)


def test_simulate_writes_what_the_model_says(
    run, drive: Path, identified: tuple[Path, str], tmp_path: Path
) -> None:
    out = tmp_path / "sim"
    outcome = run("simulate", drive, "--model", identified[0] / "model.yaml", "--out", out)
    assert outcome.code == 0
    table = pd.read_csv(out / "run_3.csv")
    assert list(table.columns) == ["t", "u1", "q_m1", "q_m1_simulated"]
    error = np.std(table["q_m1"] - table["q_m1_simulated"]) / np.std(table["q_m1"])
    result = json.loads((out / "result.json").read_text())["models"]
    (of_model,) = result.values()
    assert of_model["run_3"]["nrmse"]["q_m1"] == pytest.approx(error, rel=0.2)
    assert error < 0.01
    look_at(out / "report.html", tmp_path, figures=4)


def test_force_replaces_results_only_when_the_new_ones_are_complete(run, drive: Path, tmp_path: Path) -> None:
    out = tmp_path / "sim"
    assert run("simulate", drive, "--out", out).code == 0
    first = (out / "result.json").read_text()
    assert run("simulate", drive, "--model", drive / "gone.yaml", "--out", out, "--force").code == 2
    assert (out / "result.json").read_text() == first
    (out / "stale.txt").write_text("of the first run")
    with (out / ".written").open("a") as names:
        names.write("stale.txt\n")
    assert run("simulate", drive, "--out", out).code == 2
    assert run("simulate", drive, "--out", out, "--force").code == 0
    assert not (out / "stale.txt").exists()
    assert [path.name for path in tmp_path.iterdir()] == ["sim"]


def test_a_training_that_was_killed_before_its_first_checkpoint_is_begun_anew(tmp_path: Path) -> None:
    out = tmp_path / "out"
    (out / EVENTS).mkdir(parents=True)
    (out / "config.yaml").write_text("dataset: x\n")
    with pytest.raises(InputError, match="no results of hybrid-id"):  # it may be another program's
        refuse_taken(out, force=True)
    (out / CHECKPOINT).write_text("somebody's weights")
    with pytest.raises(InputError, match="no results of hybrid-id"):
        refuse_taken(out, force=True)
    (out / BEGUN).write_text("")
    refuse_taken(out, force=True)


def test_force_never_takes_a_record_of_the_dataset_beside_it(tmp_path: Path) -> None:
    """By its whole name or a pattern; a part of another's name is free."""
    listed = {"records": [{"file": "run_1.csv"}, {"file": "log_*.csv"}]}
    (tmp_path / "dataset.yaml").write_text(yaml.safe_dump(listed))
    for name in ("run_1.csv", "log_7.csv", "n_1.csv"):
        (tmp_path / name).write_text("t,u1\n")
    for name in ("run_1.csv", "log_7.csv"):
        with pytest.raises(InputError, match="a record of the dataset beside it"):
            files_to_write(tmp_path / name, force=True)
    files_to_write(tmp_path / "n_1.csv", force=True)


def test_force_never_takes_results_that_lie_inside_the_folder(run, drive: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert run("simulate", drive, "--out", out).code == 0
    assert run("simulate", drive, "--out", out / "second").code == 0
    said = run("simulate", drive, "--out", out, "--force")
    assert said.code == 2 and f"holds other results, in {out / 'second'}; move them" in said.err
    assert (out / "second" / "result.json").exists()


def test_a_folder_of_parts_is_taken_over_only_from_a_run_of_the_same_kind(tmp_path: Path) -> None:
    refuse_foreign(tmp_path / "none", "cells", "*/cell.json")
    (tmp_path / "cells").mkdir()
    refuse_foreign(tmp_path, "cells", "*/cell.json")
    (tmp_path / "cells" / ".half").mkdir()  # of a run that was killed while it wrote its first cell
    refuse_foreign(tmp_path, "cells", "*/cell.json")
    (tmp_path / "cells" / "liver").mkdir()
    with pytest.raises(InputError, match="no results of hybrid-id"):
        refuse_foreign(tmp_path, "cells", "*/cell.json")
    (tmp_path / "cells" / "liver" / "cell.json").write_text(json.dumps({"program": "hybrid_id 0.1.0"}))
    refuse_foreign(tmp_path, "cells", "*/cell.json")


def test_a_backup_that_nobody_here_has_made_is_left_alone(tmp_path: Path, drive: Path) -> None:
    out, backup = tmp_path / "out", tmp_path / "out.old"
    backup.mkdir()
    (backup / "mine.txt").write_text("x")
    config = study_config(drive)
    with pytest.raises(ZeroDivisionError), live_folder(out, config, force=False, resume=False):
        assert (out / BEGUN).exists()
        raise ZeroDivisionError
    out.mkdir()
    (out / BEGUN).write_text("")  # as a kill leaves it
    with live_folder(out, config, force=True, resume=False):
        (out / "result.json").write_text("{}")
    assert (backup / "mine.txt").exists() and not (out / BEGUN).exists()


def test_results_come_back_where_new_ones_cannot_take_their_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, replace_ = tmp_path / "out", Path.replace
    with results_folder(out, force=False) as folder:
        (folder / "result.json").write_text('{"program": "hybrid_id 0"}')

    def stopped(self: Path, target: Path) -> Path:
        if self.name == "new":
            raise KeyboardInterrupt
        return replace_(self, target)

    monkeypatch.setattr(Path, "replace", stopped)
    with pytest.raises(KeyboardInterrupt), results_folder(out, force=True):
        pass
    assert (out / "result.json").exists() and [path.name for path in tmp_path.iterdir()] == ["out"]


def test_force_never_takes_a_file_that_the_user_has_put_beside_the_results(tmp_path: Path) -> None:
    out, config = tmp_path / "out", StudyConfig(dataset=tmp_path, model=tmp_path / "model.yaml")

    def written(place: Path) -> None:
        (place / "result.json").write_text('{"program": "hybrid_id 0"}')

    def trained(force: bool, resume: bool = False) -> None:
        with live_folder(out, config, force=force, resume=resume), added_results(out) as folder:
            (out / CHECKPOINT).write_text("weights")
            written(folder)

    with results_folder(out, force=False) as folder:
        written(folder)
    for again in (lambda: refuse_taken(out, force=True), lambda: trained(force=True)):
        (out / "notes.txt").write_text("mine")
        with pytest.raises(InputError, match=r"notes\.txt is none of the results .* move it"):
            again()
        assert (out / "notes.txt").read_text() == "mine"
        (out / "notes.txt").unlink()
        again()
    (out / "notes.txt").write_text("mine")
    trained(force=False, resume=True)  # which fills the folder further, and replaces nothing
    assert (out / "notes.txt").read_text() == "mine"
    with pytest.raises(InputError, match=r"notes\.txt is none of the results"):
        refuse_taken(out, force=True)


def test_live_folder_brings_the_old_results_back(tmp_path: Path) -> None:
    out, config = tmp_path / "out", StudyConfig(dataset=tmp_path, model=tmp_path / "model.yaml")
    with results_folder(out, force=False) as folder:
        (folder / "result.json").write_text('{"program": "hybrid_id 0"}')
    with pytest.raises(ZeroDivisionError), live_folder(out, config, force=True, resume=False):
        (out / "events").write_text("new")
        raise ZeroDivisionError
    assert sorted(path.name for path in out.iterdir()) == [".written", "result.json"]
    with live_folder(out, config, force=True, resume=False), added_results(out) as folder:
        (folder / "result.json").write_text("new")
        (folder / "models").mkdir()
    assert (out / "result.json").read_text() == "new"
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_first_interrupt_asks_the_fit_to_end(tmp_path: Path) -> None:
    if threading.current_thread() is not threading.main_thread():
        pytest.skip("signals arrive in the main thread")
    before = signal.getsignal(signal.SIGINT)
    with FitProgress(2, 60) as progress:
        progress.flag = tmp_path / "stop"
        assert progress("records", 1, None, [0, 1]) is False
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.01)
        assert progress("records", 2, None, [0, 1]) is True
        assert progress.flag.exists()
        assert signal.getsignal(signal.SIGINT) is before  # the second one interrupts as usual
    assert signal.getsignal(signal.SIGINT) is before


def test_interrupted_fit_is_written_and_says_so(run, plain: Path, tmp_path: Path, monkeypatch) -> None:
    def stop(self: FitProgress, *_: object) -> bool:
        self.stopped = self.cut = True
        return True

    monkeypatch.setattr(FitProgress, "__call__", stop)
    outcome = run("identify", plain, "--out", tmp_path / "out")
    assert outcome.code == 130
    assert "stopped: the sets are" in outcome.err
    assert "are kept" not in outcome.err and not (tmp_path / "out" / "fits").exists()  # nothing was complete
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert {one["status"] for one in result["sets"]} == {"interrupted"}


@pytest.mark.parametrize("trained", [True, False])
def test_ctrl_c_names_the_checkpoint_where_there_is_one(
    run, drive: Path, tmp_path: Path, monkeypatch, trained: bool
) -> None:
    def stop(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    out = tmp_path / "out"
    if trained:
        out.mkdir()
        (out / "checkpoint.pt").write_bytes(b"")
        (out / BEGUN).write_text("")
        words = run("identify", drive, "--out", out).err
        assert f"{out} holds an unfinished training; 'hybrid-id train {out}/config.yaml" in words
    monkeypatch.setattr("hybrid_id.cli.train.checked_records", stop)
    outcome = run("train", drive, "--out", out, *(["--resume"] if trained else []))
    assert outcome.code == 130
    assert (f"--out {out} --resume' goes on" in outcome.err) == trained
    assert ("no results were written" in outcome.err) != trained


def test_interrupt_reaches_the_other_processes(drive: Path, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(signal, "signal", lambda *_: None)  # as in a process of its own
    data, stop = Dataset.load(drive), tmp_path / "stop"
    stop.touch()
    settings = {"engine": Engine(), "options": Options(), "starts": 1, "kept": None}
    (found,) = fit_share([0], data, load_model(drive / "model.yaml"), settings, stop, WHOLE, "cpu")
    assert found.status == "interrupted"


def test_a_record_that_is_named_as_the_table_is_refused(run, drive: Path, tmp_path: Path) -> None:
    dataset = Dataset.load(drive)
    named = replace(dataset.records[0], name="comparison"), *dataset.records[1:]
    copy = replace(dataset, records=named).save(tmp_path / "copy")
    shutil.copy(drive / "model.yaml", copy)
    outcome = run("simulate", copy, "--out", tmp_path / "out")
    assert outcome.code == 2 and "record 'comparison' is named as the table" in outcome.err


def test_profiles_are_found_written_and_said(run, drive: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    shown = run("identify", drive, "--pooled", "--profile", "J", "--out", out)
    assert shown.code == 0 and "J" in shown.out
    result = json.loads((out / "result.json").read_text())
    ends, value = result["profiles"]["J"], result["selected"]["values"]["J"]
    assert ends["lower"] < value < ends["upper"]
    assert (out / "profiles.png").stat().st_size > 1000
    told = run("identify", drive, "--profile", "nonsense", "--out", tmp_path / "none")
    assert told.code == 2 and "nonsense" in told.err


def test_demo_takes_settings(run, tmp_path: Path) -> None:
    excitation = {"starts": 2, "experiments": DEMO["excitation"]["experiments"][1:3]}
    settings = DEMO | {"duration": 1.6, "sample_time": 0.004, "excitation": excitation}
    (tmp_path / "twin.yaml").write_text(yaml.safe_dump(settings))
    done = run("demo", "--settings", tmp_path / "twin.yaml", "--out", tmp_path / "demo")
    assert done.code == 0 and "beside its estimates" in done.out
    assert Dataset.load(tmp_path / "demo" / "data").sample_time == 0.004
