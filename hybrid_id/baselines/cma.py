"""Baseline: an evolution strategy over what calibrations of robots fit: gain, damping, armature, friction, and a delay.

These are the nominal model's own parameters, with a dead time of each joint's command; of a robot joint by joint, the
others as they were measured. Nothing else can be missing: it names a delay that is longer than a sample.

Source: N. Hansen, The CMA Evolution Strategy: A Tutorial, arXiv 1604.00772, 2016, with its default constants.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np

from hybrid_id.baselines.answer import answer, gap_of, named
from hybrid_id.baselines.by_joint import Part, joined, parts_of
from hybrid_id.components.input.delay import Delay
from hybrid_id.diagnosis.errors_on_test import errors
from hybrid_id.diagnosis.fits import engine
from hybrid_id.errors import InputError
from hybrid_id.records.dataset import Dataset
from hybrid_id.systems.chain import System

CANDIDATES = 144
"""Models that are simulated, of each joint."""
WIDTH = 0.2
"""First standard deviation, of logarithms of parameters and of a delay in tenths of a second."""
REACH = 3.0
"""Largest change of a parameter's logarithm."""
SLOWEST = 0.1
"""What a delay is measured by [s]."""
LOST = 1e12
"""Cost of a model that cannot be simulated."""


def cma(dataset: Dataset, system: System) -> dict[str, Any]:
    """Fit the nominal model's parameters and delays, and name the delays that are longer than a sample."""
    found, step = [], dataset.train[0].sample_time
    for part in parts_of(dataset, system):
        late = part.system
        for joint in part.system.joints:
            if f"{joint.name}/input/delay" not in late.components:
                late = late.with_component(f"{joint.name}/input", Delay(T_d=0.0))
        found.append((part, *fitted(part, late)))
    found.sort(key=lambda own: -own[2])  # the joint with the largest improvement first
    delays = [
        (part.placed(info.component.rpartition("/")[0]), info.spec.value)
        for part, model, _ in found
        for info in model.table
        if info.symbol == "T_d"
    ]
    delays.sort(key=lambda own: own[1] <= step)
    effects = [named("delay", where, float(size > step), selected=size > step) for where, size in delays]
    after = joined(system, [model for _, model, _ in found])
    return answer(dataset.name, effects, gap_of(dataset, system, after, after))


def fitted(part: Part, start: System) -> tuple[System, float]:
    """A model with the best of the parameters that were tried, and by what factor its error on train records fell."""
    infos = [info for info in start.table if info.spec.estimate]

    def model(x: np.ndarray) -> System:
        values = {}
        for info, own in zip(infos, x, strict=True):
            spec = info.spec
            if info.symbol == "T_d":
                value = SLOWEST * abs(own)
            else:
                value = spec.value * float(np.exp(np.clip(own, -REACH, REACH)))
            values[info.name] = float(np.clip(value, spec.lower, spec.upper))
        return start.with_values(values)

    def cost(x: np.ndarray) -> float:
        with suppress(InputError, RuntimeError):
            found = errors(part.dataset, model(x), engine(), part.dataset.train)
            return LOST if found is None or not np.isfinite(found.over_noise) else found.over_noise
        return LOST

    best = evolved(cost, np.zeros(len(infos)), WIDTH, CANDIDATES)
    nominal = errors(part.dataset, part.system, engine(), part.dataset.train)
    return model(best), 1.0 if nominal is None else nominal.over_noise / max(cost(best), 1e-300)


def evolved(
    cost: Callable[[np.ndarray], float], mean: np.ndarray, width: float, most: int, seed: int = 0
) -> np.ndarray:
    """The best point ``(n,)`` that an evolution strategy with an adapted covariance has seen.

    Args:
        cost: what is to be small.
        mean: where it starts, ``(n,)``.
        width: first standard deviation.
        most: points that are tried, about.
        seed: of its draws.
    """
    n, rng = len(mean), np.random.default_rng(seed)
    children = 4 + int(3 * np.log(n))
    weights = np.log((children + 1) / 2) - np.log(np.arange(1, children // 2 + 1))
    weights = weights / weights.sum()
    parents = 1 / float(np.sum(weights**2))
    c_sigma = (parents + 2) / (n + parents + 5)
    damping = 1 + c_sigma + 2 * max(0.0, np.sqrt((parents - 1) / (n + 1)) - 1)
    c_path = (4 + parents / n) / (n + 4 + 2 * parents / n)
    c_1 = 2 / ((n + 1.3) ** 2 + parents)
    c_mu = min(1 - c_1, 2 * (parents - 2 + 1 / parents) / ((n + 2) ** 2 + parents))
    typical = np.sqrt(n) * (1 - 1 / (4 * n) + 1 / (21 * n**2))
    spread, path, path_sigma = np.eye(n), np.zeros(n), np.zeros(n)
    best, least = mean, cost(mean)
    for _ in range(max(1, most // children)):
        squares, axes = np.linalg.eigh(spread)
        roots = np.sqrt(np.maximum(squares, 1e-20))
        steps = rng.standard_normal((children, n)) * roots @ axes.T
        costs = np.array([cost(mean + width * step) for step in steps])
        order = np.argsort(costs)
        if costs[order[0]] < least:
            best, least = mean + width * steps[order[0]], float(costs[order[0]])
        chosen = steps[order[: len(weights)]]
        move = weights @ chosen
        mean = mean + width * move
        whitened = axes @ ((axes.T @ move) / roots)
        path_sigma = (1 - c_sigma) * path_sigma + np.sqrt(c_sigma * (2 - c_sigma) * parents) * whitened
        path = (1 - c_path) * path + np.sqrt(c_path * (2 - c_path) * parents) * move
        spread = (1 - c_1 - c_mu) * spread + c_1 * np.outer(path, path)
        spread = spread + c_mu * np.einsum("k,ki,kj->ij", weights, chosen, chosen)
        width *= float(np.exp(c_sigma / damping * (np.linalg.norm(path_sigma) / typical - 1)))
    return best
