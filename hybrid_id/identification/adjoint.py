"""Training by the adjoint method: the paper's identification (eq. 2) with gradients from `odeint_adjoint`.

The objective is that of Levenberg-Marquardt: weighted output error over whole records, priors, bounds, first states
within their uncertainty. All records train side by side, each its own parameter set, and leave when they have
converged. A stage of short windows from measured states, where the problem is nearly convex, comes first.

The gradient comes from the adjoint alone, so that it decides where the training ends. How long the steps are is the
metric's part (see :mod:`hybrid_id.identification.optimizers`): in the Gauss-Newton metric, parameters of which the
data say a million times more than of others take equal steps, and 15-30 gradients do what takes Adam a thousand.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

import torch
from torch import Tensor

from hybrid_id.errors import InputError
from hybrid_id.identification.costate import free_run, simulated
from hybrid_id.identification.decision_vector import Problem
from hybrid_id.identification.fit import Progress, make_bounds
from hybrid_id.identification.keep import digest_of, read_checkpoint, write_checkpoint
from hybrid_id.identification.least_squares import Options, Outcome, free_parameters
from hybrid_id.identification.objective import Loss, evaluate
from hybrid_id.identification.optimizers import GaussNewtonState, OptimizerState, advance, begin, prolonged
from hybrid_id.identification.result import FitResult, make_result
from hybrid_id.identification.windows import measured_windows
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.solvers import OdeEngine, extra_parameters
from hybrid_id.systems.chain import System


@dataclass(frozen=True)
class TrainOptions:
    """Settings of the training.

    Attributes:
        windows: stages before the whole records, each (length of a window [s], use one window in this many).
        max_iterations: gradients that a set may take in a stage.
        tolerance: a set has converged when the next step is shorter than this many standard errors.
        window_tolerance: the same in the stages of windows, which only prepare the last one.
        loss: loss of the weighted residuals.
        validate_every: gradients between two evaluations of the validation records.
    """

    windows: tuple[tuple[float, int], ...] = ((0.2, 4),)
    max_iterations: int = 100
    tolerance: float = 0.01
    window_tolerance: float = 1.0
    loss: Loss = field(default_factory=Loss)
    validate_every: int = 5


@dataclass(frozen=True)
class Snapshot:
    """What a writer is logged after a gradient, for each set (G).

    Attributes:
        step: gradients so far.
        names: name of each set (its record, or "pooled").
        table: (component key, symbol) of each free parameter; values: their values, ``(G, n_f)``.
        train, validation: loss per measurement, ``(G,)``; validation only where it was looked at.
        gradient_norm: length of the gradient in the metric, in standard errors, ``(G,)``.
        batch, sets, simulated: the rows (windows at first, then whole records), set of each, simulated outputs.
        scalars: further figures by tag.
    """

    step: int
    names: tuple[str, ...]
    table: tuple[tuple[str, str], ...]
    values: Tensor
    train: Tensor
    validation: Tensor | None
    gradient_norm: Tensor
    batch: Batch
    sets: Tensor
    simulated: Tensor
    scalars: Mapping[str, float]

    @classmethod
    def of(
        cls,
        step: int,
        names: tuple[str, ...],
        problem: Problem,
        state: OptimizerState,
        validation: Tensor | None,
        scalars: Mapping[str, float],
    ) -> Snapshot:
        """What is told of a state; outputs beyond the problem's batch (prices of networks) are left out."""
        info, batch = [problem.system.table[i] for i in problem.free], problem.batch
        table, values = tuple((i.component, i.symbol) for i in info), problem.theta(state.q)[problem.free].T
        simulated, train = state.y[..., : len(batch.outputs)], state.cost / problem.data
        return cls(
            step, names, table, values, train, validation, state.distance, batch, problem.sets, simulated, scalars
        )  # fmt: skip

    @property
    def parameter_tags(self) -> list[str]:
        """``parameters/<joint>/<symbol>`` of each, with the place where a joint has the symbol twice."""
        short = [f"{component.split('/')[0]}/{symbol}" for component, symbol in self.table]
        return [
            f"parameters/{name}" if short.count(name) == 1 else f"parameters/{component}/{symbol}"
            for name, (component, symbol) in zip(short, self.table, strict=True)
        ]


class Writer(Protocol):
    """Takes the history of a training, for example into TensorBoard."""

    def record(self, snapshot: Snapshot) -> None:
        """Take one snapshot."""
        ...


def train(
    system: System,
    batch: Batch,
    *,
    pooled: bool = False,
    engine: OdeEngine | None = None,
    options: TrainOptions | None = None,
    validation: Batch | None = None,
    writer: Writer | None = None,
    checkpoint: Path | None = None,
    resume: Path | None = None,
    progress: Progress | None = None,
) -> list[FitResult]:
    """Identify one parameter set for each row of a batch, or one for all of them, by the adjoint method.

    Ctrl-C ends the training with what it has reached (status "interrupted").

    Args:
        system: model with start values, bounds, priors and roles; parameters beyond its table (a network's weights)
            train too, with one set only.
        batch: prepared records.
        pooled: one parameter set for all rows.
        engine: solver and kind of gradient; its steps are raised where stability or accuracy needs it.
        options: settings.
        validation: records that are only looked at.
        writer: takes the history of the training.
        checkpoint: file that holds the training after each gradient.
        resume: checkpoint of the same records and model to go on from, to the same numbers.
        progress: called with (stage, gradients so far, cost of each set, sets still running).

    Raises:
        InputError: nothing to estimate, weights with several sets, or a checkpoint of another training.
    """
    options, engine, system = options or TrainOptions(), engine or OdeEngine(), copy.deepcopy(system)
    free = free_parameters(system)
    extra, device = extra_parameters(system), batch.x.device
    rows = torch.arange(batch.rows, device=device)
    sets, count = (torch.zeros_like(rows), 1) if pooled else (rows, batch.rows)
    if extra and count > 1:
        raise InputError("Weights beyond the table are shared by all records; train one record, or pooled.")
    if len(extra) != sum(len(part.weights()) for part in system.networks.values()):
        raise InputError("Weights beyond the table train in residual networks only; put them into one.")
    names = ("pooled",) if pooled and batch.rows > 1 else batch.names
    bounds = make_bounds(system, free, device)
    base = system.theta().detach().to(device)[:, None].repeat(1, count)
    whole = Problem(system, engine, batch, sets, free, bounds, base, extra, options.loss)
    identity = ["adjoint", digest_of((system, batch, pooled, engine, options.windows, options.loss))]
    state = None
    if resume is not None:
        state = read_checkpoint(resume, identity, lambda content: GaussNewtonState(**content), device)
        state = prolonged(state, options.max_iterations)
    interrupted, logged = False, 0
    try:
        for stage, window in enumerate([*options.windows, None]):
            if state is not None and stage < state.stage:
                continue
            problem, tolerance = whole, options.tolerance
            if window is not None:
                cut = measured_windows(system, batch, *window)
                if cut is None:
                    continue
                problem, tolerance = replace(whole, batch=cut[0], sets=sets[cut[1]]), options.window_tolerance
            if state is not None:
                problem.set_weights(state.q)
            if state is None or state.stage < stage:
                state = begin(problem, base if state is None else problem.theta(state.q), stage, state)
            while not interrupted:
                if writer is not None and state.iteration > logged:
                    problem.set_weights(state.q)
                    looked = None
                    if validation is not None and state.iteration % options.validate_every == 0:
                        exact = _exact(engine, state)
                        theta = problem.theta(state.q)
                        looked = validation_loss(replace(problem, engine=exact), theta, validation)
                    writer.record(Snapshot.of(state.iteration, names, problem, state, looked, {}))
                    logged = state.iteration
                going = state.running.nonzero().flatten()
                if progress is not None:
                    label = "records" if window is None else "windows"
                    interrupted = bool(progress(label, state.iteration, state.cost, going))
                if interrupted or going.numel() == 0:
                    break
                state = advance(problem, state, tolerance, options.max_iterations)
                if checkpoint is not None:
                    write_checkpoint(checkpoint, vars(state), identity)
            if interrupted:
                break
    except KeyboardInterrupt:
        interrupted = True
        if state is None:
            raise
    assert state is not None  # the last stage always takes place

    # one evaluation with exact sensitivities at the end, as a fit has it
    finished = state.stage == len(options.windows)
    whole = replace(whole, engine=_exact(engine, state))
    whole.set_weights(state.q)
    theta, nodes = whole.theta(state.q), state.nodes
    spread = theta[:, sets]
    if not finished:  # the end of a stage of windows has no whole record yet
        nodes = free_run(system, whole.engine, batch, batch.x, spread)[0]
    nodes = nodes.nan_to_num(0.0)
    at = evaluate(system, whole.engine, batch, nodes, spread, free, loss=options.loss, chunk=1)
    cost = bounds.prior_cost(theta[free].T).index_add(0, sets, at.cost)
    # a set that had settled over windows has not seen whole records
    left = {"running"} if finished else {"running", "converged", "stalled", "max_iterations"}
    status = ["interrupted" if interrupted and one in left else one for one in state.status]
    outcome = Outcome(theta, cost, state.steps, status, at, state.history)
    return [make_result(whole, outcome, g, Options(loss=options.loss)) for g in range(count)]


def _exact(engine: OdeEngine, state: GaussNewtonState) -> OdeEngine:
    """The engine with the steps of a state, differentiated by backprop."""
    return replace(engine, substeps=state.substeps, fine=state.fine, gradient="backprop")


def validation_loss(problem: Problem, theta: Tensor, batch: Batch) -> Tensor:
    """Loss per measurement of every set on the records of a batch, ``(G,)``; NaN where a simulation diverged."""
    count = theta.shape[1]
    many = batch.take(torch.arange(batch.rows, device=theta.device).repeat(count))
    spread = theta.repeat_interleave(batch.rows, 1)
    x, closed = free_run(problem.system, problem.engine, many, many.x, spread)
    y = simulated(problem.system, many, x, spread)
    cost = problem.loss.value((many.y - y) * many.weight).sum((1, 2)).where(closed, torch.nan)
    return cost.reshape(count, batch.rows).sum(1) / (batch.weight > 0).sum()
