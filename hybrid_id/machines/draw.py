"""Draws a case from a seed: machine, effects, experiments, and a size of the effects that gives the wanted level."""

from typing import Any

import numpy as np

from hybrid_id.errors import InputError
from hybrid_id.machines import messy
from hybrid_id.machines.case import Case, runs_in_mujoco, tuned
from hybrid_id.machines.effects import CATALOGUE, OUTSIDE, Effect
from hybrid_id.machines.experiments import draw_campaign
from hybrid_id.machines.grading import Graded, grade, scale_to_level
from hybrid_id.machines.judge import SOUND
from hybrid_id.machines.robots import SYSTEMS, Robot, draw_robot

FAMILIES = {"single": 0.58, "pair": 0.14, "none": 0.04, "parameters": 0.10, "unknown": 0.14}
"""Families of cases and how often each is drawn: one effect, two, a simulator that is right, one with wrong values and
nothing missing, and something at work that is outside the catalogue."""
LEVELS = {"strong": 0.4, "medium": 0.4, "weak": 0.2}
WRONG = 0.3
"""Nominal values are wrong by up to this share, but where the simulator is right."""
PLAIN = 1.5
"""Error of wrong values over that of the re-fit, at least, where nothing else is wrong."""
LEAST, SEEN = 1.15, 1.1
"""Re-fit over noise of a case with effects, at least: on the test records, and on the train records, where those who
diagnose have to see it."""
IN_MUJOCO = 0.5
"""Share of MuJoCo among the cases that it can run, where the engine is not given."""


def same_case(
    seed: int,
    draw: int,
    *,
    name: str = "again",
    family: str | None = None,
    system: str | None = None,
    effect: str | None = None,
    level: str | None = None,
    engine: str | None = None,
    realism: str = "clean",
) -> Case:
    """The machine and the experiments of a case once more, for experiments beyond them.

    Args:
        seed: of the case, as its answers tell.
        draw: which of the machines that were tried, as its answers tell.
        name: of the case.
        family: this and the rest as they were given to `make_case`.
        system: see there.
        effect: see there.
        level: see there.
        engine: see there.
        realism: see there; friction is that of no record.
    """
    if realism == "messy":
        family = messy.family_of(seed, family, effect)
        made = messy.same_machine(seed, draw, name=name, family=family, system=system, effect=effect)
        graded = None if made is None else made.graded
        return _known(graded, name).case
    family, level = family_and_level(seed, family, effect, level)
    graded = draw_case(np.random.default_rng([seed, 1, draw]), name, family, system, effect, level, engine)
    return _known(graded, name).case


def _known(graded: Graded | None, name: str) -> Graded:
    if graded is None:
        raise InputError(
            f"case {name} cannot be made again; its answers belong to another version of the generator"
        )
    return graded


def family_and_level(seed: int, family: str | None, effect: str | None, level: str | None) -> tuple[str, str]:
    """Family and level, drawn where they are not given."""
    rng = np.random.default_rng([seed, 0])
    if family is None and effect:
        family = "unknown" if effect in {kind.__name__ for kind in OUTSIDE} else "single"
    family = family or str(rng.choice(list(FAMILIES), p=list(FAMILIES.values())))
    return family, level or str(rng.choice(list(LEVELS), p=list(LEVELS.values())))


def draw_case(
    rng: np.random.Generator,
    name: str,
    family: str,
    system: str | None,
    effect: str | None,
    level: str,
    engine: str | None,
) -> Graded | None:
    """One attempt at a case; None where its effects do not show as wanted, or make the machine run away.

    Raises:
        InputError: an effect that the system cannot have.
    """
    kinds = _formulas(rng, family, effect, system)
    if system is None:
        common = [s for s in SYSTEMS if all(s in kind.systems for kind in kinds)]
        if not common:
            return None
        system = str(rng.choice(common))
    robot = draw_robot(rng, system)
    if not all(kind.fits(robot) for kind in kinds):
        return None
    effects = [kind.draw(rng, robot, int(rng.integers(robot.joints))) for kind in kinds]
    if len({e.where for e in effects}) < len(effects) or len({e.name for e in effects}) < len(effects):
        return None
    if not all(one.acts_at(other.alter(robot), one.joint) for one in effects for other in effects):
        return None
    campaign = draw_campaign(rng, robot)
    wish = engine or ("mujoco" if rng.random() < IN_MUJOCO else "in_house")
    if wish == "mujoco" and not runs_in_mujoco(robot, effects):
        if engine:
            return None
        wish = "in_house"
    wrong = 0.0 if family == "none" else WRONG
    case = Case(name, robot, (), campaign, _model(rng, robot, effects, wrong), wish)
    try:
        case = tuned(case, rng.uniform(0.15, 0.45))
        if not effects:
            sound = grade(case)
            shows = family == "none" or sound.errors.nominal >= PLAIN * sound.errors.refit
            return sound if sound.ratio <= 1.1 and shows else None
        graded = []
        for one in effects:
            alone = case.with_effects([one])
            graded.append(scale_to_level(alone, "medium" if len(effects) > 1 and level == "weak" else level))
        if not all(np.isfinite(g.ratio) and g.ratio >= (LEAST if len(effects) == 1 else 1.4) for g in graded):
            return None
        both = case.with_effects([e for g in graded for e in g.case.effects])
        found = graded[0] if len(graded) == 1 else grade(both)
    except InputError:  # a record of numbers that are none
        return None
    # a re-fit that has run away says nothing of how hard the case is
    sound = np.isfinite(found.ratio) and found.errors.refit <= found.errors.nominal
    return found if sound and found.ratio >= LEAST and found.errors.train >= SEEN else None


def _formulas(
    rng: np.random.Generator, family: str, effect: str | None, system: str | None
) -> list[type[Effect]]:
    """Formulas of the effects of a case."""
    if family in SOUND:
        return []
    if family == "unknown":
        return [_choose(rng, [k for k in OUTSIDE if effect in (None, k.__name__)], effect or family, system)]
    names = [n for n, kinds in sorted(CATALOGUE.items()) if any(system in (None, *k.systems) for k in kinds)]
    chosen = [effect or str(rng.choice(names))]
    if family == "pair":
        chosen.append(str(rng.choice([name for name in names if name != chosen[0]])))
    return [_choose(rng, _named(name), name, system) for name in chosen]


def _named(effect: str) -> list[type[Effect]]:
    """Formulas of a named effect, or the one formula of that name."""
    formulas = [kind for kinds in CATALOGUE.values() for kind in kinds]
    return CATALOGUE.get(effect) or [kind for kind in formulas if kind.__name__ == effect]


def _choose(
    rng: np.random.Generator, kinds: list[type[Effect]], effect: str, system: str | None
) -> type[Effect]:
    """One of the formulas that a system can have; by name, so that a seed means the same in every version."""
    kinds = sorted((k for k in kinds if system in (None, *k.systems)), key=lambda kind: kind.__name__)
    if not kinds:
        raise InputError(f"blind make: {effect} cannot be met on a {system} machine; give another system")
    return kinds[rng.integers(len(kinds))]


def _model(rng: np.random.Generator, robot: Robot, effects: list[Effect], wrong: float) -> dict[str, Any]:
    """Today's simulator of the robot, without what the effects withhold, its values off by a share."""
    for effect in effects:
        robot = effect.alter(robot)
    return robot.model(rng, wrong)
