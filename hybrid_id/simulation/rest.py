"""Where the side of a compliant gear rests that nobody has measured: the load has wound the gear up."""

from __future__ import annotations

from collections.abc import Collection

import torch
from torch import Tensor

from hybrid_id.systems.chain import Channels, System
from hybrid_id.systems.joint import Joint

SMALLEST, LARGEST, HALVINGS = 1e-5, 2.0, 50
"""Twists [rad at the link] between which the balance is looked for, and steps of the bisection."""


def hidden_side(joint: Joint, outputs: Collection[str]) -> int | None:
    """Row of the angle, the motor's or the link's, that outputs do not tell behind a gear that gives way; else None."""
    if joint.rigid:
        return None
    motor, link = joint.positions
    if f"q_a{joint.number}" not in outputs:
        return link
    return None if {f"q_m{joint.number}", f"v_m{joint.number}"} & set(outputs) else motor


@torch.no_grad()
def resting_twist(system: System, joint: Joint, x: list[Tensor], u: Channels) -> Tensor:
    """Link angle less the rotor's over the ratio [rad], ``(B,)``, at which a resting joint's spring carries its load.

    0 where dry friction at the link can hold the load, and where no twist carries it. Loads of the joint's own count,
    not what an arm's links do to each other.

    Args:
        system: of the joint.
        joint: with a compliant gear.
        x: state rows at rest, ``(B,)`` each, the link where the rotor is.
        u: channels, ``(B,)`` each.
    """
    nothing = torch.zeros_like(x[0])
    if not (joint.loads or joint.logged or joint.gear.errors):
        return nothing
    p = system.views(list(system.theta().to(x[0])[:, None]))
    link = joint.positions[1]

    def pull(twist: Tensor) -> Tensor:
        """Torque on the link that twists it further."""
        rows = list(x)
        rows[link] = x[link] + twist
        return joint.spring_torque(rows, p) - joint.load_torque(rows[link], nothing, u, p)

    held = pull(nothing).abs() <= joint.dry_level("link_friction", p, nothing, nothing, x) + 1e-12
    reach = torch.full_like(nothing, SMALLEST)
    while float(reach.max()) < LARGEST and bool(((pull(reach) > 0) | (pull(-reach) < 0)).any()):
        reach = 2.0 * reach
    carried = (pull(reach) <= 0) & (pull(-reach) >= 0) & ~held
    low, high = -reach, reach
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        further = pull(middle) > 0
        low, high = torch.where(further, middle, low), torch.where(further, high, middle)
    return torch.where(carried, 0.5 * (low + high), nothing)
