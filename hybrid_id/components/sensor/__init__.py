"""Sensors."""

from hybrid_id.components.sensor.encoder import LinkEncoder, MotorEncoder

__all__ = ["LinkEncoder", "MotorEncoder"]
