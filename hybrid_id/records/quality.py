"""Checks of records before anything is fitted to them: what is wrong, where, and what to do about it."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from hybrid_id.records.confounders import confounded_signals
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.finding import Finding, Severity, worst_first
from hybrid_id.records.measures import (
    DRIVES,
    count_turns,
    estimate_noise,
    find_stop,
    quantisation_step,
    rest_samples,
    start_position,
    stretches,
)
from hybrid_id.records.record import Record, stamp
from hybrid_id.records.sampling import check_sampling, check_steps
from hybrid_id.records.skew import check_skews
from hybrid_id.records.units import stem

__all__ = [
    "Finding",
    "check_dataset",
    "check_record",
    "estimate_noise",
    "quantisation_step",
    "start_position",
]

SPIKE = 12.0  # times noise or quantisation step


def check_record(record: Record) -> list[Finding]:
    """Check one record's sampling, inputs and outputs; worst findings first."""
    findings = [*check_sampling(record), *_excitation(record)]
    for name, values in record.outputs.items():
        findings += [
            Finding(severity, code, f"{record.name}, {name}: {words}", record.name, name)
            for severity, code, words in _output(record, name, values)
        ]
    return worst_first(findings)


def check_dataset(dataset: Dataset) -> list[Finding]:
    """Check a dataset as a whole and every record in it; worst first, what records share said once."""
    findings = [*_roles(dataset), *_repeats(dataset), *check_steps(dataset), *_dead_inputs(dataset)]
    findings += [
        Finding("warning", "together", f"these records cannot tell {words}; vary one without the other")
        for words in confounded_signals(dataset.records)
    ]
    findings += [Finding("info", "resampled", report.message, report.record) for report in dataset.resampling]
    for channel in dataset.outputs:
        findings += _across_records(dataset, channel)
    findings += check_skews(dataset)
    findings += _merged([finding for record in dataset for finding in check_record(record)])
    return worst_first(findings)


def remarks(dataset: Dataset) -> list[Finding]:
    """What the check of a dataset has found fault with: its errors and warnings, worst first."""
    return [finding for finding in check_dataset(dataset) if finding.severity != "info"]


def _excitation(record: Record) -> Iterator[Finding]:
    name = record.name
    drives = {key: values for key, values in record.inputs.items() if stem(key) in (*DRIVES, "goal")}
    if drives and not any(np.ptp(values) for values in drives.values()):
        verb = "changes" if len(drives) == 1 else "change"
        words = f"{name}: {', '.join(drives)} never {verb}, so only a free motion is seen; excite the drive"
        yield Finding("warning", "no_excitation", words, name)
    moving = [values for values in (*drives.values(), *record.outputs.values()) if np.ptp(values)]
    if drives and max((count_turns(values, 0.05 * np.ptp(values)) for values in moving), default=0) < 2:
        words = f"{name}: under two turning points in each signal hide the inertia; add a faster record"
        yield Finding("warning", "slow", words, name)
    for channel, values in ((key, values) for key, values in drives.items() if stem(key) in DRIVES):
        at_limit = np.abs(values) == np.abs(values).max()
        runs = stretches(at_limit)
        runs = runs[runs[:, 1] - runs[:, 0] >= 3]
        if at_limit.mean() > 0.02 and len(runs) >= 2 and np.unique(values).size > 20:
            words = (
                f"{name}, {channel}: at its limit of {np.abs(values).max():.4g} in {at_limit.mean():.0%} of the "
                "samples; make sure that the value after the limit is logged"
            )
            yield Finding("info", "clipped_input", words, name, channel)


def _output(record: Record, name: str, values: np.ndarray) -> Iterator[tuple[Severity, str, str]]:
    """Yield (severity, code, words) for one output."""
    spread = float(values.std())
    if np.ptp(values) == 0 or spread == 0:  # squares of 1e-300 are nothing
        # one joint of several, say
        held = any(np.ptp(other) for key, other in record.outputs.items() if key != name)
        words = f"it is {values[0]:g} throughout; check its column and its sensor"
        yield "warning" if held else "error", "constant", words
        return
    noise, quantum = estimate_noise(values), quantisation_step(values)
    fine = max(noise, quantum)
    position = stem(name) in ("q_m", "q_a")
    resolution = f", resolution {quantum:.3g}" if quantum > 1e-3 * spread else ""
    yield "info", "noise", f"noise about {noise:.2g}, {noise / spread:.2%} of the signal's spread{resolution}"
    if noise > 0.1 * spread:
        yield "warning", "noisy", "noise is above a tenth of the signal; move further or use a better sensor"
    if quantum and np.ptp(values) < 20 * quantum:
        yield (
            "warning",
            "coarse",
            f"it spans only {np.ptp(values) / quantum:.0f} steps of {quantum:.3g}; move further",
        )
    jumps = np.diff(values)
    wrapped = np.abs(np.abs(jumps) - 2 * np.pi) < 1.0
    if position and wrapped.any() and np.quantile(np.abs(jumps), 0.98) < 1.0:
        at = record.time[np.argmax(wrapped) + 1]
        words = (
            f"it jumps by a turn {wrapped.sum()} times, first at {stamp(at)} s; set 'unwrap' for its column"
        )
        yield "warning", "wrapped", words
    if values.size > 4:
        near = np.sort(np.lib.stride_tricks.sliding_window_view(values, 5), axis=1)
        away = np.abs(values[2:-2] - near[:, 2])
        # The closest three of five samples move on as the motion does, which turns within a few samples at times.
        moved = np.min(near[:, 2:] - near[:, :3], axis=1)
        spikes = (away > SPIKE * fine) & (away > 2 * moved)
        if spikes.any():
            at = record.time[np.argmax(spikes) + 2]
            count = spikes.sum()
            words = f"{count} samples stand out as spikes, first at {stamp(at)} s; use a robust loss or repair them"
            yield "warning", "spikes", words
    for extreme in (values.max(), values.min()):
        if (at := find_stop(values, extreme, fine)) is not None:
            words = (
                f"it stops dead at {extreme:.4g}, first at {stamp(record.time[at])} s: an end stop or the sensor's "
                "range; keep clear of it or cut the record with 'between'"
            )
            yield "warning", "clipped", words
    if position and count_turns(values, 5 * fine) == 0:
        words = (
            "it moves in one direction only, so friction cannot be told from a constant torque; add reversals"
        )
        yield "warning", "one_direction", words
    first = np.diff(values[:3])  # a start at rest that accelerates has a second step three times the first
    if (
        position
        and rest_samples(record) < 3
        and abs(first.sum()) > 6 * fine
        and abs(first[0]) > 2 * abs(np.ptp(first))
    ):
        yield (
            "warning",
            "start_motion",
            "it is moving at the start, so that its speed there has to be estimated; begin at rest",
        )


def _merged(findings: list[Finding]) -> Iterator[Finding]:
    """Join findings that more than two records share into the first of them, which then counts the others."""
    groups: dict[tuple[str, str], list[Finding]] = {}
    for finding in findings:
        groups.setdefault((finding.code, finding.channel), []).append(finding)
    for first, *others in groups.values():
        more = list(dict.fromkeys(other.record for other in others if other.record != first.record))
        if len(more) < 2:
            yield from (first, *others)
        else:
            names = ", ".join(more[:5]) + (", ..." if len(more) > 5 else "")
            yield replace(first, message=f"{first.message} [likewise in {len(more)} more records: {names}]")


def _roles(dataset: Dataset) -> Iterator[Finding]:
    if not dataset.train:
        yield Finding("error", "no_train", f"{dataset.name} has no train record; give one the role 'train'")
    elif len(dataset.train) == 1:
        words = (
            f"{dataset.name} has one train record, so parameters cannot be compared over records; add some"
        )
        yield Finding("warning", "one_train", words)
    if not dataset.test:
        words = f"{dataset.name} has no test record, so nothing is held back; give one the role 'test'"
        yield Finding("info", "no_test", words)


def _dead_inputs(dataset: Dataset) -> Iterator[Finding]:
    """Inputs that push the motor and never change in any train record: a free swing, or a column gone wrong."""
    values = {
        channel.name: np.concatenate([record.inputs[channel.name] for record in dataset.train])
        for channel in (dataset.inputs if dataset.train else ())
        if stem(channel.name) in (*DRIVES, "goal")
    }
    dead = [name for name, signal in values.items() if np.ptp(signal) == 0]
    for name in dead:
        words = (
            f"{name} is {values[name][0]:g} in every sample of every train record, so nothing shows how it drives the "
            "motor; unless the joint is to swing freely, check its column or add a record in which it changes"
        )
        yield Finding("warning", "dead_input", words, channel=name)


def _repeats(dataset: Dataset) -> Iterator[Finding]:
    """Records with the same numbers under two names: they would be counted twice, or leak into the test."""
    seen: dict[bytes, Record] = {}
    for record in dataset:
        contents = b"".join(
            values.tobytes() for values in (*record.inputs.values(), *record.outputs.values())
        )
        first = seen.setdefault(contents, record)
        if first is not record:
            leak = " and would leak from train to test" if first.role != record.role else ""
            words = f"{record.name} holds the same numbers as {first.name}{leak}; remove one of them"
            yield Finding("error" if leak else "warning", "repeated", words, record.name)


def _across_records(dataset: Dataset, channel: Channel) -> Iterator[Finding]:
    """Compare one output over the records, and its noise with the declared one."""
    name, signals = channel.name, [record.outputs[channel.name] for record in dataset]
    spreads = np.array([values.std() for values in signals])
    usual = np.median(spreads)
    for record, spread in zip(dataset, spreads, strict=True):
        if len(spreads) > 2 and not usual / 50 < spread < usual * 50:
            words = (
                f"{record.name}, {name}: it varies by {spread:.2g} where the other records vary by {usual:.2g}; "
                "check its unit"
            )
            yield Finding("warning", "scale", words, record.name, name)
    noise = float(np.median([estimate_noise(values) for values in signals]))
    if channel.noise_std and noise and not 1 / 3 < noise / channel.noise_std < 3:
        words = (
            f"{name}: noise_std is {channel.noise_std:.2g} in the dataset file but the records show {noise:.2g}; "
            "correct it or leave it out"
        )
        drowned = channel.noise_std > spreads.max() > 0  # no fit could see the signal
        yield Finding("error" if drowned else "warning", "noise_std", words, channel=name)
