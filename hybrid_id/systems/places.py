"""Which places a system has, and what may sit in them."""

from __future__ import annotations

from hybrid_id.components.base import PLACES, Component
from hybrid_id.errors import InputError, close_match


def check_place(where: str, kind: type[Component], n_joints: int) -> None:
    """Raise InputError where a system of so many joints has no such place, or the place takes no such component."""
    joint, _, place = where.partition("/")
    joints = [f"joint{i + 1}" for i in range(n_joints)]
    if joint not in joints or place not in PLACES:
        near = close_match(where, (f"{one}/{other}" for one in joints for other in kind.places))
        raise InputError(
            f"Place '{where}' is not known{near}; use one of {', '.join(joints)} with one of {', '.join(PLACES)}."
        )
    if place not in kind.places:
        raise InputError(f"{kind.kind} cannot sit in '{where}'; it belongs in {' or '.join(kind.places)}.")
