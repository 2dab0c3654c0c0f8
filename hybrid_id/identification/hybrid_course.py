"""The stages of a hybrid training: what each moves, when it stops, and what a checkpoint holds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor

from hybrid_id.identification.adjoint import Snapshot, Writer
from hybrid_id.identification.checkpoint import as_content, write_checkpoint
from hybrid_id.identification.costate import free_run
from hybrid_id.identification.fit import measured_windows
from hybrid_id.identification.network_data import output_shares, with_memory, with_price
from hybrid_id.identification.quasi_newton import State, advance, begin
from hybrid_id.identification.unknowns import Problem
from hybrid_id.simulation.prepare import Batch

GAIN, STALE = 1e-3, 8
"""Least share by which a loss must fall to count as a gain, and gradients within which the cost must do so."""
PARTS = 10
"""Parts of a validation record whose losses are compared in pairs."""
Progress = Callable[[str, int, float], bool | None]


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


class Found(NamedTuple):
    """What a rung of the ladder came to.

    Attributes:
        theta, weights: ``(n_p, 1)`` and ``(n_w,)``.
        train: loss per measurement.
        validation: the same in each part of the validation records; their mean is the loss.
        iterations, status: gradients up to here, and how the rung ended.
    """

    theta: Tensor
    weights: Tensor
    train: float
    validation: Tensor
    iterations: int
    status: str


@dataclass
class Course:
    """Where a training stands; all of it is in the checkpoint.

    Attributes:
        stage: number of the stage.
        theta, weights: what it started from, ``(n_p, 1)`` and ``(n_w,)``.
        state: the optimiser's; None where the stage has not begun.
        best, best_q, waited: least validation loss of the stage, its unknowns, and looks since then.
        done: gradients before this stage.
        found: finished rungs.
    """

    stage: int
    theta: Tensor
    weights: Tensor
    state: State | None = None
    best: float = torch.inf
    best_q: Tensor | None = None
    waited: int = 0
    done: int = 0
    found: list[Found] = field(default_factory=list)

    def content(self) -> dict[str, Any]:
        """The course as tensors, numbers and text."""
        state = None if self.state is None else as_content(self.state)
        return vars(self) | {"state": state, "found": [tuple(f) for f in self.found]}

    @classmethod
    def of(cls, content: dict[str, Any]) -> Course:
        """The course of a checkpoint."""
        state = content["state"]
        found = [Found(*f) for f in content["found"]]
        return cls(**content | {"state": None if state is None else State(**state), "found": found})


@dataclass
class Trainer:
    """Runs the stages of one training.

    Attributes:
        whole: output error over whole records, without a price.
        validation: records that tell when a stage ends.
        stages: in their order.
        max_iterations, tolerance: of each stage.
        patience, validate_every: looks without a gain that end a stage, and gradients between two of them.
        identity: names of records, components and stages, for the checkpoint.
        writer, checkpoint, progress: see :func:`hybrid_id.identification.hybrid.train_hybrid`.
    """

    whole: Problem
    validation: Batch
    stages: list[Stage]
    max_iterations: int
    tolerance: float
    patience: int
    validate_every: int
    identity: list[str]
    writer: Writer | None = None
    checkpoint: Path | None = None
    progress: Progress | None = None

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
        return replace(whole, batch=with_price(system, batch, stage.price), sets=sets, hold=stage.hold)

    @torch.no_grad()
    def losses(self, theta: Tensor, batch: Batch) -> Tensor:
        """Loss per measurement in each of ten parts of each row, ``(10 R,)``, with the weights as they are.

        Rows run from their measured first states; the loss of one that diverged is infinite.
        """
        engine = replace(self.whole.engine, gradient="backprop")
        _, lin, closed = free_run(self.whole.system, engine, batch, batch.x, theta.expand(-1, batch.rows))
        loss = self.whole.loss.value((batch.y - lin.y) * batch.weight).sum(2)
        loss = loss.where(closed[:, None], torch.inf).nan_to_num(torch.inf, torch.inf)
        scale = PARTS * batch.rows / (batch.weight > 0).sum()
        return torch.cat([part.sum(1) * scale for part in loss.tensor_split(PARTS, 1)])

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
            course.state, course.best, course.best_q, course.waited = None, torch.inf, None, 0
        return False

    def _stage(self, problem: Problem, stage: Stage, course: Course) -> bool:
        """Run one stage to its end; returns whether it was stopped before."""
        if course.state is None:
            course.state = begin(problem, course.theta, course.stage, None)
        while True:
            state = course.state
            problem.set_weights(state.q)
            ended, looked = not bool(state.running.any()) or _settled(state), None
            if ended or (state.iteration - state.began) % self.validate_every == 0:
                looked = float(self.losses(problem.theta(state.q), self.validation).mean())
                gain = looked < (1.0 - GAIN) * course.best
                course.waited = 0 if gain else course.waited + 1
                if gain or course.best_q is None:
                    course.best, course.best_q = looked, state.q
            self._tell(problem, state, course, looked)
            loss = float(state.cost[0] / self._data(problem))
            if self.progress is not None and self.progress(stage.label, course.done + state.iteration, loss):
                return True
            if ended or course.waited > self.patience:
                return False
            course.state = advance(problem, state, self.tolerance, self.max_iterations, 1)
            if self.checkpoint is not None:
                write_checkpoint(self.checkpoint, course.content(), self.identity)

    def _finish(self, problem: Problem, stage: Stage, course: Course) -> None:
        """Go on from the stage's best unknowns; the last stage of a price is a rung of the ladder."""
        state, q = course.state, course.best_q
        assert state is not None and q is not None
        problem.set_weights(q)
        course.theta, course.done = problem.theta(q), course.done + state.iteration
        course.weights = torch.nn.utils.parameters_to_vector(problem.extra).detach().clone()
        if not stage.hold:
            early = state.status[0] == "running" and course.waited > self.patience
            status = (
                "stopped early" if early else "settled" if state.status[0] == "running" else state.status[0]
            )
            course.found.append(self.found(course.theta, course.weights, course.done, status))

    def found(self, theta: Tensor, weights: Tensor, iterations: int, status: str) -> Found:
        """What a rung came to, with the weights as they are."""
        train, validation = (self.losses(theta, batch) for batch in (self.whole.batch, self.validation))
        return Found(theta, weights, float(train.mean()), validation, iterations, status)

    def _data(self, problem: Problem) -> int:
        """Number of measurements, the networks' outputs not among them."""
        return int((problem.batch.weight[..., : len(self.whole.batch.outputs)] > 0).sum())

    def _tell(self, problem: Problem, state: State, course: Course, looked: float | None) -> None:
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


def _settled(state: State) -> bool:
    """Whether the last gradients of a stage have lowered its cost by next to nothing."""
    history = state.history
    return len(history) > STALE and bool(history[-1][0] > (1.0 - GAIN) * history[-1 - STALE][0])
