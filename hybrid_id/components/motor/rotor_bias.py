"""Torque on the rotor that never changes."""

from hybrid_id.components.drive import RotorTorque
from hybrid_id.parameters import Parameter


class RotorBias(RotorTorque):
    """``tau = T_0`` at the rotor, driving: an amplifier's offset, where a gear parts it from a load on the link.

    Source: see ``constant_torque``. It may stand among the loads, too, as the bias that it is.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | T_0 | N m | torque, of either sign |
    """

    kind = "rotor_bias"
    places = ("motor", "load")
    T_0 = Parameter(0.0, lower=-1e3, upper=1e3, unit="N m", doc="torque of either sign")

    def torque(self, p, angle, speed):
        return p.T_0.expand_as(angle)
