"""How many periods a turn a torque that goes with the rotor's angle may have: a scan by one linearisation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from hybrid_id.components import Cogging
from hybrid_id.identification.result import FitResult
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.lifted import condense, linearise
from hybrid_id.simulation.rollout import simulate

PERIODS = range(1, 49)


def likely_periods(result: FitResult, batch: Batch, joint: int, count: int = 2) -> list[int]:
    """The periods a turn of the rotor whose torque would explain most of a fit's residuals, best first.

    The outputs' response to ``T cos(n q) + T' sin(n q)`` for all n comes from one linearisation of the fitted model,
    with the measured angle in the phase; what the model's own parameters could explain is projected out.

    Args:
        result: pooled fit.
        batch: its records.
        joint: number, from 1.
        count: how many to return.
    """
    where = f"joint{joint}/motor"
    probe = result.system.with_component(where, Cogging(T_c=0.0, T_s=0.0, n=0.0))
    column = [
        i
        for i, info in enumerate(probe.table)
        if (info.component, info.symbol) == (f"{where}/cogging", "T_c")
    ]
    theta = probe.theta().detach()[:, None].expand(-1, batch.rows)
    x = simulate(probe, result.engine, batch).x
    lin = linearise(probe, result.engine, x, batch.u, batch.dt, theta, column, batch.outputs)
    phase = batch.x[..., result.system.joints[joint - 1].positions[0]]
    waves = torch.stack([f(n * phase) for n in PERIODS for f in (torch.cos, torch.sin)], -1)
    chained = condense(
        replace(lin, b=lin.b * waves[:, :, None, :], d=lin.d.expand(*lin.d.shape[:-1], waves.shape[-1])), x
    )
    n_x = x.shape[-1]
    response = lin.c @ chained[..., n_x:-1] * batch.weight[..., None]
    keep = [(batch.weight[r] > 0).any(1).numpy() for r in range(batch.rows)]
    waves_out = np.concatenate(
        [response[r].numpy()[k].reshape(-1, waves.shape[-1]) for r, k in enumerate(keep)]
    )
    own = np.concatenate([j.reshape(-1, j.shape[-1]) for j in result.jacobian])
    left = np.concatenate([r.reshape(-1) for r in result.residual])
    basis = np.linalg.qr(own / np.maximum(np.linalg.norm(own, axis=0), 1e-300))[0]
    waves_out = waves_out - basis @ (basis.T @ waves_out)
    left = left - basis @ (basis.T @ left)
    gains = []
    for i in range(len(PERIODS)):
        pair = waves_out[:, 2 * i : 2 * i + 2]
        fit = np.linalg.lstsq(pair, left, rcond=1e-8)[0]
        gains.append(float(left @ left - np.square(left - pair @ fit).sum()))
    return [PERIODS[i] for i in np.argsort(gains)[::-1][:count]]
