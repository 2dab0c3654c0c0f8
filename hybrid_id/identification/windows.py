"""Windows of records: pieces from measured states, and which links nobody measures."""

from __future__ import annotations

import torch
from torch import Tensor

from hybrid_id.components.base import Transmission
from hybrid_id.simulation.batch import Batch
from hybrid_id.systems.chain import System

SHORTEST = 25
"""Fewest samples of a window or a stroke."""


def window_samples(samples: int, step: float, seconds: float, least: int = 4) -> int | None:
    """Samples of a window of so many seconds, 25 at least; None where fewer than ``least`` fit into a record.

    Args:
        samples: of the longest record.
        step: sample time [s].
        seconds: length of the window.
        least: windows that a record holds.
    """
    length = max(SHORTEST, round(seconds / step))
    return length if least * length <= samples else None


def holds_enough(seconds: float, step: float) -> bool:
    """Whether a window of so many seconds holds enough samples as it is, and is not made longer for it."""
    return seconds / step > SHORTEST - 0.5


def measured_windows(
    system: System, batch: Batch, seconds: float, every: int = 1, least: int = 4
) -> tuple[Batch, Tensor] | None:
    """Windows of a batch whose first states are measured and free within their uncertainty, and the row of each.

    Args:
        system: has the states.
        batch: whole records.
        seconds: length of a window.
        every: use one window in this many.
        least: windows that the longest record holds.

    Returns:
        None where it holds fewer.
    """
    length = window_samples(batch.x.shape[1], batch.sample_time, seconds, least)
    if length is None:
        return None
    return batch.windows(length, every * length, measured_spread(system, batch))


def measured_spread(system: System, batch: Batch) -> Tensor:
    """Standard deviation of states that are measured in motion, ``(R, n_x)``; 0 of those that are not."""
    noise = dict(zip(batch.outputs, (1.0 / batch.weight.amax(1)).unbind(1), strict=True))
    x0_std = torch.zeros_like(batch.x[:, 0])
    for joint in system.joints:
        # behind a rigid gear either encoder tells both sides
        link = max(abs(turns) for _, turns in joint.links) if joint.rigid else 1.0
        for side, row, ratio in (("a", joint.positions[-1], link), ("m", joint.positions[0], 1.0)):
            if (angle := noise.get(f"q_{side}{joint.number}")) is not None:
                x0_std[:, row], x0_std[:, row + 1] = ratio * angle, ratio * angle / (20 * batch.sample_time)
            if (speed := noise.get(f"v_{side}{joint.number}")) is not None:
                x0_std[:, row + 1] = ratio * speed
    return x0_std


def hidden_links(system: System, batch: Batch) -> bool:
    """Whether no encoder sees a link that its gear leaves loose near zero load.

    Behind a spring that is stiff throughout the link is where its motor is, nearly: measured windows do, and cost less.
    """
    return any(
        type(joint.gear.transmission[1]).loaded is not Transmission.loaded
        and joint.positions[1] + 1 in joint.hidden_rows(batch.outputs)  # not its speed either
        for joint in system.joints
    )
