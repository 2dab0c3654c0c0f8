"""What a study says of networks: share, overlap with the physics, warnings, and which records validate."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from drives import make_record, multisine, rigid_drive

from hybrid_id.components import ResidualNetwork
from hybrid_id.errors import InputError
from hybrid_id.identification.hybrid import HybridOptions
from hybrid_id.identification.networks import with_scales
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.solvers import OdeEngine
from hybrid_id.simulation.step import Engine
from hybrid_id.study.hybrid import NetworkRole, hybridise, network_roles, split
from hybrid_id.systems import System

ENGINE = Engine("smooth", 8, width=1.0)
DRIVE = rigid_drive(ratio=20.0)
PLACE = "joint1/motor_friction"


@pytest.fixture(scope="module")
def batch() -> Batch:
    record = make_record(
        DRIVE, multisine(0, samples=300, rest=10), seed=0, noise={"q_m1": 0.01}, engine=ENGINE
    )
    return make_batch(DRIVE, [record], noise_std={"q_m1": 0.01})


def role(batch: Batch, inputs: tuple[str, ...], weights: list[float], place: str = PLACE) -> NetworkRole:
    """What a linear network with given weights does."""
    system = DRIVE.with_component(place, ResidualNetwork(inputs=inputs, hidden=()))
    system = with_scales(system, batch)
    (part,) = system.networks.values()
    with torch.no_grad():
        part.weights()["layers.0.weight"].copy_(torch.tensor([weights]))
    (found,) = network_roles(system, ENGINE, batch)
    return found


def test_a_network_that_is_viscous_friction_is_said_to_be_that(batch: Batch) -> None:
    found = role(batch, ("speed",), [0.2])
    assert found.overlap == pytest.approx(1.0, abs=1e-6)
    assert {"F_v", "P_m2"} == {name for name, cosine in found.alike if cosine > 0.999}
    assert 0.1 < found.share < 0.4 and found.unit == "N m" and found.where == PLACE


def test_a_constant_part_that_is_estimated_is_the_networks_own(batch: Batch) -> None:
    system = with_scales(DRIVE.with_component(PLACE, ResidualNetwork(inputs=("speed",), hidden=())), batch)
    freed = system.with_specs({"b_0": replace(system.parameter("b_0").spec, estimate=True)})
    (found,) = network_roles(freed, ENGINE, batch)
    assert "J" in found.room and "b_0" not in found.room


def test_a_network_of_the_angle_overlaps_little(batch: Batch) -> None:
    found = role(batch, ("sin 7",), [0.2])
    assert found.overlap < 0.3
    assert found.room["J"] > 0.0 and found.room["F_c"] == pytest.approx(
        found.rms, rel=0.1
    )  # its torque is ±F_c
    assert found.map.shape == (len(found.speed), len(found.angle))
    np.testing.assert_allclose(found.map[3], found.map[40], rtol=1e-12)
    assert found.angle[-1] == pytest.approx(2 * np.pi) and found.seen[:, 1].max() <= 2 * np.pi


def test_a_network_that_sleeps_has_no_share(batch: Batch) -> None:
    found = role(batch, ("speed", "angle"), [0.0, 0.0], place="joint1/input")
    assert (found.share, found.overlap, found.variance_share, found.unit) == (0.0, 0.0, 0.0, "V")


def dataset(*roles: str) -> Dataset:
    record = make_record(DRIVE, multisine(0, samples=40, rest=5), seed=0, noise={})
    records = tuple(replace(record, name=f"run_{k}", role=role) for k, role in enumerate(roles))
    return Dataset("drive", (Channel("u1", "V"),), (Channel("q_m1", "rad"),), records)


def names(parts: tuple) -> list[list[str]]:
    return [[record.name for record in part] for part in parts]


def test_test_records_stay_unseen_while_there_are_others() -> None:
    assert names(split(dataset("train", "train", "train", "test"))) == [["run_0", "run_1"], ["run_2"]]
    assert names(split(dataset("train", "test"))) == [["run_0"], ["run_1"]]
    assert names(split(dataset("train", "train", "test"), ["run_0"])) == [["run_1"], ["run_0"]]
    assert names(split(dataset("train", "validation", "test"))) == [["run_0"], ["run_1"]]
    for faulty, chosen in (
        (dataset("train"), None),
        (dataset("train", "test"), ["run_9"]),
        (dataset("train"), ["run_0"]),
    ):
        with pytest.raises(InputError, match="drive"):
            split(faulty, chosen)


def test_systems_are_left_as_they_are(batch: Batch) -> None:
    system: System = DRIVE.with_component(PLACE, ResidualNetwork())
    with_scales(system, batch)
    assert next(iter(system.networks.values())).scale.tolist() == [1.0]


def test_a_machine_that_changes_from_record_to_record_is_said_to() -> None:
    """What is missing is no function of the state: each record is met with its own friction, none with the same."""
    model = DRIVE.with_component("joint1/motor", ResidualNetwork(inputs=("sin 1", "cos 1"), hidden=(2,)))
    made = tuple(
        make_record(
            DRIVE.with_values({"F_c": level}), multisine(k, samples=250, rest=10), seed=k, noise={"q_m1": 0.02},
            name=f"run_{k}", engine=ENGINE,
        )
        for k, level in enumerate((0.008, 0.012, 0.008, 0.012))
    )  # fmt: skip
    data = Dataset("drive", (Channel("u1", "V"),), (Channel("q_m1", "rad", 0.02),), made, signal_share=0.0)
    brief = HybridOptions(windows=(), max_iterations=1)
    study = hybridise(data, model, engine=OdeEngine(fine=4, width=1.0), options=brief)
    assert study.own < 1.2 and study.pooled > 3.0
    assert any("parameters differ from record to record" in warning for warning in study.warnings)
