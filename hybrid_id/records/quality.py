"""Checks of records before anything is fitted to them: what is wrong, where, and what to do about it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal

import numpy as np

from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.measures import (
    DRIVES,
    count_turns,
    estimate_noise,
    find_stop,
    has_arrived,
    noise_of,
    quantisation_step,
    rest_samples,
    stretches,
)
from hybrid_id.records.record import Record, stamp
from hybrid_id.records.resample import find_gaps, turns_back
from hybrid_id.records.skew import find_skews
from hybrid_id.records.units import number_of, stem

Severity = Literal["error", "warning", "info"]


@dataclass(frozen=True)
class Finding:
    """One result of a check.

    Attributes:
        severity: `error` (a fit would be meaningless), `warning` (it may be wrong) or `info`.
        code: Short name of the check, to filter by.
        message: A sentence that names record and channel and says what to do.
        record: Name of the record; empty for the dataset as a whole.
        channel: Name of the channel, where there is one.
    """

    severity: Severity
    code: str
    message: str
    record: str = ""
    channel: str = ""


def worst_first(findings: list[Finding]) -> list[Finding]:
    """Errors, then warnings, then what is only worth knowing; otherwise in the order of the checks."""
    return sorted(findings, key=lambda finding: ("error", "warning", "info").index(finding.severity))


SPIKE = 12.0  # times noise or quantisation step
SLIP = 1e-4
"""Spread of an output, relative to that of other records, up to which no wrong unit, but a rest, explains it."""
ROUNDING = 1e-13
"""Spread of an output, relative to its largest value, up to which arithmetic and not a motion has made it."""
RESTS = 3.0
"""Standard deviation of an output over its noise or quantisation step up to which its joint stands still."""


def check_record(record: Record) -> list[Finding]:
    """Check one record's sampling, inputs and outputs; worst findings first."""
    findings = [*check_sampling(record), *_excitation(record)]
    still = resting(record)
    for name, values in record.outputs.items():
        if name in still:
            continue  # of a joint that is at rest while others move, no fault of its signal is worth a line
        findings += [
            Finding(severity, code, f"{record.name}, {name}: {words}", record.name, name)
            for severity, code, words in _output(record, name, values)
        ]
    return worst_first(findings)


def check_dataset(dataset: Dataset) -> list[Finding]:
    """Check a dataset as a whole and every record in it; worst first, what records share said once."""
    findings = list(_as_a_whole(dataset))
    findings += [
        Finding("warning", "together", f"these records cannot separate {words}; vary one without the other")
        for words in confounded_signals(dataset.records)
    ]
    findings += [
        Finding("warning", "between", f"{record.name}: {dataset.cut_beyond[record.name]}", record.name)
        for record in dataset
        if record.name in dataset.cut_beyond
    ]
    findings += [Finding("info", "resampled", report.message, report.record) for report in dataset.resampling]
    for channel in dataset.outputs:
        findings += _across_records(dataset, channel)
    findings += [
        Finding("warning", "skew", skew.message, channel=skew.channel) for skew in find_skews(dataset)
    ]
    of_records = [finding for record in dataset for finding in check_record(record)]
    slow = {finding.record for finding in of_records if finding.code == "slow"}
    if any(record.name not in slow for record in dataset.train):  # no fault, for all are fitted at once
        words = "{}: under two turning points in each signal; the inertia shows in faster train records"
        of_records = [
            replace(one, severity="info", message=words.format(one.record)) if one.code == "slow" else one
            for one in of_records
        ]
    findings += _merged(of_records)
    findings += _resting(dataset)
    return worst_first(findings)


def _as_a_whole(dataset: Dataset) -> Iterator[Finding]:
    """Roles, records that are there twice, signals read from another's column, unequal steps, dead inputs."""

    def is_line(time: np.ndarray, values: np.ndarray) -> bool:
        """Whether a signal of more than two samples rises or falls in proportion to time."""
        span = float(np.ptp(values))
        share = (time - time[0]) / (time[-1] - time[0])
        line = values[0] + (values[-1] - values[0]) * share
        return values.size > 2 and span > 0 and float(np.abs(values - line).max()) <= LINE * span

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
    # the same numbers under two names would be counted twice, or leak into the test
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
    # signals that were read from the column of another one: an input's and an output's, or that of the stamps
    for one in (c.name for c in dataset.inputs):
        for other in (c.name for c in dataset.outputs):
            if all(np.array_equal(record.inputs[one], record.outputs[other]) for record in dataset):
                words = f"{one} and {other} hold the same numbers in every record; correct the column of one of them"
                yield Finding("error", "same_signal", words, channel=one)
    for name in (c.name for c in (*dataset.inputs, *dataset.outputs)):
        if all(is_line(record.time, record.signal(name)) for record in dataset):
            words = (
                f"{name} is a straight line over time in every record; check its column unless it is a ramp"
            )
            yield Finding("warning", "as_time", words, channel=name)
    # the steps of the records beside the finest one
    finest = min(dataset, key=lambda record: record.sample_time)
    for record in dataset:
        if record.sample_time > UNEQUAL * finest.sample_time:
            words = (
                f"{record.name}: its samples are {1e3 * record.sample_time:.4g} ms apart where those of {finest.name} "
                f"are {1e3 * finest.sample_time:.4g} ms apart; check the unit of its time, or resample all to one step"
            )
            yield Finding("warning", "unequal_steps", words, record.name)
    # what pushes the motor and never changes in any train record: a free swing, or a column gone wrong
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


def resting(record: Record) -> tuple[str, ...]:
    """Outputs of joints that stand still in a record while another joint moves: none spreads beyond its noise."""

    def still(values: np.ndarray) -> bool:
        fine = max(estimate_noise(values), quantisation_step(values)) if np.ptp(values) else np.inf
        return _spread(values) <= RESTS * fine

    joints: dict[str, list[str]] = {}
    for name in record.outputs:
        joints.setdefault(number_of(name), []).append(name)
    rest = [names for names in joints.values() if all(still(record.outputs[name]) for name in names)]
    return () if len(rest) == len(joints) else tuple(name for names in rest for name in names)


def _spread(values: np.ndarray) -> float:
    """Standard deviation of a signal; 0 where only rounding changes it, as it does to one number read many times."""
    spread = float(values.std())
    return spread if spread > ROUNDING * float(np.abs(values).max()) else 0.0


def _resting(dataset: Dataset) -> Iterator[Finding]:
    """One sentence on all joints that stand still somewhere, with the records."""
    where: dict[str, list[str]] = {}
    for record in dataset:
        for name in resting(record):
            where.setdefault(name, []).append(record.name)
    if not where:
        return
    at = {name: tuple(records) for name, records in where.items()}
    said = []
    for records in dict.fromkeys(at.values()):
        names = ", ".join(name for name, found in at.items() if found == records)
        said.append(f"{names} in {'every record' if len(records) == len(dataset.records) else _few(records)}")
    words = (
        f"joints stand still while others move, so that nothing is learnt of their friction there: {'; '.join(said)}; "
        "if one has moved, check its column"
    )
    yield Finding("warning", "rests", words)


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
    spread = _spread(values)
    if spread == 0:
        # one joint of several, say
        held = any(np.ptp(other) for key, other in record.outputs.items() if key != name)
        words = f"it is {values[0]:g} throughout; check its column and its sensor"
        yield "warning" if held else "error", "constant", words
        return
    noise, quantum = noise_of(record, name), quantisation_step(values)
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
    goal = record.inputs.get(f"goal{number_of(name)}") if position else None
    # what no machine does: jumps by a turn, spikes, dead stops but at a goal at which the joint has arrived
    if position and (turns := turns_back(values)).size:
        at = stamp(float(record.time[turns[0]]))
        yield (
            "warning",
            "wrapped",
            f"it jumps by a turn {turns.size} times, first at {at} s; set 'unwrap' for its column",
        )
    if values.size > 4:
        near = np.sort(np.lib.stride_tricks.sliding_window_view(values, 5), axis=1)
        away = np.abs(values[2:-2] - near[:, 2])
        # The closest three of five samples move on as the motion does, which turns within a few samples at times.
        moved = np.min(near[:, 2:] - near[:, :3], axis=1)
        spikes = (away > SPIKE * fine) & (away > 2 * moved)
        if spikes.any():
            at = record.time[np.argmax(spikes) + 2]
            count = spikes.sum()
            stand = (
                "1 sample stands out as a spike,"
                if count == 1
                else f"{count} samples stand out as spikes, first"
            )
            words = (
                f"{stand} at {stamp(at)} s; use '--loss huber', or repair {'it' if count == 1 else 'them'}"
            )
            yield "warning", "spikes", words
    for extreme in (values.max(), values.min()):
        at = find_stop(values, extreme, fine)
        if at is not None and (goal is None or not has_arrived(values, goal, at)):
            words = (
                f"it stops dead at {extreme:.4g}, first at {stamp(record.time[at])} s: an end stop or the sensor's "
                "range; keep clear of it or cut the record with 'between'"
            )
            yield "warning", "clipped", words
    if position and count_turns(values, 5 * fine) == 0:
        words = "it moves in one direction only, so friction cannot be separated from a constant torque; add reversals"
        yield "warning", "one_direction", words
    first = np.diff(values[:3])  # a start at rest that accelerates has a second step three times the first
    if (
        position
        and rest_samples(record) < 3
        and abs(first.sum()) > 6 * fine
        and abs(first[0]) > 2 * abs(np.ptp(first))
    ):
        words = "it is moving at the start, so that its speed there has to be estimated; begin at rest"
        yield "warning", "start_motion", words


def _merged(findings: list[Finding]) -> Iterator[Finding]:
    """Join findings of more than two records into the first of them, which then names the others.

    Those without a number of their own say the same of every channel: records and channels together count.
    """
    groups: dict[tuple[str, str], list[Finding]] = {}
    for finding in findings:
        words = finding.message.partition(": ")[2]
        alike = finding.channel if not words or any(map(str.isdigit, words)) else words
        groups.setdefault((finding.code, alike), []).append(finding)
    for first, *others in groups.values():
        more = dict.fromkeys((o.channel, o.record) for o in others)
        more.pop((first.channel, first.record), None)
        if len(more) < 2:
            yield from (first, *others)
        else:
            records: dict[str, list[str]] = {}
            for channel, record in more:
                records.setdefault(channel, []).append(record)
            places = "; ".join(f"{channel} in {_few(names)}" for channel, names in records.items())
            if list(records) == [first.channel]:  # else the channel is named
                places = f"in {len(more)} more records: {_few(records[first.channel])}"
            yield replace(first, message=f"{first.message} [likewise {places}]")


def _few(names: Sequence[str]) -> str:
    return ", ".join(names[:5]) + (", ..." if len(names) > 5 else "")


LINE = 1e-9
"""Largest distance of a signal from a straight line, over its span, up to which no sensor has measured it."""


def _across_records(dataset: Dataset, channel: Channel) -> Iterator[Finding]:
    """Compare one output over the records, and its noise with the declared one."""
    name, signals = channel.name, [record.outputs[channel.name] for record in dataset]
    spreads = np.array([_spread(values) for values in signals])
    usual = np.median(spreads)
    for record, values, spread in zip(dataset, signals, spreads, strict=True):
        moves = spread > max(RESTS * max(estimate_noise(values), quantisation_step(values)), SLIP * usual)
        if len(spreads) > 2 and moves and not usual / 50 < spread < usual * 50:
            words = (
                f"{record.name}, {name}: it varies by {spread:.2g} where the other records vary by {usual:.2g}; "
                "check its unit"
            )
            yield Finding("warning", "scale", words, record.name, name)
    levels = [noise_of(record, name) for record in dataset if record.n_samples >= KNOWN]
    noise = float(np.median(levels)) if levels else 0.0
    if channel.noise_std and noise and not 1 / 3 < noise / channel.noise_std < 3:
        words = (
            f"{name}: noise_std is {channel.noise_std:.2g} in the dataset file but the records show {noise:.2g}; "
            "correct it or leave it out"
        )
        drowned = channel.noise_std > spreads.max() > 0  # no fit could see the signal
        senseless = drowned or channel.noise_std < noise / TOO_SURE
        yield Finding("error" if senseless else "warning", "noise_std", words, channel=name)


KNOWN = 24
"""Samples of a record from which its noise is known well enough to doubt a declared one."""
TOO_SURE = 1000.0
"""Noise of the records over the declared one from which every fit would follow the noise."""
MIN_SAMPLES = 200
SLOW_STEP = 0.2  # s; hardly anybody samples a drive that slowly, but 5 kHz stamped in ms looks like it
STEPS = 5e-6, 1.0  # s; no drive is sampled faster or slower, so that the stamps are in another unit
STAMPS = ((1e2, "ms", "unit: ms"), (1e5, "us", "unit: us"), (np.inf, "ns", "scale: 1.0e-9"))
"""Units of stamps by the step below which they explain one that is too long, and what says so."""
UNEQUAL = 10.0  # ratio of two records' steps


def absurd_steps(dataset: Dataset) -> list[Finding]:
    """Find steps that cannot be meant: no simulation may meet them, it would not end."""
    found = [finding for record in dataset for finding in check_sampling(record)]
    return [one for one in found if one.severity == "error" and one.code in ("slow_step", "fast_step")]


def check_sampling(record: Record) -> Iterator[Finding]:
    """Check one record's stamps."""
    name, step = record.name, record.sample_time
    if record.n_samples < MIN_SAMPLES:
        words = f"{name} has {record.n_samples} samples; record longer, at least {MIN_SAMPLES}"
        yield Finding("warning", "short", words, name)
    if step >= SLOW_STEP:
        unit, key = next((u, k) for most, u, k in STAMPS if step < most)
        words = (
            f"{record.title}: its samples are {step:.4g} s apart, too far for most drives; if its stamps are in "
            f"{unit}, set 't: {{column: t, {key}}}' under 'columns' in the dataset file"
        )
        yield Finding("error" if step >= STEPS[1] else "warning", "slow_step", words, name)
    if step < STEPS[0]:
        words = (
            f"{record.title}: its samples are {step:.4g} s apart, closer than any drive is sampled; correct 'unit' and "
            "'scale' of t under 'columns' in the dataset file: stamps in seconds need neither"
        )
        yield Finding("error", "fast_step", words, name)
    if gaps := find_gaps(record):
        places = "place" if len(gaps) == 1 else "places"
        longest = np.floor(max(length for _, length in gaps) / step) + 1
        words = (
            f"{record.title}: samples are missing at {len(gaps)} {places}, first after {stamp(gaps[0][0])} s for "
            f"{1e3 * gaps[0][1]:.3g} ms ({gaps[0][1] / step:.0f} steps), and a fit would take the input as held "
            f"meanwhile; cut the record there with 'between', or bridge it with 'resample: {{max_gap: {longest:.0f}}}'"
        )
        yield Finding("error", "gap", words, name)
    elif not record.is_uniform:
        steps = np.diff(record.time)
        words = (
            f"{name}: stamps are {1e3 * steps.min():.3g} to {1e3 * steps.max():.3g} ms apart (median "
            f"{1e3 * step:.3g} ms, spread {steps.std() / step:.1%}) and are used as they are; "
            "'resample: true' makes them uniform"
        )
        yield Finding("info", "jitter", words, name)


TOGETHER = 0.9
"""Correlation over the records from which two conditions count as one: less than a fifth of either is its own."""
FEWEST = 4
"""Records below which any two conditions may go together by chance."""
STEADY = 0.1
"""Largest share of a channel's variance that lies within the records where it is a condition of each."""


def record_conditions(records: Sequence[Record]) -> dict[str, np.ndarray]:
    """Conditions of records by name, one number a record, ``(R,)``; only what differs between them.

    Numbers of the records' meta (payload, controller gain, temperature), and the means of input channels that hardly
    change within a record. What has the numbers of an earlier condition is the same one under another name.
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
    """Pairs of conditions that change together over the records, each in a sentence without its full stop."""
    if len(records) < FEWEST:
        return
    for (one, first), (other, second) in combinations(record_conditions(records).items(), 2):
        correlation = float(np.corrcoef(first, second)[0, 1])
        if abs(correlation) >= TOGETHER:
            way = "rise together" if correlation > 0 else "go opposite ways"
            yield (
                f"what {one} does from what {other} does: they {way} (correlation {correlation:.2f} over "
                f"{len(records)} records)"
            )


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and bool(np.isfinite(value))


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
