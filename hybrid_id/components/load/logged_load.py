"""A load that was measured."""

from hybrid_id.components.base import LoggedTorque
from hybrid_id.parameters import Parameter


class LoggedLoad(LoggedTorque):
    """``tau = c_w w`` at the link, opposing the motor, from a logged channel w held between samples.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | w | any | what was logged: a load cell, a spring's deflection, the angle of a pendulum on the link |
    | c_w | N m per unit of w | torque per unit |

    A body that hangs on the link and whose motion is logged need not be simulated: its reaction enters as measured.
    """

    kind = "logged_load"
    left_out = "is left out, apply the logged torque through qfrc_applied"
    channels = ("w",)
    c_w = Parameter(1.0, lower=-1e6, upper=1e6, unit="N m", doc="torque per unit of the logged channel")

    def torque(self, p, channels):
        return p.c_w * channels["w"]
