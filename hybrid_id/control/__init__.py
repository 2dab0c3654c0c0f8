"""Controllers that use an identified model, and closed loops to judge them in."""

from hybrid_id.control.closed_loop import Plant, Tracking, track
from hybrid_id.control.computed_torque import ComputedTorque
from hybrid_id.control.reference import Reference, sines

__all__ = ["ComputedTorque", "Plant", "Reference", "Tracking", "sines", "track"]
