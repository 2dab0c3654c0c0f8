"""The stages of a hybrid training: what each moves and minimises, and when it stops."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from hybrid_id.identification import first_order, quasi_newton
from hybrid_id.identification.adjoint import Snapshot, Writer
from hybrid_id.identification.checkpoint import write_checkpoint
from hybrid_id.identification.costate import free_run
from hybrid_id.identification.decision_vector import Problem
from hybrid_id.identification.first_order import Descent
from hybrid_id.identification.horizons import measured_windows
from hybrid_id.identification.network_data import output_shares, with_memory, with_price
from hybrid_id.identification.network_projection import projection
from hybrid_id.identification.quasi_newton import State
from hybrid_id.identification.schedule import Course, Found, HybridOptions, Stage, excess, typical
from hybrid_id.simulation.prepare import Batch

GAIN, STALE = 1e-3, 8
"""Least share by which a loss must fall to count as a gain, and gradients within which the cost must do so."""
PARTS = 10
"""Parts of a validation record whose losses are compared in pairs."""
Progress = Callable[[str, int, float], bool | None]


@dataclass
class Trainer:
    """Runs the stages of one training.

    Attributes:
        whole: output error over whole records, without a price.
        validation: records that tell when a stage ends.
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

    def problem(self, stage: Stage, course: Course) -> Problem | None:
        """What a stage minimises; None where the records are too short for its windows."""
        whole, system = self.whole, self.whole.system
        torch.nn.utils.vector_to_parameters(course.weights, whole.extra)
        batch, sets = whole.batch, whole.sets
        if stage.window is not None:
            guess = with_memory(system, batch, course.theta.expand(-1, batch.rows))
            cut = measured_windows(system, guess, *stage.window)
            if cut is None:
                return None
            batch, sets = cut[0], sets[cut[1]]
        whole = replace(whole, sets=sets, hold=stage.hold)
        if self.options.augmentation == "norm":
            return replace(whole, batch=with_price(system, batch, stage.price))
        overlap = projection(
            system, batch, course.theta, whole.extra, width=whole.engine.width, price=stage.price
        )
        return replace(whole, batch=batch, penalty=overlap)

    @torch.no_grad()
    def losses(self, theta: Tensor, batch: Batch, *, walk: bool = False) -> Tensor:
        """Loss per measurement in each of ten parts of each row, ``(10, R)``, with the weights as they are.

        Rows run from their measured first states; the loss of one that diverged is infinite, and without ``walk`` that
        of one whose free run is too far off for Newton's method.
        """
        engine = replace(self.whole.engine, gradient="backprop")
        _, lin, closed = free_run(
            self.whole.system, engine, batch, batch.x, theta.expand(-1, batch.rows), walk=walk
        )
        loss = self.whole.loss.value((batch.y - lin.y) * batch.weight).sum(2)
        loss = loss.where(closed[:, None], torch.inf).nan_to_num(torch.inf, torch.inf)
        number = (batch.weight > 0).sum(2)
        seen = number.cumsum(1)
        part = ((seen - number) * PARTS // seen[:, -1:].clamp_min(1)).clamp_max(PARTS - 1)
        total = loss.new_zeros(batch.rows, PARTS).scatter_add(1, part, loss.where(number > 0, 0.0))
        count = loss.new_zeros(batch.rows, PARTS).scatter_add(1, part, number.to(loss.dtype))
        return (total / count).where(count > 0, (total.sum(1) / count.sum(1))[:, None]).T

    def run(self, course: Course) -> bool:
        """Run all stages that are left; returns whether the training was stopped."""
        while course.stage < len(self.stages):
            stage = self.stages[course.stage]
            problem = self.problem(stage, course)
            if problem is not None:
                if self._stage(problem, stage, course):
                    return True
                self._finish(problem, stage, course)
            course.stage += 1
            course.state, course.best, course.kept, course.waited = None, None, None, 0
        return False

    def _stage(self, problem: Problem, stage: Stage, course: Course) -> bool:
        """Run one stage to its end; returns whether it was stopped before."""
        options = self.options
        if course.state is None:
            course.state = self._begin(problem, course)
        while True:
            state = course.state
            problem.set_weights(state.q)
            ended, looked = not bool(state.running.any()) or _settled(state), None
            if ended or (state.iteration - state.began) % options.validate_every == 0:
                looked = self._look(problem, state, course)
            self._tell(problem, state, course, looked)
            loss = float(state.cost[0] / self._data(problem))
            if self.progress is not None and self.progress(stage.label, course.done + state.iteration, loss):
                return True
            if ended or course.waited > options.patience:
                return False
            course.state = self._advance(problem, state)
            if self.checkpoint is not None:
                write_checkpoint(self.checkpoint, course.content(), self.identity)

    def _look(self, problem: Problem, state: State | Descent, course: Course) -> float:
        """Compare the validation loss with the stage's best, and keep the unknowns unless it is worse."""
        losses = self.losses(problem.theta(state.q), self.validation)
        best = losses if course.best is None else course.best
        gain = typical(losses) < (1.0 - GAIN) * typical(best)
        worse, chance = excess(losses, best)
        if course.kept is None or gain or worse <= chance:
            course.kept = state.q
        course.best, course.waited = (losses if gain else best), (0 if gain else course.waited + 1)
        return typical(losses)

    def _begin(self, problem: Problem, course: Course) -> State | Descent:
        """The optimiser's state at the start of a stage."""
        if self.options.optimizer == "adam":
            return first_order.begin(problem, course.theta, course.stage)
        return quasi_newton.begin(problem, course.theta, course.stage, None)

    def _advance(self, problem: Problem, state: State | Descent) -> State | Descent:
        """One more gradient."""
        wish = self.options
        if isinstance(state, Descent):
            return first_order.advance(problem, state, wish.rate, wish.clip, wish.max_iterations)
        return quasi_newton.advance(problem, state, wish.tolerance, wish.max_iterations, 1)

    def _finish(self, problem: Problem, stage: Stage, course: Course) -> None:
        """Go on from the stage's kept unknowns; the last stage of a price is a rung of the ladder."""
        state, q = course.state, course.kept
        assert state is not None and q is not None
        problem.set_weights(q)
        course.theta, course.done = problem.theta(q), course.done + state.iteration
        course.weights = torch.nn.utils.parameters_to_vector(problem.extra).detach().clone()
        if not stage.hold:
            early = state.status[0] == "running" and course.waited > self.options.patience
            status = (
                "stopped early" if early else "settled" if state.status[0] == "running" else state.status[0]
            )
            course.found.append(self.found(course.theta, course.weights, course.done, status))

    def found(self, theta: Tensor, weights: Tensor, iterations: int, status: str) -> Found:
        """What a rung came to, with the weights as they are."""
        train, validation = (
            self.losses(theta, batch, walk=True) for batch in (self.whole.batch, self.validation)
        )
        counts = (
            (self.whole.batch.weight > 0).sum((1, 2)).to(train.dtype)
        )  # a long record tells more of the noise
        mean = float(train.mean(0) @ counts / counts.sum())
        return Found(theta, weights, mean, validation, iterations, status)

    def _data(self, problem: Problem) -> int:
        """Number of measurements, the networks' outputs not among them."""
        return int((problem.batch.weight[..., : len(self.whole.batch.outputs)] > 0).sum())

    def _tell(self, problem: Problem, state: State | Descent, course: Course, looked: float | None) -> None:
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
                step=course.done + state.iteration,
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
                | {"residual/price": self.stages[course.stage].price},
            )
        )


def _settled(state: State | Descent) -> bool:
    """Whether the last gradients of a stage have lowered its cost by next to nothing; a descent goes up and down."""
    history = state.history
    return (
        isinstance(state, State)
        and len(history) > STALE
        and bool(history[-1][0] > (1.0 - GAIN) * history[-1 - STALE][0])
    )
