"""From the commanded voltage to the torque on the rotor: amplifier, winding, magnets."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from hybrid_id.machines.physics.law import Lanes, Law, Push, Signals


@dataclass
class Motor:
    """``tau = P_1 (u - P_2 v)``, with a warming resistance and a lagging current as options.

    | symbol | meaning | unit |
    | --- | --- | --- |
    | P_1, P_2 | torque per volt, back-EMF | N m/V, V s/rad |
    | lag | L / R of the winding, 0: none | s |
    | heating | rise of R / R_0 - 1 per second and square of the torque | 1/(N m)^2/s |
    | cooling | time constant of its fall | s |
    """

    P_1: Lanes
    P_2: Lanes
    lag: Lanes | None = None
    heating: Lanes | None = None
    cooling: Lanes = 1.0
    _torque: np.ndarray = field(default_factory=lambda: np.zeros(1), repr=False)
    _warmth: np.ndarray = field(default_factory=lambda: np.zeros(1), repr=False)

    def start(self, lanes: int) -> None:
        """Cold, and without current."""
        self._torque, self._warmth = np.zeros(lanes), np.zeros(lanes)

    def act(self, push: Push, x: Signals) -> None:
        """Set torque and electrical damping, the first of what acts on a rotor.

        The lagging current is stepped exactly for a held voltage.
        """
        gain = self.P_1
        if self.heating is not None:
            gain = gain / (1 + self._warmth)
        if self.lag is None:
            push.torque, push.slope = gain * x.volts, gain * self.P_2
            x.effort = gain * (x.volts - self.P_2 * x.v_m)
        else:
            static = gain * (x.volts - self.P_2 * x.v_m)
            rate = x.step / np.maximum(self.lag, 1e-9)
            decay = np.exp(-rate)
            mean = static + (self._torque - static) * (-np.expm1(-rate) / rate)
            self._torque = static + (self._torque - static) * decay
            push.torque = mean
            x.effort = mean
        if self.heating is not None:
            self._warmth = self._warmth + x.step * (self.heating * x.effort**2 - self._warmth / self.cooling)


@dataclass
class Cogging(Law):
    """``tau = -sum_i A_i sin(n_i q_m + phi_i)``: magnets that prefer some rotor angles; A [N m]."""

    amplitudes: Sequence[Lanes]
    periods: Sequence[float]
    phases: Sequence[float]

    def act(self, push: Push, x: Signals) -> None:
        for amplitude, periods, phase in zip(self.amplitudes, self.periods, self.phases, strict=True):
            push.torque = push.torque - amplitude * np.sin(periods * x.q_m + phase)


@dataclass
class Servo(Motor):
    """``tau = gain (goal - q_a)``: a position servo whose encoder sits at the joint; gain 0 gives the command itself.

    The command is a goal [rad], or a torque [N m]; gain [N m/rad].
    """

    P_1: Lanes = 0.0
    P_2: Lanes = 0.0
    gain: Lanes = 0.0

    def act(self, push: Push, x: Signals) -> None:
        follows = not (isinstance(self.gain, float) and self.gain == 0.0)
        push.torque = x.effort = self.gain * (x.volts - x.q_a) if follows else x.volts + 0.0
