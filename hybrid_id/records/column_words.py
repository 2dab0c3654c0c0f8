"""What the name of a log's column says: its quantity, whether it is a command, its unit, and its joint."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass


def _words(spaced: str) -> frozenset[str]:
    return frozenset(spaced.split())


KINDS: dict[str, frozenset[str]] = {
    "error": _words("error errors err"),
    "supply": _words("supply vbat vbus vcc vin battery"),
    "temperature": _words("temp temperature"),
    "duty": _words("duty pwm dutycycle"),
    "current": _words("current cur curr amps amp ampere amperes iq i ia"),
    "torque": _words("torque torques tau trq tq effort efforts moment force"),
    "speed": _words("speed speeds vel velocity velocities qd dq qdot omega w dtheta thetadot dpos rpm dps"),
    "angle": _words(
        "angle angles pos position positions q theta th phi enc encoder qm qa counts ticks deg "
        "degrees rotation"
    ),
    "voltage": _words("voltage volt volts u vm um vmotor"),
    "time": _words(
        "t time timestamp timestamps stamp stamps times clock seconds secs sec millis micros nanos"
    ),
}
"""Words for each quantity, in the order in which they decide."""
COMMAND = _words(
    "cmd command commands commanded goal goals target targets ref reference desired des "
    "setpoint sp action actions input plant control ctrl"
)
MEASURED = _words(
    "meas measured measurement actual act feedback fb state states present observation obs sensed"
)
GOALS = _words("goal goals target targets setpoint sp")
"""Words of commands that are angles where no quantity is named."""
LINK, MOTOR = _words("link load arm"), _words("motor rotor")
COUNTERS = _words("index idx frame sample samples id seq sequence episode task row step count done reward")
"""Words of columns that number the rows."""
FILLERS = _words(
    "joint joints data value values raw filtered the of in servo m a controller side rad deg "
    "radian radians mrad rev revs turn turns revolutions degrees s ms us ns v mv ma nm n x y "
    "percent per ncm nmm j"
)
VOCABULARY = frozenset().union(*KINDS.values(), COMMAND, MEASURED, LINK, MOTOR, FILLERS)
UNITS: tuple[tuple[str, str], ...] = (
    (r"(?<![a-z])rad(ians?)?\s*(/|_per_|_|p)\s*s(ec)?\b", "rad/s"),
    (r"(deg(rees?)?|°)\s*(/|_per_|_|p)\s*s(ec)?\b|\bdps\b", "deg/s"),
    (r"rev\s*(/|_per_|p)\s*s(ec)?\b", "rev/s"),
    (r"mrad\s*(/|_per_|_|p)\s*s(ec)?\b", "mrad/s"),
    (r"rpm\b", "rpm"),
    (r"mrad\b", "mrad"),
    (r"(deg|degrees?|°)(?![a-z])", "deg"),
    (r"(?<![a-z])rad(ians?)?\b", "rad"),
    (r"(rev|turns?|revolutions?|rotations)\b", "rev"),
    (r"(counts?|ticks|lsb)\b", "counts"),
    (r"(?<![a-z])mv\b|millivolts?", "mV"),
    (r"volts?\b|[\[(]v[\])]", "V"),
    (r"(?<![a-z])ma\b|milliamps?", "mA"),
    (r"amps?\b|amperes?\b|[\[(]a[\])]", "A"),
    (r"(?<![a-z])mn[ ·*_]?m\b", "mN m"),
    (r"(?<![a-z])n[ ·*_]?cm\b", "N cm"),
    (r"(?<![a-z])n[ ·*_]?mm\b", "mN m"),
    (r"(?<![a-z])n[ ·*_]?m\b", "N m"),
    (r"percent\b|pct\b|%", "%"),
    (r"(?<![a-z])ms\b|millis|milliseconds?", "ms"),
    (r"(?<![a-z])[uµ]s\b|micros|microseconds?", "us"),
    (r"(?<![a-z])ns\b|nanos|nanoseconds?", "ns"),
    (r"seconds?\b|secs?\b|[\[(]s[\])]|_s$", "s"),
)
"""Spellings of units in names, and the unit; the first that occurs is taken."""
CHANNELS = {
    "u": "voltage", "supply": "supply", "duty": "duty", "gain": "gain", "enable": "enable", "goal": "goal",
    "tau": "torque", "i": "current", "q_m": "angle", "q_a": "angle", "v_m": "speed", "v_a": "speed",
    "temperature": "temperature",
}  # fmt: skip
"""Stems of this package's channels, and the quantity; a column may be named so already."""


@dataclass(frozen=True)
class ColumnWords:
    """What a name says.

    Attributes:
        name: of the column.
        kind: a key of ``KINDS``; empty where the name does not say.
        command: whether it says that this is commanded, and ``measured``, that it is measured.
        unit: in the name; empty where none stands there.
        side: ``link`` or ``motor``, or empty.
        joint: what is left of the name, ``shoulder_pan`` or ``2``; empty where nothing is.
        counter: whether it numbers the rows.
        speed_or_voltage: whether it is a bare ``v``, which is either.
    """

    name: str
    kind: str = ""
    command: bool = False
    measured: bool = False
    unit: str = ""
    side: str = ""
    joint: str = ""
    counter: bool = False
    speed_or_voltage: bool = False


def tokens(name: str) -> list[str]:
    """Words and numbers of a name in lower case: ``motorPos_2`` -> ``motor``, ``pos``, ``2``."""
    return [part.lower() for part in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-zµ]+|\d+", name)]


def read_name(name: str, joints: Sequence[str] = (), others: Collection[str] = ()) -> ColumnWords:
    """See what a column's name says.

    Args:
        name: of the column.
        joints: names of the robot's joints; one that stands in the name is the column's joint.
        others: names of all columns: ``q_d`` is what is desired of a ``q`` among them, as libfranka writes it.
    """
    own = re.fullmatch(r"([a-z_]+?)(\d+)", name)
    if own and own[1] in CHANNELS:
        kind = CHANNELS[own[1]]
        side = {"a": "link", "m": "motor"}.get(own[1][2:], "")
        command, kind = kind == "goal", "angle" if kind == "goal" else kind
        return ColumnWords(name, kind, command=command, side=side, joint=own[2])
    words = tokens(name)
    joint, words = _joint_in(words, joints)
    found = set(words)
    rest = re.sub(re.escape(joint), " ", name, count=1, flags=re.IGNORECASE)  # a joint may be called 'turn'
    # once more with camel case and underscores parted into words, for patterns with word ends
    spaced = re.sub(r"_(?!per_|s\b|m\b)", " ", re.sub(r"(?<=[a-z])(?=[A-Z])", " ", rest).lower())
    text = f"{rest.lower()}\n{spaced}"
    unit = next((unit for pattern, unit in UNITS if re.search(pattern, text, re.MULTILINE)), "")
    kind = next((kind for kind, some in KINDS.items() if found & some), "")
    bare = not kind and "v" in found
    if not kind and found & GOALS:
        kind = "angle"
    if kind in ("", "time") and unit in ("rad", "deg", "counts") and not found & KINDS["time"]:
        kind = "angle"
    if kind == "time" and (found & (COMMAND | MEASURED) or joint):
        kind = ""
    if kind == "voltage" and found & {"bus", "battery", "supply"}:
        kind = "supply"
    if not kind and found & {"ms", "us", "ns"} and len(words) == 1:
        kind = "time"
    if kind == "angle" and unit in ("rad/s", "deg/s", "rpm", "rev/s"):
        kind = "speed"
    desired = (
        "d" in found
        and kind in ("angle", "speed", "torque")
        and [word for word in tokens(name) if word != "d"] in map(tokens, others)
    )
    left = [word for word in words if word not in VOCABULARY and not (desired and word == "d")]
    return ColumnWords(
        name=name,
        kind=kind,
        command=desired or bool(found & COMMAND),
        measured=bool(found & MEASURED) and not desired,
        unit=unit,
        side="link" if found & LINK or "a" in found else "motor" if found & MOTOR else "",
        joint=joint or "_".join(left),
        counter=bool(found & COUNTERS) or (not kind and left == [] and not found),
        speed_or_voltage=bare,
    )


def _joint_in(words: list[str], joints: Sequence[str]) -> tuple[str, list[str]]:
    """The joint whose words stand in a name, the one of most words first, and the words without it."""
    for joint in sorted(joints, key=lambda one: -len(tokens(one))):
        whole = tokens(joint)
        core = [word for word in whole if word not in ("joint", "hinge", "motor", "servo")]
        for part in (whole, core):
            if not part or all(word.isdigit() for word in part) or len("".join(part)) < 2:
                continue
            for k in range(len(words) - len(part) + 1):
                if words[k : k + len(part)] == part:
                    return joint, words[:k] + words[k + len(part) :]
    return "", words
