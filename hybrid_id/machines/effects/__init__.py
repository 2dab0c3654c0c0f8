"""What may be at work in a machine beyond its model: each effect by name, place, and several formulas."""

from hybrid_id.machines.effects import arm, outside, transmission
from hybrid_id.machines.effects.base import CATALOGUE, OUTSIDE, Effect

__all__ = ["CATALOGUE", "OUTSIDE", "Effect", "arm", "outside", "transmission"]
