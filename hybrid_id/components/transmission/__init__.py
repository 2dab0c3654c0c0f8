"""Transmissions."""

from hybrid_id.components.transmission.linear_spring import LinearSpring
from hybrid_id.components.transmission.rigid import Rigid

__all__ = ["LinearSpring", "Rigid"]
