"""The quantity that each column of a joint is: by its name, else by its values."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hybrid_id.records.column_words import ColumnWords
from hybrid_id.records.proposal import RELATED, Guess, derivative_ratio, drive_fit, follows
from hybrid_id.records.proposal_parts import Evidence

INPUTS = ("voltage", "duty", "current", "torque", "goal")
"""Quantities that can drive a joint, in the order in which they are preferred."""


def kinds_of(columns: Sequence[ColumnWords], evidence: Evidence) -> dict[str, list[ColumnWords]]:
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
