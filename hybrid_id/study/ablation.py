"""Cells of an ablation: an arm trained and tested on the records of one repeat, computed one by one and kept."""

from __future__ import annotations

import hashlib
import json
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import torch
from pydantic import BeforeValidator, TypeAdapter

from hybrid_id import __version__
from hybrid_id.identification.adjoint import Snapshot
from hybrid_id.identification.hybrid import HybridOptions, HybridResult, fit_physics, train_hybrid
from hybrid_id.identification.keep import digest_of
from hybrid_id.identification.networks import with_memory
from hybrid_id.identification.windows import measured_windows
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.files import hidden_beside
from hybrid_id.records.yaml_file import write_yaml
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.prepare import SIGNAL_SHARE
from hybrid_id.simulation.solvers import OdeEngine
from hybrid_id.study.ablation_plan import BLACK_BOX, NONE, Cell, Split, split_records, with_arm
from hybrid_id.study.fan_out import Failure, fan_out, sealed, unsealed
from hybrid_id.study.hybrid import correlated_errors, network_roles
from hybrid_id.study.replays import batch_of, weighted_errors
from hybrid_id.study.training import scalars
from hybrid_id.systems.builders import black_box
from hybrid_id.systems.chain import System
from hybrid_id.systems.model_file import SKELETON, describe_model

FAILED, DONE = "failed", "done"
# JSON holds neither infinite numbers nor NaN: both are null in a file
Infinite = Annotated[float, BeforeValidator(lambda value: math.inf if value is None else value)]
Unknown = Annotated[float, BeforeValidator(lambda value: math.nan if value is None else value)]
CELL, MODEL = "cell.json", "model.yaml"


@dataclass(frozen=True)
class Rung:
    """A trained model at one price of its network's output; physics alone at an infinite one.

    Attributes:
        price: of the network's output.
        errors: RMS of the weighted error of the free run over each whole record, by record; 1 is the noise floor.
        short: the same of short free runs from measured states; empty where the records are too short.
        values, std_errors: of the estimated parameters by name.
        share: RMS of the network's output over that of the motor's torque; of the network with the largest.
        overlap: its overlap with the physics, see :class:`hybrid_id.study.hybrid.NetworkRole`.
        status: how its training ended.
    """

    price: Infinite
    errors: dict[str, Infinite]
    short: dict[str, Infinite]
    values: dict[str, float]
    std_errors: dict[str, Infinite]
    share: Unknown
    overlap: Unknown
    status: str


@dataclass(frozen=True)
class CellResult:
    """What a cell came to, as plain data.

    Attributes:
        cell: which one.
        status: done or failed.
        message: why it failed.
        split: the records.
        rungs: models by price, physics alone first; a cell of physics only has one, and so has a network alone.
        chosen: number of the rung that the validation records chose.
        gradients: of the whole training.
        seconds: that it took.
        history: of the training by tag, (gradient, value) each.
        model: the chosen model as a model file holds it; empty of a network alone that no model file can hold.
    """

    cell: Cell
    status: str = DONE
    message: str = ""
    split: Split | None = None
    rungs: tuple[Rung, ...] = ()
    chosen: int = 0
    gradients: int = 0
    seconds: float = 0.0
    history: dict[str, list[tuple[int, Unknown]]] = field(default_factory=dict)
    model: dict[str, Any] = field(default_factory=dict)

    @property
    def best(self) -> Rung:
        """The chosen rung."""
        return self.rungs[self.chosen]

    def error(self, records: str) -> float:
        """RMS of the chosen model's errors over the train, validation, test or beyond records; nan of none."""
        names = () if self.split is None else getattr(self.split, records)
        square = [self.best.errors[name] ** 2 for name in names]
        return math.sqrt(sum(square) / len(square)) if square else math.nan


class History:
    """Keeps the scalars of a training, where :class:`~hybrid_id.identification.adjoint.Writer` asks for a writer."""

    def __init__(self) -> None:
        self.history: dict[str, list[tuple[int, float]]] = {}

    def record(self, snapshot: Snapshot) -> None:
        """Take one snapshot."""
        (figures,) = scalars(snapshot, fits=False).values()
        for tag, value in figures.items():
            self.history.setdefault(tag, []).append((snapshot.step, value))


def from_plain(content: dict[str, Any]) -> CellResult:
    """The result that :func:`save_cell` made a mapping of; an error that is None was infinite.

    Raises:
        ValueError: no such mapping.
    """
    return TypeAdapter(CellResult).validate_python(content)


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
        alone = partial(black_box, self.system, inputs=self.inputs, hidden=(cell.arm.width,), seed=cell.seed)
        unscaled = alone([1.0] * len(self.system.joints))
        # the batch was prepared for it: the physics may have further states
        return unscaled if train is None else alone(_accelerations(unscaled, train))


def run_cell(task: Task, cell: Cell) -> CellResult:
    """Train and test one cell.

    Raises:
        KeyboardInterrupt: the user stopped the training; nothing of the cell is kept.
    """
    start, split, options = time.perf_counter(), task.split(cell.seed), replace(task.options, seed=cell.seed)
    if cell.arm.residual == BLACK_BOX:
        options = replace(options, price=0.0)
    by_name = {record.name: record for record in task.dataset}

    def batch(system: System, names: tuple[str, ...]) -> Batch:
        return batch_of(task.dataset, system, [by_name[n] for n in names], task.signal_share)

    system = task.model(cell, batch(task.model(cell), split.train))
    train, validation, everything = (
        batch(system, names) for names in (split.train, split.validation, tuple(by_name))
    )
    history = History()
    if cell.arm.residual == NONE:
        found = fit_physics(system, train, task.engine, options)
        engine = replace(task.engine, substeps=found.engine.substeps, gradient="backprop")
        engine = engine.stable(found.system, train, _theta(found.system, train))
        rungs = [_rung(task, found.system, engine, train, everything, torch.inf, found.status)]
        chosen, best = 0, found.system
    else:
        result = train_hybrid(
            system, train, validation, engine=task.engine, options=options, writer=history,
            spread=correlated_errors,
        )  # fmt: skip
        if result.interrupted:
            raise KeyboardInterrupt
        rungs = [_of_ladder(task, result, k, train, everything) for k in range(len(result.models))]
        chosen, best = result.chosen, result.system
        if cell.arm.residual == BLACK_BOX:  # its first rung, a constant acceleration, is no arm of its own
            rungs, chosen, best = rungs[-1:], 0, result.models[-1].system
    steps = [step for step, _ in history.history.get("loss/train", [])]
    # a network alone that stands for an arm has no description that a model file could name
    described = best.tree is not None or best.name in SKELETON
    return CellResult(
        cell, DONE, "", split, tuple(rungs), chosen, max(steps, default=0), time.perf_counter() - start,
        history.history, describe_model(best) if described else {},
    )  # fmt: skip


def _of_ladder(task: Task, result: HybridResult, k: int, train: Batch, everything: Batch) -> Rung:
    """One rung of a training's ladder, tested."""
    of = result.models[k]
    names = [info.name for info in of.system.table if info.spec.estimate]
    rung = _rung(
        task, of.system, result.engine, train, everything, result.price if k else torch.inf, of.status
    )
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
        short = weighted_errors(system, engine, windows[0])
    roles = network_roles(system, engine, train) if price < torch.inf else ()
    most = max(roles, key=lambda role: role.share, default=None)
    share, overlap = (0.0, 0.0) if most is None else (most.share, most.overlap)
    return Rung(price, weighted_errors(system, engine, everything), short, values, {}, share, overlap, status)


def _theta(system: System, batch: Batch) -> torch.Tensor:
    return system.theta().detach()[:, None].expand(-1, batch.rows)


def _accelerations(system: System, batch: Batch) -> list[float]:
    """RMS of each motor's measured acceleration [rad/s^2]."""
    dt, found = batch.dt[:, :-1], []
    for joint in system.joints:
        speed = batch.x[:, :, joint.positions[0] + 1]
        found.append(float((speed.diff(dim=1)[dt > 0] / dt[dt > 0]).square().mean().sqrt()) or 1.0)
    return found


def run_cells(
    task: Task, cells: Sequence[Cell], *, jobs: int = 1, scheduler: str | None = None
) -> Iterator[CellResult]:
    """Compute cells, each as soon as it is done; one that breaks is a result that says so, and the rest goes on.

    Args:
        task: what they share.
        cells: which ones.
        jobs: processes on this machine.
        scheduler: address of an existing Dask cluster, which is taken instead.

    Raises:
        InputError: nobody answers at the address, or Dask is not installed.
    """
    for number, result in fan_out(run_cell, task, cells, jobs=jobs, scheduler=scheduler):
        yield CellResult(cells[number], FAILED, result.message) if isinstance(result, Failure) else result


def key_of(task: Task, cell: Cell, program: str = __version__) -> str:
    """Digest of all that decides a cell: records, model, settings, and the program that computes it."""
    settings = (
        program, cell, task.split(cell.seed), task.engine, replace(task.options, seed=0), task.inputs,
        task.memory, task.lipschitz, task.horizon, task.signal_share, digest_of(task.system), task.dataset.digest,
    )  # fmt: skip
    return hashlib.sha256(repr(settings).encode()).hexdigest()


def save_cell(folder: Path, result: CellResult, key: str) -> None:
    """Write a cell's folder under a temporary name and rename it, so that it is whole or not there."""
    place = folder / result.cell.name
    with hidden_beside(place) as temporary:
        new = temporary / "new"
        new.mkdir()
        (new / CELL).write_text(json.dumps(sealed(asdict(result), key)), encoding="utf-8")
        if result.model:
            write_yaml(new / MODEL, result.model)
        if place.exists():
            place.replace(temporary / "old")
        new.replace(place)


def load_cell(folder: Path, cell: Cell, key: str) -> CellResult | None:
    """The cell that an earlier run has kept; None where there is none, or one of other settings or edited."""
    try:
        kept = unsealed(folder / cell.name / CELL, key)
        return None if kept is None else from_plain(kept)
    except ValueError:
        return None
