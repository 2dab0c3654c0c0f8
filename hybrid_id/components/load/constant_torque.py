"""Torque that never changes."""

from hybrid_id.components.base import LoadTorque
from hybrid_id.parameters import Parameter


class ConstantTorque(LoadTorque):
    """``tau = T_0`` at the link, opposing the motor: a bias torque, or behind a motor an amplifier's offset.

    Source: the offset of A. Janot, P.-O. Vandanjon and M. Gautier, A generic instrumental variable approach for
    industrial robot identification, IEEE Trans. Control Syst. Technol. 22 (1), 2014.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | T_0 | N m | torque, of either sign |
    """

    kind = "constant_torque"
    T_0 = Parameter(0.0, lower=-1e6, upper=1e6, unit="N m", doc="torque of either sign")

    def torque(self, p, angle, speed):
        return p.T_0.expand_as(angle)
