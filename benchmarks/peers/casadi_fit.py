"""CasADi: RK4 as symbolic expressions, `mapaccum` over a segment, `map` over segments, Levenberg-Marquardt outside.

Two ways to the derivatives, and two ways to evaluate them:
- `jacobian`: of the segment's simulation, by CasADi's own differentiation (its documented use);
- `sensitivities=True`: sensitivity equations of an RK4 step written out by the user and simulated along;
- interpreted by CasADi's virtual machine, or C code generated, built with `gcc -O3` and loaded.
"""

from __future__ import annotations

import subprocess
import tempfile
from pathlib import Path

import casadi as ca
import numpy as np

from benchmarks.peers import lifted
from benchmarks.peers.settings import LENGTH
from benchmarks.reference import SAMPLE_TIME, SMOOTHING, SUB_STEPS, Array, Problem


def acceleration(v, u, theta):
    inertia, p_m1, p_m2, f_11, f_12, f_13, f_14, f_21, f_22, f_23, f_24, f_3 = ca.vertsplit(theta)
    base, peak, speed, width = (
        ca.if_else(v > 0, one, two) for one, two in ((f_11, f_21), (f_12, f_22), (f_13, f_23), (f_14, f_24))
    )
    level = base + (peak - base) * ca.exp(-(((ca.fabs(v) - speed) / width) ** 2))
    return (p_m1 * (u - p_m2 * v) - level * ca.tanh(v / SMOOTHING) - f_3 * v) / inertia


def runge_kutta(state, u, theta):
    """One step of (q, v)."""
    h = SAMPLE_TIME / SUB_STEPS
    q, v = ca.vertsplit(state)
    k1 = acceleration(v, u, theta)
    k2 = acceleration(v + h / 2 * k1, u, theta)
    k3 = acceleration(v + h / 2 * k2, u, theta)
    k4 = acceleration(v + h * k3, u, theta)
    return ca.vertcat(q + h * v + h * h / 6 * (k1 + k2 + k3), v + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4))


def segment_by_jacobian() -> ca.Function:
    """(parameters and start (14,), voltage (1, L)) -> outputs (L + 1,), sensitivities (L + 1, 14)."""
    state, u, theta = ca.SX.sym("x", 2), ca.SX.sym("u"), ca.SX.sym("p", 12)
    following = state
    for _ in range(SUB_STEPS):
        following = runge_kutta(following, u, theta)
    sample = ca.Function("sample", [state, u, theta], [following])
    free, voltage = ca.MX.sym("w", 14), ca.MX.sym("u", 1, LENGTH)
    states = sample.mapaccum(LENGTH)(free[12:], voltage, ca.repmat(free[:12], 1, LENGTH))
    outputs = ca.vertcat(states[0, :].T, states[1, -1])
    return ca.Function("segment", [free, voltage], [outputs, ca.densify(ca.jacobian(outputs, free))])


def segment_by_sensitivities() -> ca.Function:
    """The same, with the step's sensitivity equations in the simulated state."""
    state, u, theta, sensitivity = (
        ca.SX.sym("x", 2),
        ca.SX.sym("u"),
        ca.SX.sym("p", 12),
        ca.SX.sym("s", 2, 14),
    )
    following = runge_kutta(state, u, theta)
    by_state, by_theta = ca.jacobian(following, state), ca.jacobian(following, theta)
    moved = by_state @ sensitivity + ca.horzcat(by_theta, ca.SX(2, 2))
    augmented = ca.vertcat(state, ca.vec(sensitivity))
    step = ca.Function("step", [augmented, u, theta], [ca.cse(ca.vertcat(following, ca.vec(moved)))])
    z, u, theta = ca.MX.sym("z", 30), ca.MX.sym("u"), ca.MX.sym("p", 12)
    end = z
    for _ in range(SUB_STEPS):
        end = step(end, u, theta)
    sample = ca.Function("sample", [z, u, theta], [end])
    free, voltage = ca.MX.sym("w", 14), ca.MX.sym("u", 1, LENGTH)
    start = ca.vertcat(free[12:], ca.DM(24, 1), ca.vec(ca.DM.eye(2)))
    states = sample.mapaccum(LENGTH)(start, voltage, ca.repmat(free[:12], 1, LENGTH))
    outputs = ca.vertcat(states[0, :].T, states[1, -1])
    sensitivities = ca.vertcat(states[2::2, :].T, states[3::2, -1].T)
    return ca.Function("segment", [free, voltage], [outputs, sensitivities])


def built(function: ca.Function, folder: Path) -> ca.Function:
    """The function as compiled C code."""
    source, library = folder / f"{function.name()}.c", folder / f"{function.name()}.so"
    function.generate(source.name, {"with_header": False})
    Path(source.name).replace(source)
    subprocess.run(["gcc", "-O3", "-fPIC", "-shared", str(source), "-o", str(library)], check=True)
    return ca.external(function.name(), str(library))


def prepare(problem: Problem, *, generated: bool = False, sensitivities: bool = False):
    segment = segment_by_sensitivities() if sensitivities else segment_by_jacobian()
    n_segments = problem.voltage.shape[1] // LENGTH
    function = segment.map(n_segments)
    if generated:
        with tempfile.TemporaryDirectory() as folder:
            function = built(function, Path(folder))

    def solve(problem: Problem):
        voltages = [ca.DM(u.reshape(1, -1)) for u in problem.voltage]

        def segments(record: int, theta: Array, states: Array) -> tuple[Array, Array]:
            free = np.vstack([np.repeat(theta[:, None], n_segments, axis=1), states.T])
            outputs, columns = function(free, voltages[record])
            return outputs.full().T, columns.full().T.reshape(n_segments, 14, LENGTH + 1)

        return lifted.solve(problem, segments)

    return solve
