"""Windows of records that begin where the machine was seen to be, for models whose free runs lose the records."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np
import torch

from hybrid_id.identification.fit import measured_windows
from hybrid_id.identification.horizons import link_seen
from hybrid_id.identification.objective import Loss, evaluate
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.stability import with_substeps
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.chain import System


def windows(system: System, engine: Engine, batch: Batch, seconds: float) -> Batch:
    """Windows of whole records; those too short for four windows stay whole.

    What nobody has measured (heat, bristles, the twist of a gear without an encoder at its link) begins as in a free
    run of the model and is held there: free to move, it would explain whatever happens in so short a time.

    Args:
        system: model with the values that its hidden states are simulated with.
        engine: how.
        batch: whole records, prepared for it.
        seconds: length of a window.
    """
    hidden = list(system.memory_rows)
    loose = [j for j in system.joints if not j.rigid and not link_seen(batch, j.number)]
    if hidden or loose:
        run = simulate(system, with_substeps(system, engine, batch), batch).x.nan_to_num(0.0, 0.0, 0.0)
        x = batch.x.clone()
        x[..., hidden] = run[..., hidden]
        for joint in loose:
            motor, link = joint.positions
            for row in (0, 1):
                twist = run[..., link + row] - run[..., motor + row] / joint.gear_ratio
                x[..., link + row] = batch.x[..., motor + row] / joint.gear_ratio + twist
                hidden.append(link + row)
        batch = replace(batch, x=x)
    cut = measured_windows(system, batch, seconds)
    if cut is None:
        return batch
    cut[0].x0_std[:, hidden] = 0.0
    return cut[0]


def window_errors(system: System, engine: Engine, batch: Batch, seconds: float) -> list[np.ndarray]:
    """Weighted errors of a model over windows, ``(T, n_y)`` each; none where the records are too short for them.

    The first state of each is moved by one Gauss-Newton step within its uncertainty: what the encoders' noise does to a
    measured speed is no error of the model.

    Args:
        system: the model.
        engine: how it is simulated.
        batch: whole records, prepared for it.
        seconds: length of a window.
    """
    short = windows(system, engine, batch, seconds)
    if short.rows == batch.rows:
        return []
    run = simulate(system, *_started(system, engine, short))
    found = ((run.y - short.y) * short.weight).numpy()
    return [row[(weight > 0).any(1)] for row, weight in zip(found, short.weight.numpy(), strict=True)]


def _started(system: System, engine: Engine, short: Batch) -> tuple[Engine, Batch]:
    """Windows whose first states are moved by one Gauss-Newton step within their uncertainty, and a stable engine."""
    theta = system.theta().detach()[:, None].expand(-1, short.rows)
    engine = with_substeps(system, engine, short, theta)
    at = evaluate(system, engine, short, short.x, theta, [], loss=Loss(), chunk=short.x.shape[1])
    x = short.x.clone()
    with suppress(RuntimeError):  # states that nothing tells stay as they were measured
        x[:, 0] -= torch.linalg.solve(at.hessian, at.gradient)
    return engine, replace(short, x=x)


def free_runs(
    system: System, engine: Engine, batch: Batch, seconds: float | None = None
) -> tuple[Batch, np.ndarray]:
    """Free runs of a model over whole records or over windows of them: what is run, and its outputs ``(R, T, n_y)``.

    Args:
        system: the model.
        engine: how it is simulated.
        batch: whole records, prepared for it.
        seconds: length of the windows; None for whole records.
    """
    short = batch if seconds is None else windows(system, engine, batch, seconds)
    if short.rows == batch.rows:  # records too short for windows stay whole, from where they have begun
        return batch, simulate(system, with_substeps(system, engine, batch), batch).y.numpy()
    return short, simulate(system, *_started(system, engine, short)).y.numpy()
