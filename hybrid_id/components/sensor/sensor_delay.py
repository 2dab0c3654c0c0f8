"""Encoder that is read late."""

from types import SimpleNamespace

from torch import Tensor

from hybrid_id.components.base import Component
from hybrid_id.components.input.delay import Delay
from hybrid_id.components.site import free
from hybrid_id.parameters import Parameter


def late_motion(delay: Tensor, angle: Tensor, speed: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
    """Angle [rad] and speed [rad/s] as they were a dead time [s] ago, ``(B,)`` each, see :class:`SensorDelay`."""
    return angle + state, -speed - 2.0 / delay * state


def trailing(delay: Tensor, speed: Tensor) -> tuple[Tensor, Tensor]:
    """Drive [rad/s] and rate [1/s] of the state of such a reading, ``(B,)`` each."""
    return -2.0 * speed, (2.0 / delay).expand_as(speed)


class SensorDelay(Component):
    """``y = q + z``, ``dz/dt = -2 v - (2 / T_r) z``: the motor's angle is read T_r [s] after it was there.

    It is the first Pade approximant of the dead time, ``(1 - T_r s / 2) / (1 + T_r s / 2)`` of the angle, right to the
    second order in T_r; z [rad] is how far the reading trails, ``-T_r v`` at constant speed. For a single joint it
    is the same as a late command, which is why it sits with that; between the joints of an arm it is not.

    Source: e.g. G. F. Franklin, J. D. Powell, A. Emami-Naeini, Feedback Control of Dynamic Systems, 7th ed., 2015,
    section 5.6.3.
    """

    kind = "sensor_delay"
    places = ("input",)
    states = ("lag",)
    T_r = Parameter(0.005, lower=1e-4, upper=0.05, unit="s", doc="dead time of the reading")
    effect = Delay.effect

    def motion(
        self, p: SimpleNamespace, angle: Tensor, speed: Tensor, state: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Angle [rad] and speed [rad/s] as they are read at the motor, ``(B,)`` each."""
        return late_motion(p.T_r, angle, speed, state)

    def state_update(self, p: SimpleNamespace, speed: Tensor) -> tuple[Tensor, Tensor]:
        """Drive [rad/s] and rate [1/s] of its state, ``dz/dt = drive - rate z``, ``(B,)`` each."""
        return trailing(p.T_r, speed)

    @staticmethod
    def starts(site):
        if len(site.ratios) == 1:  # of a single joint it is the same as a delay
            return []
        longest = min(0.06, 15.0 * site.sample_time)
        return [{"T_r": free(3.0 * site.sample_time, 0.3 * site.sample_time, longest)}]

    def mjcf(self, p):
        return {}, "is left out, the exported sensors read true angles, in time"
