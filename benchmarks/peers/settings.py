"""What every multiple-shooting peer shares: settings of the fit, chosen on the numba peer, and the start states.

With these settings 60 of 60 fits (ten records, six sets of starts) reach the noise floor, in 9 evaluations on
average. Two phases: the segments' states held at their measured values, then free and closing their gaps. Without
the first phase a third of the fits stall; without the limit on the relative step every sixth does.
"""

from __future__ import annotations

import numpy as np

from benchmarks.reference import SAMPLE_TIME, Array

LENGTH = 25  # samples a segment
MAX_ITERATIONS = 100
FIRST_DAMPING = 1e-2
LARGEST_STEP = 0.3  # of a parameter's value
HELD_TOLERANCE = 0.1  # end of the first phase: promised relative fall of its merit
GAP_WEIGHT_HELD = (1.0, 0.05)  # of angle [1] and speed [s] gaps beside the residuals, first phase
GAP_WEIGHT_CLOSING = (70.0, 5.0)  # the same in the merit of the second phase


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
