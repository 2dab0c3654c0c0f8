"""Torque that never changes."""

from hybrid_id.components.base import Effect, LoadTorque
from hybrid_id.components.site import free
from hybrid_id.parameters import Parameter

ALL_OVER = (
    "slow motion both ways over the whole range: a bias is the same all over, a weight or a spring is not"
)


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
    effect = Effect(
        "constant_torque",
        "bias of an amplifier's offset, a cable, a balancing weight; usually below 5 % of the rated torque",
        "A. Janot, P.-O. Vandanjon, M. Gautier, A generic instrumental variable approach for industrial robot "
        "identification, IEEE Trans. Control Systems Technology 22(1), 2014",
        {"gravity_load": ALL_OVER, "spring_load": ALL_OVER},
    )

    def torque(self, p, angle, speed):
        return p.T_0.expand_as(angle)

    @staticmethod
    def starts(site):
        at_link = site.torque * site.ratio
        return [{"T_0": free(0.0, -3.0 * at_link, 3.0 * at_link)}]

    def mjcf(self, p):
        return {"bias": (p.T_0,)}, ""
