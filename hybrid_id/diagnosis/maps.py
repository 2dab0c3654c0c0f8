"""What a fitted model misses, as pictures show it: a torque over angle and speed, and errors after each reversal."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from hybrid_id.diagnosis.fits import Fits, engine
from hybrid_id.diagnosis.model import FittedModel
from hybrid_id.diagnosis.response import bumps, respond
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.stability import with_substeps
from hybrid_id.study.replay import batch_of

ANGLES, SPEEDS = 7, 6
"""Bumps of the map along each axis; six along the speed leave its middle to a step, as dry friction makes it."""
CELLS = 31
"""Cells of the map along each axis."""
LARGEST = 200_000
"""Samples that a map is made of: of longer datasets so many records, for each of its bumps is simulated over all."""
STILL = 0.02
"""Share of the joint's usual top speed that counts as motion in a direction."""
LONGEST, BINS = 1.0, 40
"""Time [s] after a reversal that is looked at, and parts that it is cut into."""
FEWEST = 8
"""Reversals from which a mean with a standard error is worth showing."""


@dataclass(frozen=True, eq=False)
class TorqueMap:
    """The torque that a model misses at one side of a joint, over angle and speed there.

    Attributes:
        joint: ``joint1`` ...
        side: ``motor`` or ``load``.
        share: part of what the model leaves (mean square) that such a torque explains on records left out.
        angle, speed: centres of the cells, ``(k,)``.
        torque: ``(speed, angle)`` [N m]; NaN where no record has been.
    """

    joint: str
    side: str
    share: float
    angle: np.ndarray
    speed: np.ndarray
    torque: np.ndarray


@dataclass(frozen=True, eq=False)
class Reversals:
    """Mean error of free runs over the time since a joint's motion has turned round.

    Attributes:
        output: which angle.
        count: reversals.
        time: since the reversal, middle of each part [s], ``(k,)``.
        mean: measured - simulated along the new direction, in the output's unit, ``(k,)``; NaN where fewer than
            ``FEWEST`` reversals last so long.
        error: standard error of the mean over the reversals, alike.
    """

    output: str
    count: int
    time: np.ndarray
    mean: np.ndarray
    error: np.ndarray


def torque_map(fits: Fits, model: FittedModel, joint: int, side: str) -> TorqueMap:
    """The torque over angle and speed that would explain most of what a fitted model leaves of the train records.

    Args:
        fits: holds the records.
        model: the fitted model.
        joint: number, from 1.
        side: ``motor``, ``load``, or ``joint`` where both move alike.
    """
    batch = fits.records(model.system)
    shown = max(2, LARGEST // batch.x.shape[1])
    if batch.rows > shown:
        batch = batch.take(torch.linspace(0, batch.rows - 1, shown).round().long())
    opened = respond(model.system, model.result.engine, batch, joint, "load" if side == "load" else "motor")
    row = opened.row
    valid = (batch.weight > 0).any(2)
    q, v = batch.x[..., row], batch.x[..., row + 1]
    low, high = float(q[valid].min()), float(q[valid].max())
    top = float(np.quantile(v[valid].abs().numpy(), 0.98))

    def waves(angle: torch.Tensor, speed: torch.Tensor) -> torch.Tensor:
        sides = bumps(angle, ANGLES, low, high)[..., :, None] * bumps(speed, SPEEDS, -top, top)[..., None, :]
        dry = torch.tanh(speed / (0.002 * float(v[valid].abs().max()) + 1e-12))
        return torch.cat([sides.flatten(-2), dry[..., None]], -1)

    share, coefficients = opened.explained(waves(q, v))
    edges = [np.linspace(start, end, CELLS + 1) for start, end in ((low, high), (-top, top))]
    angle, speed = (0.5 * (edge[1:] + edge[:-1]) for edge in edges)
    grid = waves(*(torch.tensor(axis) for axis in np.meshgrid(angle, speed)))
    seen = np.histogram2d(v[valid].numpy(), q[valid].numpy(), bins=edges[::-1])[0] > 0
    torque = np.where(seen, grid.numpy() @ coefficients, np.nan)
    return TorqueMap(f"joint{joint}", side, share, angle, speed, torque)


def after_reversals(fits: Fits, model: FittedModel) -> list[Reversals]:
    """Mean errors after the reversals of every measured angle, over all records, train and test.

    Args:
        fits: holds the records and their horizon.
        model: the fitted model.
    """
    system, dataset = model.system, fits.dataset
    batch = batch_of(dataset, system, dataset.records)
    batch = fits.horizon.cut(system, engine(), batch)
    run = simulate(system, with_substeps(system, model.result.engine, batch), batch)
    time = torch.cumsum(batch.dt, 1) - batch.dt
    found = []
    for joint in system.joints:
        sides = {f"q_m{joint.number}": joint.positions[0], f"q_a{joint.number}": joint.positions[-1]}
        for output, row in sides.items():
            if output not in batch.outputs:
                continue
            column = batch.outputs.index(output)
            rows = [
                (time[r, used].numpy(), batch.x[r, used, row + 1].numpy(), (batch.y - run.y)[r, used, column].numpy())
                for r, used in enumerate(batch.weight[..., column] > 0)
            ]  # fmt: skip
            if (mean := mean_after_reversals(output, rows)) is not None:
                found.append(mean)
    return found


def mean_after_reversals(
    output: str, rows: list[tuple[np.ndarray, np.ndarray, np.ndarray]]
) -> Reversals | None:
    """Mean of errors over the time since the last reversal, each along the new direction.

    Args:
        output: name of the angle.
        rows: of each record time [s], speed and error, ``(T,)``.

    Returns:
        None where there are fewer than ``FEWEST`` reversals, or a run has diverged.
    """
    if not rows or not all(np.isfinite(error).all() for _, _, error in rows):
        return None
    top = float(np.quantile(np.abs(np.concatenate([speed for _, speed, _ in rows])), 0.98))
    edges = np.linspace(0.0, LONGEST, BINS + 1)
    traces = []
    for time, speed, error in rows:
        # stretches between reversals: a direction counts once the speed leaves what counts as still, and then from
        # where it last was zero; what comes before the first reversal of a record is left out
        moving = np.flatnonzero(np.abs(speed) > STILL * top)
        turned = np.flatnonzero(np.diff(np.sign(speed[moving])))
        turns, firsts = moving[1:][turned], []
        for before, turn in zip(moving[turned], turns, strict=True):
            against = np.flatnonzero(speed[before:turn] * speed[turn] <= 0.0)
            firsts.append(int(before + against[-1]) + 1)
        ends = [*firsts[1:], len(speed)]
        for first, end, turn in zip(firsts, ends, turns, strict=False):
            way = float(np.sign(speed[turn]))
            since = time[first:end] - time[first]
            part = np.minimum(np.searchsorted(edges, since + 1e-9, side="right") - 1, BINS)
            number = np.bincount(part, minlength=BINS + 1)[:BINS]
            total = np.bincount(part, way * error[first:end], minlength=BINS + 1)[:BINS]
            traces.append(np.where(number > 0, total / np.maximum(number, 1), np.nan))
    if len(traces) < FEWEST:
        return None
    values = np.array(traces)
    number = np.sum(~np.isnan(values), axis=0)
    mean = np.nansum(values, axis=0) / np.maximum(number, 1)
    spread = np.sqrt(np.nansum(np.square(values - mean), axis=0) / np.maximum(number - 1, 1))
    lasting = number >= FEWEST
    return Reversals(
        output, len(traces), 0.5 * (edges[1:] + edges[:-1]), np.where(lasting, mean, np.nan),
        np.where(lasting, spread / np.sqrt(np.maximum(number, 1)), np.nan),
    )  # fmt: skip
