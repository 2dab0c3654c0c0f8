"""Sensitivities to the weights of networks, for the metric in which a training steps.

Every lane gets weights of its own, equal to the stored ones, so that one backward sweep a state gives the derivatives
of all lanes by all weights. The gradient of the training remains the adjoint's; the length and turn of a step are
those of Gauss and Newton. Source: J. Nocedal, S. Wright, Numerical Optimization, 2nd ed., 2006, sec. 10.3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from hybrid_id.identification.costate import linearise_sorted
from hybrid_id.simulation.lifted import Linearisation
from hybrid_id.simulation.prepare import Batch
from hybrid_id.simulation.solvers import OdeEngine
from hybrid_id.systems.chain import System

LANES = 8_000
"""Lanes per block: each carries all weights through all steps of its sample."""


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
    flat, dt = x.reshape(-1, n_x), batch.dt.reshape(-1)
    u, spread = {n: c.reshape(-1) for n, c in batch.u.items()}, theta.repeat_interleave(samples, 1)
    blocks = [slice(k, k + LANES) for k in range(0, len(dt), LANES)]
    found = [
        _by_weights(
            system, engine, flat[b], {n: c[b] for n, c in u.items()}, dt[b], spread[:, b], batch.outputs
        )
        for b in blocks
    ]
    later, now = (torch.cat(part).unflatten(0, (rows, samples)) for part in zip(*found, strict=True))
    return replace(lin, b=torch.cat([lin.b, later], -1), d=torch.cat([lin.d, now], -1))


def _by_weights(
    system: System,
    engine: OdeEngine,
    x: Tensor,
    u: dict[str, Tensor],
    dt: Tensor,
    theta: Tensor,
    outputs: Sequence[str],
) -> tuple[Tensor, Tensor]:
    """Derivatives of the state a sample later and of the outputs by all weights, ``(B, n, n_w)`` each."""
    p, lanes, leaves = system.views(list(theta)), len(dt), []
    for key, part in system.networks.items():
        for name, weight in part.weights().items():
            leaf = weight.detach()[..., None].expand(*weight.shape, lanes).clone().requires_grad_()
            setattr(p[key], name, leaf)
            leaves.append(leaf)
    count = sum(leaf.numel() for leaf in leaves) // lanes
    state = list(x.unbind(1))

    def jacobian(targets: Sequence[Tensor]) -> Tensor:
        rows = []
        for target in targets:
            if not target.requires_grad:
                rows.append(x.new_zeros(lanes, count))
                continue
            grads = torch.autograd.grad(target.sum(), leaves, retain_graph=True, allow_unused=True)
            columns = [torch.zeros_like(w) if g is None else g for w, g in zip(leaves, grads, strict=True)]
            rows.append(torch.cat([c.reshape(-1, lanes) for c in columns]).T)
        return torch.stack(rows, 1)

    with torch.enable_grad():
        now, later = system.outputs(outputs, state, u, p), engine.sample(system, state, u, dt, p)
    return jacobian(later), jacobian(now)
