"""Levenberg-Marquardt for peers that only supply derivatives of segments: the algorithm of `numba_fit`, not fused.

A peer gives `segments(record, parameters, states) -> (outputs (S, L + 1), sensitivities (S, 14, L + 1))`: the angle
after each of the L samples of each segment and the speed after the last, and their derivatives by the twelve
parameters and the segment's start (q, v). Condensing is numpy, about 1 ms a record, so that a cold start needs no
compiler but the peer's own.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.peers.settings import (
    FIRST_DAMPING,
    GAP_WEIGHT_CLOSING,
    GAP_WEIGHT_HELD,
    HELD_TOLERANCE,
    LARGEST_STEP,
    LENGTH,
    MAX_ITERATIONS,
    boundary_states,
)
from benchmarks.reference import BOUNDS, DECREMENT, STOP, TRUTH, Array, Estimate, Problem

Segments = Callable[[int, Array, Array], tuple[Array, Array]]


def condense(y: Array, states: Array, outputs: Array, sensitivities: Array, scale: Array, *, closing: bool):
    """(squares, merit, maps, hessian, gradient) of one record in 12 parameters (units of scale) and the start state.

    closing, maps: as in `numba_fit.linearise`.
    """
    n_segments, length = outputs.shape[0], outputs.shape[1] - 1
    weight = np.array(GAP_WEIGHT_CLOSING if closing else GAP_WEIGHT_HELD)
    unit = np.concatenate([scale, [1.0, 1.0]])[:, None]
    at_start = np.zeros((n_segments, 14, 1))
    at_start[:, 12] = 1.0
    columns = np.concatenate([at_start, sensitivities[:, :, : length - 1] * unit], axis=2)  # (S, 14, L)
    residual = np.concatenate([states[:, :1], outputs[:, : length - 1]], axis=1) - y.reshape(
        n_segments, length
    )
    gaps = outputs[:-1, length - 1 :] - states[1:]
    end = (sensitivities[:-1, :, length - 1 :] * unit).transpose(0, 2, 1)  # (S - 1, 2, 14)
    squares = (residual**2).sum()
    merit = squares + ((weight * gaps) ** 2).sum()
    local_hessian = columns @ columns.transpose(0, 2, 1)
    local_gradient = (columns @ residual[:, :, None])[:, :, 0]
    maps = np.zeros((n_segments, 2, 15))
    if not closing:
        weighted = (weight[:, None] * end)[:, :, :12].reshape(-1, 12)
        hessian, gradient = np.eye(14), np.zeros(14)
        hessian[:12, :12] = local_hessian[:, :12, :12].sum(axis=0) + weighted.T @ weighted
        gradient[:12] = local_gradient[:, :12].sum(axis=0) + weighted.T @ (weight * gaps).ravel()
        return squares, merit, maps, hessian, gradient
    maps[0, 0, 12] = maps[0, 1, 13] = 1.0
    fresh = np.concatenate([end[:, :, :12], np.zeros((n_segments - 1, 2, 2)), gaps[:, :, None]], axis=2)
    by_state = end[:, :, 12:]
    for segment in range(n_segments - 1):
        maps[segment + 1] = by_state[segment] @ maps[segment] + fresh[segment]
    lift = np.zeros((n_segments, 14, 15))
    lift[:, :12, :12] = np.eye(12)
    lift[:, 12:] = maps
    total = (lift.transpose(0, 2, 1) @ (local_hessian @ lift)).sum(axis=0)
    shift = (lift.transpose(0, 2, 1) @ local_gradient[:, :, None]).sum(axis=0)[:, 0]
    return squares, merit, maps, total[:14, :14], total[:14, 14] + shift[:14]


def bounded_step(hessian: Array, gradient: Array, damping: float, lower: Array, upper: Array) -> Array:
    """Marquardt step (14,); parameters that would leave their bounds stop there and the others are solved again."""
    matrix, step, free = hessian.copy(), np.zeros(14), np.ones(14, dtype=bool)
    matrix[range(12), range(12)] += damping * (np.diag(hessian)[:12] + 1e-9)
    while True:
        step[free] = np.linalg.solve(
            matrix[np.ix_(free, free)], -gradient[free] - matrix[np.ix_(free, ~free)] @ step[~free]
        )
        outside = free.copy()
        outside[:12] &= (step[:12] < lower) | (step[:12] > upper)
        outside[12:] = False
        if not outside.any():
            return step
        step[:12] = np.where(outside[:12], np.clip(step[:12], lower, upper), step[:12])
        free &= ~outside


def fit(problem: Problem, record: int, states: Array, segments: Segments) -> tuple[Array, Array, int]:
    """One record: (parameters, start state, evaluations)."""
    y, start = problem.angle[record], problem.starts[record]
    goal = len(y) * (STOP * problem.floor[record]) ** 2
    lower, upper = BOUNDS[0] * TRUTH, BOUNDS[1] * TRUTH

    def linearise(theta: Array, states: Array, closing: bool):
        return condense(y, states, *segments(record, theta, states), start, closing=closing)

    theta, closing, damping, length = start, False, FIRST_DAMPING, 1.0
    squares, merit, maps, hessian, gradient = linearise(theta, states, closing)
    evaluations = 1
    while evaluations < MAX_ITERATIONS and damping < 1e8:
        low, high = (
            np.maximum(lower, (1 - LARGEST_STEP) * theta),
            np.minimum(upper, (1 + LARGEST_STEP) * theta),
        )
        step = bounded_step(hessian, gradient, damping, (low - theta) / start, (high - theta) / start)
        promised = -gradient @ step
        if not closing and promised < HELD_TOLERANCE * merit:
            closing, damping = True, 1e-6
            squares, merit, maps, hessian, gradient = linearise(theta, states, closing)
            evaluations += 1
            continue
        joined = closing and merit <= 1.001 * squares  # no gaps: the segments are the free run
        if joined and squares <= goal and promised <= DECREMENT * problem.floor[record] ** 2:
            break
        trial = theta + length * step[:12] * start
        trial_states = states + length * (maps[:, :, :14] @ step + maps[:, :, 14])
        point = linearise(trial, trial_states, closing)
        evaluations += 1
        if point[1] < merit:
            theta, states = trial, trial_states
            squares, merit, maps, hessian, gradient = point
            damping, length = max(0.1 * damping, 1e-9), 1.0
        elif closing:
            damping, length = 2.0 * damping, 0.5 * length
        else:
            damping *= 10.0
    return theta, states[0], evaluations


def solve(problem: Problem, segments: Segments) -> Estimate:
    """All records, one after another."""
    states = np.ascontiguousarray(boundary_states(problem.angle, LENGTH))
    fits = [fit(problem, record, states[record], segments) for record in range(problem.n_records)]
    return Estimate(*(np.array(column) for column in zip(*fits, strict=True)))
