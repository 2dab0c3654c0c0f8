"""Encoders."""

from hybrid_id.components.base import Effect, Sensor
from hybrid_id.components.site import free
from hybrid_id.parameters import Parameter

WEIGHT = (
    "slow motion over the whole range with a weight at the end: a wrong zero turns the weight's torque too, a bias "
    "leaves it as it is"
)


class MotorEncoder(Sensor):
    """Motor-side encoder ``y = q_m + offset`` [rad].

    | symbol | unit | meaning |
    | --- | --- | --- |
    | offset | rad | reading at the model's zero; matters only where gravity, a spring or a goal fixes the zero |
    """

    kind = "motor_encoder"
    channel = "q_m"
    offset = Parameter(
        0.0, lower=-1e4, upper=1e4, unit="rad", doc="reading at the model's zero", estimate=False
    )
    effect = Effect(
        "encoder_zero",
        "reading of an encoder or its calibration that is not zero where the goal is; usually a few degrees",
        "W. Khalil, E. Dombre, Modeling, Identification and Control of Robots, Hermes Penton, 2002",
        {"constant_torque": WEIGHT},
    )

    def read(self, p, value):
        return value + p.offset

    @classmethod
    def starts(cls, site):
        if site.servo is None or cls.channel not in site.measured:
            return []
        most = 0.5 * (site.ratio if cls.channel == "q_m" else 1.0)
        return [{"offset": free(0.0, -most, most)}]


class LinkEncoder(MotorEncoder):
    """Link-side encoder ``y = q_a + offset`` [rad]."""

    kind = "link_encoder"
    channel = "q_a"
