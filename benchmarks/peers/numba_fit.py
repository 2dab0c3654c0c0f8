"""Hand-written numba: lifted multiple shooting, Levenberg-Marquardt, forward sensitivities coded by hand.

The strongest peer: a kernel for this one law and nothing else. Each RK4 step is differentiated exactly: since the
speed does not depend on the angle, a scalar backward sweep through the four stages gives the weight of each
stage's partial derivatives, and the sensitivities (2 x 14) advance once a step. Records are fitted one after
another, segments of 25 samples are condensed on the fly onto 12 parameters and the start state.
"""

from __future__ import annotations

import math

import numba
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
from benchmarks.reference import (
    BOUNDS,
    DECREMENT,
    SAMPLE_TIME,
    SMOOTHING,
    STOP,
    SUB_STEPS,
    TRUTH,
    Estimate,
    Problem,
)

H = SAMPLE_TIME / SUB_STEPS
compiled = numba.njit(fastmath=True, error_model="numpy")


@compiled
def stage(v, u, theta, p):
    """Acceleration and its derivative by v; the partial derivatives that are not trivial go to p (5,).

    p: those by the active side's four friction parameters, and the side (0 or 4).
    """
    side = 0 if v > 0.0 else 4
    speed = abs(v)
    base, peak, centre, width = theta[3 + side], theta[4 + side], theta[5 + side], theta[6 + side]
    z = (speed - centre) / width
    bump = math.exp(-z * z)
    drop = (peak - base) * bump
    level = base + drop
    sign = math.tanh(v / SMOOTHING)
    slope = -2.0 * z * drop / width
    inverse = 1.0 / theta[0]
    a = (theta[1] * (u - theta[2] * v) - level * sign - theta[11] * v) * inverse
    a_v = -(
        theta[1] * theta[2]
        + (slope if v > 0.0 else -slope) * sign
        + level * (1.0 - sign * sign) / SMOOTHING
        + theta[11]
    )
    p[0] = -(1.0 - bump) * sign * inverse
    p[1] = -bump * sign * inverse
    p[2] = slope * sign * inverse
    p[3] = slope * z * sign * inverse
    return a, a_v * inverse, side


@compiled
def add(target, weight, v, k, side, p):
    """Adds a stage's partial derivatives, with its weight, to target (12,) (voltage and scale terms come later)."""
    target[0] += weight * k
    target[1] += weight
    target[2] += weight * v
    for i in range(4):
        target[3 + side + i] += weight * p[i]


@compiled
def finish(target, u, theta):
    """Turns the sums of weight x (k, 1, v) into derivatives by J, P_m1, P_m2 and f_3."""
    inverse = 1.0 / theta[0]
    weights, speeds = target[1], target[2]
    target[0] *= -inverse
    target[1] = (weights * u - theta[2] * speeds) * inverse
    target[2] = -theta[1] * speeds * inverse
    target[11] = -speeds * inverse


@compiled
def advance(q, v, u, theta, s_q, s_v, p, b_q, b_v):
    """One RK4 step with the sensitivities s_q, s_v (14,) by 12 parameters and the segment's start (q, v)."""
    k1, a1, d1 = stage(v, u, theta, p[0])
    v2 = v + 0.5 * H * k1
    k2, a2, d2 = stage(v2, u, theta, p[1])
    v3 = v + 0.5 * H * k2
    k3, a3, d3 = stage(v3, u, theta, p[2])
    v4 = v + H * k3
    k4, a4, d4 = stage(v4, u, theta, p[3])
    # backward sweep of v+ = v + H/6 (k1 + 2 k2 + 2 k3 + k4)
    w4 = H / 6.0
    w3 = H / 3.0 + H * a4 * w4
    w2 = H / 3.0 + 0.5 * H * a3 * w3
    w1 = H / 6.0 + 0.5 * H * a2 * w2
    v_v = 1.0 + a1 * w1 + a2 * w2 + a3 * w3 + a4 * w4
    # and of q+ = q + H v + H^2/6 (k1 + k2 + k3)
    x3 = H * H / 6.0
    x2 = x3 + 0.5 * H * a3 * x3
    x1 = x3 + 0.5 * H * a2 * x2
    q_v = H + a1 * x1 + a2 * x2 + a3 * x3
    b_q[:] = 0.0
    b_v[:] = 0.0
    add(b_v, w1, v, k1, d1, p[0])
    add(b_v, w2, v2, k2, d2, p[1])
    add(b_v, w3, v3, k3, d3, p[2])
    add(b_v, w4, v4, k4, d4, p[3])
    add(b_q, x1, v, k1, d1, p[0])
    add(b_q, x2, v2, k2, d2, p[1])
    add(b_q, x3, v3, k3, d3, p[2])
    finish(b_v, u, theta)
    finish(b_q, u, theta)
    for i in range(12):
        s_q[i] += q_v * s_v[i] + b_q[i]
        s_v[i] = v_v * s_v[i] + b_v[i]
    s_q[13] += q_v * s_v[13]
    s_v[13] *= v_v
    return q + H * v + H * H / 6.0 * (k1 + k2 + k3), v + H / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)


@compiled
def linearise(u, y, theta, states, scale, closing, maps, hessian, gradient):
    """Normal equations of one record in 12 parameters (units of scale) and the start state; (squares, merit).

    closing: the segments' states follow the parameters so that the gaps close (lifted shooting, condensed); else
    they are held and the gaps are residuals like the others (short-horizon prediction, the first phase).
    maps: (S, 2, 15), linear from (parameters, start state, 1) to each segment's change of state.
    """
    n_segments = len(states)
    hessian[:] = 0.0
    gradient[:] = 0.0
    maps[:] = 0.0
    if closing:
        maps[0, 0, 12] = maps[0, 1, 13] = 1.0
    p, b_q, b_v = np.empty((4, 5)), np.empty(12), np.empty(12)
    s_q, s_v, column = np.empty(14), np.empty(14), np.empty(15)
    squares, gaps = 0.0, 0.0
    weight = GAP_WEIGHT_CLOSING if closing else GAP_WEIGHT_HELD
    for segment in range(n_segments):
        q, v = states[segment]
        s_q[:] = 0.0
        s_v[:] = 0.0
        s_q[12] = s_v[13] = 1.0
        m = maps[segment]
        for k in range(segment * LENGTH, (segment + 1) * LENGTH):
            residual = q - y[k]
            squares += residual * residual
            for i in range(15):
                column[i] = m[0, i] + s_q[13] * m[1, i]
            for i in range(12):
                column[i] += s_q[i] * scale[i]
            column[14] += residual
            for i in range(14):
                gradient[i] += column[i] * column[14]
                for j in range(i + 1):
                    hessian[i, j] += column[i] * column[j]
            for _ in range(SUB_STEPS):
                q, v = advance(q, v, u[k], theta, s_q, s_v, p, b_q, b_v)
        if segment + 1 == n_segments:
            break
        gap_q, gap_v = q - states[segment + 1, 0], v - states[segment + 1, 1]
        gaps += (weight[0] * gap_q) ** 2 + (weight[1] * gap_v) ** 2
        if closing:
            following = maps[segment + 1]
            for i in range(15):
                following[0, i] = m[0, i] + s_q[13] * m[1, i]
                following[1, i] = s_v[13] * m[1, i]
            for i in range(12):
                following[0, i] += s_q[i] * scale[i]
                following[1, i] += s_v[i] * scale[i]
            following[0, 14] += gap_q
            following[1, 14] += gap_v
        else:
            for i in range(12):
                row_q, row_v = weight[0] ** 2 * s_q[i] * scale[i], weight[1] ** 2 * s_v[i] * scale[i]
                gradient[i] += row_q * gap_q + row_v * gap_v
                for j in range(i + 1):
                    hessian[i, j] += (row_q * s_q[j] + row_v * s_v[j]) * scale[j]
    if not closing:
        hessian[12, 12] = hessian[13, 13] = 1.0
    for i in range(14):
        for j in range(i):
            hessian[j, i] = hessian[i, j]
    return squares, squares + gaps


@compiled
def bounded_step(hessian, gradient, damping, lower, upper):
    """Marquardt step (14,); parameters that would leave their bounds stop there and the others are solved again."""
    matrix, step = hessian.copy(), np.zeros(14)
    free = np.ones(14, dtype=np.bool_)
    for i in range(12):
        matrix[i, i] += damping * (hessian[i, i] + 1e-9)
    while True:
        index = np.flatnonzero(free)
        right = -gradient[index]
        for i in np.flatnonzero(~free):
            right -= matrix[index, i] * step[i]
        step[index] = np.linalg.solve(matrix[index][:, index], right)
        outside = (step[:12] < lower) | (step[:12] > upper)
        if not (outside & free[:12]).any():
            return step
        for i in np.flatnonzero(outside & free[:12]):
            step[i] = min(max(step[i], lower[i]), upper[i])
            free[i] = False


@compiled
def free_run(u, y, theta, q, v):
    """Sum of squares of the simulation from one start state."""
    p = np.empty((4, 5))
    squares = 0.0
    for k in range(len(u)):
        squares += (q - y[k]) ** 2
        for _ in range(SUB_STEPS):
            k1, _, _ = stage(v, u[k], theta, p[0])
            k2, _, _ = stage(v + 0.5 * H * k1, u[k], theta, p[0])
            k3, _, _ = stage(v + 0.5 * H * k2, u[k], theta, p[0])
            k4, _, _ = stage(v + H * k3, u[k], theta, p[0])
            q += H * v + H * H / 6.0 * (k1 + k2 + k3)
            v += H / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return squares


@compiled
def fit(u, y, start, states, goal, tolerance, lower, upper):
    """One record, until the free run's sum of squares is at most `goal` and its promised fall at most `tolerance`."""
    scale = start.copy()
    maps, trial_maps = np.empty((len(states), 2, 15)), np.empty((len(states), 2, 15))
    hessian, trial_hessian = np.empty((14, 14)), np.empty((14, 14))
    gradient, trial_gradient = np.empty(14), np.empty(14)
    theta, closing, damping, length = start.copy(), False, FIRST_DAMPING, 1.0
    squares, merit = linearise(u, y, theta, states, scale, closing, maps, hessian, gradient)
    evaluations = 1
    while evaluations < MAX_ITERATIONS and damping < 1e8:
        low, high = (
            np.maximum(lower, (1.0 - LARGEST_STEP) * theta),
            np.minimum(upper, (1.0 + LARGEST_STEP) * theta),
        )
        step = bounded_step(hessian, gradient, damping, (low - theta) / scale, (high - theta) / scale)
        promised = -np.dot(gradient, step)
        if not closing and promised < HELD_TOLERANCE * merit:
            closing, damping = True, 1e-6
            squares, merit = linearise(u, y, theta, states, scale, closing, maps, hessian, gradient)
            evaluations += 1
            continue
        if (
            closing
            and squares <= goal
            and promised <= tolerance
            and free_run(u, y, theta, states[0, 0], states[0, 1]) <= goal
        ):
            break
        trial = theta + length * step[:12] * scale
        trial_states = states.copy()
        for segment in range(len(states)):
            for row in range(2):
                change = np.dot(maps[segment, row, :14], step) + maps[segment, row, 14]
                trial_states[segment, row] += length * change
        trial_squares, trial_merit = linearise(
            u, y, trial, trial_states, scale, closing, trial_maps, trial_hessian, trial_gradient
        )
        evaluations += 1
        if trial_merit < merit:
            theta, states, squares, merit = trial, trial_states, trial_squares, trial_merit
            maps, trial_maps = trial_maps, maps
            hessian, trial_hessian = trial_hessian, hessian
            gradient, trial_gradient = trial_gradient, gradient
            damping, length = max(0.1 * damping, 1e-9), 1.0
        elif closing:
            damping, length = 2.0 * damping, 0.5 * length
        else:
            damping *= 10.0
    return theta, states[0], evaluations


def solve(problem: Problem) -> Estimate:
    states = np.ascontiguousarray(boundary_states(problem.angle, LENGTH))
    goal = problem.angle.shape[1] * (STOP * problem.floor) ** 2
    fits = [
        fit(u, y, start, state, bound, DECREMENT * floor**2, BOUNDS[0] * TRUTH, BOUNDS[1] * TRUTH)
        for u, y, start, state, bound, floor in zip(
            problem.voltage, problem.angle, problem.starts, states, goal, problem.floor, strict=True
        )
    ]
    theta, start, iterations = (np.array(column) for column in zip(*fits, strict=True))
    return Estimate(theta, start, iterations)


def prepare(problem: Problem):
    """Compiles by solving the first record."""
    solve(problem.head(1))
    return solve
