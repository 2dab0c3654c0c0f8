"""Encoders."""

from hybrid_id.components.base import Sensor
from hybrid_id.parameters import Parameter


class MotorEncoder(Sensor):
    """Motor-side encoder ``y = q_m + offset`` [rad].

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
    """Link-side encoder ``y = q_a + offset`` [rad]."""

    kind = "link_encoder"
    channel = "q_a"
