"""Motor behind a current loop."""

from hybrid_id.components.base import Motor
from hybrid_id.parameters import Parameter


class CurrentMotor(Motor):
    """``tau_m = k_t i``, for drives that are commanded (or logged) in current.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | k_t | N m/A | torque constant |
    """

    kind = "current_motor"
    takes = "A"
    k_t = Parameter(0.05, lower=1e-9, upper=1e3, unit="N m/A", doc="torque constant")

    def torque(self, p, command, speed):
        return p.k_t * command

    def current(self, p, torque):
        return torque / p.k_t

    def mjcf(self, p):
        return {"gainprm": (p.k_t,)}, ""
