"""Ideal torque source."""

from hybrid_id.components.base import Motor
from hybrid_id.parameters import Parameter


class TorqueMotor(Motor):
    """``tau_m = gain * tau`` for drives that are commanded in torque.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | gain | 1 | torque delivered per torque commanded; held at 1 by default |
    """

    kind = "torque_motor"
    takes = "N m"
    gain = Parameter(1.0, upper=10.0, unit="1", doc="delivered per commanded torque", estimate=False)

    def torque(self, p, command, speed):
        return p.gain * command

    def mjcf(self, p):
        return {"gainprm": (p.gain,)}, ""
