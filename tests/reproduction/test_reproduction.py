"""The paper in short: every stage, closed loop, table and figure comes about, and a second run takes what is kept."""

import json
from pathlib import Path

import numpy as np
import pytest
from browser import look_at
from typer.testing import CliRunner

from hybrid_id.cli.app import app
from hybrid_id.errors import InputError
from hybrid_id.reporting.provenance import program
from hybrid_id.reproduction import plan as plans
from hybrid_id.reproduction.claims import claims
from hybrid_id.reproduction.comparison import PRINTED, fit_rows, inertia_rows, parameter_rows
from hybrid_id.reproduction.plan import config_folder, read_plan, twin_settings
from hybrid_id.reproduction.result import StageResult, load, save
from hybrid_id.reproduction.run import Reproduction, reproduce
from hybrid_id.reproduction.tracking import MODELS, three_models
from hybrid_id.systems.model_file import load_model

DISTURBANCES = {"friction_drift", "torque_noise", "encoder_counts", "encoder_noise"}


def test_numbers_of_experiments_are_the_papers() -> None:
    plan = read_plan(quick=False)
    found = {
        n: len(twin_settings(s, quick=False)[0]["excitation"]["experiments"]) for n, s in plan.stages.items()
    }
    assert [found[name] for name in PRINTED] == [10, 10, 8, 9, 12]


def test_one_machine_in_all_stages() -> None:
    plan = read_plan(quick=False)
    sizes = [
        {k: v for k, v in twin_settings(s, quick=False)[0]["disturbances"].items() if k in DISTURBANCES}
        for s in plan.stages.values()
    ]
    assert all(size == sizes[0] for size in sizes)


def test_missing_settings_are_named(monkeypatch) -> None:
    monkeypatch.setattr(plans, "NAME", "nowhere.yaml")
    with pytest.raises(InputError, match=r"nowhere\.yaml is missing"):
        config_folder()


def test_a_key_that_is_not_known_is_named(tmp_path, monkeypatch) -> None:
    text = (config_folder() / plans.NAME).read_text(encoding="utf-8")
    (tmp_path / plans.NAME).write_text(text.replace("bandwidth:", "bandwith:"), encoding="utf-8")
    monkeypatch.setattr(plans, "config_folder", lambda: tmp_path)
    with pytest.raises(InputError, match=r"reproduce\.yaml: key 'tracking\.bandwith' is unknown") as raised:
        read_plan(quick=True)
    assert "\n" not in str(raised.value)


def every_row_of_every_table_is_there(quick: Reproduction, folder: Path) -> None:
    for stage, table in PRINTED.items():
        result, truth = quick.stages[stage], quick.truths[stage]
        rows = parameter_rows(stage, result, truth)
        assert [row.name for row in rows] == list(table.rows)
        assert [row.name for row in fit_rows(stage, result)] == list(table.fit_rows)
        held = {row.name for row in rows if row.role == "stage"}
        assert held == ({"P_m1", "P_m2", "f_3"} if stage == "link1_flexible" else set())
    assert len(inertia_rows(quick.stages, quick.truths)) == 3


def nine_of_ten_intervals_hold_the_truth(quick: Reproduction, folder: Path) -> None:
    rows = []
    for stage in PRINTED:
        assert not quick.stages[stage].failed, stage
        rows += parameter_rows(stage, quick.stages[stage], quick.truths[stage])
    free = [row for row in rows if row.role != "stage"]
    claimed = [row for row in free if np.isfinite(row.interval)]
    assert len(free) > 55 and len(claimed) > 40
    assert sum(row.covered for row in claimed) >= 0.9 * len(claimed), [row.name for row in claimed]


def held_values_are_the_earlier_stages(quick: Reproduction, folder: Path) -> None:
    rigid, flexible = quick.stages["link1"], quick.stages["link1_flexible"]
    found = dict(zip(rigid.names, rigid.values[rigid.selected], strict=True))
    for name in ("P_m1", "P_m2", "f_3"):
        assert flexible.held[name] == pytest.approx(found[name], rel=1e-9)
    # what scales with the motor constant inherits its uncertainty of 3 %
    inertia = flexible.names.index("J_a")
    assert flexible.held_error[inertia] > 0.02 * flexible.values[0, inertia]


def each_model_knows_more(quick: Reproduction, folder: Path) -> None:
    for case in ("one_link", "both_links"):
        errors = quick.tracking[case].rms.mean(2)
        assert (errors[1] > 3 * errors[2]).all()
    ratio = quick.tracking["backlash"].rms[1] / quick.tracking["backlash"].rms[0]
    assert (ratio < 0.5).all()
    system = load_model(folder / "link1.yaml")
    theta = three_models(system, {"J": 2e-5}, 0.25, range(4))
    names = [info.name for info in system.table]
    assert theta.shape[1] == 4 * len(MODELS)
    assert set(np.round(theta[names.index("J"), :4].numpy() / 2e-5, 6)) == {0.75, 1.25}
    assert (theta[names.index("f_12"), :8] == 0).all() and (theta[names.index("f_12"), 8:] > 0).all()


def what_is_kept_is_not_computed_again(quick: Reproduction, folder: Path) -> None:
    said = []
    again = reproduce(folder, quick=True, seeds=2, program=program(), say=said.append)
    assert all(words.endswith("kept from before") for words in said) and len(said) == 9
    assert claims(again.stages, again.truths, again.tracking) == claims(
        quick.stages, quick.truths, quick.tracking
    )


def results_of_something_else_are_not_taken(quick: Reproduction, folder: Path) -> None:
    path = folder / "stage.json"
    save(quick.stages["link1"], path, {"version": 1})
    assert load(StageResult, path, {"version": 2}) is None
    kept = load(StageResult, path, {"version": 1})
    np.testing.assert_array_equal(kept.values, quick.stages["link1"].values)
    assert kept.names == quick.stages["link1"].names
    path.write_text("{broken")
    assert load(StageResult, path, {"version": 1}) is None
    path.unlink()


def page_has_every_table_and_figure(quick: Reproduction, folder: Path) -> None:
    out = folder.with_name("out")
    out.mkdir()
    folder.rename(out / "parts")
    ended = CliRunner().invoke(app, ["reproduce", "--quick", "--out", str(out)])
    assert ended.exit_code == 0, ended.output
    page = (out / "report.html").read_text(encoding="utf-8")
    for number in range(1, 13):
        assert f"Table {number}:" in page
    for number in (3, 4, 5, 8, 9, 13, 14):
        assert f"Fig. {number}." in page
    assert page.count("data:image/png") == 8 == page.count('class="live"')
    found = json.loads((out / "result.json").read_text(encoding="utf-8"))
    assert found["quick"] and found["claims"]
    assert "all tables and figures" in ended.stdout
    look_at(out / "report.html", out.parent, figures=8)


def test_the_paper_in_short(tmp_path: Path) -> None:
    """One test, since workers of a parallel run would each walk through the paper for theirs."""
    folder = tmp_path / "parts"
    folder.mkdir()
    quick = reproduce(folder, quick=True, seeds=2, program=program(), say=lambda words: None)
    for check in (
        every_row_of_every_table_is_there, nine_of_ten_intervals_hold_the_truth, held_values_are_the_earlier_stages,
        each_model_knows_more, what_is_kept_is_not_computed_again, results_of_something_else_are_not_taken,
        page_has_every_table_and_figure,
    ):  # fmt: skip
        check(quick, folder)


def test_foreign_files_are_left_alone(tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("mine")
    ended = CliRunner().invoke(app, ["reproduce", "--quick", "--out", str(tmp_path)])
    assert isinstance(ended.exception, InputError) or ended.exit_code == 2
    assert [file.name for file in tmp_path.iterdir()] == ["thesis.txt"]
