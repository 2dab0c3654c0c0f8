"""Residual networks before and while they train: scales, price, hidden states, and sensitivities to the weights.

Sources: Y. Yin et al., APHYNITY, ICLR 2021 (price of the norm); J. Nocedal, S. Wright,
Numerical Optimization, 2nd ed., 2006, sec. 10.3 (Gauss-Newton metric).
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import replace

import torch
from torch import Tensor

from hybrid_id.components.bristle import relax
from hybrid_id.components.residual import ResidualNetwork
from hybrid_id.identification.costate import linearise_sorted
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.lifted import Linearisation, slices
from hybrid_id.simulation.solvers import OdeEngine
from hybrid_id.systems.chain import System
from hybrid_id.systems.networks import HARMONIC, LINK_PLACES, Networks

LANES = 8_000
"""Lanes per block: each carries all weights through all steps of its sample."""


def networks_of(system: System) -> list[tuple[str, str, ResidualNetwork, Networks]]:
    """Name of its output (``r_motor1``), place, network and joint's networks of each."""
    found = []
    for joint in system.joints:
        for place, (_, part, _) in joint.networks.by_place.items():
            found.append((f"r_{place}{joint.number}", place, part, joint.networks))
    return found


@torch.no_grad()
def with_scales(system: System, batch: Batch, width: float = 0.5) -> System:
    """The system whose networks have input and output scales from the measured motion of a batch.

    Angles get their mean and standard deviation, other signals their RMS; the output scale is the RMS of the motor's
    torque (at the link where the place is there) or of the command.

    Args:
        system: holds the networks.
        batch: rows; samples without a measurement do not count.
        width: speed over which the engine smooths friction [rad/s], the scale of a ``direction``: a network that is
            sharper or softer than the friction beside it would learn the difference where the joint creeps.
    """
    system = copy.deepcopy(system)
    used = (batch.weight > 0).any(2).reshape(-1)
    x = [column.reshape(-1)[used] for column in batch.x.unbind(2)]
    u = {name: channel.reshape(-1)[used] for name, channel in batch.u.items()}
    p = system.views(list(system.theta().to(batch.x)[:, None]))
    for _, place, part, networks in networks_of(system):
        drive, ratio = networks.joint.drive, networks.joint.gear_ratio
        reference = command = drive.command(x, u, p, network=False)
        if place != "input":
            # without its windings, whose states nobody has measured
            reference = drive.motor[1].torque(p[drive.motor[0]], command, x[drive.rotor + 1])
        for k, (name, signal) in enumerate(
            zip(part.inputs, networks.signals(place, x, u, p)[0], strict=True)
        ):
            signal = (reference if name == "torque" and drive.windings else signal).expand_as(x[0])
            shift, scale = signal.new_zeros(()), signal.square().mean().sqrt()
            if HARMONIC.fullmatch(name):
                scale = torch.ones_like(scale)
            elif name.startswith(("angle", "deflection")) and name != "deflection_rate":
                shift, scale = signal.mean(), signal.std()
            elif name == "direction":
                scale = torch.full_like(scale, width)
            part.shift[k], part.scale[k] = shift, scale if scale > 0 else torch.ones_like(scale)
        size = reference.square().mean().sqrt() * (ratio if place in (*LINK_PLACES, "transmission") else 1.0)
        part.output_scale.fill_(float(size) or 1.0)
    return system


def with_price(system: System, batch: Batch, price: float) -> Batch:
    """The batch with each network's output as one more measurement, which reads zero.

    Its weight makes a mean square of ``(r / S)^2 = 1`` cost as much as a mean square error of ``price`` noise
    variances in one output: the least-norm augmentation of APHYNITY (Yin et al., ICLR 2021, eq. 4) as a penalty.
    """
    if price == 0.0:
        return batch
    used = (batch.weight > 0).any(2).to(batch.y.dtype)
    columns = [price**0.5 / part.output_scale.to(batch.y) * used for _, _, part, _ in networks_of(system)]
    weight = torch.stack(columns, 2)
    names = tuple(name for name, *_ in networks_of(system))
    return replace(
        batch,
        y=torch.cat([batch.y, torch.zeros_like(weight)], 2),
        weight=torch.cat([batch.weight, weight], 2),
        outputs=(*batch.outputs, *names),
    )


@torch.no_grad()
def with_memory(system: System, batch: Batch, theta: Tensor) -> Batch:
    """The batch with the networks' hidden states along the measured motion in its guess; windows start with them.

    Args:
        system: has the hidden states.
        batch: rows; the other states of its guess stay.
        theta: all parameters of each row in table order, ``(n_p, R)``.
    """
    if not any(part.memory for part in system.networks.values()):
        return batch
    x, p = batch.x.clone(), system.views(list(theta))
    for k in range(x.shape[1] - 1):
        u = {name: channel[:, k] for name, channel in batch.u.items()}
        for networks in (joint.networks for joint in system.joints):
            for row, (drive, rate, *_) in networks.state_updates(x[:, k].unbind(1), u, p):
                x[:, k + 1, row] = relax(x[:, k, row], drive, rate, batch.dt[:, k])
    return replace(batch, x=x)


@torch.no_grad()
def output_shares(system: System, batch: Batch, x: Tensor, theta: Tensor) -> dict[str, float]:
    """RMS of each network's output over its scale, by output name.

    Args:
        system: holds the networks.
        batch: rows; samples without a measurement do not count.
        x: states there, ``(R, T, n_x)``.
        theta: all parameters, ``(n_p, 1)``.
    """
    used = (batch.weight > 0).any(2).reshape(-1)
    rows = [column.reshape(-1)[used] for column in x.unbind(2)]
    u = {name: channel.reshape(-1)[used] for name, channel in batch.u.items()}
    networks = networks_of(system)
    outputs = system.outputs([name for name, *_ in networks], rows, u, system.views(list(theta)))
    return {
        name: float((output / part.output_scale).square().mean().sqrt())
        for (name, _, part, _), output in zip(networks, outputs, strict=True)
    }


def linearise_with_weights(
    system: System, engine: OdeEngine, batch: Batch, x: Tensor, theta: Tensor, free: Sequence[int]
) -> Linearisation:
    """Linearisation by the states, the free parameters and, last, all weights in the order of the system's parameters.

    Args:
        system: equations of motion.
        engine: how a sample is integrated.
        batch: rows of data.
        x: nodes, ``(R, T, n_x)``.
        theta: all parameters of each row in table order, ``(n_p, R)``.
        free: indices of the parameters to differentiate by.
    """
    lin = linearise_sorted(system, engine, batch, x, theta, free)
    rows, samples, n_x = x.shape
    flat_x, flat_dt = x.reshape(-1, n_x), batch.dt.reshape(-1)
    flat_u, spread = {n: c.reshape(-1) for n, c in batch.u.items()}, theta.repeat_interleave(samples, 1)
    found: tuple[list[Tensor], list[Tensor]] = [], []
    for block in slices(len(flat_dt), LANES):
        p, dt, leaves = system.views(list(spread[:, block])), flat_dt[block], []
        for key, part in system.networks.items():
            for name, weight in part.weights().items():
                # each lane has weights of its own, so that one backward pass differentiates all of them
                leaf = weight.detach()[..., None].expand(*weight.shape, len(dt)).clone().requires_grad_()
                setattr(p[key], name, leaf)
                leaves.append(leaf)
        state, u = list(flat_x[block].unbind(1)), {n: c[block] for n, c in flat_u.items()}
        with torch.enable_grad():
            now = system.outputs(batch.outputs, state, u, p)
            later = engine.sample(system, state, u, dt, p)
        for targets, jacobians in zip((later, now), found, strict=True):
            columns = []
            for target in targets:
                grads: Sequence[Tensor | None] = [None] * len(leaves)
                if target.requires_grad:
                    grads = torch.autograd.grad(target.sum(), leaves, retain_graph=True, allow_unused=True)
                pairs = zip(grads, leaves, strict=True)
                flat = [(torch.zeros_like(w) if g is None else g).reshape(-1, len(dt)) for g, w in pairs]
                columns.append(torch.cat(flat).T)
            jacobians.append(torch.stack(columns, 1))
    later, now = (torch.cat(part).unflatten(0, (rows, samples)) for part in found)
    return replace(lin, b=torch.cat([lin.b, later], -1), d=torch.cat([lin.d, now], -1))


def effects(
    system: System, width: float, x: Sequence[Tensor], u: Mapping[str, Tensor], values: Sequence[Tensor]
) -> dict[str, Tensor]:
    """Derivatives of all accelerations, in units of their RMS, by each estimated parameter and each network's b_0.

    The networks sleep meanwhile: else a change of scale of all torques looks like any network.

    Args:
        system: equations of motion.
        width: speed over which friction is smoothed [rad/s].
        x: states, ``(N,)`` each.
        u: channels, ``(N,)`` each.
        values: all parameters in table order, ``(1,)`` each.

    Returns:
        By name of the parameter, or ``b_0 joint1/motor``, ``(N times speeds,)``.
    """
    values, leaves = list(values), {}
    for k, info in enumerate(system.table):
        if info.spec.estimate or info.symbol == "b_0":
            place = info.component.rpartition("/")[0]
            values[k] = values[k].expand_as(x[0]).clone().requires_grad_()
            leaves[f"b_0 {place}" if info.symbol == "b_0" else info.name] = values[k]
    p = system.views(values)
    for key, part in system.networks.items():
        for name, weight in part.last_weights().items():
            setattr(p[key], name, torch.zeros_like(weight))
    with torch.enable_grad():
        rates = system.rates(x, u, p, width=width)
        rows = []
        for row in system.speed_rows:
            size = rates[row].detach().square().mean().sqrt().clamp_min(1e-300)
            grads = torch.autograd.grad(
                rates[row].sum(), list(leaves.values()), retain_graph=True, allow_unused=True
            )
            rows.append([torch.zeros_like(x[0]) if g is None else g / size for g in grads])
    return {name: torch.cat([row[k] for row in rows]) for k, name in enumerate(leaves)}


def physical_names(system: System) -> list[str]:
    """The estimated parameters, without those that belong to a network."""
    return [info.name for info in system.table if info.spec.estimate and info.symbol != "b_0"]


def span(columns: Tensor) -> Tensor:
    """Orthonormal basis of the span of columns ``(N, n)``."""
    size = columns.norm(dim=0)
    columns = columns[:, size > 0] / size[size > 0]
    if columns.shape[1] == 0:
        return columns
    left, strength, _ = torch.linalg.svd(columns, full_matrices=False)
    return left[:, strength > 1e-9 * strength[0]]
