"""Load: masses and torques at the link."""

from hybrid_id.components.load.constant_torque import ConstantTorque
from hybrid_id.components.load.gravity import Gravity
from hybrid_id.components.load.logged_load import LoggedLoad
from hybrid_id.components.load.one_link import OneLink, TwoInertias
from hybrid_id.components.load.spring import Spring

__all__ = ["ConstantTorque", "Gravity", "LoggedLoad", "OneLink", "Spring", "TwoInertias"]
