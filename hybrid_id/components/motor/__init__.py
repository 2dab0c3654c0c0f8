"""Motors, and what acts beside them."""

from hybrid_id.components.motor.cogging import Cogging
from hybrid_id.components.motor.current_motor import CurrentMotor
from hybrid_id.components.motor.dc_motor import DCMotor
from hybrid_id.components.motor.electrical_lag import ElectricalLag
from hybrid_id.components.motor.free_rotor import FreeRotor
from hybrid_id.components.motor.rotor_bias import RotorBias
from hybrid_id.components.motor.thermal_derating import ThermalDerating
from hybrid_id.components.motor.torque_motor import TorqueMotor

__all__ = [
    "Cogging",
    "CurrentMotor",
    "DCMotor",
    "ElectricalLag",
    "FreeRotor",
    "RotorBias",
    "ThermalDerating",
    "TorqueMotor",
]
