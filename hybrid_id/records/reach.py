"""Where test records go that no train record has been: what acts there only, no train record can tell."""

from collections.abc import Iterator

import numpy as np

from hybrid_id.records.dataset import Dataset
from hybrid_id.records.measures import DRIVES
from hybrid_id.records.record import Record
from hybrid_id.records.units import stem

FARTHER = 1.25
"""Ratio of the largest commands or speeds from which a test record is somewhere else."""
OVER = 0.05
"""Time [s] over which a speed is taken: a quantised angle has none from sample to sample."""


def beyond(dataset: Dataset) -> Iterator[str]:
    """Test records that go farther than every train record, each in a sentence without its full stop.

    Args:
        dataset: its train and test records.
    """
    units = {c.name: "" if c.unit == "1" else f" {c.unit}" for c in (*dataset.inputs, *dataset.outputs)}
    units |= {_speed_of(name): f"{unit}/s" for name, unit in units.items()}
    train = [_largest(record) for record in dataset.train]
    for record in dataset.test if train else ():
        found = []
        for what, value in _largest(record).items():
            most = max(one.get(what, 0.0) for one in train)
            if value > FARTHER * most:
                found.append(f"{what} {value:.3g} against {most:.3g}{units.get(what, '')}")
        if found:
            yield f"test record {record.name} goes where no train record has been ({', '.join(found)})"


def _largest(record: Record) -> dict[str, float]:
    """Largest size of each command, and largest speed of each measured angle, by what it is called."""
    found = {
        name: float(np.nanmax(np.abs(values)))
        for name, values in record.inputs.items()
        if stem(name) in DRIVES
    }
    steps = max(1, round(OVER / record.sample_time))
    for name, values in record.outputs.items():
        if stem(name).startswith("q") and len(values) > steps:
            moved = np.abs(values[steps:] - values[:-steps]) / (steps * record.sample_time)
            found[_speed_of(name)] = float(np.nanmax(moved))
    return found


def _speed_of(name: str) -> str:
    return f"speed of {name}"
