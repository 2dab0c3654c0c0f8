"""Steps along clipped gradients, for networks so large that no matrix of their weights is affordable.

One call is one gradient, as in :mod:`hybrid_id.identification.quasi_newton`. The gradient is that of the loss per
measurement in the scaled unknowns, and it is clipped to a largest length before it enters the moments: a record that
nearly diverges then costs one step, not the course. Gauss-Newton's steps need no clipping; their damping bounds them.

Sources: D. P. Kingma, J. Ba, Adam, ICLR 2015, algorithm 1; R. Pascanu, T. Mikolov, Y. Bengio, On the difficulty of
training recurrent neural networks, ICML 2013, algorithm 1 (clipping).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from hybrid_id.identification.decision_vector import Problem
from hybrid_id.simulation.rollout import rollout

DECAY, DECAY_SQUARE, TINY = 0.9, 0.999, 1e-8
SMALLEST_RATE = 1e-4
"""Share of the first step at which a descent that diverges again and again has stalled."""


@dataclass(frozen=True)
class Descent:
    """Where a training stands, for one set and rows (R).

    Attributes not named here are those of :class:`.quasi_newton.State`.

    Attributes:
        mean, square: running means of the gradient and of its square, ``(1, N)``.
        rate: share of the full step that is left after divergences.
        distance: length of the gradient before it is clipped, ``(1,)``.
    """

    stage: int
    began: int
    iteration: int
    substeps: int
    fine: int
    q: Tensor
    slope: Tensor
    cost: Tensor
    mean: Tensor
    square: Tensor
    rate: float
    distance: Tensor
    running: Tensor
    nodes: Tensor
    y: Tensor
    status: list[str]
    history: list[Tensor]


def begin(problem: Problem, theta: Tensor, stage: int) -> Descent:
    """The descent at the start of a stage.

    Args:
        problem: objective of the stage, with one set.
        theta: parameters to start from, ``(n_p, 1)``.
        stage: its number.
    """
    q = problem.start(theta)
    engine = problem.engine.stable(problem.system, problem.batch, theta[:, problem.sets])
    problem = replace(problem, engine=engine)
    cost, slope, run = problem.value(q, problem.batch.x)
    if not bool(torch.isfinite(cost).all()):  # the measured states were too far off for Newton's method
        cost, slope, run = problem.value(
            q, rollout(problem.system, engine, problem.batch, theta[:, problem.sets])
        )
    fine = torch.isfinite(cost) & torch.isfinite(slope).all(1)
    zero = torch.zeros_like(q)
    return Descent(
        stage, 0, 1, engine.substeps, engine.fine, q, slope, cost, zero, zero, 1.0, slope.norm(dim=1) / problem.data,
        fine, run.x, run.y, ["running" if ok else "diverged" for ok in fine.tolist()], [cost],
    )  # fmt: skip


def advance(problem: Problem, state: Descent, rate: float, clip: float, max_iterations: int) -> Descent:
    """One step along the clipped gradient, and the gradient where it ends.

    Args:
        problem: objective.
        state: where the descent stands.
        rate: largest change of an unknown in one step.
        clip: largest length of the gradient.
        max_iterations: gradients in this stage.
    """
    count = state.iteration - state.began
    if count >= max_iterations or state.rate < SMALLEST_RATE:
        status = "max_iterations" if count >= max_iterations else "stalled"
        return replace(state, running=torch.zeros_like(state.running), status=[status])
    theta, batch = problem.theta(state.q)[:, problem.sets], replace(problem.batch, x=state.nodes)
    before = replace(problem.engine, substeps=state.substeps, fine=state.fine)
    problem.set_weights(state.q)
    engine = before.stable(problem.system, batch, theta)
    problem = replace(problem, engine=engine)
    gradient = clipped(state.slope / problem.data[:, None], clip)
    mean = DECAY * state.mean + (1.0 - DECAY) * gradient
    square = DECAY_SQUARE * state.square + (1.0 - DECAY_SQUARE) * gradient.square()
    unbiased = mean / (1.0 - DECAY**count), square / (1.0 - DECAY_SQUARE**count)
    step = -rate * state.rate * unbiased[0] / (unbiased[1].sqrt() + TINY)
    low, high = problem.box(state.q)
    q = state.q + torch.maximum(torch.minimum(step, high), low)
    cost, slope, run = problem.value(q, state.nodes)
    state = replace(state, iteration=state.iteration + 1, substeps=engine.substeps, fine=engine.fine)
    if not bool(torch.isfinite(cost).all() and torch.isfinite(slope).all()):
        # the averages count every gradient, as the correction of their beginning does
        halved = replace(state, rate=0.5 * state.rate, history=[*state.history, state.cost])
        return replace(halved, mean=mean, square=square)
    return replace(
        state, q=q, slope=slope, cost=cost, mean=mean, square=square, nodes=run.x, y=run.y,
        distance=slope.norm(dim=1) / problem.data, history=[*state.history, cost],
    )  # fmt: skip


def clipped(gradient: Tensor, longest: float) -> Tensor:
    """The gradient of each set, ``(G, N)``, shortened to a largest length."""
    return gradient * (longest / gradient.norm(dim=1, keepdim=True).clamp_min(longest))
