"""Torques that go with the rotor's angle: how many periods a turn, and how large, to begin a fit with."""

from __future__ import annotations

import numpy as np
import torch

from hybrid_id.gap.probe import probe
from hybrid_id.identification.result import FitResult
from hybrid_id.simulation.batch import Batch

PERIODS = range(1, 49)


def likely_waves(
    result: FitResult, batch: Batch, joint: int, count: int = 2
) -> list[tuple[int, float, float]]:
    """Torques ``T_c cos(n q) + T_s sin(n q)`` that would explain most of what a fit leaves, best first: (n, T_c, T_s).

    The phase is that of the measured angle: a simulation that is off by a fraction of a period has lost it.

    Args:
        result: pooled fit.
        batch: its records.
        joint: number, from 1.
        count: how many to return.
    """
    opened = probe(result.system, result.engine, batch, joint, "motor")
    phase = batch.x[..., opened.row]
    waves = torch.stack([f(n * phase) for n in PERIODS for f in (torch.cos, torch.sin)], -1)
    own, left = opened.own.flatten(0, 1).numpy(), opened.left.flatten().numpy()
    response = opened.response(waves).flatten(0, 1).numpy()
    basis = np.linalg.qr(own / np.maximum(np.linalg.norm(own, axis=0), 1e-300))[0]
    response, left = response - basis @ (basis.T @ response), left - basis @ (basis.T @ left)
    found = []
    for i, n in enumerate(PERIODS):
        pair = response[:, 2 * i : 2 * i + 2]
        wave = np.linalg.lstsq(pair, left, rcond=1e-8)[0]
        found.append((float(np.square(left - pair @ wave).sum()), n, float(wave[0]), float(wave[1])))
    return [(n, first, second) for _, n, first, second in sorted(found)[:count]]
