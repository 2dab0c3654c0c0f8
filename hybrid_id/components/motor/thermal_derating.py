"""Resistance of a warm winding."""

from hybrid_id.components.base import Effect, Winding
from hybrid_id.components.site import free
from hybrid_id.parameters import Parameter

FASTEST = 1.0
"""Least time constant [s] with which the winding of a small motor warms, by data sheets."""
COPPER = 0.0039
"""Temperature coefficient of copper [1/K]."""


class ThermalDerating(Winding):
    """``tau' = tau / (1 + w)``, ``T_w dw/dt = c tau'^2 (1 + w) - w``: a warm winding carries less current.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | w | 1 | relative rise of the resistance, copper's 0.0039 per kelvin times the temperature's rise; 0 when cold |
    | T_w | s | thermal time constant of the winding |
    | c | 1/(N m)^2 | rise of w in the end per square of torque: losses R i^2 grow with the resistance |

    Source: single-body thermal model, e.g. Maxon, "Motor data and operating ranges"; W. Leonhard, Control of
    Electrical Drives, 3rd ed., 2001, section 4.3.
    """

    kind = "thermal_derating"
    states = ("w",)
    T_w = Parameter(20.0, lower=1e-2, upper=1e5, unit="s", doc="thermal time constant of the winding")
    c = Parameter(1.0, upper=1e9, unit="1/(N m)^2", doc="relative rise of resistance per square of torque")
    effect = Effect(
        "thermal_derating",
        "winding that warms and carries less current; usually 10 to 30 % less after minutes of heavy work",
        "W. Leonhard, Control of Electrical Drives, 3rd ed., Springer, 2001, chapter 4",
        {
            "quadratic_drag": "the same fast move cold and after minutes of heavy work: drag is there at once and "
            "stays, heat builds up",
            "load_dependent_friction": "the same payload moved cold and after minutes of heavy work: friction under "
            "load is there at once, heat builds up",
            "kinematic_error": "the same slow turns cold and after minutes of heavy work: an error of the gear repeats "
            "with the rotor's angle, heat knows no angle",
        },
    )

    def torque(self, p, torque, states):
        return torque / (1.0 + states[0])

    def state_updates(self, p, torque, states):
        heat = p.c * torque.square() / (1.0 + states[0])
        return [(heat / p.T_w, (1.0 / p.T_w).expand_as(torque))]

    @staticmethod
    def starts(site):
        longest = max(30.0 * site.duration, 9.0 * FASTEST)
        return [
            {
                "T_w": free(max(share * site.duration, FASTEST), FASTEST, longest),
                "c": free(0.1 / site.torque**2, 0.0, 30.0 / site.torque**2),
            }
            for share in (0.3, 3.0)
        ]

    def mjcf(self, p, resistance, constant):
        capacity = resistance * COPPER * float(p.T_w) / (constant**2 * max(float(p.c), 1e-12))
        return {"thermal": (0, capacity, p.T_w, COPPER, 25, 25)}, ""
