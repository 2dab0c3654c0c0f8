"""What a trained network does beside the physics: its share of the torque, its overlap with the physics, its map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from hybrid_id.identification.network_data import networks_of
from hybrid_id.identification.network_projection import effects, physical_names, span
from hybrid_id.simulation.prepare import Batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.chain import System
from hybrid_id.systems.networks import HARMONIC, LINK_PLACES

GRID = 61


@dataclass(frozen=True, eq=False)
class NetworkRole:
    """One network along the records.

    Attributes:
        where: its place, ``joint1/motor``.
        unit: of its output.
        rms: of its output.
        share: RMS of its output over that of the motor's torque (at the link where the place is there) or command.
        variance_share: the same of the variances.
        overlap: projection coefficient in 0 ... 1: length of the part of the accelerations it causes that lies in the
            span of those of the physics alone to its estimated parameters, over the whole length.
        alike: the parameters to whose effects its own is most alike, with the cosine between them.
        worth: the change of the estimated parameters, by name, that comes nearest to the accelerations it causes: so
            much of each lies in the network.
        room: the change of each estimated parameter alone, by name, that would cause accelerations as large (RMS) as
            the network's.
        speed, angle, map: its output ``(n_speed, n_angle)`` against both, of the side where it acts; other inputs at
            their mean, hidden states at rest.
        seen: speed and angle at each tenth sample, ``(n, 2)``: where the records support the map.
    """

    where: str
    unit: str
    rms: float
    share: float
    variance_share: float
    overlap: float
    alike: tuple[tuple[str, float], ...]
    worth: dict[str, float]
    room: dict[str, float]
    speed: np.ndarray
    angle: np.ndarray
    map: np.ndarray
    seen: np.ndarray


def network_roles(system: System, engine: Engine, batch: Batch) -> tuple[NetworkRole, ...]:
    """What each network of a trained system does along the free runs of a batch."""
    run = simulate(system, engine, batch)
    used = ((batch.weight > 0).any(2) & torch.isfinite(run.x).all(2)).reshape(-1)
    x = [column.reshape(-1)[used] for column in run.x.unbind(2)]
    u = {name: channel.reshape(-1)[used] for name, channel in batch.u.items()}
    values = list(system.theta().detach().to(batch.x)[:, None])
    p, found = system.views(values), []
    accelerations = effects(system, engine.width, x, u, values)
    free = physical_names(system)
    empty = x[0].new_zeros(len(x[0]) * len(system.speed_rows), 0)
    physical = torch.stack([accelerations[name] for name in free], 1) if free else empty
    basis = span(physical)
    for name, place, part, networks in networks_of(system):
        joint = networks.joint
        with torch.no_grad():
            output = system.outputs([name], x, u, p)[0].expand_as(x[0])
            drive = joint.drive
            reference = drive.command(x, u, p, network=False)
            if place != "input":
                reference = drive.motor_torque(x, u, p, network=False)
            if place in (*LINK_PLACES, "transmission"):
                reference = joint.gear_ratio * reference
        caused = accelerations[f"b_0 {joint.name}/{place}"] * output.repeat(len(system.speed_rows))
        length, lengths = float(caused.norm()), physical.norm(dim=0)
        cosines = (physical.T @ caused / (lengths * length).clamp_min(1e-300)).abs()
        alike = sorted(zip(free, cosines.tolist(), strict=True), key=lambda pair: -pair[1])[:3]
        speed, angle, values_at, seen = _map(system, place, networks, part, x, u, p)
        found.append(
            NetworkRole(
                f"{joint.name}/{place}", joint.drive.input[1].gives if place == "input" else "N m",
                float(output.square().mean().sqrt()),
                _ratio(output.square().mean().sqrt(), reference.square().mean().sqrt()),
                _ratio(output.var(), reference.var()),
                float((basis.T @ caused).norm()) / length if length > 0 else 0.0,
                tuple(alike), dict(zip(free, _nearest(physical, caused), strict=True)),
                dict(zip(free, (length / lengths.clamp_min(1e-300)).tolist(), strict=True)),
                speed, angle, values_at, seen,
            )
        )  # fmt: skip
    return tuple(found)


def _ratio(part: Tensor, whole: Tensor) -> float:
    return float(part / whole) if float(whole) > 0 else 0.0


def _nearest(columns: Tensor, target: Tensor) -> list[float]:
    """Coefficients of the columns ``(N, n)`` that come nearest to the target; the least ones where several do."""
    size = columns.norm(dim=0).clamp_min(1e-300)
    return (torch.linalg.pinv(columns / size, rtol=1e-6) @ target / size).tolist()


@torch.no_grad()
def _map(system: System, place: str, networks, part, x, u, p) -> tuple[np.ndarray, ...]:
    """Speeds, angles and the network's output on their grid, and the speeds and angles that the records visit."""
    joint = networks.joint
    at_link = place in LINK_PLACES
    angle, speed = (
        joint.link_motion(x, p) if at_link else (x[joint.positions[0]], x[joint.positions[0] + 1])
    )[:2]
    turn = 2.0 * torch.pi
    low, high = float(angle.min()), float(angle.max())
    if high - low > turn and not any(name == "angle" for name in part.inputs):
        low, high = 0.0, turn  # what knows the angle by its sine and cosine alone repeats itself
    reach = float(speed.abs().max())
    speeds = torch.linspace(-reach, reach, GRID, dtype=speed.dtype, device=speed.device)
    angles = torch.linspace(low, high, GRID, dtype=angle.dtype, device=speed.device)
    v, q = (grid.reshape(-1) for grid in torch.meshgrid(speeds, angles, indexing="ij"))
    signals = []
    for name, signal in zip(part.inputs, networks.signals(place, x, u, p)[0], strict=True):
        if match := HARMONIC.fullmatch(name):
            signals.append((torch.sin if match[1] == "sin" else torch.cos)(float(match[2]) * q))
        elif name in ("angle", "speed", "direction"):
            signals.append(q if name == "angle" else v)
        else:
            signals.append(signal.mean().expand_as(q))
    rest = [torch.zeros_like(q)] * part.memory
    key = networks.by_place[place][0]
    output = part.output(p[key], signals, rest).reshape(GRID, GRID)
    wrapped = angle if high - low != turn else angle % turn
    seen = torch.stack([speed, wrapped], 1)[::10]
    return speeds.cpu().numpy(), angles.cpu().numpy(), output.cpu().numpy(), seen.cpu().numpy()
