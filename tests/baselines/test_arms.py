"""Baselines on an arm of two joints, whose constant torque its description lacks, joint by joint."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import torch
import yaml
from gapcase import only

from hybrid_id.baselines.by_joint import joined, parts_of
from hybrid_id.baselines.cma import evolved
from hybrid_id.baselines.reconstruct import reconstructed
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


def test_evolution_fits_parameters_and_names_nothing_but_a_delay(arm: tuple[Dataset, System, str]) -> None:
    dataset, system, _ = arm
    said = METHODS["cma"](dataset, system)
    assert {(one["name"], one["where"]) for one in said["effects"]} == {
        ("delay", "j1/input"),
        ("delay", "j2/input"),
    }
    assert said["gap"]["with_effect"] == said["gap"]["refit"] != said["gap"]["nominal"]


def test_regression_and_network_look_at_every_joint(arm: tuple[Dataset, System, str]) -> None:
    dataset, system, at = arm
    sparse = METHODS["sparse"](dataset, system)
    assert {one["where"].split("/")[0] for one in sparse["effects"]} == {"j1", "j2"}
    assert sparse["effects"][0]["where"].startswith(at)
    network = METHODS["network"](dataset, system)
    assert {one["joint"] for one in network["location"]} == {"j1", "j2"}
    assert not any(one["selected"] for one in network["effects"])


def test_torque_on_the_links_is_what_the_drive_gives(arm: tuple[Dataset, System, str]) -> None:
    dataset, system, at = arm
    for joint, name in enumerate(("j1", "j2")):
        every = [reconstructed(dataset, record, system, joint) for record in dataset.train]
        own, target = (np.concatenate([getattr(one, part) for one in every]) for part in ("own", "target"))
        bias = np.concatenate([one.library["constant_torque", f"{name}/load"] for one in every])
        left = []
        for columns in (own, np.column_stack([own, bias])):
            weights = np.linalg.lstsq(columns, target, rcond=None)[0]
            left.append(float(np.std(target - columns @ weights) / np.std(target)))
        assert (
            left[1] < 0.3 and weights[0] > 0 and (weights[1:4] < 0).all()
        )  # gain; damping, dry friction, rotor
        assert (left[1] < 0.8 * left[0]) == (name == at)


def test_parts_are_the_robot_again(arm: tuple[Dataset, System, str]) -> None:
    dataset, system, _ = arm
    parts = parts_of(dataset, system)
    assert [part.placed(f"joint{k}/load") for k, part in enumerate(parts, 1)] == ["j1/load", "j2/load"]
    whole = joined(system, [part.system for part in parts])
    assert {i.name: i.spec.value for i in whole.table} == {i.name: i.spec.value for i in system.table}
    still = replace(
        dataset,
        records=tuple(replace(r, outputs={n: 0.0 * y for n, y in r.outputs.items()}) for r in dataset),
    )
    with pytest.raises(InputError, match=r"No joint can be taken by itself .*stands still"):
        parts_of(still, system)


def test_evolution_follows_a_bent_valley() -> None:
    def cost(x: np.ndarray) -> float:
        return float(100.0 * (x[1] - x[0] ** 2) ** 2 + (1.0 - x[0]) ** 2)

    best = evolved(cost, np.array([-1.0, 1.0]), 0.5, 900)
    assert best == pytest.approx([1.0, 1.0], abs=1e-3)
    assert np.array_equal(best, evolved(cost, np.array([-1.0, 1.0]), 0.5, 900))
