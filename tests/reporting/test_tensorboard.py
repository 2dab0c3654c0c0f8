"""What a training writes for TensorBoard, read back from the event files."""

from pathlib import Path

import pytest
import torch
from drives import make_records, multisine, rigid_drive
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from hybrid_id.identification.adjoint import TrainOptions, train
from hybrid_id.reporting.tensorboard import TrainingLog
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.solvers import OdeEngine
from hybrid_id.simulation.step import Engine

NOISE = {"q_m1": 0.02}
ENGINE = Engine("smooth", substeps=8, width=2.0)
DRIVE = rigid_drive()


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a short training of two records, with a validation record."""
    records = make_records(DRIVE, [multisine(k, samples=200) for k in range(3)], noise=NOISE, engine=ENGINE)
    batch = make_batch(DRIVE, records, noise_std=NOISE)
    folder = tmp_path_factory.mktemp("events")
    options = TrainOptions(windows=(), max_iterations=5, validate_every=2)
    with TrainingLog(folder) as log:
        train(
            DRIVE.with_values({"J": 3e-5, "F_c": 0.006}),
            batch.take(torch.tensor([0, 1])),
            engine=OdeEngine(fine=8, width=2.0),
            options=options,
            validation=batch.take(torch.tensor([2])),
            writer=log,
        )
    return folder


def events(folder: Path) -> EventAccumulator:
    accumulator = EventAccumulator(str(folder))
    accumulator.Reload()
    return accumulator


def test_one_run_a_set_with_the_documented_tags(runs: Path) -> None:
    assert {path.name for path in runs.iterdir()} == {"run_0", "run_1"}
    for folder in runs.iterdir():
        tags = set(events(folder).Tags()["scalars"])
        wanted = {"loss/train", "loss/validation", "gradient/norm", "fit/q_m1"}
        wanted |= {f"parameters/joint1/{s}" for s in ("J", "P_m1", "P_m2", "F_c", "F_v")}
        assert tags == wanted


def test_loss_falls_and_the_fit_rises(runs: Path) -> None:
    read = events(runs / "run_0")
    loss, fit = ([e.value for e in read.Scalars(tag)] for tag in ("loss/train", "fit/q_m1"))
    assert loss[-1] < 0.1 * loss[0]
    assert fit[0] < fit[-1] <= 100.0
    assert [e.step for e in read.Scalars("loss/train")] == sorted(
        {e.step for e in read.Scalars("loss/train")}
    )


def test_pictures_of_simulated_against_measured(runs: Path) -> None:
    assert "simulated/q_m1" in events(runs / "run_1").Tags()["images"]
