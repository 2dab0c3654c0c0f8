"""From a seed to case folders with their answers beside them."""

import difflib
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from joblib import Parallel, delayed

from hybrid_id.blind.campaign import draw_campaign
from hybrid_id.blind.case import Case, runs_in_mujoco, tuned
from hybrid_id.blind.effects import CATALOGUE, OUTSIDE, Effect
from hybrid_id.blind.levels import BANDS, Graded, grade, scale_to_level
from hybrid_id.blind.rivals import find_rivals, with_only
from hybrid_id.blind.robots import SYSTEMS, Robot, draw_robot
from hybrid_id.blind.sheet import answers
from hybrid_id.errors import InputError
from hybrid_id.records.yaml_file import write_yaml

FAMILIES = {"single": 0.58, "pair": 0.14, "none": 0.14, "unknown": 0.14}
"""Families of cases and how often each is drawn."""
LEVELS = {"strong": 0.4, "medium": 0.4, "weak": 0.2}
WRONG = 0.3
"""Nominal values are wrong by up to this share."""
IN_MUJOCO = 0.5
"""Share of MuJoCo among the cases that it can run, where the engine is not given."""
NEEDED = 1.2
"""Re-fit with one effect of a pair alone over the noise floor, at least."""
DRAWS = 8
"""Machines that are tried for a case before it is given up."""


def make_case(
    seed: int,
    folder: str | Path,
    *,
    name: str | None = None,
    family: str | None = None,
    system: str | None = None,
    effect: str | None = None,
    level: str | None = None,
    engine: str | None = None,
    grading: bool = True,
) -> Path:
    """Make one case; what is not given is drawn.

    Args:
        seed: source of all that is random.
        folder: the case becomes a folder in it, its answers `answers/NAME.yaml`.
        name: of the case; `c` and the seed by default.
        family: single, pair, none or unknown.
        system: one_link, one_link_flexible or two_link.
        effect: name of the effect, or the first one of a pair; of the class for effects outside the catalogue.
        level: strong, medium or weak.
        engine: in_house or mujoco.
        grading: whether to look for other effects that explain the records as well; slower.

    Returns:
        The case's folder.

    Raises:
        InputError: a name is not known, or no machine could be drawn that the effect shows on.
    """
    _check(family=family, system=system, effect=effect, level=level, engine=engine)
    name = name or f"c{seed:03d}"
    family, level = _wish(seed, family, effect, level)
    for draw in range(DRAWS):
        rng = np.random.default_rng([seed, 1, draw])
        graded = _draw(rng, name, family, system, effect, level, engine)
        if graded is None:
            continue
        case, records, rivals, alone = graded.case, graded.records, [], {}
        if grading and len(case.effects) == 1:
            rivals = find_rivals(case, records, seed)
        if grading and len(case.effects) > 1:
            alone = with_only(case, records)
        named_after_all = family == "unknown" and any(rival.counts for rival in rivals)
        if named_after_all or any(ratio < NEEDED for ratio in alone.values()):
            continue
        sheet = answers(graded, family, (seed, draw), rivals=rivals, alone=alone)
        return _write(sheet, graded, Path(folder))
    raise InputError(
        f"case {name}: no machine of {DRAWS} shows {effect or family} at level {level}; give another level or seed"
    )


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
    """
    family, level = _wish(seed, family, effect, level)
    graded = _draw(np.random.default_rng([seed, 1, draw]), name, family, system, effect, level, engine)
    if graded is None:
        raise InputError(
            f"case {name} cannot be made again; its answers belong to another version of the generator"
        )
    return graded.case


def _wish(seed: int, family: str | None, effect: str | None, level: str | None) -> tuple[str, str]:
    """Family and level, drawn where they are not given."""
    rng = np.random.default_rng([seed, 0])
    family = family or ("single" if effect else str(rng.choice(list(FAMILIES), p=list(FAMILIES.values()))))
    return family, level or str(rng.choice(list(LEVELS), p=list(LEVELS.values())))


def make_cases(n: int, seed: int, folder: str | Path, *, jobs: int = 1, **options: Any) -> list[Path]:
    """Make n cases, seeds counted up from `seed`; options as in `make_case`. A case that fails is left out."""
    known = ("family", "system", "effect", "level", "engine")
    _check(**{option: options.get(option) for option in known})
    made = Parallel(n_jobs=jobs)(
        delayed(_attempt)(seed + i, folder, f"c{i + 1:03d}", options) for i in range(n)
    )
    return [path for path in made if path is not None]


def _attempt(seed: int, folder: str | Path, name: str, options: Mapping[str, Any]) -> Path | None:
    try:
        return make_case(seed, folder, name=name, **options)
    except InputError:
        return None


def _draw(
    rng: np.random.Generator,
    name: str,
    family: str,
    system: str | None,
    effect: str | None,
    level: str,
    engine: str | None,
) -> Graded | None:
    """One attempt at a case; None where its effects do not show as wanted."""
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
    campaign = draw_campaign(rng, robot)
    wish = engine or ("mujoco" if rng.random() < IN_MUJOCO else "in_house")
    if wish == "mujoco" and not runs_in_mujoco(robot, effects):
        if engine:
            return None
        wish = "in_house"
    case = Case(name, robot, (), campaign, _model(rng, robot, effects), wish)
    case = tuned(case, rng.uniform(0.15, 0.45))
    if not effects:
        sound = grade(case)
        return sound if sound.ratio <= 1.1 else None
    graded = []
    for one in effects:
        alone = case.with_effects([one])
        graded.append(scale_to_level(alone, "medium" if len(effects) > 1 and level == "weak" else level))
    if any(g.ratio < (1.15 if len(effects) == 1 else 1.4) or not np.isfinite(g.ratio) for g in graded):
        return None
    if len(effects) == 1:
        return graded[0]
    return grade(case.with_effects([e for g in graded for e in g.case.effects]))


def _formulas(
    rng: np.random.Generator, family: str, effect: str | None, system: str | None
) -> list[type[Effect]]:
    """Formulas of the effects of a case."""
    if family == "none":
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


def _model(rng: np.random.Generator, robot: Robot, effects: list[Effect]) -> dict[str, Any]:
    """Today's simulator of the robot, without what the effects withhold."""
    for effect in effects:
        robot = effect.alter(robot)
    return robot.model(rng, WRONG)


def _write(sheet: Mapping[str, Any], graded: Graded, folder: Path) -> Path:
    """Write a case and its answers; the folder appears only when it is complete."""
    case, path = graded.case, folder / graded.case.name
    if path.exists():
        raise InputError(f"{path} exists already; remove it or give another folder")
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder, prefix=".making-") as temporary:
        made = graded.records.dataset.save(Path(temporary) / case.name)
        write_yaml(made / "model.yaml", case.model)
        write_yaml(folder / "answers" / f"{case.name}.yaml", sheet)
        made.replace(path)
    return path


def _check(**given: str | None) -> None:
    """Refuse a name that is not known."""
    formulas = [kind.__name__ for kinds in (*CATALOGUE.values(), OUTSIDE) for kind in kinds]
    known = {
        "family": list(FAMILIES),
        "system": list(SYSTEMS),
        "effect": [*sorted(CATALOGUE), *sorted(formulas)],
        "level": list(BANDS),
        "engine": ["in_house", "mujoco"],
    }
    for option, value in given.items():
        if value is not None and value not in known[option]:
            close = difflib.get_close_matches(value, known[option], n=1)
            hint = f"did you mean '{close[0]}'?" if close else f"use one of {', '.join(known[option])}"
            raise InputError(f"blind make: {option} '{value}' is not known; {hint}")
