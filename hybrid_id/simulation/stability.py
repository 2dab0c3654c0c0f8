"""Sub-steps from the stiffness of the equations of motion where the records move."""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from torch import Tensor

from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.step import MAX_SUBSTEPS, Engine, fill_jacobian
from hybrid_id.systems.chain import System

LIMIT = {"dry": 0.5, "smooth": 2.5, "memory": 0.2}
"""Largest step times eigenvalue: accuracy of the fastest mode for the dry engine, RK4's region of stability (2.78) for
the smooth one, whose stiff part is the smoothing itself; less with bristles, which alternate with the motion at second
order."""


def fastest_rate(system: System, engine: Engine, batch: Batch, theta: Tensor, nodes: int = 128) -> float:
    """Largest eigenvalue magnitude [1/s] of the equations of motion over nodes of the batch.

    Args:
        system: equations of motion.
        engine: how dry friction enters them.
        batch: where the records move; speeds through zero are added for the smooth engine.
        theta: parameters of each row, ``(n_p, R)``.
        nodes: number of nodes to look at.
    """
    rows, samples, n_x = batch.x.shape
    count, last = min(nodes, rows * samples), rows * samples - 1
    pick = torch.linspace(0, last, count, dtype=torch.float64, device=batch.x.device).long()
    leaves = [c.clone() for c in batch.x.reshape(-1, n_x)[pick].unbind(1)]
    if engine.friction == "smooth":
        for row in system.speed_rows:
            leaves[row][::2] = 0.0
    u = {name: channel.reshape(-1)[pick] for name, channel in batch.u.items()}
    p = system.views(list(theta[:, pick // samples]))
    for joint in system.joints:
        if (loaded := joint.gear.loaded(leaves[joint.positions[0]], p)) is not None:
            leaves[joint.positions[1]][1::2] = loaded[1::2]
    leaves = [leaf.requires_grad_() for leaf in leaves]
    with torch.enable_grad():
        signs = None if engine.friction == "smooth" else system.directions(leaves, u, p)
        rates = system.rates(leaves, u, p, signs, engine.width)
        state_updates = system.state_updates(leaves, u, p)
    jacobian = torch.zeros(n_x, n_x, len(pick), dtype=batch.x.dtype, device=batch.x.device)
    fill_jacobian(jacobian, rates, leaves)
    # what remembers couples back through its drive (a bristle that sticks is a spring); its own rate is exact
    for row, one in state_updates:
        fill_jacobian(jacobian[row : row + 1], [one.drive], leaves)
    jacobian = jacobian.permute(2, 0, 1)
    jacobian = jacobian[torch.isfinite(jacobian).all(2).all(1)]
    return float(torch.linalg.eigvals(jacobian).abs().max()) if len(jacobian) else math.inf


def with_substeps(system: System, engine: Engine, batch: Batch, theta: Tensor | None = None) -> Engine:
    """The engine with at least as many sub-steps as stability and accuracy need at these parameters.

    Args:
        system: equations of motion.
        engine: whose sub-steps are the least.
        batch: where the records move.
        theta: parameters of each row, ``(n_p, R)`` (default: the system's values).
    """
    if theta is None:
        theta = system.theta().detach().to(batch.x.device)[:, None].expand(-1, batch.rows)
    rate, step = fastest_rate(system, engine, batch, theta), float(batch.dt.max())
    limit = LIMIT["memory" if system.memory_rows else engine.friction]
    needed = MAX_SUBSTEPS if not math.isfinite(rate) else math.ceil(step * rate / limit)
    return replace(engine, substeps=max(engine.substeps, min(needed, engine.most_substeps)))
