"""The channels of one joint: its angle and speed, its command, their units, signs, zeros and side of the gear."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hybrid_id.records.column_words import ColumnWords, tokens
from hybrid_id.records.logs import Log
from hybrid_id.records.proposal import (
    ANGLE_FACTORS,
    COUNTS,
    RELATED,
    SPEED_FACTORS,
    DriveFit,
    Guess,
    JointFacts,
    angle_unit,
    beyond_limits,
    correlation,
    counted_unit,
    derivative_ratio,
    drive_fit,
    encoder_bits,
    follows,
    goal_lag,
    goal_unit,
    rate_of,
    side_and_unit,
    side_by_range,
    sign_of,
    speed_unit,
    wrap_period,
    zero_by_goal,
    zero_offset,
)
from hybrid_id.records.proposal_parts import Chosen, DriveFacts, Evidence
from hybrid_id.records.units import to_si

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
RESTS = 0.05
"""Span of a joint's angle, relative to its size, up to which a joint whose goal stands still does, too."""
BEYOND = {"V": 200.0, "A": 100.0}
"""Voltage and current that no drive's log exceeds: larger numbers without a unit are thousandths."""
PARTS = {unit: to_si(unit, "tau")[1] for unit in ("mN m", "N cm")}
"""Units of a torque by their parts of a newton metre."""
FITTED = 8
"""Logs whose acceleration is fitted, those in which the joint moves most; of their fits the median is taken."""

Kinds = Mapping[str, Sequence[ColumnWords]]


@dataclass(frozen=True)
class Pair:
    """A joint that the logs drive and show: its command beside its angle, its speed or both.

    Attributes:
        title: what messages call it; empty where neither robot nor columns name it.
        joint: of the robot; None without one.
        columns: that may be its own, but for those that stand still.
        kinds: the columns by what they are.
        command: kind of its command.
        angle: its angle, if there is one.
        speed: its speed, if there is one.
    """

    title: str
    joint: JointFacts | None
    columns: Sequence[ColumnWords]
    kinds: Kinds
    command: str
    angle: ColumnWords | None
    speed: ColumnWords | None


def find_pair(
    title: str, columns: Sequence[ColumnWords], joint: JointFacts | None, evidence: Evidence
) -> Pair | None:
    """The command of a joint and its angle or speed; where one is missing, its columns are left out and it is said.

    Args:
        title: what messages call the joint; empty where neither robot nor columns name it.
        columns: that may be its own.
        joint: of the robot; None without one.
        evidence: takes what is left out, and questions.
    """
    if joint is not None and joint.tied:
        for one in columns:
            at = "" if one.command else _about(one, evidence)
            evidence.leave(one.name, f"of {title}, which is held because of {joint.tied}{at}")
        moving = [one for one in columns if one.kind == "angle" and not one.command and _goes(one, evidence)]
        if moving:
            name = moving[0].name
            evidence.ask(
                f"Does {title}, which moves in the logs ({name} goes through {evidence.span(name):.3g}), move little, "
                f"as a gripper does? It is held because of {joint.tied}: else take that out of the robot's file, or "
                "leave logs out in which it moves."
            )
        return None
    # whether the joint's goal stands still in all logs, and so does its angle, nearly
    goals = [one for one in columns if one.kind == "goal" or (one.command and one.kind in ("", "angle"))]
    angles = [one for one in columns if one.kind == "angle" and not one.command]
    rests = joint is not None and goals != [] and not any(_goes(one, evidence) for one in angles)
    rests = rests and not any(evidence.moves(one.name) for one in goals)
    moving = [one for one in columns if evidence.moves(one.name) or one.kind in ("supply", "gain", "enable")]
    for one in columns:
        if one not in moving:
            evidence.leave(one.name, "stands still in all logs")
    columns = moving
    kinds = _kinds_of(columns, evidence)
    angle, speed = evidence.first(kinds, "angle"), evidence.first(kinds, "speed")
    # a robot whose file has a position loop there is told where to go, whatever else its controller logs
    order = ("goal", *INPUTS) if joint is not None and joint.servo else INPUTS
    found = ((kind, _drives(kinds, kind, evidence)) for kind in order)
    reported = ("torque", "current") if rests else ()  # by a servo, which take no part in driving it
    command = next((kind for kind, one in found if one and (one.command or kind not in reported)), None)
    if command is None and rests:
        for one in columns:
            at = _about(one, evidence) if one is angle else ""
            evidence.leave(one.name, f"of {title}, which is held{at}: its goal stands still in all logs")
        return None
    if command is None or not (angle or speed):
        missing = "no input" if command is None else "no angle and no speed"
        for one in columns:
            evidence.leave(one.name, f"of {title or 'the drive'}, for which there is {missing}")
        if title:
            evidence.ask(
                f"Joint '{title}' has {missing} in the logs, and is left out. Is there one under another name?"
            )
        return None
    return Pair(title, joint, columns, kinds, command, angle, speed)


def _kinds_of(columns: Sequence[ColumnWords], evidence: Evidence) -> dict[str, list[ColumnWords]]:
    """Columns by quantity; a commanded angle is a goal, and what a name leaves open is seen from the values.

    Args:
        columns: of one joint.
        evidence: takes what is concluded and asked.
    """
    kinds: dict[str, list[ColumnWords]] = {}
    left: list[ColumnWords] = []  # whose names leave it open
    for one in columns:
        kind = "goal" if one.kind == "angle" and one.command else one.kind
        if kind == "speed" and one.command:
            evidence.leave(one.name, "a commanded speed, which no drive here takes as its input")
        elif kind:
            kinds.setdefault(kind, []).append(one)
        else:
            left.append(one)
    guesses, log = evidence.proposal.guesses, evidence.longest()
    time = evidence.time(log)

    def angle() -> ColumnWords | None:
        return evidence.first(kinds, "angle")

    def take(one: ColumnWords, kind: str, why: str, sure: bool = False) -> None:
        """Place a column; where that is not sure, ask."""
        kinds.setdefault(kind, []).append(one)
        left.remove(one)
        guesses.append(Guess(f"column {one.name}", kind, why, sure))
        if not sure:
            evidence.ask(f"Is the column '{one.name}' the {kind}? ({why})")

    # the one measured column of a joint in a LeRobot dataset is its angle
    measured = [one for one in left if one.measured and not one.command]
    if evidence.logs[0].file.file_format == "lerobot" and len(measured) == 1 and angle() is None:
        take(measured[0], "angle", "the state of a LeRobot dataset", True)
    # a column whose derivative is another one
    pairs = [
        (abs(derivative_ratio(time, log.columns[a.name], log.columns[v.name])[1]), a, v)
        for a in (left if angle() is None else ())
        for v in (*left, *kinds.get("speed", []))
        if a is not v and not a.command
    ]
    if pairs and (best := max(pairs, key=lambda pair: pair[0]))[0] > RELATED:
        related, a, v = best
        take(a, "angle", f"smooth, and its derivative correlates by {related:.3f} with '{v.name}'")
        if v in left:
            take(v, "speed", f"the derivative of '{a.name}' correlates by {related:.3f} with it")
    # of columns that say nothing the smoothest, where another one is left to be the command
    silent = [one for one in left if not one.command]
    others = len(silent) + any(kinds.get(kind) for kind in INPUTS) >= 2
    if silent and others and len(left) >= 2 and angle() is None and not evidence.first(kinds, "speed"):
        rough = {}  # standard deviation of the steps over that of the values
        for one in silent:
            values = log.columns[one.name]
            rough[one.name] = float(np.std(np.diff(values))) / max(float(np.std(values)), 1e-300)
        smooth = min(silent, key=lambda one: rough[one.name])
        take(smooth, "angle", f"the smoothest column: steps of {rough[smooth.name]:.2g} of its deviation")
    # a bare `v` is a speed where it is the angle's derivative, and else a voltage
    for one in [one for one in left if one.speed_or_voltage]:
        if (known := angle()) is None:
            take(one, "voltage", "a bare v without an angle")
            continue
        related = derivative_ratio(time, log.columns[known.name], log.columns[one.name])[1]
        kind = "speed" if abs(related) > RELATED else "voltage"
        words = f"v, whose correlation with the derivative of '{known.name}' is {related:+.2f}"
        take(one, kind, words, abs(related) > RELATED or abs(related) < 0.7)
    # a command without a quantity is a goal where the angle follows it, else a duty or a voltage
    commands = [one for one in left if one.command]
    if not commands and not any(kinds.get(kind) for kind in INPUTS) and len(left) == 1:
        commands = list(left)
    if commands:
        known = angle()
        one = commands[0] if len(commands) == 1 or known is None else _best_command(commands, known, evidence)
        (liveliest,) = evidence.liveliest(one.name)
        values, far, related = liveliest.columns[one.name], evidence.far(one.name), 0.0
        if known is not None:
            q = liveliest.columns[known.name]
            related = follows(evidence.time(liveliest), values, q)
            related = related if 0.3 < np.ptp(values) / max(np.ptp(q), 1e-300) < 3.0 else 0.0
        if known is not None and abs(related) > RELATED:
            words = f"a command that '{known.name}' follows: correlation {related:+.3f}, spans alike"
            take(one, "goal", words, bool(related > 0.97))
        elif far <= 1.0001:
            take(one, "duty", f"a command within -1 and 1 (up to {far:.3g})")
        else:
            take(one, "voltage", f"a command up to {far:.3g} that the angle does not follow")
    # a voltage beside a goal or a duty that never falls to half of its largest value is the supply's
    for one in list(kinds.get("voltage", []) if kinds.get("goal") or kinds.get("duty") else ()):
        if not one.command and evidence.span(one.name) < 0.5 * evidence.far(one.name):
            kinds["voltage"].remove(one)
            kinds.setdefault("supply", []).append(one)
            why = "a voltage that never falls to half of its largest value, beside a goal or a duty"
            guesses.append(Guess(f"column {one.name}", "supply", why, True))
    return kinds


def _best_command(commands: Sequence[ColumnWords], angle: ColumnWords, evidence: Evidence) -> ColumnWords:
    """Of several commands without a quantity the one that the acceleration follows best."""
    (log,) = evidence.liveliest(angle.name)
    time = evidence.time(log)
    fits = {one.name: drive_fit(time, log.columns[one.name], log.columns[angle.name]) for one in commands}
    shares = {name: abs(fit.partial) if fit else 0.0 for name, fit in fits.items()}
    best = max(commands, key=lambda one: shares[one.name])
    listed = ", ".join(
        f"{name} {share:.3f}" for name, share in sorted(shares.items(), key=lambda item: -item[1])
    )
    evidence.ask(f"Is '{best.name}' what acts on the drive? Correlations with the change of speed: {listed}.")
    return best


def _goes(one: ColumnWords, evidence: Evidence) -> bool:
    """Whether an angle goes through more than one that rests."""
    return evidence.span(one.name) > RESTS * evidence.far(one.name)


def _about(one: ColumnWords, evidence: Evidence) -> str:
    return f" ({one.name} is about {evidence.mean(one.name):.3g})"


def choose_channels(pair: Pair, number: int, evidence: Evidence) -> None:
    """Choose the channels of one joint.

    Args:
        pair: its command, and its angle or speed.
        number: of its channels, among the joints that have a pair.
        evidence: takes channels, guesses and questions.
    """
    drive = DriveFacts(pair.title or "the drive", number, pair.command)
    work = _Joint(evidence, pair.joint, pair.kinds, drive)
    work.choose(pair.angle, pair.speed)
    taken = {one.column for one in (*work.inputs, *work.outputs)}
    for one in pair.columns:
        if one.name not in taken:
            named = ((kind, some) for kind, some in pair.kinds.items() if one in some)
            kind, some = next(named, ("a column", ()))
            reason = f"nothing that a drive with a {pair.command} takes as it is"
            if any(other.name in taken for other in some):
                reason = f"a second {kind}"
            elif kind == "torque" and not one.command:
                reason = f"if a sensor at the link measures it, add it as the output tau_a{number}"
            evidence.leave(one.name, f"{kind} of {drive.joint}: {reason}")
    evidence.proposal.inputs += work.inputs
    evidence.proposal.outputs += work.outputs
    evidence.proposal.drives.append(drive)


def _drives(kinds: Kinds, kind: str, evidence: Evidence) -> ColumnWords | None:
    """The column of a quantity that can be the input, commanded before unmarked; measured ones are none."""
    moving = [one for one in kinds.get(kind, ()) if evidence.moves(one.name)]
    if kind in ("current", "torque"):
        others = any(_drives(kinds, other, evidence) for other in ("voltage", "duty", "goal"))
        moving = [one for one in moving if one.command or not (one.measured or others)]
    moving.sort(key=lambda one: (not one.command, one.measured, len(one.name)))
    return moving[0] if moving else None


def _why(name: str, column: ColumnWords, kind: str) -> Guess:
    how = f"its name: {kind}" if column.kind else f"its values: {kind}"
    command = ", commanded" if column.command else ", measured" if column.measured else ""
    return Guess(name, column.name, f"{how}{command}", bool(column.kind))


@dataclass
class _Joint:
    """One joint while its channels are chosen; outputs begin with the angle, inputs with the command."""

    evidence: Evidence
    joint: JointFacts | None
    kinds: Kinds
    drive: DriveFacts
    inputs: list[Chosen] = field(default_factory=list)
    outputs: list[Chosen] = field(default_factory=list)
    side_said: bool = False
    firm: bool = False
    """Whether the angle's name or its encoder's steps say its unit."""

    def choose(self, angle: ColumnWords | None, speed: ColumnWords | None) -> None:
        """Choose the channels in the order in which one is evidence for the next."""
        # with a gear, a name that says joint means the joint's side; without, both sides are one
        column = angle or speed
        assert column is not None
        at_joint = self.drive.command == "goal" if self.gear == 1.0 else "joint" in tokens(column.name)
        self.drive.side = "a" if column.side == "link" or (at_joint and not column.side) else "m"
        self.side_said = bool(column.side)
        if angle is not None:
            self._angle(angle, speed)
        if speed is not None:
            self._speed(speed)
        column = _drives(self.kinds, self.drive.command, self.evidence)
        assert column is not None
        # the command, with what its drive needs besides
        command, number, ask = self.drive.command, self.drive.number, self.evidence.ask
        name = f"{STEMS[command]}{number}"
        chosen = Chosen(name, column.name, "", guesses=[_why(name, column, command)])
        self.inputs.append(chosen)
        if command == "goal":
            self._goal(chosen, column)
        elif command == "voltage":
            self._simple(chosen, column, *self._volts_or_amps(column, "V"))
            if column.measured:
                ask(
                    f"'{column.name}' is taken as the commanded voltage, though its name says measured. Is it?"
                )
        elif command == "current":
            self._simple(chosen, column, *self._volts_or_amps(column, "A"))
            if not column.command:
                ask(
                    f"Is '{column.name}' the commanded current? As a measured one beside a voltage it belongs to the "
                    "outputs; log the command, too."
                )
        elif command == "torque":
            part, slide = PARTS.get(column.unit, 1.0), self.joint is not None and self.joint.slide
            unit = column.unit if part != 1.0 else "N" if slide else "N m"
            self._simple(chosen, column, unit, part)
            if not column.command:
                self.evidence.ask_of(
                    column.name, "Commanded torque, and in N m: {}? Servos log a load or a current so."
                )
        else:
            self._duty(chosen, column)
        if command == "goal" and self.kinds.get("gain") and self.kinds.get("supply"):
            self.drive.command = "position_loop"
            gain, name = self.kinds["gain"][0], f"gain{number}"
            self.inputs.append(Chosen(name, gain.name, "1", guesses=[_why(name, gain, "gain")]))
            self._supply()
        # the motor's switch, where it is thrown: off, its terminals are open
        for column in self.kinds.get("enable", ())[:1]:
            if self.evidence.moves(column.name):
                name = f"enable{self.drive.number}"
                self.inputs.append(Chosen(name, column.name, "1", guesses=[_why(name, column, "switch")]))
        # turn the angle where command and response are opposed, and fit the drive
        command, output = self.inputs[0], self.outputs[0]
        if self._by_goal:
            (log,) = self.evidence.liveliest(output.column)
            related = follows(self.evidence.time(log), command.values(log), output.values(log))
            words = f"correlation of the goal with the angle: {related:+.2f}"
            sure = abs(related) > 0.5
            guess = Guess(f"sign of {output.name}", "-1" if sure and related < 0 else "1", words, sure)
        else:
            guess = sign_of(self._fit(), command.name, output.name)
        if not guess.sure:
            self.evidence.ask(
                f"Does a positive '{command.column}' turn '{output.column}' the positive way? ({guess.evidence})"
            )
        if guess.value != "-1":
            output.guesses.append(guess)
        else:
            turned, words = self._turned(guess.evidence)
            for one in turned:
                one.turn()
            turned[0].guesses.append(Guess(f"sign of {turned[0].name}", "-1", words))
        self.drive.fit = self._fit()
        if angle is not None:
            self._side_by_motor()
            self._zero()
            # how late the angle follows its goal, the median of the logs that show it
            if self.drive.command == "goal":
                logs, goal = self.evidence.liveliest(self.outputs[0].column, FITTED), self.inputs[0]
                lags = [
                    goal_lag(self.evidence.time(log), goal.values(log), angle)
                    for log, angle in zip(logs, self.at_joint(logs), strict=True)
                ]
                if shown := [lag for lag in lags if lag]:
                    self.drive.lag = float(np.median(shown))
                    words = (
                        f"distance of angle and goal over the speed, median of {len(shown)} of {len(lags)} logs "
                        f"({min(shown):.3g} to {max(shown):.3g} s); that of a loop is its damping over its stiffness"
                    )
                    most = 2 * len(shown) > len(lags)
                    goal.guesses.append(Guess(f"lag of {goal.name}", f"{self.drive.lag:.3g} s", words, most))
        self._current()

    @property
    def ratio(self) -> float:
        """Turns of what the angle is measured at for one of the joint, as far as the sheet says."""
        return self.gear if self.drive.side == "m" else 1.0

    def at_joint(self, logs: Sequence[Log]) -> list[np.ndarray]:
        """The angle at the joint in each log [rad or m], (T,)."""
        return [self.outputs[0].values(log) / self.ratio for log in logs]

    @property
    def gear(self) -> float:
        return self.evidence.sheet.ratio(self.drive.number)

    # Side of the gear

    def _turn_side(self, side: str, words: str) -> None:
        """Rename the outputs to a side of the gear."""
        self.drive.side = side
        for one in self.outputs:
            one.name = re.sub(r"_[ma](?=\d)", f"_{side}", one.name)
            one.guesses = [replace(g, about=re.sub(r"_[ma](?=\d)", f"_{side}", g.about)) for g in one.guesses]
        self.outputs[0].guesses.append(Guess("side of the gear", "motor" if side == "m" else "link", words))

    def _side_by_motor(self) -> None:
        """Settle the angle's unit and side by the sheet's back-EMF constant, else its side by the joint's range."""
        angle, drive, sheet = self.outputs[0], self.drive, self.evidence.sheet
        constant, found = sheet.back_emf_constant or sheet.torque_constant, None
        if constant is not None and drive.command == "voltage" and angle.unit in ANGLE_FACTORS:
            unsure = any(guess.about == f"unit of {angle.name}" and not guess.sure for guess in angle.guesses)
            units = ("rad", "deg", "rev") if unsure else (angle.unit,)
            found = side_and_unit(drive.fit, ANGLE_FACTORS[angle.unit], constant, self.gear, units)
        if found is not None and not (self.side_said and found[0] != drive.side):
            side, unit, words = found
            if unit != angle.unit:
                about = f"unit of {angle.name}"
                angle.factor *= ANGLE_FACTORS[unit] / ANGLE_FACTORS[angle.unit]
                angle.unit = unit
                angle.guesses = [guess for guess in angle.guesses if guess.about != about]
                angle.guesses.append(Guess(about, unit, words))
                self._unask_unit(angle)
                drive.fit = self._fit()
            if self.gear != 1.0:
                self._turn_side(side, words)
            return
        if self.side_said or self.gear == 1.0:
            return
        span = max(float(np.ptp(angle.values(log))) for log in self.evidence.logs)
        if self.joint is not None and (by_range := side_by_range(span, self.joint, self.gear)):
            self._turn_side(*by_range)
            return
        here, there, other = ("motor", "joint", "a") if drive.side == "m" else ("joint", "motor", "m")
        now, then = (f"q_{side}{drive.number}" for side in (drive.side, other))
        self.evidence.ask(
            f"Is '{angle.column}' the angle of the {here}? With a gear of {self.gear:g} and an encoder at the {there}, "
            f"call {now} {then} in dataset.yaml, and so its speed."
        )

    # Angle and speed

    def _angle(self, column: ColumnWords, speed: ColumnWords | None) -> None:
        logs, counts = self.evidence.logs, self.evidence.sheet.counts_per_turn or 0.0
        values, name = [log.columns[column.name] for log in logs], f"q_{self.drive.side}{self.drive.number}"
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
            (log,) = self.evidence.liveliest(column.name)
            q = np.unwrap(log.columns[column.name], period=period) if period else log.columns[column.name]
            found, related = derivative_ratio(self.evidence.time(log), q, log.columns[speed.name])
            ratio = found if abs(related) > RELATED else 0.0
        self.firm = bool(column.unit or counted_unit(values))
        times = [self.evidence.time(log) for log in logs]
        geared = self.drive.side == "m" and self.evidence.sheet.gear_ratio is None
        joint = self.joint  # with its range as the angle sees it, where its name says that it is the motor's
        if joint is not None and self.side_said and not joint.slide:
            joint = replace(joint, low=joint.low * self.ratio, high=joint.high * self.ratio)
        guess = angle_unit(
            values,
            times,
            f"unit of {name}",
            column.unit,
            joint,
            ratio,
            speed.unit if speed else "",
            counts,
            1.0 if self.side_said else self.gear,
            geared,
        )
        chosen = Chosen(name, column.name, guess.value, guesses=[_why(name, column, "angle"), guess])
        self._scale_angle(chosen, guess.value)
        if period:
            chosen.unwrap = period
            chosen.guesses.append(Guess(f"turns of {name}", f"unwrap {period:g}", "it jumps by a whole turn"))
        if not guess.sure and guess.value == "deg" and geared and self.joint is not None:
            self.evidence.ask_of(
                column.name,
                "Degrees of the joint, or rad of a motor behind its gear: {}? Degrees of the joint are taken, for both "
                "fit the ranges in the robot's file; give gear_ratio in --motor.",
            )
        elif not guess.sure:
            self._ask_unit(chosen, guess)
        elif guess.value == "deg" and not (column.unit or ratio or encoder_bits(values, 360.0)):
            known = self.joint is not None or logs[0].file.file_format == "lerobot"
            if known and self.evidence.far(column.name) <= PERCENT:
                self.evidence.ask_of(
                    column.name,
                    "Degrees, or percent of the joint's range, as LeRobot may record: {}? Degrees are taken; percent "
                    "needs the scale of each joint in 'columns'.",
                )
        self.outputs.append(chosen)

    def _ask_unit(self, chosen: Chosen, guess: Guess) -> None:
        entry = f"{chosen.name}: {{column: {chosen.column}, unit: ..., scale: ...}}"
        self.evidence.ask(
            f"In which unit is '{chosen.column}'? It is taken as {guess.value}: {guess.evidence}.", entry
        )

    def _unask_unit(self, chosen: Chosen) -> None:
        questions = self.evidence.proposal.questions
        questions[:] = [q for q in questions if not q.words.startswith(f"In which unit is '{chosen.column}'")]

    def _scale_angle(self, chosen: Chosen, unit: str) -> None:
        """Unit, scale and factor of an angle or a goal in a unit of `angle_unit`."""
        if unit != "counts":
            chosen.unit = unit
            chosen.factor = {"m": 1.0, "mm": 1e-3}.get(unit) or ANGLE_FACTORS[unit]
            return
        given = self.evidence.sheet.counts_per_turn
        chosen.unit, chosen.scale = "rad", 2 * math.pi / (given or COUNTS)
        chosen.factor = chosen.scale
        words = f"2 pi / {given or COUNTS:g} counts a turn" + ("" if given else ", the usual 12 bits")
        chosen.guesses.append(Guess(f"scale of {chosen.name}", f"{chosen.scale:.6g}", words, bool(given)))
        if not given:
            self.evidence.ask_of(
                chosen.column,
                f"How many counts has a turn of {{}}? {COUNTS} are assumed (counts_per_turn in --motor).",
            )

    def _speed(self, column: ColumnWords) -> None:
        name = f"v_{self.drive.side}{self.drive.number}"
        if not self.outputs:
            # A speed without an angle, in the unit of its name
            unit = column.unit if column.unit in SPEED_FACTORS else "rad/s"
            words = "its name says so" if column.unit else "assumed"
            guess = Guess(f"unit of {name}", unit, words, bool(column.unit))
            chosen = Chosen(name, column.name, unit, factor=SPEED_FACTORS[unit])
            chosen.guesses += [_why(name, column, "speed"), guess]
            if not guess.sure:
                self._ask_unit(chosen, guess)
            self.outputs.append(chosen)
            return
        angle = self.outputs[0]
        (log,) = self.evidence.liveliest(column.name)
        time, speed = self.evidence.time(log), log.columns[column.name]
        q = angle.values(log) / angle.factor
        ratio, related = derivative_ratio(time, q, speed)
        if abs(related) < RELATED:
            self.evidence.leave(
                column.name, f"a speed that does not match the angle (correlation {related:+.2f})"
            )
            self.evidence.ask(
                f"Is '{column.name}' the speed of this joint? It does not match '{angle.column}' ({related:+.2f})."
            )
            return
        backward = np.diff(q, prepend=q[0]) / np.median(np.diff(time))
        if max(correlation(one, ratio * speed) for one in (np.gradient(q, time), backward)) > 1.0 - 1e-9:
            self.evidence.leave(
                column.name, "computed from the angle (a difference of its samples), so it tells nothing new"
            )
            words = "it is the difference of the angle's samples, sample by sample"
            self.evidence.proposal.guesses.append(Guess(f"column {column.name}", "left out", words))
            return
        guess = speed_unit(ratio, abs(angle.factor), f"unit of {name}", column.unit)
        if not guess.sure:
            self.evidence.leave(column.name, f"a speed in no usual unit ({guess.evidence})")
            if self.firm:
                self.evidence.ask(
                    f"In which unit is the speed '{column.name}'? {guess.evidence}.", f"{name}: {column.name}"
                )
            else:
                # the angle's unit is unsure, too: its speed contradicts it
                about = f"unit of {angle.name}"
                k = next(k for k, one in enumerate(angle.guesses) if one.about == about)
                found = f"1 of '{column.name}' {guess.evidence.removeprefix('one of it ')}"
                words = f"{angle.guesses[k].evidence}, but {found}: percent of its range?"
                angle.guesses[k] = replace(angle.guesses[k], evidence=words, sure=False)
                self._unask_unit(angle)
                self._ask_unit(angle, angle.guesses[k])
            return
        chosen = Chosen(name, column.name, guess.value, factor=SPEED_FACTORS[guess.value])
        chosen.guesses += [_why(name, column, "speed"), guess]
        if ratio < 0:
            chosen.turn()
            words = f"opposed to the derivative of '{angle.column}' (correlation {related:+.2f})"
            chosen.guesses.append(Guess(f"sign of {name}", "-1", words))
        self.outputs.append(chosen)

    # Command

    def _supply(self) -> None:
        """The logged supply voltage."""
        column, name = self.kinds["supply"][0], f"supply{self.drive.number}"
        chosen = Chosen(name, column.name, "", guesses=[_why(name, column, "supply")])
        self._simple(chosen, column, *self._volts_or_amps(column, "V"))
        self.inputs.append(chosen)

    def _volts_or_amps(self, column: ColumnWords, unit: str) -> tuple[str, float]:
        """Unit of a voltage or a current, and its factor: thousandths by the name, or by values beyond any drive's."""
        milli = column.unit == f"m{unit}" or (
            not column.unit and self.evidence.far(column.name) > BEYOND[unit]
        )
        return (f"m{unit}", 1e-3) if milli else (unit, 1.0)

    def _simple(self, chosen: Chosen, column: ColumnWords, unit: str, factor: float) -> None:
        chosen.unit, chosen.factor = unit, factor
        said, far = bool(column.unit), self.evidence.far(column.name)
        words = "its name says so" if said else f"values up to {far:.3g}, none in its name"
        chosen.guesses.append(Guess(f"unit of {chosen.name}", unit, words, said))

    def _goal(self, chosen: Chosen, column: ColumnWords) -> None:
        """A goal is in the unit of its name, else in the one with which it spans what the angle does."""
        about = f"unit of {chosen.name}"
        angle = next((one for one in self.outputs if one.name.startswith("q_")), None)
        said = column.unit if column.unit in (*ANGLE_FACTORS, "counts") else ""
        if said or angle is None:
            words = "its name says so" if said else "assumed"
            guess = Guess(about, said or "rad", words, bool(said))
        else:
            (log,) = self.evidence.liveliest(angle.column)
            goal, moved = log.columns[column.name], angle.values(log)
            of = (
                np.ptp if np.ptp(goal) > 0.0 else lambda signal: abs(np.mean(signal))
            )  # one that rests has a place
            guess = goal_unit(float(of(goal)), float(of(moved)), abs(angle.factor), angle.column, about)
        chosen.guesses.append(guess)
        if angle is not None and guess.value == "same":
            doubted = any(one.about == f"unit of {angle.name}" and not one.sure for one in angle.guesses)
            chosen.guesses[-1] = replace(guess, value=angle.unit, sure=guess.sure and not doubted)
            chosen.unit, chosen.scale, chosen.factor = angle.unit, abs(angle.scale), abs(angle.factor)
        else:
            self._scale_angle(chosen, guess.value)
        steps = [np.abs(np.diff(log.columns[column.name])) for log in self.evidence.logs]
        largest = max((float(step.max()) for step in steps if step.size), default=0.0)
        if angle is not None and angle.unwrap and largest > 0.8 * angle.unwrap:
            self.evidence.ask(
                f"The goal '{column.name}' jumps by a whole turn as '{angle.column}' does, which cannot be undone "
                "alike for both: is there a goal without jumps? Sign, zero and delay are not to be trusted until then."
            )
        if not guess.sure:
            self.evidence.ask(
                f"In which unit is the goal '{column.name}'? It is taken in {chosen.unit}: {guess.evidence}."
            )

    def _duty(self, chosen: Chosen, column: ColumnWords) -> None:
        """A duty with a logged supply stays one; with a constant supply it is a voltage."""
        far, about, number = (
            self.evidence.far(column.name),
            f"unit of {chosen.name}",
            self.drive.number,
        )
        top = next((top for top in DUTY_TOPS if far <= 1.001 * top), far)
        words = f"values up to {far:.4g}: {top:g} is full duty"
        # counters and timers hold whole numbers alone
        logs = self.evidence.liveliest(column.name, 3)
        whole = all(bool(np.all(np.mod(log.columns[column.name], 1.0) == 0.0)) for log in logs)
        said = top == 1.0 or (top == 100.0 and (column.unit == "%" or not whole or far > 0.98 * top))
        if not said:
            self.evidence.ask(
                f"Which value of '{column.name}' is full duty? {top:g} is assumed, for it goes up to {far:.4g}."
            )
        if self.kinds.get("supply"):
            chosen.unit, chosen.scale = ("%", 1.0) if top == 100.0 else ("1", 1.0 / top)
            chosen.factor = 1.0 / top
            chosen.guesses.append(Guess(about, chosen.unit, words, said))
            self._supply()
            return
        given = self.evidence.sheet.voltage
        volts = given or SUPPLY
        self.drive.command = "voltage"
        chosen.name, chosen.unit, chosen.scale, chosen.factor = f"u{number}", "V", volts / top, volts / top
        source = "of the motor's sheet" if given else "a placeholder"
        value = f"{volts:g} V / {top:g}"
        chosen.guesses.append(Guess(f"unit of {chosen.name}", value, f"{words}; {volts:g} V {source}", False))
        if not given:
            self.evidence.ask(
                f"What is the supply voltage behind the duty '{column.name}'? {volts:g} V stand in its scale; another "
                "one changes P_m1 and P_m2 alone. Give voltage in --motor, or log it."
            )

    # Sign, zero and end stops

    @property
    def _by_goal(self) -> bool:
        return self.drive.command in ("goal", "position_loop")

    def _turned(self, words: str) -> tuple[list[Chosen], str]:
        """Which of two opposed ones to turn: the outputs, or the command where the robot's range asks for that."""
        command, output, joint = self.inputs[0], self.outputs[0], self.joint
        if joint is None or output.name.startswith("v_"):
            return list(self.outputs), words
        angles = self.at_joint(self.evidence.logs)
        fits = [zero_offset([way * one for one in angles], joint, "") is None for way in (1.0, -1.0)]
        if fits == [True, False]:
            return [command], f"{words}; turned, the angle would leave the range of {joint.name}"
        if fits == [True, True]:
            self.evidence.ask(
                f"'{command.column}' and '{output.column}' are opposed. The angle is turned; if it has the "
                "sign of the robot's file, turn the command instead (scale: -1)"
            )
        return list(self.outputs), words

    def _fit(self) -> DriveFit | None:
        """The acceleration's fit, the median one of the logs in which the joint moves most."""
        fits, output = [], self.outputs[0]
        for log in self.evidence.liveliest(output.column, FITTED):
            command = self.inputs[0].values(log)
            if self.drive.command == "duty" and len(self.inputs) > 1:
                command = command * self.inputs[1].values(log)
            angle = output.values(log)
            if self._by_goal:
                command = command - angle
            speed = output.name.startswith("v_")
            fits.append(drive_fit(self.evidence.time(log), command, angle, speed=speed))
        fits = sorted((fit for fit in fits if fit is not None), key=lambda fit: fit.partial)
        return fits[len(fits) // 2] if fits else None

    def _zero(self) -> None:
        """Bring the angle, and a goal with it, to the zero of the robot's file; without one, to its goal's."""
        angle, joint, about = self.outputs[0], self.joint, f"zero of {self.outputs[0].name}"
        values = self.at_joint(self.evidence.logs)
        limited = joint is not None and math.isfinite(joint.range)
        by_range = zero_offset(values, joint, about) if joint is not None and limited else None
        by_goal = None
        if self.drive.command == "goal" and (by_range or joint is None):
            goals = [self.inputs[0].values(log) for log in self.evidence.logs]
            reach = joint.range if joint is not None else max(float(np.ptp(one)) for one in values)
            by_goal = zero_by_goal(values, goals, reach, about)
        if guess := by_goal or by_range:
            offset, both = float(guess.value), ""
            angle.zero = float(f"{offset * self.ratio / angle.factor:.9g}")
            if by_goal is None and self.drive.command == "goal":
                self.inputs[0].zero = float(f"{offset / self.inputs[0].factor:.9g}")
                both = ", and so that of its goal"
            angle.guesses.append(replace(guess, value=f"{angle.zero:g}"))
            self.evidence.ask(
                f"Where is the zero of {self.drive.joint} in '{angle.column}'? At {angle.zero:g}{both}: "
                f"{guess.evidence}.",
                f"{angle.name}: {{column: {angle.column}, zero: ...}}",
            )
            if joint is None:
                self.drive.fit = self._fit()
        elif joint is not None and limited:
            angle.guesses.append(Guess(about, "0", f"all angles lie in the range of {joint.name}"))
        if joint is not None and limited:
            # where the joint is beyond its limits
            values, middle = self.at_joint(self.evidence.logs), 0.5 * (joint.low + joint.high)
            for k, beyond in enumerate(beyond_limits(values, joint)):
                if beyond.any():
                    far = values[k][np.argmax(np.abs(values[k] - middle))]
                    words = (
                        f"{joint.name} runs to {far:.4g}, its limits are {joint.low:.4g} to {joint.high:.4g}"
                    )
                    self.evidence.stops.setdefault(k, []).append((words, beyond))

    def _current(self) -> None:
        """A measured current is an output beside a commanded voltage."""
        command, drive = self.inputs[0], self.drive
        some = [
            one
            for one in self.kinds.get("current", ())
            if self.evidence.moves(one.name) and one.name != command.column
        ]
        if drive.command not in ("voltage", "duty") or not some:
            return
        column = min(some, key=lambda one: (one.command, not one.measured, len(one.name)))
        unit, factor = self._volts_or_amps(column, "A")
        chosen = Chosen(f"i{drive.number}", column.name, unit, factor=factor)
        words = "its name says so" if column.unit else f"values up to {self.evidence.far(column.name):.3g}"
        chosen.guesses += [
            _why(chosen.name, column, "current"),
            Guess(f"unit of {chosen.name}", unit, words, bool(column.unit)),
        ]
        (log,) = self.evidence.liveliest(self.outputs[0].column)
        i, u, angle = chosen.values(log), command.values(log), self.outputs[0].values(log)
        speed = angle if self.outputs[0].name.startswith("v_") else rate_of(self.evidence.time(log), angle)
        columns = np.stack([u, speed, np.sign(u)], axis=1)
        gain = float(np.linalg.lstsq(columns / np.std(columns, axis=0).clip(1e-12), i, rcond=None)[0][0])
        related = correlation(i, u)
        if i.min() >= -0.02 * i.max() and u.min() < -0.1 * u.max():
            drive.unsigned = True
            words = "never negative while the command is"
            chosen.guesses.append(Guess(f"sign of {chosen.name}", "none", words))
        elif gain < 0 and related < -0.2:
            chosen.turn()
            words = f"opposed to the command (correlation {related:+.2f})"
            chosen.guesses.append(Guess(f"sign of {chosen.name}", "-1", words))
        self.outputs.append(chosen)
