"""Arms, repeats and splits of an ablation, the models that it compares, and cells that are really trained."""

# pyright: reportCallIssue=false

import math
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from drives import flexible_drive, make_record, make_records, multisine, rigid_drive

from hybrid_id.components import REGISTRY
from hybrid_id.errors import InputError
from hybrid_id.identification.hybrid import HybridOptions
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.solvers import OdeEngine
from hybrid_id.simulation.step import Engine
from hybrid_id.study.ablation import (
    BLACK_BOX,
    Arm,
    Cell,
    CellResult,
    Task,
    arms,
    run_cell,
    run_cells,
    split_records,
)
from hybrid_id.systems import System, two_link
from hybrid_id.systems.builders import black_box
from hybrid_id.systems.model_file import describe_model

DRIVE = rigid_drive(ratio=20.0)
STATIC, ALONE = Arm("static", ("joint1/motor",), 3), Arm(BLACK_BOX, (), 3)
BROKEN = Arm("static", ("joint9/motor",), 3)


def dataset(count: int, tests: int = 0) -> Dataset:
    record = make_record(DRIVE, multisine(0, samples=40, rest=5), seed=0, noise={})
    records = [
        replace(record, name=f"run_{k}", role="test" if k >= count - tests else "train", note=f"{k} V")
        for k in range(count)
    ]
    return Dataset("drive", (Channel("u1", "V"),), (Channel("q_m1", "rad"),), tuple(records))


def test_every_combination_is_an_arm_beside_physics_only() -> None:
    every = arms(widths=(4, 8), places=(("joint1/motor",), ("joint1/input",)), physics=(("F_v",),))
    assert every[0] == Arm() and every[-1].residual == BLACK_BOX
    assert len(every) == 2 * (1 + 2 * 2 * 2) + 1 == len(set(every)) == len({arm.name for arm in every})
    split = split_records(dataset(5), 0)
    names = {Cell(arm, seed, split).name for arm in every for seed in range(5)}
    assert len(names) == 5 * len(every)
    assert all(name.replace("-", "").replace("_", "").isalnum() for name in names)
    assert arms(residuals=(), black_box=None) == [Arm()]
    assert Cell(Arm(), 3, split).name == "physics-only-seed-3"
    places = tuple(f"left_shoulder_pitch_joint_{k}/motor_friction" for k in range(7))
    names = {Cell(Arm("static", places[:n], 8), 1, split).name for n in (6, 7)}
    assert len(names) == 2 and all(len(name) < 150 for name in names)  # a file system takes them


def test_a_split_is_the_seeds_alone_and_divides_no_experiment() -> None:
    data = dataset(10)
    first, again, other = (split_records(data, seed) for seed in (3, 3, 4))
    assert first == again != other
    parts = first.train, first.validation, first.test
    assert [len(p) for p in parts] == [6, 2, 2] and len(set().union(*parts)) == 10
    assert first.overlap == pytest.approx(2 / 8)


def test_test_records_stay_test_records() -> None:
    splits = [split_records(dataset(10, tests=3), seed) for seed in range(4)]
    assert {split.test for split in splits} == {("run_7", "run_8", "run_9")}
    assert len({split.train for split in splits}) > 1


def test_validation_records_validate_in_every_repeat() -> None:
    data = dataset(10, tests=3)
    records = (replace(r, role="validation") if r.name in ("run_0", "run_4") else r for r in data)
    data = replace(data, records=tuple(records))
    for seed in range(4):
        split = split_records(data, seed, beyond=["run_1"])
        assert split.validation == ("run_0", "run_4") and split.train == ("run_2", "run_3", "run_5", "run_6")
    assert (
        len(split_records(data, 0, beyond=["run_0", "run_4"]).validation) == 1
    )  # drawn, as there is none in range


def test_what_is_out_of_range_is_never_trained_on() -> None:
    for seed in range(4):
        split = split_records(dataset(8), seed, beyond=["run_2", "7 V"])
        assert split.beyond == ("run_2", "run_7")
        assert not {*split.beyond} & {*split.train, *split.validation, *split.test}


def test_faults_of_a_split_are_told() -> None:
    with pytest.raises(InputError, match="Pattern 'run_9' fits no name"):
        split_records(dataset(5), 0, beyond=["run_9"])
    with pytest.raises(InputError, match="too few records"):
        split_records(dataset(2), 0)


def task_of(system: System, data: Dataset | None = None, **settings) -> Task:
    options = HybridOptions(windows=(), max_iterations=2)
    given = {
        "engine": OdeEngine(fine=4, width=2.0),
        "options": options,
        "inputs": ("speed",),
        "horizon": 0.03,
    }
    return Task(data or dataset(5), system, **given | settings)


def test_physics_is_taken_out_by_component_or_parameter() -> None:
    arm = Arm(
        "memory", ("joint1/motor", "joint1/input"), 4, ("F_v", "joint1/motor_friction/coulomb_friction")
    )
    system = task_of(DRIVE, memory=3).model(arm, 1)
    assert system.parameter("F_v").spec.value == 0.0 and not system.parameter("F_v").spec.estimate
    assert "joint1/motor_friction/coulomb_friction" not in system.components
    assert len(system.networks) == 2 and all(part.memory == 3 for part in system.networks.values())
    for taken, words in (
        (("F_x",), "no parameter 'F_x'"),
        (("J",), "J cannot be zero"),
        (("a/b/c",), "no c at"),
    ):
        with pytest.raises(InputError, match=words):
            task_of(DRIVE).model(Arm(without=taken), 0)


@pytest.mark.parametrize("system", [DRIVE, flexible_drive(), two_link((20.0, 30.0))], ids=lambda s: s.name)
def test_a_network_alone_moves_by_nothing_else(system) -> None:
    accelerations = [100.0 * (k + 1) for k in range(len(system.joints))]
    alone = black_box(system, accelerations, hidden=(4,), seed=0)
    assert [info.symbol for info in alone.table if info.spec.estimate] == ["T_0"] * len(system.joints)
    assert all(joint.rigid for joint in alone.joints) and alone.input_names == system.input_names
    for part in alone.networks.values():
        with torch.no_grad():
            part.layers[-1].bias.fill_(2.0)
    x = [torch.full((3,), 0.5, dtype=torch.float64)] * len(alone.state_names)
    u = {name: torch.ones(3, dtype=torch.float64) for name in alone.input_names}
    rates = alone.rates(x, u, alone.views(list(alone.theta()[:, None])))
    for row, acceleration in zip(alone.speed_rows, accelerations, strict=True):
        torch.testing.assert_close(rates[row], 2.0 * acceleration * torch.ones(3, dtype=torch.float64))
    assert describe_model(alone)["system"] == system.name


def test_a_network_alone_has_a_size_and_sleeps_at_first() -> None:
    with pytest.raises(InputError, match="positive"):
        black_box(DRIVE, [0.0])
    record = make_record(DRIVE, multisine(0, samples=40, rest=10), seed=0, noise={"q_m1": 0.01})
    alone = black_box(DRIVE, [10.0])
    assert simulate(alone, Engine("smooth"), make_batch(alone, [record])).x[..., 1].abs().max() == 0.0


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
    return task_of(model, data)


def cell(task: Task, arm: Arm, seed: int = 0) -> Cell:
    return Cell(arm, seed, split_records(task.dataset, seed, beyond=["run_4"]))


@pytest.fixture(scope="module")
def physics(task: Task) -> CellResult:
    return run_cell(task, cell(task, Arm()))


def test_cells_are_computed_in_processes_and_kept(
    task: Task, physics: CellResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To the same numbers; a broken one says why and loses no other; what is kept is read as it was."""
    cells, computed = [cell(task, Arm()), cell(task, BROKEN), cell(task, Arm(), 1)], []

    def run(task: Task = task, jobs: int = 1) -> list[CellResult]:
        computed.clear()
        results, failed = run_cells(
            task, cells, lambda name: tmp_path / name / "cell.json", jobs=jobs,
            done=lambda name, _, earlier: None if earlier else computed.append(name),
        )  # fmt: skip
        assert failed[cells[1].name].startswith("InputError: Place 'joint9/motor' is not known")
        return results

    results = run(jobs=2)
    assert [r.cell for r in results] == [cells[0], cells[2]] and len(computed) == 3
    assert results[0].rungs == physics.rungs
    assert run() == results and computed == [cells[1].name]

    def quick(task: Task, cell: Cell) -> CellResult:
        return replace(physics, cell=cell, model=describe_model(task.model(cell.arm, cell.seed)))

    monkeypatch.setattr("hybrid_id.study.ablation.run_cell", quick)
    others = [
        replace(task, horizon=0.04),
        replace(task, options=replace(task.options, max_iterations=3)),
        replace(task, dataset=replace(task.dataset, name="other", inputs=(Channel("u1", "V", 0.1),))),
        replace(task, system=task.system.with_values({"J": 2.4e-5})),
        replace(task, engine=replace(task.engine, width=1.0)),
    ]
    for other in others:
        run(other)
        assert len(computed) == 3
    run(replace(others[-1], options=replace(task.options, seed=9)))  # a cell's own takes its place
    assert len(computed) == 1


def test_physics_of_a_hybrid_cell_is_that_of_physics_only(
    task: Task, physics: CellResult, tmp_path: Path
) -> None:
    cells = [cell(task, STATIC)]
    ((result,), _) = run_cells(task, cells, lambda name: tmp_path / f"{name}.json")
    assert result.rungs[0].values == physics.best.values
    assert result.rungs[0].errors == pytest.approx(physics.best.errors, rel=1e-6)
    assert [rung.price for rung in result.rungs] == [math.inf, 1.0]
    assert {"loss/train", "loss/validation", "parameters/joint1/J"} <= set(result.history)
    assert run_cells(task, cells, lambda name: tmp_path / f"{name}.json")[0] == [result]  # as it was kept


def test_a_network_alone_is_trained_by_the_same_machinery(task: Task) -> None:
    result = run_cell(task, cell(task, ALONE))
    assert [rung.price for rung in result.rungs] == [0.0] and set(result.best.values) == {"T_0"}
    assert set(result.best.errors) == {f"run_{k}" for k in range(5)} == set(result.best.short)


def test_a_network_alone_stands_in_for_joints_with_states_of_their_own(task: Task) -> None:
    two = two_link((20.0, 30.0)).with_component("joint1/motor_friction", REGISTRY["lugre"]())
    record = task.dataset.records[0]
    inputs = {f"u{k}": record.inputs["u1"] for k in (1, 2)}
    outputs = {f"q_m{k}": k * record.outputs["q_m1"] for k in (1, 2)}
    one = replace(task, system=two)
    alone = Arm(BLACK_BOX, width=4)
    batch = make_batch(one.model(alone, 0), [replace(record, inputs=inputs, outputs=outputs)])
    table = one.model(alone, 0, batch).table
    inertias = [info.spec.value for info in table if info.unit == "kg m^2" and not info.spec.estimate]
    assert len(inertias) == 2 and inertias[0] == pytest.approx(2.0 * inertias[1], rel=0.05)
