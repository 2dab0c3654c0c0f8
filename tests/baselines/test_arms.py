"""Baselines on an arm of two joints, whose constant torque its description lacks, joint by joint."""

from collections.abc import Iterator
from dataclasses import replace

import pytest
import torch
import yaml
from gapcase import only

from hybrid_id.baselines.methods import joined, taken_apart
from hybrid_id.baselines.run import METHODS
from hybrid_id.errors import InputError
from hybrid_id.machines import arm as arms
from hybrid_id.machines import draw_arm
from hybrid_id.machines.make import make_case
from hybrid_id.records.dataset import Dataset
from hybrid_id.systems.chain import System
from hybrid_id.systems.model_file import load_model

pytest.importorskip("mujoco")


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Dataset, System, str]]:
    """Records, nominal model, and the joint where a constant torque acts."""
    torch.set_num_threads(1)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(arms, "JOINTS", (2, 2))
        patch.setattr(arms, "SERVOS", 1.0)
        patch.setattr(draw_arm, "LENGTH", 1.5)
        case = make_case(27211, tmp_path_factory.mktemp("arm"), realism="arms", effect="constant_torque")
    truth = yaml.safe_load((case.parent / "answers" / f"{case.name}.yaml").read_text())
    yield Dataset.load(case), load_model(case / "model.yaml"), truth["effects"][0]["where"].split("/")[0]


def test_criterion_leads_with_the_joint_that_gains_most(arm: tuple[Dataset, System, str]) -> None:
    dataset, system, at = arm
    with only("constant_torque", "quadratic_drag"):
        said = METHODS["bic"](dataset, system)
    first, *others = said["effects"]
    assert (first["name"], first["where"], first["selected"]) == ("constant_torque", f"{at}/load", True)
    assert not any(one["selected"] for one in others)
    assert {one["where"].split("/")[0] for one in others} == {"j1", "j2"}
    assert said["gap"]["with_effect"] < 0.5 * min(said["gap"]["refit"], said["gap"]["nominal"])


def test_stribeck_stands_at_the_joint_that_errs_most(arm: tuple[Dataset, System, str]) -> None:
    dataset, system, at = arm
    said = METHODS["stribeck"](dataset, system)
    selected = [(one["name"], one["where"]) for one in said["effects"] if one["selected"]]
    assert selected == [("stribeck_friction", f"{at}/motor_friction")]


def test_joints_taken_apart_are_the_robot_again(arm: tuple[Dataset, System, str]) -> None:
    dataset, system, _ = arm
    whole = joined(system, [part for _, part in taken_apart(dataset, system)])
    assert {i.name: i.spec.value for i in whole.table} == {i.name: i.spec.value for i in system.table}
    still = replace(
        dataset,
        records=tuple(replace(r, outputs={n: 0.0 * y for n, y in r.outputs.items()}) for r in dataset),
    )
    with pytest.raises(InputError, match=r"No joint can be taken by itself .*stands still"):
        taken_apart(still, system)
