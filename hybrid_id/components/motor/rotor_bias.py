"""Torque on the rotor that never changes."""

from hybrid_id.components.base import RotorTorque
from hybrid_id.components.load.constant_torque import ConstantTorque
from hybrid_id.components.site import free
from hybrid_id.parameters import Parameter


class RotorBias(RotorTorque):
    """``tau = T_0`` at the rotor, driving: an amplifier's offset, where a gear parts it from a load on the link.

    Source: see ``constant_torque``. It may stand among the loads, too, as the bias that it is.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | T_0 | N m | torque, of either sign |
    """

    kind = "rotor_bias"
    at_motor = True
    places = ("motor", "load")
    T_0 = Parameter(0.0, lower=-1e3, upper=1e3, unit="N m", doc="torque of either sign")
    effect = ConstantTorque.effect

    def torque(self, p, angle, speed):
        return p.T_0.expand_as(angle)

    @staticmethod
    def starts(site):
        # a gear that gives way parts it from a bias of the link
        return [] if site.rigid else [{"T_0": free(0.0, -3.0 * site.torque, 3.0 * site.torque)}]
