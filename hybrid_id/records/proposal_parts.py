"""What a proposal for logs is made of: channels, facts of a drive, questions, and the logs that give the evidence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from hybrid_id.records.column_words import ColumnWords
from hybrid_id.records.logs import Log
from hybrid_id.records.proposal import DriveFit, Guess


class MotorSheet(BaseModel):
    """What a data sheet says of the drive, in SI units and at the motor's shaft; all of it may be left out.

    Attributes:
        gear_ratio: turns of the motor for one of the joint; a list gives one number a joint.
        torque_constant: [N m/A].
        back_emf_constant: [V s/rad].
        resistance: of the winding [ohm].
        inertia: of the rotor [kg m^2].
        voltage: of the supply [V].
        counts_per_turn: of the encoder.
        servo: sts3215 or xl330_m288.
        p: register P of that servo.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    gear_ratio: float | list[float] | None = None
    torque_constant: float | None = Field(default=None, gt=0)
    back_emf_constant: float | None = Field(default=None, gt=0)
    resistance: float | None = Field(default=None, gt=0)
    inertia: float | None = Field(default=None, gt=0)
    voltage: float | None = Field(default=None, gt=0)
    counts_per_turn: float | None = Field(default=None, gt=0)
    servo: str | None = None
    p: float | None = Field(default=None, gt=0)

    def ratio(self, number: int) -> float:
        """Gear ratio of the joint of a number; 1 where the sheet has none."""
        given = self.gear_ratio
        if isinstance(given, list):
            given = given[number - 1] if number <= len(given) else None
        return given or 1.0


@dataclass
class Chosen:
    """One channel of the dataset.

    Attributes:
        name: of the channel, ``q_m1``.
        column: in the files.
        unit: as `dataset.yaml` shall have it.
        scale: beside it.
        factor: of the column to SI, sign included.
        zero: the column's number where the channel is 0.
        unwrap: period by which the column jumps; 0 where it does not.
        guesses: what was concluded about it.
    """

    name: str
    column: str
    unit: str
    scale: float = 1.0
    factor: float = 1.0
    zero: float = 0.0
    unwrap: float = 0.0
    guesses: list[Guess] = field(default_factory=list)

    def values(self, log: Log) -> np.ndarray:
        """Values in SI, (T,)."""
        found = log.columns[self.column]
        return self.factor * ((np.unwrap(found, period=self.unwrap) if self.unwrap else found) - self.zero)

    def turn(self) -> None:
        """Turn the sign."""
        self.scale, self.factor = -self.scale, -self.factor


@dataclass(frozen=True)
class Question:
    """What the logs do not say: the words, and the line that would answer it, where there is one.

    Where the words are those of a ``pattern`` with ``columns`` in the place of ``{}``, both are kept.
    """

    words: str
    line: str = ""
    place: str = "dataset"
    pattern: str = ""
    columns: tuple[str, ...] = ()


@dataclass
class DriveFacts:
    """What the logs say of one joint's drive, for its model.

    Attributes:
        joint: the robot's name of it, or what the columns call it.
        number: of its channels.
        command: a member of ``INPUTS``, or ``position_loop`` where the loop's gain and the supply are logged too.
        side: ``m`` where the angle is the motor's, ``a`` where it is the link's.
        fit: of the acceleration, in SI; of a goal, to the goal's distance from the angle.
        lag: of the angle behind its goal in steady motion [s]; 0 where it is open.
        unsigned: whether a current is logged without its sign.
    """

    joint: str
    number: int
    command: str
    side: str = "m"
    fit: DriveFit | None = None
    lag: float = 0.0
    unsigned: bool = False


@dataclass
class Proposal:
    """A dataset that could be made of the logs; ``roles`` and ``logs`` go together."""

    time: Chosen
    logs: list[Log]
    roles: list[str] = field(default_factory=list)
    inputs: list[Chosen] = field(default_factory=list)
    outputs: list[Chosen] = field(default_factory=list)
    drives: list[DriveFacts] = field(default_factory=list)
    held: list[str] = field(default_factory=list)
    left: list[tuple[str, str]] = field(default_factory=list)
    resample: bool = False
    max_gap: float = 0.0
    between: dict[int, tuple[float, float]] = field(default_factory=dict)
    guesses: list[Guess] = field(default_factory=list)
    questions: list[Question] = field(default_factory=list)

    @property
    def all_guesses(self) -> list[Guess]:
        """Every guess, those about channels first."""
        channels = [self.time, *self.inputs, *self.outputs]
        return [guess for channel in channels for guess in channel.guesses] + self.guesses


@dataclass
class Evidence:
    """All logs on one clock, and what is concluded from them.

    Attributes:
        logs: every one of them.
        clock: stamps [s] of each log, by ``id``.
        words: what the name of each column says.
        sheet: of the motor.
        proposal: takes what is concluded.
        stops: by the place of a log, joint and farthest angle [rad] beyond its limits, and where it is there, (T,).
    """

    logs: Sequence[Log]
    clock: Mapping[int, np.ndarray]
    words: Mapping[str, ColumnWords]
    sheet: MotorSheet
    proposal: Proposal
    stops: dict[int, list[tuple[str, np.ndarray]]] = field(default_factory=dict)

    def ask(self, words: str, line: str = "") -> None:
        """Leave a question."""
        self.proposal.questions.append(Question(words, line))

    def ask_of(self, column: str, pattern: str) -> None:
        """Leave a question about a column, in the place of ``{}``; the same one of several columns is one question."""
        questions = self.proposal.questions
        same = next((k for k, one in enumerate(questions) if one.pattern == pattern), len(questions))
        columns = (*(questions[same].columns if same < len(questions) else ()), column)
        words = pattern.format(", ".join(f"'{one}'" for one in columns))
        questions[same : same + 1] = [Question(words, pattern=pattern, columns=columns)]

    def leave(self, column: str, why: str) -> None:
        """Leave a column out."""
        if column not in [name for name, _ in self.proposal.left]:
            self.proposal.left.append((column, why))

    def moves(self, column: str) -> bool:
        """Whether a column changes in any log."""
        return any(np.ptp(log.columns[column]) > 0 for log in self.logs)

    def far(self, column: str) -> float:
        """Largest size of a column's values."""
        return max(float(np.max(np.abs(log.columns[column]))) for log in self.logs)

    def span(self, column: str) -> float:
        """How far a column's values go over all logs."""
        return float(np.ptp(np.concatenate([log.columns[column] for log in self.logs])))

    def mean(self, column: str) -> float:
        """Mean of a column's values over all logs."""
        return float(np.concatenate([log.columns[column] for log in self.logs]).mean())

    def longest(self) -> Log:
        """The log of most samples."""
        return max(self.logs, key=lambda log: self.time(log).size)

    def liveliest(self, column: str, most: int = 1) -> list[Log]:
        """The logs in which a column moves most, over all of its samples."""
        moved = {
            id(log): float(np.std(log.columns[column])) * log.columns[column].size ** 0.5 for log in self.logs
        }
        return sorted(self.logs, key=lambda log: -moved[id(log)])[:most]

    def time(self, log: Log) -> np.ndarray:
        """Stamps [s] of a log, (T,)."""
        return self.clock[id(log)]

    def first(self, kinds: Mapping[str, Sequence[ColumnWords]], kind: str) -> ColumnWords | None:
        """The column of a quantity that is taken where there are several: measured, at the motor, named shortest."""
        some = [one for one in kinds.get(kind, ()) if self.moves(one.name)]
        some.sort(key=lambda one: (one.command, one.side == "link", not one.measured, len(one.name)))
        return some[0] if some else None
