"""Voltages and references that move a robot: what test engineers command, and what robots do at work."""

from collections.abc import Callable

import numpy as np

RESTING = 0.1
"""Time at the start of each record without voltage [s]."""

Wave = Callable[[np.random.Generator, np.ndarray], np.ndarray]
"""A signal of about unit size over time (T,) [s], zero at its start."""


def multisine(rng: np.random.Generator, time: np.ndarray, low: float = 0.15, high: float = 3.0) -> np.ndarray:
    """Sum of 8 to 14 sines of random phase between two frequencies [Hz], RMS 1, falling with frequency."""
    tones = rng.integers(8, 15)
    frequencies = np.exp(rng.uniform(np.log(low), np.log(high), tones))
    weights = frequencies ** -rng.uniform(0.0, 0.6)
    wave = np.sin(2 * np.pi * np.outer(time, frequencies) + rng.uniform(0, 2 * np.pi, tones)) @ weights
    return fade(time) * wave / np.sqrt(np.sum(weights**2) / 2)


def sweep(rng: np.random.Generator, time: np.ndarray) -> np.ndarray:
    """A sine whose frequency runs exponentially, up or down, between about 0.2 and 5 Hz; peak 1."""
    low, high = rng.uniform(0.15, 0.4), rng.uniform(2.5, 6.0)
    ends = (low, high) if rng.random() < 0.7 else (high, low)
    run = time / time[-1]
    frequency = ends[0] * (ends[1] / ends[0]) ** run
    phase = (
        2 * np.pi * np.concatenate([[0.0], np.cumsum(0.5 * (frequency[1:] + frequency[:-1]) * np.diff(time))])
    )
    return fade(time) * np.sin(phase)


def steps(rng: np.random.Generator, time: np.ndarray) -> np.ndarray:
    """Jumps to random levels within +-1 every 0.5 to 1.5 s."""
    level, wave, until = 0.0, np.zeros_like(time), RESTING
    for k, t in enumerate(time):
        if t >= until:
            until = t + rng.uniform(0.5, 1.5)
            level = _other(rng, level)
        wave[k] = level
    return wave


def trapezoid(rng: np.random.Generator, time: np.ndarray) -> np.ndarray:
    """Moves between random points within +-1 with a trapezoid of speed, and rests between them."""
    return _moves(rng, time, rest=(0.05, 0.5), cruise=rng.uniform(0.2, 0.6))


def pick_and_place(rng: np.random.Generator, time: np.ndarray) -> np.ndarray:
    """The same few points within +-1 again and again, quickly, with a rest at each: a robot at work."""
    points = rng.uniform(-1, 1, rng.integers(2, 5))
    points[np.argmax(np.abs(points))] /= np.max(np.abs(points))
    return _moves(rng, time, rest=(0.2, 0.4), cruise=0.1, points=points)


def slow_reversals(rng: np.random.Generator, time: np.ndarray) -> np.ndarray:
    """A slow sine or triangle between 0.1 and 0.4 Hz of changing size, peak about 1: many reversals near standstill."""
    frequency = rng.uniform(0.12, 0.45)
    angle = 2 * np.pi * frequency * np.maximum(time - RESTING, 0)
    wave = np.sin(angle) if rng.random() < 0.5 else 2 / np.pi * np.arcsin(np.sin(angle))
    if rng.random() < 0.4:
        wave = wave * (0.6 + 0.4 * np.cos(angle / rng.uniform(2, 5)))
    elif rng.random() < 0.5:
        wave = wave + 0.3 * np.sin(rng.uniform(2, 5) * angle)
    return wave


def fade(time: np.ndarray, length: float = 0.15) -> np.ndarray:
    """0 while at rest, then smoothly to 1 within `length` [s]."""
    run = np.clip((time - RESTING) / length, 0, 1)
    return run**2 * (3 - 2 * run)


def _other(rng: np.random.Generator, level: float) -> float:
    """A new level within +-1, at least 0.3 from the last."""
    while True:
        new = rng.uniform(-1, 1)
        if abs(new - level) > 0.3:
            return float(new)


def _moves(
    rng: np.random.Generator,
    time: np.ndarray,
    *,
    rest: tuple[float, float],
    cruise: float,
    points: np.ndarray | None = None,
) -> np.ndarray:
    """Point-to-point moves; `cruise` is the part of a move at full speed, the rest is spent on ramps."""
    at, start, wave, count = 0.0, RESTING, np.zeros_like(time), 0
    while start < time[-1]:
        goal = _other(rng, at) if points is None else float(points[count % len(points)])
        length = max(0.25, rng.uniform(0.5, 1.1) * abs(goal - at))
        run = np.clip((time - start) / length, 0, 1)
        ramp = 0.5 * (1 - cruise)
        peak = 1 / (1 - ramp)
        share = np.where(
            run < ramp,
            0.5 * peak / ramp * run**2,
            np.where(run > 1 - ramp, 1 - 0.5 * peak / ramp * (1 - run) ** 2, peak * (run - 0.5 * ramp)),
        )
        wave = np.where(time >= start, at + (goal - at) * share, wave)
        at, start, count = goal, start + length + rng.uniform(*rest), count + 1
    return wave
