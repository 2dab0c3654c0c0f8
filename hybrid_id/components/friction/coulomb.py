"""Coulomb friction."""

from hybrid_id.components.base import Friction
from hybrid_id.parameters import Parameter


class Coulomb(Friction):
    """Dry friction of constant level: |tau| <= F_c at rest, ``tau = F_c sgn v`` in motion (paper, eq. 6: F_c).

    | symbol | unit | meaning |
    | --- | --- | --- |
    | F_c | N m | Coulomb level |
    """

    kind = "coulomb_friction"
    F_c = Parameter(0.01, upper=1e6, unit="N m", doc="Coulomb level")

    def dry(self, p, magnitude, forward):
        return p.F_c
