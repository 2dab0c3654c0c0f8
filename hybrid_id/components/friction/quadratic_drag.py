"""Drag that grows with the square of the speed."""

from hybrid_id.components.base import Effect, Friction
from hybrid_id.components.site import free
from hybrid_id.parameters import Parameter


class QuadraticDrag(Friction):
    """``tau = F_q v |v|`` with F_q [N m s^2/rad^2], v [rad/s]; source: windage, J. E. Vrancik, NASA TN D-4849, 1968."""

    kind = "quadratic_drag"
    F_q = Parameter(1e-7, upper=1e4, unit="N m s^2/rad^2", doc="drag coefficient")
    effect = Effect(
        "quadratic_drag",
        "air or oil that is stirred, with the square of the speed; usually below 5 % of the rated torque at top speed",
        "J. E. Vrancik, Prediction of windage power loss in alternators, NASA TN D-4849, 1968",
        {
            "kinematic_error": "steady high speeds over many turns: drag brakes evenly, an error of the gear ripples "
            "with the rotor's angle and takes nothing on average",
        },
        smoothness="smooth (its curvature jumps at rest)",
    )

    def smooth(self, p, speed):
        return p.F_q * speed * speed.abs()

    @staticmethod
    def starts(site):
        size = 0.05 * site.torque * site.gearing**3 / site.speed**2
        return [{"F_q": free(size, 0.0, 100.0 * size)}]
