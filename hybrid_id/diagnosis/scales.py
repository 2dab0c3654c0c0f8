"""How large things are in these records: what start values of an effect are measured by."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import torch
from torch import Tensor

from hybrid_id.components.base import Component
from hybrid_id.components.site import Scales, Tip
from hybrid_id.records.units import number_of
from hybrid_id.simulation.batch import Batch
from hybrid_id.systems.arm import MOTION
from hybrid_id.systems.chain import System
from hybrid_id.systems.joint import Joint

REST = 0.02
"""Share of the largest value below which a joint rests."""
TOUCHED = 1e-3
"""How far a joint must raise a point for what it touches to matter to that joint [m]."""


def scales(system: System, batch: Batch) -> list[Scales]:
    """Scales of every joint; 1 in place of what never differs from nothing.

    Args:
        system: fitted model.
        batch: records, prepared for it.
    """
    known = system
    for joint in system.joints:
        if (
            f"{joint.name}/motor/electrical_lag" in system.components
        ):  # the current that lags was not measured
            known = known.without_component(f"{joint.name}/motor", "electrical_lag")
    x = batch.x[..., [system.state_names.index(name) for name in known.state_names]]
    return [_of_joint(known, joint, replace(batch, x=x)) for joint in known.joints]


def _of_joint(system: System, joint: Joint, batch: Batch) -> Scales:
    valid = (batch.weight > 0).any(2)
    row = joint.positions[0]
    q, v = batch.x[..., row][valid], batch.x[..., row + 1][valid]
    views = {key: cast(Component, part).view() for key, part in system.components.items()}
    states = [column[valid] for column in batch.x.unbind(2)]
    channels = {name: channel[valid] for name, channel in batch.u.items()}
    with torch.no_grad():
        command = joint.drive.command(states, channels, views).detach()
        torque = _rms(joint.drive.torque(states, channels, views))
        key, inertia = joint.inertia
        rotor = float(inertia.rotor(views[key], joint.gear_ratio))
        total = rotor + float(inertia.behind_gear(views[key], joint.gear_ratio)) / joint.gear_ratio**2
        fastest, forward = torch.full_like(v[:1], float(v.abs().max())), torch.ones_like(v[:1])
        level = joint.dry_level("motor_friction", views, fastest, forward, states)
        if joint.rigid:
            beyond = joint.dry_level("link_friction", views, fastest / joint.gear_ratio, forward, states)
            level = level + beyond / joint.gear_ratio
        highest = float(level.max())
    off = channels.get(f"enable{joint.number}")
    own = str(joint.number)
    shown = {f"i{joint.number}", f"tau{joint.number}"} & set(batch.outputs)
    link, moving = q / joint.gear_ratio, _at_work(v)
    fast = float(moving.abs().quantile(0.95)) if moving.numel() < 2**24 else float(v.abs().max())
    tree = system.tree
    # bodies with a mass that a joint of a robot carries, outermost first
    bodies = () if tree is None else tree.bodies
    carried = [
        one for one in bodies if one.inertia.mass and tree and tree.carries(joint.number - 1, one.joint)
    ]
    return Scales(
        joint=joint.number,
        ratio=joint.gear_ratio,
        sample_time=batch.sample_time,
        duration=float(batch.dt.sum(1).max()),
        command=float(command.abs().max()) or 1.0,
        command_rms=_rms(command) or 1.0,
        speed=fast or 1.0,
        turns=float(q.max() - q.min()) or 1.0,
        angle=float(link.max() - link.min()) or 1.0,
        middle=0.5 * float(link.max() + link.min()),
        torque=torque or 1.0,
        dry=highest if highest > 1e-9 * torque else 0.1 * (torque or 1.0),
        inertia=total,
        rotor=rotor,
        measured=tuple(n.removesuffix(own) for n in batch.outputs if number_of(n) == own),
        bodies=tuple(body.name for body in sorted(carried, key=lambda body: -body.joint)),
        tip=_tip(system, joint, batch),
        shows_torque=bool(shown) or (off is not None and bool((off < 1.0).any())),
    )


def _at_work(signal: Tensor) -> Tensor:
    """Samples of a signal but those near zero, in which a joint rests: long pauses make no signal smaller."""
    size = signal.abs()
    return signal[size > REST * size.max()] if size.numel() and float(size.max()) else signal


def _rms(signal: Tensor) -> float:
    return float(_at_work(signal).square().mean().sqrt())


def _tip(system: System, joint: Joint, batch: Batch) -> Tip | None:
    """The lowest of the points at the ends of the tree whose height a joint of a robot changes; None without any."""
    tree, valid = system.tree, (batch.weight > 0).any(2)
    if tree is None:
        return None
    seats, seat = system.arm.seats, joint.number - 1
    angles = {k: batch.u[f"{MOTION[0]}{k + 1}"][valid] for k in range(len(tree.joints)) if k not in seats}
    for k, one in zip(seats, system.joints, strict=True):
        angles[k] = batch.x[..., one.positions[0]][valid] / one.gear_ratio
    held = angles | {seat: angles[seat].mean().expand_as(angles[seat])}
    moved, still = (tree.poses([q[k] for k in sorted(q)]) for q in (angles, held))
    inner = {one.parent for one in tree.joints}
    found = []
    for name, point in tree.points.items():
        if point.joint not in inner and tree.carries(seat, point.joint):
            heights, without = (torch.as_tensor(tree.place(poses, point)[2]) for poses in (moved, still))
            if float((heights - without).abs().max()) > TOUCHED:
                found.append(Tip(name, float(heights.min()), float(heights.max())))
    return min(found, key=lambda tip: tip.lowest, default=None)
