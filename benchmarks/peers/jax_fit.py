"""JAX: a scan over a segment's samples, differentiated forwards, jitted; Levenberg-Marquardt outside.

Two ways to the derivatives: `vmap` over segments of `jacfwd` (the idiom), and, with `lanes_last=True`, segments
written as the last axis by hand with `vmap` over the 14 tangents only, which XLA's CPU code runs several times
faster. One record (200 segments) a call, since records end after different numbers of iterations.
"""

from __future__ import annotations

import os

os.environ.setdefault(
    "XLA_FLAGS",
    "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1 --xla_force_host_platform_device_count=1",
)
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.peers import lifted
from benchmarks.peers.settings import LENGTH
from benchmarks.reference import SAMPLE_TIME, SMOOTHING, SUB_STEPS, Array, Problem

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_platforms", "cpu")


def acceleration(v, u, theta):
    inertia, p_m1, p_m2, f_11, f_12, f_13, f_14, f_21, f_22, f_23, f_24, f_3 = theta
    forward = v > 0
    base, peak = jnp.where(forward, f_11, f_21), jnp.where(forward, f_12, f_22)
    speed, width = jnp.where(forward, f_13, f_23), jnp.where(forward, f_14, f_24)
    level = base + (peak - base) * jnp.exp(-(((jnp.abs(v) - speed) / width) ** 2))
    return (p_m1 * (u - p_m2 * v) - level * jnp.tanh(v / SMOOTHING) - f_3 * v) / inertia


def simulate(free, voltage):
    """Outputs (L + 1, ...) from (parameters, start) (14, ...) and voltages (L, ...) of one or many segments."""
    theta, h = free[:12], SAMPLE_TIME / SUB_STEPS

    def sample(state, u):
        q, v = state
        for _ in range(SUB_STEPS):
            k1 = acceleration(v, u, theta)
            k2 = acceleration(v + h / 2 * k1, u, theta)
            k3 = acceleration(v + h / 2 * k2, u, theta)
            k4 = acceleration(v + h * k3, u, theta)
            q = q + h * v + h * h / 6 * (k1 + k2 + k3)
            v = v + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return (q, v), q

    (_, speed), angles = jax.lax.scan(sample, (free[12], free[13]), voltage)
    return jnp.concatenate([angles, speed[None]])


@jax.jit
def by_jacfwd(theta, states, voltage):
    """Outputs (S, L + 1) and sensitivities (S, 14, L + 1) of one record with voltages (S, L)."""
    free = jnp.concatenate([jnp.broadcast_to(theta, (len(states), 12)), states], axis=1)

    def with_outputs(free, voltage):
        outputs = simulate(free, voltage)
        return outputs, outputs

    columns, outputs = jax.vmap(jax.jacfwd(with_outputs, has_aux=True))(free, voltage)
    return outputs, columns.transpose(0, 2, 1)


@jax.jit
def by_lanes(theta, states, voltage):
    """The same, segments last inside."""
    free = jnp.concatenate([jnp.broadcast_to(theta[:, None], (12, len(states))), states.T])
    directions = jnp.broadcast_to(jnp.eye(14)[:, :, None], (14, *free.shape))

    def derivative(direction):
        return jax.jvp(lambda point: simulate(point, voltage.T), (free,), (direction,))

    outputs, columns = jax.vmap(derivative, out_axes=(None, 0))(directions)
    return outputs.T, columns.transpose(2, 0, 1)


def prepare(problem: Problem, *, lanes_last: bool = False):
    """Compiles for the record's length."""
    linearise = by_lanes if lanes_last else by_jacfwd
    n_segments = problem.voltage.shape[1] // LENGTH

    def solve(problem: Problem):
        voltages = [jnp.asarray(u.reshape(n_segments, LENGTH)) for u in problem.voltage]

        def segments(record: int, theta: Array, states: Array) -> tuple[Array, Array]:
            outputs, columns = linearise(theta, states, voltages[record])
            return np.asarray(outputs), np.asarray(columns)

        return lifted.solve(problem, segments)

    linearise(
        problem.starts[0], np.zeros((n_segments, 2)), jnp.asarray(problem.voltage[0].reshape(n_segments, -1))
    )
    return solve
