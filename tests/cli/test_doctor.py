"""`doctor`, completion, and `--json` on every command that prints a table."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import whole
from PIL import Image

from hybrid_id import __version__
from hybrid_id.cli import doctor as module
from hybrid_id.systems import one_link


def test_doctor_tells_the_machine_and_passes_its_self_test(run) -> None:
    done = run("doctor", "--json")
    assert done.code == 0, done.err
    told = json.loads(done.out)
    assert told["machine"]["hybrid_id"] == __version__
    assert told["packages"]["torch"]
    assert told["self_test"]["passed"] and len(told["self_test"]["parameters"]) == 12


def test_doctor_fails_aloud(run, monkeypatch: pytest.MonkeyPatch) -> None:
    failed = {"passed": False, "off": ["J"], "fit_percent": 12.0, "seconds": 1.0, "parameters": {"J": {}}}
    monkeypatch.setattr("hybrid_id.paper.demo.self_test", lambda: failed)
    monkeypatch.setattr(module, "version", lambda name: "9.9")
    done = run("doctor")
    assert done.code == 1
    assert "self-test FAILED (J off)" in done.out


def test_doctor_compiles_ahead(run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("hybrid_id.simulation.c_code.AHEAD", tmp_path / "share/hybrid_id")
    monkeypatch.setattr("hybrid_id.study.ahead.shipped", lambda: [one_link()])
    monkeypatch.setattr("hybrid_id.paper.demo.self_test", lambda: {"passed": True, "error": "not run"})
    done = run("doctor", "--ahead")
    assert done.code == 0 and "compiled ahead: 1 system" in done.err
    kept = list((tmp_path / "share/hybrid_id").glob("*.so"))
    assert len(kept) >= 3  # the engine, a rollout and a fit; another test may have loaded what condenses


def test_doctor_says_what_kept_the_self_test_from_its_end(run, monkeypatch: pytest.MonkeyPatch) -> None:
    def missing() -> None:
        raise ModuleNotFoundError("No module named 'pandas'")

    monkeypatch.setattr("hybrid_id.paper.demo.self_test", missing)
    done = run("doctor")
    assert done.code == 1
    assert (
        "self-test FAILED: ModuleNotFoundError: No module named 'pandas'" in done.out and "torch" in done.out
    )
    assert json.loads(run("doctor", "--json").out)["self_test"]["passed"] is False


def test_completion_knows_commands_and_choices(run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("_HYBRID_ID_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", "hybrid-id di")
    monkeypatch.setenv("COMP_CWORD", "1")
    assert run().out.split() == ["diagnose"]


def test_every_command_that_prints_results_has_json() -> None:
    commands = whole().commands
    without = [
        name
        for name, command in commands.items()
        if not any("--json" in parameter.opts for parameter in command.params)
    ]
    assert without == ["schema", "blind"]  # the one prints JSON alone, the other has commands of its own


def test_the_list_of_commands_loads_no_torch() -> None:
    code = (
        "import sys\nfrom hybrid_id.cli.app import app\ntry: app(['--help'])\nexcept SystemExit: pass\n"
        "print(*[m for m in ('pandas', 'torch') if m in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "diagnose" in done.stdout and not done.stderr.strip()


@pytest.mark.parametrize("command", ["components", "effects"])
def test_lists_as_json(run, command: str) -> None:
    told = json.loads(run(command, "--json").out)
    assert told["program"] == f"hybrid_id {__version__}"
    assert len(told[command]) > 20


def test_excite_as_json(run, tmp_path: Path) -> None:
    options = ("--duration", 2, "--tones", 4, "--band", 1, 6, "--starts", 2, "--json")
    told = json.loads(run("excite", "--out", tmp_path / "wave.csv", *options).out)
    assert 1.0 < told["crest_factor"] < 1.6


def test_version_is_in_every_kind_of_file(run, drive: Path, tmp_path: Path) -> None:
    assert run("simulate", drive, "--out", tmp_path / "replay").code == 0
    assert (drive / "model.yaml").read_text().startswith(f"# hybrid_id {__version__}\n")
    picture = next((tmp_path / "replay").glob("*.png"))
    with Image.open(picture) as image:
        assert image.info["Software"] == f"hybrid_id {__version__}"
    assert (
        json.loads((tmp_path / "replay" / "result.json").read_text())["program"] == f"hybrid_id {__version__}"
    )
