"""A twin of EMPS, a linear axis of 95 kg on a ball screw, whose friction differs by direction.

Source of structure and values: A. Janot, M. Gautier, M. Brunot, Data set and reference models of EMPS, Workshop on
Nonlinear System Identification Benchmarks, 2019. The directions' difference and the disturbance are ours.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np

from hybrid_id import Record

STEP = 1e-3  # s, of controller and simulation


def records(axis: Mapping[str, Any], sample_time: float) -> list[Record]:
    """Records of a position-controlled axis that moves between rests, logged as force and position."""
    found = []
    for k in range(axis["records"]):
        rng = np.random.default_rng([axis["seed"], k])
        goal = strokes(axis, rng)
        force, position = simulate(axis, goal, disturbance(axis, len(goal), rng))
        position = position + axis["encoder_step"] * (rng.random(len(position)) - 0.5)
        every = round(sample_time / STEP)
        count = len(force) // every
        mean = force[: count * every].reshape(count, every).mean(1)
        time = sample_time * np.arange(count)
        found.append(Record(f"run_{k}", time, {"tau1": mean}, {"q_m1": position[: count * every : every]}))
    return found


def strokes(axis: Mapping[str, Any], rng: np.random.Generator) -> np.ndarray:
    """Goal [m], ``(T,)``: to and fro by trapezoids of speed, with a rest after each."""
    parts, here = [np.zeros(round(axis["rest"] / STEP))], 0.0
    while sum(map(len, parts)) * STEP < axis["duration"]:
        speed, length = rng.uniform(*axis["speed"]), rng.uniform(*axis["length"])
        rise = speed / axis["acceleration"]
        t = np.arange(0.0, length / speed + rise, STEP)
        rate = np.clip(np.minimum(t / rise, (t[-1] - t) / rise), 0.0, 1.0)
        way = np.cumsum(rate) / rate.sum() * (length if here <= 0.0 else -length)
        parts += [here + way, np.full(round(axis["rest"] / STEP), here + way[-1])]
        here = float(here + way[-1])
    return np.concatenate(parts)


def disturbance(axis: Mapping[str, Any], count: int, rng: np.random.Generator) -> np.ndarray:
    """Slow force that no channel logs [N], ``(T,)``: a first-order Gauss-Markov process."""
    memory = np.exp(-STEP / axis["disturbance_time"])
    kicks = np.sqrt(1.0 - memory**2) * axis["disturbance"] * rng.standard_normal(count)
    found = np.empty(count)
    level = axis["disturbance"] * rng.standard_normal()
    for k, kick in enumerate(kicks):
        level = memory * level + kick
        found[k] = level
    return found


def simulate(axis: Mapping[str, Any], goal: np.ndarray, extra: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Force command [N] and position [m], both ``(T,)``; dry friction stops within a step, as an impulse."""
    mass, position, speed = axis["M"], float(goal[0]), 0.0
    force, path = np.empty(len(goal)), np.empty(len(goal))
    for k, aim in enumerate(goal):
        command = axis["speed_gain"] * (axis["position_gain"] * (aim - position) - speed)
        command = min(max(command, -axis["limit"]), axis["limit"])
        force[k], path[k] = command, position
        viscous = axis["F_v"] * (1.0 + (axis["asymmetry"] if speed > 0.0 else -axis["asymmetry"]))
        free = speed + STEP / mass * (command - axis["offset"] - extra[k] - viscous * speed)
        speed = float(np.sign(free)) * max(abs(free) - STEP / mass * axis["F_c"], 0.0)
        position += STEP * speed
    return force, path


def cut(record: Record) -> list[Record]:
    """The strokes of a record, each from the middle of a rest to the middle of the next."""
    moving = np.abs(np.gradient(record.outputs["q_m1"], record.time)) > 2e-3
    edges = np.flatnonzero(np.diff(moving.astype(int)))
    begins, ends = edges[::2], edges[1::2]
    middles = [0, *((ends[:-1] + begins[1:]) // 2), len(moving) - 1]
    return [
        Record(
            f"{record.name}_stroke_{n}",
            record.time[a : b + 1],
            {"tau1": record.inputs["tau1"][a : b + 1]},
            {"q_m1": record.outputs["q_m1"][a : b + 1]},
            record.role,
        )
        for n, (a, b) in enumerate(pairwise(middles))
    ]
