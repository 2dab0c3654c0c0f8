"""Optimisers of the adjoint training, one gradient a call: damped Gauss-Newton steps, or Adam for large networks.

Gauss-Newton: every set has its own metric, damping and end. The metric is the Gauss-Newton matrix, taken anew after
each accepted step. Steps are those of Levenberg-Marquardt, inside the bounds.

Adam (`torch.optim`) serves where no matrix of the weights is affordable. Its gradient is that of the loss per
measurement in the scaled decision vector, clipped to a largest length before it enters the moments: a record that
nearly diverges then costs one step, not the history.

Sources: J. Nocedal, S. Wright, Numerical Optimization, 2nd ed., 2006, sec. 10.3; H. B. Nielsen, Damping Parameter in
Marquardt's Method, IMM-REP-1999-05; D. P. Kingma, J. Ba, Adam, ICLR 2015; R. Pascanu, T. Mikolov, Y. Bengio, On the
difficulty of training recurrent neural networks, ICML 2013, algorithm 1 (clipping).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor, nn

from hybrid_id.identification.decision_vector import Problem
from hybrid_id.identification.least_squares import bounded_lm_step
from hybrid_id.simulation.rollout import rollout

SMALLEST_RATE = 1e-4
"""Share of the first step at which a descent that diverges again and again has stalled."""
DAMPING, LARGEST_DAMPING = 1e-3, 1e4
"""First damping relative to the metric's diagonal, and the one at which a set has stalled."""


@dataclass(frozen=True, kw_only=True)
class OptimizerState:
    """Where a training stands: all that a checkpoint holds, for sets (G) and rows (R).

    Attributes:
        stage: number of the stage; began: gradients before it; iteration: gradients so far.
        substeps, fine: steps of the engine.
        q: decision vector, ``(G, N)``; slope, cost: gradient and cost there.
        distance: what is left to go, ``(G,)``.
        running: whether a set still moves, ``(G,)``.
        nodes: free run of each row at q, ``(R, T, n_x)``; y: its outputs, ``(R, T, n_y)``.
        status: of each set, as in a fit's result.
        history: cost of each set after each gradient of the stage.
    """

    stage: int
    began: int
    iteration: int
    substeps: int
    fine: int
    q: Tensor
    slope: Tensor
    cost: Tensor
    distance: Tensor
    running: Tensor
    nodes: Tensor
    y: Tensor
    status: list[str]
    history: list[Tensor]


@dataclass(frozen=True, kw_only=True)
class GaussNewtonState(OptimizerState):
    """Where a Gauss-Newton training stands; ``distance`` is the length of the undamped step in standard errors.

    Attributes:
        metric: ``(G, N, N)``, positive definite.
        moved: whether the set has moved since its metric was taken, ``(G,)``.
        damping: added share of the metric's diagonal, ``(G,)``; growth: its factor when a step fails.
        steps: gradients of each set, ``(G,)``.
    """

    metric: Tensor
    moved: Tensor
    damping: Tensor
    growth: Tensor
    steps: Tensor


@dataclass(frozen=True, kw_only=True)
class AdamState(OptimizerState):
    """Where a training by Adam stands, for one set; ``distance`` is the length of the gradient before it is clipped.

    Attributes:
        adam: state of `torch.optim.Adam`.
        rate: share of the full step that is left after divergences.
    """

    adam: dict[str, Any]
    rate: float


def _started(problem: Problem, theta: Tensor, stage: int, done: int) -> tuple[Problem, dict[str, Any]]:
    """The problem with stable steps, and where a stage begins: fields of :class:`OptimizerState`."""
    q = problem.start(theta)
    engine = problem.engine.stable(problem.system, problem.batch, theta[:, problem.sets])
    problem = replace(problem, engine=engine)
    cost, slope, run = problem.value(q, problem.batch.x)
    if not bool(torch.isfinite(cost).all()):  # the measured states were too far off for Newton's method
        guess = rollout(problem.system, engine, problem.batch, theta[:, problem.sets])
        cost, slope, run = problem.value(q, guess)
    finite = torch.isfinite(cost) & torch.isfinite(slope).all(1)
    return problem, {
        "stage": stage, "began": done, "iteration": done + 1, "substeps": engine.substeps, "fine": engine.fine,
        "q": q, "slope": slope, "cost": cost, "running": finite, "nodes": run.x, "y": run.y, "history": [cost],
        "status": ["running" if ok else "diverged" for ok in finite.tolist()],
    }  # fmt: skip


def begin(problem: Problem, theta: Tensor, stage: int, before: GaussNewtonState | None) -> GaussNewtonState:
    """The state at the start of a stage: steps of the engine, first gradient, Gauss-Newton metric.

    Args:
        problem: objective of the stage.
        theta: parameters to start from, ``(n_p, G)``.
        stage: its number.
        before: end of the stage before.
    """
    problem, start = _started(problem, theta, stage, 0 if before is None else before.iteration)
    q, running, zero = start["q"], start["running"], torch.zeros_like(start["cost"])
    steps = torch.zeros_like(running, dtype=torch.long) if before is None else before.steps
    state = GaussNewtonState(
        **start,
        metric=torch.eye(q.shape[1], dtype=q.dtype, device=q.device).repeat(len(q), 1, 1),
        moved=torch.zeros_like(running),
        damping=zero + DAMPING,
        growth=zero + 2.0,
        distance=zero,
        steps=steps + 1,
    )
    return _with_metric(problem, state, running)


def prolonged(state: GaussNewtonState, max_iterations: int) -> GaussNewtonState:
    """A state read from a checkpoint, whose sets go on where a larger limit now leaves them gradients."""
    if state.iteration - state.began >= max_iterations:
        return state
    status = ["running" if one == "max_iterations" else one for one in state.status]
    running = torch.tensor([one == "running" for one in status], device=state.running.device)
    return replace(state, status=status, running=running)


def _with_metric(problem: Problem, state: GaussNewtonState, wanted: Tensor) -> GaussNewtonState:
    """The state with the metric of some sets taken where they stand, from forward sensitivities."""
    chosen = wanted.nonzero().flatten()
    if chosen.numel() == 0:
        return state
    part, rows = problem.of(chosen)
    q, metric = state.q[chosen], state.metric.clone()
    metric[chosen] = part.curvature(part.evaluated(q, state.nodes[rows]), q, state.cost[chosen])
    return replace(state, metric=metric, moved=state.moved & ~wanted)


def _step(metric: Tensor, slope: Tensor, damping: Tensor, box: tuple[Tensor, Tensor]) -> Tensor:
    """Minimiser of the damped quadratic model of each set inside its box, ``(G, N)``."""
    unit = metric.diagonal(dim1=1, dim2=2).rsqrt()
    return unit * bounded_lm_step(metric, slope, unit, (damping[:, None] + 1e-12).expand_as(unit), *box)[0]


def advance(
    problem: Problem, state: GaussNewtonState, tolerance: float, max_iterations: int
) -> GaussNewtonState:
    """One gradient of every running set: trial, and acceptance.

    A set ends when the metric at its own point says that it has arrived.

    Args:
        problem: objective.
        state: where the sets stand.
        tolerance: standard errors within which a set has arrived.
        max_iterations: gradients in this stage.
    """
    # the steps that the engine needs where the sets stand now
    problem.set_weights(state.q)
    before = replace(problem.engine, substeps=state.substeps, fine=state.fine)
    theta, here = problem.theta(state.q)[:, problem.sets], replace(problem.batch, x=state.nodes)
    engine = before.stable(problem.system, here, theta)
    problem = replace(problem, engine=engine)
    if engine != before:
        cost, slope, run = problem.value(state.q, state.nodes)
        kept = state.running & torch.isfinite(cost) & torch.isfinite(slope).all(1)
        rows = kept[problem.sets, None, None]
        state = replace(
            state, substeps=engine.substeps, fine=engine.fine, iteration=state.iteration + 1,
            cost=cost.where(kept, state.cost), slope=slope.where(kept[:, None], state.slope),
            nodes=run.x.where(rows, state.nodes), y=run.y.where(rows, state.y), steps=state.steps + kept,
            moved=state.moved | kept,
        )  # fmt: skip
    state = _with_metric(problem, state, state.running & state.moved)

    step = _step(state.metric, state.slope, torch.zeros_like(state.cost), problem.box(state.q, trust=False))
    size = (step * (state.metric @ step[..., None])[..., 0]).sum(1).clamp_min(0.0)
    distance = (size * problem.data / (2.0 * state.cost).clamp_min(1e-300)).sqrt()
    status, running = list(state.status), state.running.clone()
    for g in running.nonzero().flatten().tolist():
        if float(distance[g]) < tolerance:
            status[g] = "converged"
        elif float(state.damping[g]) > LARGEST_DAMPING:
            status[g] = "stalled"
        elif state.iteration - state.began >= max_iterations:
            status[g] = "max_iterations"
        running[g] = status[g] == "running"
    state = replace(state, status=status, running=running, distance=distance)
    chosen = running.nonzero().flatten()
    if chosen.numel() == 0:
        return state

    part, rows = problem.of(chosen)
    old, metric, damping = state.cost[chosen], state.metric[chosen], state.damping[chosen]
    step = _step(metric, state.slope[chosen], damping, part.box(state.q[chosen]))
    pulled = (metric @ step[..., None])[..., 0]
    predicted = -(state.slope[chosen] * step).sum(1) - 0.5 * (step * pulled).sum(1)
    cost, slope, run = part.value(state.q[chosen] + step, state.nodes[rows])
    finite = torch.isfinite(cost) & torch.isfinite(slope).all(1)
    accepted = finite & (old - cost >= 1e-4 * predicted - 1e-10 * old)
    ratio = ((old - cost) / predicted).nan_to_num(0.0).clamp(-10.0, 10.0)
    ease = (1.0 - (2.0 * ratio - 1.0) ** 3).clamp(0.1, 2.0)
    growth = state.growth[chosen]

    def at(old: Tensor, index: Tensor, new: Tensor) -> Tensor:
        return old.index_copy(0, index, new.to(old.dtype))

    taken, moved = chosen[accepted], accepted[part.sets].nonzero().flatten()
    new_cost = at(state.cost, taken, cost[accepted])
    return replace(
        state,
        iteration=state.iteration + 1,
        q=at(state.q, taken, (state.q[chosen] + step)[accepted]),
        slope=at(state.slope, taken, slope[accepted]),
        cost=new_cost,
        moved=at(state.moved, chosen, accepted),
        damping=at(state.damping, chosen, damping * torch.where(accepted, ease, growth)),
        growth=at(state.growth, chosen, torch.where(accepted, torch.full_like(growth, 2.0), 2.0 * growth)),
        steps=at(state.steps, chosen, state.steps[chosen] + 1),
        nodes=at(state.nodes, rows[moved], run.x[moved]),
        y=at(state.y, rows[moved], run.y[moved]),
        history=[*state.history, new_cost],
    )


def begin_descent(problem: Problem, theta: Tensor, stage: int) -> AdamState:
    """Adam at the start of a stage.

    Args:
        problem: objective of the stage, with one set.
        theta: parameters to start from, ``(n_p, 1)``.
        stage: its number.
    """
    problem, start = _started(problem, theta, stage, 0)
    return AdamState(**start, adam={}, rate=1.0, distance=start["slope"].norm(dim=1) / problem.data)


def descend(problem: Problem, state: AdamState, rate: float, clip: float, max_iterations: int) -> AdamState:
    """One step along the clipped gradient, and the gradient where it ends.

    Args:
        problem: objective.
        state: where the descent stands.
        rate: largest change of an entry of the decision vector in one step.
        clip: largest length of the gradient.
        max_iterations: gradients in this stage.
    """
    spent = state.iteration - state.began >= max_iterations
    if spent or state.rate < SMALLEST_RATE:
        status = "max_iterations" if spent else "stalled"
        return replace(state, running=torch.zeros_like(state.running), status=[status])
    theta, batch = problem.theta(state.q)[:, problem.sets], replace(problem.batch, x=state.nodes)
    before = replace(problem.engine, substeps=state.substeps, fine=state.fine)
    problem.set_weights(state.q)
    engine = before.stable(problem.system, batch, theta)
    problem = replace(problem, engine=engine)
    moved = nn.Parameter(state.q.clone())
    adam = torch.optim.Adam([moved])
    if state.adam:
        adam.load_state_dict(state.adam)
    adam.param_groups[0]["lr"] = rate * state.rate
    moved.grad = state.slope / problem.data[:, None]
    nn.utils.clip_grad_norm_([moved], clip)
    adam.step()
    low, high = problem.box(state.q)
    q = state.q + torch.maximum(torch.minimum(moved.detach() - state.q, high), low)
    cost, slope, run = problem.value(q, state.nodes)
    state = replace(
        state,
        iteration=state.iteration + 1,
        substeps=engine.substeps,
        fine=engine.fine,
        adam=adam.state_dict(),
    )
    if not bool(torch.isfinite(cost).all() and torch.isfinite(slope).all()):
        return replace(state, rate=0.5 * state.rate, history=[*state.history, state.cost])
    return replace(
        state, q=q, slope=slope, cost=cost, nodes=run.x, y=run.y, distance=slope.norm(dim=1) / problem.data,
        history=[*state.history, cost],
    )  # fmt: skip
