"""What happens to the voltage between the command and the motor's terminals."""

from dataclasses import dataclass

import numpy as np

from hybrid_id.blind.physics.law import InputLaw, Lanes, Signals


@dataclass
class Delay(InputLaw):
    """Dead time: ``u(t - delay)``, in fractions of a sample too, as its mean over a step; delay [s]."""

    delay: Lanes

    def volts(self, volts: np.ndarray, x: Signals) -> np.ndarray:
        ends = [(x.time + side * x.step - self.delay) / x.sample_time for side in (-0.5, 0.5)]
        first, last = (np.floor(np.broadcast_to(end, volts.shape) + 1e-9).astype(int) for end in ends)
        # a step is no longer than a sample: at most one change of the held command falls into it
        new = np.where(last > first, (ends[1] - last) * x.sample_time / x.step, 1.0)
        return (1 - new) * self._held(x, first) + new * self._held(x, last)

    def _held(self, x: Signals, sample: np.ndarray) -> np.ndarray:
        """Command of a sample (B,) [V], none before the first."""
        known = x.history[np.clip(sample, 0, len(x.history) - 1), np.arange(sample.size)]
        return np.where(sample < 0, 0.0, known)


@dataclass
class Deadband(InputLaw):
    """Nothing below the threshold [V]; above it the command less ``shift`` of the threshold (0: all of it)."""

    threshold: Lanes
    shift: float

    def volts(self, volts: np.ndarray, x: Signals) -> np.ndarray:
        size = np.abs(volts)
        return np.where(size > self.threshold, np.sign(volts) * (size - self.shift * self.threshold), 0.0)


@dataclass
class Saturation(InputLaw):
    """``|u| <= limit`` [V]."""

    limit: Lanes

    def volts(self, volts: np.ndarray, x: Signals) -> np.ndarray:
        return np.clip(volts, -self.limit, self.limit)


@dataclass
class SoftSaturation(InputLaw):
    """``u / (1 + |u / limit|^n)^(1/n)``: an amplifier that nears its limit [V] gradually."""

    limit: Lanes
    sharpness: float = 8.0

    def volts(self, volts: np.ndarray, x: Signals) -> np.ndarray:
        return volts / (1 + np.abs(volts / self.limit) ** self.sharpness) ** (1 / self.sharpness)


@dataclass
class SupplySag(InputLaw):
    """A weak supply behind a PWM amplifier: ``u - sag d^2 T`` with the duty ``d = u / supply`` and the motor torque T.

    The source carries ``d`` times the winding's current, and the winding sees ``d`` times what it is left with; ``sag``
    [V/(N m)], ``supply`` [V]. Braking pumps it up.
    """

    sag: Lanes
    supply: Lanes

    def volts(self, volts: np.ndarray, x: Signals) -> np.ndarray:
        return volts - self.sag * (volts / self.supply) ** 2 * x.effort


@dataclass
class UnevenGain(InputLaw):
    """An amplifier that gives ``1 + excess`` of the command in one direction only."""

    excess: Lanes

    def volts(self, volts: np.ndarray, x: Signals) -> np.ndarray:
        return np.where(volts > 0, (1 + self.excess) * volts, volts)
