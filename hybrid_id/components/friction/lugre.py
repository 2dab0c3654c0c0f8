"""LuGre friction."""

from hybrid_id.components.bristle import Bristle, stiffnesses
from hybrid_id.components.site import free
from hybrid_id.parameters import Parameter


class LuGre(Bristle):
    """``dz/dt = v - sigma_0 |v| z / g(v)``, ``tau = sigma_0 z + sigma_1 dz/dt``; state z [rad].

    | symbol | unit | meaning |
    | --- | --- | --- |
    | sigma_0 | N m/rad | bristle stiffness |
    | sigma_1 | N m s/rad | bristle damping |
    | g(v) | N m | level of the dry laws on the same speed, the Stribeck curve |

    Source: Canudas de Wit, Olsson, Astrom, Lischinsky, IEEE TAC 40(3), 1995. The viscous term is a component of its
    own. With a constant sigma_1 as here the law is passive while sigma_1 sigma_0 |v| < 4 g(v) (the source's map from
    speed to torque); it may return energy above that speed.
    """

    kind = "lugre"
    states = ("z",)
    sigma_0 = Parameter(1.0, lower=1e-6, upper=1e6, unit="N m/rad", doc="bristle stiffness")
    sigma_1 = Parameter(1e-3, upper=1e4, unit="N m s/rad", doc="bristle damping")

    def state_updates(self, p, states, speed, level):
        return [(speed, p.sigma_0 * speed.abs() / level)]

    def torque(self, p, states, speed, level):
        (state,), ((drive, rate),) = states, self.state_updates(p, states, speed, level)
        return p.sigma_0 * state + p.sigma_1 * (drive - rate * state)

    @staticmethod
    def starts(site):
        found = []
        for stiffness in stiffnesses(site):
            # a tenth of what would damp the rotor on its bristle aperiodically
            damping = 0.2 * (stiffness.value * site.rotor * site.gearing**2) ** 0.5
            found.append({"sigma_0": stiffness, "sigma_1": free(damping, 0.0, 100.0 * damping)})
        return found

    def mjcf(self, p):
        return {"bristle": (p.sigma_0, p.sigma_1)}, ""
