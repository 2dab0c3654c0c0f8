"""Which other effects explain a case as well as the true one does: they count as right answers.

Each named effect is built into the nominal model in every place where it fits, and fitted with it to the train
records, from the simulator's re-fitted values and from the true ones, since re-fitted values may be implausible.
A rival counts when it predicts the test records within 6 % of the true effect's error, fitted alike, and leaves less
than a tenth of the gap (mean square). Those that could close little of it even in the linear prediction are not fitted.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hybrid_id.machines.case import Case, Records, build
from hybrid_id.machines.effects import CATALOGUE, Effect
from hybrid_id.machines.effects.base import UNKNOWN
from hybrid_id.machines.grading import (
    ROUNDS,
    STEP,
    Bench,
    Refit,
    free_parameters,
    refit,
    refit_model,
    true_values,
)
from hybrid_id.machines.physics.bench import Plant
from hybrid_id.machines.physics.machine import Machine
from hybrid_id.machines.robots import Robot

CLOSE, REST = 1.06, 0.1
"""Largest error relative to the true effect's, and largest share of the gap left, of a rival that counts."""
FARTHEST = 1.15
"""Largest error of the true effect, fitted as its rivals are, over the noise floor, by which these are judged."""
LOOK, PROMISING = 5, 2.0
"""Steps of a rival's first fit, and the error over the floor up to which it is fitted to the end."""
WORTH = 0.65
"""Share of the gap that a rival may leave in the linear prediction and still be re-fitted."""
DRAWS, SIZES = 8, (0.2, 1.5)
"""Starts of a rival: draws of its shape, and their sizes."""


@dataclass(frozen=True, eq=False)
class Rival:
    """Another effect on the records of a case.

    Attributes:
        effect: as it was fitted.
        rest: share of the gap (mean square) that it leaves on the test records; on the train records and by linear
            prediction where that ruled it out; infinite where no fit of it ends.
        counts: whether it is as good an answer as the true effect.
        ratio: its error on the test records over the noise floor; infinite where it was ruled out, not a number where
            no fit of it ends.
    """

    effect: Effect
    rest: float
    counts: bool
    ratio: float = np.inf


def find_rivals(case: Case, records: Records, seed: int, number: int = 0) -> list[Rival]:
    """All rivals of one effect of a case, the best first; the case's other effect stays beside them.

    Args:
        case: what was at work.
        records: of the case.
        seed: of the rivals' starts.
        number: of the effect.
    """
    floor, truth = records.noise_floor, case.effects[number]
    beside = tuple(effect for effect in case.effects if effect is not truth)
    if any(type(effect).alter is not Effect.alter for effect in beside):
        # its parameters are some of those that the nominal model lacks: they stand in the rivals' simulator
        robot = replace(case.truth(), lacks=truth.alter(case.robot).lacks)
        case, beside = replace(case, robot=robot, effects=(truth,)), ()
    model = refit_model(case, records)
    if beside:
        model, values = fit_with(case, records, beside, model)
        beside = tuple(e.with_values(v) for e, v in zip(beside, values, strict=True))
        own = case.truth().values
        model = replace(model, values={name: value for name, value in model.values.items() if name in own})
    rng = np.random.default_rng([seed, 2])
    true = replace(model, values=true_values(case.truth(), model.values))
    # the truth itself, simulated and fitted as its rivals are, does not always come down to the floor
    if type(truth).alter is Effect.alter:
        own = fit_with(case, records, (truth, *beside), true)[0].test
        floor = min(max(floor, own), FARTHEST * floor)
    noise = float(np.mean(Bench(case, records, lambda _: build(case.robot, case.effects)).clean_error() ** 2))
    screens = [_Screen(case, records, values, beside, noise) for values in (model, true)]
    found = []
    for kind in candidates(case.truth(), every=truth.name == UNKNOWN):
        for joint in range(case.robot.joints):
            if (kind.name, kind.place, joint) == (truth.name, truth.place, truth.joint):
                continue
            if any((kind.name, joint) == (effect.name, effect.joint) for effect in beside):
                continue
            if not kind.acts_at(screens[0].robot, joint):
                continue
            starts = _best_starts(screens, kind, joint, rng)
            start, left, _ = min(starts, key=lambda one: one[1])
            if left > WORTH:
                found.append(Rival(start, left, False))
                continue
            tried = [((s, *beside), model) for s, left, model in starts if left <= WORTH]
            fits = zip(fit_all(case, records, tried, rounds=LOOK), tried, strict=True)
            (fitted, values), (effects, _) = min(fits, key=lambda one: one[0][0].train)
            effects = tuple(e.with_values(v) for e, v in zip(effects, values, strict=True))
            if fitted.test < PROMISING * floor:
                fitted, values = fit_with(case, records, effects, fitted)
                effects = tuple(e.with_values(v) for e, v in zip(effects, values, strict=True))
            if not np.isfinite(fitted.test):
                found.append(Rival(effects[0], np.inf, False, np.nan))
                continue
            rest = float((fitted.test**2 - floor**2) / (model.test**2 - floor**2))
            counts = bool(fitted.test <= CLOSE * floor and rest < REST)
            found.append(Rival(effects[0], rest, counts, float(fitted.test / floor)))
    return sorted(found, key=lambda rival: rival.rest)


def fit_with(
    case: Case, records: Records, effects: tuple[Effect, ...], start: Refit
) -> tuple[Refit, list[dict[str, float]]]:
    """Today's simulator with effects, all re-fitted together; the second part holds the effects' fitted values."""
    return fit_all(case, records, [(effects, start)])[0]


def fit_all(
    case: Case, records: Records, starts: Sequence[tuple[tuple[Effect, ...], Refit]], *, rounds: int = ROUNDS
) -> list[tuple[Refit, list[dict[str, float]]]]:
    """The same from several starts, of the same effects with other values."""
    robot, effects = case.truth(), starts[0][0]
    values = [{f"{i}.{k}": v for i, e in enumerate(own) for k, v in e.values.items()} for own, _ in starts]
    moved = [f"{i}.{k}" for i, e in enumerate(effects) for k in _fitted(e)]
    given = [
        {**start.values, **{name: float(np.mean(own[name])) for name in moved}}
        for own, (_, start) in zip(values, starts, strict=True)
    ]
    # what stays and is the same for all need not be a number for each lane, nor a number at all
    differs = [n for n, v in values[0].items() if n not in moved and any(own[n] != v for own in values)]
    held = [{name: float(own[name]) for name in differs} for own in values]
    signed = [f"{i}.{k}" for i, e in enumerate(effects) for k in _fitted(e) if k in e.signed]

    def together(given: Mapping[str, np.ndarray]) -> Plant:
        own = {name: value for name, value in given.items() if name in robot.values}
        machine_of = robot.with_values({**dict.fromkeys(robot.lacks, 0.0), **own})
        moved = [
            type(e)(e.joint, {k: given.get(f"{i}.{k}", v) for k, v in e.values.items()})
            for i, e in enumerate(effects)
        ]
        for effect in moved:
            machine_of = effect.alter(machine_of)
        machine = machine_of.assemble(substeps=_substeps(moved))
        for effect in moved:
            effect.install(machine, machine_of)
        return machine

    fits = refit(together, given, case, records, signed=signed, held=held, rounds=rounds)
    return [
        (fit, [{k: fit.values[f"{i}.{k}"] for k in _fitted(e)} for i, e in enumerate(effects)])
        for fit in fits
    ]


def _substeps(effects: Sequence[Effect]) -> int:
    """Steps a sample that fits of effects need."""
    return max((effect.substeps for effect in effects), default=1)


def _fitted(effect: Effect) -> list[str]:
    """Keys of an effect's values that a fit moves."""
    return [key for key in (*effect.sized, *effect.shapes) if key in effect.values]


def candidates(robot: Robot, *, every: bool) -> list[type[Effect]]:
    """Formulas that the nominal model could have beside its own parameters: every one, or the first of name and place.

    What no name stands for must not be what another formula of a name explains.
    """
    found: dict[tuple[str, str, str], type[Effect]] = {}
    for name, kinds in sorted(CATALOGUE.items()):
        for kind in sorted(kinds, key=lambda kind: kind.__name__):
            if kind.fits(robot) and kind.alter is Effect.alter:
                found.setdefault((name, kind.place, kind.__name__ if every else ""), kind)
    return list(found.values())


def _best_starts(
    screens: "Sequence[_Screen]", kind: type[Effect], joint: int, rng: np.random.Generator
) -> list[tuple[Effect, float, Refit]]:
    """For each of several simulators the draw of an effect that promises most; all of them run side by side."""
    draws = [[kind.draw(rng, screen.robot, joint) for _ in range(DRAWS)] for screen in screens]
    starts = [[effect.scaled(size) for effect in own for size in SIZES] for own in draws]
    first, each = screens[0], DRAWS * len(SIZES)
    keys = list(starts[0][0].values)
    values = {f".{key}": np.array([float(s.values[key]) for own in starts for s in own]) for key in keys}
    for name in first.robot.values:
        values[name] = np.repeat([float(np.mean(screen.robot.values[name])) for screen in screens], each)

    def alone(given: Mapping[str, np.ndarray]) -> Plant:
        robot = first.robot.with_values({name: given[name] for name in first.robot.values})
        machine = first.machine(robot, kind.substeps)
        kind(joint, {key: given[f".{key}"] for key in keys}).install(machine, robot)
        return machine

    moved = Bench(first.case, first.records, alone).residuals(values)
    parts = np.split(moved, len(screens))
    return [screen.best_of(own, part) for screen, own, part in zip(screens, starts, parts, strict=True)]


class _Screen:
    """Linear prediction of what an effect would leave of the gap on the train records."""

    def __init__(
        self, case: Case, records: Records, model: Refit, beside: Sequence[Effect], noise: float
    ) -> None:
        self.case, self.model, self.beside, robot = case, model, beside, case.truth()
        robot = robot.with_values(dict.fromkeys(robot.lacks, 0.0)).with_values(model.values)
        self.robot, names = robot, free_parameters(case.truth())
        bench = Bench(case, records, lambda v: self.machine(robot.with_values(v)))
        sets = np.ones((len(names) + 1, len(names))) + STEP * np.eye(len(names) + 1)[:, 1:]
        moved = bench.residuals({n: robot.values[n] * sets[:, i] for i, n in enumerate(names)})
        self.base = moved[0]
        self.plane = np.linalg.qr((moved[1:] - moved[0]).T)[0]
        self.gap = self._beside_parameters(self.base)
        self.records = records
        self.noise = noise

    def best_of(self, starts: Sequence[Effect], moved: np.ndarray) -> tuple[Effect, float, Refit]:
        """The start that promises most, the share of the gap that it leaves, and the simulator that it is added to.

        Args:
            starts: effects.
            moved: residuals with each of them.
        """
        change = self._beside_parameters(moved - self.base)
        square = np.sum(change**2, axis=1) + 1e-9
        along = -(change @ self.gap) / square
        kind = type(starts[0])
        signed = set(kind.signed) & set(kind.sized)
        along = along if signed else np.maximum(along, 0.0)
        left = np.sum((self.gap + along[:, None] * change) ** 2, axis=1) / self.gap.size
        i = int(np.argmin(left))
        rest = (left[i] - self.noise) / (np.mean(self.gap**2) - self.noise)
        size = np.clip(along[i], -10.0, 10.0)
        return starts[i].scaled(float(size) if abs(size) > 1e-3 else 1e-3), float(rest), self.model

    def machine(self, robot: Robot, substeps: int = 1) -> Machine:
        """The machine of a robot with the effects that stay."""
        machine = robot.assemble(substeps=max(substeps, _substeps(self.beside)))
        for effect in self.beside:
            effect.install(machine, robot)
        return machine

    def _beside_parameters(self, residuals: np.ndarray) -> np.ndarray:
        """Residuals without what the simulator's own parameters can do."""
        return residuals - (residuals @ self.plane) @ self.plane.T


PAIR_SIZES = (0.5, 1.0, 2.0, 4.0)
"""Sizes, relative to the true one, from which an effect is fitted: alone it may have to do the other's work."""


@dataclass(frozen=True)
class Alone:
    """What one effect of a pair leaves without the other.

    Attributes:
        test: its error on the test records over that of both.
        train: the same on the train records.
    """

    test: float
    train: float


def with_only(case: Case, records: Records) -> dict[str, Alone] | None:
    """What each effect of a pair leaves without the other, by name; None where that cannot be said.

    The other's part may go unseen on the train records, or the re-fit's parameters may stand in for it. Nothing can be
    said where no fit ends, or where both together, fitted alike, do not come down to the noise.

    Args:
        case: with two effects.
        records: of the case.
    """
    both = _fitted_with(case, records, case.effects)
    if both is None or not both.test <= FARTHEST * records.noise_floor:
        return None
    found = {}
    for effect in case.effects:
        one = _fitted_with(case, records, (effect,))
        if one is None:
            return None
        floor = max(both.test, records.noise_floor)
        found[effect.name] = Alone(one.test / floor, float(np.sqrt(one.train / both.train)))
    return found


def _fitted_with(case: Case, records: Records, effects: tuple[Effect, ...]) -> Refit | None:
    """Best fit of the nominal model with some of a case's effects; None where none ends."""
    truth = case.truth()
    brought = {name for effect in effects for name in effect.alter(case.robot).lacks - case.robot.lacks}
    case = replace(case, robot=replace(truth, lacks=truth.lacks - brought), effects=())
    model, added = refit_model(case, records), tuple(e for e in effects if type(e).alter is Effect.alter)
    fits = [model]
    if added:
        true = replace(model, values=true_values(truth, model.values))
        starts = [(tuple(e.scaled(size) for e in added), m) for m in (model, true) for size in PAIR_SIZES]
        fits = [fit for fit, _ in fit_all(case, records, starts)]
    return min((fit for fit in fits if np.isfinite(fit.test)), key=lambda fit: fit.train, default=None)
