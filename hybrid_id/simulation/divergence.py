"""Why a simulation has left all bounds, in one sentence for the user."""

from __future__ import annotations

import torch

from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.stability import LIMIT, MAX_SUBSTEPS, fastest_rate
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.chain import System


def cause_of_divergence(
    system: System, engine: Engine, batch: Batch, x: torch.Tensor, theta: torch.Tensor | None = None
) -> str:
    """Which record lost which state at what time, and why probably, of the first row that diverged; "" where none did.

    Args:
        system: what was simulated, with the values that it was simulated with.
        engine: how.
        batch: the records.
        x: states of their free runs, ``(R, T, n_x)``.
        theta: all parameters, ``(n_p,)`` (default: the system's values).
    """
    finite = torch.isfinite(x)
    lost = (~finite.all(2).all(1)).nonzero().flatten().tolist()
    if not lost:
        return ""
    row = lost[0]
    sample = int((~finite[row].all(1)).nonzero()[0, 0])
    state = system.state_names[int((~finite[row, sample]).nonzero()[0, 0])]
    time = float(batch.dt[row, :sample].sum())
    where = f"record '{batch.names[row]}': the simulation has no finite {state} from {time:.3g} s on"
    if not torch.isfinite(batch.x[row]).all():
        return f"{where}, because the record's own samples are not finite; correct the record"
    theta = (system.theta().detach() if theta is None else theta)[:, None]
    p = system.views(list(theta))
    for key, part in system.arm.couplings.items():
        least = system.arm.determinant(p, key, part)
        if least is not None and not bool((least > 0).all()):
            return f"{where}, because the mass matrix is singular; bring down the values of {part.kind}"
    one = batch.take(torch.tensor([row]))
    rate = fastest_rate(system, engine, one, theta)
    step, limit = float(one.dt.max()), LIMIT["memory" if system.memory_rows else engine.friction]
    if step * rate > limit * max(engine.substeps, 1):
        taken = step / max(engine.substeps, 1)
        return (
            f"{where}, because its step of {taken:.2g} s is unstable for a model whose fastest "
            f"time constant is {1.0 / rate:.2g} s ({MAX_SUBSTEPS} sub-steps a sample at most); correct the units or "
            "the smallest inertia, or resample"
        )
    largest = float(x[row, :sample].abs().max()) if sample else 0.0
    return (
        f"{where}, because the motion grows without bound (up to {largest:.2g} before); correct the units, "
        "the signs or the values of the model"
    )
