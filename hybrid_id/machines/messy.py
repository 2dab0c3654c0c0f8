"""Messy machines: one or two dominant effects among several small ones, and all that is imperfect beside them.

Friction drifts from record to record, encoders are eccentric, miss counts and are read a little apart, and the model
file sometimes lacks a part that the others stand in for. Sizes come from a linear prediction, then from the records of
the machine itself; a few steps of the secant method correct them.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, islice

import numpy as np

from hybrid_id.errors import InputError
from hybrid_id.machines.case import Case, logged, tuned
from hybrid_id.machines.effects import CATALOGUE, OUTSIDE, Effect
from hybrid_id.machines.effects.base import UNKNOWN
from hybrid_id.machines.effects.friction import PreslidingDahl, WithheldCoulomb
from hybrid_id.machines.experiments import draw_campaign, noise_std
from hybrid_id.machines.grading import STEP, Errors, Graded, nominal_error
from hybrid_id.machines.judge import SOUND
from hybrid_id.machines.mixtures import Fit, Measured, Mixtures, Simulator
from hybrid_id.machines.physics.bench import Flaws
from hybrid_id.machines.rivals import Rival, candidates
from hybrid_id.machines.robots import SYSTEMS, Robot, draw_robot

FAMILIES = {"single": 0.58, "pair": 0.21, "unknown": 0.21}
"""Families of messy machines: one dominant effect, two, or one outside the catalogue."""
LEADERS = {"single": 1, "pair": 2, "unknown": 1}
"""Dominant effects of a machine, by family."""
CANDIDATES, ATTEMPTS = 2, 3
"""How many more effects may become dominant ones, and how many choices among all of them are tried."""
TRIES = 60
"""Draws of effects until enough go with each other, at most."""
LENGTHS = (2100, 3500)
"""Shortest and longest record [samples]."""
FEWEST, MOST, SPARE = 3, 6, 2
"""Small effects of a machine, and how many more are drawn for those that do not show."""
OUTSIDE_SHARE = 0.3
"""Share of small effects that are outside the catalogue."""
LIFT = (0.10, 0.60)
"""Rise of the re-fit's error by a small effect alone, relative to the noise floor."""
WANTED_LIFT = (0.14, 0.46)
"""The same, as it is aimed at."""
DOMINANT, TWICE = 0.40, 2.0
"""Share of the gap that a dominant effect closes at least, and how many times that of the largest small one."""
SPREAD = (-0.33, 0.27)
"""Logarithm of the factor on what sets an effect's shape."""
WANTED_SHARE = {"single": (0.48, 0.83), "pair": (0.42, 0.5), "unknown": (0.58, 0.84)}
"""Shares of the gap that each dominant effect is to close, by family."""
ADDS = 0.11
"""Share of the gap that a dominant effect closes at least when it is added after a larger one."""
TRAIN_SHARE, SECOND_SHARE = 0.25, 0.12
"""Shares of the gap on the train records that the dominant effect that shows most there closes at least, and others."""
SIZES = np.geomspace(0.025, 9.0, 8)
"""Sizes that are tried in the linear prediction, relative to the one drawn."""
MEASURED, FARTHEST = 3, 3.4
"""Records of small effects alone, at most, and the factor by which a size is put right between them, at most."""
NEAR = 0.085
"""Distance of a share from the wanted one up to which a linear prediction is believed to reach it."""
CORRECTIONS = 3
"""Sizes of the dominant effects that are measured, at most."""
HOPELESS = 0.085
"""Share of the gap of a dominant effect below which it is given up."""
WATCHED = 2
"""Small effects, the largest, whose share is watched meanwhile."""
CLOSE, REST = 1.055, 0.1
"""A rival counts up to this error relative to the true effect's, and up to this share of what that closes left open."""
WORTH, RIVALS = 0.42, 5
"""Share of what the true effect closes that a rival promises at least, and how many are fitted."""
DRAWS = 6
"""Draws of a rival's shape."""
IMITATED = 0.5
"""Share of the gap that a named effect may close where the dominant one is outside the catalogue."""
TANGLED = 0.17
"""Share of the gap by which the error may grow when an effect is added; beyond it, shares in an order say nothing."""
RUNAWAY = 1e3
"""Error, relative to the signal, beyond which a prediction is bounded."""
HARMLESS = 1.12
"""Error of the re-fit over that of the machine where nothing is missing, at most."""


@dataclass(frozen=True)
class Part:
    """One effect of a messy machine.

    Attributes:
        effect: in its final size.
        role: dominant or small.
        closes: share of the gap on the test records that adding it alone closes.
        closes_train: the same on the train records, which are all that a diagnosis is chosen by.
        share: fall of the test mean square when it is added after all larger ones, over the gap.
        share_train: the same of the train mean square.
        lift: rise of the re-fit's error by it alone, relative to the noise floor; None of a dominant one.
        rivals: other effects in its place; none of a small one.
    """

    effect: Effect
    role: str
    closes: float
    closes_train: float
    share: float
    share_train: float
    lift: float | None
    rivals: tuple[Rival, ...]


@dataclass(frozen=True, eq=False)
class Messy:
    """A messy machine.

    Attributes:
        graded: its case, records and errors.
        parts: its effects, in the order in which they are added.
        drift: factors on friction (n_joints, R).
        withheld: harmless parameters that the model file lacks.
    """

    graded: Graded
    parts: tuple[Part, ...]
    drift: np.ndarray
    withheld: tuple[str, ...]


def family_of(seed: int, family: str | None, effect: str | None) -> str:
    """Family of a messy machine, drawn where it is not given."""
    rng = np.random.default_rng([seed, 3])
    if family is None and effect:
        family = "unknown" if effect in {kind.__name__ for kind in OUTSIDE} else "single"
    return family or str(rng.choice(list(FAMILIES), p=list(FAMILIES.values())))


def same_machine(
    seed: int,
    draw: int,
    *,
    name: str,
    family: str,
    system: str | None = None,
    effect: str | None = None,
) -> Messy | None:
    """One of the machines that are drawn from a seed; None where it does not come out as wanted."""
    try:
        return draw_messy(np.random.default_rng([seed, 4, draw]), name, family, system, effect)
    except (InputError, np.linalg.LinAlgError):  # a record of numbers that are none
        return None


def draw_messy(
    rng: np.random.Generator, name: str, family: str, system: str | None, effect: str | None
) -> Messy | None:
    """One attempt at a messy machine; None where it does not come out as wanted.

    Raises:
        InputError: an effect that the system cannot have.
    """
    known = [kind for kinds in (*CATALOGUE.values(), OUTSIDE) for kind in kinds]
    asked = [kind for kind in known if effect in (kind.name, kind.__name__)]
    met = [s for s in SYSTEMS if system in (None, s) and (not effect or any(s in k.systems for k in asked))]
    if not met:
        raise InputError(f"blind make: {effect} cannot be met on a {system} machine; give another system")
    robot = draw_robot(rng, str(rng.choice(met)))
    leaders = [] if family in SOUND else _leaders(rng, robot, family, asked)
    small = [] if family in SOUND else _small(rng, robot, leaders)
    if family not in SOUND and (len(leaders) < LEADERS[family] or len(small) < FEWEST + SPARE):
        return None
    campaign = draw_campaign(rng, robot, lengths=LENGTHS)
    case = tuned(Case(name, robot, (), campaign, {}), rng.uniform(0.12, 0.4), substeps=1)
    case = replace(case, campaign=_flawed(rng, case))
    spread = rng.uniform(0.008, 0.045, (robot.joints, 1))
    drift = 1 + spread * np.clip(rng.standard_normal((robot.joints, len(campaign.roles))), -2.0, 2.0)
    names = [robot.name(i, "F_v") for i in range(robot.joints)]
    withheld = tuple(n for n in names if rng.random() < 0.4)
    wrong = 0.0 if family == "none" else rng.uniform(0.08, 0.32)
    if family in SOUND:
        return _sound(rng, case, drift, withheld, wrong, right_values=family == "none")
    return _mixed(rng, case, leaders, small, family, drift, withheld, wrong)


def _leaders(
    rng: np.random.Generator, robot: Robot, family: str, asked: Sequence[type[Effect]]
) -> list[Effect]:
    """Effects that may dominate, more than are needed; an effect that is asked for comes first, or alone."""
    groups = [OUTSIDE] if family == "unknown" else [CATALOGUE[name] for name in sorted(CATALOGUE)]
    groups = [[k for k in sorted(kinds, key=lambda k: k.__name__) if k.fits(robot)] for kinds in groups]
    first = [kind for kind in asked if kind.fits(robot)]
    wanted = 1 if first and family != "pair" else LEADERS[family] + CANDIDATES
    found: list[Effect] = []
    for _ in range(TRIES):
        kinds = first if first and not found else groups[rng.integers(len(groups))]
        if kinds:
            one = _drawn(rng, kinds[rng.integers(len(kinds))], robot)
            if _goes_with(one, found, robot):
                found.append(one)
        if len(found) == wanted:
            break
    return found


def _small(rng: np.random.Generator, robot: Robot, leaders: Sequence[Effect]) -> list[Effect]:
    """Small effects, more than are needed, that go with all that may dominate."""
    inside = sorted((k for kinds in CATALOGUE.values() for k in kinds), key=lambda kind: kind.__name__)
    outside = sorted(OUTSIDE, key=lambda kind: kind.__name__)
    wanted, found = int(rng.integers(FEWEST, MOST + 1)) + SPARE, list(leaders)
    for _ in range(TRIES):
        kinds = outside if rng.random() < OUTSIDE_SHARE else inside
        kind = kinds[rng.integers(len(kinds))]
        if kind.fits(robot):
            one = _drawn(rng, kind, robot)
            if _goes_with(one, found, robot):
                found.append(one)
        if len(found) == len(leaders) + wanted:
            break
    return found[len(leaders) :]


def _drawn(rng: np.random.Generator, kind: type[Effect], robot: Robot) -> Effect:
    """An effect at some joint, its shape spread further than that of clean cases, and never from a list."""
    one = kind.draw(rng, robot, int(rng.integers(robot.joints)))
    kept = {*kind.sized, "supply"}
    spread = {k: v * float(np.exp(rng.uniform(*SPREAD))) for k, v in one.values.items() if k not in kept}
    return one.with_values(spread)


def _goes_with(one: Effect, others: Sequence[Effect], robot: Robot) -> bool:
    """Whether an effect can act beside others, and is another than they are."""
    altered = robot
    for other in others:
        altered = other.alter(altered)
    if not one.acts_at(altered, one.joint) or (one.replaces and any(other.replaces for other in others)):
        return False
    dry = (PreslidingDahl, WithheldCoulomb)
    for other in others:
        if other.joint != one.joint:
            continue
        same = type(one) is type(other) or (one.name == other.name != UNKNOWN)
        if (
            same
            or one.place == other.place == "transmission"
            or (isinstance(one, dry) and isinstance(other, dry))
        ):
            return False
    return all(other.acts_at(one.alter(altered), other.joint) for other in others)


def _flawed(rng: np.random.Generator, case: Case):
    """The experiments with encoders that are eccentric, miss counts, and are read a little apart."""
    campaign = case.campaign
    encoders, noise = campaign.encoders, noise_std(campaign.encoders)
    samples, outputs, lanes = encoders.jitter.shape
    lost = np.zeros((samples, outputs, lanes))
    for i in range(outputs):
        for b in range(lanes):
            for _ in range(rng.poisson(rng.uniform(0.0, 1.5))):
                start = rng.integers(60, samples)
                counts = rng.choice([-1, 1]) * rng.integers(1, 3)
                lost[start : start + rng.integers(15, 220), i, b] += counts * encoders.quantum[i]
    late = np.zeros(outputs)
    if outputs > 1:  # one channel alone that is late is a delay
        late[rng.integers(outputs)] = rng.uniform(0.05, 0.45)
    flaws = Flaws(noise * rng.uniform(0.05, 0.4, outputs), rng.uniform(-np.pi, np.pi, outputs), late, lost)
    return replace(campaign, encoders=replace(encoders, flaws=flaws))


def _model(
    rng: np.random.Generator, robot: Robot, effects: Sequence[Effect], withheld: Sequence[str], wrong: float
):
    """Today's simulator, without what effects withhold and without what the others stand in for."""
    for effect in effects:
        robot = effect.alter(robot)
    return robot.with_values({name: robot.values[name] for name in withheld}, withheld=True).model(rng, wrong)


def _sound(
    rng: np.random.Generator,
    case: Case,
    drift: np.ndarray,
    withheld: tuple[str, ...],
    wrong: float,
    *,
    right_values: bool,
) -> Messy | None:
    """A machine whose structure is that of its simulator."""
    mixtures = Mixtures(case.robot, (), case.campaign)
    made = mixtures.record([()], drift)
    floor = float(mixtures.floors([()], made)[0])
    fit = mixtures.fit([Simulator(0, (), mixtures.true)], made, rounds=12)[0]
    case = replace(case, model=_model(rng, case.robot, (), withheld, wrong))
    graded = _graded(case, made[0], fit, floor)
    if not fit.test <= HARMLESS * floor or (not right_values and graded.errors.nominal < 1.5 * fit.test):
        return None
    return Messy(graded, (), drift, withheld)


def _mixed(
    rng: np.random.Generator,
    case: Case,
    candidates: list[Effect],
    small: list[Effect],
    family: str,
    drift: np.ndarray,
    withheld: tuple[str, ...],
    wrong: float,
) -> Messy | None:
    """A machine with dominant and small effects."""
    leaders, effects = LEADERS[family], [*candidates, *small]
    mixtures = Mixtures(case.robot, effects, case.campaign)
    forecast = _Forecast(mixtures, drift)
    wanted = np.exp(rng.uniform(np.log(WANTED_LIFT[0]), np.log(WANTED_LIFT[1]), len(effects)))
    sizes = np.array([forecast.size_for(i, lift) or 0.0 for i, lift in enumerate(wanted)])
    sizes[: len(candidates)] = 0.0
    shown = np.flatnonzero(sizes)[: len(small)]
    if len(shown) < FEWEST:
        return None
    goal = np.full(leaders, rng.uniform(*WANTED_SHARE[family]))
    among = np.where(np.isin(np.arange(len(sizes)), shown[: len(small) - SPARE]), sizes, 0.0)
    if next(forecast.leads(among, len(candidates), goal), None) is None:
        return None
    lifts = dict(zip(shown, _alone(mixtures, drift, shown, sizes[shown], wanted[shown]), strict=True))
    kept = [(i, one) for i, one in lifts.items() if one is not None][: len(small) - SPARE]
    if len(kept) < FEWEST:
        return None
    kept.sort(key=lambda pair: -pair[1][1])
    among = np.zeros(len(effects))
    for i, (size, _) in kept:
        among[i] = size
    lift = [None] * leaders + [lift for _, (_, lift) in kept]
    for leading, sizes in islice(forecast.leads(among, len(candidates), goal), ATTEMPTS):
        acting = [*leading, *(i for i, _ in kept)]
        mixtures = Mixtures(case.robot, [effects[i] for i in acting], case.campaign)
        found = _settled(mixtures, drift, sizes[acting], leaders, goal)
        parts = _parts(rng, mixtures, found, lift, leaders) if found else ()
        outside = sum(part.share for part in parts if part.effect.name == UNKNOWN)
        if found and parts and (outside >= 0.5) == (family == "unknown"):
            final = tuple(part.effect for part in parts)
            case = replace(case, effects=final, model=_model(rng, case.robot, final, withheld, wrong))
            return Messy(_graded(case, found.made, found.base, found.floor), parts, drift, withheld)
    return None


def _graded(case: Case, made: Measured, fit: Fit, floor: float) -> Graded:
    """The records as they are written, and the errors of the nominal model."""
    records = replace(logged(case, made.volts, made.angles, made.angles), noise_floor=floor)
    return Graded(case, records, Errors(nominal_error(case, records), fit.test, float(np.sqrt(fit.train))))


class _Forecast:
    """What effects of any size would add to the re-fit's error, by linear prediction from the machine without them."""

    def __init__(self, mixtures: Mixtures, drift: np.ndarray) -> None:
        self.mixtures, count = mixtures, len(mixtures.effects)
        nothing = (0.0,) * count
        self.made = mixtures.record([nothing], drift)
        base = Simulator(0, nothing, mixtures.true)
        names = list(mixtures.true)
        moved = [replace(base, values={**base.values, n: base.values[n] * (1 + STEP)}) for n in names]
        sized = [
            replace(base, sizes=tuple(float(s) if j == i else 0.0 for j in range(count)))
            for i in range(count)
            for s in SIZES
        ]
        angles = mixtures.responses([base, *moved, *sized], self.made)
        lengths, logged_angles = mixtures.campaign.lengths, self.made[0].angles
        train, test, self.floor = [], [], []
        for b, length in enumerate(lengths):
            own, real = angles[:length, :, :, b], logged_angles[:length, :, b]
            change = (own[:, :, 1:] - own[:, :, :1]) / np.hypot(mixtures.noise, 1e-3 * real.std(axis=0))[
                :, None
            ]
            if b in mixtures.train:
                train.append(change.reshape(-1, change.shape[-1]))
                continue
            scale = real.std(axis=0) * np.sqrt(length)
            for o in range(real.shape[1]):
                test.append((own[:, o, 1:] - own[:, o, :1]) / scale[o])
                self.floor.append(np.sum((own[:, o, 0] - real[:, o]) ** 2) / scale[o] ** 2)
        rows = np.nan_to_num(np.concatenate(train), nan=1e6, posinf=1e6, neginf=-1e6)
        plane, effect = rows[:, : len(names)], rows[:, len(names) :]
        moves = np.linalg.lstsq(plane, effect, rcond=None)[0]
        left = [part[:, len(names) :] - part[:, : len(names)] @ moves for part in test]
        bounded = [np.nan_to_num(np.clip(part, -RUNAWAY, RUNAWAY), nan=RUNAWAY) for part in left]
        self.products = np.array([part.T @ part for part in bounded])

    def error(self, sizes: np.ndarray) -> float:
        """Normalised RMSE of the re-fit on the test records."""
        among = np.flatnonzero(sizes)
        near = np.abs(np.log(SIZES / sizes[among, None])).argmin(axis=1)
        columns, factors = among * len(SIZES) + near, sizes[among] / SIZES[near]
        squares = self.floor + factors @ self.products[:, columns[:, None], columns] @ factors
        return float(np.mean(np.sqrt(np.maximum(squares, 0.0))))

    def leads(
        self, sizes: np.ndarray, candidates: int, goal: np.ndarray
    ) -> Iterator[tuple[tuple[int, ...], np.ndarray]]:
        """Yield those of the candidates that may dominate others of given sizes, and all sizes."""
        for leading in combinations(range(candidates), len(goal)):
            led = self.lead(sizes, leading, goal)
            if led is not None:
                yield leading, led

    def size_for(self, number: int, lift: float) -> float | None:
        """Size of an effect that alone lifts the error so far; None where none does."""
        tried = np.geomspace(SIZES[0], SIZES[-1], 60)
        sizes = np.zeros(len(self.mixtures.effects))
        floor, found = self.error(sizes), []
        for size in tried:
            sizes[number] = size
            found.append(self.error(sizes) / floor - 1)
        off = np.abs(np.log(np.maximum(found, 1e-9) / lift))
        best = int(np.nanargmin(off))
        return float(tried[best]) if off[best] < 0.25 else None

    def lead(self, sizes: np.ndarray, leading: Sequence[int], goal: np.ndarray) -> np.ndarray | None:
        """Sizes with which some effects each close a wanted share of the gap, beside others; None where none do."""
        sizes, tried, floor = sizes.copy(), np.geomspace(SIZES[0], SIZES[-1], 60), self.error(0.0 * sizes)
        for i in leading:
            sizes[i] = self.size_for(i, 1.0) or SIZES[len(SIZES) // 2]
        for last in (False, False, True):
            for i, wanted in zip(leading, goal, strict=True):
                own = sizes.copy()
                own[i] = 0.0
                without, squares = self.error(own) ** 2, []
                for size in tried:
                    own[i] = size
                    squares.append(self.error(own) ** 2)
                share = (np.array(squares) - without) / (np.array(squares) - floor**2)
                best = int(np.nanargmin(np.abs(share - wanted)))
                if last and (abs(share[best] - wanted) > NEAR or best in (0, len(tried) - 1)):
                    return None
                sizes[i] = tried[best]
        return sizes


def _alone(
    mixtures: Mixtures, drift: np.ndarray, small: np.ndarray, sizes: np.ndarray, wanted: np.ndarray
) -> list[tuple[float, float] | None]:
    """Size of each small effect and its lift alone, from records of its own; None where it stays beside `LIFT`.

    A lift that falls beside is put right by its growth with the square of the size.
    """
    count, sizes = len(mixtures.effects), sizes.copy()
    found: list[tuple[float, float] | None] = [None] * len(small)
    for _ in range(MEASURED):
        beside = [k for k, one in enumerate(found) if one is None]
        ones = [tuple(np.where(np.arange(count) == small[k], sizes[k], 0.0)) for k in beside]
        made = mixtures.record(ones, drift)
        floors = mixtures.floors(ones, made)
        starts = [Simulator(n, (0.0,) * count, mixtures.true) for n in range(len(ones))]
        for k, fit, floor in zip(beside, mixtures.fit(starts, made, rounds=4), floors, strict=True):
            lift = float(fit.test / floor - 1)
            if LIFT[0] < lift < LIFT[1]:
                found[k] = (float(sizes[k]), lift)
            elif np.isfinite(lift):
                sizes[k] *= np.clip(np.sqrt(wanted[k] / max(lift, 1e-3)), 1 / FARTHEST, FARTHEST)
        if None not in found:
            break
    return found


@dataclass(frozen=True, eq=False)
class _Found:
    """A mixture whose leading effects dominate.

    Attributes:
        sizes: factor of each effect.
        made: its records.
        floor: error of the machine itself.
        base: the nominal model, re-fitted.
        alone: the same with each leading effect.
    """

    sizes: np.ndarray
    made: Measured
    floor: float
    base: Fit
    alone: list[Fit]


def _settled(
    mixtures: Mixtures, drift: np.ndarray, sizes: np.ndarray, leaders: int, goal: np.ndarray
) -> _Found | None:
    """The mixture with leading effects so large that they dominate; None where they do not."""
    count, values = len(sizes), mixtures.true
    for _ in range(CORRECTIONS):
        having = [tuple(np.where(np.arange(count) == i, sizes, 0.0)) for i in range(-1, leaders + WATCHED)]
        starts = [Simulator(0, own, values, free=(i - 1,) * (i > 0)) for i, own in enumerate(having)]
        made = mixtures.record([tuple(sizes)], drift)
        floor = float(mixtures.floors([tuple(sizes)], made)[0])
        base, *alone = mixtures.fit(starts, made, rounds=6)
        gap = base.test**2 - floor**2
        closes = np.array([(base.test**2 - one.test**2) / gap for one in alone])
        if not np.isfinite([floor, *closes]).all() or gap <= 0:
            return None
        own, next_one = closes[:leaders], closes[leaders:].max()
        if own.min() >= max(DOMINANT, TWICE * next_one):
            trained = [(base.train - one.train) / (base.train - 1) for one in alone[:leaders]]
            seen = max(trained) >= TRAIN_SHARE and min(trained) >= SECOND_SHARE
            return _Found(sizes, made[0], floor, base, alone[:leaders]) if seen else None
        if own.min() < HOPELESS:
            return None
        # shares grow with the square of the sizes, and what the leading ones leave is that of all others
        others = np.clip(1 - own.sum(), 0.05, 1.0) / max(1 - goal.sum(), 0.07)
        sizes = sizes.copy()
        sizes[:leaders] *= np.clip(np.sqrt(goal / np.maximum(own, HOPELESS) * others), 0.55, 1.9)
        values = base.simulator.values
    return None


def _parts(
    rng: np.random.Generator,
    mixtures: Mixtures,
    found: _Found,
    lifts: Sequence[float | None],
    leaders: int,
) -> tuple[Part, ...]:
    """The effects in the order in which they are added, with their shares; none where a small one is too large.

    The leading ones come first, then the others by what each lifts alone. The share is the fall of the test mean square
    over the gap when an effect is added after all before it; with all of them the error is that of the machine itself.
    """
    count, base, floor = len(found.sizes), found.base, found.floor
    gap = base.test**2 - floor**2
    order = [*sorted(range(leaders), key=lambda i: found.alone[i].test), *range(leaders, count)]

    def having(some: Sequence[int], values: dict) -> Simulator:
        sizes = tuple(float(found.sizes[j]) if j in some else 0.0 for j in range(count))
        return Simulator(0, sizes, values, free=tuple(i for i in some if i < leaders))

    nested = [having(order[:k], dict(mixtures.true)) for k in range(2, count)]
    single = [having([i], dict(base.simulator.values)) for i in range(leaders, count)]
    fits = mixtures.fit([*nested, *single], [found.made], rounds=4)
    errors = [base.test, found.alone[order[0]].test, *(fit.test for fit in fits[: len(nested)]), floor]
    shares = dict(zip(order, -np.diff(np.square(errors)) / gap, strict=True))
    squares = [base.train, found.alone[order[0]].train, *(fit.train for fit in fits[: len(nested)]), 1.0]
    shares_train = dict(zip(order, -np.diff(squares) / (base.train - 1), strict=True))
    alone = (*found.alone, *fits[len(nested) :])
    closes = [(base.test**2 - one.test**2) / gap for one in alone]
    trained = [(base.train - one.train) / (base.train - 1) for one in alone]
    if min(closes[:leaders]) < TWICE * max(closes[leaders:]) or min(shares.values()) < -TANGLED:
        return ()
    if min(shares[i] for i in order[:leaders]) < ADDS:  # one does the other's work
        return ()
    parts = []
    for i in order:
        one, rivals = mixtures.effects[i].scaled(float(found.sizes[i])), []
        if i < leaders:
            rivals = _rivals(rng, mixtures, [found.made], base, found.alone[i], one)
            imitated = max((1 - rival.rest for rival in rivals), default=0.0) * closes[i]
            if one.name == UNKNOWN and (imitated > IMITATED or any(rival.counts for rival in rivals)):
                return ()
        role = "dominant" if i < leaders else "small"
        closed = float(closes[i]), float(trained[i]), float(shares[i]), float(shares_train[i])
        parts.append(Part(one, role, *closed, lifts[i], tuple(rivals)))
    return tuple(parts)


def _rivals(
    rng: np.random.Generator, mixtures: Mixtures, made: list[Measured], base: Fit, own: Fit, truth: Effect
) -> list[Rival]:
    """Other effects that the nominal model may be given instead of a dominant one, the best first.

    A rival counts where it predicts the test records within 6 % of the error with the true effect and leaves less than
    a tenth of what that closes, all small effects missing from both.
    """
    bare = mixtures.bare
    lacking = mixtures.robot
    kinds = [
        (kind, joint)
        for kind in candidates(bare, every=truth.name == UNKNOWN)
        for joint in range(bare.joints)
        if kind.acts_at(lacking, joint)
        and (kind.name, kind.place, joint) != (truth.name, truth.place, truth.joint)
    ]
    drawn = [
        [kind.draw(rng, bare, joint) for _ in range(DRAWS if kind.shapes else 1)] for kind, joint in kinds
    ]
    tried = Mixtures(bare, [own_draws[0] for own_draws in drawn], mixtures.campaign, beside=mixtures.effects)
    nothing = (0.0,) * len(kinds)
    start = Simulator(0, nothing, base.simulator.values)
    moved = [replace(start, values={**start.values, n: v * (1 + STEP)}) for n, v in start.values.items()]
    rows = tried.residuals([start, *moved], made)
    plane = np.linalg.qr((rows[1:] - rows[0]).T)[0]
    gap = rows[0] - plane @ (plane.T @ rows[0])
    starts: dict[int, tuple[float, Simulator]] = {}
    grown: list[tuple[int, Simulator]] = []  # by the number of its kind
    for i, draws in enumerate(drawn):
        own_sizes = [
            replace(
                start,
                sizes=tuple(s if j == i else 0.0 for j in range(len(kinds))),
                shapes={
                    (i, key): float(np.mean(v)) for key, v in one.values.items() if not isinstance(v, str)
                },
            )
            for one in draws
            for s in (0.3, 1.1)
        ]
        starts[i] = (np.inf, own_sizes[0])
        grown += [(i, one) for one in own_sizes]
    for group in tried.alike([one.sizes for _, one in grown]):
        chosen = [grown[k] for k in group]
        changes = tried.residuals([one for _, one in chosen], made) - rows[0]
        for (i, one), change in zip(chosen, changes, strict=True):
            change = change - plane @ (plane.T @ change)
            square = float(change @ change) + 1e-9
            along = -float(change @ gap) / square
            kind = kinds[i][0]
            if not set(kind.signed) & set(kind.sized):
                along = max(along, 0.0)
            left = float(np.mean((gap + along * change) ** 2))
            if left < starts[i][0] and along:
                size = tuple(s * float(np.clip(along, -8.0, 8.0)) for s in one.sizes)
                starts[i] = (left, replace(one, sizes=size))
    closing = base.train - own.train
    promising = sorted((left, i) for i, (left, _) in starts.items() if base.train - left >= WORTH * closing)
    best = [
        replace(
            starts[i][1],
            free=(i,),
            free_shapes=tuple((i, k) for k in kinds[i][0].shapes if (i, k) in starts[i][1].shapes),
        )
        for _, i in promising[:RIVALS]
    ]
    found = []
    for (_, i), fit in zip(promising, tried.fit(best, made, rounds=4) if best else [], strict=False):
        one = tried.effects[i].with_values({key: v for (_, key), v in fit.simulator.shapes.items()})
        rest = float(1 - (base.test**2 - fit.test**2) / (base.test**2 - own.test**2))
        counts = bool(fit.test <= CLOSE * own.test and rest < REST)
        found.append(Rival(one.scaled(fit.simulator.sizes[i]), rest, counts, float(fit.test / own.test)))
    return sorted(found, key=lambda rival: rival.rest)
