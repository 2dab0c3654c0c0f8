"""Transmissions."""

from hybrid_id.components.transmission.backlash import Backlash
from hybrid_id.components.transmission.backlash_flexibility import BacklashFlexibility
from hybrid_id.components.transmission.flexibility import JointFlexibility
from hybrid_id.components.transmission.hardening_spring import HardeningSpring
from hybrid_id.components.transmission.kinematic_error import KinematicError
from hybrid_id.components.transmission.linear_spring import LinearSpring
from hybrid_id.components.transmission.rigid import Rigid

__all__ = [
    "Backlash",
    "BacklashFlexibility",
    "HardeningSpring",
    "JointFlexibility",
    "KinematicError",
    "LinearSpring",
    "Rigid",
]
