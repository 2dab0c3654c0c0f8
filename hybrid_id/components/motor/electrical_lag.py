"""Inductance of the winding."""

from hybrid_id.components.base import Effect, Winding
from hybrid_id.components.site import free
from hybrid_id.parameters import Parameter


class ElectricalLag(Winding):
    """``T_e dz/dt = tau - z`` with T_e = L / R [s]: the torque z follows the one without inductance, tau.

    It is the winding's ``L di/dt + R i = U - k_e v`` times the torque constant, z = k_m i [N m].
    Source: W. Leonhard, Control of Electrical Drives, 3rd ed., 2001, chapter 5; neglected in the paper's eq. (3).
    """

    kind = "electrical_lag"
    states = ("tau_e",)
    T_e = Parameter(1e-3, lower=1e-6, upper=10.0, unit="s", doc="electrical time constant L/R")
    effect = Effect(
        "electrical_lag",
        "inductance that delays the winding's current; usually L / R of 0.1 to 3 ms",
        "W. Leonhard, Control of Electrical Drives, 3rd ed., Springer, 2001, chapter 5",
        {
            "joint_flexibility": "a sweep through the resonance with two payloads: a resonance moves with the inertia, "
            "the winding's lag stays",
        },
    )

    def torque(self, p, torque, states):
        return states[0]

    def state_updates(self, p, torque, states):
        return [(torque / p.T_e, (1.0 / p.T_e).expand_as(torque))]

    @staticmethod
    def starts(site):
        step = site.sample_time
        return [{"T_e": free(start * step, 0.25 * step, 0.1)} for start in (1.0, 5.0)]

    def mjcf(self, p, resistance, constant):
        return {"inductance": (0, p.T_e)}, ""
