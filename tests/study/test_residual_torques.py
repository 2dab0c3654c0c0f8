"""Networks at a robot's joints: one where something is missing, none elsewhere, and physics keeps its meaning."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from servo_arm import described, records_of

from hybrid_id.components import REGISTRY
from hybrid_id.errors import InputError
from hybrid_id.records.dataset import Dataset
from hybrid_id.reporting.residual_torques import lead
from hybrid_id.reporting.results import write_physics
from hybrid_id.study.residual_torques import HELD, _best_size, learn_residuals
from hybrid_id.systems.builders import one_link
from hybrid_id.systems.by_joint import turned_together
from hybrid_id.systems.chain import System
from hybrid_id.systems.model_file import load_model, save_model

pytest.importorskip("mujoco")


@pytest.fixture
def nominal(tmp_path: Path) -> System:
    return described(tmp_path)


def test_a_network_stays_where_something_is_missing_alone(nominal: System, tmp_path: Path) -> None:
    machine = nominal.with_component("joint3/load", REGISTRY["spring_load"](k_s=0.8, q_s=0.4))
    dataset, stages = records_of(machine, 5), list[str]()
    found = learn_residuals(dataset, nominal, ["lift", "elbow"], say=lambda name, *_: stages.append(name))
    assert stages == ["lift", "elbow"] and not found.skipped
    elbow, lift = found.joints["elbow"], found.joints["lift"]
    assert lift.size is None and lift.hybrid is lift.physics and lift.map is None
    assert elbow.size is not None and elbow.map is not None and elbow.map.share > 0.1
    assert all(abs(moved) < HELD + 1e-6 for moved in elbow.drift.values())
    ((before, after),) = elbow.tested.values()
    assert after < 0.3 * before
    ((before, after),) = found.tested.values()  # all joints simulated
    assert after < 0.5 * before
    assert "joint3/load/residual_torque" in found.system.components
    assert not any("residual" in key for key in found.physics.components)
    save_model(found.system, tmp_path / "hybrid.yaml")
    again = load_model(tmp_path / "hybrid.yaml")
    assert [i.spec.value for i in again.table] == [i.spec.value for i in found.system.table]


def test_a_network_whose_runs_diverge_does_not_stay_for_what_it_gains_elsewhere() -> None:
    gains = {f"run_{k}": (2.0, 1.5 + 0.05 * k) for k in range(6)}
    wild = gains | {"run_5": (2.0, np.inf)}
    small = {name: (2.0, 1.9 + 0.001 * k) for k, name in enumerate(gains)}
    assert _best_size({1.0: gains, 2.0: small}, 0.2)[::2] == (1.0, True)
    assert _best_size({1.0: wild, 2.0: small}, 0.2)[::2] == (2.0, True)
    assert not _best_size({1.0: wild}, 0.2)[2]


def test_joints_of_a_coupled_gear_are_taken_together(nominal: System, tmp_path: Path) -> None:
    (tmp_path / "model.yaml").write_text(
        "robot: {file: arm.xml}\ncouplings: [{joints: [lift, elbow], matrix: [[1, 0], [1, 1]]}]\n"
    )
    wrist = load_model(tmp_path / "model.yaml")
    assert [turned_together(wrist, k) for k in range(3)] == [[0], [1, 2], [1, 2]]
    assert turned_together(nominal, 2) == [2]
    machine = wrist.with_component("joint3/load", REGISTRY["spring_load"](k_s=0.8, q_s=0.4))
    stages = list[str]()
    found = learn_residuals(
        records_of(machine, 5), wrist, ["elbow", "lift"], say=lambda name, *_: stages.append(name)
    )
    assert stages == ["elbow"] and not found.skipped and found.others == ["pan"]
    lift, elbow = found.joints["lift"], found.joints["elbow"]
    assert lift.size is not None and lift.hybrid is elbow.hybrid
    assert lift.map is not None and elbow.map is not None and elbow.map.share > lift.map.share
    ((before, after),) = elbow.tested.values()
    assert after < 0.75 * before
    assert all(f"joint{k}/load/residual_torque" in found.system.components for k in (2, 3))


def in_roles(dataset: Dataset, *roles: str) -> Dataset:
    """The same records with other roles."""
    pairs = zip(dataset.records, roles, strict=True)
    return replace(dataset, records=tuple(replace(record, role=role) for record, role in pairs))


def test_one_train_record_is_enough_where_validation_records_judge(nominal: System) -> None:
    machine = nominal.with_component("joint3/load", REGISTRY["spring_load"](k_s=0.8, q_s=0.4))
    dataset = in_roles(records_of(machine, 3), "train", "validation", "validation")
    found = learn_residuals(dataset, nominal, ["elbow"])
    elbow = found.joints["elbow"]
    assert set(elbow.left_out) == {"run_1", "run_2"} and elbow.gain.mean > 0.1
    assert elbow.size is None and "At elbow too few records are left out to say whether" in lead(found)
    assert all(after < before for before, after in elbow.left_out.values())


def test_nothing_missing_nothing_learnt(nominal: System) -> None:
    found = learn_residuals(records_of(nominal, 4), nominal, ["elbow"])
    assert found.joints["elbow"].size is None
    assert found.system.theta().tolist() == found.physics.theta().tolist()


def test_what_cannot_be_learnt_is_refused(nominal: System) -> None:
    dataset = records_of(nominal, 2)
    words = (
        r"has 1 train and 0 validation records where the joint moves; .*: give more records the role train"
    )
    with pytest.raises(InputError, match=words):
        learn_residuals(dataset, nominal, ["elbow"])
    with pytest.raises(
        InputError, match=r"has 1 train and 1 validation .*: give more records the role validation"
    ):
        learn_residuals(in_roles(records_of(nominal, 2), "train", "validation"), nominal, ["elbow"])
    with pytest.raises(InputError, match="The robot has no joint 'wrist'"):
        learn_residuals(dataset, nominal, ["wrist"])
    with pytest.raises(InputError, match="for a robot"):
        learn_residuals(dataset, one_link(50.0))


def test_ctrl_c_keeps_the_joints_that_are_done(nominal: System) -> None:
    def stop(name: str, done: int, total: int) -> None:
        if name == "elbow":
            raise KeyboardInterrupt

    found = learn_residuals(records_of(nominal, 3), nominal, ["lift", "elbow"], say=stop)
    assert found.interrupted and set(found.joints) == {"lift"} and found.skipped == {"elbow": "stopped"}


def test_a_limit_that_is_never_met_stays_a_parameter(nominal: System, tmp_path: Path) -> None:
    """It has no standard error, and stands in the files of a joint whose network stays."""
    machine = nominal.with_component("joint3/load", REGISTRY["spring_load"](k_s=0.8, q_s=0.4))
    dataset = records_of(machine, 5)
    name = "tau_max_elbow"
    spec = nominal.parameter(name).spec
    limited = nominal.with_specs({name: replace(spec.at(50.0), estimate=True)})
    found = learn_residuals(dataset, limited, ["elbow"])
    elbow = found.joints["elbow"]
    assert elbow.size is not None and name in elbow.physics.names and name not in elbow.drift
    assert found.system.parameter(name).spec.estimate
    write_physics(tmp_path / "parameters.csv", found)
    lines = [line.split(",") for line in (tmp_path / "parameters.csv").read_text().splitlines()]
    assert [float(line[3]) for line in lines if line[2] == name] == [50.0, 50.0]


def test_a_model_with_a_network_is_no_physics(nominal: System) -> None:
    learnt = nominal.with_component("joint3/load", REGISTRY["residual_torque"]())
    with pytest.raises(InputError, match=r"has a network .*residual_torque.*physics\.yaml"):
        learn_residuals(records_of(nominal, 3), learnt, ["elbow"])
