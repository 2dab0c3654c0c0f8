"""`blind make | run | score` from the command line: sealed, resumed, refused and scored."""

import json
import re
import shutil
import sys
from pathlib import Path

import pytest
from gapcase import only, small_case
from typer.testing import CliRunner

from hybrid_id.baselines.run import read_case
from hybrid_id.cli.app import app
from hybrid_id.cli.folder import sole_writer
from hybrid_id.components import ConstantTorque
from hybrid_id.machines import arm, draw_arm
from hybrid_id.machines import experiments as plans
from hybrid_id.machines import make as making
from hybrid_id.machines import seal as sealing
from hybrid_id.machines.seal import seal
from hybrid_id.records.yaml_file import write_yaml
from hybrid_id.systems.model_file import save_model

ORACLE = {"nominal": 0.3, "refit": 0.1, "with_effect": 0.01, "noise_floor": 0.01}
BIAS = {
    "name": "constant_torque", "where": "joint1/load", "accept": ["constant_torque"], "accept_where": ["joint1/load"],
}  # fmt: skip
ABOUT = {"seed": 5, "commit": "0" * 40, "asked": 3, "options": {"system": "one_link", "family": None}}


def call(*words: object, fails: str = "") -> str:
    """Output of a command; where it shall be refused, the sentence matches and the exit code is 2."""
    result = CliRunner().invoke(app, ["blind", *map(str, words)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    if fails:
        assert result.exit_code == 2 and re.search(fails, result.output), result.output
    return result.output


@pytest.fixture
def home(sealed_once: Path, tmp_path: Path) -> Path:
    """Three sealed cases of a test's own."""
    return shutil.copytree(sealed_once, tmp_path, dirs_exist_ok=True)


@pytest.fixture(scope="module")
def sealed_once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three sealed cases: a bias that is withheld, nothing, and a broken one."""
    home = tmp_path_factory.mktemp("sealed")
    cases = home / "cases"
    for name, missing in (("c001", ConstantTorque(T_0=0.15)), ("c002", None), ("c003", None)):
        dataset, system = small_case(missing)
        place = dataset.save(cases / name)
        save_model(system, place / "model.yaml")
        truth = {"family": "single" if missing else "none", "effects": [BIAS] if missing else []}
        write_yaml(cases / "answers" / f"{name}.yaml", truth | {"level": "strong", "oracle": ORACLE})
    (cases / "c003" / "model.yaml").write_text("system: one_leg\n")
    seal(cases, home / "sealed" / "a.tar", ABOUT)
    return home


def test_run_is_scored(home: Path) -> None:
    cases, runs, archive = home / "cases", home / "runs", home / "sealed" / "a.tar"
    with only("constant_torque", "stribeck_friction"):
        said = call("run", cases, "--out", runs, "--method", "stribeck", "--method", "bic")
    assert "c003, InputError" in said and "1 of 3 cases broke" in said
    before = (runs / "bic" / "c001" / "diagnosis.json").stat().st_mtime_ns
    assert "2 of 3 cases are kept from before" in call("run", cases, "--out", runs, "--method", "bic")
    assert (runs / "bic" / "c001" / "diagnosis.json").stat().st_mtime_ns == before
    told = call("score", runs, "--answers", archive)
    assert "hybrid-id blind make --out cases --seed 5 --cases 3 --first 1 --system one_link\n" in told
    content = json.loads((runs / "scores.json").read_text())
    assert content["about"]["scored"] == 3 and list(content["methods"]) == ["bic", "stribeck"]
    stribeck = content["methods"]["stribeck"]["scores"]["all"]
    assert stribeck["top_1"]["value"] == 0 and stribeck["false_alarms"]["value"] == 1
    assert stribeck["broken"]["wrong"] == ["c003"]
    text = (runs / "scoreboard.md").read_text()
    assert text.startswith("# 2") and text.count(", seed 5\n") == 1


def test_answers_within_reach_and_other_answers_are_refused(home: Path) -> None:
    cases, runs, archive = home / "cases", home / "runs", home / "sealed" / "a.tar"
    (home / "answers").mkdir()
    call("run", cases, "--out", runs, fails="answers can be read by the run")
    (home / "answers").rmdir()
    call("run", cases, "--out", runs, "--method", "stribeck")
    archive.write_bytes(archive.read_bytes() + b"x")
    call("score", runs, "--answers", archive, fails="not the archive that was sealed")


def test_cases_that_were_changed_after_they_were_sealed_are_refused(home: Path) -> None:
    cases = home / "cases"
    manifest = json.loads((cases / "manifest.json").read_text())
    manifest["digests"] = {name: read_case(cases / name).digest for name in manifest["names"]}
    (cases / "manifest.json").write_text(json.dumps(manifest))
    call("run", cases, "--out", home / "runs", "--method", "stribeck")
    (cases / "c002" / "notes.txt").write_text("a hint")
    call("run", cases, "--out", home / "runs", "--method", "bic", fails="c002 does not hold the files")


def test_an_unfinished_run_is_not_scored(home: Path) -> None:
    cases, runs, archive = home / "cases", home / "runs", home / "sealed" / "a.tar"
    (runs / "stribeck" / ".half").mkdir(
        parents=True
    )  # of a run that was killed before it wrote its first line
    call("run", cases, "--out", runs, "--method", "stribeck")
    (runs / "stribeck" / "c002" / "diagnosis.json").unlink()
    call("score", runs, "--answers", archive, fails="lacks 1 of 3 cases")


def test_parts_are_scored_together(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plans, "LENGTHS", (700, 900))
    wish = ["--cases", 1, "--family", "none", "--system", "one_link", "--seed", 4]
    parts, archives = [], []
    for first in (1, 2):
        made, sealed = home / f"part{first}" / "cases", home / f"sealed{first}" / "a.tar"
        call("make", "--out", made, "--answers", sealed, "--first", first, *wish)
        assert [p.name for p in made.glob("c*")] == [f"c{first:03d}"]
        call("run", made, "--out", home / f"runs{first}", "--method", "stribeck")
        parts, archives = [*parts, home / f"runs{first}"], [*archives, "--answers", sealed]
    told = call("score", *parts, *archives)
    assert "2 of 2 cases scored" in told
    assert "--seed 4 --cases 2" in told
    call("score", *reversed(parts), *archives[2:], *archives[:2], fails="does not begin with case 1")
    call("score", *parts, *archives[:2], fails="2 folders of runs but 1 archives")


def test_an_arm_is_made_diagnosed_joint_by_joint_and_scored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("mujoco")
    monkeypatch.setattr(arm, "JOINTS", (2, 2))
    monkeypatch.setattr(arm, "SERVOS", 1.0)
    monkeypatch.setattr(draw_arm, "LENGTH", 1.5)
    cases, runs, archive = tmp_path / "a" / "cases", tmp_path / "runs", tmp_path / "sealed" / "a.tar"
    wish = ("--realism", "arms", "--seed", 27207, "--cases", 1, "--effect", "encoder_zero")
    call("make", "--out", cases, "--answers", archive, *wish)
    assert "arm.xml" in {p.name for p in (cases / "c001").iterdir()}
    with only("encoder_zero", "quadratic_drag"):
        call("run", cases, "--out", runs)
    said = json.loads((runs / "diagnose" / "c001" / "diagnosis.json").read_text())
    assert set(said["joints"]) == {"j1", "j2"} and "unknown_location" in said
    told = call("score", runs, "--answers", archive)
    assert "--realism arms" in told and "| joint of the dominant effect | ≥ 90 % | 100 %" in told
    scores = json.loads((runs / "scores.json").read_text())["methods"]["diagnose"]["scores"]["all"]
    for name in ("joint", "place", "top_1", "tied"):
        assert scores[name]["value"] == 1.0, name
    assert scores["processor"]["value"] > 0


def test_wrong_input_is_refused(home: Path, tmp_path: Path) -> None:
    cases, archive = home / "cases", home / "sealed" / "a.tar"
    call("run", home / "nothing", "--out", home / "runs", fails=r"has no manifest\.json")
    call("run", cases, "--out", cases, fails="holds files that are no runs")
    call("run", cases, "--out", home / "runs", "--backend", "dask", fails="belong together")
    call("score", home / "cases", "--answers", archive, fails="holds no run")
    call("make", "--out", tmp_path / "x", "--seed", "five", fails="neither a number nor 'commit'")
    call("make", "--out", tmp_path / "x", "--open-answers", "--answers", archive, fails="contradict")
    call("make", "--out", tmp_path / "x", "--answers", archive, fails="exists already")
    inside = tmp_path / "x" / "answers.tar"
    call("make", "--out", tmp_path / "x", "--answers", inside, fails="in the folder of the cases")
    call("make", "--out", tmp_path / "x", "--family", "none", "--effect", "backlash", fails="nothing at work")
    (tmp_path / "y").mkdir()
    with sole_writer(tmp_path / "y"):  # another run is at it
        call("make", "--out", tmp_path / "y", "--cases", 1, fails="another run is writing")
    busy = home / "runs" / "stribeck"
    busy.mkdir(parents=True)
    (busy / "run.json").write_text("{}")
    with sole_writer(busy):
        call("run", cases, "--out", home / "runs", "--method", "stribeck", fails="another run is writing")
    call("make", "--nope", fails="see 'hybrid-id blind make --help'")


def test_another_program_takes_part(home: Path) -> None:
    cases, runs, archive = home / "cases", home / "runs", home / "sealed" / "a.tar"
    program = home / "theirs.py"
    program.write_text(
        "import json, pathlib, sys\n"
        "case, answer = map(pathlib.Path, sys.argv[1:])\n"
        "assert {p.name for p in case.parent.iterdir()} == {'c001'}, 'something lies beside'\n"
        "assert (case / 'model.yaml').exists()\n"
        "one = {'name': 'constant_torque', 'where': 'joint1/load', 'probability': 0.8, 'selected': True}\n"
        "answer.write_text(json.dumps({'effects': [one], 'unknown': False}))\n"
    )
    theirs = ("run", cases, "--out", runs, "--method", "external")
    command = ("--command", f"{sys.executable} {program} {{case}} {{answer}}")
    said = call(*theirs, *command)
    assert "external 1 of 3: c001, effects" in said and "something lies beside" in said
    call("score", runs, "--answers", archive)
    scores = json.loads((runs / "scores.json").read_text())["methods"]["external"]["scores"]["all"]
    assert (scores["top_1"]["value"], scores["top_1"]["n"]) == (1.0, 1)
    call(*theirs, fails="belong together")
    assert "2 of 3 cases broke" in call(*theirs, *command)
    program.write_text("# another version\n" + program.read_text())
    assert "kept from before" not in call(*theirs, *command)
    call(*theirs, "--command", "theirs {case} {answer}", fails="theirs is not a program")
    call(*theirs, "--command", "theirs", fails="needs --command with")


def test_making_goes_on_where_it_was_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plans, "LENGTHS", (700, 900))
    wish = ["--out", tmp_path / "a", "--cases", 2, "--family", "none", "--system", "one_link", "--seed", 4]
    attempt = making._attempt

    def stopped(seed: int, *more: object) -> Path | None:
        if seed == 5:
            raise KeyboardInterrupt
        return attempt(seed, *more)  # type: ignore[arg-type]

    monkeypatch.setattr(making, "_attempt", stopped)
    assert "the same command goes on" in call("make", *wish)
    monkeypatch.setattr(making, "_attempt", attempt)
    first = (tmp_path / "a" / "c001" / "dataset.yaml").stat().st_mtime_ns
    call("make", *wish[:-1], 9, fails="unfinished cases of another seed")
    write = sealing.write_whole

    def killed(path: Path, content: bytes) -> None:
        if path.name == "manifest.json":
            raise KeyboardInterrupt
        write(path, content)

    monkeypatch.setattr(sealing, "write_whole", killed)
    call("make", *wish)
    assert (tmp_path / "sealed" / "a.answers.tar").exists()
    monkeypatch.setattr(sealing, "write_whole", write)
    call("make", *wish)
    assert (tmp_path / "a" / "c001" / "dataset.yaml").stat().st_mtime_ns == first
    assert sorted(p.name for p in (tmp_path / "a").iterdir()) == ["c001", "c002", "manifest.json"]
