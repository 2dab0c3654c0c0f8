"""What every multiple-shooting peer starts from: states at the segment boundaries, read off the measured angle."""

from __future__ import annotations

import numpy as np

from benchmarks.reference import SAMPLE_TIME, Array


def boundary_states(angle: Array, length: int, half_window: int = 15) -> Array:
    """(R, S, 2) states (q, v) at every `length`-th sample of angles (R, T): local quadratics by least squares.

    The window shifts inwards at the ends of the record.
    """
    n_samples = angle.shape[1]
    boundaries = np.arange(0, n_samples, length)
    centres = np.clip(boundaries, half_window, n_samples - 1 - half_window)
    offset = np.arange(-half_window, half_window + 1)
    polynomial = np.linalg.pinv(np.vander(SAMPLE_TIME * offset, 3, increasing=True))  # (3, W)
    c0, c1, c2 = np.einsum("pw,rsw->prs", polynomial, angle[:, centres[:, None] + offset])
    t = SAMPLE_TIME * (boundaries - centres)
    return np.stack([c0 + c1 * t + c2 * t**2, c1 + 2.0 * c2 * t], axis=-1)
