"""Sensors."""

from hybrid_id.components.sensor.encoder import LinkEncoder, MotorEncoder
from hybrid_id.components.sensor.late_reading import LateReading

__all__ = ["LateReading", "LinkEncoder", "MotorEncoder"]
