"""How long a model runs free before it starts again from a measured state: whole records, strokes, or windows."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from hybrid_id.components.base import Transmission
from hybrid_id.errors import InputError
from hybrid_id.identification.objective import Loss, evaluate
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.rollout import Simulation, simulate
from hybrid_id.simulation.stability import with_substeps
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.chain import System

SHORTEST = 25
"""Fewest samples of a window or a stroke."""
STILL, REST = 0.02, 0.1
"""A joint rests while its speed stays below this share of its largest one, for so long [s] at least."""


@dataclass(frozen=True)
class Horizon:
    """How long a free run is.

    Attributes:
        kind: "whole" records, "strokes" (from rest to rest), or "windows" of one length.
        seconds: length of the windows; 0 for the other kinds.
        reason: why it was chosen, in words; empty where the user chose it.
    """

    kind: Literal["whole", "strokes", "windows"] = "whole"
    seconds: float = 0.0
    reason: str = ""

    def __post_init__(self) -> None:
        if (self.kind == "windows") != (0.0 < self.seconds < np.inf):
            raise InputError(
                f"A horizon of {self.kind} has {self.seconds:g} s; give windows a positive length, others none."
            )

    @staticmethod
    def of(wish: str | float) -> Horizon | None:
        """The horizon of a user's word: a length [s], "whole", "strokes", or "auto" (None: the records choose).

        Raises:
            InputError: no such horizon.
        """
        if wish == "auto":
            return None
        if wish in ("whole", "strokes"):
            return Horizon(wish)  # type: ignore[arg-type]
        with suppress(ValueError):
            if 0.0 < float(wish) < np.inf:
                return Horizon("windows", float(wish))
        raise InputError(f"window '{wish}' is not known; give a length in seconds, whole, strokes or auto")

    def __str__(self) -> str:
        names = {"whole": "free runs over whole records", "strokes": "free runs from rest to rest"}
        words = names.get(self.kind, f"free runs of {self.seconds:g} s from measured states")
        return f"{words}, for {self.reason}" if self.reason else words

    def cut(self, system: System, engine: Engine, batch: Batch) -> Batch:
        """The pieces of a batch over which a model runs free; the batch itself where there is only one a record.

        Every piece keeps the name of its record, and the pieces of a record follow each other without overlap. Its
        first state is as measured, free within its uncertainty. What nobody has measured (heat, bristles, the twist of
        a gear without an encoder at its link) begins as in a free run of the model and is held there: free to move, it
        would explain whatever happens in so short a time.

        Args:
            system: model with the values that its hidden states are simulated with.
            engine: how.
            batch: whole records, prepared for it.
        """
        if self.kind == "windows":
            return windows(system, engine, batch, self.seconds)
        return strokes(system, engine, batch) if self.kind == "strokes" else batch


WHOLE = Horizon()


def windows(system: System, engine: Engine, batch: Batch, seconds: float) -> Batch:
    """Windows of whole records, see :meth:`Horizon.cut`; records too short for four windows stay whole.

    Args:
        system: model with the values that its hidden states are simulated with.
        engine: how.
        batch: whole records, prepared for it.
        seconds: length of a window.
    """
    if window_samples(batch.x.shape[1], batch.step, seconds) is None:
        return batch
    batch, hidden = _simulated_hidden(system, engine, batch)
    cut = measured_windows(system, batch, seconds)
    if cut is None:
        return batch
    cut[0].x0_std[:, hidden] = 0.0
    return cut[0]


def strokes(system: System, engine: Engine, batch: Batch) -> Batch:
    """Pieces from rest to rest, see :meth:`Horizon.cut`; a piece begins amid a rest between two motions.

    Args:
        system: model with the values that its hidden states are simulated with.
        engine: how.
        batch: whole records, prepared for it.
    """
    cuts = [_stroke_starts(system, batch, row) for row in range(batch.rows)]
    if all(len(starts) == 2 for starts in cuts):
        return batch
    batch, hidden = _simulated_hidden(system, engine, batch)
    device = batch.x.device
    row = torch.tensor([r for r, starts in enumerate(cuts) for _ in starts[1:]], device=device)
    start = torch.tensor([s for starts in cuts for s in starts[:-1]], device=device)
    length = torch.tensor([int(n) for starts in cuts for n in np.diff(starts)], device=device)
    x0_std = measured_spread(system, batch)
    x0_std[:, hidden] = 0.0
    x0_std = torch.where((start == 0)[:, None], batch.x0_std[row], x0_std[row])
    return batch.pieces(row, start, length, x0_std)


def _stroke_starts(system: System, batch: Batch, row: int) -> list[int]:
    """First samples of a record's strokes, and the number of its samples."""
    samples = int((batch.weight[row] > 0).any(1).sum())
    rows = [joint.positions[-1] + 1 for joint in system.joints]
    speed = batch.x[row, :samples, rows].abs().cpu().numpy()
    still = (speed <= STILL * speed.max(0)).all(1)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(int)))
    step = float(batch.dt[row][batch.dt[row] > 0].median()) if samples > 1 else np.inf
    starts = [0]
    for first, last in edges.reshape(-1, 2).tolist():
        middle, inside = (first + last) // 2, first > 0 and last < samples
        if inside and (last - first) * step >= REST and middle - starts[-1] >= SHORTEST:
            starts.append(middle)
    if len(starts) > 1 and samples - starts[-1] < SHORTEST:
        starts.pop()
    return [*starts, samples]


def _simulated_hidden(system: System, engine: Engine, batch: Batch) -> tuple[Batch, list[int]]:
    """The batch with its hidden states as in a free run, and their rows."""
    hidden = list(system.memory_rows)
    loose = [j for j in system.joints if not j.rigid and not link_seen(batch, j.number)]
    if not hidden and not loose:
        return batch, hidden
    run = simulate(system, with_substeps(system, engine, batch), batch).x.nan_to_num(0.0, 0.0, 0.0)
    x = batch.x.clone()
    x[..., hidden] = run[..., hidden]
    for joint in loose:
        motor, link = joint.positions
        for row in (0, 1):
            twist = run[..., link + row] - run[..., motor + row] / joint.gear_ratio
            x[..., link + row] = batch.x[..., motor + row] / joint.gear_ratio + twist
            hidden.append(link + row)
    return replace(batch, x=x), hidden


def free_runs(system: System, engine: Engine, batch: Batch, theta: Tensor | None = None) -> Simulation:
    """Free runs of pieces, the first state of each moved by one Gauss-Newton step within its uncertainty.

    What the encoders' noise does to a measured speed is no error of the model.

    Args:
        system: the model.
        engine: how it is simulated.
        batch: pieces, see :meth:`Horizon.cut`.
        theta: parameters of each row, ``(n_p, R)`` (default: the system's values).
    """
    if theta is None:
        theta = system.theta().detach().to(batch.x.device)[:, None].expand(-1, batch.rows)
    at = evaluate(system, engine, batch, batch.x, theta, [], loss=Loss(), chunk=batch.x.shape[1])
    x = batch.x.clone()
    with suppress(RuntimeError):  # states that nothing identifies stay as they were measured
        x[:, 0] -= torch.linalg.solve(at.hessian, at.gradient)
    return simulate(system, engine, replace(batch, x=x), theta)


def window_errors(system: System, engine: Engine, batch: Batch, seconds: float) -> list[np.ndarray]:
    """Weighted errors of a model over windows, ``(T, n_y)`` each; none where the records are too short for them.

    Args:
        system: the model.
        engine: how it is simulated.
        batch: whole records, prepared for it.
        seconds: length of a window.
    """
    short = windows(system, engine, batch, seconds)
    if short.rows == batch.rows:
        return []
    run = free_runs(system, with_substeps(system, engine, short), short)
    found = ((run.y - short.y) * short.weight).numpy()
    return [row[(weight > 0).any(1)] for row, weight in zip(found, short.weight.numpy(), strict=True)]


def window_samples(samples: int, step: float, seconds: float) -> int | None:
    """Samples of a window of so many seconds, 25 at least; None where four do not fit into a record.

    Args:
        samples: of the longest record.
        step: sample time [s].
        seconds: length of the window.
    """
    length = max(SHORTEST, round(seconds / step))
    return length if 4 * length <= samples else None


def measured_windows(
    system: System, batch: Batch, seconds: float, every: int = 1
) -> tuple[Batch, Tensor] | None:
    """Windows of a batch whose first states are measured and free within their uncertainty, and the row of each.

    Args:
        system: tells the states.
        batch: whole records.
        seconds: length of a window.
        every: use one window in this many.

    Returns:
        None where the records are shorter than four windows.
    """
    length = window_samples(batch.x.shape[1], batch.step, seconds)
    if length is None:
        return None
    return batch.windows(length, every * length, measured_spread(system, batch))


def measured_spread(system: System, batch: Batch) -> Tensor:
    """Standard deviation of states that are measured in motion, ``(R, n_x)``."""
    noise = dict(zip(batch.outputs, (1.0 / batch.weight.amax(1)).unbind(1), strict=True))
    x0_std = 0.1 * batch.std(batch.x)
    x0_std[:, system.memory_rows] = 0.0
    for joint in system.joints:
        # behind a rigid gear either encoder tells both sides
        link = joint.gear_ratio if joint.rigid else 1.0
        for side, row, ratio in (("a", joint.positions[-1], link), ("m", joint.positions[0], 1.0)):
            if (angle := noise.get(f"q_{side}{joint.number}")) is not None:
                x0_std[:, row], x0_std[:, row + 1] = ratio * angle, ratio * angle / (20 * batch.step)
            if (speed := noise.get(f"v_{side}{joint.number}")) is not None:
                x0_std[:, row + 1] = ratio * speed
    return x0_std


def link_seen(batch: Batch, joint: int) -> bool:
    """Whether an encoder sees the link of a joint, numbered from 1."""
    return bool({f"q_a{joint}", f"v_a{joint}"} & set(batch.outputs))


def hidden_links(system: System, batch: Batch) -> bool:
    """Whether no encoder sees a link that its gear leaves loose near zero load.

    Behind a spring that is stiff throughout the link is where its motor is, nearly: measured windows do, and cost less.
    """
    return any(
        type(joint.gear.transmission[1]).loaded is not Transmission.loaded
        and not link_seen(batch, joint.number)
        for joint in system.joints
    )
