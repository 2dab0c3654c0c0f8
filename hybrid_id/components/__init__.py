"""Everything that acts in a drive chain: one law, one class, one file. Importing this package fills the registry."""

from hybrid_id.components.base import PLACES, REGISTRY, Component
from hybrid_id.components.friction import (
    AsymmetricStribeck,
    AsymmetricStribeckEq8,
    Coulomb,
    Dahl,
    LoadDependent,
    LuGre,
    Stribeck,
    Viscous,
)
from hybrid_id.components.input import CurrentCommand, DutySupply, PositionLoop, TorqueCommand, Voltage
from hybrid_id.components.load import ConstantTorque, Gravity, LoggedLoad, OneLink, Spring, TwoInertias
from hybrid_id.components.motor import CurrentMotor, DCMotor, TorqueMotor
from hybrid_id.components.sensor import LinkEncoder, MotorEncoder
from hybrid_id.components.transmission import LinearSpring, Rigid

__all__ = [
    "PLACES",
    "REGISTRY",
    "AsymmetricStribeck",
    "AsymmetricStribeckEq8",
    "Component",
    "ConstantTorque",
    "Coulomb",
    "CurrentCommand",
    "CurrentMotor",
    "DCMotor",
    "Dahl",
    "DutySupply",
    "Gravity",
    "LinearSpring",
    "LinkEncoder",
    "LoadDependent",
    "LoggedLoad",
    "LuGre",
    "MotorEncoder",
    "OneLink",
    "PositionLoop",
    "Rigid",
    "Spring",
    "Stribeck",
    "TorqueCommand",
    "TorqueMotor",
    "TwoInertias",
    "Viscous",
    "Voltage",
]
