"""`ablate`: results, what happens to a run that is stopped, broken cells, and faults of the study file."""

import json
import math
from collections.abc import Callable, Sequence
from fnmatch import fnmatchcase
from pathlib import Path

import pytest
from browser import look_at
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from hybrid_id import __version__
from hybrid_id.config import load_config
from hybrid_id.paper.twin import read_settings
from hybrid_id.records.yaml_file import read_yaml
from hybrid_id.study.ablation import NONE, Cell, CellResult, Rung, Task
from hybrid_id.systems.model_file import describe_model

STUDY = """
dataset: {data}
hybrid: {{networks: [{{place: joint1/motor, inputs: [speed], hidden: [4]}}], price: 1.0}}
ablation: {{residual: [static, black_box], physics: [[F_v]], seeds: 3, out_of_range: [run_2]}}
"""
ERRORS = {"none": 5.0, "static": 1.5, "black box": 20.0}
ARMS, SEEDS = 5, 3


@pytest.fixture
def study(drive: Path, tmp_path: Path) -> Path:
    path = tmp_path / "study.yaml"
    path.write_text(STUDY.format(data=drive))
    return path


@pytest.fixture
def plain(study: Path) -> Path:
    """The same without pictures, events and page, which take longer than what else is tested."""
    with study.open("a") as file:
        file.write("output: {figures: false, tensorboard: false, report: false}\n")
    return study


def test_the_shipped_study_and_its_twin_are_sound() -> None:
    configs = Path(__file__).resolve().parents[2] / "configs"
    config = load_config(configs / "ablation.yaml")
    assert config.ablation is not None and config.output.folder is not None
    twin = read_settings(read_yaml(configs / "twin_ablation.yaml"))
    notes = [str(plan) for plan in twin.excitation.experiments]
    assert sum(fnmatchcase(note, p) for note in notes for p in config.ablation.out_of_range) == 2


class Cells:
    """Takes the place of the training: counts the cells, and breaks or stops at those that it is told."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.seen: list[str] = []
        self.fault: Callable[[Cell, int], BaseException | None] = lambda cell, count: None
        monkeypatch.setattr("hybrid_id.study.ablation.run_cell", self.run)

    def run(self, task: Task, cell: Cell) -> CellResult:
        self.seen.append(cell.name)
        if (fault := self.fault(cell, len(self.seen))) is not None:
            raise fault
        error = ERRORS[cell.arm.residual] * (1.0 + 0.02 * cell.seed) * (2.0 if cell.arm.without else 1.0)
        rungs = [self.rung(task, math.inf, error)]
        if cell.arm.hybrid:
            rungs = [self.rung(task, math.inf, 5.0), self.rung(task, 1.0, error)]
        history = {} if cell.arm.residual == NONE else {"loss/train": [(1, 3.0), (2, 1.0)]}
        model = describe_model(task.model(cell.arm, cell.seed))
        return CellResult(cell, tuple(rungs), min(1, len(rungs) - 1), 1.0, history, model)

    @staticmethod
    def rung(task: Task, price: float, error: float) -> Rung:
        errors = {record.name: error for record in task.dataset}
        return Rung(price, errors, errors, {"J": 2e-5}, {"J": 1e-7}, 0.1, 0.2, "converged")

    def again(self) -> Sequence[str]:
        """The cells since the last look."""
        seen, self.seen = self.seen, []
        return seen


@pytest.fixture
def cells(monkeypatch: pytest.MonkeyPatch) -> Cells:
    return Cells(monkeypatch)


def test_everything_is_written_and_said(run, study: Path, cells: Cells, tmp_path: Path) -> None:
    out = tmp_path / "out"
    shown = run("ablate", study, "--out", out)
    assert shown.code == 0, shown.err
    assert "Hybrid: static network at joint1/motor" in shown.out and "overlap" in shown.out
    result = json.loads((out / "ablation.json").read_text())
    assert result["answer"] == "hybrid" and result["program"].startswith("hybrid_id ")
    assert [arm["seeds"] for arm in result["arms"]] == [[0, 1, 2]] * ARMS
    assert result["failed"] == {}
    assert result["arms"][1]["weighted_error"]["test"] == pytest.approx([1.5, 1.53, 1.56])
    assert len(list((out / "cells").iterdir())) == ARMS * SEEDS == len(list((out / "tensorboard").iterdir()))
    for kept in (out / "cells").glob("*/cell.json"):
        assert json.loads(kept.read_text())["program"] == f"hybrid_id {__version__}"
    (folder,) = (out / "tensorboard").glob("static-*wide-seed-1")
    events = EventAccumulator(str(folder)).Reload()
    assert {"loss/train", "final/test", "final/out_of_range", "final/share"} <= set(events.Tags()["scalars"])
    again = run("ablate", out / "config.yaml", "--out", out, "--json")
    assert again.code == 0 and json.loads(again.out) == result
    assert len(cells.seen) == ARMS * SEEDS
    look_at(out / "report.html", tmp_path, figures=2)


def test_a_run_that_is_stopped_goes_on_where_it_was(run, plain: Path, cells: Cells, tmp_path: Path) -> None:
    out = tmp_path / "out"
    cells.fault = lambda cell, count: KeyboardInterrupt() if count == 5 else None
    stopped = run("ablate", plain, "--out", out)
    assert stopped.code == 130 and f"4 of {ARMS * SEEDS} cells are kept" in stopped.err
    assert not (out / "ablation.json").exists()
    first, cells.fault = cells.again()[:4], lambda cell, count: None
    (out / "cells" / ".killed").mkdir()  # what a run that was killed while it wrote leaves
    assert run("ablate", plain, "--out", out).code == 0
    rest = cells.again()
    assert len(rest) == ARMS * SEEDS - 4 and not set(first) & set(rest)
    assert run("ablate", plain, "--out", out).code == 0 and cells.again() == []


def test_a_broken_cell_is_told_and_tried_again(run, study: Path, cells: Cells, tmp_path: Path) -> None:
    out = tmp_path / "out"
    cells.fault = lambda cell, count: ValueError("no luck") if count == 2 else None
    shown = run("ablate", study, "--out", out)
    assert shown.code == 1 and "1 of 15 cells broke" in shown.err
    (name,) = json.loads((out / "ablation.json").read_text())["failed"]
    assert not (out / "cells" / name).exists() and "ValueError: no luck" in shown.out
    cells.again()
    assert run("ablate", study, "--out", out).code == 0 and cells.again() == [name]
    cells.fault = lambda cell, count: ValueError("no luck") if cell.arm.residual == NONE else None
    none = run("ablate", study, "--out", tmp_path / "none")
    assert none.code == 2 and "no fit of physics only" in none.err and "ValueError: no luck" in none.err


FAULTS = {
    "unknown residual": ("[static, black_box]", "[statik]", ("ablation.residual", "statik")),
    "no repeat": ("seeds: 3", "seeds: 0", ("key 'ablation.seeds': give from 1", "found 0")),
    "seed twice": ("seeds: 3", "seeds: [0, 0]", ("'ablation.seeds'", "0 is given twice")),
    "pattern of nothing": ("[run_2]", "[run_7]", ("'run_7'", "key 'ablation.out_of_range'", "run_0")),
    "no such physics": ("[[F_v]]", "[[F_v], [F_x]]", ("key 'ablation.physics[1]'", "'F_x' (did you mean 'F_")),
    "no such component": ("[[F_v]]", "[[joint1/motor/dahl]]", ("key 'ablation.physics[0]'", "dahl", "joint1/motor")),
    "place of the first network": ("place: joint1", "place: joint2", ("'hybrid.networks[0].place'", "did you mean")),
    "no such input": ("[speed]", "[sped]", ("'hybrid.networks[0].inputs'", "'sped' (did you mean 'speed'?)")),
    "long windows": ("price:", "windows: [[2.0, 1]], price:", ("key 'hybrid.windows': windows of 2 s are too long",)),
    "too few records": ("[run_2]", "[run_2, run_1, run_0]", ("too few records",)),
}  # fmt: skip


@pytest.mark.parametrize("name", FAULTS)
def test_faults_are_told_before_any_training(
    name: str, run, study: Path, cells: Cells, tmp_path: Path
) -> None:
    old, new, words = FAULTS[name]
    assert old in study.read_text()
    study.write_text(study.read_text().replace(old, new))
    shown = run("ablate", study, "--out", tmp_path / "out")
    assert shown.code == 2 and not cells.seen and not (tmp_path / "out").exists()
    lines = [line for line in shown.err.splitlines() if not line.startswith("warning: ")]
    assert len(lines) == 1 and lines[0].startswith("Error: ") and all(word in lines[0] for word in words)
    assert "more)" not in lines[0]


def test_options_and_folders_that_do_not_fit(run, study: Path, cells: Cells, tmp_path: Path) -> None:
    out = tmp_path / "out"
    alone = ("--scheduler", "tcp://127.0.0.1:9")
    for extra, words in (
        (("--backend", "dask"), "--scheduler"),
        (alone, "--backend"),
        (("--jobs", "0"), "jobs"),
    ):
        told = run("ablate", study, "--out", out, *extra)
        assert told.code == 2 and words in told.err and "No such option" not in told.err
    out.mkdir()
    (out / "thesis.txt").write_text("mine")
    shown = run("ablate", study, "--out", out)
    assert shown.code == 2 and "not empty" in shown.err and not cells.seen
    assert "--force" not in shown.err  # which this command does not have
    (out / "thesis.txt").unlink()
    assert run("ablate", study, "--out", out).code == 0
    found = json.loads((out / "ablation.json").read_text())
    (out / "ablation.json").write_text(json.dumps(found | {"dataset": "another"}))
    other = run("ablate", study, "--out", out)
    assert other.code == 2 and "the ablation of another dataset, 'another'" in other.err


def test_what_the_records_are_too_short_for_is_said(run, plain: Path, cells: Cells, tmp_path: Path) -> None:
    text = plain.read_text().replace("price: 1.0", "price: 1.0, windows: [[0.1, 4], [0.4, 2]]")
    plain.write_text(text.replace("seeds: 3", "seeds: 3, horizon: 0.5"))
    shown = run("ablate", plain, "--out", tmp_path / "out")
    assert shown.code == 0 and shown.err.count("windows of 0.4 s ('hybrid.windows')") == 1
    assert "no short free runs of 0.5 s ('ablation.horizon')" in shown.err


def test_tensorboard_shows_the_plan_of_today(run, study: Path, cells: Cells, tmp_path: Path) -> None:
    out, text = tmp_path / "out", study.read_text().replace("seeds: 3", "seeds: 3, width: [8]")
    study.write_text(text)
    run("ablate", study, "--out", out)
    (out / "tensorboard" / "mine").mkdir()
    study.write_text(text.replace("[8]", "[4]"))
    shown = run("ablate", study, "--out", out)
    assert shown.code == 0 and "6 cells of an earlier plan stay in" in shown.err
    runs = {path.name for path in (out / "tensorboard").iterdir()}
    assert "mine" in runs and len(runs) == ARMS * SEEDS + 1 and not any("8-wide" in name for name in runs)
    cells.again()
    study.write_text(text)
    assert run("ablate", study, "--out", out).code == 0 and cells.again() == []
    assert len([p for p in (out / "tensorboard").iterdir() if "8-wide" in p.name]) == 6
