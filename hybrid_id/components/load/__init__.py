"""Load: masses and torques at the link."""

from hybrid_id.components.load.arm_gravity import ArmGravity
from hybrid_id.components.load.constant_torque import ConstantTorque
from hybrid_id.components.load.gravity import Gravity
from hybrid_id.components.load.logged_load import LoggedLoad
from hybrid_id.components.load.one_link import OneLink, TwoInertias
from hybrid_id.components.load.spring import Spring
from hybrid_id.components.load.two_link import JointCoupling, LinkInertia

__all__ = [
    "ArmGravity",
    "ConstantTorque",
    "Gravity",
    "JointCoupling",
    "LinkInertia",
    "LoggedLoad",
    "OneLink",
    "Spring",
    "TwoInertias",
]
