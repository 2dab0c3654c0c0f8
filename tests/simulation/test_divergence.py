"""A simulation that is lost says which record, when, which state, and why."""

import numpy as np
import pytest
import torch
from drives import batch_of, flexible_drive, make_record, multisine, rigid_drive

from hybrid_id.errors import InputError
from hybrid_id.identification.horizons import WHOLE
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.simulation.rollout import cause_of_divergence, simulate
from hybrid_id.simulation.step import Engine
from hybrid_id.study import compare
from hybrid_id.systems import System, two_link


def cause(system: System, engine: Engine, **channels: np.ndarray) -> str:
    batch = batch_of(system, channels)
    return cause_of_divergence(system, engine, batch, simulate(system, engine, batch).x)


def test_sound_simulation_has_no_cause() -> None:
    assert cause(rigid_drive(), Engine(), u1=multisine(1, samples=100)) == ""


def test_unstable_step_is_named() -> None:
    stiff = flexible_drive().with_values({"k": 1e9})
    words = cause(stiff, Engine(substeps=1), u1=multisine(1, samples=300, rest=10))
    assert "record 'row0'" in words and "unstable" in words and " from 0." in words


def test_singular_mass_matrix_is_named() -> None:
    system = two_link((100.0, 100.0))
    batch = batch_of(system, {"u1": np.zeros(20), "u2": np.zeros(20)}, outputs=("q_m1", "q_m2"))
    lost = torch.full_like(batch.x, torch.nan)
    place = next(k for k, info in enumerate(system.table) if info.symbol == "P_3")
    theta = system.theta().detach()
    theta[place] = 1e3
    words = cause_of_divergence(system, Engine(), batch, lost, theta)
    assert "mass matrix is singular" in words


@pytest.fixture
def dataset() -> Dataset:
    record = make_record(rigid_drive(), multisine(1, samples=200), seed=1, noise={"q_m1": 0.01})
    return Dataset("bench", (Channel("u1", "V"),), (Channel("q_m1", "rad"),), (record,))


def test_compare_says_which_record_is_lost(dataset: Dataset) -> None:
    wrong = flexible_drive().with_values({"k": 1e9})
    with pytest.raises(InputError, match="wrong: record 'run'"):
        compare(dataset, {"wrong": wrong}, horizon=WHOLE)
