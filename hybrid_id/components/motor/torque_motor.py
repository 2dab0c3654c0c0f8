"""Ideal torque source."""

from hybrid_id.components.base import Motor
from hybrid_id.parameters import Parameter


class TorqueMotor(Motor):
    """``tau_m = gain * tau`` for drives that are commanded in torque, ``i = tau_m / k_t`` where a current is measured.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | gain | 1 | torque delivered per torque commanded; held at 1 by default |
    | k_t | N m/A | torque constant; held at 1 by default, and of no matter where no current is measured |

    Behind a ``position_servo``, whose back-EMF is part of viscous friction, ``i`` is what the loop asks for: the load
    that a servo reports of its duty, and the current of its winding at standstill only.
    """

    kind = "torque_motor"
    takes = "N m"
    gain = Parameter(1.0, upper=10.0, unit="1", doc="delivered per commanded torque", estimate=False)
    k_t = Parameter(1.0, lower=1e-9, upper=1e3, unit="N m/A", doc="torque constant", estimate=False)

    def torque(self, p, command, speed):
        return p.gain * command

    def current(self, p, torque):
        return torque / p.k_t

    def mjcf(self, p):
        return {"gainprm": (p.gain,)}, ""
