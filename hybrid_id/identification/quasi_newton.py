"""Batched quasi-Newton steps: every set has its own metric, damping and end; one call is one gradient of all of them.

The metric of parameters and first states is the Gauss-Newton matrix, taken anew after a few accepted steps; in
between, and for a network's weights always, it follows the gradients by BFGS. Steps are damped as Marquardt's.

Sources: J. Nocedal, S. Wright, Numerical Optimization, 2nd ed., 2006: BFGS eq. (6.19), Gauss-Newton sec. 10.3;
H. B. Nielsen, Damping Parameter in Marquardt's Method, IMM-REP-1999-05.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from hybrid_id.identification.box import solve_box
from hybrid_id.identification.decision_vector import Problem
from hybrid_id.simulation.rollout import rollout

DAMPING, LARGEST_DAMPING = 1e-3, 1e4
"""First damping relative to the metric's diagonal, and the one at which a set has stalled."""


@dataclass(frozen=True)
class State:
    """Where a training stands: all that a checkpoint holds, for sets (G) and rows (R).

    Attributes:
        stage: number of the stage; began: gradients before it; iteration: gradients so far.
        substeps, fine: steps of the engine.
        q: unknowns, ``(G, N)``; slope, cost: gradient and cost there.
        metric: ``(G, N, N)``, positive definite.
        damping: added share of the metric's diagonal, ``(G,)``; growth: its factor when a step fails.
        age: accepted steps since the metric was taken anew, ``(G,)``.
        distance: length of the undamped step in standard errors, ``(G,)``.
        running: whether a set still moves, ``(G,)``.
        steps: gradients of each set, ``(G,)``.
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
    metric: Tensor
    damping: Tensor
    growth: Tensor
    age: Tensor
    distance: Tensor
    running: Tensor
    steps: Tensor
    nodes: Tensor
    y: Tensor
    status: list[str]
    history: list[Tensor]


def begin(problem: Problem, theta: Tensor, stage: int, before: State | None) -> State:
    """The state at the start of a stage: steps of the engine, first gradient, Gauss-Newton metric.

    Args:
        problem: objective of the stage.
        theta: parameters to start from, ``(n_p, G)``.
        stage: its number.
        before: end of the stage before.
    """
    q = problem.start(theta)
    engine = problem.engine.stable(problem.system, problem.batch, theta[:, problem.sets])
    problem = replace(problem, engine=engine)
    cost, slope, run = problem.value(q, problem.batch.x)
    if not bool(torch.isfinite(cost).all()):  # the measured states were too far off for Newton's method
        walked = rollout(problem.system, engine, problem.batch, theta[:, problem.sets])
        cost, slope, run = problem.value(q, walked)
    fine = torch.isfinite(cost) & torch.isfinite(slope).all(1)
    zero = torch.zeros_like(cost)
    done = 0 if before is None else before.iteration
    steps = torch.zeros_like(fine, dtype=torch.long) if before is None else before.steps
    state = State(
        stage, done, done + 1, engine.substeps, engine.fine, q, slope, cost, problem.first_metric(q, slope),
        zero + DAMPING, zero + 2.0, zero, zero, fine, steps + 1, run.x, run.y,
        ["running" if ok else "diverged" for ok in fine.tolist()], [cost],
    )  # fmt: skip
    return _renew(problem, state, fine.nonzero().flatten())


def _with_stable_steps(problem: Problem, state: State) -> tuple[Problem, State]:
    """The problem with the steps that the engine needs where the sets stand now, and the state under it."""
    problem.set_weights(state.q)
    before = replace(problem.engine, substeps=state.substeps, fine=state.fine)
    theta, batch = problem.theta(state.q)[:, problem.sets], replace(problem.batch, x=state.nodes)
    engine = before.stable(problem.system, batch, theta)
    problem = replace(problem, engine=engine)
    if engine == before:
        return problem, state
    cost, slope, run = problem.value(state.q, state.nodes)
    kept = state.running & torch.isfinite(cost) & torch.isfinite(slope).all(1)
    rows = kept[problem.sets]
    state = replace(
        state, substeps=engine.substeps, fine=engine.fine, iteration=state.iteration + 1,
        cost=cost.where(kept, state.cost), slope=slope.where(kept[:, None], state.slope),
        nodes=run.x.where(rows[:, None, None], state.nodes), y=run.y.where(rows[:, None, None], state.y),
        steps=state.steps + kept,
    )  # fmt: skip
    return problem, _renew(problem, state, kept.nonzero().flatten())


def prolonged(state: State, max_iterations: int) -> State:
    """A state read from a checkpoint, whose sets go on where a larger limit now leaves them gradients."""
    if state.iteration - state.began >= max_iterations:
        return state
    status = ["running" if one == "max_iterations" else one for one in state.status]
    running = torch.tensor([one == "running" for one in status], device=state.running.device)
    return replace(state, status=status, running=running)


def _renew(problem: Problem, state: State, chosen: Tensor) -> State:
    """The state with the metric of some sets taken anew, that of the weights kept."""
    if chosen.numel() == 0:
        return state
    part, rows = problem.of(chosen)
    physical = part.curvature(state.q[chosen], state.nodes[rows], state.cost[chosen])
    metric, age, size = state.metric.clone(), state.age.clone(), physical.shape[1]
    metric[chosen, :size], metric[chosen, :, :size] = 0.0, 0.0
    metric[chosen, :size, :size] = physical
    age[chosen] = 0.0
    return replace(state, metric=metric, age=age)


def _step(metric: Tensor, slope: Tensor, damping: Tensor, box: tuple[Tensor, Tensor]) -> Tensor:
    """Minimiser of the damped quadratic model of each set inside its box, ``(G, N)``."""
    diagonal = metric.diagonal(dim1=1, dim2=2)
    unit = diagonal.rsqrt()
    scaled = metric * unit[:, :, None] * unit[:, None, :]
    damped = scaled + torch.diag_embed((damping[:, None] + 1e-12).expand_as(unit))
    return unit * solve_box(damped, unit * slope, box[0] / unit, box[1] / unit)


def _distance(problem: Problem, state: State) -> Tensor:
    """Length of the undamped step of each set in standard errors, ``(G,)``."""
    box = problem.box(state.q, trust=False)
    step = _step(state.metric, state.slope, torch.zeros_like(state.cost), box)
    size = (step * (state.metric @ step[..., None])[..., 0]).sum(1)
    return (size.clamp_min(0.0) * problem.data / (2.0 * state.cost).clamp_min(1e-300)).sqrt()


def advance(problem: Problem, state: State, tolerance: float, max_iterations: int, refresh: int) -> State:
    """One gradient of every running set: trial, acceptance, update of the metric.

    A set ends when a metric that was taken at its own point says that it has arrived.

    Args:
        problem: objective.
        state: where the sets stand.
        tolerance: standard errors within which a set has arrived.
        max_iterations: gradients in this stage.
        refresh: accepted steps after which the metric is taken anew.
    """
    problem, state = _with_stable_steps(problem, state)
    due = (state.age >= refresh) | ((state.age > 0) & (_distance(problem, state) < tolerance))
    state = _renew(problem, state, (state.running & due).nonzero().flatten())
    distance, status, running = _distance(problem, state), list(state.status), state.running.clone()
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

    change = slope - state.slope[chosen]
    bend, stiff = (step * change).sum(1), (step * pulled).sum(1)
    usable = accepted & (bend > 1e-8 * step.norm(dim=1) * change.norm(dim=1))
    update = _outer(change) / bend[:, None, None] - _outer(pulled) / stiff[:, None, None]
    metric = torch.where(usable[:, None, None], metric + update, metric)

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
        metric=at(state.metric, chosen, metric),
        damping=at(state.damping, chosen, damping * torch.where(accepted, ease, growth)),
        growth=at(state.growth, chosen, torch.where(accepted, torch.full_like(growth, 2.0), 2.0 * growth)),
        age=at(state.age, chosen, state.age[chosen] + accepted),
        steps=at(state.steps, chosen, state.steps[chosen] + 1),
        nodes=at(state.nodes, rows[moved], run.x[moved]),
        y=at(state.y, rows[moved], run.y[moved]),
        history=[*state.history, new_cost],
    )  # fmt: skip


def _outer(vector: Tensor) -> Tensor:
    return vector[:, :, None] * vector[:, None, :]
