"""Figures that a record gives away about its sensors: noise, quantisation, rest at the start, turning points."""

from math import comb
from weakref import WeakKeyDictionary

import numpy as np

from hybrid_id.records.dataset import Dataset
from hybrid_id.records.derivatives import noise_level
from hybrid_id.records.record import Record
from hybrid_id.records.units import stem

ORDER = 6  # of the differences that leave the noise and take the motion away
BLOCKS = 40
STUCK = 10  # samples in a row at one extreme
DRIVES = ("u", "duty", "tau", "i")  # stems of the inputs that push the motor
_AT_REST: WeakKeyDictionary[Record, int] = WeakKeyDictionary()
_NOISE: WeakKeyDictionary[Record, dict[str, float]] = WeakKeyDictionary()
_SPREAD: WeakKeyDictionary[Record, dict[str, float]] = WeakKeyDictionary()


def quantisation_step(values: np.ndarray) -> float:
    """Return the step of which all differences of a signal are multiples, or 0 for a continuous signal.

    Args:
        values: Signal, shape (T,).
    """
    levels = np.unique(values)
    steps = np.diff(levels)
    steps = steps[steps > 1e-9 * max(np.ptp(values), 1e-300)]  # below: rounding of one and the same level
    if steps.size == 0:
        return 0.0
    multiples = steps / steps.min()
    step = float(steps.sum() / np.round(multiples).sum())
    on_grid = np.abs(steps / step - np.round(steps / step)) < 0.05
    return step if np.mean(on_grid) > 0.95 and levels.size < 0.9 * values.size else 0.0


def less_half_a_count(error: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """Return an error of a free run without the offset of up to half a count that no reading can tell.

    Where in a count the run began is not measured, whether an encoder rounds or counts edges.

    Args:
        error: Of the run, (T,).
        measured: The output, (T,).
    """
    within = 0.5 * quantisation_step(measured)
    return error - np.clip(error.mean(), -within, within)


def estimate_noise(values: np.ndarray) -> float:
    """Estimate the standard deviation of a sensor's noise from one signal, in its unit.

    Differences of order n of white noise have the variance C(2n, n)*sigma^2, while those of a motion that is slow
    against the sampling vanish (Rice, Ann. Statist. 12(4), 1984, for n = 1). The median over blocks keeps spikes
    and fast moments out. Quantisation error follows the motion where the sensor is fine, so that
    differences miss it; it counts with the least that it is, step/sqrt(12).

    Args:
        values: Signal, (T,), about uniformly sampled.
    """
    floor = quantisation_step(values) / np.sqrt(12)
    if values.size < 4 * ORDER:
        return float(floor)
    squares = np.diff(values, ORDER) ** 2 / comb(2 * ORDER, ORDER)
    blocks = np.array_split(squares, min(BLOCKS, squares.size // ORDER))
    # The median of a block's mean square lies a little under its mean; blocks are long enough to neglect it.
    return float(max(floor, np.sqrt(np.median([block.mean() for block in blocks]))))


def noise_of(record: Record, output: str) -> float:
    """Standard deviation of the noise that one output of a record shows, estimated once; 0 where it never changes."""
    known = _NOISE.setdefault(record, {})
    if output not in known:
        values = record.outputs[output]
        known[output] = float(noise_level(values)) if values.size > ORDER else 0.0
    return known[output]


def spread_of(record: Record, output: str) -> float:
    """Standard deviation of one output of a record, computed once; exactly 0 where it never changes."""
    known = _SPREAD.setdefault(record, {})
    if output not in known:
        values = record.outputs[output]
        known[output] = float(np.std(values)) if np.ptp(values) > 0 else 0.0
    return known[output]


def sensor_noise(dataset: Dataset) -> dict[str, float]:
    """Standard deviation of each output's noise: as declared, or the root mean square of what train records show.

    Where a joint moves slowly, samples between an encoder's counts have often been interpolated, and a record shows
    next to no noise; so not the median. 0 where no record shows any.

    Args:
        dataset: all of its records count where it has no train record.
    """
    found = {}
    for channel in dataset.outputs:
        shown = [noise_of(r, channel.name) for r in dataset.train or dataset.records]
        found[channel.name] = channel.noise_std or float(np.sqrt(np.mean(np.square(shown))))
    return found


def rest_samples(record: Record) -> int:
    """Count the first samples that are taken at rest; at least 1. Counted once a record, however often it is asked.

    At rest means: every voltage, duty, torque or current is zero and no
    output leaves its noise. Where a motion ends that stretch (an arm let go), only its first quarter counts,
    in which such a motion has gone a sixteenth of the way. The sample at which the input sets in still
    shows the rest, but it is left out, since its stamp may lag behind the input.
    """
    if record not in _AT_REST:
        drives = [name for name in record.inputs if stem(name) in DRIVES]
        pushed = np.zeros(record.n_samples, dtype=bool)
        for name in drives:
            pushed |= record.inputs[name] != 0
        quiet = int(np.argmax(pushed)) if pushed.any() else record.n_samples
        if not drives or quiet <= 1:
            _AT_REST[record] = 1
        else:
            for values in record.outputs.values():
                start = values[:quiet]
                left = np.abs(start - np.median(start[:5])) > 6 * max(
                    estimate_noise(values), quantisation_step(values)
                )
                if left.any():
                    quiet = min(quiet, max(1, int(np.argmax(left)) // 4))
            _AT_REST[record] = quiet
    return _AT_REST[record]


def count_turns(values: np.ndarray, threshold: float) -> int:
    """Count how often a signal changes between rising and falling, by more than `threshold` each time."""
    blocks = np.array_split(values, min(400, values.size))
    path = np.array([block.mean() for block in blocks])
    turns, direction, extreme = 0, 0, path[0]
    for value in path:
        if direction * (value - extreme) >= 0 and direction:
            extreme = value
        elif abs(value - extreme) > threshold:
            turns += direction != 0
            direction, extreme = (1 if value > extreme else -1), value
    return turns


def stretches(mask: np.ndarray) -> np.ndarray:
    """Return (first, one past the last) sample of every stretch of True in (T,), shape (n, 2)."""
    return np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])))).reshape(-1, 2)


def find_stop(values: np.ndarray, extreme: float, fine: float) -> int | None:
    """Return the sample at which a signal runs at speed into an extreme and stays there, or None.

    At speed means a tenth of what it often reaches: dry friction, too, holds a motion that turns, but slowly.

    Args:
        values: Signal, (T,).
        extreme: Its greatest or least value.
        fine: Noise or quantisation step, whichever is greater, in the signal's unit.
    """
    moves = np.abs(values[3:] - values[:-3])
    least = max(6 * fine, 0.1 * float(np.quantile(moves, 0.9))) if moves.size else np.inf
    for start, stop in stretches(values == extreme):
        if stop - start >= STUCK and start >= 3 and moves[start - 3] > least:
            return int(start)
    return None


def has_arrived(values: np.ndarray, goal: np.ndarray, at: int) -> bool:
    """Return whether a joint stops at a sample because its goal is there, and rests or turns.

    There means within a tenth of how far the goal moves, and anywhere where it never moves; it rests or turns where it
    goes less far, from shortly before to shortly after, than a third of what it does in that time where it is fastest.

    Args:
        values: Angle, (T,).
        goal: Its goal, (T,).
        at: Number of the sample.
    """
    if np.abs(values[at] - goal[at]) > 0.1 * np.ptp(goal) > 0.0:
        return False
    moves = np.abs(goal[2 * STUCK :] - goal[: -2 * STUCK])
    around = np.abs(goal[min(at + STUCK, goal.size - 1)] - goal[max(at - STUCK, 0)])
    return bool(moves.size and around <= np.quantile(moves, 0.99) / 3.0)
