"""Long commands that are stopped: SIGTERM does what Ctrl-C does, what is kept is said, and identify goes on."""

import os
import signal
import time
from pathlib import Path

import pytest
import soak

from hybrid_id.cli import console
from hybrid_id.cli.console import FitProgress, SearchProgress, terminated_as_interrupted
from hybrid_id.identification.result import FitResult


def test_terminated_is_interrupted() -> None:
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(KeyboardInterrupt), terminated_as_interrupted():
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(1.0)
    assert signal.getsignal(signal.SIGTERM) is before


def test_terminated_ends_a_fit_as_politely_as_ctrl_c(capsys: pytest.CaptureFixture[str]) -> None:
    with terminated_as_interrupted(), FitProgress(2, 60) as progress:
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(0.01)
        assert progress("records", 2, None, [0, 1]) is True
    assert "stopping after this iteration" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["identify", "diagnose", "train", "ablate", "simulate", "demo"])
def test_every_command_takes_sigterm(run, plain: Path, tmp_path: Path, monkeypatch, command: str) -> None:
    def terminated(*_: object, **__: object) -> None:
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(1.0)

    for module in ("identify", "diagnose", "train", "ablate"):
        monkeypatch.setattr(f"hybrid_id.cli.{module}.checked_records", terminated)
    monkeypatch.setattr("hybrid_id.cli.replay.records_to_replay", terminated)
    monkeypatch.setattr("hybrid_id.cli.demo.refuse_taken", terminated)
    source = () if command == "demo" else (plain if command != "simulate" else plain.parent,)
    outcome = run(command, *source, "--out", tmp_path / "out")
    assert outcome.code == 130 and outcome.err.splitlines()[-1].startswith("Error: stopped")
    assert not (tmp_path / "out").exists()


def stop_after(fits: int, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Stop identify after so many fits; returns the list of records whose fit begins."""
    begun: list[str] = []
    from hybrid_id.identification import fit as module

    real = module.fit

    def counted(system, batch, *, progress=None, **settings) -> list[FitResult]:
        begun.append(batch.names[0])
        return real(system, batch, progress=progress, **settings)

    def call(progress: FitProgress, *_: object) -> bool:
        progress.stopped = progress.cut = len(begun) > fits
        return progress.stopped

    monkeypatch.setattr(module, "fit", counted)
    monkeypatch.setattr(FitProgress, "__call__", call)
    return begun


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Study file of three records of a robot's joint, each of which is fitted by itself."""
    folder = tmp_path_factory.mktemp("robot") / "data"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(soak, "SAMPLES", 150)
        patch.setattr(soak, "SETS", 3)
        patch.setattr(soak, "LONG", 1)
        soak.identification(folder)
    return folder / "study.yaml"


def result(out: Path) -> bytes:
    return (out / "result.json").read_bytes()


def test_identify_goes_on_with_the_sets_that_were_complete(
    run, robot: Path, tmp_path: Path, monkeypatch
) -> None:
    assert run("identify", robot, "--window", "whole", "--out", tmp_path / "whole").code == 0
    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        stop_after(2, patch)
        cut = run("identify", robot, "--window", "whole", "--out", out)
    assert cut.code == 130 and "2 fits are kept, and the same command with --resume goes on" in cut.err
    assert len(list(out.glob("fits/*.npz"))) == 2 and result(out) != result(tmp_path / "whole")
    refused = run("identify", robot, "--window", "whole", "--out", out)
    assert refused.code == 2 and "holds an unfinished identification; --resume goes on" in refused.err
    assert (
        "unfinished identification"
        in run("diagnose", robot, "--window", "whole", "--out", out, "--resume").err
    )
    with monkeypatch.context() as patch:
        begun = stop_after(1000, patch)
        assert run("identify", robot, "--window", "whole", "--out", out, "--resume").code == 0
    assert begun == ["run_2"]
    assert result(out) == result(tmp_path / "whole") and not (out / "fits").exists()
    assert "nothing to resume" in run("identify", robot, "--window", "whole", "--out", out, "--resume").err


def test_other_settings_and_records_are_fitted_anew(run, robot: Path, tmp_path: Path, monkeypatch) -> None:
    """A different input or option never reuses a fit: all of its own are made, and the answer is that of a new run."""
    cut = tmp_path / "cut"
    with monkeypatch.context() as patch:
        stop_after(2, patch)
        assert run("identify", robot, "--window", "whole", "--out", cut).code == 130
    assert (
        run("identify", robot, "--window", "whole", "--loss", "huber", "--out", tmp_path / "huber").code == 0
    )
    with monkeypatch.context() as patch:
        begun = stop_after(1000, patch)
        assert (
            run("identify", robot, "--window", "whole", "--loss", "huber", "--out", cut, "--resume").code == 0
        )
    assert begun == ["run_0", "run_1", "run_2"]
    assert result(cut) == result(tmp_path / "huber")


def test_a_long_search_says_how_long(capsys: pytest.CaptureFixture[str]) -> None:
    """Ten fits of 1 s each out of 90: 2 × 90 s for one effect, 4 × 3 × 90 s for three."""
    now = 7.0
    with SearchProgress(3, clock=lambda: now) as progress:
        progress("nominal model", 0, 1)
        for stage in ("effect 1", "effect 2"):
            for done in range(1, 91):
                progress(stage, done, 90)
                now += 1.0
    said = " ".join(capsys.readouterr().err.split())
    assert said.count("the search will take") == 1
    assert "about 3 min if one effect explains the gap, and up to about 18 min if it goes on to 3" in said


def test_a_short_search_says_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with SearchProgress(3, clock=lambda: 0.0) as progress:
        for done in range(1, 91):
            progress("effect 1", done, 90)
    assert "will take" not in capsys.readouterr().err


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.2, "1 s"), (40.0, "40 s"), (90.0, "1.5 min"), (1080.0, "18 min"), (9000.0, "2.5 h")],
)
def test_a_time_is_said_roughly(seconds: float, words: str) -> None:
    assert console._rough(seconds) == words
