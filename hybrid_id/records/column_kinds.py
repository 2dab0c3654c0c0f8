"""The quantity that each column of a joint is: by its name, else by its values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

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
    found = _Kinds(evidence)
    for one in columns:
        kind = "goal" if one.kind == "angle" and one.command else one.kind
        if kind == "speed" and one.command:
            evidence.leave(one.name, "a commanded speed, which no drive here takes as its input")
        elif kind:
            found.kinds.setdefault(kind, []).append(one)
        else:
            found.open.append(one)
    found.state_of_lerobot()
    found.angle_by_its_derivative()
    found.smoothest_as_angle()
    found.bare_v()
    found.command()
    found.supply()
    return found.kinds


@dataclass
class _Kinds:
    """Columns whose quantity is known, and those whose names leave it open."""

    evidence: Evidence
    kinds: dict[str, list[ColumnWords]] = field(default_factory=dict)
    open: list[ColumnWords] = field(default_factory=list)

    @property
    def angle(self) -> ColumnWords | None:
        return self.evidence.first(self.kinds, "angle")

    def take(self, one: ColumnWords, kind: str, why: str, sure: bool = False) -> None:
        """Place a column; where that is not sure, ask."""
        self.kinds.setdefault(kind, []).append(one)
        self.open.remove(one)
        self.evidence.proposal.guesses.append(Guess(f"column {one.name}", kind, why, sure))
        if not sure:
            self.evidence.ask(f"Is the column '{one.name}' the {kind}? ({why})")

    def supply(self) -> None:
        """A voltage beside a goal or a duty that never falls to half of its largest value is the supply's."""
        if not (self.kinds.get("goal") or self.kinds.get("duty")):
            return
        for one in list(self.kinds.get("voltage", [])):
            if not one.command and self.evidence.span(one.name) < 0.5 * self.evidence.far(one.name):
                self.kinds["voltage"].remove(one)
                self.kinds.setdefault("supply", []).append(one)
                why = "a voltage that never falls to half of its largest value, beside a goal or a duty"
                self.evidence.proposal.guesses.append(Guess(f"column {one.name}", "supply", why, True))

    def state_of_lerobot(self) -> None:
        """The one measured column of a joint in a LeRobot dataset is its angle."""
        measured = [one for one in self.open if one.measured and not one.command]
        lerobot = self.evidence.logs[0].file.file_format == "lerobot"
        if lerobot and len(measured) == 1 and self.angle is None:
            self.take(measured[0], "angle", "the state of a LeRobot dataset", True)

    def angle_by_its_derivative(self) -> None:
        """A column whose derivative is another one."""
        if self.angle is not None:
            return
        log = self.evidence.longest()
        time = self.evidence.time(log)
        free = [*self.open, *self.kinds.get("speed", [])]
        pairs = [
            (abs(derivative_ratio(time, log.columns[a.name], log.columns[v.name])[1]), a, v)
            for a in self.open
            for v in free
            if a is not v and not a.command
        ]
        if pairs and (best := max(pairs, key=lambda pair: pair[0]))[0] > RELATED:
            related, a, v = best
            self.take(a, "angle", f"smooth, and its derivative correlates by {related:.3f} with '{v.name}'")
            if v in self.open:
                self.take(v, "speed", f"the derivative of '{a.name}' correlates by {related:.3f} with it")

    def smoothest_as_angle(self) -> None:
        """Of columns that say nothing the smoothest, where another one is left to be the command."""
        if self.angle is not None or self.evidence.first(self.kinds, "speed") or len(self.open) < 2:
            return
        log = self.evidence.longest()
        silent = [one for one in self.open if not one.command]
        rough = {}  # standard deviation of the steps over that of the values
        for one in silent:
            values = log.columns[one.name]
            rough[one.name] = float(np.std(np.diff(values))) / max(float(np.std(values)), 1e-300)
        if silent and len(silent) + any(self.kinds.get(kind) for kind in INPUTS) >= 2:
            smooth = min(silent, key=lambda one: rough[one.name])
            words = f"the smoothest column: steps of {rough[smooth.name]:.2g} of its deviation"
            self.take(smooth, "angle", words)

    def bare_v(self) -> None:
        """A bare `v` is a speed where it is the angle's derivative, and else a voltage."""
        log, angle = self.evidence.longest(), self.angle
        for one in [one for one in self.open if one.speed_or_voltage]:
            if angle is None:
                self.take(one, "voltage", "a bare v without an angle")
                continue
            related = derivative_ratio(
                self.evidence.time(log), log.columns[angle.name], log.columns[one.name]
            )[1]
            kind = "speed" if abs(related) > RELATED else "voltage"
            words = f"v, whose correlation with the derivative of '{angle.name}' is {related:+.2f}"
            self.take(one, kind, words, abs(related) > RELATED or abs(related) < 0.7)

    def command(self) -> None:
        """A command without a quantity is a goal where the angle follows it, else a duty or a voltage."""
        commands = [one for one in self.open if one.command]
        if not commands and not any(self.kinds.get(kind) for kind in INPUTS) and len(self.open) == 1:
            commands = list(self.open)
        if not commands:
            return
        angle, one = self.angle, self._best_command(commands)
        (log,) = self.evidence.liveliest(one.name)
        values, far = log.columns[one.name], self.evidence.far(one.name)
        if angle is not None:
            q = log.columns[angle.name]
            related = follows(self.evidence.time(log), values, q)
            if abs(related) > RELATED and 0.3 < np.ptp(values) / max(np.ptp(q), 1e-300) < 3.0:
                words = f"a command that '{angle.name}' follows: correlation {related:+.3f}, spans alike"
                self.take(one, "goal", words, bool(related > 0.97))
                return
        if far <= 1.0001:
            self.take(one, "duty", f"a command within -1 and 1 (up to {far:.3g})")
        else:
            self.take(one, "voltage", f"a command up to {far:.3g} that the angle does not follow")

    def _best_command(self, commands: Sequence[ColumnWords]) -> ColumnWords:
        """Of several commands without a quantity the one that the acceleration follows best."""
        angle = self.angle
        if len(commands) == 1 or angle is None:
            return commands[0]
        (log,) = self.evidence.liveliest(angle.name)
        time = self.evidence.time(log)
        fits = {one.name: drive_fit(time, log.columns[one.name], log.columns[angle.name]) for one in commands}
        shares = {name: abs(fit.partial) if fit else 0.0 for name, fit in fits.items()}
        best = max(commands, key=lambda one: shares[one.name])
        listed = ", ".join(
            f"{name} {share:.3f}" for name, share in sorted(shares.items(), key=lambda item: -item[1])
        )
        self.evidence.ask(
            f"Is '{best.name}' what acts on the drive? Correlations with the change of speed: {listed}."
        )
        return best
