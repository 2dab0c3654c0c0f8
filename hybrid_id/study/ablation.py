"""One cell of an ablation: an arm trained and tested on the records of one repeat."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import torch

from hybrid_id.identification.horizons import measured_windows
from hybrid_id.identification.hybrid import HybridResult, fit_physics, train_hybrid
from hybrid_id.identification.network_data import with_memory
from hybrid_id.identification.schedule import HybridOptions
from hybrid_id.records.dataset import Dataset
from hybrid_id.simulation.prepare import SIGNAL_SHARE, Batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.solvers import OdeEngine, stable_engine
from hybrid_id.study.ablation_cell import DONE, CellResult, Course, Rung
from hybrid_id.study.ablation_plan import BLACK_BOX, NONE, Cell, Split, split_records, with_arm
from hybrid_id.study.network_role import network_roles
from hybrid_id.study.replays import batch_of
from hybrid_id.systems.black_box import black_box
from hybrid_id.systems.chain import System
from hybrid_id.systems.model_file import describe_model


@dataclass(frozen=True, eq=False)
class Task:
    """What all cells of an ablation share.

    Attributes:
        dataset: the records.
        system: the physics, without networks.
        engine: solver and kind of gradient.
        options: settings of the training; a cell's seed takes the place of theirs.
        inputs: what the networks read.
        memory: hidden states of a network with memory.
        lipschitz: bound of the networks, None for none.
        validation, test, beyond: see :func:`.ablation_plan.split_records`.
        horizon: length [s] of the short free runs from measured states.
        signal_share: see :func:`hybrid_id.simulation.prepare.make_batch`.
    """

    dataset: Dataset
    system: System
    engine: OdeEngine
    options: HybridOptions
    inputs: tuple[str, ...]
    memory: int = 2
    lipschitz: float | None = None
    validation: float = 0.2
    test: float = 0.2
    beyond: tuple[str, ...] = ()
    horizon: float = 0.2
    signal_share: float = SIGNAL_SHARE

    def split(self, seed: int) -> Split:
        """The records of a repeat."""
        return split_records(
            self.dataset, seed, validation=self.validation, test=self.test, beyond=self.beyond
        )

    def model(self, cell: Cell, train: Batch | None = None) -> System:
        """The model of a cell before its training; the network alone takes its scale from the batch."""
        if cell.arm.residual != BLACK_BOX:
            return with_arm(self.system, cell.arm, self.inputs, self.memory, self.lipschitz, cell.seed)
        sizes = [1.0] * len(self.system.joints) if train is None else _accelerations(self.system, train)
        return black_box(self.system, sizes, inputs=self.inputs, hidden=(cell.arm.width,), seed=cell.seed)


def run_cell(task: Task, cell: Cell) -> CellResult:
    """Train and test one cell.

    Raises:
        KeyboardInterrupt: the user stopped the training; nothing of the cell is kept.
    """
    start, split, options = time.perf_counter(), task.split(cell.seed), replace(task.options, seed=cell.seed)
    if cell.arm.residual == BLACK_BOX:
        options = replace(options, prices=(0.0,))
    by_name = {record.name: record for record in task.dataset}

    def batch(system: System, names: tuple[str, ...]) -> Batch:
        return batch_of(task.dataset, system, [by_name[n] for n in names], task.signal_share, "cpu")

    system = task.model(cell, batch(task.model(cell), split.train))
    train, validation, everything = (
        batch(system, names) for names in (split.train, split.validation, tuple(by_name))
    )
    course = Course()
    if cell.arm.residual == NONE:
        found = fit_physics(system, train, task.engine, options)
        engine = replace(task.engine, substeps=found.engine.substeps, gradient="backprop")
        engine = engine.stable(found.system, train, _theta(found.system, train))
        rungs = [_rung(task, found.system, engine, train, everything, torch.inf, found.status)]
        chosen, best = 0, found.system
    else:
        result = train_hybrid(system, train, validation, engine=task.engine, options=options, writer=course)
        if result.interrupted:
            raise KeyboardInterrupt
        rungs = [_of_ladder(task, result, k, train, everything) for k in range(len(result.rungs))]
        chosen, best = result.chosen, result.system
        if cell.arm.residual == BLACK_BOX:  # its first rung, a constant acceleration, is no arm of its own
            rungs, chosen, best = rungs[-1:], 0, result.rungs[-1].system
    steps = [step for step, _ in course.history.get("loss/train", [])]
    return CellResult(
        cell, DONE, "", split, tuple(rungs), chosen, max(steps, default=0), time.perf_counter() - start,
        course.history, describe_model(best),
    )  # fmt: skip


def _of_ladder(task: Task, result: HybridResult, k: int, train: Batch, everything: Batch) -> Rung:
    """One rung of a training's ladder, tested."""
    of = result.rungs[k]
    names = [info.name for info in of.system.table if info.spec.estimate]
    rung = _rung(task, of.system, result.engine, train, everything, of.price, of.status)
    return replace(rung, std_errors=dict(zip(names, of.errors.tolist(), strict=True)))


def _rung(
    task: Task, system: System, engine: OdeEngine, train: Batch, everything: Batch, price: float, status: str
) -> Rung:
    """A trained system, tested on all records."""
    values = {info.name: info.spec.value for info in system.table if info.spec.estimate}
    remembered = with_memory(
        system, everything, _theta(system, everything)
    )  # windows begin with memories in motion
    short, windows = {}, measured_windows(system, remembered, task.horizon)
    if windows is not None:
        short = _missed(system, engine, windows[0])
    roles = network_roles(system, engine, train) if price < torch.inf else ()
    most = max(roles, key=lambda role: role.share, default=None)
    share, overlap = (0.0, 0.0) if most is None else (most.share, most.overlap)
    return Rung(price, _missed(system, engine, everything), short, values, {}, share, overlap, status)


def _missed(system: System, engine: OdeEngine, batch: Batch) -> dict[str, float]:
    """RMS of the weighted error of the free runs by record; infinite where one diverged."""
    run = simulate(system, stable_engine(system, engine, batch), batch)
    square = ((run.y - batch.y) * batch.weight).square().sum((1, 2))
    count = (batch.weight > 0).sum((1, 2))
    found: dict[str, float] = {}
    for name in dict.fromkeys(batch.names):
        rows = torch.tensor([k for k, other in enumerate(batch.names) if other == name])
        mean = float(square[rows].sum() / count[rows].sum())
        found[name] = mean**0.5 if mean == mean else torch.inf
    return found


def _theta(system: System, batch: Batch) -> torch.Tensor:
    return system.theta().detach()[:, None].expand(-1, batch.rows)


def _accelerations(system: System, batch: Batch) -> list[float]:
    """RMS of each motor's measured acceleration [rad/s^2]."""
    dt, found = batch.dt[:, :-1], []
    for joint in system.joints:
        speed = batch.x[:, :, joint.positions[0] + 1]
        found.append(float((speed.diff(dim=1)[dt > 0] / dt[dt > 0]).square().mean().sqrt()) or 1.0)
    return found
