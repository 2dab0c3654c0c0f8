"""From logs to the channels of a dataset: every choice with its evidence, every doubt as a question."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from hybrid_id.errors import InputError
from hybrid_id.records.column_words import ColumnWords, read_name, tokens
from hybrid_id.records.joint_channels import choose_channels, find_pair
from hybrid_id.records.logs import Log
from hybrid_id.records.proposal import (
    RELATED,
    TIME_FACTORS,
    Guess,
    JointFacts,
    follows,
    is_time,
    sampling,
    time_unit,
)
from hybrid_id.records.proposal_parts import Chosen, Evidence, MotorSheet, Proposal, Question
from hybrid_id.records.resample import MAX_GAP

LONGEST_GAP = 20.0
"""Missing samples, in median steps, up to which a gap is bridged and beyond which a record is cut."""
CLEAR = 0.1
"""Time [s] that is kept off an end stop."""
LEAST_PART = 0.5
"""Share of a record that a cut at an end stop has to leave; where it would leave less, the stop is asked about only."""
BACKWARD = 0.1
"""Share of the steps of a column up to which it is time that goes back somewhere, and not another quantity."""
LEAST_FOR_TEST, MANY = 3, 5
"""Records from which the last one tests the model, and from which the last two do."""


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
    words = {name: read_name(name, names, logs[0].columns.keys()) for name in logs[0].columns}
    time = _time(logs, words)
    proposal = Proposal(time, list(logs))
    proposal.left += [(name, why) for name, why in logs[0].left.items()]
    clock = {id(log): time.factor * log.columns[time.column] for log in logs}
    evidence = Evidence(logs, clock, words, sheet, proposal)
    for name, why in logs[0].left.items():
        if read_name(name, names).kind:
            evidence.ask(f"Is '{name}' needed? It is left out: {why}.")
    groups = _groups(words, time.column, evidence, names)
    placed = _place(groups, joints, proposal)
    found = [find_pair(joint.name if joint else key, groups[key], joint, evidence) for key, joint in placed]
    pairs = [pair for pair in found if pair is not None]
    if not pairs:
        shown = ", ".join(list(logs[0].columns)[:12]) + (", ..." if len(logs[0].columns) > 12 else "")
        why = "; ".join(f"{name}: {reason}" for name, reason in proposal.left[:3])
        raise InputError(
            f"{logs[0].file.path} has no usable pair of an input (voltage, duty, current, torque, goal) and an angle "
            f"or speed (columns are {shown}{'; ' + why if why else ''}); rename the columns after what they hold, or "
            "write dataset.yaml by hand as docs/records.md shows"
        )
    if not joints:
        # where no robot says how the joints hang together, the first one alone is modelled
        first, *others = pairs
        if others:
            evidence.ask(
                f"The logs hold {len(pairs)} joints, and no robot is given: the model is of '{first.title}' alone, "
                f"the others ({', '.join(one.title for one in others)}) are left out. Give --robot with the MJCF or "
                "URDF for all; one joint alone is right only if the others stood still."
            )
        own = {one.name for one in first.columns}
        for pair in others:
            for one in pair.columns:
                if one.name not in own:
                    evidence.leave(one.name, f"of {pair.title}, a joint that is left out")
        pairs = [first]
    for number, pair in enumerate(pairs, 1):
        choose_channels(pair, number, evidence)
    _share_units(evidence)
    if still := [log for log in logs if not any(np.ptp(log.columns[c.column]) for c in proposal.outputs)]:
        proposal = propose([log for log in logs if log not in still], joints, sheet)
        proposal.left += [(log.file.title, "no angle and no speed moves in it") for log in still]
        return proposal
    logged = {drive.joint for drive in proposal.drives}
    proposal.held = [joint.name for joint in joints if joint.name not in logged]
    used = {one.column for one in (time, *proposal.inputs, *proposal.outputs)} | {n for n, _ in proposal.left}
    rows = "numbers the rows, or a second clock"
    proposal.left += [
        (name, rows if one.counter or one.kind == "time" else "not needed, or not understood")
        for name, one in words.items()
        if name not in used
    ]
    evenly = sampling([clock[id(log)] for log in logs])
    proposal.resample = evenly.value == "resample"
    proposal.guesses.append(evenly)
    _parts(evidence)
    # the last record tests the model, of many the last two; of too few none does
    count = len(proposal.logs)
    tests = 0 if count < LEAST_FOR_TEST else 1 if count < MANY else 2
    proposal.roles = ["train"] * (count - tests) + ["test"] * tests
    if tests:
        which = "last is the test record" if tests == 1 else "last two are test records"
        reason = f"the {which}, which no fit sees"
    else:
        reason = "too few to keep one for the test"
        proposal.questions.append(
            Question(
                f"Are there more logs? {'The one record is' if count == 1 else 'Both records are'} fitted, and none "
                f"tests the model: record at least {LEAST_FOR_TEST - count} more, with another motion (other speeds, "
                "both directions, the whole range), and make it role: test."
            )
        )
    proposal.guesses.append(Guess("roles", f"{count - tests} train, {tests} test", reason))
    if any(guess.about == "unit of time" and not guess.sure for guess in time.guesses):
        why = next(guess.evidence for guess in time.guesses if guess.about == "unit of time")
        evidence.ask(
            f"Is the unit of '{time.column}' {time.unit}? {why}.",
            f"t: {{column: {time.column}, unit: ...}}",
        )
    return proposal


def _share_units(evidence: Evidence) -> None:
    """Units that are sure at one joint are so at others whose columns are named alike and would have the same one."""
    proposal = evidence.proposal
    # of names that are alike: each sure unit, and its column
    known: dict[tuple[object, ...], dict[str, str]] = {}
    for chosen in (*proposal.outputs, *proposal.inputs):
        for guess in chosen.guesses:
            if guess.about == f"unit of {chosen.name}" and guess.sure:
                known.setdefault(_apart_from_joint(evidence, chosen), {}).setdefault(
                    guess.value, chosen.column
                )
    for chosen in (*proposal.outputs, *proposal.inputs):
        units = known.get(_apart_from_joint(evidence, chosen), {})
        for k, guess in enumerate(chosen.guesses):
            unsure = guess.about == f"unit of {chosen.name}" and not guess.sure
            if unsure and list(units) == [guess.value]:
                words = f"that of '{units[guess.value]}', which is named alike, and {guess.evidence}"
                chosen.guesses[k] = replace(guess, evidence=words, sure=True)
                asked = (
                    f"In which unit is '{chosen.column}'",
                    f"In which unit is the goal '{chosen.column}'",
                )
                proposal.questions[:] = [one for one in proposal.questions if not one.words.startswith(asked)]


def _apart_from_joint(evidence: Evidence, chosen: Chosen) -> tuple[object, ...]:
    """What a column's name says, its joint left out."""
    said = evidence.words[chosen.column]
    words, joint = tokens(chosen.column), tokens(said.joint)
    return said.kind, chosen.name.rstrip("0123456789"), tuple(word for word in words if word not in joint)


def _parts(evidence: Evidence) -> None:
    """Bridge short gaps by resampling, and cut records at long ones and at end stops; all is said and asked about."""
    proposal = evidence.proposal
    for k, log in enumerate(proposal.logs):
        time = evidence.time(log)
        clocks = {"": time} | {
            c.column: log.times[c.column] for c in proposal.outputs if c.column in log.times
        }
        gaps = {name: np.diff(own) / np.median(np.diff(own)) for name, own in clocks.items()}
        part, name = np.arange(time.size), max(gaps, key=lambda one: float(gaps[one].max()))
        if (most := float(gaps[name].max())) > LONGEST_GAP:
            between, after = np.zeros(time.size, bool), np.zeros(time.size, int)
            for one, own in clocks.items():
                for place in np.flatnonzero(gaps[one] > LONGEST_GAP):
                    between |= (time > own[place]) & (time < own[place + 1])
                    after += time >= own[place + 1]
            rows = np.flatnonzero(~between)
            part = max(np.split(rows, np.flatnonzero(np.diff(after[rows])) + 1), key=len)
            whose = f" of '{name}'" if name else ""
            words = f"samples{whose} are missing for {most:.3g} steps; the longest part without such a gap is kept"
            _cut(proposal, k, time[part], words)
        part = _clear_of_stops(evidence, k, part)
        longest = 1.0
        for name, own in clocks.items():
            if name or proposal.resample:  # other topics are interpolated, whether the clock is even or not
                inside = (own[1:] > time[part[0]]) & (own[:-1] < time[part[-1]])
                longest = max(longest, float(np.max(gaps[name][inside], initial=1.0)))
        if longest > MAX_GAP:
            proposal.resample = True
            proposal.max_gap = max(proposal.max_gap, float(math.ceil(longest + 1.0)))
    if proposal.max_gap:
        words = f"the longest gap that is bridged is below {proposal.max_gap:g} median steps"
        proposal.guesses.append(Guess("gaps", f"max_gap {proposal.max_gap:g}", words, False))
        evidence.ask(
            f"May gaps of up to {proposal.max_gap:g} steps be bridged by interpolation? Else cut the records there "
            "with 'between'."
        )


def _clear_of_stops(evidence: Evidence, k: int, part: np.ndarray) -> np.ndarray:
    """The longest part of a record's rows in which no joint is at an end stop, which no model here has."""
    if k not in evidence.stops:
        return part
    proposal, title = evidence.proposal, evidence.logs[k].file.title
    time = evidence.time(evidence.logs[k])[part]
    words = "; ".join(why for why, _ in evidence.stops[k])
    at_stop = np.any([beyond for _, beyond in evidence.stops[k]], axis=0)[part]
    if not at_stop.any():
        return part
    stops = np.r_[-np.inf, time[at_stop], np.inf]
    after = np.searchsorted(stops, time)
    clear = np.minimum(time - stops[after - 1], stops[after] - time) > CLEAR
    runs = np.split(np.flatnonzero(clear), np.flatnonzero(np.diff(np.flatnonzero(clear)) > 1) + 1)
    best = max(runs, key=len)
    why = "End stops are not in the model"
    if len(best) < LEAST_PART * part.size:
        evidence.ask(
            f"Does {title} run into an end stop? {words}. {why}: cut the record there with 'between'."
        )
        return part
    _cut(
        proposal,
        k,
        time[best],
        f"{words}; the longest part clear of it is kept, for end stops are not in the model",
    )
    evidence.ask(
        f"Does {title} run into an end stop? {words}. {why}, so the record is cut; where the limits are wrong, correct "
        "the robot's file and remove 'between'."
    )
    return part[best]


def _cut(proposal: Proposal, k: int, time: np.ndarray, words: str) -> None:
    """Keep a record between its first and last stamp [s]."""
    proposal.between[k] = float(time[0]), float(time[-1])
    value = f"{time[0]:.6g} to {time[-1]:.6g} s"
    proposal.guesses.append(Guess(f"part of {proposal.logs[k].file.title}", value, words))


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
        # raise InputError for a column that would be time, did it not repeat or go back somewhere
        columns = [name for name in words if words[name].kind == "time"]
        for log in logs:
            for name in columns:
                values = log.columns[name]
                back = np.flatnonzero(np.diff(values) <= 0.0)
                if 0 < back.size < BACKWARD * values.size:
                    k = int(back[0])
                    step = f"from {values[k]:.9g} to {values[k + 1]:.9g} at sample {k + 2}"
                    raise InputError(
                        f"{log.file.path}: time '{name}' goes {step}, but it must increase; correct or remove that "
                        "sample, or leave the log out"
                    )
        raise InputError(
            f"{first.file.path} has no column of time: none of {', '.join(list(words)[:12])} increases in even steps; "
            "log the time of each sample"
        )
    why = "its name, and it increases in even steps" if column in named else "it increases in even steps"
    guess = time_unit(first.columns[column], words[column].unit)
    time = Chosen("t", column, guess.value, guesses=[Guess("time", column, why, column in named), guess])
    time.factor = TIME_FACTORS[guess.value]
    return time


def _groups(
    words: Mapping[str, ColumnWords], time: str, evidence: Evidence, joints: Sequence[str]
) -> dict[str, list[ColumnWords]]:
    """Columns by joint, in the order in which the joints are met; ``joints`` are the robot's, by name."""
    groups: dict[str, list[ColumnWords]] = {}
    for name, one in words.items():
        if name != time and one.kind != "time" and not (one.counter and not one.kind):
            groups.setdefault(one.joint, []).append(one)
    keys = [key for key in groups if any(evidence.moves(one.name) for one in groups[key])]
    common = groups.pop("", [])
    outputs = {  # whose name makes it an angle or a speed, or the measured state of a joint
        one.name
        for one in words.values()
        if not one.command and (one.kind in ("angle", "speed") or (not one.kind and one.measured))
    }
    named = [key for key in keys if key and any(one.name in outputs for one in groups[key])]
    if not named:  # one joint, whatever its columns are called
        return {"": [*common, *(one for some in groups.values() for one in some)]}
    rest = {
        key: some for key, some in groups.items() if key in joints and key not in named
    }  # no other joint's
    if len(named) == 1:
        others = [one for key, some in groups.items() if key not in named and key not in rest for one in some]
        return {named[0]: [*groups[named[0]], *common, *others]} | rest
    _take_elements(groups, named, evidence, joints)
    for key in named:
        groups[key] += common
    named = [*named, *rest]
    stems = {_element(key)[0] for key in named}  # what all have in common says nothing of a joint
    short = bool(joints) and len(stems) == 1 and not any(key in joints for key in named)
    short = short and not any(set(tokens(min(stems))) & set(tokens(name)) for name in joints)
    return {_element(key)[1] if short else key: groups[key] for key in named}


def _element(key: str) -> tuple[str, str]:
    """A key without and with its number alone, ``data_3`` -> ``data``, ``3``; no key and all of it without one."""
    found = re.fullmatch(r"(.*?)_?(\d+)", key)
    return (found[1], found[2]) if found else (key, key)


def _take_elements(
    groups: dict[str, list[ColumnWords]], named: list[str], evidence: Evidence, joints: Sequence[str]
) -> None:
    """Give the numbered elements of a command, which are as many as the joints, to these.

    They are those whose angles follow them, where that is clear, else in the joints' order, which is asked about.
    """
    loose: dict[str, list[str]] = {}
    for key in groups:
        if key not in named and _element(key)[1].isdigit():
            loose.setdefault(_element(key)[0], []).append(key)
    some = [keys for keys in loose.values() if len(keys) == len(named)]
    if len(some) != 1 or (set(named) - set(joints) and any(_element(key)[1].isdigit() for key in named)):
        return
    elements = sorted(some[0], key=lambda key: int(_element(key)[1]))
    order = sorted(named, key=lambda name: joints.index(name) if name in joints else len(joints))
    found = _followed([groups[key] for key in elements], [groups[name] for name in order], evidence)
    shown = ", ".join(_element(key)[1] for key in elements)
    taken = ", ".join(order[k] for k in found or range(len(order)))
    if found is None:
        evidence.ask(
            f"The elements {shown} of the command have no names; they are taken in the order of the joints: {taken}. "
            "Is that their order?"
        )
    else:
        words = "each is the one that the angle of its joint follows best"
        evidence.proposal.guesses.append(Guess(f"elements {shown}", taken, words))
    for key, k in zip(elements, found or range(len(order)), strict=True):
        groups[order[k]] += groups.pop(key)


def _followed(
    elements: Sequence[Sequence[ColumnWords]], joints: Sequence[Sequence[ColumnWords]], evidence: Evidence
) -> list[int] | None:
    """The joint whose angle follows each element of a command, by its place; None where that is not clear."""
    angles = [
        next((one.name for one in some if one.kind == "angle" and not one.command), "") for some in joints
    ]
    if not all(angles):
        return None
    found = []
    for some in elements:
        (log,) = evidence.liveliest(some[0].name)
        time, goal = evidence.time(log), log.columns[some[0].name]
        related = [follows(time, goal, log.columns[name]) if np.ptp(goal) > 0.0 else 0.0 for name in angles]
        found.append(int(np.argmax(related)))
        if related[found[-1]] < RELATED:
            return None
    return found if len(set(found)) == len(found) else None


def _place(
    groups: Mapping[str, Sequence[ColumnWords]], joints: Sequence[JointFacts], proposal: Proposal
) -> list[tuple[str, JointFacts | None]]:
    """Key of the columns and the robot's joint, of each joint that is logged, in the robot's order."""
    keys = list(groups)
    if not joints:
        if all(re.search(r"\d+$", key) for key in keys):
            keys.sort(key=lambda key: int(re.findall(r"\d+$", key)[0]))
        return [(key, None) for key in keys]
    by_name = {joint.name: joint for joint in joints}
    numbers = [int(found[0]) for key in keys if (found := re.findall(r"\d+$", key))]
    first, found, unsure = min(numbers, default=1), [], []
    called = {joint: tokens(joint.name)[-1:] for joint in joints if not joint.tied}
    from_zero = first == 0 and ["0"] not in called.values()  # where the robot's own numbers begin at 1
    for key in keys:
        if key in by_name:
            found.append((key, by_name[key]))
            words = f"its name stands in the names of the columns ({key})"
            proposal.guesses.append(Guess("joint", key, words))
            continue
        digits = re.findall(r"\d+$", key)
        place = int(digits[0]) - min(first, 1) if digits else 0 if len(keys) == 1 else -1
        own, side = [str(int(number) + from_zero) for number in digits], set(tokens(_element(key)[0]))
        near = [joint for joint in called if side & set(tokens(joint.name))] or list(called)  # left_1, say
        same = [joint for joint in near if digits and called[joint] == own]
        joint = same[0] if len(same) == 1 else joints[place] if 0 <= place < len(joints) else None
        if joint is None or joint in [one for _, one in found]:
            proposal.left += [(one.name, "no joint of the robot is called so") for one in groups[key]]
            proposal.questions.append(Question(f"Which joint of the robot are the columns of '{key}'?"))
            continue
        sure = len(joints) == 1 or len(same) == 1
        found.append((key, joint))
        words = (
            f"columns of '{key}' by their number" if digits else "the columns name no joint: the first one"
        )
        proposal.guesses.append(Guess("joint", joint.name, words, sure))
        if not sure:
            unsure.append((key, joint.name))
    if unsure:
        several, names = (", ".join(some) for some in zip(*((f"'{k}'", n) for k, n in unsure), strict=True))
        order = "" if len(unsure) == 1 else ", in this order"
        proposal.questions.append(Question(f"Are the columns of {several} those of joint {names}{order}?"))
    return sorted(found, key=lambda one: joints.index(one[1]))
