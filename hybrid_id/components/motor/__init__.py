"""Motors."""

from hybrid_id.components.motor.current_motor import CurrentMotor
from hybrid_id.components.motor.dc_motor import DCMotor
from hybrid_id.components.motor.torque_motor import TorqueMotor

__all__ = ["CurrentMotor", "DCMotor", "TorqueMotor"]
