"""Coulomb friction."""

from hybrid_id.components.base import Effect, Friction
from hybrid_id.components.site import free
from hybrid_id.parameters import Parameter


class Coulomb(Friction):
    """Dry friction of constant level: |tau| <= F_c at rest, ``tau = F_c sgn v`` in motion (paper, eq. 6: F_c).

    | symbol | unit | meaning |
    | --- | --- | --- |
    | F_c | N m | Coulomb level |
    """

    kind = "coulomb_friction"
    F_c = Parameter(0.01, upper=1e6, unit="N m", doc="Coulomb level")
    has_level = True
    effect = Effect(
        "coulomb_friction",
        "dry friction of bearings, seals, brushes and teeth, the same at any speed; usually 1 to 10 % of the rated "
        "torque",
        "H. Olsson, K. J. Astrom, C. Canudas de Wit, M. Gafvert, P. Lischinsky, Friction models and friction "
        "compensation, European Journal of Control 4(3), 1998",
        {
            "viscous_friction": "steady speeds at several heights: dry friction stays, viscous friction grows with "
            "speed",
            "stribeck_friction": "steady speeds from creeping upwards: Coulomb friction stays, a Stribeck fall does "
            "not",
            "asymmetric_friction": "the same steady speeds both ways: Coulomb friction is the same either way",
            "presliding_friction": "small reversals from rest, below what breaks it away: a bristle gives and springs "
            "back, dry friction holds",
            "position_dependent_friction": "slow motion both ways over the whole range: Coulomb friction is the same "
            "all over",
            "load_dependent_friction": "the same slow move with two payloads: Coulomb friction stays as it is",
            "constant_torque": "the same slow move both ways: dry friction turns with the direction, a bias does not",
        },
        smoothness="jumps with the direction",
        where_held=True,
    )

    def dry(self, p, magnitude, forward):
        return p.F_c

    @staticmethod
    def starts(site):
        levels = [law for law in site.frictions if law.has_level]
        if any(law.kind != Coulomb.kind or law.specs["F_c"].estimate for law in levels):
            return []
        torque, r = site.torque, site.gearing
        return [{"F_c": free(0.1 * torque * r, 0.0, 3.0 * torque * r)}]
