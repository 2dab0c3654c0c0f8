"""What a cell of an ablation comes to: plain data that a file and another machine can hold."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from typing import Any

from hybrid_id.identification.adjoint import Snapshot
from hybrid_id.plain import plain
from hybrid_id.study.ablation_plan import Arm, Cell, Split

FAILED, DONE = "failed", "done"


@dataclass(frozen=True)
class Rung:
    """A trained model at one price of its network's output; physics alone at an infinite one.

    Attributes:
        price: of the network's output.
        errors: RMS of the weighted error of the free run over each whole record, by record; 1 is the noise floor.
        short: the same of short free runs from measured states; empty where the records are too short.
        values, std_errors: of the estimated parameters by name.
        share: RMS of the network's output over that of the motor's torque; of the network with the largest.
        overlap: its overlap with the physics, see :class:`hybrid_id.study.network_role.NetworkRole`.
        status: how its training ended.
    """

    price: float
    errors: dict[str, float]
    short: dict[str, float]
    values: dict[str, float]
    std_errors: dict[str, float]
    share: float
    overlap: float
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
        history: course of the training by tag, (gradient, value) each.
        model: the chosen model as a model file holds it.
    """

    cell: Cell
    status: str = DONE
    message: str = ""
    split: Split | None = None
    rungs: tuple[Rung, ...] = ()
    chosen: int = 0
    gradients: int = 0
    seconds: float = 0.0
    history: dict[str, list[tuple[int, float]]] = field(default_factory=dict)
    model: dict[str, Any] = field(default_factory=dict)

    @property
    def best(self) -> Rung:
        """The chosen rung."""
        return self.rungs[self.chosen]


class Course:
    """Keeps the scalars of a training, where :class:`~hybrid_id.identification.adjoint.Writer` asks for a writer."""

    def __init__(self) -> None:
        self.history: dict[str, list[tuple[int, float]]] = {}

    def record(self, snapshot: Snapshot) -> None:
        """Take one snapshot."""
        scalars = {"loss/train": snapshot.train[0], "gradient/norm": snapshot.gradient_norm[0]}
        if snapshot.validation is not None:
            scalars["loss/validation"] = snapshot.validation[0]
        scalars |= dict(zip(snapshot.parameter_tags, snapshot.values[0], strict=True))
        for tag, value in (scalars | dict(snapshot.scalars)).items():
            self.history.setdefault(tag, []).append((snapshot.step, float(value)))


def as_plain(result: CellResult) -> dict[str, Any]:
    """A cell's result as JSON holds it; what is not finite becomes None."""
    return plain(asdict(result))


def from_plain(content: dict[str, Any]) -> CellResult:
    """The result that :func:`as_plain` made a mapping of; an error that is None was infinite."""
    arm, split = content["cell"]["arm"], content["split"]
    lists = {key: tuple(arm[key]) for key in ("places", "without")}
    values: dict[str, Any] = {"cell": Cell(Arm(**arm | lists), content["cell"]["seed"])}
    values["split"] = None if split is None else Split(**{key: tuple(names) for key, names in split.items()})
    values["rungs"] = tuple(_rung(rung) for rung in content["rungs"])
    values["history"] = {
        tag: [(step, math.nan if value is None else value) for step, value in course]
        for tag, course in content["history"].items()
    }
    return CellResult(**content | values)


def _rung(content: dict[str, Any]) -> Rung:
    values: dict[str, Any] = {"price": _infinite(content["price"])}
    for name in ("errors", "short", "std_errors"):
        values[name] = {key: _infinite(value) for key, value in content[name].items()}
    values |= {name: math.nan if content[name] is None else content[name] for name in ("share", "overlap")}
    return Rung(**content | values)


def _infinite(value: float | None) -> float:
    return math.inf if value is None else value
