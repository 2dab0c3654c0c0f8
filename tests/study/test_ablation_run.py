"""Cells in turn, in processes and on a real Dask cluster; broken ones; what is kept and taken up again."""

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from drives import make_records, multisine, rigid_drive
from servo_arm import described

from hybrid_id.components import REGISTRY
from hybrid_id.errors import InputError
from hybrid_id.identification.hybrid import HybridOptions
from hybrid_id.identification.keep import fingerprint
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.files import plain
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.solvers import OdeEngine
from hybrid_id.simulation.step import Engine
from hybrid_id.study.ablation import (
    CellResult,
    Task,
    from_plain,
    key_of,
    load_cell,
    run_cells,
    save_cell,
)
from hybrid_id.study.ablation_plan import BLACK_BOX, Arm, Cell
from hybrid_id.systems import two_link
from hybrid_id.systems.model_file import load_model

STATIC = Arm("static", ("joint1/motor",), 3)
BROKEN = Cell(Arm("static", ("joint9/motor",), 3), 0)
CELLS = [Cell(Arm(), 0), BROKEN, Cell(Arm(), 1)]


@pytest.fixture(scope="module")
def task() -> Task:
    """Five short records of a drive; one of them out of range."""
    drive, engine = rigid_drive(ratio=20.0), Engine("smooth", 4, width=2.0)
    voltages = [
        multisine(k, samples=104, rest=8, amplitude=2.5 + 2.0 * (k == 4), step=0.004) for k in range(5)
    ]
    records = make_records(drive, voltages, noise={"q_m1": 0.02}, engine=engine, step=0.004)
    data = Dataset("drive", (Channel("u1", "V"),), (Channel("q_m1", "rad", 0.02),), tuple(records), 0.004)
    model = drive.with_values({"J": 2.3e-5})
    model = model.with_specs(
        {n: replace(model.parameter(n).spec, estimate=False) for n in ("P_m1", "P_m2", "F_v")}
    )
    options = HybridOptions(windows=(), max_iterations=2)
    return Task(
        data, model, OdeEngine(fine=4, width=2.0), options, ("speed",), beyond=("run_4",), horizon=0.03
    )


def outcome(results: Sequence[CellResult]) -> dict[str, tuple[str, dict[str, float]]]:
    """Status and errors by name of the cell."""
    return {r.cell.name: (r.status, dict(r.best.errors) if r.rungs else {}) for r in results}


@pytest.fixture(scope="module")
def in_turn(task: Task) -> list[CellResult]:
    return list(run_cells(task, CELLS))


def test_a_broken_cell_says_why_and_loses_no_other(in_turn: list[CellResult]) -> None:
    assert [r.status for r in in_turn] == ["done", "failed", "done"]
    assert in_turn[1].message.startswith("InputError: Place 'joint9/motor' is not known")


def test_processes_come_to_the_same(task: Task, in_turn: list[CellResult]) -> None:
    assert outcome(list(run_cells(task, CELLS, jobs=2))) == outcome(in_turn)


def test_a_dask_cluster_comes_to_the_same(task: Task, in_turn: list[CellResult]) -> None:
    distributed = pytest.importorskip("distributed", reason="needs distributed (hybrid-id[dask])")
    settings = {"n_workers": 2, "threads_per_worker": 1, "processes": True, "dashboard_address": None}
    with distributed.LocalCluster(**settings) as cluster:
        assert outcome(list(run_cells(task, CELLS, scheduler=cluster.scheduler_address))) == outcome(in_turn)


def test_a_scheduler_that_does_not_answer_is_told(task: Task, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed", reason="needs distributed (hybrid-id[dask])")
    monkeypatch.setattr("hybrid_id.study.fan_out.TIMEOUT", 0.2)
    for address in ("tcp://127.0.0.1:9", "nonsense://"):
        with pytest.raises(InputError, match="No Dask scheduler answers"):
            list(run_cells(task, CELLS, scheduler=address))


def test_physics_of_a_hybrid_cell_is_that_of_physics_only(task: Task, in_turn: list[CellResult]) -> None:
    result = next(run_cells(task, [Cell(STATIC, 0)]))
    assert result.status == "done", result.message
    assert result.split == in_turn[0].split
    assert result.rungs[0].values == in_turn[0].best.values
    assert result.rungs[0].errors == pytest.approx(in_turn[0].best.errors, rel=1e-6)
    assert [rung.price for rung in result.rungs] == [math.inf, 1.0]
    assert {"loss/train", "loss/validation", "parameters/joint1/J"} <= set(result.history)
    assert from_plain(json.loads(json.dumps(plain(asdict(result))))) == result


def test_errors_beside_a_network_allow_for_correlated_residuals(
    task: Task, monkeypatch: pytest.MonkeyPatch
) -> None:
    def large(jacobians, residuals, prior):
        return np.full(len(prior), 1e6)

    monkeypatch.setattr("hybrid_id.study.ablation.correlated_errors", large)
    result = next(run_cells(task, [Cell(STATIC, 0)]))
    assert result.status == "done", result.message
    for rung in result.rungs:
        assert all(error > 100.0 * abs(rung.values[name]) for name, error in rung.std_errors.items())


def test_a_network_alone_is_trained_by_the_same_machinery(task: Task) -> None:
    result = next(run_cells(task, [Cell(Arm(BLACK_BOX, (), 3), 0)]))
    assert result.status == "done", result.message
    assert [rung.price for rung in result.rungs] == [0.0] and set(result.best.values) == {"T_0"}
    assert set(result.best.errors) == {f"run_{k}" for k in range(5)} == set(result.best.short)


def test_what_is_kept_is_found_again_and_nothing_else(
    task: Task, in_turn: list[CellResult], tmp_path: Path
) -> None:
    result, cell = in_turn[0], CELLS[0]
    key = key_of(task, cell)
    assert load_cell(tmp_path, cell, key) is None
    save_cell(tmp_path, result, key)
    save_cell(tmp_path, result, key)  # in place of the first
    assert [path.name for path in tmp_path.iterdir()] == [cell.name]
    assert load_cell(tmp_path, cell, key) == result
    assert {path.name for path in (tmp_path / cell.name).iterdir()} == {"cell.json", "model.yaml"}
    content = json.loads((tmp_path / cell.name / "cell.json").read_text())
    for change in ({"split": "x"}, {"rungs": []}, {"chosen": 3}, {"seconds": 0.5}):  # somebody has edited it
        edited = content | {"result": content["result"] | change}
        (tmp_path / cell.name / "cell.json").write_text(json.dumps(edited))
        assert load_cell(tmp_path, cell, key) is None
    (tmp_path / cell.name / "cell.json").write_text("{half a ")
    assert load_cell(tmp_path, cell, key) is None


def test_the_key_follows_all_that_decides_a_cell(task: Task) -> None:
    cell = CELLS[0]
    others = [
        replace(task, horizon=0.04),
        replace(task, options=replace(task.options, max_iterations=3)),
        replace(task, dataset=task.dataset.select(["run_0", "run_1", "run_2", "run_4"])),
        replace(task, system=task.system.with_values({"J": 2.4e-5})),
        replace(task, engine=replace(task.engine, width=1.0)),
    ]
    keys = [key_of(task, cell), key_of(task, Cell(Arm(), 1)), *(key_of(other, cell) for other in others)]
    assert len(set(keys)) == len(keys)
    assert key_of(replace(task, options=replace(task.options, seed=9)), cell) == keys[0]


def test_the_key_follows_the_description_of_a_robot(task: Task, tmp_path: Path) -> None:
    """A model file names it, and may stay as it is where that is edited."""
    nominal = described(tmp_path)
    heavy = tmp_path / "heavy"
    heavy.mkdir()
    (heavy / "arm.xml").write_text((tmp_path / "arm.xml").read_text().replace('mass="0.4"', 'mass="0.8"'))
    (heavy / "model.yaml").write_text((tmp_path / "model.yaml").read_text())
    edited = load_model(heavy / "model.yaml")
    keys = {key_of(replace(task, system=one), CELLS[0]) for one in (nominal, edited)}
    assert len(keys) == 2
    assert fingerprint(nominal, []) != fingerprint(edited, []) and fingerprint(nominal, []) == fingerprint(
        described(tmp_path), []
    )


def test_a_network_alone_stands_in_for_joints_with_states_of_their_own(task: Task) -> None:
    two = two_link((20.0, 30.0)).with_component("joint1/motor_friction", REGISTRY["lugre"]())
    record = task.dataset.records[0]
    inputs = {f"u{k}": record.inputs["u1"] for k in (1, 2)}
    outputs = {f"q_m{k}": k * record.outputs["q_m1"] for k in (1, 2)}
    one = replace(task, system=two)
    cell = Cell(Arm(BLACK_BOX, width=4), 0)
    batch = make_batch(one.model(cell), [replace(record, inputs=inputs, outputs=outputs)])
    table = one.model(cell, batch).table
    inertias = [info.spec.value for info in table if info.unit == "kg m^2" and not info.spec.estimate]
    assert len(inertias) == 2 and inertias[0] == pytest.approx(2.0 * inertias[1], rel=0.05)
