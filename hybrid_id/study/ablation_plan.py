"""What an ablation compares: arms, repeats, and which records each repeat trains, validates and tests on."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np

from hybrid_id.components.residual import ResidualNetwork
from hybrid_id.errors import InputError, listed
from hybrid_id.records.dataset import Dataset
from hybrid_id.systems.by_joint import numbered
from hybrid_id.systems.chain import System

NONE, STATIC, MEMORY, BLACK_BOX = "none", "static", "memory", "black box"
OWN, ALL = "own", "all"
LONGEST_NAME = 120
"""Characters of a cell's folder before its seed: a file system takes names of 255."""


@dataclass(frozen=True)
class Arm:
    """One way to model the records.

    Attributes:
        residual: none, static, memory or black box.
        places: where its networks act, joints numbered or named as the robot does; empty without a residual network.
        width: neurons of the hidden layer; 0 without a network.
        reads: own, so that each network is one of its joint alone, or all: angle and speed of every other joint, too.
        without: components and parameters that are taken out of the physics on purpose.
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
class Cell:
    """One arm in one repeat; the unit that is computed, kept and resumed."""

    arm: Arm
    seed: int

    @property
    def name(self) -> str:
        """Its name as that of a folder; a long one ends in a digest of what is cut off."""
        words = "".join(c if c.isalnum() or c in "._" else "-" for c in self.arm.name)
        words = "-".join(filter(None, words.split("-")))
        if len(words) > LONGEST_NAME:
            words = f"{words[:LONGEST_NAME]}-{hashlib.sha256(self.arm.name.encode()).hexdigest()[:8]}"
        return f"{words}-seed-{self.seed}"


@dataclass(frozen=True)
class Factors:
    """What the arms differ in; every combination is an arm.

    Attributes:
        residuals: kinds of residual networks, static or memory; physics only is always there.
        places: of the networks, one or several at a time.
        widths: neurons of the one hidden layer.
        reads: own or all: whether a network knows its own joint alone.
        physics: what is taken out on purpose; an empty one is the whole model, which is always there.
        black_box: neurons of the network that stands alone; None leaves this arm out.
    """

    residuals: tuple[str, ...] = (STATIC, MEMORY)
    places: tuple[tuple[str, ...], ...] = (("joint1/motor",),)
    widths: tuple[int, ...] = (8,)
    physics: tuple[tuple[str, ...], ...] = ((),)
    black_box: int | None = 16
    reads: tuple[str, ...] = (OWN,)

    @property
    def arms(self) -> list[Arm]:
        """All arms: physics only first, the network alone last."""
        found = []
        for without in dict.fromkeys(((), *self.physics)):
            found.append(Arm(without=without))
            found += [
                Arm(residual, places, width, without, reads)
                for residual in self.residuals
                for places in self.places
                for width in self.widths
                for reads in self.reads
            ]
        return found + ([] if self.black_box is None else [Arm(BLACK_BOX, (), self.black_box)])


def plan(factors: Factors, seeds: Sequence[int]) -> list[Cell]:
    """All cells, repeat by repeat, so that what is done first can be compared."""
    return [Cell(arm, seed) for seed in seeds for arm in factors.arms]


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


def with_arm(
    system: System, arm: Arm, inputs: Sequence[str], memory: int, lipschitz: float | None, seed: int
) -> System:
    """The model of an arm that has physics; see :func:`hybrid_id.systems.builders.black_box` for the one without."""
    system = without_parts(system, arm.without)
    for where in arm.places:
        states, place = memory if arm.residual == MEMORY else 0, numbered(system, where)
        read = list(inputs)
        if arm.reads == ALL:
            others = [joint.number for joint in system.joints if not place.startswith(f"{joint.name}/")]
            read += [f"{signal}{number}" for number in others for signal in ("angle", "speed")]
        part = ResidualNetwork(
            inputs=tuple(dict.fromkeys(read)),
            hidden=(arm.width,),
            memory=states,
            lipschitz=lipschitz,
            seed=seed,
        )
        system = system.with_component(place, part)
    return system
