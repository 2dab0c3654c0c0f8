"""Models in MuJoCo: what it lacks is fitted anew there, and what it carries stays."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from drives import make_records, multisine, only, rigid_drive

from hybrid_id.components import PositionDependent
from hybrid_id.export.target import in_mujoco, target_errors
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.record import Record
from hybrid_id.reporting.target import replays_table
from hybrid_id.study.replay import replay
from hybrid_id.systems import System
from hybrid_id.systems.model_file import load_model

pytest.importorskip("mujoco")


def recorded(truth: System, noise: float = 1e-4) -> Dataset:
    """Three train records and a test record of a drive."""
    voltages = [multisine(seed, samples=500, amplitude=6.0 + seed) for seed in range(4)]
    records = make_records(truth, voltages, noise={"q_m1": noise})
    records[3] = replace(records[3], role="test")
    channels = (Channel("u1", "V"),), (Channel("q_m1", "rad", noise),)
    return Dataset("drive", *channels, tuple(records), 0.002)


def of_role(dataset: Dataset, role: str) -> Dataset:
    return replace(dataset, records=tuple(r for r in dataset.records if r.role == role))


def test_what_mujoco_lacks_goes_into_the_parameters_that_it_has() -> None:
    truth = rigid_drive()
    data, level = recorded(truth), truth.parameter("F_c").spec.value
    # zero periods a turn: a Coulomb level by another name, which MuJoCo does not know
    other = PositionDependent(A_c=0.6 * level, A_s=0.0, n=0.0)
    split = truth.with_values({"F_c": 0.4 * level}).with_component("joint1/motor_friction", other)
    found = in_mujoco(only(split, "F_c", "F_v", "A_c"), of_role(data, "test"), train=of_role(data, "train"))
    assert set(found.refitted) <= {"F_c", "F_v"} and "F_c" in found.refitted
    assert found.system.parameter("F_c").spec.value == pytest.approx(level, rel=0.01)
    assert found.summary.there < 1e-3 < 0.1 < found.before[0].there
    assert in_mujoco(split, of_role(data, "test")).refitted == {}, (
        "without train records nothing is fitted anew"
    )


def test_what_mujoco_carries_stays_as_it_was_identified() -> None:
    data = recorded(rigid_drive(), noise=0.3)
    found = in_mujoco(rigid_drive(), of_role(data, "test"), train=of_role(data, "train"))
    assert found.refitted == {} and found.rows == found.before
    assert found.summary.role == "test" and found.summary.by_output == {"q_m1": found.summary.there}


ARM = """<mujoco><worldbody><body><joint name="lift" axis="0 1 0" armature="0.5" damping="2" frictionloss="0.1"/>
<inertial mass="0.4" pos="0 0 -0.1" diaginertia="1e-3 1e-3 3e-4"/><body pos="0 0 -0.2">
<joint name="elbow" axis="0 1 0" armature="0.01" damping="0.05" frictionloss="0.01"/>
<inertial mass="0.1" pos="0 0 -0.05" diaginertia="1e-4 1e-4 1e-4"/></body></body></worldbody></mujoco>"""


def test_of_a_robot_the_joints_that_mujoco_loses_are_fitted_there(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(ARM)
    (tmp_path / "model.yaml").write_text("robot: {file: arm.xml}\n")
    nominal = load_model(tmp_path / "model.yaml")
    split = nominal.with_component("joint2/motor_friction", PositionDependent(A_c=0.02, A_s=0.0, n=0.0))
    time, still = 0.004 * np.arange(250), {"q_m1": np.zeros(250), "q_m2": np.zeros(250)}
    commands = ({"tau1": 6.0 * np.sin(w * time), "tau2": 0.1 * np.sin(1.7 * w * time)} for w in (6.0, 9.0))
    channels = tuple(Channel(f"tau{k}", "N m") for k in (1, 2)), tuple(Channel(n, "rad", 1e-3) for n in still)
    blank = tuple(Record(f"run_{k}", time, one, still) for k, one in enumerate(commands))
    rng, runs = np.random.default_rng(0), replay(Dataset("arm", *channels, blank, 0.004), split)
    noisy = ({n: y + 1e-3 * rng.standard_normal(250) for n, y in run.outputs.items()} for run in runs)
    data = Dataset(
        "arm", *channels, tuple(replace(r, outputs=y) for r, y in zip(blank, noisy, strict=True)), 0.004
    )
    stages = []
    found = in_mujoco(split, data, train=data, progress=lambda *now: stages.append(now))
    assert {split.parameter(name).component.split("/")[0] for name in found.refitted} == {"joint2"}
    assert found.summary.there < 0.5 * np.mean([row.there for row in found.before])
    assert stages[0] == ("replays", 0, 1) and all(0 <= done <= total for _, done, total in stages)


def test_an_output_that_stands_still_is_left_out() -> None:
    """Its simulations move by rounding, or creep: how far they are apart is no share of anything."""
    data = recorded(rigid_drive())
    still = replace(data.records[3], outputs={"q_m1": np.full(500, 0.3)})
    found = target_errors({"exported": rigid_drive()}, replace(data, records=(*data.records[:3], still)))
    row = found.exported.rows[-1]
    assert row.record == still.name and np.isnan([row.known_apart, row.here, row.there]).all()
    assert found.exported.summary.worst < 1e-2
    last = [list(column.cells)[-1] for column in replays_table(found.exported.rows, data.outputs).columns]
    assert last[-3:] == ["constant"] * 3


def test_worse_is_a_corrected_model_beside_a_better_re_fitted_one() -> None:
    data = of_role(recorded(rigid_drive()), "test")
    off = rigid_drive().with_values({"F_c": 2 * rigid_drive().parameter("F_c").spec.value})
    pairs = [
        ({"re-fitted": rigid_drive(), "corrected": off}, True),
        ({"re-fitted": rigid_drive(), "corrected": rigid_drive()}, False),
        ({"re-fitted": off, "corrected": rigid_drive()}, False),
        ({"nominal": rigid_drive(), "identified": off}, False),
        ({"re-fitted": rigid_drive(), "hybrid": off}, True),
    ]
    assert [target_errors(models, data).worse for models, _ in pairs] == [worse for _, worse in pairs]
