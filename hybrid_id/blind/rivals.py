"""Which other effects explain a case as well as the true one does: they count as right answers.

Each named effect is built into today's simulator in every place where it fits, and fitted with it to the train
records, from the simulator's re-fitted values and from the true ones: a re-fit that has been bent is no place to start.
A rival counts when it predicts the test records within 6 % of the true effect's error, fitted alike, and leaves less
than a tenth of the gap (mean square). Those that could close little of it even in the linear prediction are not fitted.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hybrid_id.blind.case import Case, Records, build
from hybrid_id.blind.effects import CATALOGUE, Effect
from hybrid_id.blind.physics.bench import Plant
from hybrid_id.blind.physics.integrator import Machine
from hybrid_id.blind.refit import STEP, Bench, Refit, free_parameters, refit, refit_model
from hybrid_id.blind.robots import Robot

CLOSE, REST = 1.06, 0.1
"""Largest error relative to the true effect's, and largest share of the gap left, of a rival that counts."""
FARTHEST = 1.15
"""Largest error of the true effect, fitted as its rivals are, over the noise floor, by which these are judged."""
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
            prediction where that ruled it out.
        counts: whether it is as good an answer as the true effect.
    """

    effect: Effect
    rest: float
    counts: bool


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
        # its parameters are some of those that today's simulator lacks: they stand in the rivals' simulator
        robot = replace(case.truth(), lacks=truth.alter(case.robot).lacks)
        case, beside = replace(case, robot=robot, effects=(truth,)), ()
    model = refit_model(case, records)
    if beside:
        model, values = fit_with(case, records, beside, model)
        beside = tuple(type(e)(e.joint, {**e.values, **v}) for e, v in zip(beside, values, strict=True))
        own = case.truth().values
        model = replace(model, values={name: value for name, value in model.values.items() if name in own})
    rng = np.random.default_rng([seed, 2])
    true = replace(model, values={name: float(np.mean(case.truth().values[name])) for name in model.values})
    # the truth itself, simulated and fitted as its rivals are, does not always come down to the floor
    if type(truth).alter is Effect.alter:
        own = fit_with(case, records, (truth, *beside), true)[0].test
        floor = min(max(floor, own), FARTHEST * floor)
    screens = [_Screen(case, records, values, beside) for values in (model, true)]
    found = []
    for kind in _candidates(case):
        for joint in range(case.robot.joints):
            if (kind.name, kind.place, joint) == (truth.name, truth.place, truth.joint):
                continue
            if any((kind.name, joint) == (effect.name, effect.joint) for effect in beside):
                continue
            if not kind.has_inertia(screens[0].robot, joint):
                continue
            starts = [(*screen.best_start(kind, joint, rng), screen.model) for screen in screens]
            start, left, _ = min(starts, key=lambda one: one[1])
            if left > WORTH:
                found.append(Rival(start, left, False))
                continue
            fits = [(*fit_with(case, records, (s, *beside), m), s) for s, left, m in starts if left <= WORTH]
            fitted, values, start = min(fits, key=lambda one: one[0].train)
            rest = (fitted.test**2 - floor**2) / (model.test**2 - floor**2)
            counts = fitted.test <= CLOSE * floor and rest < REST
            found.append(Rival(type(start)(joint, {**start.values, **values[0]}), float(rest), bool(counts)))
    return sorted(found, key=lambda rival: rival.rest)


def with_only(case: Case, records: Records) -> dict[str, float]:
    """What each effect of a pair leaves without the other: re-fit with it alone over the noise floor, by name."""
    model, found = refit_model(case, records), {}
    for effect in case.effects:
        if type(effect).alter is Effect.alter:
            fitted, _ = fit_with(case, records, (effect,), model)
        else:  # its parameters are some of those that today's simulator lacks
            lacks = case.truth().lacks - effect.alter(case.robot).lacks
            fitted = refit_model(case, records, lacks=lacks)
        found[effect.name] = fitted.test / records.noise_floor
    return found


def fit_with(
    case: Case, records: Records, effects: tuple[Effect, ...], start: Refit
) -> tuple[Refit, list[dict[str, float]]]:
    """Today's simulator with effects, all re-fitted together; the second part holds the effects' fitted values."""
    robot, signed = case.truth(), []
    values = dict(start.values)
    for i, effect in enumerate(effects):
        for key in _fitted(effect):
            values[f"{i}.{key}"] = float(np.mean(effect.values[key]))
            if key in effect.signed:
                signed.append(f"{i}.{key}")

    def together(given: Mapping[str, np.ndarray]) -> Plant:
        own = {name: value for name, value in given.items() if name in robot.values}
        machine_of = robot.with_values({**dict.fromkeys(robot.lacks, 0.0), **own})
        moved = [
            type(e)(e.joint, {**e.values, **{key: given[f"{i}.{key}"] for key in _fitted(e)}})
            for i, e in enumerate(effects)
        ]
        for effect in moved:
            machine_of = effect.alter(machine_of)
        machine = machine_of.assemble(substeps=1)
        for effect in moved:
            effect.install(machine, machine_of)
        return machine

    fitted = refit(together, values, case, records, signed=signed, rounds=5)
    return fitted, [{k: fitted.values[f"{i}.{k}"] for k in _fitted(e)} for i, e in enumerate(effects)]


def _fitted(effect: Effect) -> list[str]:
    """Keys of an effect's values that a fit moves."""
    return [key for key in (*effect.sized, *effect.shapes) if key in effect.values]


def _candidates(case: Case) -> list[type[Effect]]:
    """The first formula of each name and place that today's simulator could have beside its own parameters."""
    robot, found = case.truth(), {}
    for name, kinds in sorted(CATALOGUE.items()):
        for kind in sorted(kinds, key=lambda kind: kind.__name__):
            if kind.fits(robot) and kind.alter is Effect.alter:
                found.setdefault((name, kind.place), kind)
    return list(found.values())


class _Screen:
    """Linear prediction of what an effect would leave of the gap on the train records."""

    def __init__(self, case: Case, records: Records, model: Refit, beside: Sequence[Effect] = ()) -> None:
        self.case, self.model, self.beside, robot = case, model, beside, case.truth()
        robot = robot.with_values(dict.fromkeys(robot.lacks, 0.0)).with_values(model.values)
        self.robot, names = robot, free_parameters(case.truth())
        bench = Bench(case, records, lambda v: self._machine(robot.with_values(v)))
        sets = np.ones((len(names) + 1, len(names))) + STEP * np.eye(len(names) + 1)[:, 1:]
        moved = bench.residuals({n: robot.values[n] * sets[:, i] for i, n in enumerate(names)})
        self.base = moved[0]
        self.plane = np.linalg.qr((moved[1:] - moved[0]).T)[0]
        self.gap = self._beside_parameters(self.base)
        self.records = records
        true = Bench(case, records, lambda v: build(case.robot, case.effects))
        self.noise = float(np.mean(true.clean_error() ** 2))

    def best_start(self, kind: type[Effect], joint: int, rng: np.random.Generator) -> tuple[Effect, float]:
        """The draw of an effect that promises most, and the share of the gap that it leaves."""
        draws = [kind.draw(rng, self.robot, joint) for _ in range(DRAWS)]
        starts = [effect.scaled(size) for effect in draws for size in SIZES]
        values = {key: np.array([float(s.values[key]) for s in starts]) for key in starts[0].values}

        def alone(given: Mapping[str, np.ndarray]) -> Plant:
            machine = self._machine(self.robot)
            kind(joint, given).install(machine, self.robot)
            return machine

        moved = Bench(self.case, self.records, alone).residuals(values)
        change = self._beside_parameters(moved - self.base)
        square = np.sum(change**2, axis=1) + 1e-9
        along = -(change @ self.gap) / square
        signed = set(kind.signed) & set(kind.sized)
        along = along if signed else np.maximum(along, 0.0)
        left = np.sum((self.gap + along[:, None] * change) ** 2, axis=1) / self.gap.size
        i = int(np.argmin(left))
        rest = (left[i] - self.noise) / (np.mean(self.gap**2) - self.noise)
        size = np.clip(along[i], -10.0, 10.0)
        return starts[i].scaled(float(size) if abs(size) > 1e-3 else 1e-3), float(rest)

    def _machine(self, robot: Robot) -> Machine:
        """The machine of a robot with the effects that stay."""
        machine = robot.assemble(substeps=1)
        for effect in self.beside:
            effect.install(machine, robot)
        return machine

    def _beside_parameters(self, residuals: np.ndarray) -> np.ndarray:
        """Residuals without what the simulator's own parameters can do."""
        return residuals - (residuals @ self.plane) @ self.plane.T
