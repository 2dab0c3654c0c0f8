"""Supply that gives way under load."""

from hybrid_id.components.base import CommandMap, Effect
from hybrid_id.components.site import free
from hybrid_id.parameters import Parameter

SOFTEST = 1.0
"""Largest resistance of a supply over that of the winding: a stalled motor at full duty lets it fall by half."""


class SupplySag(CommandMap):
    """``u' = (u + rho d^2 k_e v) / (1 + rho d^2)``, ``d = u / V_0``: a PWM amplifier behind a source with resistance.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | u, u' | V | voltage that the duty would give at the idle supply, and the one that it gives |
    | d | 1 | duty |
    | V_0 | V | supply voltage without load |
    | rho = R_s / R | 1 | resistance of source and leads over that of the winding |
    | k_e | V s/rad | the motor's back-EMF constant, as known before; v [rad/s] is the rotor's speed |

    The source carries the averaged current ``d i`` and falls to ``V_0 - R_s d i``, the winding draws
    ``i = (u' - k_e v) / R``; together, ``u' - k_e v = (u - k_e v) / (1 + rho d^2)``. Braking pumps the supply up.
    Only rho / V_0^2 shows in the motion, so V_0 is given.

    Source: averaged switch model, e.g. R. W. Erickson, D. Maksimovic, Fundamentals of Power Electronics, 2nd ed.,
    2001, sections 3.2 and 7.4; source with internal resistance (Thevenin).
    """

    kind = "supply_sag"
    stage = 2
    rho = Parameter(0.05, upper=10.0, unit="1", doc="source resistance over winding resistance")
    V_0 = Parameter(12.0, lower=1e-3, upper=1e4, unit="V", doc="supply without load", estimate=False)
    k_e = Parameter(0.0, upper=1e3, unit="V s/rad", doc="back-EMF constant, as known before", estimate=False)
    effect = Effect(
        "supply_sag",
        "supply and leads of some resistance, whose voltage falls under load; usually 5 to 20 % of the winding's",
        "R. W. Erickson, D. Maksimovic, Fundamentals of Power Electronics, 2nd ed., Kluwer, 2001",
        {
            "voltage_saturation": "steps of growing height from standstill up to speed: a supply sags with the current "
            "and recovers as the motor gathers speed, a limit cuts alike at every speed",
            "thermal_derating": "the same full step cold and after minutes of heavy work: a sag comes and goes with "
            "the current, heat stays",
            "quadratic_drag": "full steps from standstill, then coasting: a sag is deepest at standstill, drag acts at "
            "speed, without current too",
            "load_dependent_friction": "a payload lifted and lowered slowly, with the supply's voltage on record: "
            "friction opposes both, a sag takes from the lifting only",
        },
    )

    def map(self, p, command, speed):
        drawn = p.rho * (command / p.V_0).square()
        return (command + drawn * p.k_e * speed) / (1.0 + drawn)

    @staticmethod
    def starts(site):
        motor = site.at("motor").get("dc_motor")
        if motor is None or not site.has("voltage"):  # where the supply is logged, its sag is known
            return []
        return [{"rho": free(0.1, 0.0, SOFTEST), "V_0": site.command, "k_e": motor.specs["P_m2"].value}]
