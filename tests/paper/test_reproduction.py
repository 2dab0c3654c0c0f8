"""The paper in short: every stage, closed loop, table and figure comes about, and a second run takes what is kept."""

import json
from pathlib import Path

import numpy as np
import pytest
from browser import look_at
from paper.twins import config
from typer.testing import CliRunner

from hybrid_id.cli.app import app
from hybrid_id.errors import InputError
from hybrid_id.paper import stages
from hybrid_id.paper.comparison import PRINTED, parameter_table
from hybrid_id.paper.run import reproduce
from hybrid_id.paper.tracking import MODELS, three_models
from hybrid_id.paper.twin import model_description
from hybrid_id.reporting.provenance import program
from hybrid_id.systems.model_file import ModelFile, build_model


def test_campaign_is_the_papers_on_one_machine() -> None:
    plan = stages.read_plan(quick=False)["stages"]
    twins = [stages.twin_settings(plan[name], quick=False)[0] for name in PRINTED]
    assert [len(twin["excitation"]["experiments"]) for twin in twins] == [10, 10, 8, 9, 12]
    for size in ("friction_drift", "torque_noise", "encoder_counts", "encoder_noise"):
        assert len({twin["disturbances"][size] for twin in twins}) == 1
    experiments = [experiment for twin in twins for experiment in twin["excitation"]["experiments"]]
    sines = [e[u] for e in experiments for u in ("u1", "u2") if u in e] + [
        e for e in experiments if "peak" in e
    ]
    assert max(one["peak"] for one in sines) <= 24, "the supply"


def test_missing_settings_are_named(monkeypatch) -> None:
    monkeypatch.setattr(stages, "PLAN", "nowhere.yaml")
    with pytest.raises(InputError, match=r"nowhere\.yaml is missing"):
        stages.config_folder()


def test_three_models_know_more_and_more() -> None:
    system = build_model(ModelFile.model_validate(model_description(config("link1"), 0)))
    theta = three_models(system, {"J": 2e-5}, 0.25, range(4)).numpy()
    names = [info.name for info in system.table]
    assert theta.shape[1] == 4 * len(MODELS)
    assert set(np.round(theta[names.index("J"), :4] / 2e-5, 6)) == {0.75, 1.25}
    assert (theta[names.index("f_12"), :8] == 0).all() and (theta[names.index("f_12"), 8:] > 0).all()


def test_the_paper_in_short(tmp_path: Path) -> None:
    """One test, since workers of a parallel run would each walk through the paper for theirs."""
    folder = tmp_path / "out" / "parts"
    folder.mkdir(parents=True)
    quick = reproduce(folder, quick=True, seeds=2, program=program(), say=lambda words: None)

    # every row of every table is there, and nine of ten intervals that are claimed hold the truth
    claimed = covered = 0
    for stage, table in PRINTED.items():
        assert not quick.stages[stage].failed, stage
        rows = parameter_table(stage, quick.stages[stage])
        assert list(rows.index) == list(table.parameters)
        claimed, covered = claimed + rows.claimed.sum(), covered + rows.covered.sum()
    assert claimed > 40 and covered >= 0.9 * claimed
    # what scales with the motor constant inherits its uncertainty of 3 %
    flexible = quick.stages["link1_flexible"]
    inertia = flexible.names.index("J_a")
    assert flexible.held_error[inertia] > 0.02 * flexible.values[0, inertia]

    # what is kept is not computed again, what is broken or of another program is
    said: list[str] = []
    again = reproduce(folder, quick=True, seeds=2, program=program(), say=said.append)
    assert all(words.endswith("kept from before") for words in said) and len(said) == 9
    assert again.claims == quick.claims
    (folder / "tracking_one_link.json").write_text("{broken")
    said.clear()
    reproduce(folder, quick=True, seeds=2, program=program(), say=said.append)
    assert [words for words in said if not words.endswith("kept from before")] == [
        "tracking, one link: 2 seeds"
    ]
    with pytest.raises(KeyboardInterrupt):
        reproduce(folder, quick=True, seeds=2, program="another", say=_stop)

    # the page has every table and figure
    out = folder.parent
    ended = CliRunner().invoke(app, ["reproduce", "--quick", "--out", str(out)])
    assert ended.exit_code == 0, ended.output
    page = (out / "report.html").read_text(encoding="utf-8")
    assert all(f"Table {number}:" in page for number in range(1, 13))
    assert all(f"Fig. {number}." in page for number in (3, 4, 5, 8, 9, 13, 14))
    assert page.count("data:image/png") == 7
    found = json.loads((out / "result.json").read_text(encoding="utf-8"))
    assert found["quick"] and found["claims"] == [vars(claim) for claim in quick.claims]
    assert "all tables and figures" in ended.stdout
    look_at(out / "report.html", tmp_path, figures=7)


def _stop(words: str) -> None:
    if not words.endswith("kept from before"):
        raise KeyboardInterrupt


def test_ctrl_c_says_how_it_goes_on(tmp_path: Path, monkeypatch) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("hybrid_id.paper.run.run_stage", interrupted)
    ended = CliRunner().invoke(app, ["reproduce", "--quick", "--out", str(tmp_path)])
    assert ended.exit_code == 130 and "the same command goes on from there" in ended.stderr


def test_foreign_files_are_left_alone(tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("mine")
    ended = CliRunner().invoke(app, ["reproduce", "--quick", "--out", str(tmp_path)])
    assert isinstance(ended.exception, InputError) or ended.exit_code == 2
    assert [file.name for file in tmp_path.iterdir()] == ["thesis.txt"]
