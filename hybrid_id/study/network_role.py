"""What a trained network does beside the physics: its share of the torque, its overlap with the physics, its map."""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from hybrid_id.identification.network_data import networks_of
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
    speed: np.ndarray
    angle: np.ndarray
    map: np.ndarray
    seen: np.ndarray


def network_roles(system: System, engine: Engine, batch: Batch) -> tuple[NetworkRole, ...]:
    """What each network of a trained system does along the free runs of a batch."""
    used = (batch.weight > 0).any(2).reshape(-1)
    run = simulate(system, engine, batch)
    x = [column.reshape(-1)[used] for column in run.x.unbind(2)]
    u = {name: channel.reshape(-1)[used] for name, channel in batch.u.items()}
    values = list(system.theta().detach().to(batch.x)[:, None])
    p, found = system.views(values), []
    asleep = copy.deepcopy(system)  # else a change of scale of all torques looks like any network
    for part in asleep.networks.values():
        part.fall_asleep()
    effects = _effects(asleep, engine, x, u, values)
    free = [info.name for info in system.table if info.spec.estimate]
    physical = (
        torch.stack([effects[name] for name in free], 1)
        if free
        else effects["_"].new_zeros(len(effects["_"]), 0)
    )
    basis = _basis(physical)
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
        caused = effects[f"b_0 {joint.name}/{place}"] * output.repeat(len(system.speed_rows))
        length = float(caused.norm())
        cosines = (physical.T @ caused / (physical.norm(dim=0) * caused.norm()).clamp_min(1e-300)).abs()
        alike = sorted(zip(free, cosines.tolist(), strict=True), key=lambda pair: -pair[1])[:3]
        speed, angle, values_at, seen = _map(system, place, networks, part, x, u, p)
        found.append(
            NetworkRole(
                f"{joint.name}/{place}", "V" if place == "input" else "N m", float(output.square().mean().sqrt()),
                _ratio(output.square().mean().sqrt(), reference.square().mean().sqrt()),
                _ratio(output.var(), reference.var()),
                float((basis.T @ caused).norm()) / length if length > 0 else 0.0,
                tuple(alike), speed, angle, values_at, seen,
            )
        )  # fmt: skip
    return tuple(found)


def _ratio(part: Tensor, whole: Tensor) -> float:
    return float(part / whole) if float(whole) > 0 else 0.0


def _effects(
    system: System, engine: Engine, x: list[Tensor], u: dict[str, Tensor], values: list[Tensor]
) -> dict[str, Tensor]:
    """Derivatives of all accelerations, in units of their RMS, by each estimated parameter and each network's b_0."""
    leaves = {}
    for k, info in enumerate(system.table):
        if info.spec.estimate or info.symbol == "b_0":
            place = info.component.rpartition("/")[0]
            values[k] = values[k].expand_as(x[0]).clone().requires_grad_()
            leaves[f"b_0 {place}" if info.symbol == "b_0" else info.name] = values[k]
    with torch.enable_grad():
        rates = system.rates(x, u, system.views(values), width=engine.width)
        rows = []
        for row in system.speed_rows:
            size = rates[row].detach().square().mean().sqrt().clamp_min(1e-300)
            grads = torch.autograd.grad(
                rates[row].sum(), list(leaves.values()), retain_graph=True, allow_unused=True
            )
            rows.append([torch.zeros_like(x[0]) if g is None else g / size for g in grads])
    return {name: torch.cat([row[k] for row in rows]) for k, name in enumerate(leaves)}


def _basis(columns: Tensor) -> Tensor:
    """Orthonormal basis of the span of columns ``(N, n)``."""
    size = columns.norm(dim=0)
    columns = columns[:, size > 0] / size[size > 0]
    if columns.shape[1] == 0:
        return columns
    left, strength, _ = torch.linalg.svd(columns, full_matrices=False)
    return left[:, strength > 1e-9 * strength[0]]


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
    speeds = torch.linspace(-reach, reach, GRID, dtype=speed.dtype)
    angles = torch.linspace(low, high, GRID, dtype=angle.dtype)
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
    return speeds.numpy(), angles.numpy(), output.cpu().numpy(), seen.cpu().numpy()
