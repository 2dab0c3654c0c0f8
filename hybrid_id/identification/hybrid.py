"""Training of physics with residual networks, in stages: physics, the networks with physics held, both together.

The networks' output has a price, so that they add only what the physics cannot say. Validation records tell where the
training stops and whether the networks are worth their freedom. Gradients are the adjoint's, steps those of
:mod:`hybrid_id.identification.optimizers`.

Sources: Y. Yin et al., APHYNITY, ICLR 2021 (least-norm augmentation); L. Prechelt, Early stopping, 1998.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor
from torch.nn.utils import parameters_to_vector, vector_to_parameters

from hybrid_id.errors import InputError
from hybrid_id.identification.adjoint import Snapshot, Writer
from hybrid_id.identification.costate import free_run, simulated
from hybrid_id.identification.decision_vector import Problem
from hybrid_id.identification.fit import fit, make_bounds
from hybrid_id.identification.keep import digest_of, read_checkpoint, write_checkpoint
from hybrid_id.identification.least_squares import Options
from hybrid_id.identification.networks import output_shares, with_memory, with_price, with_scales
from hybrid_id.identification.objective import Loss
from hybrid_id.identification.optimizers import (
    AdamState,
    GaussNewtonState,
    OptimizerState,
    advance,
    begin,
    begin_descent,
    descend,
    prolonged,
)
from hybrid_id.identification.result import FitResult, sensitivities
from hybrid_id.identification.windows import measured_windows
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.solvers import OdeEngine, extra_parameters
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.chain import System

GAIN, STALE = 1e-3, 8
"""Least share by which a loss must fall to count as a gain, and gradients within which the cost must do so."""
PARTS = 10
"""Parts of a validation record whose losses are compared in pairs."""
Progress = Callable[[str, int, float], bool | None]
Spread = Callable[[list[np.ndarray], list[np.ndarray], np.ndarray], np.ndarray]
"""Standard errors by the weighted sensitivities and residuals of each record, and the information of priors."""


@dataclass(frozen=True)
class HybridOptions:
    """Settings of a hybrid training.

    Attributes:
        price: of the networks' mean square output (see :func:`.networks.with_price`).
        windows: stages in which the networks alone train, before the whole records: (length [s], one in this many).
        max_iterations: gradients in a stage.
        tolerance: a stage has converged when the next step is shorter than this many standard errors.
        patience: evaluations of the validation records without a gain after which a stage ends.
        validate_every: gradients between two of them.
        worth: share by which the networks must lower the validation loss to be kept, see :func:`worth_it`.
        loss: loss of the weighted residuals.
        starts: start points of the fit of physics alone.
        seed: of these.
        optimizer: ``gauss_newton``, or ``adam`` for networks of more than some hundred weights.
        rate, clip: of Adam: largest step of a parameter or weight in its unit, and length to which a gradient of the
            loss per measurement is clipped (see :mod:`.optimizers`).
    """

    price: float = 1.0
    windows: tuple[tuple[float, int], ...] = ((0.1, 4), (0.4, 2), (1.6, 1))
    max_iterations: int = 40
    tolerance: float = 0.1
    patience: int = 10
    validate_every: int = 2
    worth: float = 0.02
    loss: Loss = field(default_factory=Loss)
    starts: int = 1
    seed: int = 0
    optimizer: Literal["gauss_newton", "adam"] = "gauss_newton"
    rate: float = 0.01
    clip: float = 1.0


@dataclass(frozen=True, eq=False)
class Trained:
    """A model that a hybrid training ends with: physics alone, or with networks.

    Attributes:
        system: the trained system.
        train, validation: loss per measurement; that of validation records is :func:`typical`.
        iterations: gradients up to here.
        status: how the training ended.
        errors: standard errors of the estimated parameters, ``(n_f,)``; with networks, their weights are unknown
            too.
        loose: the same without the price, which alone keeps a parameter where a network could do its work.
        plain: those without the price if residuals had no memory: what the records alone tell apart.
    """

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
        models: physics alone, then with networks; the former only where the training was stopped before its end.
        chosen: number of the model that the validation records choose.
        price: of the networks' output.
        engine: with which all of them are simulated.
        interrupted: whether the training was stopped before its end.
    """

    physics: FitResult
    models: tuple[Trained, ...]
    chosen: int
    price: float
    engine: OdeEngine
    interrupted: bool

    @property
    def system(self) -> System:
        """The chosen system."""
        return self.models[self.chosen].system


@dataclass
class TrainingState:
    """Where a training stands; all of it is in the checkpoint.

    Attributes:
        stage: number of the stage.
        theta, weights: what it started from, ``(n_p, 1)`` and ``(n_w,)``.
        state: the optimiser's; None where the stage has not begun.
        best, waited: validation losses of the stage where they were least, and evaluations since then.
        kept: decision vector of the last evaluation whose losses were not above those by more than chance: what the
            train records say counts until the validation records object.
        done: gradients before this stage.
        status: how the last stage ended.
    """

    stage: int
    theta: Tensor
    weights: Tensor
    state: OptimizerState | None = None
    best: Tensor | None = None
    kept: Tensor | None = None
    waited: int = 0
    done: int = 0
    status: str = ""

    @classmethod
    def of(cls, content: dict[str, Any]) -> TrainingState:
        """The state in a checkpoint."""
        state = content["state"]
        if state is not None:
            state = GaussNewtonState(**state) if "metric" in state else AdamState(**state)
        rest = {name: value for name, value in content.items() if name != "state"}
        return cls(**rest, state=state)


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

    Ctrl-C ends the training with the models that it has.

    Args:
        system: model with at least one residual network; what its networks have learnt before is forgotten.
        batch: records to train on.
        validation: records that tell when to stop and whether to keep the networks.
        engine: solver and kind of gradient.
        options: settings.
        writer: takes the history of the training.
        checkpoint: file that holds the training after each gradient.
        resume: checkpoint of the same training to go on from, to the same numbers.
        progress: called with (stage, gradients so far, loss per measurement); true ends the training.
        spread: standard errors that allow for correlated residuals, which count where they are larger.

    Raises:
        InputError: no network, nothing to estimate, a negative price, or a checkpoint of another training.
    """
    options, engine = options or HybridOptions(), engine or OdeEngine()
    if not system.networks:
        raise InputError(
            "The model has no residual network to train; add one to a place, or use a plain fit."
        )
    if not options.price >= 0.0:
        raise InputError(f"The price of the networks is {options.price}; give a number that is not negative.")
    settings = (engine, options.optimizer, options.windows, options.price, options.loss, options.worth)
    settings += (options.starts, options.seed)
    settings += (options.rate, options.clip) if options.optimizer == "adam" else ()
    identity = ["hybrid", digest_of((system, batch, validation, settings))]
    physics = fit_physics(system, batch, engine, options)
    values = {name: physics.system.parameter(name).spec.value for name in physics.names}
    system = with_scales(system.with_values(values), batch, engine.width)
    for part in system.networks.values():
        part.forget()
    device = batch.x.device
    system, validation, free = system.to(device), validation.to(device), system.estimated
    theta = system.theta().detach()[:, None]
    engine = engine.stable(system, batch, theta.expand(-1, batch.rows))
    sets = torch.zeros(batch.rows, dtype=torch.long, device=device)
    bounds, extra = make_bounds(system, free, device), extra_parameters(system)
    whole = Problem(system, engine, batch, sets, free, bounds, theta, extra, options.loss)
    training = TrainingState(0, theta, parameters_to_vector(extra).detach().clone(), status=physics.status)
    ends = [(replace(training), losses(whole, theta, validation, roll_out=True))]
    if resume is not None:
        training = read_checkpoint(resume, identity, TrainingState.of, device)
        if isinstance(training.state, GaussNewtonState):
            training.state = prolonged(training.state, options.max_iterations)

    def keep() -> None:
        if checkpoint is not None:
            state = None if training.state is None else dict(vars(training.state))
            write_checkpoint(checkpoint, vars(training) | {"state": state}, identity)

    try:
        interrupted = _descend(whole, validation, options, training, writer, keep, progress)
    except KeyboardInterrupt:
        interrupted = True
    if not interrupted:
        vector_to_parameters(training.weights, extra)
        ends.append((training, losses(whole, training.theta, validation, roll_out=True)))
    models = [_trained(whole, end, loss, options.price * k, spread) for k, (end, loss) in enumerate(ends)]
    chosen = int(len(ends) > 1 and worth_it(ends[0][1], ends[1][1], options.worth))
    exact = replace(engine, gradient="backprop")
    return HybridResult(physics, tuple(models), chosen, options.price, exact, interrupted)


def _descend(
    whole: Problem,
    validation: Batch,
    options: HybridOptions,
    training: TrainingState,
    writer: Writer | None,
    keep: Callable[[], None],
    progress: Progress | None,
) -> bool:
    """Run all stages that are left; returns whether the training was stopped.

    The networks train alone, on windows of growing length and whole records; then all together.
    """
    system, adam = whole.system, options.optimizer == "adam"
    stages = [*((window, True) for window in (*options.windows, None)), (None, False)]
    while training.stage < len(stages):
        window, hold = stages[training.stage]
        vector_to_parameters(training.weights, whole.extra)
        batch, sets, label = whole.batch, whole.sets, "networks" if hold else "physics and networks"
        label += ", records" if window is None else f", windows of {window[0]:g} s"
        if window is not None:
            guess = with_memory(system, batch, training.theta.expand(-1, batch.rows))
            cut = measured_windows(system, guess, *window)
            if cut is None:  # the records are too short
                training.stage += 1
                continue
            batch, sets = cut[0], sets[cut[1]]
        problem = replace(whole, batch=with_price(system, batch, options.price), sets=sets, hold=hold)
        data = int((batch.weight > 0).sum())
        if training.state is None:
            training.state = (
                begin_descent(problem, training.theta, training.stage)
                if adam
                else begin(problem, training.theta, training.stage, None)
            )
        while True:
            state, looked = training.state, None
            problem.set_weights(state.q)
            theta, history = problem.theta(state.q), state.history
            # the last gradients have lowered the cost by next to nothing; Adam goes up and down
            stale = not adam and len(history) > STALE
            settled = stale and bool(history[-1][0] > (1.0 - GAIN) * history[-1 - STALE][0])
            ended = not bool(state.running.any()) or settled
            if ended or (state.iteration - state.began) % options.validate_every == 0:
                found = losses(whole, theta, validation)
                best = found if training.best is None else training.best
                gain = typical(found) < (1.0 - GAIN) * typical(best)
                worse, chance = excess(found, best)
                if training.kept is None or gain or worse <= chance:
                    training.kept = state.q
                training.best, training.waited = (found, 0) if gain else (best, training.waited + 1)
                looked = torch.tensor([typical(found)])
            if writer is not None:
                shares = output_shares(system, problem.batch, state.nodes, theta)
                told = {f"residual/share_{name}": share for name, share in shares.items()}
                told["residual/price"] = options.price
                measured, step = replace(problem, batch=batch), training.done + state.iteration
                writer.record(Snapshot.of(step, ("hybrid",), measured, state, looked, told))
            if progress is not None and progress(
                label, training.done + state.iteration, float(state.cost[0] / data)
            ):
                return True
            if ended or training.waited > options.patience:
                break
            if isinstance(state, AdamState):
                training.state = descend(problem, state, options.rate, options.clip, options.max_iterations)
            elif isinstance(state, GaussNewtonState):
                training.state = advance(problem, state, options.tolerance, options.max_iterations)
            keep()
        assert training.kept is not None  # the first gradient is looked at, the last at the latest
        early = "stopped early" if training.waited > options.patience else "settled"
        training.status = early if state.status[0] == "running" else state.status[0]
        problem.set_weights(training.kept)
        training.theta, training.done = problem.theta(training.kept), training.done + state.iteration
        training.weights = parameters_to_vector(problem.extra).detach().clone()
        training.stage += 1
        training.state, training.best, training.kept, training.waited = None, None, None, 0
    return False


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


def physics_of(system: System, batch: Batch) -> tuple[System, Batch]:
    """A system without its networks, and the batch without their hidden states."""
    names = system.state_names
    for key in system.networks:
        where, _, kind = key.rpartition("/")
        system = system.without_component(where, kind)
    rows = [names.index(name) for name in system.state_names]
    return system, replace(batch, x=batch.x[..., rows], x0_std=batch.x0_std[:, rows])


@torch.no_grad()
def losses(problem: Problem, theta: Tensor, batch: Batch, *, roll_out: bool = False) -> Tensor:
    """Loss per measurement in each of ten parts of each row, ``(10, R)``, with the weights as they are.

    Rows run from their measured first states; the loss of one that diverged is infinite, and without ``roll_out``
    that of one whose free run is too far off for Newton's method.

    Args:
        problem: system, engine and loss.
        theta: all parameters, ``(n_p, 1)``.
        batch: records.
        roll_out: see :func:`.costate.free_run`.
    """
    engine, spread = replace(problem.engine, gradient="backprop"), theta.expand(-1, batch.rows)
    x, closed = free_run(problem.system, engine, batch, batch.x, spread, roll_out=roll_out)
    y = simulated(problem.system, batch, x, spread)
    loss = problem.loss.value((batch.y - y) * batch.weight).sum(2)
    loss = loss.where(closed[:, None], torch.inf).nan_to_num(torch.inf, torch.inf)
    number = (batch.weight > 0).sum(2)
    seen = number.cumsum(1)
    part = ((seen - number) * PARTS // seen[:, -1:].clamp_min(1)).clamp_max(PARTS - 1)
    total = loss.new_zeros(batch.rows, PARTS).scatter_add(1, part, loss.where(number > 0, 0.0))
    count = loss.new_zeros(batch.rows, PARTS).scatter_add(1, part, number.to(loss.dtype))
    return (total / count).where(count > 0, (total.sum(1) / count.sum(1))[:, None]).T


def typical(parts: Tensor) -> float:
    """Geometric mean of the losses in the parts of the validation records.

    A free run that has lost its record (a rotor that rests one tooth further on) says little from there on: the mean
    would be of these parts alone.
    """
    return float(parts.clamp_min(1e-300).log().mean().exp())


def excess(parts: Tensor, reference: Tensor) -> tuple[float, float]:
    """Mean logarithm of the ratio of losses to a reference in the same parts, and its standard error.

    The parts of one record share its run of the machine (friction that drifts from run to run), so that the larger of
    two standard errors counts: that of independent parts, and that of independent records, where there are several.

    Args:
        parts: losses in each part of each record, ``(n_parts, R)``.
        reference: the same of what they are compared with.
    """
    # both may be infinite where a run is lost
    ratio = torch.where(parts == reference, 1.0, parts / reference).clamp_min(1e-300).log()
    ways = [ratio.flatten()] + ([ratio.mean(0)] if ratio.shape[1] > 1 else [])
    return float(ratio.mean()), max(float(way.std()) / len(way) ** 0.5 for way in ways)


def worth_it(physics: Tensor, hybrid: Tensor, worth: float) -> bool:
    """Whether networks lower the typical validation loss by more than the share ``worth`` and by more than chance.

    Physics alone has the benefit of the doubt: chance is one standard error of the mean log ratio of the losses.

    Args:
        physics: validation loss of physics alone in each part of the records, ``(n_parts, R)``.
        hybrid: the same with networks.
        worth: share of the loss with networks.
    """
    if typical(physics) <= typical(hybrid):
        return False
    above, chance = excess(physics, hybrid)
    # chance is unknown where physics alone loses a record: it is worse
    return not above <= math.log1p(worth) + chance


def _trained(
    whole: Problem, end: TrainingState, validation: Tensor, price: float, spread: Spread | None
) -> Trained:
    """A model of its own, with standard errors from the Gauss-Newton matrix of all that was trained.

    Args:
        whole: output error over whole records.
        end: of the training; its first stage for physics alone.
        validation: losses, see :func:`losses`.
        price: of the networks; 0 for physics alone.
        spread: see :func:`train_hybrid`.
    """
    system, batch, theta, networks = whole.system, whole.batch, end.theta, end.stage > 0
    vector_to_parameters(end.weights, whole.extra)
    values = {i.name: float(theta[k, 0]) for k, i in enumerate(system.table) if i.spec.estimate}
    parts = losses(whole, theta, batch, roll_out=True)
    counts = (batch.weight > 0).sum((1, 2)).to(parts.dtype)  # a long record says more of the noise
    train = float(parts.mean(0) @ counts / counts.sum())
    exact = replace(whole.engine, gradient="backprop")
    spread_theta = theta.expand(-1, batch.rows)
    nodes = free_run(system, exact, batch, batch.x, spread_theta, roll_out=True)[0].nan_to_num(0.0)
    n_f = len(whole.free)
    moved = n_f + (whole.weights if networks else 0)

    def errors(at: float) -> tuple[np.ndarray, np.ndarray]:
        """Standard errors as residuals without memory give them, and the larger of these and those of ``spread``."""
        if not np.isfinite(train):  # its free run was lost, and says nothing
            return np.full(len(values), np.nan), np.full(len(values), np.nan)
        problem = replace(whole, batch=with_price(system, batch, at))
        noise = 2.0 * train
        cost, q = theta.new_full((1,), train * float(problem.data[0])), problem.start(theta)
        sensitivity = problem.evaluated(q, nodes)
        matrix = problem.curvature(sensitivity, q, cost)[0]
        matrix = matrix if networks else matrix[: -problem.weights, : -problem.weights]
        inverse = torch.linalg.pinv(matrix, hermitian=True).diagonal()[:n_f]
        plain = ((noise * inverse.clamp_min(0.0)).sqrt() * problem.unit).cpu().numpy()
        if spread is None:
            return plain, plain
        # parameters in units of their size, residuals in those of their own RMS; prices behind the measured outputs
        # hold the networks as priors do
        rows, measured = torch.arange(batch.rows, device=cost.device), len(batch.outputs)
        jacobians, residuals = sensitivities(
            sensitivity, rows, rows, problem.batch, Options(loss=problem.loss)
        )
        size = np.concatenate([problem.unit.cpu().numpy(), np.ones(moved - n_f)]) / math.sqrt(noise)
        scaled = [part[..., :moved] * size for part in jacobians]
        prior = np.diag(problem.held(cost)[0, :moved].cpu().numpy()) / noise
        prior += sum(np.einsum("tyi,tyj->ij", part[:, measured:], part[:, measured:]) for part in scaled)
        left = [part[:, :measured] / math.sqrt(noise) for part in residuals]
        wide = spread([part[:, :measured] for part in scaled], left, prior)[:n_f]
        return plain, np.maximum(plain, problem.unit.cpu().numpy() * wide)

    plain, loose = errors(0.0)
    return Trained(
        system.with_values(values), train, typical(validation), end.done, end.status,
        errors(price)[1] if price > 0.0 else loose, loose, plain,
    )  # fmt: skip
