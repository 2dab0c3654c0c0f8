"""A hybrid training: its settings, its schedule of stages, where it stands, and the loop that runs it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import torch
from torch import Tensor

from hybrid_id.identification.adjoint import Snapshot, Writer
from hybrid_id.identification.checkpoint import as_content, write_checkpoint
from hybrid_id.identification.costate import free_run, simulated
from hybrid_id.identification.decision_vector import Problem
from hybrid_id.identification.networks import output_shares, projection, with_memory, with_price
from hybrid_id.identification.objective import Loss
from hybrid_id.identification.optimizers import (
    AdamState,
    OptimizerState,
    QuasiNewtonState,
    advance,
    begin,
    begin_descent,
    descend,
)
from hybrid_id.identification.windows import measured_windows
from hybrid_id.simulation.batch import Batch

GAIN, STALE = 1e-3, 8
"""Least share by which a loss must fall to count as a gain, and gradients within which the cost must do so."""
PARTS = 10
"""Parts of a validation record whose losses are compared in pairs."""
Progress = Callable[[str, int, float], bool | None]


@dataclass(frozen=True)
class HybridOptions:
    """Settings of a hybrid training.

    Attributes:
        prices: of the networks' mean square output, falling (see :func:`.networks.with_price`).
        windows: stages in which the networks alone train, before the whole records: (length [s], one in this many).
        max_iterations: gradients in a stage.
        tolerance: a stage has converged when the next step is shorter than this many standard errors.
        patience: evaluations of the validation records without a gain after which a stage ends.
        validate_every: gradients between two of them.
        worth: share by which a rung further down must lower the validation loss, see :func:`choose`.
        loss: loss of the weighted residuals.
        starts: start points of the fit of physics alone.
        seed: of these.
        augmentation: what has the price: the networks' mean square output (``norm``), or only the part of what they
            cause that the parameters cause, too (``projection``, see :class:`.networks.Projection`).
        optimizer: ``gauss_newton``, or ``adam`` for networks of more than some hundred weights.
        rate, clip: of Adam: largest step of a parameter or weight in its unit, and length to which a gradient of the
            loss per measurement is clipped (see :mod:`.optimizers`).
        precision: of the training; physics alone is fitted in float64.
    """

    prices: tuple[float, ...] = (10.0, 1.0, 0.1, 0.01)
    windows: tuple[tuple[float, int], ...] = ((0.1, 4), (0.4, 2), (1.6, 1))
    max_iterations: int = 40
    tolerance: float = 0.1
    patience: int = 10
    validate_every: int = 2
    worth: float = 0.02
    loss: Loss = field(default_factory=Loss)
    starts: int = 1
    seed: int = 0
    augmentation: Literal["norm", "projection"] = "norm"
    optimizer: Literal["gauss_newton", "adam"] = "gauss_newton"
    rate: float = 0.01
    clip: float = 1.0
    precision: Literal["float64", "float32"] = "float64"

    @property
    def dtype(self) -> torch.dtype:
        """Number type of the precision."""
        return torch.float32 if self.precision == "float32" else torch.float64

    @property
    def stages(self) -> list[Stage]:
        """The networks alone, on windows of growing length and whole records; then all together, price by price."""
        alone = [Stage(0, self.prices[0], window, True) for window in (*self.windows, None)]
        return alone + [Stage(k, price, None, False) for k, price in enumerate(self.prices)]


class Stage(NamedTuple):
    """A part of the training.

    Attributes:
        rung: number of its price on the ladder.
        price: of the networks' output.
        window: length [s] of windows and use of one in so many; None for whole records.
        hold: whether the physics is held.
    """

    rung: int
    price: float
    window: tuple[float, int] | None
    hold: bool

    @property
    def label(self) -> str:
        """Its name for a progress line."""
        what = "networks" if self.hold else f"physics and networks, price {self.price:g}"
        return f"{what}, {'records' if self.window is None else f'windows of {self.window[0]:g} s'}"


def typical(losses: Tensor) -> float:
    """Geometric mean of the losses in the parts of the validation records.

    A free run that has lost its record (a rotor that rests one tooth further on) says little from there on: the mean
    would be of these parts alone.
    """
    return float(losses.clamp_min(1e-300).log().mean().exp())


def excess(losses: Tensor, reference: Tensor) -> tuple[float, float]:
    """Mean logarithm of the ratio of losses to a reference in the same parts, and its standard error.

    The parts of one record share its run of the machine (friction that drifts from run to run), so that the larger of
    two standard errors counts: that of independent parts, and that of independent records, where there are several.

    Args:
        losses: in each part of each record, ``(n_parts, R)``.
        reference: the same of what they are compared with.
    """
    # both may be infinite where a run is lost
    ratio = torch.where(losses == reference, 1.0, losses / reference).clamp_min(1e-300).log()
    ways = [ratio.flatten()] + ([ratio.mean(0)] if ratio.shape[1] > 1 else [])
    return float(ratio.mean()), max(float(way.std()) / len(way) ** 0.5 for way in ways)


class Found(NamedTuple):
    """What a rung of the ladder came to.

    Attributes:
        theta, weights: ``(n_p, 1)`` and ``(n_w,)``.
        train: loss per measurement.
        validation: the same in each part of the validation records, ``(n_parts, R)``; see :func:`typical`.
        iterations, status: gradients up to here, and how the rung ended.
    """

    theta: Tensor
    weights: Tensor
    train: float
    validation: Tensor
    iterations: int
    status: str


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
        found: finished rungs.
    """

    stage: int
    theta: Tensor
    weights: Tensor
    state: OptimizerState | None = None
    best: Tensor | None = None
    kept: Tensor | None = None
    waited: int = 0
    done: int = 0
    found: list[Found] = field(default_factory=list)

    def content(self) -> dict[str, Any]:
        """The state as tensors, numbers and text."""
        state = None if self.state is None else as_content(self.state)
        return vars(self) | {"state": state, "found": [tuple(f) for f in self.found]}

    @classmethod
    def of(cls, content: dict[str, Any]) -> TrainingState:
        """The state in a checkpoint."""
        state = content["state"]
        found, kind = (
            [Found(*f) for f in content["found"]],
            QuasiNewtonState if state and "metric" in state else AdamState,
        )
        return cls(**content | {"state": None if state is None else kind(**state), "found": found})


@dataclass
class Trainer:
    """Runs the stages of one training.

    Attributes:
        whole: output error over whole records, without a price.
        validation: records that say when a stage ends.
        options: settings.
        identity: of the training, for the checkpoint.
        writer, checkpoint, progress: see :func:`hybrid_id.identification.hybrid.train_hybrid`.
    """

    whole: Problem
    validation: Batch
    options: HybridOptions
    identity: list[str]
    writer: Writer | None = None
    checkpoint: Path | None = None
    progress: Progress | None = None

    @property
    def stages(self) -> list[Stage]:
        """All stages in their order."""
        return self.options.stages

    def problem(self, stage: Stage, training: TrainingState) -> Problem | None:
        """What a stage minimises; None where the records are too short for its windows."""
        whole, system = self.whole, self.whole.system
        torch.nn.utils.vector_to_parameters(training.weights, whole.extra)
        batch, sets = whole.batch, whole.sets
        if stage.window is not None:
            guess = with_memory(system, batch, training.theta.expand(-1, batch.rows))
            cut = measured_windows(system, guess, *stage.window)
            if cut is None:
                return None
            batch, sets = cut[0], sets[cut[1]]
        whole = replace(whole, sets=sets, hold=stage.hold)
        if self.options.augmentation == "norm":
            return replace(whole, batch=with_price(system, batch, stage.price))
        overlap = projection(
            system, batch, training.theta, whole.extra, width=whole.engine.width, price=stage.price
        )
        return replace(whole, batch=batch, penalty=overlap)

    @torch.no_grad()
    def losses(self, theta: Tensor, batch: Batch, *, roll_out: bool = False) -> Tensor:
        """Loss per measurement in each of ten parts of each row, ``(10, R)``, with the weights as they are.

        Rows run from their measured first states; the loss of one that diverged is infinite, and without ``roll_out``
        that of one whose free run is too far off for Newton's method.
        """
        engine = replace(self.whole.engine, gradient="backprop")
        spread = theta.expand(-1, batch.rows)
        x, closed = free_run(self.whole.system, engine, batch, batch.x, spread, roll_out=roll_out)
        y = simulated(self.whole.system, batch, x, spread)
        loss = self.whole.loss.value((batch.y - y) * batch.weight).sum(2)
        loss = loss.where(closed[:, None], torch.inf).nan_to_num(torch.inf, torch.inf)
        number = (batch.weight > 0).sum(2)
        seen = number.cumsum(1)
        part = ((seen - number) * PARTS // seen[:, -1:].clamp_min(1)).clamp_max(PARTS - 1)
        total = loss.new_zeros(batch.rows, PARTS).scatter_add(1, part, loss.where(number > 0, 0.0))
        count = loss.new_zeros(batch.rows, PARTS).scatter_add(1, part, number.to(loss.dtype))
        return (total / count).where(count > 0, (total.sum(1) / count.sum(1))[:, None]).T

    def run(self, training: TrainingState) -> bool:
        """Run all stages that are left; returns whether the training was stopped."""
        while training.stage < len(self.stages):
            stage = self.stages[training.stage]
            problem = self.problem(stage, training)
            if problem is not None:
                if self._stage(problem, stage, training):
                    return True
                self._finish(problem, stage, training)
            training.stage += 1
            training.state, training.best, training.kept, training.waited = None, None, None, 0
        return False

    def _stage(self, problem: Problem, stage: Stage, training: TrainingState) -> bool:
        """Run one stage to its end; returns whether it was stopped before."""
        options = self.options
        if training.state is None:
            training.state = self._begin(problem, training)
        while True:
            state = training.state
            problem.set_weights(state.q)
            ended, looked = not bool(state.running.any()) or _settled(state), None
            if ended or (state.iteration - state.began) % options.validate_every == 0:
                looked = self._validate(problem, state, training)
            self._log(problem, state, training, looked)
            loss = float(state.cost[0] / self._data(problem))
            if self.progress is not None and self.progress(
                stage.label, training.done + state.iteration, loss
            ):
                return True
            if ended or training.waited > options.patience:
                return False
            training.state = self._advance(problem, state)
            if self.checkpoint is not None:
                write_checkpoint(self.checkpoint, training.content(), self.identity)

    def _validate(self, problem: Problem, state: OptimizerState, training: TrainingState) -> float:
        """Compare the validation loss with the stage's best, and keep the decision vector unless it is worse."""
        losses = self.losses(problem.theta(state.q), self.validation)
        best = losses if training.best is None else training.best
        gain = typical(losses) < (1.0 - GAIN) * typical(best)
        worse, chance = excess(losses, best)
        if training.kept is None or gain or worse <= chance:
            training.kept = state.q
        training.best, training.waited = (losses if gain else best), (0 if gain else training.waited + 1)
        return typical(losses)

    def _begin(self, problem: Problem, training: TrainingState) -> OptimizerState:
        """The optimiser's state at the start of a stage."""
        if self.options.optimizer == "adam":
            return begin_descent(problem, training.theta, training.stage)
        return begin(problem, training.theta, training.stage, None)

    def _advance(self, problem: Problem, state: OptimizerState) -> OptimizerState:
        """One more gradient."""
        wish = self.options
        if isinstance(state, AdamState):
            return descend(problem, state, wish.rate, wish.clip, wish.max_iterations)
        assert isinstance(state, QuasiNewtonState)
        return advance(problem, state, wish.tolerance, wish.max_iterations, 1)

    def _finish(self, problem: Problem, stage: Stage, training: TrainingState) -> None:
        """Go on from the stage's kept decision vector; the last stage of a price is a rung of the ladder."""
        state, q = training.state, training.kept
        assert state is not None and q is not None
        problem.set_weights(q)
        training.theta, training.done = problem.theta(q), training.done + state.iteration
        training.weights = torch.nn.utils.parameters_to_vector(problem.extra).detach().clone()
        if not stage.hold:
            early = state.status[0] == "running" and training.waited > self.options.patience
            status = (
                "stopped early" if early else "settled" if state.status[0] == "running" else state.status[0]
            )
            training.found.append(self.found(training.theta, training.weights, training.done, status))

    def found(self, theta: Tensor, weights: Tensor, iterations: int, status: str) -> Found:
        """What a rung came to, with the weights as they are."""
        train, validation = (
            self.losses(theta, batch, roll_out=True) for batch in (self.whole.batch, self.validation)
        )
        counts = (
            (self.whole.batch.weight > 0).sum((1, 2)).to(train.dtype)
        )  # a long record says more of the noise
        mean = float(train.mean(0) @ counts / counts.sum())
        return Found(theta, weights, mean, validation, iterations, status)

    def _data(self, problem: Problem) -> int:
        """Number of measurements, the networks' outputs not among them."""
        return int((problem.batch.weight[..., : len(self.whole.batch.outputs)] > 0).sum())

    def _log(
        self, problem: Problem, state: OptimizerState, training: TrainingState, looked: float | None
    ) -> None:
        """Give the writer one snapshot, networks' outputs apart from the measured ones."""
        if self.writer is None:
            return
        problem.set_weights(state.q)
        count, info = len(self.whole.batch.outputs), [problem.system.table[i] for i in problem.free]
        batch, theta = problem.batch, problem.theta(state.q)
        shares = output_shares(problem.system, batch, state.nodes, theta)
        plain = replace(
            batch, y=batch.y[..., :count], weight=batch.weight[..., :count], outputs=batch.outputs[:count]
        )
        self.writer.record(
            Snapshot(
                step=training.done + state.iteration,
                names=("hybrid",),
                table=tuple((i.component, i.symbol) for i in info),
                values=theta[problem.free].T,
                train=state.cost / self._data(problem),
                validation=None if looked is None else torch.tensor([looked]),
                gradient_norm=state.distance,
                batch=plain,
                sets=problem.sets,
                simulated=state.y[..., :count],
                scalars={f"residual/share_{n}": v for n, v in shares.items()}
                | {"residual/price": self.stages[training.stage].price},
            )
        )


def _settled(state: OptimizerState) -> bool:
    """Whether the last gradients of a stage have lowered its cost by next to nothing; a descent goes up and down."""
    history = state.history
    return (
        isinstance(state, QuasiNewtonState)
        and len(history) > STALE
        and bool(history[-1][0] > (1.0 - GAIN) * history[-1 - STALE][0])
    )
