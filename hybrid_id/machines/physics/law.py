"""What a law of a drive reads, and what it gives back."""

from typing import Any

import numpy as np

Lanes = np.ndarray | float
"""One number for all lanes, or one for each of B runs that are integrated side by side, (B,)."""


class Signals:
    """Signals of one joint in the middle of a step, ``(B,)`` each.

    Attributes:
        time, step: middle of the step and its length [s].
        command: voltage that the controller commands [V].
        volts: voltage at the motor's terminals [V].
        q_m, v_m: angle [rad] and speed [rad/s] of the rotor.
        q_a, v_a: angle [rad] and speed [rad/s] of the link.
        rise_m, rise_a: by which the speeds of rotor and link have risen in the step before [rad/s].
        effort: torque of the motor [N m].
        carried: torque through the gear at the motor's side [N m], of the step before.
        history: commands so far, ``(T, B)`` [V], sample k held from k to k + 1.
        sample_time: of the history [s].
    """

    def __init__(self, lanes: int) -> None:
        zero = np.zeros(lanes)
        self.time = self.step = 0.0
        self.command = self.volts = self.effort = self.carried = zero
        self.q_m, self.v_m, self.q_a, self.v_a = (zero.copy() for _ in range(4))
        self.rise_m = self.rise_a = zero
        self.history: Any = np.zeros((0, lanes))
        self.sample_time = 0.0

    def commanded(self, sample: np.ndarray) -> np.ndarray:
        """Commands (B,) [V] held from a sample on, a whole number or one for each lane; the first before all."""
        if not isinstance(self.history, np.ndarray):  # a step that is being written down
            return self.history.at(sample)
        known = np.clip(sample, 0, len(self.history) - 1).astype(int)
        return self.history[known, np.arange(self.history.shape[1])]


class Push:
    """What acts on one body: explicit torque, implicit damping, and the interval of dry friction.

    ``J a = torque - slope v - f`` with ``f in [-minus, plus]``, f = plus at v > 0 and -minus at v < 0.
    """

    __slots__ = ("minus", "plus", "slope", "torque")

    def __init__(self) -> None:
        self.torque: Lanes = 0.0
        self.slope: Lanes = 0.0
        self.plus: Lanes = 0.0
        self.minus: Lanes = 0.0

    def dry(self, level: Lanes) -> None:
        """Add dry friction of equal level in both directions."""
        self.plus = self.plus + level
        self.minus = self.minus + level


class Law:
    """A law of a body, an amplifier or a spring; parameters are attributes, each a `Lanes`, and `start` sets states.

    Attributes:
        on_link: whether it acts on the link, where speed and torque are those of the joint.
        needs_carried: whether it reads the torque through the gear.
    """

    on_link = False
    needs_carried = False

    def start(self, lanes: int) -> None:
        """Set the states of B runs to rest."""

    def act(self, push: Push, x: Signals) -> None:
        """Add what the law contributes, and move its states on by one step."""
        raise NotImplementedError

    def volts(self, volts: np.ndarray, x: Signals) -> np.ndarray:
        """What a law between command and motor makes of a voltage (B,) [V]."""
        raise NotImplementedError

    def torque(self, twist: np.ndarray, rate: np.ndarray, step: float) -> np.ndarray:
        """Torque on the link (B,) [N m] of a spring behind the gear: its twist [rad] and its rate [rad/s]."""
        raise NotImplementedError

    def speed(self, x: Signals) -> np.ndarray:
        """Speed of the body that the law acts on."""
        return x.v_a if self.on_link else x.v_m
