"""An ablation: arms trained and tested on the same records by a plan, one cell for each arm in each repeat."""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from fnmatch import fnmatchcase
from functools import partial
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator

from hybrid_id import __version__
from hybrid_id.components.residual import ResidualNetwork
from hybrid_id.errors import InputError, listed
from hybrid_id.identification.adjoint import Snapshot
from hybrid_id.identification.hybrid import HybridOptions, fit_physics, train_hybrid
from hybrid_id.identification.keep import digest_of
from hybrid_id.identification.networks import with_memory
from hybrid_id.identification.windows import measured_windows
from hybrid_id.records.dataset import Dataset
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.solvers import OdeEngine
from hybrid_id.study.hybrid import correlated_errors, network_roles
from hybrid_id.study.many import each_kept
from hybrid_id.study.replay import batch_of, weighted_errors
from hybrid_id.study.training import scalars
from hybrid_id.systems.builders import black_box
from hybrid_id.systems.by_joint import numbered
from hybrid_id.systems.chain import System
from hybrid_id.systems.model_file import SKELETON, describe_model

NONE, STATIC, MEMORY, BLACK_BOX = "none", "static", "memory", "black box"
OWN, ALL = "own", "all"
LONGEST_NAME = 120
"""Characters of a cell's folder before its seed: a file system takes names of 255."""
# JSON holds neither infinite numbers nor NaN: both are null in a file
Infinite = Annotated[float, BeforeValidator(lambda value: math.inf if value is None else value)]
Unknown = Annotated[float, BeforeValidator(lambda value: math.nan if value is None else value)]


@dataclass(frozen=True)
class Arm:
    """One way to model the records.

    Attributes:
        residual: none, static, memory or black box.
        places: where its networks act, joints numbered or named as the robot does; empty without a residual network.
        width: neurons of the hidden layer; 0 without a network.
        without: components and parameters that are taken out of the physics on purpose.
        reads: own, so that each network is one of its joint alone, or all: angle and speed of every other joint, too.
    """

    residual: str = NONE
    places: tuple[str, ...] = ()
    width: int = 0
    without: tuple[str, ...] = ()
    reads: str = OWN

    @property
    def name(self) -> str:
        """Its name in tables and folders."""
        if self.residual == BLACK_BOX:
            return f"network alone, {self.width} wide"
        words = "physics only"
        if self.residual != NONE:
            words = f"{self.residual} network at {' and '.join(self.places)}, {self.width} wide"
            words += ", reading all joints" if self.reads == ALL else ""
        return f"{words}, without {' and '.join(self.without)}" if self.without else words

    @property
    def label(self) -> str:
        """Its name in short, for rows of tables and axes."""
        words = "physics only" if self.residual == NONE else f"{self.residual} {self.width}"
        words = f"network alone {self.width}" if self.residual == BLACK_BOX else words
        words += f" at {', '.join(self.places)}" if self.places else ""
        words += ", reads all joints" if self.reads == ALL else ""
        taken = ", ".join(name.rpartition("/")[2] for name in self.without)
        return f"{words}\nwithout {taken}" if taken else words

    @property
    def hybrid(self) -> bool:
        """Whether a network stands beside physics."""
        return self.residual in (STATIC, MEMORY)


@dataclass(frozen=True)
class Split:
    """Names of the records of one repeat; the same for all of its arms.

    Attributes:
        train, validation, test: to train on, to end and choose a training, and to compare the arms.
        beyond: out of the range of all others, tested apart.
    """

    train: tuple[str, ...]
    validation: tuple[str, ...]
    test: tuple[str, ...]
    beyond: tuple[str, ...]

    @property
    def overlap(self) -> float:
        """Records tested on over records that the training works with, validation among them.

        See :func:`hybrid_id.statistics.variation.paired_difference`.
        """
        return len(self.test) / (len(self.train) + len(self.validation))


@dataclass(frozen=True)
class Cell:
    """One arm in one repeat; the unit that is computed, kept and resumed."""

    arm: Arm
    seed: int
    split: Split

    @property
    def name(self) -> str:
        """Its name as that of a folder; a long one ends in a digest of what is cut off."""
        words = "".join(c if c.isalnum() or c in "._" else "-" for c in self.arm.name)
        words = "-".join(filter(None, words.split("-")))
        if len(words) > LONGEST_NAME:
            words = f"{words[:LONGEST_NAME]}-{hashlib.sha256(self.arm.name.encode()).hexdigest()[:8]}"
        return f"{words}-seed-{self.seed}"


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

    def error(self, records: Sequence[str], *, short: bool = False) -> float:
        """RMS of the errors over those of some records that are known; nan of none."""
        errors = self.short if short else self.errors
        square = [errors[name] ** 2 for name in records if name in errors]
        return math.sqrt(sum(square) / len(square)) if square else math.nan


@dataclass(frozen=True)
class CellResult:
    """What a cell came to, as plain data.

    Attributes:
        cell: which one.
        rungs: models by price, physics alone first; a cell of physics only has one, and so has a network alone.
        chosen: number of the rung that the validation records chose.
        seconds: that it took.
        history: of the training by tag, (gradient, value) each.
        model: the chosen model as a model file holds it; empty of a network alone that no model file can hold.
    """

    cell: Cell
    rungs: tuple[Rung, ...]
    chosen: int
    seconds: float
    history: dict[str, list[tuple[int, Unknown]]]
    model: dict[str, Any]

    @property
    def best(self) -> Rung:
        """The chosen rung."""
        return self.rungs[self.chosen]


def arms(
    *,
    residuals: Sequence[str] = (STATIC, MEMORY),
    places: Sequence[tuple[str, ...]] = (("joint1/motor",),),
    widths: Sequence[int] = (8,),
    reads: Sequence[str] = (OWN,),
    physics: Sequence[tuple[str, ...]] = (),
    black_box: int | None = 16,
) -> list[Arm]:
    """Every combination, physics only first, the network alone last.

    Args:
        residuals: kinds of residual networks, static or memory; physics only is always there.
        places: of the networks, one or several at a time.
        widths: neurons of the one hidden layer.
        reads: own or all: whether a network knows its own joint alone.
        physics: what is taken out on purpose; the whole model is always there.
        black_box: neurons of the network that stands alone; None leaves this arm out.
    """
    found = []
    for without in dict.fromkeys(((), *physics)):
        found.append(Arm(without=without))
        for residual, where, width, read in product(residuals, places, widths, reads):
            found.append(Arm(residual, where, width, without, read))
    return found + ([] if black_box is None else [Arm(BLACK_BOX, (), black_box)])


def split_records(
    dataset: Dataset, seed: int, *, validation: float = 0.2, test: float = 0.2, beyond: Sequence[str] = ()
) -> Split:
    """Whole records drawn by a seed: an experiment is never divided between training and test.

    Records of role test test in every repeat, and those of role validation validate; only where there is none of a
    role, a share is drawn anew.

    Args:
        dataset: the records.
        seed: of the draw.
        validation: share of the drawn records, at least one record.
        test: the same.
        beyond: patterns of names or notes of records that are out of range.

    Raises:
        InputError: a pattern that fits no record, or too few records.
    """
    apart = records_beyond(dataset, beyond)
    tests = [r.name for r in dataset.test if r.name not in apart]
    drawn = [r.name for r in dataset.train if r.name not in apart]
    drawn = [drawn[k] for k in np.random.default_rng(seed).permutation(len(drawn))]
    n_validation, n_test = (max(1, round(share * len(drawn))) for share in (validation, test))
    if not tests:
        tests, drawn = drawn[:n_test], drawn[n_test:]
    held, train = [r.name for r in dataset.validation if r.name not in apart], drawn
    if not held:
        held, train = drawn[:n_validation], drawn[n_validation:]
    if not train or not tests:
        raise InputError(
            f"Dataset '{dataset.name}' has too few records in range to train on {len(train)}, validate on "
            f"{len(held)} and test on {len(tests)}; an ablation needs at least one of each."
        )
    return Split(*(tuple(sorted(names)) for names in (train, held, tests, apart)))


def records_beyond(dataset: Dataset, patterns: Sequence[str]) -> list[str]:
    """Names of the records whose name or note fits one of the patterns; an InputError where one fits none."""
    for pattern in patterns:
        if not any(fnmatchcase(text, pattern) for r in dataset for text in (r.name, r.note)):
            raise InputError(
                f"Pattern '{pattern}' fits no name or note of dataset '{dataset.name}', which has "
                f"{listed(r.name for r in dataset)}; correct or remove it."
            )
    return [r.name for r in dataset if any(fnmatchcase(t, p) for p in patterns for t in (r.name, r.note))]


def without_parts(system: System, taken: Sequence[str]) -> System:
    """The physics that is left: components by key are gone, parameters by name are held at zero.

    Raises:
        InputError: a name that the model does not have, or a parameter that cannot be zero.
    """
    for name in taken:
        where, slash, kind = name.rpartition("/")
        if slash:
            system = system.without_component(numbered(system, where), kind)
            continue
        spec = system.parameter(name).spec
        if not spec.lower <= 0.0 <= spec.upper:
            raise InputError(f"{name} cannot be zero within its bounds; take its component out instead.")
        left = type(spec)(0.0, spec.lower, spec.upper, spec.unit, estimate=False)
        system = system.with_specs({name: left})
    return system


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
        horizon: length [s] of the short free runs from measured states.
    """

    dataset: Dataset
    system: System
    engine: OdeEngine
    options: HybridOptions
    inputs: tuple[str, ...]
    memory: int = 2
    lipschitz: float | None = None
    horizon: float = 0.2

    def model(self, arm: Arm, seed: int, train: Batch | None = None) -> System:
        """The model of an arm before its training; the network alone takes its scale from the batch."""
        if arm.residual == BLACK_BOX:
            alone = partial(black_box, self.system, inputs=self.inputs, hidden=(arm.width,), seed=seed)
            system, scales = alone([1.0] * len(self.system.joints)), []
            if train is None:
                return system
            # the batch was prepared for the network alone: the physics may have further states
            dt = train.dt[:, :-1]
            for joint in system.joints:
                speed = train.x[:, :, joint.positions[0] + 1]
                scales.append(float((speed.diff(dim=1)[dt > 0] / dt[dt > 0]).square().mean().sqrt()) or 1.0)
            return alone(scales)
        system = without_parts(self.system, arm.without)
        for where in arm.places:
            place, read = numbered(system, where), list(self.inputs)
            if arm.reads == ALL:
                others = [joint.number for joint in system.joints if not place.startswith(f"{joint.name}/")]
                read += [f"{signal}{number}" for number in others for signal in ("angle", "speed")]
            network = ResidualNetwork(
                inputs=tuple(dict.fromkeys(read)), hidden=(arm.width,), lipschitz=self.lipschitz, seed=seed,
                memory=self.memory if arm.residual == MEMORY else 0,
            )  # fmt: skip
            system = system.with_component(place, network)
        return system


class History:
    """Keeps the scalars of a training, where :class:`~hybrid_id.identification.adjoint.Writer` asks for a writer."""

    def __init__(self) -> None:
        self.history: dict[str, list[tuple[int, float]]] = {}

    def record(self, snapshot: Snapshot) -> None:
        """Take one snapshot."""
        (figures,) = scalars(snapshot, fits=False).values()
        for tag, value in figures.items():
            self.history.setdefault(tag, []).append((snapshot.step, value))


def run_cell(task: Task, cell: Cell) -> CellResult:
    """Train and test one cell, by the same functions as `train`.

    Raises:
        KeyboardInterrupt: the user stopped the training; nothing of the cell is kept.
    """
    start, arm, split, history = time.perf_counter(), cell.arm, cell.split, History()
    options, system = replace(task.options, seed=cell.seed), task.model(cell.arm, cell.seed)

    def batch(names: Sequence[str]) -> Batch:
        records = [task.dataset[name] for name in names]
        return batch_of(task.dataset, system, records)

    if arm.residual == BLACK_BOX:
        options, system = replace(options, price=0.0), task.model(arm, cell.seed, batch(split.train))
    train, everything = batch(split.train), batch([record.name for record in task.dataset])

    def tested(
        trained: System, engine: OdeEngine, price: float, status: str, errors: Sequence[float]
    ) -> Rung:
        estimated = [info for info in trained.table if info.spec.estimate]
        names = [info.name for info in estimated]
        theta = trained.theta().detach()[:, None].expand(-1, everything.rows)
        remembered = with_memory(trained, everything, theta)  # windows begin with memories in motion
        windows = measured_windows(trained, remembered, task.horizon)
        roles = network_roles(trained, engine, train) if price < math.inf else ()
        most = max(roles, key=lambda role: role.share, default=None)
        return Rung(
            price, weighted_errors(trained, engine, everything),
            {} if windows is None else weighted_errors(trained, engine, windows[0]),
            {info.name: info.spec.value for info in estimated}, dict(zip(names, errors, strict=False)),
            0.0 if most is None else most.share, 0.0 if most is None else most.overlap, status,
        )  # fmt: skip

    if arm.residual == NONE:
        fit = fit_physics(system, train, task.engine, options)
        engine = replace(task.engine, substeps=fit.engine.substeps, gradient="backprop")
        theta = fit.system.theta().detach()[:, None].expand(-1, train.rows)
        engine = engine.stable(fit.system, train, theta)
        rungs, chosen, best = [tested(fit.system, engine, math.inf, fit.status, ())], 0, fit.system
    else:
        result = train_hybrid(
            system, train, batch(split.validation), engine=task.engine, options=options, writer=history,
            spread=correlated_errors,
        )  # fmt: skip
        if result.interrupted:
            raise KeyboardInterrupt
        rungs = [
            tested(m.system, result.engine, result.price if k else math.inf, m.status, m.errors.tolist())
            for k, m in enumerate(result.models)
        ]
        chosen, best = result.chosen, result.system
        if arm.residual == BLACK_BOX:  # its first rung, a constant acceleration, is no arm of its own
            rungs, chosen, best = rungs[-1:], 0, result.models[-1].system
    # a network alone that stands for a robot has no description that a model file could name
    model = describe_model(best) if best.tree is not None or best.name in SKELETON else {}
    seconds = time.perf_counter() - start
    return CellResult(cell, tuple(rungs), chosen, seconds, history.history, model)


def run_cells(
    task: Task,
    cells: Sequence[Cell],
    files: Callable[[str], Path],
    *,
    program: str = __version__,
    **how: Any,
) -> tuple[list[CellResult], Mapping[str, str]]:
    """Compute cells, and keep each as soon as it is done; those of an earlier run are not computed again.

    Args:
        task: what they share.
        cells: which ones.
        files: where the result of a name is kept.
        program: what computes them, of which others' results are not taken.
        how: ``jobs``, ``scheduler`` and ``done`` of :func:`hybrid_id.study.many.each_kept`.

    Returns:
        The results of the cells that are done, and why others broke, by name.

    Raises:
        InputError: nobody answers at the address, or Dask is not installed.
    """
    decides = {field.name: getattr(task, field.name) for field in fields(task)}
    decides |= {
        "dataset": (task.dataset.digest, task.dataset.signal_share),
        "options": replace(task.options, seed=0),
    }
    shared = digest_of(decides)
    results, failed = each_kept(
        run_cell, task, {cell.name: cell for cell in cells}, kind=CellResult, files=files,
        key=lambda cell: (program, shared, cell), **how,
    )  # fmt: skip
    return list(results.values()), failed
