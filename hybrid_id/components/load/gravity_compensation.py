"""A controller that holds the weight of a robot's links."""

from hybrid_id.components.base import Effect, Shared
from hybrid_id.components.site import free
from hybrid_id.parameters import Parameter

POSTURES = "rests in many postures: held weight differs from posture to posture, a {} does not"


class GravityCompensation(Shared):
    """Torque ``c_g G(q)`` at each motor, seen at the joint: the weight of the links as the description has them.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | c_g | 1 | share of the weight that the controller holds; 1 is all of it |
    | G | N m or N | load of the joints by the description's bodies, those with ``gravcomp`` as far as it says |
    | q | rad or m | positions of the joints |

    Payloads, wrong masses and a tilted base are not compensated: the controller does not know them. The torque comes
    from the motor, so that the gear passes the whole weight, and load-dependent friction feels it. It does not count
    towards limits of torque, and stays where motors are switched off. Outputs ``tau`` and ``i`` are without it.

    Source: W. Khalil, E. Dombre, Modeling, Identification and Control of Robots, 2002, section 14.4 (PD control with
    gravity compensation). Differs from MuJoCo's ``gravcomp``, whose force acts at the bodies, where a gear gives way or
    has load-dependent friction.
    """

    kind = "gravity_compensation"
    c_g = Parameter(1.0, lower=0.0, upper=2.0, unit="1", doc="share of the links' weight that is held")
    effect = Effect(
        "gravity_compensation",
        "controller that holds the weight of the links beside what is commanded, as most collaborative robots do; "
        "usually all of it",
        "W. Khalil, E. Dombre, Modeling, Identification and Control of Robots, Hermes Penton, 2002",
        {
            "link_mass": "fast motion: what is held still has its inertia, a lighter link has less of both",
            "base_tilt": "rests in many postures: a tilt turns the load of each joint, a controller takes it away",
            "constant_torque": POSTURES.format("bias"),
            "encoder_zero": POSTURES.format("wrong zero"),
            "spring_load": "one joint at rest in many postures of the others: held weight differs from one to the "
            "next, a spring's torque does not",
        },
    )

    @staticmethod
    def starts(site):
        # most of the weight: a little less is what wrong masses look like; the model's own torque leaves it out
        known = {"tau", "i"} & set(site.measured)
        return [{"c_g": free(1.0, 0.5, 1.2)}] if site.bodies and not known else []
