"""From logs to the channels of a dataset: every choice with its evidence, every doubt as a question."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from hybrid_id.errors import InputError
from hybrid_id.records.column_words import ColumnWords, read_name, tokens
from hybrid_id.records.logs import Log
from hybrid_id.records.proposal import (
    ANGLE_FACTORS,
    COUNTS,
    RELATED,
    SPEED_FACTORS,
    TIME_FACTORS,
    DriveFit,
    Guess,
    JointFacts,
    angle_unit,
    correlation,
    derivative_ratio,
    drive_fit,
    follows,
    is_time,
    rate_of,
    sampling,
    side_and_unit,
    sign_of,
    speed_unit,
    time_unit,
    wrap_period,
    zero_offset,
)
from hybrid_id.records.resample import MAX_GAP

INPUTS = ("voltage", "duty", "current", "torque", "goal")
"""Quantities that can drive a joint, in the order in which they are preferred."""
STEMS = {"voltage": "u", "duty": "duty", "current": "i", "torque": "tau", "goal": "goal", "supply": "supply",
         "gain": "gain", "enable": "enable"}  # fmt: skip
DUTY_TOPS = (1.0, 100.0, 255.0, 885.0, 1000.0, 1023.0, 4095.0)
"""Numbers that stand for full duty."""
PERCENT = 100.5
"""Largest value of an angle that may be percent of a joint's range."""
SUPPLY = 12.0
"""Supply voltage [V] that stands in where none is known."""
BEYOND = {"V": 200.0, "A": 100.0}
"""Voltage and current that no drive's log exceeds: larger numbers without a unit are thousandths."""
LONGEST_GAP = 20.0
"""Missing samples, in median steps, up to which a gap is bridged and beyond which a record is cut."""
MOST_LOGS = 8
"""Logs from which evidence is taken; all are records."""


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


@dataclass
class Chosen:
    """One channel of the dataset.

    Attributes:
        name: of the channel, ``q_m1``.
        column: in the files.
        unit: as `dataset.yaml` shall have it.
        scale: beside it.
        factor: of the column to SI, sign included.
        unwrap: period by which the column jumps; 0 where it does not.
        guesses: what was concluded about it.
    """

    name: str
    column: str
    unit: str
    scale: float = 1.0
    factor: float = 1.0
    unwrap: float = 0.0
    guesses: list[Guess] = field(default_factory=list)

    def values(self, log: Log) -> np.ndarray:
        """Values in SI, (T,)."""
        found = log.columns[self.column]
        return self.factor * (np.unwrap(found, period=self.unwrap) if self.unwrap else found)

    def turn(self) -> None:
        """Turn the sign."""
        self.scale, self.factor = -self.scale, -self.factor


@dataclass(frozen=True)
class Question:
    """What cannot be told from the logs: the words, and the line that would answer it, where there is one."""

    words: str
    line: str = ""
    place: str = "dataset"


@dataclass
class DriveFacts:
    """What the logs say of one joint's drive, for its model.

    Attributes:
        joint: the robot's name of it, or what the columns call it.
        number: of its channels.
        command: a member of ``INPUTS``, or ``position_loop`` where the loop's gain and the supply are logged too.
        side: ``m`` where the angle is the motor's, ``a`` where it is the link's.
        fit: of the acceleration, in SI; of a goal, to the goal's distance from the angle.
        unsigned: whether a current is logged without its sign.
        offset: zero of the angle that the robot's range asks for [rad]; 0 where none is.
        side_known: whether a sheet has settled the side.
    """

    joint: str
    number: int
    command: str
    side: str = "m"
    fit: DriveFit | None = None
    unsigned: bool = False
    offset: float = 0.0
    side_known: bool = False


@dataclass
class Proposal:
    """A dataset that could be made of the logs."""

    time: Chosen
    logs: list[Log]
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
    def all_guesses(self) -> list[tuple[str, Guess]]:
        """Every guess, with the column that it is about or an empty string."""
        channels = [self.time, *self.inputs, *self.outputs]
        found = [(channel.column, guess) for channel in channels for guess in channel.guesses]
        return [*found, *(("", guess) for guess in self.guesses)]


def propose(
    logs: Sequence[Log], joints: Sequence[JointFacts] = (), sheet: MotorSheet | None = None
) -> Proposal:
    """Choose time, inputs and outputs among the columns of logs.

    Args:
        logs: with columns of the same names.
        joints: of the robot, in its file's order; empty without one.
        sheet: of the motor.

    Raises:
        InputError: there is no usable pair of an input and an output, or no column of time.
    """
    sheet = sheet or MotorSheet()
    names = [joint.name for joint in joints]
    words = {name: read_name(name, names) for name in logs[0].columns}
    time = _time(logs, words)
    proposal = Proposal(time, list(logs))
    proposal.left += [(name, why) for name, why in logs[0].left.items()]
    clock = {id(log): time.factor * log.columns[time.column] for log in logs}
    work = _Work(list(logs[:MOST_LOGS]), clock, words, sheet, proposal)
    groups = _groups(words, time.column, work)
    placed = _place(groups, joints, proposal)
    for key, joint, number in placed:
        work.joint(key, groups[key], joint, number)
    if not proposal.drives:
        raise InputError(_no_pair(logs[0], proposal))
    _one_numbering(proposal, joints)
    used = {one.column for one in (time, *proposal.inputs, *proposal.outputs)} | {n for n, _ in proposal.left}
    proposal.left += [(name, "not needed, or not understood") for name in words if name not in used]
    found = sampling([clock[id(log)] for log in logs])
    proposal.resample = found.value == "resample"
    proposal.guesses.append(found)
    _gaps(proposal, [clock[id(log)] for log in logs])
    if any(guess.about == "unit of time" and not guess.sure for guess in time.guesses):
        evidence = next(guess.evidence for guess in time.guesses if guess.about == "unit of time")
        work.ask(
            f"Is the unit of '{time.column}' {time.unit}? {evidence}.",
            f"t: {{column: {time.column}, unit: ...}}",
        )
    return proposal


def _gaps(proposal: Proposal, times: Sequence[np.ndarray]) -> None:
    """Bridge short gaps by resampling, and cut records at long ones; both are said and asked about."""
    for k, (log, time) in enumerate(zip(proposal.logs, times, strict=True)):
        steps = np.diff(time) / np.median(np.diff(time))
        longest = float(steps.max())
        if longest > LONGEST_GAP:
            cuts = np.flatnonzero(steps > LONGEST_GAP) + 1
            parts = np.split(np.arange(time.size), cuts)
            part = max(parts, key=len)
            proposal.between[k] = float(time[part[0]]), float(time[part[-1]])
            words = (
                f"samples are missing for {longest:.3g} steps; the longest part without such a gap is kept"
            )
            proposal.guesses.append(
                Guess(f"part of {log.file.title}", f"{time[part[0]]:.6g} to {time[part[-1]]:.6g} s", words)
            )
            longest = float(np.max(steps[part[:-1]], initial=1.0))
        if longest > MAX_GAP and proposal.resample:
            proposal.max_gap = max(proposal.max_gap, float(math.ceil(longest + 1.0)))
    if proposal.max_gap:
        words = f"the longest gap that is bridged is below {proposal.max_gap:g} median steps"
        proposal.guesses.append(Guess("gaps", f"max_gap {proposal.max_gap:g}", words, False))
        proposal.questions.append(
            Question(
                f"May gaps of up to {proposal.max_gap:g} steps be bridged by interpolation? Else cut the records there "
                "with 'between'."
            )
        )


def _no_pair(log: Log, proposal: Proposal) -> str:
    shown = ", ".join(list(log.columns)[:12]) + (", ..." if len(log.columns) > 12 else "")
    why = "; ".join(f"{name}: {reason}" for name, reason in proposal.left[:3])
    return (
        f"{log.file.path} has no usable pair of an input (voltage, duty, current, torque, goal) and an angle or speed "
        f"(columns are {shown}{'; ' + why if why else ''}); rename the columns after what they hold, or write "
        "dataset.yaml by hand as docs/records.md shows"
    )


def _time(logs: Sequence[Log], words: Mapping[str, ColumnWords]) -> Chosen:
    """The column of time and its unit."""
    first = logs[0]
    if first.clock:
        guess = Guess("time", first.clock, "stamps of the topic with the angles, in seconds")
        return Chosen("t", first.clock, "s", guesses=[guess])
    fits = [name for name in words if all(is_time(log.columns[name]) for log in logs)]
    if first.file.file_format == "lerobot" and "t" in fits:
        return Chosen("t", "t", "s", guesses=[Guess("time", "t", "frame_index / fps of the LeRobot dataset")])
    named = [name for name in fits if words[name].kind == "time"]
    named.sort(key=lambda name: (name not in ("t", "time"), words[name].counter))
    other = [name for name in fits if not words[name].kind and not words[name].counter]
    numbered = [name for name in fits if name.isdigit()]
    if not (column := next(iter([*named, *other, *numbered]), None)):
        raise InputError(
            f"{first.file.path} has no column of time: none of {', '.join(list(words)[:12])} increases in even steps; "
            "log the time of each sample"
        )
    why = "its name, and it increases in even steps" if column in named else "it increases in even steps"
    guess = time_unit(first.columns[column], words[column].unit)
    time = Chosen("t", column, guess.value, guesses=[Guess("time", column, why, column in named), guess])
    time.factor = TIME_FACTORS[guess.value]
    if guess.value == "ns":
        time.unit, time.scale = "s", 1e-9
    return time


def _groups(words: Mapping[str, ColumnWords], time: str, work: _Work) -> dict[str, list[ColumnWords]]:
    """Columns by joint, in the order in which the joints are met."""
    groups: dict[str, list[ColumnWords]] = {}
    for name, one in words.items():
        if name != time and one.kind != "time" and not (one.counter and not one.kind):
            groups.setdefault(one.joint, []).append(one)
    keys = [key for key in groups if any(work.moves(one.name) for one in groups[key])]
    common = groups.pop("", [])
    named = [key for key in keys if key and any(_is_output(one) for one in groups[key])]
    if not named:  # one joint, whatever its columns are called
        return {"": [*common, *(one for some in groups.values() for one in some)]}
    if len(named) == 1:
        others = [one for key in groups if key not in named for one in groups[key]]
        return {named[0]: [*groups[named[0]], *common, *others]}
    loose = [key for key in groups if key.isdigit() and key not in named]
    if loose and not any(name.isdigit() for name in named) and len(loose) == len(named):
        for key, name in zip(sorted(loose, key=int), named, strict=True):
            groups[name] += groups.pop(key)
        work.ask(
            f"The elements {', '.join(loose)} of the command have no names; they are taken in the order of the joints: "
            f"{', '.join(named)}. Is that their order?"
        )
    for key in named:
        groups[key] += common
    return {key: some for key, some in groups.items() if key in named}


def _is_output(one: ColumnWords) -> bool:
    """Whether a column's name makes it an angle or a speed, or the measured state of a joint."""
    return not one.command and (one.kind in ("angle", "speed") or (not one.kind and one.measured))


def _place(
    groups: Mapping[str, Sequence[ColumnWords]], joints: Sequence[JointFacts], proposal: Proposal
) -> list[tuple[str, JointFacts | None, int]]:
    """Key of the columns, the robot's joint and its number, of each joint that is logged."""
    keys = list(groups)
    if not joints:
        if all(re.search(r"\d+$", key) for key in keys):
            keys.sort(key=lambda key: int(re.findall(r"\d+$", key)[0]))
        return [(key, None, number) for number, key in enumerate(keys, 1)]
    by_name = {joint.name: joint for joint in joints}
    numbers = [int(found[0]) for key in keys if (found := re.findall(r"\d+$", key))]
    first, found = min(numbers, default=1), []
    for key in keys:
        if key in by_name:
            found.append((key, by_name[key]))
            words = f"its name stands in the names of the columns ({key})"
            proposal.guesses.append(Guess("joint", key, words))
            continue
        digits = re.findall(r"\d+$", key)
        place = int(digits[0]) - min(first, 1) if digits else 0 if len(keys) == 1 else -1
        same = [joint for joint in joints if digits and tokens(joint.name)[-1:] == digits]
        joint = same[0] if len(same) == 1 else joints[place] if 0 <= place < len(joints) else None
        if joint is None or joint in [one for _, one in found]:
            proposal.left += [(one.name, "no joint of the robot is called so") for one in groups[key]]
            proposal.questions.append(Question(f"Which joint of the robot are the columns of '{key}'?"))
            continue
        sure = len(joints) == 1
        found.append((key, joint))
        words = (
            f"columns of '{key}' by their number" if digits else "the columns name no joint: the first one"
        )
        proposal.guesses.append(Guess("joint", joint.name, words, sure))
        if not sure:
            proposal.questions.append(Question(f"Are the columns of '{key}' those of joint {joint.name}?"))
    order = [joint for joint in joints if joint in [one for _, one in found]]
    return sorted(((key, joint, order.index(joint) + 1) for key, joint in found), key=lambda item: item[2])


def _one_numbering(proposal: Proposal, joints: Sequence[JointFacts]) -> None:
    """Number the joints that have a pair in the robot's order; without a robot, keep the first alone."""
    order = sorted({drive.number for drive in proposal.drives})
    if not joints and len(order) > 1:
        others = [drive.joint for drive in proposal.drives if drive.number != order[0]]
        proposal.questions.append(
            Question(
                f"The logs hold {len(order)} joints, and no robot is given: the model is of "
                f"'{proposal.drives[0].joint}' alone, the others ({', '.join(others)}) are left out. "
                "Give --robot with the MJCF or URDF for all; "
                "one joint alone is right only if the others stood still."
            )
        )
        for group in (proposal.inputs, proposal.outputs):
            gone = [one for one in group if not re.fullmatch(rf"\D+{order[0]}", one.name)]
            proposal.left += [(one.column, f"{one.name}, of a joint that is left out") for one in gone]
            group[:] = [one for one in group if one not in gone]
        proposal.drives[:] = [drive for drive in proposal.drives if drive.number == order[0]]
        order = order[:1]
    new = {old: k for k, old in enumerate(order, 1)}
    for one in (*proposal.inputs, *proposal.outputs):
        stem, digits = re.fullmatch(r"(\D+)(\d+)", one.name).groups()  # type: ignore[union-attr]
        one.name = f"{stem}{new[int(digits)]}"
    for drive in proposal.drives:
        drive.number = new[drive.number]
    logged = {drive.joint for drive in proposal.drives}
    proposal.held = [joint.name for joint in joints if joint.name not in logged]


@dataclass
class _Work:
    """What the choice for one joint after the other works with."""

    logs: list[Log]
    clock: Mapping[int, np.ndarray]
    words: Mapping[str, ColumnWords]
    sheet: MotorSheet
    proposal: Proposal

    def ask(self, words: str, line: str = "", place: str = "dataset") -> None:
        self.proposal.questions.append(Question(words, line, place))

    def leave(self, column: str, why: str) -> None:
        if column not in [name for name, _ in self.proposal.left]:
            self.proposal.left.append((column, why))

    def moves(self, column: str) -> bool:
        return any(np.ptp(log.columns[column]) > 0 for log in self.logs)

    def far(self, column: str) -> float:
        return max(float(np.max(np.abs(log.columns[column]))) for log in self.logs)

    def longest(self) -> Log:
        return max(self.logs, key=lambda log: self.clock[id(log)].size)

    def liveliest(self, column: str) -> Log:
        """The log in which a column moves most, over all of its samples."""
        return max(
            self.logs, key=lambda log: float(np.std(log.columns[column])) * log.columns[column].size ** 0.5
        )

    def time(self, log: Log) -> np.ndarray:
        return self.clock[id(log)]

    def joint(self, key: str, columns: Sequence[ColumnWords], joint: JointFacts | None, number: int) -> None:
        """Choose the channels of one joint; where a pair is missing, its columns are left out and it is said."""
        columns = [one for one in columns if not self._still(one)]
        kinds = self._kinds(columns)
        angle = self._first(kinds, "angle")
        speed = self._first(kinds, "speed")
        title = joint.name if joint is not None else key or "the drive"
        command = next((kind for kind in INPUTS if self._drives(kinds.get(kind, []), kind, kinds)), None)
        if command is None or not (angle or speed):
            missing = "no input" if command is None else "no angle and no speed"
            for one in columns:
                self.leave(one.name, f"of {title}, for which there is {missing}")
            if joint is not None or key:
                self.ask(
                    f"Joint '{title}' has {missing} in the logs, and is left out. Is there one under another name?"
                )
            return
        column = self._drives(kinds[command], command, kinds)
        assert column is not None
        proposal = self.proposal
        drive = DriveFacts(title, number, command)
        side = self._side(angle or speed, drive)
        outputs: list[Chosen] = []
        if angle is not None:
            chosen = self._angle(angle, f"q_{side}{number}", joint, speed)
            outputs.append(chosen)
        if speed is not None:
            outputs += self._speed(speed, f"v_{side}{number}", outputs[0] if outputs else None)
        inputs = self._inputs(column, command, number, kinds, drive, outputs, joint)
        self._sign(inputs, outputs, drive, joint)
        if joint is None and angle is not None:
            self._by_sheet(inputs, outputs, drive, bool(angle.side))
        if joint is not None and angle is not None:
            self._zero(outputs[0], inputs[0], drive, joint)
        outputs += self._measured(kinds, number, drive, inputs[0], outputs)
        taken = {one.column for one in (*inputs, *outputs)}
        for one in columns:
            if one.name not in taken:
                reason = "no channel that a drive of this kind has, or a second one of its kind"
                self.leave(one.name, f"{kinds_of(kinds, one)} of {title}: {reason}")
        proposal.inputs += inputs
        proposal.outputs += outputs
        proposal.drives.append(drive)

    def _still(self, one: ColumnWords) -> bool:
        if self.moves(one.name) or one.kind in ("supply", "gain", "enable"):
            return False
        self.leave(one.name, "stands still in all logs")
        return True

    def _kinds(self, columns: Sequence[ColumnWords]) -> dict[str, list[ColumnWords]]:
        """Columns by quantity; a commanded angle is a goal, and what a name leaves open is seen from the values."""
        kinds: dict[str, list[ColumnWords]] = {}
        open_ones = []
        for one in columns:
            kind = one.kind
            if kind == "angle" and one.command:
                kind = "goal"
            elif kind == "speed" and one.command:
                self.leave(one.name, "a commanded speed, which no drive here takes as its input")
                continue
            if kind:
                kinds.setdefault(kind, []).append(one)
            else:
                open_ones.append(one)
        self._by_content(kinds, open_ones)
        return kinds

    def _by_content(self, kinds: dict[str, list[ColumnWords]], open_ones: list[ColumnWords]) -> None:
        """Place columns whose names say nothing."""
        log = self.longest()
        time = self.time(log)

        def take(one: ColumnWords, kind: str, why: str, sure: bool = False) -> None:
            kinds.setdefault(kind, []).append(one)
            open_ones.remove(one)
            self.proposal.guesses.append(Guess(f"column {one.name}", kind, why, sure))
            if not sure:
                self.ask(f"Is the column '{one.name}' the {kind}? ({why})")

        if not self._first(kinds, "angle"):
            measured = [one for one in open_ones if one.measured and not one.command]
            if len(measured) == 1 and log.file.file_format == "lerobot":
                take(measured[0], "angle", "the state of a LeRobot dataset", True)
        if not self._first(kinds, "angle"):
            free = [*open_ones, *kinds.get("speed", [])]
            pairs = [
                (abs(derivative_ratio(time, log.columns[a.name], log.columns[v.name])[1]), a, v)
                for a in open_ones
                for v in free
                if a is not v and not a.command
            ]
            if pairs and (best := max(pairs, key=lambda pair: pair[0]))[0] > RELATED:
                related, a, v = best
                take(a, "angle", f"smooth, and its derivative correlates by {related:.3f} with '{v.name}'")
                if v in open_ones:
                    take(v, "speed", f"the derivative of '{a.name}' correlates by {related:.3f} with it")
        if not self._first(kinds, "angle") and not self._first(kinds, "speed") and len(open_ones) > 1:
            silent = [one for one in open_ones if not one.command]
            rough = {one.name: _roughness(log.columns[one.name]) for one in silent}
            if silent and len(silent) + any(kinds.get(kind) for kind in INPUTS) >= 2:
                smooth = min(silent, key=lambda one: rough[one.name])
                take(
                    smooth,
                    "angle",
                    f"the smoothest column: steps of {rough[smooth.name]:.2g} of its deviation",
                )
        angle = self._first(kinds, "angle")
        for one in [one for one in open_ones if one.speed_or_voltage]:
            if angle is None:
                take(one, "voltage", "a bare v without an angle")
                continue
            related = derivative_ratio(time, log.columns[angle.name], log.columns[one.name])[1]
            kind = "speed" if abs(related) > RELATED else "voltage"
            words = f"v, whose correlation with the derivative of '{angle.name}' is {related:+.2f}"
            take(one, kind, words, abs(related) > RELATED or abs(related) < 0.7)
        commands = [one for one in open_ones if one.command]
        if not commands and not any(kinds.get(kind) for kind in INPUTS) and len(open_ones) == 1:
            commands = list(open_ones)
        if commands:
            self._command(self._best_command(commands, angle), angle, kinds, take)

    def _best_command(self, commands: Sequence[ColumnWords], angle: ColumnWords | None) -> ColumnWords:
        """Of several commands without a quantity the one that the acceleration follows best."""
        if len(commands) == 1 or angle is None:
            return commands[0]
        log = self.liveliest(angle.name)
        fits = {
            one.name: drive_fit(self.time(log), log.columns[one.name], log.columns[angle.name])
            for one in commands
        }
        shares = {name: abs(fit.partial) if fit else 0.0 for name, fit in fits.items()}
        best = max(commands, key=lambda one: shares[one.name])
        listed = ", ".join(
            f"{name} {share:.3f}" for name, share in sorted(shares.items(), key=lambda item: -item[1])
        )
        self.ask(f"Is '{best.name}' what acts on the drive? Correlations with the change of speed: {listed}.")
        return best

    def _command(
        self, one: ColumnWords, angle: ColumnWords | None, kinds: Mapping[str, object], take: object
    ) -> None:
        """See whether a command without a quantity is a goal, a duty or a voltage."""
        assert callable(take)
        log = self.liveliest(one.name)
        values, far = log.columns[one.name], self.far(one.name)
        if angle is not None:
            q = log.columns[angle.name]
            related = follows(self.time(log), values, q)
            alike = 0.3 < np.ptp(values) / max(np.ptp(q), 1e-300) < 3.0
            if abs(related) > RELATED and alike:
                words = f"a command that '{angle.name}' follows: correlation {related:+.3f}, spans alike"
                take(one, "goal", words, bool(related > 0.97))
                return
        if far <= 1.0001:
            take(one, "duty", f"a command within -1 and 1 (up to {far:.3g})")
        else:
            take(one, "voltage", f"a command up to {far:.3g} that the angle does not follow")

    def _first(self, kinds: Mapping[str, Sequence[ColumnWords]], kind: str) -> ColumnWords | None:
        """The column of a quantity that is taken where there are several: measured, at the motor, named shortest."""
        some = [one for one in kinds.get(kind, ()) if self.moves(one.name)]
        some.sort(key=lambda one: (one.command, one.side == "link", not one.measured, len(one.name)))
        return some[0] if some else None

    def _drives(
        self, some: Sequence[ColumnWords], kind: str, kinds: Mapping[str, Sequence[ColumnWords]]
    ) -> ColumnWords | None:
        """The column of a quantity that can be the input, commanded before unmarked; measured ones are none."""
        moving = [one for one in some if self.moves(one.name)]
        if kind in ("current", "torque"):
            others = any(self._drives(kinds.get(k, []), k, kinds) for k in ("voltage", "duty", "goal"))
            moving = [one for one in moving if one.command or not (one.measured or others)]
        moving.sort(key=lambda one: (not one.command, one.measured, len(one.name)))
        return moving[0] if moving else None

    def _side(self, column: ColumnWords | None, drive: DriveFacts) -> str:
        assert column is not None
        drive.side = "a" if column.side == "link" else "m"
        return drive.side

    def _angle(
        self, column: ColumnWords, name: str, joint: JointFacts | None, speed: ColumnWords | None
    ) -> Chosen:
        values = [log.columns[column.name] for log in self.logs]
        times = [self.time(log) for log in self.logs]
        counts = self.sheet.counts_per_turn or 0.0
        early = column.unit if column.unit in (*ANGLE_FACTORS, "counts") else "deg"
        period = (
            wrap_period(values, early, counts)
            or wrap_period(values, "rad")
            or wrap_period(values, "counts", counts)
        )
        if period:
            values = [np.unwrap(one, period=period) for one in values]
        ratio = 0.0
        if speed is not None:
            log = self.liveliest(column.name)
            q = np.unwrap(log.columns[column.name], period=period) if period else log.columns[column.name]
            found, related = derivative_ratio(self.time(log), q, log.columns[speed.name])
            ratio = found if abs(related) > RELATED else 0.0
        guess = angle_unit(
            values, times, f"unit of {name}", column.unit, joint, ratio, speed.unit if speed else "", counts
        )
        chosen = Chosen(name, column.name, guess.value, guesses=[self._why(name, column, "angle"), guess])
        self._scale_angle(chosen, guess.value)
        if period:
            chosen.unwrap = period
            chosen.guesses.append(Guess(f"turns of {name}", f"unwrap {period:g}", "it jumps by a whole turn"))
        if not guess.sure:
            self._ask_unit(chosen, guess)
        elif (
            self.logs[0].file.file_format == "lerobot"
            and guess.value == "deg"
            and self.far(column.name) <= PERCENT
        ):
            self.ask(
                f"Is '{column.name}' in degrees, or in percent of the joint's range, as LeRobot records by default? "
                f"It is taken in degrees, for it stays within {PERCENT:g}; percent needs the scale of that joint.",
                f"{name}: {{column: {column.name}, scale: ...}}",
            )
        return chosen

    def _ask_unit(self, chosen: Chosen, guess: Guess) -> None:
        entry = f"{chosen.name}: {{column: {chosen.column}, unit: ..., scale: ...}}"
        self.ask(
            f"In which unit is '{chosen.column}'? It is taken as {guess.value}: {guess.evidence}.", entry
        )

    def _scale_angle(self, chosen: Chosen, unit: str) -> None:
        if unit == "counts":
            counts = self.sheet.counts_per_turn or COUNTS
            chosen.unit, chosen.scale = "rad", 2 * math.pi / counts
            chosen.factor = chosen.scale
            chosen.guesses.append(
                Guess(
                    f"scale of {chosen.name}",
                    f"{chosen.scale:.6g}",
                    f"2 pi / {counts:g} counts a turn"
                    + ("" if self.sheet.counts_per_turn else ", the usual 12 bits"),
                    bool(self.sheet.counts_per_turn),
                )
            )
            if not self.sheet.counts_per_turn:
                self.ask(
                    f"How many counts has a turn of '{chosen.column}'? {COUNTS} are assumed "
                    "(counts_per_turn in --motor)."
                )
        elif unit in ("m", "mm"):
            chosen.factor = 1.0 if unit == "m" else 1e-3
        else:
            chosen.factor = ANGLE_FACTORS[unit]

    def _speed(self, column: ColumnWords, name: str, angle: Chosen | None) -> list[Chosen]:
        log = self.liveliest(column.name)
        if angle is None:
            unit = column.unit if column.unit in SPEED_FACTORS else "rad/s"
            guess = Guess(
                f"unit of {name}", unit, "its name says so" if column.unit else "assumed", bool(column.unit)
            )
            chosen = Chosen(name, column.name, unit, factor=SPEED_FACTORS[unit])
            chosen.guesses += [self._why(name, column, "speed"), guess]
            if not guess.sure:
                self._ask_unit(chosen, guess)
            return [chosen]
        q = angle.values(log) / angle.factor
        ratio, related = derivative_ratio(self.time(log), q, log.columns[column.name])
        if abs(related) < RELATED:
            self.leave(column.name, f"a speed that does not match the angle (correlation {related:+.2f})")
            self.ask(
                f"Is '{column.name}' the speed of this joint? It does not match '{angle.column}' ({related:+.2f})."
            )
            return []
        rate = np.gradient(q, self.time(log))
        backward = np.diff(q, prepend=q[0]) / np.median(np.diff(self.time(log)))
        copies = [correlation(one, ratio * log.columns[column.name]) for one in (rate, backward)]
        if max(copies) > 1.0 - 1e-9:
            self.leave(
                column.name, "computed from the angle (a difference of its samples), so it tells nothing new"
            )
            self.proposal.guesses.append(
                Guess(
                    f"column {column.name}",
                    "left out",
                    "it is the difference of the angle's samples, sample by sample",
                )
            )
            return []
        guess = speed_unit(ratio, abs(angle.factor), f"unit of {name}", column.unit)
        if not guess.sure:
            self.leave(column.name, f"a speed in no usual unit ({guess.evidence})")
            self.ask(
                f"In which unit is the speed '{column.name}'? {guess.evidence}.", f"{name}: {column.name}"
            )
            return []
        chosen = Chosen(name, column.name, guess.value, factor=SPEED_FACTORS[guess.value])
        chosen.guesses += [self._why(name, column, "speed"), guess]
        if ratio < 0:
            chosen.turn()
            words = f"opposed to the derivative of '{angle.column}' (correlation {related:+.2f})"
            chosen.guesses.append(Guess(f"sign of {name}", "-1", words))
        return [chosen]

    def _why(self, name: str, column: ColumnWords, kind: str) -> Guess:
        how = f"its name: {kind}" if column.kind else f"its values: {kind}"
        command = ", commanded" if column.command else ", measured" if column.measured else ""
        return Guess(name, column.name, f"{how}{command}", bool(column.kind))

    def _inputs(
        self,
        column: ColumnWords,
        command: str,
        number: int,
        kinds: Mapping[str, Sequence[ColumnWords]],
        drive: DriveFacts,
        outputs: Sequence[Chosen],
        joint: JointFacts | None,
    ) -> list[Chosen]:
        """The command, with what its drive needs besides."""
        name = f"{STEMS[command]}{number}"
        chosen = Chosen(name, column.name, "", guesses=[self._why(name, column, command)])
        if command == "goal":
            self._goal(chosen, column, outputs, joint)
        elif command == "voltage":
            self._simple(chosen, column, *self._volts_or_amps(column, "V"), bool(column.unit))
            if column.measured:
                self.ask(
                    f"'{column.name}' is taken as the commanded voltage, though its name says measured. Is it?"
                )
        elif command == "current":
            self._simple(chosen, column, *self._volts_or_amps(column, "A"), bool(column.unit))
            if not column.command:
                self.ask(
                    f"Is '{column.name}' the commanded current? As a measured one beside a voltage it belongs to the "
                    "outputs; log the command, too."
                )
        elif command == "torque":
            milli = column.unit == "mN m"
            slide = joint is not None and joint.slide
            unit = "mN m" if milli else "N" if slide else "N m"
            self._simple(chosen, column, unit, 1e-3 if milli else 1.0, bool(column.unit))
            if not column.command:
                self.ask(
                    f"Is '{column.name}' the commanded torque, and in N m? Servos log a load or a current so."
                )
        else:
            return self._duty(chosen, column, number, kinds, drive)
        inputs = [chosen]
        if command == "goal" and kinds.get("gain") and kinds.get("supply"):
            drive.command = "position_loop"
            for kind, unit in (("gain", "1"), ("supply", "V")):
                other = kinds[kind][0]
                one = Chosen(f"{kind}{number}", other.name, unit)
                one.guesses.append(self._why(one.name, other, kind))
                inputs.append(one)
        return inputs

    def _volts_or_amps(self, column: ColumnWords, unit: str) -> tuple[str, float]:
        """Unit of a voltage or a current, and its factor: thousandths by the name, or by values beyond any drive's."""
        milli = column.unit == f"m{unit}" or (not column.unit and self.far(column.name) > BEYOND[unit])
        return (f"m{unit}", 1e-3) if milli else (unit, 1.0)

    def _simple(self, chosen: Chosen, column: ColumnWords, unit: str, factor: float, said: bool) -> None:
        chosen.unit, chosen.factor = unit, factor
        words = "its name says so" if said else f"values up to {self.far(column.name):.3g}, none in its name"
        chosen.guesses.append(Guess(f"unit of {chosen.name}", unit, words, said))

    def _goal(
        self, chosen: Chosen, column: ColumnWords, outputs: Sequence[Chosen], joint: JointFacts | None
    ) -> None:
        """A goal is in its angle's unit, unless its name says otherwise or its span contradicts."""
        angle = next((one for one in outputs if one.name.startswith("q_")), None)
        unit = column.unit if column.unit in (*ANGLE_FACTORS, "counts") else ""
        if unit or angle is None:
            guess = Guess(
                f"unit of {chosen.name}", unit or "rad", "its name says so" if unit else "assumed", bool(unit)
            )
            chosen.guesses.append(guess)
            chosen.unit = guess.value
            self._scale_angle(chosen, guess.value)
            return
        log = self.liveliest(angle.column)
        spans = np.ptp(log.columns[column.name]) / max(np.ptp(angle.values(log) / abs(angle.factor)), 1e-300)
        near = 0.3 < spans < 3.0
        words = f"the unit of '{angle.column}', whose span is {1 / max(spans, 1e-9):.2g} of it"
        chosen.unit, chosen.scale, chosen.factor = angle.unit, abs(angle.scale), abs(angle.factor)
        chosen.guesses.append(Guess(f"unit of {chosen.name}", angle.unit, words, near))
        if not near:
            self.ask(f"In which unit is the goal '{column.name}'? It is taken in {angle.unit}: {words}.")

    def _duty(
        self,
        chosen: Chosen,
        column: ColumnWords,
        number: int,
        kinds: Mapping[str, Sequence[ColumnWords]],
        drive: DriveFacts,
    ) -> list[Chosen]:
        """A duty with a logged supply stays one; with a constant supply it is a voltage."""
        far = self.far(column.name)
        top = next((top for top in DUTY_TOPS if far <= 1.001 * top), far)
        words = f"values up to {far:.4g}: {top:g} is full duty"
        sure = top in (1.0, 100.0)
        if not sure:
            self.ask(
                f"Which value of '{column.name}' is full duty? {top:g} is assumed, for it goes up to {far:.4g}."
            )
        supply = kinds.get("supply")
        if supply:
            chosen.unit, chosen.scale = ("%", 1.0) if top == 100.0 else ("1", 1.0 / top)
            chosen.factor = 1.0 / top
            chosen.guesses.append(Guess(f"unit of {chosen.name}", chosen.unit, words, sure))
            column = supply[0]
            unit, factor = self._volts_or_amps(column, "V")
            other = Chosen(f"supply{number}", column.name, unit, factor=factor)
            other.guesses.append(self._why(other.name, column, "supply"))
            return [chosen, other]
        volts = self.sheet.voltage or SUPPLY
        drive.command = "voltage"
        chosen.name, chosen.unit, chosen.scale = f"u{number}", "V", volts / top
        chosen.factor = chosen.scale
        given = "of the motor's sheet" if self.sheet.voltage else "a placeholder"
        chosen.guesses.append(
            Guess(f"unit of {chosen.name}", f"{volts:g} V / {top:g}", f"{words}; {volts:g} V {given}", False)
        )
        if not self.sheet.voltage:
            self.ask(
                f"What is the supply voltage behind the duty '{column.name}'? {volts:g} V stand in its scale; another "
                "one changes P_m1 and P_m2 alone. Give voltage in --motor, or log it."
            )
        return [chosen]

    def _sign(
        self, inputs: Sequence[Chosen], outputs: Sequence[Chosen], drive: DriveFacts, joint: JointFacts | None
    ) -> None:
        """Turn the angle where command and response are opposed, and fit the drive."""
        command, output = inputs[0], outputs[0]
        speed = output.name.startswith("v_")
        if drive.command in ("goal", "position_loop"):
            log = self.liveliest(output.column)
            related = follows(self.time(log), command.values(log), output.values(log))
            words = f"correlation of the goal with the angle: {related:+.2f}"
            sure = abs(related) > 0.5
            guess = Guess(f"sign of {output.name}", "-1" if sure and related < 0 else "1", words, sure)
        else:
            guess = sign_of(self._fit(inputs, output, drive), command.name, output.name)
        opposed = guess.value == "-1"
        if not guess.sure:
            self.ask(
                f"Does a positive '{command.column}' turn '{output.column}' the positive way? ({guess.evidence})"
            )
        if not opposed:
            output.guesses.append(guess)
        else:
            turned = list(outputs)
            words = guess.evidence
            if joint is not None and not speed:
                fits = [
                    zero_offset([output.values(log) * way for log in self.logs], 1.0, joint, "") is None
                    for way in (1.0, -1.0)
                ]
                if fits == [True, False]:
                    turned, words = (
                        [command],
                        f"{words}; turned, the angle would leave the range of {joint.name}",
                    )
                elif fits == [True, True]:
                    self.ask(
                        f"'{command.column}' and '{output.column}' are opposed. The angle is turned; if it has the "
                        "sign of the robot's file, turn the command instead (scale: -1)"
                    )
            for one in turned:
                one.turn()
            turned[0].guesses.append(Guess(f"sign of {turned[0].name}", "-1", words))
        drive.fit = self._fit(inputs, output, drive)

    def _fit(self, inputs: Sequence[Chosen], output: Chosen, drive: DriveFacts) -> DriveFit | None:
        fits = []
        for log in self.logs:
            command = inputs[0].values(log)
            if drive.command == "duty" and len(inputs) > 1:
                command = command * inputs[1].values(log)
            angle = output.values(log)
            if drive.command in ("goal", "position_loop"):
                command = command - angle
            fits.append(drive_fit(self.time(log), command, angle, speed=output.name.startswith("v_")))
        fits = sorted((fit for fit in fits if fit is not None), key=lambda fit: fit.partial)
        return fits[len(fits) // 2] if fits else None

    def _by_sheet(
        self, inputs: Sequence[Chosen], outputs: Sequence[Chosen], drive: DriveFacts, side_said: bool
    ) -> None:
        """Settle the unit of the angle and its side of the gear by the sheet's back-EMF constant."""
        constant = self.sheet.back_emf_constant or self.sheet.torque_constant
        ratio = self.sheet.gear_ratio if isinstance(self.sheet.gear_ratio, int | float) else 1.0
        angle = outputs[0]
        if constant is None or drive.command != "voltage" or angle.unit not in ANGLE_FACTORS:
            return
        about = f"unit of {angle.name}"
        unsure = any(guess.about == about and not guess.sure for guess in angle.guesses)
        units = ("rad", "deg", "rev") if unsure else (angle.unit,)
        found = side_and_unit(drive.fit, ANGLE_FACTORS[angle.unit], constant, ratio, units)
        if found is None or (side_said and found[0] != drive.side):
            return
        side, unit, words = found
        if unsure:
            angle.factor *= ANGLE_FACTORS[unit] / ANGLE_FACTORS[angle.unit]
            angle.unit = unit
            angle.guesses = [guess for guess in angle.guesses if guess.about != about]
            angle.guesses.append(Guess(about, unit, words))
            start = f"In which unit is '{angle.column}'"
            self.proposal.questions[:] = [q for q in self.proposal.questions if not q.words.startswith(start)]
        drive.side = side
        drive.side_known = True
        for one in outputs:
            one.name = re.sub(r"_[ma](?=\d)", f"_{side}", one.name)
            one.guesses = [replace(g, about=re.sub(r"_[ma](?=\d)", f"_{side}", g.about)) for g in one.guesses]
        angle.guesses.append(Guess("side of the gear", "motor" if side == "m" else "link", words))
        drive.fit = self._fit(inputs, angle, drive)

    def _zero(self, angle: Chosen, command: Chosen, drive: DriveFacts, joint: JointFacts) -> None:
        values = [angle.values(log) for log in self.logs]
        guess = zero_offset(values, 1.0, joint, f"zero of {angle.name}")
        if guess is None:
            words = f"all angles lie in the range of {joint.name}"
            if math.isfinite(joint.range):
                angle.guesses.append(Guess(f"zero of {angle.name}", "0", words))
            return
        angle.guesses.append(guess)
        drive.offset = float(guess.value)
        both = (
            f"; the goal '{command.column}' has the same zero, which no key of the files corrects"
            if drive.command == "goal"
            else ""
        )
        self.ask(
            f"Where is the robot's zero of {joint.name} in '{angle.column}'? {guess.evidence}{both}. Correct the "
            "columns in the log, or the sensor's offset in model.yaml.",
        )

    def _measured(
        self,
        kinds: Mapping[str, Sequence[ColumnWords]],
        number: int,
        drive: DriveFacts,
        command: Chosen,
        outputs: Sequence[Chosen],
    ) -> list[Chosen]:
        """A measured current is an output beside a commanded voltage."""
        some = [
            one for one in kinds.get("current", ()) if self.moves(one.name) and one.name != command.column
        ]
        if drive.command not in ("voltage", "duty") or not some:
            return []
        column = min(some, key=lambda one: (one.command, not one.measured, len(one.name)))
        unit, factor = self._volts_or_amps(column, "A")
        chosen = Chosen(f"i{number}", column.name, unit, factor=factor)
        chosen.guesses.append(self._why(chosen.name, column, "current"))
        words = "its name says so" if column.unit else f"values up to {self.far(column.name):.3g}"
        chosen.guesses.append(Guess(f"unit of {chosen.name}", chosen.unit, words, bool(column.unit)))
        log = self.liveliest(outputs[0].column)
        i, u = chosen.values(log), command.values(log)
        related = correlation(i, u)
        angle = outputs[0].values(log)
        speed = angle if outputs[0].name.startswith("v_") else rate_of(self.time(log), angle)
        columns = np.stack([u, speed, np.sign(u)], axis=1)
        gain = float(np.linalg.lstsq(columns / np.std(columns, axis=0).clip(1e-12), i, rcond=None)[0][0])
        if i.min() >= -0.02 * i.max() and u.min() < -0.1 * u.max():
            drive.unsigned = True
            chosen.guesses.append(
                Guess(f"sign of {chosen.name}", "none", "never negative while the command is")
            )
        elif gain < 0 and related < -0.2:
            chosen.turn()
            words = f"opposed to the command (correlation {related:+.2f})"
            chosen.guesses.append(Guess(f"sign of {chosen.name}", "-1", words))
        return [chosen]


def kinds_of(kinds: Mapping[str, Sequence[ColumnWords]], one: ColumnWords) -> str:
    """The quantity that a column was taken for."""
    return next((kind for kind, some in kinds.items() if one in some), "a column")


def _roughness(values: np.ndarray) -> float:
    """Standard deviation of the steps over that of the values."""
    return float(np.std(np.diff(values))) / max(float(np.std(values)), 1e-300)
