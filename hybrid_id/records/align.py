"""Channels that one file stamps apart, such as the topics of a bag, brought to the stamps of its time column.

An input is held: at each stamp it has the last value that came before, however long ago. An output is interpolated
linearly. Samples before the first value of a channel, or after the last one of an output, are left out.
"""

from collections.abc import Collection, Mapping

import numpy as np

from hybrid_id.errors import InputError
from hybrid_id.records.record import stamp
from hybrid_id.records.resample import refuse_turns


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
    """Bring signals with stamps of their own to the common stamps.

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
