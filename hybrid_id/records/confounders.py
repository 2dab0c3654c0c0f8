"""Facts of records that change together: what one of them does to a machine cannot be told from what the other does."""

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from hybrid_id.records.measures import DRIVES
from hybrid_id.records.record import Record
from hybrid_id.records.units import stem

TOGETHER = 0.9
"""Correlation over the records from which two facts count as one: less than a fifth of either's variance is its own."""
FEWEST = 4
"""Records below which any two facts may go together by chance."""
STEADY = 0.1
"""Largest share of a channel's variance that lies within the records where it says what each was taken under."""


def taken_under(records: Sequence[Record]) -> dict[str, np.ndarray]:
    """What records were taken under, by name, one number a record, ``(R,)``; only what differs between them.

    Numbers of the records' meta (payload, controller gain, temperature), and the means of input channels that hardly
    change within a record. What has the numbers of an earlier fact is the same one under another name.
    """
    known = [name for name, value in (records[0].meta if records else {}).items() if _is_number(value)]
    found = {
        name: np.array([float(r.meta[name]) for r in records])
        for name in known
        if all(_is_number(r.meta.get(name)) for r in records)
    }
    for name in records[0].inputs if records else ():
        if stem(name) not in (*DRIVES, "goal", "enable") and all(name in r.inputs for r in records):
            within = float(np.mean([r.inputs[name].var() for r in records]))
            means = np.array([r.inputs[name].mean() for r in records])
            if within <= STEADY * (within + means.var()):
                found.setdefault(name, means)
    kept: dict[str, np.ndarray] = {}
    for name, values in found.items():
        if np.ptp(values) > 0 and not any(np.allclose(values, others) for others in kept.values()):
            kept[name] = values
    return kept


def confounded_signals(records: Sequence[Record]) -> Iterator[str]:
    """Pairs of facts that change together over the records, each in a sentence without its full stop."""
    if len(records) < FEWEST:
        return
    for (one, first), (other, second) in combinations(taken_under(records).items(), 2):
        correlation = float(np.corrcoef(first, second)[0, 1])
        if abs(correlation) >= TOGETHER:
            way = "rise together" if correlation > 0 else "go opposite ways"
            yield (
                f"what {one} does from what {other} does: they {way} (correlation {correlation:.2f} over "
                f"{len(records)} records)"
            )


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and bool(np.isfinite(value))
