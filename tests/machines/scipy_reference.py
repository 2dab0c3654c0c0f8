"""The same machines through scipy's adaptive solver with its own event location: slow, and the check on speed."""

import numpy as np
from scipy.integrate import solve_ivp

from hybrid_id.machines.physics.stick_slip import MAX_SWITCHES, StickSlip


def integrate_scipy(
    system: StickSlip,
    start: np.ndarray,
    inputs: np.ndarray,
    time: np.ndarray,
    *,
    rtol: float = 1e-10,
    atol: float = 1e-12,
) -> np.ndarray:
    """Simulate one run with DOP853, restarted at each sample and at each switch.

    Args:
        system: the machine, with parameters for one run.
        start: (n_x,) state at the first time stamp.
        inputs: (T, n_inputs), held over each sample.
        time: (T,) s.
        rtol: relative tolerance of a step.
        atol: absolute tolerance of a step.

    Returns:
        (T, n_x) states at the time stamps.
    """
    x = np.asarray(start, dtype=float)[:, None]
    mode = system.initial_mode(x)
    states = [x[:, 0]]
    for k in range(len(time) - 1):
        u = inputs[k][:, None]
        x, mode = system.solve_sticking(x, mode, u, mode == 0)
        x, mode = _one_sample(system, x, mode, u, (time[k], time[k + 1]), rtol, atol)
        states.append(x[:, 0])
    return np.array(states)


def _one_sample(system: StickSlip, x, mode, u, span, rtol: float, atol: float):
    """Solve over one sample with a held input, from switch to switch."""
    begin, end = span
    for _ in range(MAX_SWITCHES):
        solution = solve_ivp(
            lambda t, y, mode=mode: system.rate(y[:, None], mode, u)[:, 0],
            (begin, end),
            x[:, 0],
            method="DOP853",
            events=[_event(system, mode, u, axis, begin) for axis in range(len(mode))],
            rtol=rtol,
            atol=atol,
        )
        x, begin = solution.y[:, -1:], solution.t[-1]
        if solution.status != 1:
            return x, mode
        fired = np.array([[times.size > 0] for times in solution.t_events])
        x, mode = system.solve_sticking(x, mode, u, fired | (mode == 0))
    raise RuntimeError(f"more than {MAX_SWITCHES} switches between stick and slip within one sample")


def _event(system: StickSlip, mode, u, axis: int, begin: float):
    """The guard of one axis in the form that `solve_ivp` stops at.

    Over the elapsed time, so that an axis that has just left its rest, at a guard of zero, does not stop there again.
    """

    def guard(t: float, y: np.ndarray) -> float:
        return float(system.guards(y[:, None], mode, u)[axis, 0]) / (t - begin) if t > begin else 1.0

    guard.terminal = True  # type: ignore[attr-defined]
    guard.direction = -1  # type: ignore[attr-defined]
    return guard
