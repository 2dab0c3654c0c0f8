"""Windows of records that begin where the machine was seen to be, for models whose free runs lose the records."""

from __future__ import annotations

from dataclasses import replace

from hybrid_id.identification.fit import measured_windows
from hybrid_id.identification.horizons import link_seen
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.rollout import simulate
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
        x, run = batch.x.clone(), simulate(system, engine, batch).x.nan_to_num(0.0, 0.0, 0.0)
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
