"""Long commands that are stopped: SIGTERM does what Ctrl-C does, what is kept is said, and identify goes on."""

import os
import signal
import time
from pathlib import Path

import pytest
import soak

from hybrid_id.cli.console import FitProgress, SearchProgress
from hybrid_id.identification.result import FitResult


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
    before = result(out)
    again = run("identify", robot, "--window", "whole", "--out", out, "--resume")
    assert again.code == 0 and "holds a complete identification (result.json)" in " ".join(again.err.split())
    assert result(out) == before
    foreign = run("diagnose", robot, "--window", "whole", "--out", out, "--resume")
    assert foreign.code == 2 and "is not empty" in foreign.err


@pytest.mark.parametrize("polite", [True, False])
def test_ctrl_c_after_the_fits_keeps_the_result_without_pictures(
    run, drive: Path, tmp_path: Path, monkeypatch, polite: bool
) -> None:
    """Stopped during the statistics nothing is drawn; stopped while drawing, what is drawn is left out."""
    study, out = tmp_path / "study.yaml", tmp_path / "out"
    study.write_text(f"dataset: {drive}\noutput: {{tensorboard: false}}\n")
    with monkeypatch.context() as patch:
        if polite:
            leave = FitProgress.__exit__

            def stop(self, *given: object) -> None:
                self.stopped = True
                leave(self, *given)

            patch.setattr(FitProgress, "__exit__", stop)
        else:

            def drawing(*_: object, **__: object) -> None:
                raise KeyboardInterrupt

            patch.setattr("hybrid_id.reporting.page.how_made", drawing)
        cut = run("identify", study, "--out", out)
    said = " ".join(cut.err.split())
    assert cut.code == 130 and "stopped: the sets are complete and in result.json" in said
    assert "pictures and page are not written; " in said and "--resume goes on" in said
    assert "report.html" not in cut.out and "pictures" not in cut.out
    assert not list(out.glob("*.png")) and not (out / "report.html").exists()
    first = result(out)
    assert run("identify", study, "--out", out, "--resume").code == 0
    assert result(out) == first and (out / "report.html").exists() and list(out.glob("*.png"))
    assert not (out / "fits").exists()


def test_what_is_complete_in_spite_of_ctrl_c_is_no_failure(
    run, plain: Path, tmp_path: Path, monkeypatch
) -> None:
    leave = FitProgress.__exit__

    def stop(self, *given: object) -> None:
        self.stopped = True
        leave(self, *given)

    monkeypatch.setattr(FitProgress, "__exit__", stop)
    assert run("identify", plain, "--out", tmp_path / "out").code == 0


@pytest.mark.parametrize(("command", "noun"), [("identify", "identification"), ("diagnose", "diagnosis")])
def test_resuming_nothing_says_that_it_starts_anew(
    run, plain: Path, tmp_path: Path, monkeypatch, command: str, noun: str
) -> None:
    def stop(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(f"hybrid_id.cli.{command}.checked_records", stop)
    said = run(command, plain, "--out", tmp_path / "out", "--resume").err
    assert f"no fit is kept in {tmp_path / 'out'}, so this {noun} starts anew" in " ".join(said.split())
    assert "starts anew" not in run(command, plain, "--out", tmp_path / "out").err


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
