"""Checks of time: length, gaps, jitter, and steps that only a wrong unit explains."""

from collections.abc import Iterator

import numpy as np

from hybrid_id.records.dataset import Dataset
from hybrid_id.records.finding import Finding
from hybrid_id.records.record import Record, stamp
from hybrid_id.records.resample import find_gaps

MIN_SAMPLES = 200
SLOW_STEP = 0.2  # s; nobody samples a drive that slowly, but 5 kHz stamped in ms looks like it
STAMPS = ((1e2, "ms", "unit: ms"), (1e5, "us", "unit: us"), (np.inf, "ns", "scale: 1.0e-9"))
"""Units of stamps by the step below which they explain one that is too long, and what says so."""
UNEQUAL = 10.0  # ratio of two records' steps


def check_sampling(record: Record) -> Iterator[Finding]:
    """Check one record's stamps."""
    name, step = record.name, record.sample_time
    if record.n_samples < MIN_SAMPLES:
        words = f"{name} has {record.n_samples} samples; record longer, at least {MIN_SAMPLES}"
        yield Finding("warning", "short", words, name)
    if step >= SLOW_STEP:
        unit, key = next((u, k) for most, u, k in STAMPS if step < most)
        words = (
            f"{name}: its samples are {step:.4g} s apart, too far for most drives; if its stamps are in {unit}, set "
            f"'t: {{column: t, {key}}}' under 'columns'"
        )
        yield Finding("warning", "slow_step", words, name)
    if gaps := find_gaps(record):
        places = "place" if len(gaps) == 1 else "places"
        longest = np.floor(max(length for _, length in gaps) / step) + 1
        words = (
            f"{record.title}: samples are missing at {len(gaps)} {places}, first after {stamp(gaps[0][0])} s for "
            f"{1e3 * gaps[0][1]:.3g} ms ({gaps[0][1] / step:.0f} steps), and a fit would take the input as held "
            f"meanwhile; cut the record there with 'between', or bridge it with 'resample: {{max_gap: {longest:.0f}}}'"
        )
        yield Finding("error", "gap", words, name)
    if not record.is_uniform:
        steps = np.diff(record.time)
        words = (
            f"{name}: stamps are {1e3 * steps.min():.3g} to {1e3 * steps.max():.3g} ms apart (median "
            f"{1e3 * step:.3g} ms, spread {steps.std() / step:.1%}) and are used as they are; "
            "'resample: true' makes them uniform"
        )
        yield Finding("info", "jitter", words, name)


def check_steps(dataset: Dataset) -> Iterator[Finding]:
    """Compare the steps of the records with the finest one."""
    finest = min(dataset, key=lambda record: record.sample_time)
    for record in dataset:
        if record.sample_time > UNEQUAL * finest.sample_time:
            words = (
                f"{record.name}: its samples are {1e3 * record.sample_time:.4g} ms apart where those of {finest.name} "
                f"are {1e3 * finest.sample_time:.4g} ms apart; check the unit of its time, or resample all to one step"
            )
            yield Finding("warning", "unequal_steps", words, record.name)
