"""Simulations that a study is judged by: every set on every record, test records, halved steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from hybrid_id.identification.horizons import WHOLE, Horizon, free_runs
from hybrid_id.identification.result import FitResult
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.record import Record
from hybrid_id.simulation.prepare import Batch, make_batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.solvers import stable_engine
from hybrid_id.simulation.step import Engine
from hybrid_id.statistics.cross_validation import CrossValidation, cross_validation
from hybrid_id.statistics.fit import fit_percent, known_mean, nrmse
from hybrid_id.systems.chain import System

LANES = 400_000
"""Samples that are simulated at once."""


def batch_of(
    dataset: Dataset, system: System, records: Sequence[Record], signal_share: float, device: str
) -> Batch:
    """Records of a dataset prepared with the noise that it declares."""
    noise = {channel.name: channel.noise_std for channel in dataset.outputs}
    return make_batch(system, records, noise_std=noise, signal_share=signal_share).to(device)


def cross_validate(sets: Sequence[FitResult], batch: Batch, *, pooled: bool) -> CrossValidation:
    """Fit % of every set on every record: measured outputs, and speeds against smoothed derivatives.

    Args:
        sets: parameter sets.
        batch: whole records, or their pieces, over which the free runs begin anew.
        pooled: whether one set was fitted to all of them.
    """
    system, engine = sets[0].system, max((r.engine for r in sets), key=lambda e: e.substeps)
    speeds = [joint.positions[0] + 1 for joint in system.joints if f"v_m{joint.number}" not in batch.outputs]
    signals = (*batch.outputs, *(system.state_names[row] for row in speeds))
    theta = torch.stack([r.system.theta().detach() for r in sets], 1).to(batch.x.device)
    share = max(1, LANES // (batch.rows * batch.x.shape[1]))
    records = tuple(dict.fromkeys(batch.names))
    run_freely = simulate if len(records) == batch.rows else free_runs
    fits = np.empty((len(sets), len(records), len(signals)))
    for first in range(0, len(sets), share):
        some = torch.arange(first, min(first + share, len(sets)))
        rows = torch.arange(batch.rows).repeat(len(some)).to(batch.x.device)
        run = run_freely(system, engine, batch.take(rows), theta[:, some.repeat_interleave(batch.rows)])
        simulated = torch.cat([run.y, run.x[..., speeds]], -1).cpu().numpy()
        for k, i in enumerate(some.tolist()):
            fits[i] = _fits(batch, simulated[k * batch.rows : (k + 1) * batch.rows], speeds)
    own = [-1] * len(sets) if pooled else list(range(len(sets)))
    labels = ["pooled"] if pooled else [r.records[0] for r in sets]
    return cross_validation(
        fits, set_names=labels, record_names=records, signal_names=signals, own_record=own
    )


def _fits(batch: Batch, simulated: np.ndarray, speeds: Sequence[int]) -> np.ndarray:
    measured = torch.cat([batch.y, batch.x[..., list(speeds)]], -1).cpu().numpy()
    records, names = list(dict.fromkeys(batch.names)), np.array(batch.names)
    fits = np.empty((len(records), measured.shape[-1]))
    valid = (batch.weight > 0).any(2).cpu().numpy()
    for row, record in enumerate(records):
        mine = valid & (names == record)[:, None]
        for column in range(measured.shape[-1]):
            fits[row, column] = fit_percent(measured[mine, column], simulated[mine, column])
    return fits


def engine_error(result: FitResult, batch: Batch) -> float:
    """Change of the estimates when the step is halved, in standard errors, at most.

    Linearised at the estimate, along the principal axes of what the records tell, so that it holds where single
    parameters have no standard error.
    """
    rows = torch.tensor([row for row, name in enumerate(batch.names) if name in result.records])
    part = batch.take(rows)
    coarse = simulate(result.system, result.engine, part)
    near = part if "diverged" in coarse.status else replace(part, x=coarse.x)
    fine = simulate(result.system, result.engine.halved(), near)
    change = ((fine.y - coarse.y) * part.weight).cpu().numpy()
    change = np.concatenate([c[: len(r)].reshape(-1) for c, r in zip(change, result.residual, strict=True)])
    jacobian = np.concatenate([j.reshape(-1, j.shape[-1]) for j in result.jacobian])
    if not np.all(np.isfinite(change)):
        return float("inf")
    size = np.linalg.norm(jacobian, axis=0)
    axes, strength, _ = np.linalg.svd(jacobian / np.where(size > 0, size, 1.0), full_matrices=False)
    shift = axes[:, strength > 1e-9 * strength[0]].T @ change
    return float(np.max(np.abs(shift), initial=0.0) / max(result.noise_scale, 1e-300))


def test_nrmse(
    dataset: Dataset, result: FitResult, signal_share: float, horizon: Horizon = WHOLE
) -> dict[str, float]:
    """Normalised RMSE of a set on each test record, by name, outputs averaged; empty without test records."""
    if not dataset.test:
        return {}
    batch = batch_of(dataset, result.system, dataset.test, signal_share, "cpu")
    engine = stable_engine(result.system, result.engine, batch)  # these records may have longer samples
    runs = simulated_over(horizon, result.system, engine, batch)
    return {
        name: known_mean(
            [float(nrmse(measured[: len(run), c], run[:, c])) for c in range(measured.shape[-1])]
        )
        for name, measured, run in zip(batch.names, batch.y.numpy(), runs, strict=True)
    }


def simulated_over(horizon: Horizon, system: System, engine: Engine, batch: Batch) -> list[np.ndarray]:
    """Outputs of a model's free runs over a horizon, those of a record one after the other, ``(T, n_y)`` each.

    The end of a record that is shorter than a window is left out.
    """
    part = horizon.cut(system, engine, batch)
    run = simulate(system, engine, part) if part is batch else free_runs(system, engine, part)
    valid, names = (part.weight > 0).any(2).numpy(), np.array(part.names)
    return [run.y.numpy()[valid & (names == name)[:, None]] for name in batch.names]
