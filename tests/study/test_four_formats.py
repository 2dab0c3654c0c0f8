"""One uniform record, written as a ROS 1 bag, as MCAP, as a LeRobot dataset and as CSV, gives one and the same fit."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from drives import make_records, multisine, rigid_drive
from record_formats import write_lerobot

from hybrid_id.records.dataset import Dataset
from hybrid_id.records.record import Record
from hybrid_id.study import identify

HELD = ("P_m1", "P_m2")
"""Parameters that voltage and angle leave open beside the others."""
APART = 0.01
"""Standard errors by which the fits may differ."""
FPS = 500
"""Samples a second of the record."""


def as_csv(folder: Path, record: Record) -> dict:
    frame = pd.DataFrame(
        {"time_ms": 1e3 * record.time, "volts": record.inputs["u1"], "q": record.outputs["q_m1"]}
    )
    frame.to_csv(folder / "run.csv", index=False)
    columns = {"t": {"column": "time_ms", "unit": "ms"}, "u1": "volts", "q_m1": "q"}
    return {"columns": columns, "records": [{"file": "run.csv"}]}


def as_lerobot(folder: Path, record: Record) -> dict:
    names = {"observation.state": ["elbow.pos"], "action": ["elbow.volts"]}
    values = record.outputs["q_m1"][:, None], record.inputs["u1"][:, None]
    file = write_lerobot(folder, [(record.time, *values)], names, fps=FPS)
    columns = {"u1": "action/elbow.volts", "q_m1": "observation.state/elbow.pos"}
    return {"format": "lerobot", "columns": columns, "records": [{"file": file}]}


def as_bag(folder: Path, record: Record, ros1: bool) -> dict:
    from bags import array, joint_state, write_bag

    name, messages = "run.bag" if ros1 else "run", []
    for time, volts, angle in zip(record.time, record.inputs["u1"], record.outputs["q_m1"], strict=True):
        stamp = 1_700_000_000_000_000_000 + round(1e9 * time)
        messages.append(("/commands", stamp, array([volts], ros1)))
        messages.append(("/joint_states", stamp, joint_state(stamp, {"elbow": angle}, ros1, velocity=False)))
    write_bag(folder / name, messages, kind="ros1" if ros1 else "mcap")
    columns = {"t": "/joint_states", "u1": "/commands/data/0", "q_m1": "/joint_states/position/elbow"}
    return {"columns": columns, "records": [{"file": name if ros1 else "run/run.mcap"}]}


WRITERS: dict[str, Callable[[Path, Record], dict]] = {
    "lerobot": as_lerobot,
    "bag": lambda folder, record: as_bag(folder, record, True),
    "mcap": lambda folder, record: as_bag(folder, record, False),
}


def fitted(
    folder: Path, write: Callable[[Path, Record], dict], record: Record
) -> tuple[np.ndarray, np.ndarray]:
    """Estimates and their standard errors."""
    folder.mkdir()
    channels = {
        "name": "drive",
        "inputs": [{"name": "u1", "unit": "V"}],
        "outputs": [{"name": "q_m1", "unit": "rad"}],
    }
    (folder / "dataset.yaml").write_text(yaml.safe_dump(channels | write(folder, record)))
    model = rigid_drive().with_values({"F_c": 0.014, "J": 2.5e-5})
    model = model.with_specs({name: replace(model.parameter(name).spec, estimate=False) for name in HELD})
    study = identify(Dataset.load(folder), model)
    return np.ravel(study.values), study.standard_errors(0)


@pytest.fixture(scope="module")
def record() -> Record:
    return make_records(rigid_drive(), [multisine(3, samples=1000, amplitude=8.0)], noise={"q_m1": 0.01})[0]


@pytest.fixture(scope="module")
def from_csv(record: Record, tmp_path_factory: pytest.TempPathFactory) -> tuple[np.ndarray, np.ndarray]:
    return fitted(tmp_path_factory.mktemp("csv") / "csv", as_csv, record)


@pytest.mark.parametrize("kind", WRITERS)
def test_same_fit(tmp_path: Path, record: Record, from_csv: tuple[np.ndarray, np.ndarray], kind: str) -> None:
    values, errors = from_csv
    found, _ = fitted(tmp_path / kind, WRITERS[kind], record)
    assert np.all((errors > 0) & np.isfinite(errors))
    assert np.max(np.abs(found - values) / errors) <= APART


def test_a_sample_late_is_seen(
    tmp_path: Path, record: Record, from_csv: tuple[np.ndarray, np.ndarray]
) -> None:
    """What a reader that pairs the wrong samples would cost: the limit above is far below it."""
    late = Record(
        "late", record.time[1:], {"u1": record.inputs["u1"][:-1]}, {"q_m1": record.outputs["q_m1"][1:]}
    )
    values, errors = from_csv
    found, _ = fitted(tmp_path / "late", as_csv, late)
    assert np.max(np.abs(found - values) / errors) > 100 * APART
