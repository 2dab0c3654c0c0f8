"""Everything that acts in a drive chain: one law, one class, one file. Importing this package fills the registry."""

from hybrid_id.components.base import PLACES, REGISTRY, Component
from hybrid_id.components.friction import (
    AsymmetricStribeck,
    AsymmetricStribeckEq8,
    AsymmetricTanh,
    Coulomb,
    Dahl,
    LoadDependent,
    LuGre,
    Stribeck,
    Viscous,
)
from hybrid_id.components.input import CurrentCommand, DutySupply, PositionLoop, TorqueCommand, Voltage
from hybrid_id.components.load import (
    ArmGravity,
    ConstantTorque,
    Gravity,
    JointCoupling,
    LinkInertia,
    LoggedLoad,
    OneLink,
    Spring,
    TwoInertias,
)
from hybrid_id.components.motor import CurrentMotor, DCMotor, TorqueMotor
from hybrid_id.components.sensor import LinkEncoder, MotorEncoder
from hybrid_id.components.transmission import (
    Backlash,
    BacklashFlexibility,
    HardeningSpring,
    JointFlexibility,
    LinearSpring,
    Rigid,
)

__all__ = [
    "PLACES",
    "REGISTRY",
    "ArmGravity",
    "AsymmetricStribeck",
    "AsymmetricStribeckEq8",
    "AsymmetricTanh",
    "Backlash",
    "BacklashFlexibility",
    "Component",
    "ConstantTorque",
    "Coulomb",
    "CurrentCommand",
    "CurrentMotor",
    "DCMotor",
    "Dahl",
    "DutySupply",
    "Gravity",
    "HardeningSpring",
    "JointCoupling",
    "JointFlexibility",
    "LinearSpring",
    "LinkEncoder",
    "LinkInertia",
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
