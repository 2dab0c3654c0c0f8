"""Fourth-order time stepping of the same machines, for laws without memory: switching instants are located.

Moreau's rule in `machine` carries any law at one evaluation a step, and is of second order. Where a machine serves as
the truth of a published campaign, motion is a hybrid automaton (stick, slip forwards, slip backwards) instead.
Between two switches it is smooth and a classical Runge-Kutta step of fourth order applies. A step that would carry a
sliding joint through zero speed is cut at the instant of the crossing, found on the step itself; the joint then
sticks, reverses or goes on, and the rest of the step follows in the new mode. So the order is kept at every switch.
"""

from itertools import product
from typing import Any

import numpy as np

from hybrid_id.machines.physics.law import Push
from hybrid_id.machines.physics.machine import Machine, joined

MAX_SWITCHES = 20
"""Switches allowed within one step of one run; more means that the machine contradicts itself."""
HYSTERESIS = 1e-8
"""Share by which a torque must exceed friction to wake a joint at rest, so that rounding wakes nothing."""


class StickSlip:
    """A machine as differential equations, one set for each mode of its joints; B runs lie in the last axis.

    The state x (n_x, B) holds angle and speed of each rotor [rad, rad/s], those of its link behind them where a spring
    parts the two. The mode (n_joints, B) is -1 (the rotor slides backwards), 0 (sticks) or +1 (slides forwards). Inputs
    u (2 n_joints, B) are voltages [V], then disturbing torques on the rotors [N m], held over a sample.

    Two joints act on each other through the mass matrix M, so that which of those at rest stick is decided for both at
    once: all pairs of stick, forwards and backwards are tried, and since M is positive definite exactly one of them
    holds. A joint at rest holds as long as the torque lies within its friction at zero speed, each side its own.

    The machine has no law with memory, no amplifiers, no errors of its gears, and a spring with one link alone.
    """

    def __init__(self, machine: Machine) -> None:
        self.machine, self.drives = machine, machine.drives
        for drive in self.drives:
            drive.start(1, np.zeros(1))
        self.at = [2 * i for i in range(len(self.drives))]  # rows of the rotors' angles
        first = self.drives[0]
        link = (
            0.0
            if first.spring is not None
            else machine.links.mass([np.zeros(1)] * 2)[0] / first.gear.ratio**2
        )
        self.lone: list[list[Any]] = [[first.rotor + link]]  # inertia of a rotor without a second joint

    def rate(self, x: np.ndarray, mode: np.ndarray, u: np.ndarray) -> np.ndarray:
        """State derivative (n_x, B) in the given mode, smooth even where the mode just ceases to hold."""
        pushes, mass = self._acting(x, u)
        found = np.empty_like(x)
        for at, a in zip(self.at, self._motion(pushes, mass, x, mode)[0], strict=True):
            found[at], found[at + 1] = x[at + 1], a
        if len(x) > 2 * len(self.at):  # the link behind its spring
            link, J_a = self.drives[0].link_push, self.machine.links.mass([x[2]])[0]
            found[2], found[3] = x[3], (link.torque - link.slope * x[3]) / J_a
        return found

    def guards(self, x: np.ndarray, mode: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Speed of each rotor in its direction of sliding, or the room that its friction has (n_joints, B).

        Not negative as long as the mode holds.
        """
        sliding = mode * x[1 : 2 * len(self.at) : 2]
        rest = mode == 0
        if not rest.any():
            return sliding
        pushes, mass = self._acting(x, u)
        held = self._motion(pushes, mass, x, mode)[1]
        slack = [HYSTERESIS * (1 + HYSTERESIS) * push.plus for push in pushes]
        room = [_room(push, torque) + more for push, torque, more in zip(pushes, held, slack, strict=True)]
        return np.where(rest, np.array(room), sliding)

    def solve_sticking(
        self, x: np.ndarray, mode: np.ndarray, u: np.ndarray, at_rest: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """State and mode after the joints marked in `at_rest`, bool (n_joints, B), have come to zero speed."""
        if not at_rest.any():
            return x, mode
        x = x.copy()
        x[1 : 2 * len(self.at) : 2][at_rest] = 0.0
        pushes, mass = self._acting(x, u)
        best, most = mode, np.full(x.shape[1], -np.inf)
        for sides in product((0.0, 1.0, -1.0), repeat=len(self.at)):
            trial = np.where(at_rest, np.array(sides)[:, None], mode)
            accelerations, held = self._motion(pushes, mass, x, trial)
            fit = [
                np.where(side == 0, _room(push, torque), side * a * mass[i][i])
                for i, (push, torque, side, a) in enumerate(
                    zip(pushes, held, trial, accelerations, strict=True)
                )
            ]
            least = np.where(at_rest, np.array(fit), np.inf).min(axis=0)
            best, most = np.where(least > most, trial, best), np.maximum(least, most)
        return x, best

    def initial_mode(self, x: np.ndarray) -> np.ndarray:
        """Mode (n_joints, B) that the speeds of a start state call for."""
        return np.sign(x[1 : 2 * len(self.at) : 2])

    def _acting(self, x: np.ndarray, u: np.ndarray) -> tuple[list[Push], list[list[Any]]]:
        """What pushes each rotor, with its link where both are one body, and the mass matrix at the rotors' shafts."""
        drives, count = self.drives, len(self.drives)
        for i, drive in enumerate(drives):
            s, at = drive.x, 2 * i
            s.q_m, s.v_m, s.command = x[at], x[at + 1], u[i]
            if drive.spring is not None:
                s.q_a, s.v_a = x[at + 2], x[at + 3]
            drive.act()
            drive.rotor_push.torque = drive.rotor_push.torque + u[count + i]
        if count == 1:
            alone = drives[0].spring is not None or not drives[0].link_laws
            return [drives[0].rotor_push if alone else joined(drives[0], 0.0)], self.lone
        angles, speeds = [d.x.q_a for d in drives], [d.x.v_a for d in drives]
        m_11, m_12, m_22 = self.machine.links.mass(angles)
        bias = self.machine.links.bias(angles, speeds)
        pushes = [joined(d, b) for d, b in zip(drives, bias, strict=True)]
        g = [d.slope for d in drives]
        cross = g[0] * g[1] * m_12
        own = [d.rotor + ratio**2 * m for d, ratio, m in zip(drives, g, (m_11, m_22), strict=True)]
        return pushes, [[own[0], cross], [cross, own[1]]]

    def _motion(
        self, pushes: list[Push], mass: list[list[Any]], x: np.ndarray, mode: np.ndarray
    ) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Accelerations of the rotors (B,) in a mode, and the torques (B,) that friction holds in those that stick."""
        driven = [
            push.torque - push.slope * x[at + 1] - side * np.where(side > 0, push.plus, push.minus)
            for push, at, side in zip(pushes, self.at, mode, strict=True)
        ]
        if len(driven) == 1:
            return [np.where(mode[0] == 0, 0.0, driven[0] / mass[0][0])], driven
        slides = [side != 0 for side in mode]
        (m_11, m_12), (_, m_22) = mass
        felt = m_12 * (slides[0] & slides[1])  # between two joints that both move
        determinant = m_11 * m_22 - felt**2
        a_1 = slides[0] * (m_22 * driven[0] - felt * driven[1]) / determinant
        a_2 = slides[1] * (m_11 * driven[1] - felt * driven[0]) / determinant
        return [a_1, a_2], [driven[0] - m_12 * a_2, driven[1] - m_12 * a_1]


def _room(push: Push, held: np.ndarray) -> np.ndarray:
    """How far (B,) the torque that friction holds at rest lies inside its limits; negative outside."""
    return np.minimum((1 + HYSTERESIS) * push.plus - held, (1 + HYSTERESIS) * push.minus + held)


def integrate(
    system: StickSlip, start: np.ndarray, inputs: np.ndarray, time: np.ndarray, *, substeps: int = 10
) -> np.ndarray:
    """Simulate B runs over the same time stamps.

    Args:
        system: the machine, with parameters for B runs.
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
    mode = system.initial_mode(x)
    for k, sample_time in enumerate(np.diff(time)):
        x, mode = advance(system, x, mode, inputs[k], sample_time, substeps=substeps)
        states[k + 1] = x
    return states


def advance(
    system: StickSlip, x: np.ndarray, mode: np.ndarray, u: np.ndarray, sample_time: float, *, substeps: int
) -> tuple[np.ndarray, np.ndarray]:
    """State (n_x, B) and mode (n_axes, B) after one sample with its inputs u (n_inputs, B) held."""
    x, mode = system.solve_sticking(x, mode, u, mode == 0)
    for _ in range(substeps):
        x, mode = _step(system, x, mode, u, sample_time / substeps)
    return x, mode


def _runge_kutta(system: StickSlip, x: np.ndarray, mode: np.ndarray, u: np.ndarray, h) -> np.ndarray:
    """One classical Runge-Kutta step of length h, a number or (B,), within one mode."""
    k1 = system.rate(x, mode, u)
    k2 = system.rate(x + (0.5 * h) * k1, mode, u)
    k3 = system.rate(x + (0.5 * h) * k2, mode, u)
    k4 = system.rate(x + h * k3, mode, u)
    return x + (h / 6) * (k1 + k4 + 2 * (k2 + k3))


def _step(
    system: StickSlip, x: np.ndarray, mode: np.ndarray, u: np.ndarray, h: float
) -> tuple[np.ndarray, np.ndarray]:
    """One step of all runs, each from switch to switch; one without a switch left has no time left either."""
    remaining = np.full(x.shape[1], h)
    for _ in range(MAX_SWITCHES):
        whole = _runge_kutta(system, x, mode, u, remaining)
        switching = system.guards(whole, mode, u).min(axis=0) < 0
        if not switching.any():
            return whole, mode
        elapsed = _first_switch(system, x, mode, u, remaining, whole)
        x = _runge_kutta(system, x, mode, u, elapsed)
        guards = system.guards(x, mode, u)
        fired = np.arange(len(guards))[:, None] == guards.argmin(axis=0)
        x, mode = system.solve_sticking(x, mode, u, (fired | (mode == 0)) & switching)
        remaining = remaining - elapsed
    raise RuntimeError(f"more than {MAX_SWITCHES} switches between stick and slip within one step")


def _first_switch(
    system: StickSlip,
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
    g_low = system.guards(x, mode, u).min(axis=0)
    g_high = system.guards(whole, mode, u).min(axis=0)
    from_rest = (g_low <= 0) & (g_high < 0)

    def least_guard(elapsed: np.ndarray) -> np.ndarray:
        g = system.guards(_runge_kutta(system, x, mode, u, elapsed), mode, u).min(axis=0)
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
