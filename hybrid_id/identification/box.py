"""The small box-constrained quadratic problem of one Levenberg-Marquardt step, for many sets at once."""

from __future__ import annotations

import torch
from torch import Tensor


def solve_box(hessian: Tensor, gradient: Tensor, low: Tensor, high: Tensor, rounds: int = 6) -> Tensor:
    """Minimise ``g s + s H s / 2`` over ``low <= s <= high`` for a batch, by an active set from the free solution.

    Args:
        hessian: H, ``(G, n, n)``, positive definite.
        gradient: g, ``(G, n)``.
        low: lower limits, ``(G, n)``, not above 0.
        high: upper limits, ``(G, n)``, not below 0.
        rounds: changes of the active set before the step is taken as it is.
    """
    step = torch.zeros_like(gradient)
    fixed = torch.zeros_like(gradient, dtype=torch.bool)
    identity = torch.eye(gradient.shape[1], dtype=gradient.dtype, device=gradient.device)
    for _ in range(rounds):
        pinned = torch.where(fixed, step, torch.zeros_like(step))
        right = -(gradient + (hessian @ pinned[..., None])[..., 0])
        loose = (~fixed).to(gradient.dtype)
        matrix = hessian * loose[:, :, None] * loose[:, None, :] + identity * (1.0 - loose)[:, :, None]
        free = torch.linalg.solve(matrix, right * loose)
        candidate = torch.where(fixed, step, free)
        clipped = candidate.clamp(low, high)
        slope = gradient + (hessian @ clipped[..., None])[..., 0]
        outside = clipped != candidate
        release = fixed & (((clipped <= low) & (slope < 0)) | ((clipped >= high) & (slope > 0)))
        step = clipped
        if not bool((outside | release).any()):
            break
        fixed = (fixed | outside) & ~release
    return step
