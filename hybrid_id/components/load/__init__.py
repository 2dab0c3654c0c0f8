"""Load: masses and torques at the link."""

from hybrid_id.components.load.gravity import Gravity
from hybrid_id.components.load.logged_load import LoggedLoad
from hybrid_id.components.load.one_link import OneLink, TwoInertias

__all__ = ["Gravity", "LoggedLoad", "OneLink", "TwoInertias"]
