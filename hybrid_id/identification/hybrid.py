"""Training of physics with residual networks, in stages: physics, the networks with physics held, both together.

The networks' outputs have a price, so that they add only what the physics cannot say. The ladder of prices is climbed
down, each rung from the one above; validation records tell where each training stops and which rung is worth its
freedom. Gradients are the adjoint's, steps are Gauss-Newton's (see :mod:`hybrid_id.identification.optimizers`).

Sources: Y. Yin et al., APHYNITY, ICLR 2021 (least-norm augmentation); L. Prechelt, Early stopping, 1998.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from hybrid_id.errors import InputError
from hybrid_id.identification.adjoint import Writer
from hybrid_id.identification.checkpoint import fingerprint, read_checkpoint
from hybrid_id.identification.costate import free_run
from hybrid_id.identification.decision_vector import Problem
from hybrid_id.identification.fit import fit, make_bounds
from hybrid_id.identification.least_squares import Options
from hybrid_id.identification.networks import with_scales
from hybrid_id.identification.objective import Evaluation
from hybrid_id.identification.optimizers import QuasiNewtonState, prolonged
from hybrid_id.identification.result import FitResult, sensitivities
from hybrid_id.identification.training_loop import (
    Found,
    HybridOptions,
    Progress,
    Stage,
    Trainer,
    TrainingState,
    excess,
    typical,
)
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.solvers import OdeEngine, extra_parameters
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.chain import System

Spread = Callable[[list[np.ndarray], list[np.ndarray], np.ndarray], np.ndarray]
"""Standard errors by the weighted sensitivities and residuals of each record, and the information of priors."""


@dataclass(frozen=True, eq=False)
class Rung:
    """One price of the ladder and what the training came to; the first is physics alone, at an infinite price.

    Attributes:
        price: of the networks' output.
        system: the trained system.
        train, validation: loss per measurement; that of validation records is :func:`.training_loop.typical`.
        iterations: gradients up to here.
        status: how the training ended.
        errors: standard errors of the estimated parameters, ``(n_f,)``; with networks, their weights are unknown
            too.
        loose: the same without the price, which alone keeps a parameter where a network could do its work.
        plain: those without the price if residuals had no memory: what the records alone tell apart.
    """

    price: float
    system: System
    train: float
    validation: float
    iterations: int
    status: str
    errors: np.ndarray
    loose: np.ndarray
    plain: np.ndarray


@dataclass(frozen=True, eq=False)
class HybridResult:
    """What a hybrid training ends with.

    Attributes:
        physics: Levenberg-Marquardt fit of the physics alone.
        rungs: the ladder, physics first.
        chosen: number of the rung that the validation records choose.
        engine: with which all of them are simulated.
        interrupted: whether the training was stopped before its end.
    """

    physics: FitResult
    rungs: tuple[Rung, ...]
    chosen: int
    engine: OdeEngine
    interrupted: bool

    @property
    def system(self) -> System:
        """The chosen system."""
        return self.rungs[self.chosen].system


def train_hybrid(
    system: System,
    batch: Batch,
    validation: Batch,
    *,
    engine: OdeEngine | None = None,
    options: HybridOptions | None = None,
    writer: Writer | None = None,
    checkpoint: Path | None = None,
    resume: Path | None = None,
    progress: Progress | None = None,
    spread: Spread | None = None,
) -> HybridResult:
    """Train one set of parameters and weights over all rows of a batch.

    Ctrl-C ends the training with the rungs that it has.

    Args:
        system: model with at least one residual network; what its networks have learnt before is forgotten.
        batch: records to train on.
        validation: records that tell when to stop and which price to choose.
        engine: solver and kind of gradient.
        options: settings.
        writer: takes the history of the training.
        checkpoint: file that holds the training after each gradient.
        resume: checkpoint of the same training to go on from, to the same numbers.
        progress: called with (stage, gradients so far, loss per measurement); true ends the training.
        spread: standard errors that allow for correlated residuals, which count where they are larger.

    Raises:
        InputError: no network, nothing to estimate, or a checkpoint of another training.
    """
    options, engine = options or HybridOptions(), engine or OdeEngine()
    if not system.networks:
        raise InputError(
            "The model has no residual network to train; add one to a place, or use a plain fit."
        )
    if options.augmentation == "projection" and any(part.memory for part in system.networks.values()):
        raise InputError(
            "The augmentation 'projection' prices networks along the records, where their memory is not known; take "
            "'norm', or networks without memory."
        )
    prices = options.prices
    if not prices or sorted(set(prices), reverse=True) != list(prices) or prices[-1] < 0.0:
        raise InputError(
            f"The prices {list(prices)} are no ladder; give falling numbers that are not negative."
        )
    settings = (engine, options.augmentation, options.optimizer, options.precision, options.windows)
    settings += (options.prices, options.loss, options.worth, options.starts, options.seed)
    settings += (options.rate, options.clip) if options.optimizer == "adam" else ()
    identity = ["hybrid", fingerprint(system, [batch, validation], *settings)]
    physics = fit_physics(system, batch, engine, options)
    values = {name: physics.system.parameter(name).spec.value for name in physics.names}
    system = with_scales(system.with_values(values), batch, engine.width)
    for part in system.networks.values():
        part.forget()
    system = system.to(batch.x.device)
    free = system.estimated
    theta = system.theta().detach()[:, None]
    engine = engine.stable(system, batch, theta.expand(-1, batch.rows))
    sets = torch.zeros(batch.rows, dtype=torch.long, device=batch.x.device)
    bounds, extra = make_bounds(system, free, batch.x.device), extra_parameters(system)
    problem = Problem(system, engine, batch, sets, free, bounds, theta, extra, options.loss)
    trainer = Trainer(
        problem.to(options.dtype), validation.to(batch.x.device, options.dtype), options, identity,
        writer, checkpoint, progress,
    )  # fmt: skip
    theta, fresh = theta.to(options.dtype), torch.nn.utils.parameters_to_vector(extra).detach().clone()
    alone = trainer.found(theta, fresh, 0, physics.status)
    training = TrainingState(0, theta, fresh)
    if resume is not None:
        training = read_checkpoint(resume, trainer.identity, TrainingState.of, batch.x.device)
        if isinstance(training.state, QuasiNewtonState):
            training.state = prolonged(training.state, options.max_iterations)
    try:
        interrupted = trainer.run(training)
    except KeyboardInterrupt:
        interrupted = True
    found = [alone, *training.found]
    trainer.whole = trainer.whole.to(torch.float64)  # standard errors ask for all digits
    rungs = [_rung(trainer, price, f, spread) for price, f in zip((torch.inf, *prices), found, strict=False)]
    chosen = choose([f.validation for f in found], options.worth)
    return HybridResult(physics, tuple(rungs), chosen, replace(engine, gradient="backprop"), interrupted)


def fit_physics(system: System, batch: Batch, engine: OdeEngine, options: HybridOptions) -> FitResult:
    """Pooled Levenberg-Marquardt fit of a system without its networks, by the solver that trains them."""
    system, batch = physics_of(system, batch)
    settings, smooth = Options(loss=options.loss), Engine("smooth", engine.substeps, engine.width)
    (rough,) = fit(
        system, batch, pooled=True, engine=smooth, options=settings, starts=options.starts, seed=options.seed
    )
    exact = replace(engine, gradient="backprop")
    exact = exact.stable(rough.system, batch, rough.system.theta().detach()[:, None].expand(-1, batch.rows))
    (found,) = fit(rough.system, batch, pooled=True, engine=exact, options=settings, warm=False)
    return found


def fit_each(system: System, batch: Batch, physics: FitResult, options: HybridOptions) -> list[FitResult]:
    """Fits of physics alone with parameters of each row's own, from those of the fit with one set for all rows."""
    smooth = Engine("smooth", physics.engine.substeps, physics.engine.width)
    batch = physics_of(system, batch)[1]
    return fit(physics.system, batch, engine=smooth, options=Options(loss=options.loss), warm=False)


def physics_of(system: System, batch: Batch) -> tuple[System, Batch]:
    """A system without its networks, and the batch without their hidden states."""
    names = system.state_names
    for key in system.networks:
        where, _, kind = key.rpartition("/")
        system = system.without_component(where, kind)
    rows = [names.index(name) for name in system.state_names]
    return system, replace(batch, x=batch.x[..., rows], x0_std=batch.x0_std[:, rows])


def choose(losses: Sequence[Tensor], worth: float) -> int:
    """The first rung whose typical loss is not above the best one's by more than the share ``worth``.

    Physics alone has the benefit of the doubt: it stays, too, where chance (one standard error of the mean logarithm of
    the losses' ratios) may explain the rest.

    Args:
        losses: validation loss of each rung in each part of the records, physics alone first.
        worth: share of the best one's loss.
    """
    best = min(losses, key=typical)
    for k, parts in enumerate(losses):
        above, chance = excess(parts, best)
        if above <= math.log1p(worth) + (chance if k == 0 else 0.0):
            return k
    return len(losses) - 1


def _rung(trainer: Trainer, price: float, found: Found, spread: Spread | None) -> Rung:
    """A rung as a system of its own, with standard errors from the Gauss-Newton matrix of all that it trained."""
    system, theta = trainer.whole.system, found.theta.double()
    values = {  # single precision rounds bounds, too
        i.name: min(max(float(theta[k, 0]), i.spec.lower), i.spec.upper)
        for k, i in enumerate(system.table)
        if i.spec.estimate
    }
    engine = replace(trainer.whole.engine, gradient="backprop")
    batch, training = trainer.whole.batch, TrainingState(0, theta, found.weights.double())
    torch.nn.utils.vector_to_parameters(training.weights, trainer.whole.extra)
    nodes = free_run(system, engine, batch, batch.x, theta.expand(-1, batch.rows), roll_out=True)[
        0
    ].nan_to_num(0.0)

    def errors(at: float) -> tuple[np.ndarray, np.ndarray]:
        """Standard errors as residuals without memory give them, and the larger of these and those of ``spread``."""
        if not np.isfinite(found.train):  # its free run was lost, and says nothing
            return np.full(len(values), np.nan), np.full(len(values), np.nan)
        problem = trainer.problem(Stage(0, at, None, False), training)
        assert problem is not None  # whole records need no windows
        cost = theta.new_full((1,), found.train * float(problem.data[0]))
        q = problem.start(theta)
        sensitivity = problem.evaluated(q, nodes)
        matrix = problem.assembled(sensitivity, q, cost)[0]
        keep = slice(None) if price < torch.inf else slice(0, len(matrix) - problem.weights)
        inverse = torch.linalg.pinv(matrix[keep, keep], hermitian=True).diagonal()[: len(problem.free)]
        plain = ((2.0 * found.train * inverse.clamp_min(0.0)).sqrt() * problem.unit).cpu().numpy()
        if spread is None:
            return plain, plain
        moved = len(problem.free) + (problem.weights if price < torch.inf else 0)
        found_by = spread(*_evidence(problem, sensitivity, cost, len(batch.outputs), moved))
        return plain, np.maximum(plain, problem.unit.cpu().numpy() * found_by[: len(problem.free)])

    plain, loose = errors(0.0)
    return Rung(
        price, system.with_values(values), found.train, typical(found.validation), found.iterations,
        found.status, errors(price)[1] if 0.0 < price < torch.inf else loose, loose, plain,
    )  # fmt: skip


def _evidence(
    problem: Problem, at: Evaluation, cost: Tensor, measured: int, moved: int
) -> tuple[list[np.ndarray], list[np.ndarray], np.ndarray]:
    """Sensitivities and residuals of each record, and the information that holds parameters and weights beside them.

    Parameters are in units of their size, residuals in those of their own RMS.

    Args:
        problem: of one set.
        at: sensitivities at its end.
        cost: there.
        measured: number of outputs that are measured; those behind them are prices, which hold the networks.
        moved: number of parameters and weights that were fitted; the others stand still.
    """
    rows, n_f = torch.arange(problem.batch.rows, device=cost.device), len(problem.free)
    jacobians, residuals = sensitivities(at, rows, rows, problem.batch, Options(loss=problem.loss))
    noise = float(2.0 * cost / problem.data)
    size = np.concatenate([problem.unit.cpu().numpy(), np.ones(moved - n_f)]) / math.sqrt(noise)
    scaled = [part[..., :moved] * size for part in jacobians]
    prior = np.diag(problem.held(cost)[0, :moved].cpu().numpy()) / noise
    prior += sum(np.einsum("tyi,tyj->ij", part[:, measured:], part[:, measured:]) for part in scaled)
    if problem.penalty is not None and moved > n_f:
        prior[n_f:, n_f:] += problem.penalty.curvature().cpu().numpy() / noise
    left = [part[:, :measured] / math.sqrt(noise) for part in residuals]
    return [part[:, :measured] for part in scaled], left, prior
