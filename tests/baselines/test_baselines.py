"""Contenders on a small gap of this package's own models, and the runner around them."""

import json
import re
import sys
from pathlib import Path

import pytest
from gapcase import WHERE, small_case

from hybrid_id.baselines import run as runner
from hybrid_id.baselines.external import external
from hybrid_id.baselines.keep import begin, is_done, key_of, load, save
from hybrid_id.baselines.run import Case, Settings, read_case, run_cases
from hybrid_id.components import ConstantTorque
from hybrid_id.errors import InputError
from hybrid_id.records.dataset import Dataset
from hybrid_id.systems import System
from hybrid_id.systems.model_file import save_model

BIAS = ConstantTorque(T_0=0.15)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A case folder: a bias torque at the link is withheld."""
    dataset, system = small_case(BIAS)
    place = dataset.save(tmp_path_factory.mktemp("cases") / "c001")
    save_model(system, place / "model.yaml")
    return place


def test_criterion_names_what_is_missing(folder: Path) -> None:
    ((_, said),) = run_cases(Settings("bic"), [read_case(folder)])
    assert said["run"]["message"] == ""
    assert (said["effects"][0]["name"], said["effects"][0]["where"]) == ("constant_torque", WHERE)
    assert said["effects"][0]["selected"] and said["verdict"] == "effects"
    assert sum(e["probability"] for e in said["effects"]) <= 1 + 1e-3
    assert said["gap"]["with_effect"] < said["gap"]["refit"]
    assert said["run"]["seconds"] > 0


def test_stribeck_is_always_named(folder: Path) -> None:
    ((_, said),) = run_cases(Settings("stribeck"), [read_case(folder)])
    assert [e["name"] for e in said["effects"] if e["selected"]] == ["stribeck_friction"]


def _fail(dataset: Dataset, system: System) -> dict:
    raise ValueError("no solution\nat all")


def test_broken_case_is_told_and_loses_no_other(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cases = [Case("c000", {"dataset.yaml": b"name: [", "model.yaml": b""}), read_case(folder)]
    said = dict(run_cases(Settings("stribeck"), cases))
    assert said[0]["case"] == "c000" and said[0]["run"]["message"].startswith("InputError: ")
    assert said[1]["run"]["message"] == ""
    monkeypatch.setattr(runner, "METHODS", {"stribeck": _fail})
    told = dict(run_cases(Settings("stribeck"), cases[1:]))[0]["run"]["message"]
    assert re.fullmatch(r"ValueError: no solution \(baselines/test_baselines\.py, line \d+\)", told)


def test_what_is_kept_is_done_for_the_same_program_only(tmp_path: Path, folder: Path) -> None:
    case, settings = read_case(folder), Settings("bic")
    key = key_of(case, settings, "0.1.0", "abc")
    others = [
        key_of(case, Settings("stribeck"), "0.1.0", "abc"),
        key_of(case, settings, "0.1.0", "abd"),
        key_of(Case(case.name, dict(case.files) | {"model.yaml": b""}), settings, "0.1.0", "abc"),
    ]
    assert len({key, *others}) == 4
    save(tmp_path, {"case": "c001", "run": {"message": ""}}, key)
    assert is_done(load(tmp_path, "c001"), key) and not is_done(load(tmp_path, "c001"), others[0])
    save(tmp_path, {"case": "c001", "run": {"message": "broke"}}, key)
    assert not is_done(load(tmp_path, "c001"), key)
    (tmp_path / "c001" / "diagnosis.json").write_text("{half a ")
    assert load(tmp_path, "c001") is None
    assert sorted(p.name for p in tmp_path.iterdir()) == ["c001"]


def test_folder_of_another_run_is_refused(tmp_path: Path) -> None:
    about = {"method": "bic", "cases": {"answers": {"sha256": "0" * 64}}}
    begin(tmp_path / "bic", about)
    begin(tmp_path / "bic", about)
    with pytest.raises(InputError, match="other cases"):
        begin(tmp_path / "bic", about | {"cases": {"answers": {"sha256": "1" * 64}}})


GOOD = {
    "unknown": False,
    "effects": [{"name": "delay", "where": "joint1/input", "probability": 0.8, "selected": True}],
}


def answered(folder: Path, text: str) -> dict:
    """What is taken of a program that writes a text as its answer."""
    program = folder.parent / "theirs.py"
    program.write_text("import pathlib, sys\npathlib.Path(sys.argv[2]).write_bytes(" + repr(text.encode()) + ")\n"
                       "sys.stdout.buffer.write(b'caf\\xe9')\n")  # fmt: skip
    return external(folder, f"{sys.executable} {program} {{case}} {{answer}}")


def test_what_another_program_says_is_taken_as_it_is(tmp_path: Path) -> None:
    case = tmp_path / "c001"
    assert answered(case, json.dumps(GOOD))["verdict"] == "effects"
    assert answered(case, json.dumps({"unknown": True, "effects": []}))["verdict"] == "outside_catalogue"
    said = answered(case, json.dumps({"unknown": False, "effects": [], "gap": {"refit": 0.1}, "opened": "r"}))
    assert said["verdict"] == "no_gap" and said["gap"]["refit"] == 0.1 and "opened" not in said


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"unknown": "false"}, "unknown: "),
        ({"effects": [GOOD["effects"][0] | {"probability": float("nan")}]}, "probability: "),
        ({"effects": [GOOD["effects"][0] | {"where": "here"}]}, "where: "),
        ({"effects": [GOOD["effects"][0] | {"name": "unknown"}]}, "one that is none"),
        ({"effects": GOOD["effects"] * 2}, "names an effect twice"),
        ({"gap": {"shrink_interval": [float("-inf"), 1.0]}}, "shrink_interval"),
    ],
)  # fmt: skip
def test_answers_that_would_spoil_a_scoreboard_break_their_case_alone(
    change: dict, words: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=words):
        answered(tmp_path / "c001", json.dumps(GOOD | change))
