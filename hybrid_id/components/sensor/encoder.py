"""Encoders, and logs whose zero is another than theirs."""

import math

from hybrid_id.components.base import Effect, Sensor
from hybrid_id.components.site import free
from hybrid_id.parameters import Parameter

WEIGHT = (
    "slow motion over the whole range with a weight at the end: a wrong zero turns the weight's torque too, a bias "
    "leaves it as it is"
)
MOST = 0.5 * math.pi
"""Largest zero that is looked for [rad at the joint]: a quarter of a turn, by which joints are put together wrongly."""


class MotorEncoder(Sensor):
    """Motor-side encoder ``y = q_m + offset`` [rad], which a position loop at the motor reads, too.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | offset | rad | reading at the model's zero; matters only where gravity or a spring fixes the zero |
    """

    kind = "motor_encoder"
    channel = "q_m"
    offset = Parameter(
        0.0, lower=-1e4, upper=1e4, unit="rad", doc="reading at the model's zero", estimate=False
    )

    def read(self, p, value):
        return value + p.offset


class LinkEncoder(MotorEncoder):
    """Link-side encoder ``y = q_a + offset`` [rad], which a position servo reads, too."""

    kind = "link_encoder"
    at_motor = False
    channel = "q_a"


class MotorLog(MotorEncoder):
    """Motor angle as it was logged, ``y = q_m + offset`` [rad], with a zero that the servo's loop does not know.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | offset | rad | logged angle less that of which the goal speaks |
    """

    kind = "motor_log"
    in_loop = False
    effect = Effect(
        "encoder_zero",
        "logged angle whose zero is not that of the goal, by its calibration; usually a few degrees",
        "W. Khalil, E. Dombre, Modeling, Identification and Control of Robots, Hermes Penton, 2002",
        {"constant_torque": WEIGHT},
    )

    @classmethod
    def starts(cls, site):
        shows = site.servo is not None or bool(site.bodies)  # a goal, or weights, know the zero
        if not shows or cls.channel not in site.measured:
            return []
        most = MOST * (site.ratio if cls.channel == "q_m" else 1.0)
        return [{"offset": free(0.0, -most, most)}]


class LinkLog(MotorLog):
    """Link angle as it was logged, ``y = q_a + offset`` [rad], with a zero that the servo's loop does not know."""

    kind = "link_log"
    at_motor = False
    channel = "q_a"
