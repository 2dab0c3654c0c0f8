"""One link: the moving masses of a joint, as one number at the motor or as two at the gear's sides."""

from hybrid_id.components.base import Inertia
from hybrid_id.parameters import Parameter


class OneLink(Inertia):
    """Rotor and link as one inertia at the motor, ``J = J_rotor + J_link / r^2`` (paper, section III: J).

    | symbol | unit | meaning |
    | --- | --- | --- |
    | J | kg m^2 | whole inertia at the motor |
    | rotor_share | 1 | part of J on the motor's side of the gear; not identifiable while the gear is rigid and no
    load-dependent friction acts, so it is held by default |
    """

    kind = "one_link"
    J = Parameter(2e-5, lower=1e-12, upper=1e6, unit="kg m^2", doc="inertia at the motor")
    rotor_share = Parameter(0.5, upper=1.0, unit="1", doc="share of the rotor in J", estimate=False)

    def rotor(self, p, gear_ratio):
        return p.rotor_share * p.J

    def link(self, p, gear_ratio):
        return (1.0 - p.rotor_share) * p.J * gear_ratio**2

    def total(self, p, gear_ratio):
        return p.J


class TwoInertias(Inertia):
    """Rotor and link as two inertias (paper, eq. 5): J_mg at the motor, J_a at the link.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | J_m | kg m^2 | rotor and gear, at the motor |
    | J_a | kg m^2 | link, at the link |
    """

    kind = "two_inertias"
    J_m = Parameter(1.3e-5, lower=1e-12, upper=1e6, unit="kg m^2", doc="rotor inertia at the motor")
    J_a = Parameter(0.09, lower=1e-12, upper=1e9, unit="kg m^2", doc="link inertia at the link")

    def rotor(self, p, gear_ratio):
        return p.J_m

    def link(self, p, gear_ratio):
        return p.J_a
