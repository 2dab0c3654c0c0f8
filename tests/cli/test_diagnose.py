"""The command `diagnose`: what it prints and writes, and what stays as it was when it cannot."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch
from browser import look_at
from gapcase import small_case

import hybrid_id.cli.diagnose as command
from hybrid_id import __version__, load_model, replay, save_model
from hybrid_id.config import load_config
from hybrid_id.diagnosis.next_experiment import next_experiment

FILES = {
    ".written",
    "config.yaml", "diagnosis.json", "gap.png", "location.png", "missing_torque.png", "model.yaml",
    "refit.yaml", "report.html", "reversals.png", "shares.png", "tensorboard", "torque_map.png", "worst_record.png",
}  # fmt: skip
PLAIN = {".written", "config.yaml", "diagnosis.json", "model.yaml", "refit.yaml"}
"""Without pictures, events and page."""

IMPORTING = """
import builtins, os, signal
from hybrid_id.cli import main

signal.signal(signal.SIGINT, signal.default_int_handler)  # see below
load = builtins.__import__

def interrupted(name, *further):
    if name == "typer":
        os.kill(os.getpid(), signal.SIGINT)
    return load(name, *further)

builtins.__import__ = interrupted
main()
"""
ENDING = """
import atexit, os, signal, sys
from hybrid_id.cli import main

signal.signal(signal.SIGINT, signal.default_int_handler)
sys.argv = ["hybrid-id", "--version"]
atexit.register(os.kill, os.getpid(), signal.SIGINT)
main()
"""


@pytest.fixture(scope="module")
def records(diagnosed, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Dataset folder of the drive with the spring, the nominal model in it."""
    folder = tmp_path_factory.mktemp("records") / "spring"
    diagnosed[0].save(folder)
    save_model(diagnosed[1], folder / "model.yaml")
    return folder


@pytest.fixture
def plain(records: Path, tmp_path: Path) -> Path:
    """Study file without pictures, events and page, which take longer than what else is tested."""
    file = tmp_path / "plain.yaml"
    file.write_text(f"dataset: {records}\noutput: {{figures: false, tensorboard: false, report: false}}\n")
    return file


@pytest.fixture
def known(diagnosed, monkeypatch: pytest.MonkeyPatch) -> None:
    """The search itself is not repeated."""
    monkeypatch.setattr(command, "run", lambda *_: diagnosed[2])


def test_prints_the_verdict_and_writes_everything(run, known, records: Path, tmp_path: Path) -> None:
    out = tmp_path / "runs" / "gap"
    said = run("diagnose", records, "--out", out, "--seed", 7)
    assert said.code == 0
    assert said.out.startswith("Spring load explains 100 % (")
    assert len(said.out.splitlines()) <= 25
    assert {path.name for path in out.iterdir()} == FILES
    result = json.loads((out / "diagnosis.json").read_text())
    assert (result["program"], result["command"], result["seed"]) == (
        f"hybrid_id {__version__}",
        "diagnose",
        7,
    )
    assert result["verdict"] == "effects"
    verdicts = {name: tests[0]["verdict"] for name, tests in result["residual_tests"].items()}
    assert verdicts["re-fitted"] == "not white" and verdicts["corrected"] in ("white", "nearly white")
    assert load_config(out / "config.yaml").dataset.resolve() == records.resolve()
    look_at(out / "report.html", tmp_path, figures=7)


def test_the_next_experiment_is_ready_to_be_played(
    run, diagnosed, monkeypatch: pytest.MonkeyPatch, plain: Path, tmp_path: Path
) -> None:
    dataset, _, found = diagnosed
    proposed = tuple(next_experiment(dataset, [[found.search.chosen, found.search.base]]))
    monkeypatch.setattr(command, "run", lambda *_: replace(found, experiments=proposed))
    said = run("diagnose", plain, "--out", tmp_path / "gap")
    assert said.code == 0 and "next_experiment.csv" in said.out
    table = pd.read_csv(tmp_path / "gap" / "next_experiment.csv")
    begin = [f"start_{name}" for name in dataset.train[0].outputs]
    assert list(table) == ["t", "record", "name", *dataset.train[0].inputs, *begin]
    for k, one in enumerate(proposed, 1):
        for name, angle in one.start.items():
            np.testing.assert_allclose(table[f"start_{name}"][table["record"] == k], angle, rtol=1e-5)
        np.testing.assert_allclose(table["u1"][table["record"] == k], one.command, rtol=1e-5)
        assert np.ptp(one.command) > 0.0


def test_written_models_are_those_of_the_diagnosis(
    run, known, diagnosed, drive: Path, plain: Path, tmp_path: Path
) -> None:
    dataset, _, found = diagnosed
    run("diagnose", plain, "--out", tmp_path / "gap")
    for name, fitted in (("model", found.search.chosen), ("refit", found.search.base)):
        again = load_model(tmp_path / "gap" / f"{name}.yaml")
        assert list(again.components) == list(fitted.system.components)
        torch.testing.assert_close(again.theta(), fitted.system.theta(), rtol=1e-12, atol=0)
        runs = [replay(dataset, s, engine=fitted.result.engine)[3] for s in (again, fitted.system)]
        assert runs[0].nrmse["q_m1"] == pytest.approx(runs[1].nrmse["q_m1"], rel=1e-9)
    # the next command takes it as it is
    said = run("simulate", drive, "--model", tmp_path / "gap" / "model.yaml", "--out", tmp_path / "replay")
    assert said.code == 0


def test_whole_way_from_a_study_file(run, tmp_path: Path) -> None:
    dataset, nominal = small_case()
    dataset.save(tmp_path / "data")
    save_model(nominal, tmp_path / "data" / "model.yaml")
    study = tmp_path / "study.yaml"
    study.write_text(
        "dataset: data\ngap: {max_effects: 1}\n"
        "output: {folder: out, figures: false, tensorboard: false, report: false}\n"
    )
    said = run("diagnose", study)
    assert said.code == 0
    assert said.out.startswith("Wrong parameter values explain the gap, and no effect is missing.")
    assert {path.name for path in (tmp_path / "out").iterdir()} == PLAIN
    assert load_config(tmp_path / "out" / "config.yaml").gap.max_effects == 1


def test_a_stopped_search_keeps_its_fits_and_resumes(run, plain: Path, tmp_path: Path) -> None:
    """The signal goes to every process of the group, as from a terminal."""
    out = tmp_path / "runs" / "gap"
    asked = ["diagnose", str(plain), "--max-effects", "1", "--jobs", "1", "--out", str(out)]
    # a shell that started the tests in its background has told them to ignore the signal
    own = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        process = subprocess.Popen(
            [sys.executable, "-m", "hybrid_id", *asked],
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
    finally:
        signal.signal(signal.SIGINT, own)
    while process.poll() is None and len(list(out.glob("fits/*.npz"))) < 5:
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)
    _, said = process.communicate()
    assert process.returncode == 130
    assert re.fullmatch(
        r"Error: stopped; \d+ fits are kept in .*, and the same command with --resume goes on\.",
        said.splitlines()[-1],
    )
    assert "Traceback" not in said
    refused = run(*asked)
    assert refused.code == 2 and "holds an unfinished diagnosis; --resume goes on" in refused.err
    kept = {file.name for file in out.glob("fits/*.npz")}
    files, write = [], command.write_diagnosis
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            command, "write_diagnosis", lambda *given: files.extend(out.glob("fits/*.npz")) or write(*given)
        )
        done = run(*asked, "--resume")
    assert done.code == 0 and done.out.startswith("Spring load explains")
    assert kept < {file.name for file in files}
    assert {path.name for path in out.iterdir()} == PLAIN


def test_results_of_an_interrupted_search_are_written_and_it_resumes(
    run, diagnosed, monkeypatch: pytest.MonkeyPatch, plain: Path, tmp_path: Path
) -> None:
    found, out = diagnosed[2], tmp_path / "gap"
    cut = replace(found, search=replace(found.search, interrupted=True))

    def interrupted(dataset, system, config, kept):
        (kept.folder / "0.npz").write_bytes(b"")  # a fit
        return cut

    monkeypatch.setattr(command, "run", interrupted)
    said = run("diagnose", plain, "--out", out)
    assert said.code == 130 and "--resume goes on" in said.err
    assert "The search was interrupted" in " ".join(said.out.split())
    assert json.loads((out / "diagnosis.json").read_text())["interrupted"] is True
    assert (out / "fits" / "0.npz").exists()
    assert "holds an unfinished diagnosis" in run("diagnose", plain, "--out", out).err
    monkeypatch.setattr(command, "run", lambda *_: found)
    assert run("diagnose", plain, "--out", out, "--resume").code == 0
    assert {path.name for path in out.iterdir()} == PLAIN
    assert json.loads((out / "diagnosis.json").read_text())["interrupted"] is False


@pytest.mark.parametrize(
    "during",
    ["diagnosis.details.Details.compute", "reporting.diagnosis_figures.diagnosis_figures"],
    ids=["computing", "drawing"],
)
def test_ctrl_c_while_pictures_are_made_keeps_the_diagnosis(
    run, diagnosed, monkeypatch: pytest.MonkeyPatch, records: Path, tmp_path: Path, during: str
) -> None:
    def stop(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    def with_a_fit(dataset, system, config, kept):
        (kept.folder / "0.npz").write_bytes(b"")
        return diagnosed[2]

    out = tmp_path / "gap"
    monkeypatch.setattr(command, "run", with_a_fit)
    with monkeypatch.context() as patch:
        patch.setattr(f"hybrid_id.{during}", stop)
        cut = run("diagnose", records, "--out", out)
    assert cut.code == 130
    assert "the diagnosis is complete and in diagnosis.json, pictures and page are not written" in cut.err
    assert json.loads((out / "diagnosis.json").read_text())["interrupted"] is False
    assert {path.name for path in out.iterdir()} == PLAIN | {"fits"} and "--resume goes on" in cut.err
    assert run("diagnose", records, "--out", out, "--resume").code == 0
    assert {path.name for path in out.iterdir()} == FILES
    again = run("diagnose", records, "--out", out, "--resume")
    assert again.code == 0 and "holds a complete diagnosis (diagnosis.json)" in again.err


@pytest.mark.parametrize(
    ("program", "code", "said"),
    [
        (IMPORTING, 130, "Error: stopped; no results were written.\n"),
        (ENDING, 0, ""),
    ],
    ids=["while the program is loaded", "when all is said"],
)
def test_ctrl_c_before_and_after_a_command(program: str, code: int, said: str) -> None:
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (code, said)
