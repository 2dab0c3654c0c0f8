"""Viscous friction."""

from hybrid_id.components.base import Effect, Friction
from hybrid_id.components.site import free
from hybrid_id.parameters import Parameter


class Viscous(Friction):
    """``tau = F_v v``, the last term of the paper's eq. (6), (11) and (16).

    | symbol | unit | meaning |
    | --- | --- | --- |
    | F_v | N m s/rad | viscous coefficient |
    | v | rad/s | speed of the side on which it sits |
    """

    kind = "viscous_friction"
    F_v = Parameter(1e-4, upper=1e6, unit="N m s/rad", doc="viscous coefficient")
    effect = Effect(
        "viscous_friction",
        "a lubricant's resistance, in proportion to the speed; usually 1 to 10 % of the rated torque at top speed",
        "H. Olsson, K. J. Astrom, C. Canudas de Wit, M. Gafvert, P. Lischinsky, Friction models and friction "
        "compensation, European Journal of Control 4(3), 1998",
        {
            "stribeck_friction": "steady speeds from creeping to the top: a Stribeck fall is over early, viscous "
            "friction grows all the way",
            "quadratic_drag": "steady speeds up to the top: one grows with the speed, the other with its square",
            "joint_flexibility": "long steady speeds: viscous friction brakes, the damping of a spring acts only while "
            "its twist changes",
        },
        where_held=True,
    )

    def smooth(self, p, speed):
        return p.F_v * speed

    @staticmethod
    def starts(site):
        law, motor = site.at().get("viscous_friction"), site.at("motor").get("dc_motor")
        # on the motor's side it hides in a back-EMF that is estimated, unless the motor's torque is seen
        unknown = motor is not None and motor.specs["P_m2"].estimate and not site.shows_torque
        hidden = site.place == "motor_friction" and unknown
        if hidden or (law is not None and law.specs["F_v"].estimate):
            return []
        size = 0.1 * site.torque * site.gearing**2 / site.speed
        return [{"F_v": free(size, 0.0, 100.0 * size)}]
