"""The command `diagnose`: what it prints and writes, and what stays as it was when it cannot."""

import json
import os
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
    "config.yaml", "diagnosis.json", "gap.png", "missing_torque.png", "model.yaml", "refit.yaml", "report.html",
    "reversals.png", "suspects.png", "tensorboard", "torque_map.png", "where.png", "worst_record.png",
}  # fmt: skip

SEARCHED = """
import hybrid_id.cli.diagnose as command
from hybrid_id.cli import main

search = command.run
command.run = lambda *given: print("searching", flush=True) or search(*given)
main()
"""
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
    """Dataset folder of the drive with the spring, today's model in it."""
    folder = tmp_path_factory.mktemp("records") / "spring"
    diagnosed[0].save(folder)
    save_model(diagnosed[1], folder / "model.yaml")
    return folder


@pytest.fixture
def known(diagnosed, monkeypatch: pytest.MonkeyPatch) -> None:
    """The search itself is not repeated."""
    monkeypatch.setattr(command, "run", lambda *_: diagnosed[2])


def test_prints_the_verdict_and_writes_everything(run, known, records: Path, tmp_path: Path) -> None:
    out = tmp_path / "runs" / "gap"
    said = run("diagnose", records, "--out", out, "--seed", 7)
    assert said.code == 0
    assert said.out.startswith("Spring load at the load of joint 1")
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
    run, diagnosed, monkeypatch: pytest.MonkeyPatch, records: Path, tmp_path: Path
) -> None:
    dataset, _, found = diagnosed
    other = replace(found.search.chosen, result=replace(found.search.chosen.result, system=diagnosed[1]))
    proposed = tuple(next_experiment(dataset, [found.search.chosen, other]))
    monkeypatch.setattr(command, "run", lambda *_: replace(found, experiments=proposed))
    said = run("diagnose", records, "--out", tmp_path / "gap")
    assert said.code == 0 and "next_experiment.csv" in said.out
    table = pd.read_csv(tmp_path / "gap" / "next_experiment.csv")
    assert list(table) == ["t", *dataset.train[0].inputs]
    np.testing.assert_allclose(table["u1"], proposed[0].command, rtol=1e-5)
    assert np.ptp(table["u1"]) > 0.0


def test_json_is_the_file(run, known, records: Path, tmp_path: Path) -> None:
    said = run("diagnose", records, "--out", tmp_path / "gap", "--json")
    assert json.loads(said.out) == json.loads((tmp_path / "gap" / "diagnosis.json").read_text())


def test_written_models_are_those_of_the_diagnosis(
    run, known, diagnosed, records: Path, tmp_path: Path
) -> None:
    dataset, _, found = diagnosed
    run("diagnose", records, "--out", tmp_path / "gap")
    for name, explanation in (("model", found.search.chosen), ("refit", found.search.base)):
        again = load_model(tmp_path / "gap" / f"{name}.yaml")
        assert list(again.components) == list(explanation.system.components)
        torch.testing.assert_close(again.theta(), explanation.system.theta(), rtol=1e-12, atol=0)
        runs = [replay(dataset, s, engine=explanation.result.engine)[3] for s in (again, explanation.system)]
        assert runs[0].nrmse["q_m1"] == pytest.approx(runs[1].nrmse["q_m1"], rel=1e-9)
    # the next command takes it as it is
    said = run("simulate", records, "--model", tmp_path / "gap" / "model.yaml", "--out", tmp_path / "replay")
    assert said.code == 0


def test_earlier_diagnosis_is_replaced_only_by_force(run, known, records: Path, tmp_path: Path) -> None:
    out = tmp_path / "gap"
    assert run("diagnose", records, "--out", out).code == 0
    refused = run("diagnose", records, "--out", out)
    assert refused.code == 2 and "--force" in refused.err
    assert run("diagnose", records, "--out", out, "--force").code == 0
    (out / "diagnosis.json").write_text("{}")  # not ours any more
    assert run("diagnose", records, "--out", out, "--force").code == 2


def test_whole_way_from_a_study_file(run, tmp_path: Path) -> None:
    dataset, today = small_case()
    dataset.save(tmp_path / "data")
    save_model(today, tmp_path / "data" / "model.yaml")
    study = tmp_path / "study.yaml"
    study.write_text(
        "dataset: data\ngap: {most: 1}\noutput: {folder: out, figures: false, tensorboard: false, report: false}\n"
    )
    said = run("diagnose", study)
    assert said.code == 0
    assert said.out.startswith("Wrong parameters explain the gap, and no effect is missing")
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "config.yaml", "diagnosis.json", "model.yaml", "refit.yaml",
    }  # fmt: skip
    assert load_config(tmp_path / "out" / "config.yaml").gap.most == 1


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("dataset: DATA\ngap: {most: 0}\n", ("gap.most", "0")),
        ("dataset: DATA\ngap: {effects: 2}\n", ("gap.effects", "unknown")),
        ("dataset: DATA\nmodel: gone.yaml\n", ("gone.yaml", "does not exist")),
        ("dataset: DATA\npreprocessing: {records: [run_3]}\n", ("no train record",)),
    ],
)
def test_wrong_input_ends_with_one_sentence(
    text: str, names: tuple[str, ...], run, records: Path, tmp_path: Path
) -> None:
    study = tmp_path / "study.yaml"
    study.write_text(text.replace("DATA", str(records)))
    said = run("diagnose", study, "--out", tmp_path / "out")
    assert said.code == 2
    assert said.err.count("Error: ") == 1 and said.err.splitlines()[-1].endswith(".")
    for name in names:
        assert name in said.err
    assert not (tmp_path / "out").exists()


def test_ctrl_c_leaves_nothing_behind(records: Path, tmp_path: Path) -> None:
    """The signal goes to every process of the group, as from a terminal."""
    line = [sys.executable, "-c", SEARCHED, "diagnose", str(records), "--out", str(tmp_path / "runs" / "gap")]
    # a shell that started the tests in its background has told them to ignore the signal
    own = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        process = subprocess.Popen(
            line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
        )
    finally:
        signal.signal(signal.SIGINT, own)
    assert process.stdout is not None and process.stdout.readline() == "searching\n"
    time.sleep(1.0)
    os.killpg(process.pid, signal.SIGINT)
    _, said = process.communicate()
    assert process.returncode == 130
    assert said.splitlines()[-1] == "Error: stopped; no results were written."
    assert "Traceback" not in said
    assert not (tmp_path / "runs").exists()


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


def test_effects_are_listed(run) -> None:
    words = run("effects").out
    rows = run("effects", "--markdown").out.splitlines()
    assert "spring_load" in words
    assert rows[1] == "| --- | --- | --- | --- | --- |"
    assert len(rows) >= 2 + 21
    assert any(row.startswith("| `backlash` | transmission | ") for row in rows)
    told = {one["effect"]: one for one in json.loads(run("effects", "--json").out)["effects"]}
    assert told["delay"]["mistaken_for"]["electrical_lag"] == told["electrical_lag"]["mistaken_for"]["delay"]
    assert told["quadratic_drag"]["source"].endswith("1968")
