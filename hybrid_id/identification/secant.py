"""Least squares by whole rollouts and finite steps, for gears whose contacts no linearisation survives.

Behind play, the tangent of a trajectory grows with every impact while the trajectory itself does not: exact
sensitivities tell the wrong way, and Newton's method over all samples leaves the valley. Differences over a hundredth
of a parameter see through the impacts. Every difference is a lane of one compiled rollout.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, cast

import numpy as np
import torch
from scipy.optimize import least_squares

from hybrid_id.errors import InputError
from hybrid_id.identification.fit import make_bounds
from hybrid_id.identification.result import FitResult
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.lifted import shoot
from hybrid_id.simulation.stability import with_substeps
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.chain import System

STEPS = (0.01, 0.15, 0.01)
"""Finite steps, as shares of the parameters: in between, a coarse one sees through the ripple of the cost."""
WORST = 1e3
"""Weighted residual that stands for a simulation that has left all bounds."""
SETTLED = 1e-4
"""The fit ends when cost or parameters change by less than this share."""


class Rollouts:
    """Weighted residuals of a batch for many parameter sets at once.

    Args:
        system: what is simulated.
        batch: whole records; their first states are held.
        engine: how (its sub-steps are raised where stability asks for it).
        free: indices of the parameters that the points give.
    """

    def __init__(self, system: System, batch: Batch, engine: Engine, free: Sequence[int]) -> None:
        self.system, self.batch, self.free = system, batch, list(free)
        self.theta = system.theta().detach()
        self.engine = with_substeps(system, engine, batch, self.theta[:, None].expand(-1, batch.rows))
        # a delay changes the channels only: they arrive before the rollout, which then needs no past
        self.plain = system
        for key in [joint.drive.delay[0] for joint in system.joints if joint.drive.delay is not None]:
            where, _, kind = key.rpartition("/")
            self.plain = self.plain.without_component(where, kind)
        place = {(info.component, info.symbol): i for i, info in enumerate(system.table)}
        self.rows = [place[info.component, info.symbol] for info in self.plain.table]

    def residuals(self, points: np.ndarray) -> np.ndarray:
        """Residuals ``(P, R, T, n_y)`` at the points ``(P, n_f)``."""
        rows, count = self.batch.rows, len(points)
        theta = self.theta[:, None].repeat(1, count)
        theta[self.free] = torch.tensor(points.T)
        theta = theta.repeat_interleave(rows, 1)
        part = self.batch.take(torch.arange(rows).repeat(count))
        with torch.no_grad():
            samples = part.x.shape[1]
            views = self.system.views(list(theta.repeat_interleave(samples, 1)))
            channels = self.system.hold(
                {name: channel.reshape(-1) for name, channel in part.u.items()}, views
            )
            arrived = {name: channels[name].view_as(part.dt) for name in self.plain.input_names}
            arrived |= {name: channel for name, channel in part.u.items() if name.startswith("enable")}
            x = shoot(self.plain, self.engine, part.x, arrived, part.dt, theta[self.rows], samples)
            y = self.system.outputs(part.outputs, x.reshape(-1, x.shape[-1]).unbind(1), channels, views)
        run = torch.stack(y, -1).reshape(*x.shape[:2], -1)
        residual = ((part.y - run) * part.weight).nan_to_num(WORST, WORST, -WORST).clamp(-WORST, WORST)
        return residual.reshape(count, rows, *residual.shape[1:]).numpy()


def secant_fit(
    system: System, batch: Batch, *, engine: Engine, iterations: int = 20, starts: Sequence[System] = ()
) -> FitResult:
    """Fit one parameter set to all rows of a batch.

    Args:
        system: model with start values and bounds.
        batch: prepared records.
        engine: how a sample is integrated; the smooth engine, compiled, makes this affordable.
        iterations: trial points at each finite step.
        starts: the same model at other values; the fit starts at the best of them all.

    Raises:
        InputError: nothing to estimate.
    """
    free = [i for i, info in enumerate(system.table) if info.spec.estimate]
    if not free:
        raise InputError("The model has no parameter to estimate; set 'estimate: true' for at least one.")
    bounds, run = make_bounds(system, free), Rollouts(system, batch, engine, free)
    low, high = bounds.lower.numpy(), bounds.upper.numpy()
    points = np.array([s.theta().detach().numpy()[free] for s in (system, *starts)])
    start = points[np.square(run.residuals(points)).sum((1, 2, 3)).argmin()] if starts else points[0]
    size = np.maximum(np.abs(start), bounds.scale.numpy())

    def residual(z: np.ndarray) -> np.ndarray:
        return run.residuals(np.clip(z * size, low, high)[None])[0].reshape(-1)

    def tangent(z: np.ndarray, share: float) -> np.ndarray:
        value = np.clip(z * size, low, high)
        step = share * np.maximum(np.abs(value), 0.1 * size)
        step = np.where(value + step > high, -np.minimum(step, value - low), step)
        found = run.residuals(np.vstack([value, value + np.diag(step)])).reshape(len(free) + 1, -1)
        return ((found[1:] - found[0]) / (step / size)[:, None]).T

    inside = 1e-10 * np.minimum(high - low, size)
    box, z, spent = (low / size, high / size), np.clip(start, low + inside, high - inside) / size, 0
    solution = None
    for share in STEPS:
        slopes = cast(Any, partial(tangent, share=share))
        solution = least_squares(
            residual, z, slopes, bounds=box, max_nfev=iterations, ftol=SETTLED, xtol=SETTLED
        )
        z, spent = (
            np.clip(solution.x, low / size + inside / size, high / size - inside / size),
            spent + solution.nfev,
        )
    assert solution is not None
    value = np.clip(solution.x * size, low, high)
    shape = batch.y.shape
    jacobian = -(tangent(solution.x, STEPS[-1]) / size).reshape(*shape, len(free))
    left = residual(solution.x).reshape(shape)
    keep = [(batch.weight[r] > 0).any(1).numpy() for r in range(batch.rows)]
    names = tuple(system.table[i].name for i in free)
    return FitResult(
        system=system.with_values(dict(zip(names, value.tolist(), strict=True))),
        names=names,
        values=value,
        units=tuple(system.table[i].spec.unit for i in free),
        status="converged" if solution.status > 0 else "max_iterations",
        records=batch.names,
        cost=float(solution.cost),
        n_samples=int((batch.weight > 0).sum()),
        iterations=int(spent),
        jacobian=tuple(jacobian[r][keep[r]] for r in range(batch.rows)),
        residual=tuple(left[r][keep[r]] for r in range(batch.rows)),
        prior_precision=np.zeros(len(free)),
        x0=batch.x[:, 0].numpy(),
        engine=run.engine,
        history=(float(solution.cost),),
    )
