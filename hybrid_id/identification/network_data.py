"""What the records say to a network before and while it trains: scales, its price, and what it remembers."""

from __future__ import annotations

import copy
from dataclasses import replace

import torch
from torch import Tensor

from hybrid_id.components.bristle import relax
from hybrid_id.components.residual import ResidualNetwork
from hybrid_id.simulation.prepare import Batch
from hybrid_id.systems.chain import System
from hybrid_id.systems.networks import HARMONIC, LINK_PLACES, Networks


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
        system: tells the hidden states.
        batch: rows; the other states of its guess stay.
        theta: all parameters of each row in table order, ``(n_p, R)``.
    """
    if not any(part.memory for part in system.networks.values()):
        return batch
    x, p = batch.x.clone(), system.views(list(theta))
    for k in range(x.shape[1] - 1):
        u = {name: channel[:, k] for name, channel in batch.u.items()}
        for networks in (joint.networks for joint in system.joints):
            for row, drive, rate in networks.relaxations(x[:, k].unbind(1), u, p):
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
