"""Cable or hose along an arm that is slack up to an angle and pulls beyond it."""

from hybrid_id.components.base import Effect, LoadTorque
from hybrid_id.components.site import free
from hybrid_id.errors import InputError
from hybrid_id.parameters import Bounded, Parameter

TAUT = "slow motion both ways over the whole range: a cable pulls beyond one angle alone, a {} all over the range"


class Cable(LoadTorque):
    """``tau = s_c k_c max(s_c (q - q_c), 0)`` at the link: nothing up to ``q_c``, a spring beyond.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | k_c | N m/rad | stiffness of the taut cable |
    | q_c | rad | angle at which it is taut |
    | s_c | 1 | way to which it tightens: 1 for growing angles, -1 for falling ones (held) |

    Source: a spring that acts one way, as the penalty contact of W. J. Stronge, Impact Mechanics, 2nd ed., 2018,
    section 11.1; here a rope that pulls and not a wall that pushes.
    """

    kind = "cable"
    k_c = Parameter(1.0, upper=1e6, unit="N m/rad", doc="stiffness of the taut cable")
    q_c = Parameter(0.0, lower=-1e3, upper=1e3, unit="rad", doc="angle at which it is taut")
    s_c = Parameter(1.0, lower=-1.0, upper=1.0, unit="1", doc="way to which it tightens", estimate=False)
    effect = Effect(
        "cable_pull",
        "cable or hose along an arm that is taut beyond an angle; usually 5 to 30 % of the rated torque at the end",
        "W. J. Stronge, Impact Mechanics, 2nd ed., Cambridge, 2018",
        {
            "spring_load": TAUT.format("spring"),
            "constant_torque": TAUT.format("bias"),
            "link_mass": TAUT.format("weight"),
            "encoder_zero": TAUT.format("wrong zero acts"),
        },
        smoothness="kinks where it is taut",
        shape={"s_c": "k_c"},
    )

    def __init__(self, **values: float | Bounded) -> None:
        super().__init__(**values)
        if self.specs["s_c"].value == 0.0:
            raise InputError("cable: s_c is 0; give 1 (it tightens as the angle grows) or -1.")

    def torque(self, p, angle, speed):
        return p.s_c * p.k_c * (p.s_c * (angle - p.q_c)).clamp_min(0.0)

    @staticmethod
    def starts(site):
        if not site.bodies:  # of robots alone: a bench has no cables along it
            return []
        size, reach = 0.2 * site.torque * site.ratio / site.angle, 0.5 * site.angle
        taut = free(site.middle, site.middle - reach, site.middle + reach)
        return [{"k_c": free(size, 0.0, 200.0 * size), "q_c": taut, "s_c": way} for way in (1.0, -1.0)]
