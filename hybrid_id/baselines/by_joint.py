"""What a baseline for single machines takes a robot for: its joints one by one, the others as they were measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hybrid_id.errors import InputError
from hybrid_id.records.dataset import Dataset
from hybrid_id.systems.by_joint import (
    joint_parts,
    joints_to_diagnose,
    named,
    some,
    with_drive,
    with_others_measured,
)
from hybrid_id.systems.chain import System


@dataclass(frozen=True, eq=False)
class Part:
    """A joint of a robot by itself, or the whole of another machine.

    Attributes:
        dataset: its records.
        system: its nominal model.
        joint: its name; empty of a whole machine.
    """

    dataset: Dataset
    system: System
    joint: str = ""

    def placed(self, where: str) -> str:
        """A place as the whole has it."""
        return named(self.system, where)


def parts_of(dataset: Dataset, system: System) -> list[Part]:
    """The joints of a robot that can be taken by themselves; a machine without a tree as it is.

    Raises:
        InputError: no joint can.
    """
    if system.tree is None:
        return [Part(dataset, system)]
    names, skipped = joints_to_diagnose(dataset, system)
    if not names:
        raise InputError(f"No joint can be taken by itself ({'; '.join(skipped.values())}).")
    numbers = joint_parts(system)
    return [
        Part(with_others_measured(dataset, system, *numbers[n]), some(system, numbers[n]), n) for n in names
    ]


def joined(whole: System, models: Sequence[System]) -> System:
    """A robot with the drives of models of its parts; the model itself of a machine without a tree."""
    if whole.tree is None:
        return models[0]
    for one in models:
        whole = with_drive(whole, one)
    return whole
