"""The small box-constrained quadratic problem of one Levenberg-Marquardt step, for many sets at once."""

from __future__ import annotations

import torch
from torch import Tensor


def solve_box(hessian: Tensor, gradient: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """Minimise ``g s + s H s / 2`` over ``low <= s <= high`` for a batch, by a primal active set from s = 0.

    Each round goes towards the minimum over the loose coordinates, stops at the first bound in the way and holds that
    coordinate; where nothing is in the way, the held coordinate that wants to leave its bound most is let loose
    (Nocedal, Wright, Numerical Optimization, algorithm 16.3). The value falls in every round, and the free
    solution, where it lies inside, takes one.

    Args:
        hessian: H, ``(G, n, n)``, positive definite.
        gradient: g, ``(G, n)``.
        low: lower limits, ``(G, n)``, not above 0.
        high: upper limits, ``(G, n)``, not below 0.
    """
    step = torch.zeros_like(gradient)
    held = ((low >= 0) & (gradient > 0)) | ((high <= 0) & (gradient < 0))
    identity = torch.eye(gradient.shape[1], dtype=gradient.dtype, device=gradient.device)
    noise = 1e-12 * gradient.abs().amax(1, keepdim=True)
    for _ in range(6 * gradient.shape[1]):
        loose = (~held).to(gradient.dtype)
        slope = gradient + (hessian @ step[..., None])[..., 0]
        matrix = hessian * loose[:, :, None] * loose[:, None, :] + torch.diag_embed(held.to(gradient.dtype))
        move = torch.linalg.solve(matrix, -slope * loose)
        room = torch.where(move > 0, high - step, low - step) / torch.where(move == 0, torch.inf, move)
        room = torch.where(move == 0, torch.inf, room)
        fraction, first = room.min(1, keepdim=True)
        blocked = fraction < 1.0
        hit = blocked & (identity[first[:, 0]] > 0)
        step = (step + fraction.clamp(0.0, 1.0) * move).clamp(low, high)
        step = torch.where(hit, torch.where(move > 0, high, low), step)  # exactly, for the comparison below
        held = held | hit
        slope = gradient + (hessian @ step[..., None])[..., 0]
        pull = torch.where(step <= low, -slope, torch.where(step >= high, slope, torch.zeros_like(slope)))
        pull = torch.where(held & (low < high), pull - noise, torch.zeros_like(pull))
        strongest, which = pull.max(1, keepdim=True)
        leaves = ~blocked & (strongest > 0)
        if not bool((blocked | leaves).any()):
            break
        held = held & ~(leaves & (identity[which[:, 0]] > 0))
    return step
