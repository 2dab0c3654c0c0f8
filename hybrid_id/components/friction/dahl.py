"""Dahl's presliding friction."""

from hybrid_id.components.bristle import Bristle, stiffnesses
from hybrid_id.parameters import Parameter


class Dahl(Bristle):
    """Paper, eq. (7): ``dF/dt = sigma (v - |v| F / F_c(v))``, state F [N m], steady state ``F_c(v) sgn v``.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | sigma | N m/rad | stiffness at rest |
    | F_c(v) | N m | level of the dry laws on the same speed |

    Differs from the paper's letter, whose units disagree (sigma multiplies the first term only). sigma is in no
    table of the paper: a free parameter.
    """

    kind = "dahl"
    states = ("F",)
    sigma = Parameter(1.0, lower=1e-6, upper=1e6, unit="N m/rad", doc="stiffness at rest")

    def state_updates(self, p, states, speed, level):
        return [(p.sigma * speed, p.sigma * speed.abs() / level)]

    def torque(self, p, states, speed, level):
        return states[0]

    @staticmethod
    def starts(site):
        return [{"sigma": stiffness} for stiffness in stiffnesses(site)]

    def mjcf(self, p):
        return {"bristle": (p.sigma, 0.0)}, ""
