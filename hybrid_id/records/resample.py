"""Bringing a record with jittered stamps to a uniform grid, with a report of what that did.

Inputs are held between samples, so each new sample takes the time average of the held input over its own
step (the impulse on the motor is kept), or, by `hold`, the value in force at its start. A switch (`enable1`,
only 0 and 1) takes the value in force for the longer part of the step. Outputs are read off at the new
instants by a shape-preserving cubic (modified Akima: Akima, J. ACM 17(4), 1970), which passes through every
sample and does not ring at quantisation steps.

On aliasing: no low-pass filter is applied to the outputs when the new step is longer. A simulation sampled at
the same instants folds its fast parts in the same way as the measurement, whereas a filter would act on one of
them only. What the new grid does not carry is measured instead (`lost`): the RMS of the old samples minus the
new ones interpolated back.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from hybrid_id.errors import InputError
from hybrid_id.records.record import UNIFORM_TOLERANCE, Record, stamp
from hybrid_id.records.units import stem

MAX_GAP = 3.0  # median steps
MOST = 1000  # new samples for each old one: more are a slip of the step, and fill the memory


@dataclass(frozen=True)
class ResampleReport:
    """What resampling did to one record.

    Attributes:
        record: Name of the record.
        message: What was found and done, in words.
        lost: Output -> RMS of what the new grid does not carry, in the output's unit; empty where nothing was touched.
    """

    record: str
    message: str
    lost: Mapping[str, float]


def find_gaps(record: Record, max_gap: float = MAX_GAP) -> tuple[tuple[float, float], ...]:
    """Return (time of the last sample before it, length) of every step above `max_gap` median steps (s)."""
    steps = np.diff(record.time)
    return tuple(
        (float(record.time[k]), float(steps[k])) for k in np.flatnonzero(steps > max_gap * record.sample_time)
    )


def turns_back(values: np.ndarray) -> np.ndarray:
    """Samples at which an angle [rad] of a sensor of one turn begins anew, (N,); (T,) -> empty where it never does."""
    jumps = np.abs(np.diff(values))
    if jumps.size == 0 or np.quantile(jumps, 0.98) >= 1.0:
        return np.empty(0, int)
    return np.flatnonzero(np.abs(jumps - 2 * np.pi) < 1.0) + 1


def refuse_turns(name: str, time: np.ndarray, values: np.ndarray, source: str) -> None:
    """Raise InputError for an angle that is to be read off between samples, and jumps by a turn between two.

    Args:
        name: The output.
        time: Its stamps [s], (T,).
        values: Its values in SI, (T,).
        source: The record or file, to begin the message with.
    """
    if stem(name).startswith("q") and (found := turns_back(values)).size:
        raise InputError(
            f"{source}: '{name}' jumps by a turn, first at {stamp(float(time[found[0]]))} s, and has no value between "
            "the samples there; set 'unwrap' for its column"
        )


def resample_record(
    record: Record,
    sample_time: float | None = None,
    *,
    inputs: Literal["average", "hold"] = "average",
    max_gap: float = MAX_GAP,
) -> tuple[Record, ResampleReport]:
    """Bring a record to a uniform grid that starts at its first stamp.

    Args:
        record: The record; one whose stamps lie on the grid within 1 % of a step is returned unchanged.
        sample_time: New step (s); None takes the median step.
        inputs: `average` of the held input over each new step, or `hold` its value at the start of the step.
        max_gap: Longest step that is bridged, in median steps.

    Raises:
        InputError: when a step is longer than `max_gap` median steps, the new grid has under 2 samples or far more
            than the record, or an angle jumps by a turn.
    """
    step = record.sample_time if sample_time is None else sample_time
    # The tolerance keeps a last stamp that misses its grid point by rounding or slight jitter.
    n_out = int(np.floor(record.duration / step + UNIFORM_TOLERANCE)) + 1
    if n_out < 2:
        raise InputError(
            f"{record.title} lasts {record.duration:g} s, under one step of {step:g} s; shorten the step"
        )
    if n_out > MOST * record.n_samples:
        raise InputError(
            f"{record.title}: a step of {step:g} s makes {n_out:,} samples of {record.n_samples:,}; give a longer one"
        )
    if gaps := find_gaps(record, max_gap):
        raise InputError(
            f"{record.title}: after {stamp(gaps[0][0])} s samples are missing for {1e3 * gaps[0][1]:.3g} ms "
            f"({gaps[0][1] / record.sample_time:.0f} steps, {len(gaps)} gap{'s' * (len(gaps) > 1)} in all); "
            "cut the record there with 'between', or raise 'max_gap'"
        )
    grid = record.time[0] + step * np.arange(n_out)
    changed = n_out != record.n_samples or bool(np.max(np.abs(grid - record.time)) > UNIFORM_TOLERANCE * step)
    new = record
    if changed:
        # past the rounding of stamps, which is coarse where they count from 1970
        in_force = np.searchsorted(record.time, grid + UNIFORM_TOLERANCE * step, side="right") - 1
        held = {name: values[in_force] for name, values in record.inputs.items()}
        mean = {} if inputs == "hold" else {name: _read_off(record, name, grid, step) for name in held}
        outputs = {name: _read_off(record, name, grid, step) for name in record.outputs}
        new = replace(record, time=grid, inputs=held | mean, outputs=outputs)
    common = record.time <= new.time[-1]
    lost = {}
    for name, values in record.outputs.items() if changed else ():
        between = values - np.interp(record.time, new.time, new.outputs[name])
        lost[name] = float(np.sqrt(np.mean(between[common] ** 2)))
    if not changed:
        words = f"{record.name}: already uniform at {1e3 * step:.4g} ms, left as it is"
        return record, ResampleReport(record.name, words, lost)
    steps = np.diff(record.time)
    words = (
        f"{record.name}: resampled from {record.n_samples} samples (step {1e3 * steps.min():.4g} to "
        f"{1e3 * steps.max():.4g} ms, median {1e3 * record.sample_time:.4g} ms, jitter "
        f"{steps.std() / record.sample_time:.1%}) to {n_out} at {1e3 * step:.4g} ms"
    )
    if lost:
        parts = (f"{name} {rms:.2g}" for name, rms in lost.items())
        words += f"; lost between the new samples (RMS): {', '.join(parts)}"
    if gaps := find_gaps(record):
        words += f"; bridged gaps at {', '.join(f'{stamp(t)} s ({1e3 * d:.3g} ms)' for t, d in gaps)}"
    return new, ResampleReport(record.name, words, lost)


def _read_off(record: Record, name: str, instants: np.ndarray, step: float) -> np.ndarray:
    """A channel at other instants [s], (N,): an output between samples, of a held input the mean over a step [s]."""
    if name in record.outputs:
        from scipy.interpolate import Akima1DInterpolator  # slow to import, and most datasets are uniform

        refuse_turns(name, record.time, record.outputs[name], record.title)
        inside = np.clip(instants, record.time[0], record.time[-1])
        return Akima1DInterpolator(record.time, record.outputs[name], method="makima")(inside)
    mean = _mean_of_held(record.time, record.inputs[name], instants, step)
    return np.round(mean) if stem(name) == "enable" else mean


def _mean_of_held(time: np.ndarray, values: np.ndarray, grid: np.ndarray, step: float) -> np.ndarray:
    """Average a held input over [grid, grid + step); the last value is held on. Shapes (T,), (T,), (N,)."""
    stamps = np.append(time, max(time[-1], grid[-1] + step) + step)
    # Offsets from the first value keep a constant input exactly constant.
    integral = np.concatenate(([0.0], np.cumsum((values - values[0]) * np.diff(stamps))))
    return values[0] + (np.interp(grid + step, stamps, integral) - np.interp(grid, stamps, integral)) / step


def shift_channels(record: Record, late: Mapping[str, float]) -> Record:
    """Bring channels that were recorded late to the stamps of the others.

    Outputs are read off between samples as in resampling; a held input takes its average over each step. The samples
    at the ends for which a channel has no value are left out.

    Args:
        record: The record.
        late: Channel -> how late it is recorded [s]; negative where it is early.

    Raises:
        InputError: a skew is longer than the record, or an angle that is recorded late jumps by a turn.
    """
    late = {name: skew for name, skew in late.items() if skew}
    if not late:
        return record
    rounding = UNIFORM_TOLERANCE * record.sample_time
    first = record.time[0] + max(0.0, *(-skew for skew in late.values()))
    last = record.time[-1] - max(0.0, *late.values())
    kept = (record.time >= first - rounding) & (record.time <= last + rounding)
    if kept.sum() < 2:
        name = max(late, key=lambda channel: abs(late[channel]))
        raise InputError(
            f"{record.title} lasts {record.duration:g} s, which a skew of {late[name]:g} s of '{name}' uses up; "
            "correct the skew, which is in seconds"
        )
    time = record.time[kept]

    def shifted(name: str, values: np.ndarray) -> np.ndarray:
        return (
            _read_off(record, name, time + late[name], record.sample_time) if name in late else values[kept]
        )

    return replace(
        record,
        time=time,
        inputs={name: shifted(name, values) for name, values in record.inputs.items()},
        outputs={name: shifted(name, values) for name, values in record.outputs.items()},
    )


def bring_to(
    time: np.ndarray,
    signals: Mapping[str, np.ndarray],
    times: Mapping[str, np.ndarray],
    held: Collection[str],
    *,
    source: str,
    max_gap: float,
    between: tuple[float, float] | None = None,
) -> tuple[slice, dict[str, np.ndarray]]:
    """Bring signals with stamps of their own, such as the topics of a bag, to the common stamps.

    An input is held: at each stamp it has the last value that came before, however long ago. An output is interpolated
    linearly. Samples before the first value of a channel, or after the last one of an output, are left out.

    Args:
        time: The common stamps [s], (T,), increasing.
        signals: Channel -> values, (T,), or (N,) where the channel is in `times`.
        times: Channel -> own stamps [s], (N,).
        held: Channels that are held; the others are interpolated.
        source: The file, to begin a message with.
        max_gap: Longest step of an interpolated channel, in its median steps.
        between: The part of the record that is kept [s], the only one whose gaps count.

    Returns:
        Which of the common stamps have a value of every channel, and the values there.

    Raises:
        InputError: where the stamps of a channel go back, share no time with the others, or leave a gap, and where an
            angle that is interpolated jumps by a turn.
    """
    low, high = -np.inf, np.inf
    for name, own in times.items():
        if (np.diff(own) < 0).any():
            k = int(np.argmax(np.diff(own) < 0)) + 1
            raise InputError(
                f"{source}: the stamps of '{name}' go from {own[k - 1]:.9g} s to {own[k]:.9g} s, but they must "
                "increase; record this channel's topic anew"
            )
        low = max(low, own[0])
        high = high if name in held else min(high, own[-1])
    kept = slice(*np.searchsorted(time, [low, np.nextafter(high, np.inf)]))
    if len(time[kept]) < 2:
        name, own = max(times.items(), key=lambda item: item[1][0])
        raise InputError(
            f"{source}: '{name}' is stamped from {stamp(own[0])} s to {stamp(own[-1])} s where time runs from "
            f"{stamp(time[0])} s to {stamp(time[-1])} s, so that hardly a sample has both; record them by one clock "
            "(simulated time in one topic's headers is another clock than that of the recorder)"
        )
    found = {name: values[kept] for name, values in signals.items() if name not in times}
    first, last = between or (-np.inf, np.inf)
    for name, own in times.items():
        if name in held:
            found[name] = signals[name][np.searchsorted(own, time[kept], side="right") - 1]
            continue
        steps = np.diff(own)
        inside = (own[1:] > max(first, time[kept][0])) & (own[:-1] < min(last, time[kept][-1]))
        gaps = np.flatnonzero(inside & (steps > max_gap * np.median(steps)))
        if gaps.size:
            count = f"{len(gaps)} gap{'s' * (len(gaps) > 1)} in all"
            raise InputError(
                f"{source}: after {stamp(float(own[gaps[0]]))} s '{name}' has no sample for "
                f"{1e3 * steps[gaps[0]]:.3g} ms ({count}); cut the record there with 'between', or raise "
                "'resample: {max_gap: N}'"
            )
        refuse_turns(name, own, signals[name], source)
        found[name] = np.interp(time[kept], own, signals[name])
    return kept, found
