"""Resistance of a warm winding."""

from hybrid_id.components.drive import Winding
from hybrid_id.parameters import Parameter


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

    def torque(self, p, torque, states):
        return torque / (1.0 + states[0])

    def relaxations(self, p, torque, states):
        heat = p.c * torque.square() / (1.0 + states[0])
        return [(heat / p.T_w, (1.0 / p.T_w).expand_as(torque))]
