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
    units = {c.name: c.unit for c in (*dataset.inputs, *dataset.outputs)}
    train = [_largest(record) for record in dataset.train]
    for record in dataset.test if train else ():
        found = []
        for (name, what), value in _largest(record).items():
            most = max(one.get((name, what), 0.0) for one in train)
            if value > FARTHER * most:
                unit = units.get(name, "") + ("/s" if what == "speed" else "")
                found.append(
                    f"{'speed of ' if what == 'speed' else ''}{name} {value:.3g} against {most:.3g} {unit}"
                )
        if found:
            yield f"test record {record.name} goes where no train record has been ({', '.join(found)})"


def _largest(record: Record) -> dict[tuple[str, str], float]:
    """Largest size of each command, and largest speed of each measured angle, by channel and kind."""
    found = {
        (name, "size"): float(np.nanmax(np.abs(values)))
        for name, values in record.inputs.items()
        if stem(name) in DRIVES
    }
    steps = max(1, round(OVER / record.sample_time))
    for name, values in record.outputs.items():
        if stem(name).startswith("q") and len(values) > steps:
            moved = np.abs(values[steps:] - values[:-steps]) / (steps * record.sample_time)
            found[name, "speed"] = float(np.nanmax(moved))
    return found
