"""Integration of mechanisms with set-valued dry friction, many runs at once.

Between switching instants the motion is smooth and a classical Runge-Kutta step of fourth order applies. A step
that would carry a sliding axis through zero speed is cut at the instant of the crossing, found on the step
itself; the mechanism then says whether the axis sticks, reverses or goes on, and the rest of the step follows in
the new mode. The order of the method is therefore kept across stick and slip.
"""

from typing import Protocol, Self

import numpy as np

#: Switches allowed within one step of one run; more means that the mechanism contradicts itself.
MAX_SWITCHES = 20


class Mechanism(Protocol):
    """What the integrators need to know of a machine; B runs lie side by side in the last axis.

    `mode` is (n_axes, B) with -1 (slides backwards), 0 (sticks) or +1 (slides forwards) for each dry-friction
    axis. Inputs `u` are (n_inputs, B) and held over a sample.
    """

    def rate(self, x: np.ndarray, mode: np.ndarray, u: np.ndarray) -> np.ndarray:
        """State derivative (n_x, B) in the given mode, smooth even where the mode just ceases to hold."""
        ...

    def guards(self, x: np.ndarray, mode: np.ndarray, u: np.ndarray) -> np.ndarray:
        """One number for each axis and run, (n_axes, B): not negative as long as the mode holds."""
        ...

    def settle(
        self, x: np.ndarray, mode: np.ndarray, u: np.ndarray, at_rest: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """State and mode after the axes marked in `at_rest`, bool (n_axes, B), have come to zero speed."""
        ...

    def initial_mode(self, x: np.ndarray) -> np.ndarray:
        """Mode (n_axes, B) that the speeds of a start state call for."""
        ...

    def take(self, lanes: np.ndarray) -> Self:
        """The same machine for a selection of the runs."""
        ...


def integrate(
    mechanism: Mechanism, start: np.ndarray, inputs: np.ndarray, time: np.ndarray, *, substeps: int = 10
) -> np.ndarray:
    """Simulate B runs over the same time stamps.

    Args:
        mechanism: the machine, with parameters for B runs.
        start: (n_x, B) state at the first time stamp.
        inputs: (T, n_inputs, B); sample k is held from time[k] to time[k + 1].
        time: (T,) s.
        substeps: Runge-Kutta steps per sample.

    Returns:
        (T, n_x, B) states at the time stamps.
    """
    x = np.array(start, dtype=float)
    states = np.empty((len(time), *x.shape))
    states[0] = x
    mode = mechanism.initial_mode(x)
    for k, sample_time in enumerate(np.diff(time)):
        x, mode = advance(mechanism, x, mode, inputs[k], sample_time, substeps=substeps)
        states[k + 1] = x
    return states


def advance(
    mechanism: Mechanism, x: np.ndarray, mode: np.ndarray, u: np.ndarray, sample_time: float, *, substeps: int
) -> tuple[np.ndarray, np.ndarray]:
    """State (n_x, B) and mode (n_axes, B) after one sample with its inputs u (n_inputs, B) held."""
    x, mode = mechanism.settle(x, mode, u, mode == 0)
    for _ in range(substeps):
        x, mode = _step(mechanism, x, mode, u, sample_time / substeps)
    return x, mode


def _runge_kutta(mechanism: Mechanism, x: np.ndarray, mode: np.ndarray, u: np.ndarray, h) -> np.ndarray:
    """One classical Runge-Kutta step of length h, a number or (B,), within one mode."""
    k1 = mechanism.rate(x, mode, u)
    k2 = mechanism.rate(x + (0.5 * h) * k1, mode, u)
    k3 = mechanism.rate(x + (0.5 * h) * k2, mode, u)
    k4 = mechanism.rate(x + h * k3, mode, u)
    return x + (h / 6) * (k1 + k4 + 2 * (k2 + k3))


def _step(
    mechanism: Mechanism, x: np.ndarray, mode: np.ndarray, u: np.ndarray, h: float
) -> tuple[np.ndarray, np.ndarray]:
    """One step of all runs; the few with a switch in it are cut at the switch and completed on their own."""
    after = _runge_kutta(mechanism, x, mode, u, h)
    switching = (mechanism.guards(after, mode, u) < 0).any(axis=0)
    if not switching.any():
        return after, mode
    lanes = np.flatnonzero(switching)
    mode = mode.copy()
    after[:, lanes], mode[:, lanes] = _step_with_switches(
        mechanism.take(lanes), x[:, lanes], mode[:, lanes], u[:, lanes], np.full(lanes.size, h)
    )
    return after, mode


def _step_with_switches(
    mechanism: Mechanism, x: np.ndarray, mode: np.ndarray, u: np.ndarray, remaining: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Go through the remaining time (B,) of each run, from switch to switch."""
    for _ in range(MAX_SWITCHES):
        whole = _runge_kutta(mechanism, x, mode, u, remaining)
        switching = mechanism.guards(whole, mode, u).min(axis=0) < 0
        if not switching.any():
            return whole, mode
        elapsed = _first_switch(mechanism, x, mode, u, remaining, whole)
        x = _runge_kutta(mechanism, x, mode, u, elapsed)
        guards = mechanism.guards(x, mode, u)
        fired = (np.arange(len(guards))[:, None] == guards.argmin(axis=0)) & switching
        x, mode = mechanism.settle(x, mode, u, fired | (mode == 0))
        remaining = remaining - elapsed
    raise RuntimeError(f"more than {MAX_SWITCHES} switches between stick and slip within one step")


def _first_switch(
    mechanism: Mechanism,
    x: np.ndarray,
    mode: np.ndarray,
    u: np.ndarray,
    remaining: np.ndarray,
    whole: np.ndarray,
    *,
    tolerance: float = 1e-12,
) -> np.ndarray:
    """Time (B,) at which the least guard of each run falls through zero.

    Regula falsi with the Illinois weights: bracketed, and superlinear on the nearly straight guards of a step. An
    axis that has just left its rest starts at zero: there the guard over the elapsed time has the later root only.
    """
    g_low = mechanism.guards(x, mode, u).min(axis=0)
    g_high = mechanism.guards(whole, mode, u).min(axis=0)
    from_rest = (g_low <= 0) & (g_high < 0)

    def least_guard(elapsed: np.ndarray) -> np.ndarray:
        g = mechanism.guards(_runge_kutta(mechanism, x, mode, u, elapsed), mode, u).min(axis=0)
        return np.where(from_rest, g * remaining / np.maximum(elapsed, np.finfo(float).tiny), g)

    low, high = np.where(g_high < 0, 0.0, remaining), remaining  # an empty bracket where nothing switches
    if from_rest.any():
        low = np.where(from_rest, 1e-6 * remaining, low)
        g_low = np.where(from_rest, least_guard(low), g_low)
        high = np.where(from_rest & (g_low <= 0), low, high)  # back at rest at once
    g_low = np.maximum(g_low, 0.0)
    g_high = np.minimum(g_high, -np.finfo(float).tiny)
    side = np.zeros(low.size)
    middle = low
    for _ in range(60):
        middle = low + (high - low) * g_low / (g_low - g_high)
        g = least_guard(middle)
        if np.all((np.abs(g) < tolerance) | (high - low < 1e-16)):
            break
        is_high = g < 0
        high, g_high = np.where(is_high, middle, high), np.where(is_high, g, g_high)
        low, g_low = np.where(is_high, low, middle), np.where(is_high, g_low, g)
        g_low = np.where(is_high & (side > 0), g_low / 2, g_low)
        g_high = np.where(~is_high & (side < 0), g_high / 2, g_high)
        side = np.where(is_high, 1.0, -1.0)
    return middle
