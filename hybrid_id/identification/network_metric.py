"""Sensitivities to the weights of networks, for the metric in which a training steps.

A weight acts through its network's output alone. Over one sample that output is taken as constant, so that the
sensitivity to a weight is the one to the constant b_0 beside the network times ``dr/dw`` at the sample's node: one
more column in place of hundreds. The gradient stays exact (it is the adjoint's); only the length and turn of a step
depend on this. Source: Gauss-Newton of J. Nocedal, S. Wright, Numerical Optimization, 2nd ed., 2006, sec. 10.3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from hybrid_id.components.bristle import relax
from hybrid_id.identification.costate import linearise_sorted
from hybrid_id.simulation.lifted import Linearisation
from hybrid_id.simulation.prepare import Batch
from hybrid_id.simulation.solvers import OdeEngine
from hybrid_id.systems.chain import System


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
    keys = [(info.component, info.symbol) for info in system.table]
    constants = [keys.index((key, "b_0")) for key in system.networks]
    lin = linearise_sorted(system, engine, batch, x, theta, [*free, *constants])
    b, d = [lin.b[..., : len(free)]], [lin.d[..., : len(free)]]
    for k, key in enumerate(system.networks):
        output, memory, rows = _by_weights(system, key, batch, x, theta)
        through = lin.b[..., len(free) + k, None] * output[:, :, None, :]
        through[:, :, rows] = memory
        b.append(through)
        d.append(lin.d[..., len(free) + k, None] * output[:, :, None, :])
    return replace(lin, b=torch.cat(b, -1), d=torch.cat(d, -1))


def _by_weights(
    system: System, key: str, batch: Batch, x: Tensor, theta: Tensor
) -> tuple[Tensor, Tensor, list[int]]:
    """Of one network ``dr/dw`` at all nodes ``(R, T, n_w)``, its hidden states' a sample later, and their rows."""
    rows, samples, n_x = x.shape
    flat, dt = list(x.reshape(-1, n_x).unbind(1)), batch.dt.reshape(-1)
    u = {name: channel.reshape(-1) for name, channel in batch.u.items()}
    p = system.views(list(theta.repeat_interleave(samples, 1)))
    joint, place = key.split("/")[:2]
    networks = system.joints[int(joint.removeprefix("joint")) - 1].networks
    part, own = system.networks[key], networks.by_place[place][2]
    leaves = []
    for name, weight in part.weights().items():
        leaf = weight.detach()[..., None].expand(*weight.shape, len(dt)).clone().requires_grad_()
        setattr(p[key], name, leaf)
        leaves.append(leaf)

    def jacobian(target: Tensor) -> Tensor:
        grads = torch.autograd.grad(target.sum(), leaves, retain_graph=True, allow_unused=True)
        columns = [torch.zeros_like(w) if g is None else g for w, g in zip(leaves, grads, strict=True)]
        return torch.cat([c.reshape(-1, len(dt)) for c in columns]).T.reshape(rows, samples, -1)

    with torch.enable_grad():
        signals, states = networks.signals(place, flat, u, p)
        output = part.output(p[key], signals, states)
        pairs = part.relaxations(p[key], signals, states)
        later = [relax(h, drive, rate, dt) for h, (drive, rate) in zip(states, pairs, strict=True)]
    found = jacobian(output)
    memory = torch.stack([jacobian(h) for h in later], 2) if later else found.new_zeros(1)
    return found, memory, list(own)
