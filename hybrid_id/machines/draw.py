"""Draws a single drive or two links with something at work: the machine, its effects, its experiments, and their sizes.

A machine has one dominant effect, or two: of a clean one in a size that gives a wanted level. A messy one is the same
with several small effects, friction that drifts from record to record, encoders that are eccentric, miss counts and are
read a little apart, and at times a model file that lacks a part that the others stand in for. Sizes are found on the
machine itself: its records are made, the nominal model is re-fitted, and the size is put right.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations, islice
from typing import Any

import numpy as np

from hybrid_id.errors import InputError
from hybrid_id.machines.case import Case, Graded, Part, level_of, short
from hybrid_id.machines.effects import CATALOGUE, OUTSIDE, Effect
from hybrid_id.machines.effects.base import UNKNOWN
from hybrid_id.machines.effects.friction import PreslidingDahl, WithheldCoulomb
from hybrid_id.machines.experiments import SAMPLE_TIME, draw_campaign, noise_std
from hybrid_id.machines.physics.bench import Flaws, replay, run
from hybrid_id.machines.rivals import find_rivals
from hybrid_id.machines.robots import SYSTEMS, Robot, draw_robot
from hybrid_id.machines.score import SOUND
from hybrid_id.machines.trials import Measured, Simulator, Trials

LEVELS = {"strong": 0.4, "medium": 0.4, "weak": 0.2}
"""Levels of clean cases and how often each is drawn."""
BANDS = {"strong": (3.2, 9.0), "medium": (1.6, 2.8), "weak": (1.18, 1.45)}
"""Ratio of re-fit to noise floor that is aimed at; a level's own limits are a little wider."""
WRONG = 0.3
"""Nominal values of clean machines are wrong by up to this share, but where the simulator is right."""
PLAIN = 1.5
"""Error of wrong values over that of the re-fit, at least, where nothing else is wrong."""
LEAST, SEEN = 1.15, 1.1
"""Re-fit over noise of a case with effects, at least: on the test records, and on the train records, where those who
diagnose have to see it."""
NOISE = (0.002, 0.03)
"""Encoders' noise relative to the motion in the test records."""
ROUNDS, QUICK, BRIEF = 45, 6, 8
"""Evaluations of a re-fit: to the end, to find a size, and of a messy machine, whose fits start near their end."""

LENGTHS = (2100, 3500)
"""Shortest and longest record of messy machines [samples]."""
LEADERS = {"single": 1, "pair": 2, "unknown": 1}
"""Dominant effects of a machine, by family."""
CANDIDATES, ATTEMPTS = 2, 3
"""How many more effects may become dominant ones, and how many choices among all of them are tried."""
TRIES = 60
"""Draws of effects until enough go with each other, at most."""
FEWEST, MOST, SPARE = 3, 6, 2
"""Small effects of a machine, and how many more are drawn for those that do not show."""
OUTSIDE_SHARE = 0.3
"""Share of small effects that are outside the catalogue."""
SPREAD = (-0.33, 0.27)
"""Logarithm of the factor on what sets an effect's shape."""
LIFT, WANTED_LIFT = (0.10, 0.60), (0.14, 0.46)
"""Rise of the re-fit's error by a small effect alone, relative to the noise floor, and the one that is aimed at."""
LIFTED, FARTHEST_SIZE = 5, 3.4
"""Records of effects alone, at most, and the factor by which a size is put right between them, at most."""
DOMINANT, TWICE = 0.40, 2.0
"""Share of the gap that a dominant effect closes at least, and how many times that of the largest small one."""
WANTED_SHARE = {"single": (0.48, 0.83), "pair": (0.42, 0.5), "unknown": (0.58, 0.84)}
"""Shares of the gap that each dominant effect is to close, by family."""
ADDS = 0.11
"""Share of the gap that a dominant effect closes at least when it is added after a larger one."""
TRAIN_SHARE, SECOND_SHARE = 0.25, 0.12
"""Shares of the gap on the train records that the dominant effect that shows most there closes at least, and others."""
CORRECTIONS = 4
"""Sizes of the dominant effects that are measured, at most."""
HOPELESS = 0.085
"""Share of the gap of a dominant effect below which it is given up."""
WATCHED = 2
"""Small effects, the largest, whose share is watched meanwhile."""
IMITATED = 0.5
"""Share of the gap that a named effect may close where the dominant one is outside the catalogue."""
TANGLED = 0.17
"""Share of the gap by which the error may grow when an effect is added; beyond it, shares in an order say nothing."""
HARMLESS = 1.12
"""Error of the re-fit over that of the machine where nothing is missing, at most."""


def draw_drive(
    rng: np.random.Generator,
    name: str,
    family: str,
    effect: str | None,
    system: str | None,
    level: str,
    *,
    messy: bool,
) -> Graded | None:
    """One attempt at a machine; None where its effects do not come out as wanted.

    Raises:
        InputError: an effect that the system cannot have.
    """
    kinds = [k for kinds in (*CATALOGUE.values(), OUTSIDE) for k in kinds if set(k.systems) & set(SYSTEMS)]
    if not messy and effect is None and family not in SOUND:  # as often as others, whatever machine it needs
        some = [
            k for k in kinds if (k.name == UNKNOWN) == (family == UNKNOWN) and system in (None, *k.systems)
        ]
        effect = str(rng.choice(sorted({k.formula if k.name == UNKNOWN else k.name for k in some})))
    asked = [k for k in kinds if effect in (k.name, k.formula)]
    met = [s for s in SYSTEMS if system in (None, s) and (not effect or any(s in k.systems for k in asked))]
    if not met:
        raise InputError(f"blind make: {effect} cannot be met on a {system} machine; give another system")
    robot = draw_robot(rng, str(rng.choice(met)))
    leaders = _draw_leaders(rng, robot, family, asked, messy=messy)
    small = _draw_small(rng, robot, leaders) if messy and family not in SOUND else []
    if family not in SOUND and (len(leaders) < LEADERS[family] or (messy and len(small) < FEWEST + SPARE)):
        return None
    campaign = draw_campaign(rng, robot, lengths=LENGTHS if messy else None)
    case = _tuned(Case(name, robot, campaign), rng.uniform(*((0.12, 0.4) if messy else (0.15, 0.45))))
    if not messy:
        drift, withheld, wrong = np.ones((robot.joints, len(campaign.roles))), (), WRONG
    else:
        case = replace(case, campaign=_flawed(rng, case))
        spread = rng.uniform(0.008, 0.045, (robot.joints, 1))
        drift = 1 + spread * np.clip(rng.standard_normal((robot.joints, len(campaign.roles))), -2.0, 2.0)
        withheld = tuple(robot.name(i, "F_v") for i in range(robot.joints) if rng.random() < 0.4)
        wrong = rng.uniform(0.08, 0.32)
    if family == "none":
        wrong = 0.0
    about = _About(case, drift, withheld, wrong, messy)
    if family in SOUND:
        trials = about.trials(())
        made = trials.record([()], drift)
        floor = trials.floors([()], made)[0]
        base = trials.fit([Simulator(0, (), trials.true)], made, rounds=ROUNDS)[0]
        graded = about.graded(rng, trials, made[0], floor, base, ())
        shows = family == "none" or graded.nominal >= PLAIN * graded.refit
        return graded if shows and graded.refit <= (HARMLESS if messy else SEEN) * graded.floor else None
    return _mixed(rng, about, leaders, small, family, level)


def _draw_leaders(
    rng: np.random.Generator, robot: Robot, family: str, asked: Sequence[type[Effect]], *, messy: bool
) -> list[Effect]:
    """Effects that may dominate, of a messy machine more than are needed; one that is asked for comes first."""
    if family in SOUND:
        return []
    groups = [OUTSIDE] if family == UNKNOWN else [CATALOGUE[name] for name in sorted(CATALOGUE)]
    groups = [[k for k in sorted(kinds, key=lambda k: k.__name__) if k.fits(robot)] for kinds in groups]
    first = [kind for kind in asked if kind.fits(robot)]
    wanted = 1 if first and family != "pair" else LEADERS[family] + CANDIDATES * messy
    found: list[Effect] = []
    for _ in range(TRIES):
        kinds = first if first and not found else groups[rng.integers(len(groups))]
        if kinds:
            one = _drawn(rng, kinds[rng.integers(len(kinds))], robot, messy=messy)
            named = {effect.name for effect in found} - {UNKNOWN}
            if one.name not in named and _goes_with(one, found, robot):
                found.append(one)
        if len(found) == wanted:
            break
    return found


def _draw_small(rng: np.random.Generator, robot: Robot, leaders: Sequence[Effect]) -> list[Effect]:
    """Small effects, more than are needed, that go with all that may dominate."""
    inside = sorted((k for kinds in CATALOGUE.values() for k in kinds), key=lambda kind: kind.__name__)
    outside = sorted(OUTSIDE, key=lambda kind: kind.__name__)
    wanted, found = int(rng.integers(FEWEST, MOST + 1)) + SPARE, list(leaders)
    for _ in range(2 * TRIES):
        kinds = [k for k in (outside if rng.random() < OUTSIDE_SHARE else inside) if k.fits(robot)]
        one = _drawn(rng, kinds[rng.integers(len(kinds))], robot, messy=True)
        if _goes_with(one, found, robot):
            found.append(one)
        if len(found) == len(leaders) + wanted:
            break
    return found[len(leaders) :]


def _drawn(rng: np.random.Generator, kind: type[Effect], robot: Robot, *, messy: bool) -> Effect:
    """An effect at some joint, its shape in messy machines spread further, and never from a list."""
    one = kind.draw(rng, robot, int(rng.integers(robot.joints)))
    kept = {*kind.sized, "supply"} if messy else set(one.values)
    spread = {k: v * float(np.exp(rng.uniform(*SPREAD))) for k, v in one.values.items() if k not in kept}
    return one.with_values(spread)


def _goes_with(one: Effect, others: Sequence[Effect], robot: Robot) -> bool:
    """Whether an effect can act beside others, and is another than they are."""
    altered = robot
    for other in others:
        altered = other.alter(altered)
    if not one.acts_at(altered, one.joint) or (one.replaces and any(other.replaces for other in others)):
        return False
    for other in others:
        same = type(one) is type(other) or (one.name == other.name != UNKNOWN)
        dry = all(isinstance(e, PreslidingDahl | WithheldCoulomb) for e in (one, other))
        geared = one.place == other.place == "transmission"
        if other.joint == one.joint and (same or geared or dry):
            return False
    return all(other.acts_at(one.alter(altered), other.joint) for other in others)


def _tuned(case: Case, share: float) -> Case:
    """The case with encoders that suit its motion, and random torques that move the outputs by a share of their noise.

    Encoders are made coarser or finer by powers of two until their noise is within `NOISE` of the test records' motion.
    The share holds for four records of five, of the output that feels the torques most, on the machine without effects.
    """
    campaign, sound = case.campaign, case.robot.assemble(substeps=1)  # type: ignore[call-arg]
    volts, measured = run(sound, campaign.program, campaign.encoders, sample_time=SAMPLE_TIME)
    clean = replay(sound, volts, sample_time=SAMPLE_TIME, link=campaign.encoders.link)
    errors, spread, noise = [], [], noise_std(campaign.encoders)
    for b, length in enumerate(campaign.lengths):
        own = measured[:length, :, b]
        errors.append(np.mean((clean[:length, :, b] - own) ** 2, axis=0))
        if campaign.roles[b] == "test":
            spread.append(np.std(own, axis=0))
    floor = np.mean(noise / np.array(spread), axis=0)
    finer = 2.0 ** np.round(np.log2(np.clip(floor, *NOISE) / floor))
    quantum, jitter = finer * campaign.encoders.quantum, finer[:, None] * campaign.encoders.jitter
    felt = np.sqrt(np.maximum(np.array(errors) - noise**2, 1e-4 * noise**2)) / (finer * noise)
    factor = share / float(np.quantile(felt, 0.8, axis=0).max())
    program = replace(campaign.program, disturbance=factor * campaign.program.disturbance)
    encoders = replace(campaign.encoders, quantum=quantum, jitter=jitter)
    return replace(case, campaign=replace(campaign, program=program, encoders=encoders))


def _flawed(rng: np.random.Generator, case: Case) -> Any:
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


@dataclass(frozen=True, eq=False)
class _About:
    """A machine before its effects have their sizes.

    Attributes:
        case: without model.
        drift: factors on friction (n_joints, R).
        withheld: harmless parameters that the model file lacks.
        wrong: share by which nominal values are off, at most.
        messy: whether answers tell of what is small in it.
    """

    case: Case
    drift: np.ndarray
    withheld: tuple[str, ...]
    wrong: float
    messy: bool

    def trials(self, effects: Sequence[Effect]) -> Trials:
        """Trials with some effects."""
        return Trials(self.case.robot, effects, self.case.campaign)  # type: ignore[arg-type]

    def graded(
        self,
        rng: np.random.Generator,
        trials: Trials,
        measured: Measured,
        floor: Simulator,
        base: Simulator,
        parts: Sequence[Part],
    ) -> Graded:
        """The case with the nominal model, which lacks what effects withhold and what the others stand in for."""
        robot: Any = self.case.robot
        for part in parts:
            robot = part.effect.alter(robot)
        robot = robot.with_values({name: robot.values[name] for name in self.withheld}, withheld=True)
        case = replace(self.case, model=robot.model(rng, self.wrong))
        nominal = trials.having(()).errors([case.nominal()], [measured])[0]
        best = floor.test if parts else base.test
        level = level_of(base.test / floor.test) if parts else "none"
        notes = {"refit_over_floor_on_train_records": round(float(np.sqrt(base.train / floor.train)), 2)}
        about: dict[str, Any] = {
            "small_share": round(sum(p.shares["share"] for p in parts if p.shares["role"] == "small"), 4),
            "outside_share": round(sum(p.shares["share"] for p in parts if p.effect.name == UNKNOWN), 4),
            "dominant_outside": bool(parts) and parts[0].effect.name == UNKNOWN,
            "drift_of_friction": [short(std) for std in self.drift.std(axis=1)],
            "harmless_parameters_not_in_model": list(self.withheld),
        }
        encoders = self.case.campaign.encoders
        if encoders.flaws is not None:
            about["encoders"] = {
                "ripple_over_noise": [short(v) for v in encoders.flaws.ripple / noise_std(encoders)],
                "late_seconds": [short(v) for v in encoders.flaws.late * SAMPLE_TIME],
                "samples_with_missed_counts": short(np.mean(encoders.flaws.lost != 0)),
            }
        more = {"messy": about} if self.messy else {}
        return Graded(case, measured, nominal.test, base.test, best, floor.test, level, parts, notes, more)


def _mixed(
    rng: np.random.Generator,
    about: _About,
    candidates: list[Effect],
    small: list[Effect],
    family: str,
    level: str,
) -> Graded | None:
    """A machine with dominant effects, of a clean one in a level's size, of a messy one among small ones."""
    leaders, effects = LEADERS[family], [*candidates, *small]
    trials, kept = about.trials(effects), list[tuple[int, float, float]]()
    if about.messy:
        wanted = np.exp(rng.uniform(np.log(WANTED_LIFT[0]), np.log(WANTED_LIFT[1]), len(small)))
        lifted = _lifted(trials, about.drift, range(len(candidates), len(effects)), wanted, LIFT)
        kept = [(i, *size_and_lift) for i, size_and_lift in lifted.items()][: len(small) - SPARE]
        if len(kept) < FEWEST:
            return None
        kept.sort(key=lambda effect: -effect[2])
        goal = np.full(leaders, rng.uniform(*WANTED_SHARE[family]))
        # squares add up: of the gap that all small ones open, the leading ones are to close their share
        squares = sum((1 + lift) ** 2 - 1 for _, _, lift in kept) * goal / max(1 - goal.sum(), 0.07)
        lead = float(np.sqrt(1 + squares[0]) - 1)
        band = 0.4 * lead, 2.5 * lead
    else:
        goal = np.full(leaders, 1.0 / leaders)
        least, most = BANDS["medium" if leaders > 1 and level == "weak" else level]
        lead, band = float(np.sqrt(least * most) - 1), (least - 1, most - 1)
    wanted = np.full(len(candidates), lead)
    among = _lifted(trials, about.drift, range(len(candidates)), wanted, band)
    for leading in islice(combinations(among, leaders), ATTEMPTS):
        sizes = np.array([among[i][0] for i in leading] + [size for _, size, _ in kept])
        acting = about.trials([effects[i] for i in (*leading, *(i for i, _, _ in kept))])
        settled = _settled(acting, about.drift, sizes, goal, rounds=BRIEF if about.messy else ROUNDS)
        if settled is None:
            continue
        _, made, floor, base, _ = settled
        # a re-fit that has run away says nothing of how hard the case is
        if not LEAST * floor.test <= base.test < 5.0 or not base.train >= SEEN**2 * floor.train:
            continue
        parts = _parts(rng, acting, *settled, [lift for _, _, lift in kept])
        outside = sum(part.shares["share"] for part in parts if part.effect.name == UNKNOWN)
        if parts and (outside >= 0.5) == (family == UNKNOWN):
            return about.graded(rng, acting, made, floor, base, parts)
    return None


def _lifted(
    trials: Trials, drift: np.ndarray, numbers: Sequence[int], wanted: np.ndarray, band: Sequence[float]
) -> dict[int, tuple[float, float]]:
    """Size of each effect, and by how much it alone lifts the re-fit's error; none of those that stay beside a band.

    A lift that falls beside is put right by its growth with the square of the size.
    """
    count, sizes = len(trials.effects), dict.fromkeys(numbers, 1.0)
    aims, found = dict(zip(numbers, wanted, strict=True)), dict[int, tuple[float, float]]()
    for _ in range(LIFTED):
        left = [i for i in numbers if i not in found]
        if not left:
            break
        ones = [tuple(sizes[i] * (j == i) for j in range(count)) for i in left]
        made = trials.record(ones, drift)
        starts = [Simulator(n, (0.0,) * count, trials.true) for n in range(len(ones))]
        fits = trials.fit(starts, made, rounds=QUICK)
        for i, fit, floor in zip(left, fits, trials.floors(ones, made), strict=True):
            lift = fit.test / floor.test - 1
            if band[0] < lift < band[1]:
                found[i] = sizes[i], float(lift)
            elif np.isfinite(lift):
                factor = np.sqrt(aims[i] / max(lift, 1e-3))
                sizes[i] *= float(np.clip(factor, 1 / FARTHEST_SIZE, FARTHEST_SIZE))
            else:
                sizes[i] /= FARTHEST_SIZE
    return {i: found[i] for i in numbers if i in found}


def _settled(
    trials: Trials, drift: np.ndarray, sizes: np.ndarray, goal: np.ndarray, *, rounds: int
) -> tuple[np.ndarray, Measured, Simulator, Simulator, list[Simulator]] | None:
    """The mixture with leading effects so large that they dominate; None where they do not.

    Returns factors of all effects, records, the machine itself, the re-fitted model, and that with each leading effect.
    """
    count, leaders, values = len(sizes), len(goal), trials.true
    for _ in range(CORRECTIONS):
        watched = range(-1, min(leaders + WATCHED, count))
        having = [tuple(np.where(np.arange(count) == i, sizes, 0.0)) for i in watched]
        starts = [Simulator(0, own, values, free=(i - 1,) * (i > 0)) for i, own in enumerate(having)]
        made = trials.record([tuple(sizes)], drift)
        floor = trials.floors([tuple(sizes)], made)[0]
        base, *alone = trials.fit(starts, made, rounds=rounds)
        gap = base.test**2 - floor.test**2
        closes = np.array([(base.test**2 - one.test**2) / gap for one in alone])
        if not np.isfinite([floor.test, *closes]).all() or gap <= 0:
            return None
        own, next_one = closes[:leaders], closes[leaders:].max(initial=0.0)
        if own.min() >= max(DOMINANT, TWICE * next_one):
            trained = [(base.train - one.train) / (base.train - 1) for one in alone[:leaders]]
            seen = max(trained) >= TRAIN_SHARE and min(trained) >= SECOND_SHARE
            return (sizes, made[0], floor, base, alone[:leaders]) if seen else None
        if own.min() < HOPELESS:
            return None
        # shares grow with the square of the sizes, and what the leading ones leave is that of all others
        others = np.clip(1 - own.sum(), 0.05, 1.0) / max(1 - goal.sum(), 0.07) if count > leaders else 1.0
        sizes = sizes.copy()
        sizes[:leaders] *= np.clip(np.sqrt(goal / np.maximum(own, HOPELESS) * others), 0.55, 1.9)
        values = base.values
    return None


def _parts(
    rng: np.random.Generator,
    trials: Trials,
    sizes: np.ndarray,
    measured: Measured,
    floor: Simulator,
    base: Simulator,
    leading: Sequence[Simulator],
    lifts: Sequence[float],
) -> tuple[Part, ...]:
    """The effects in the order in which they are added, with their shares; none where a small one is too large.

    The leading ones come first, then the others by what each lifts alone. The share is the fall of the test mean square
    over the gap when an effect is added after all before it; with all of them the error is that of the machine itself.
    """
    count, leaders, made = len(sizes), len(leading), [measured]
    order = [*sorted(range(leaders), key=lambda i: leading[i].test), *range(leaders, count)]

    def having(some: Sequence[int], values: Any) -> Simulator:
        factors = tuple(float(sizes[j]) if j in some else 0.0 for j in range(count))
        return Simulator(0, factors, values, free=tuple(i for i in some if i < leaders))

    nested = [having(order[:k], trials.true) for k in range(2, count)]
    single = [having([i], base.values) for i in range(leaders, count)]
    fits = trials.fit([*nested, *single], made, rounds=QUICK)
    steps = [base, leading[order[0]], *fits[: len(nested)]][:count]
    alone = [*leading, *fits[len(nested) :]]
    gap, gap_train = base.test**2 - floor.test**2, base.train - 1
    closes = [(base.test**2 - one.test**2) / gap for one in alone]
    shares = dict(zip(order, -np.diff([*(one.test**2 for one in steps), floor.test**2]) / gap, strict=True))
    shares_train = dict(zip(order, -np.diff([*(one.train for one in steps), 1.0]) / gap_train, strict=True))
    if min(closes[:leaders]) < TWICE * max(closes[leaders:], default=0.0) or min(shares.values()) < -TANGLED:
        return ()
    if min(shares[i] for i in order[:leaders]) < ADDS:  # one does the other's work
        return ()
    parts = []
    for i in order:
        one, rivals = trials.effects[i].scaled(float(sizes[i])), []
        if i < leaders:
            # of two effects alone, each is judged with the other at work
            lacking = (base, leading[i]) if count != 2 else (leading[1 - i], floor)
            rivals = find_rivals(rng, trials, made, *lacking, i)
            imitated = max((1 - rival.rest for rival in rivals), default=0.0) * closes[i]
            if one.name == UNKNOWN and (imitated > IMITATED or any(rival.counts for rival in rivals)):
                return ()
        told = {
            "role": "dominant" if i < leaders else "small",
            "share": round(float(shares[i]), 4),
            "closes": round(float(closes[i]), 4),
            "closes_train": round(float((base.train - alone[i].train) / gap_train), 4),
            "share_train": round(float(shares_train[i]), 4),
        }
        lift = {} if i < leaders else {"lift": round(lifts[i - leaders], 3)}
        parts.append(Part(one, rivals, told | lift))
    return tuple(parts)
