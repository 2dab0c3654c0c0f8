"""What may be at work in a machine beyond its model: each effect by name, place, and several formulas."""

from hybrid_id.blind.effects import dependence, friction, load, motor, outside, outside_drive, transmission
from hybrid_id.blind.effects import input as amplifier
from hybrid_id.blind.effects.base import CATALOGUE, OUTSIDE, Effect

__all__ = [
    "CATALOGUE",
    "OUTSIDE",
    "Effect",
    "amplifier",
    "dependence",
    "friction",
    "load",
    "motor",
    "outside",
    "outside_drive",
    "transmission",
]
