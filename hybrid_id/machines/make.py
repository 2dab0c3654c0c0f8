"""From a seed to case folders with their answers beside them."""

import difflib
import warnings
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from joblib import Parallel, delayed

from hybrid_id.errors import InputError, MachineError
from hybrid_id.machines.case import Graded, ground_truth
from hybrid_id.machines.draw import BANDS, LEVELS, draw_drive
from hybrid_id.machines.draw_arm import draw_arm_case
from hybrid_id.machines.effects import CATALOGUE, OUTSIDE
from hybrid_id.machines.robots import SYSTEMS
from hybrid_id.machines.score import SOUND
from hybrid_id.records.files import hidden_beside
from hybrid_id.records.yaml_file import write_yaml

CLEAN, MESSY, ARMS = "clean", "messy", "arms"
"""Kinds of cases: one thing lacks, or a dominant one among small ones, or that in an arm of two to seven joints."""
FAMILIES = {
    CLEAN: {"single": 0.58, "pair": 0.14, "none": 0.04, "parameters": 0.10, "unknown": 0.14},
    MESSY: {"single": 0.58, "pair": 0.21, "unknown": 0.21},
    ARMS: {"single": 0.775, "unknown": 0.125, "parameters": 0.10},
}
"""Families of each kind of cases and how often each is drawn: one effect, two, a simulator that is right, one with
wrong values and nothing missing, and something at work that is outside the catalogue."""
DRAWS = {CLEAN: 12, MESSY: 26, ARMS: 22}
"""Machines that are tried for a case before it is given up."""
NUMBERS = {CLEAN: 1, MESSY: 4, ARMS: 6}
"""Of the random numbers that a kind of cases is drawn from, beside the seed."""


def make_case(
    seed: int,
    folder: str | Path,
    *,
    name: str | None = None,
    family: str | None = None,
    system: str | None = None,
    effect: str | None = None,
    level: str | None = None,
    realism: str = CLEAN,
) -> Path:
    """Make one case; what is not given is drawn.

    Args:
        seed: source of all that is random.
        folder: the case becomes a folder in it, its answers `answers/NAME.yaml`.
        name: of the case; `c` and the seed by default.
        family: single, pair, none, parameters or unknown.
        system: one_link, one_link_flexible or two_link.
        effect: name of the effect, or the first one of a pair; of the formula for effects outside the catalogue.
        level: strong, medium or weak.
        realism: clean, where nothing is at work beyond the family; or messy, where that is dominant among small ones,
            drift and imperfect encoders, and level is not to be chosen; or arms, of two to seven joints in
            MuJoCo, as messy as that, where the system is not to be chosen either.

    Returns:
        The case's folder.

    Raises:
        InputError: a name is not known, or no machine could be drawn that the effect shows on.
    """
    given = {"family": family, "system": system, "effect": effect, "level": level}
    _check(realism, given)
    family, wanted = family_and_level(seed, realism, family, effect, level)
    name = name or f"c{seed:03d}"
    for draw in range(DRAWS[realism]):
        rng = np.random.default_rng([seed, NUMBERS[realism], draw])
        try:
            if realism == ARMS:
                graded = draw_arm_case(rng, name, family, effect)
            else:
                graded = draw_drive(rng, name, family, effect, system, wanted, messy=realism == MESSY)
        except np.linalg.LinAlgError:  # a record of numbers that are none
            continue
        if graded is not None and level in (None, graded.level):
            return _write(graded, ground_truth(graded, family, seed, draw), Path(folder))
    raise InputError(
        f"case {name}: no machine of {DRAWS[realism]} shows {effect or family} as it is wanted; give another seed"
        + (" or level" if realism == CLEAN else "")
    )


def family_and_level(
    seed: int, realism: str, family: str | None, effect: str | None, level: str | None
) -> tuple[str, str]:
    """Family and level, drawn where they are not given."""
    rng = np.random.default_rng([seed, 0])
    if family is None and effect:
        family = "unknown" if effect in {kind.formula for kind in OUTSIDE} else "single"
    chances = FAMILIES[realism]
    family = family or str(rng.choice(list(chances), p=list(chances.values())))
    return family, level or str(rng.choice(list(LEVELS), p=list(LEVELS.values())))


def make_cases(
    n: int,
    seed: int,
    folder: str | Path,
    *,
    first: int = 1,
    jobs: int = 1,
    done: Callable[[], object] | None = None,
    **options: Any,
) -> list[Path]:
    """Make n cases, seeds counted up from `seed`; a case that fails is left out, one that is there is kept.

    Args:
        n: how many.
        seed: of the case with number 1.
        folder: see `make_case`.
        first: number of the first of them.
        jobs: processes.
        done: called after each case.
        **options: see `make_case`.
    """
    given = dict.fromkeys(("family", "system", "effect", "level")) | options
    _check(str(given.pop("realism", CLEAN)), given)
    numbers = range(first, first + n)
    calls = (delayed(_attempt)(seed + i - 1, folder, f"c{i:03d}", options) for i in numbers)
    made = []
    for path in Parallel(n_jobs=jobs, return_as="generator")(calls):
        made.append(path)
        if done is not None:
            done()
    return [path for path in made if path is not None]


def _attempt(seed: int, folder: str | Path, name: str, options: Mapping[str, Any]) -> Path | None:
    if (Path(folder) / name).is_dir():
        return Path(folder) / name
    try:
        return make_case(seed, folder, name=name, **options)
    except (OSError, MemoryError, MachineError):  # not of the case, which comes with the next try
        raise
    except InputError:
        return None
    except Exception as error:  # a fault of ours, which is to lose this case alone, and to be seen
        warnings.warn(
            f"case {name} of seed {seed} is left out: {type(error).__name__}: {error}", stacklevel=2
        )
        return None


def _write(graded: Graded, truth: Mapping[str, Any], folder: Path) -> Path:
    """Write a case and its answers; the folder appears only when it is complete."""
    path = folder / graded.case.name
    if path.exists():
        raise InputError(f"{path} exists already; remove it or give another folder")
    folder.mkdir(parents=True, exist_ok=True)
    with hidden_beside(path) as temporary:
        made = graded.case.dataset(graded.measured).save(temporary / path.name)
        write_yaml(made / "model.yaml", graded.case.model)
        for file, text in graded.case.files.items():
            (made / file).write_text(text, encoding="utf-8")
        write_yaml(folder / "answers" / f"{path.name}.yaml", truth)
        made.replace(path)
    return path


def _check(realism: str, given: Mapping[str, str | None]) -> None:
    """Refuse a kind of cases or a name that is not known, and what a kind of cases leaves no choice of."""
    if realism not in FAMILIES:
        raise InputError(f"blind make: realism '{realism}' is not known; use {CLEAN}, {MESSY} or {ARMS}")
    if realism == ARMS:
        if given["system"] or given["level"]:
            raise InputError(
                "blind make: arms are of two to seven joints, in MuJoCo; leave --system and --level out"
            )
        if find_spec("mujoco") is None:
            raise InputError(
                "blind make: arms move in MuJoCo, which is not installed; "
                "install it with pip install 'hybrid_id[robots]'"
            )
    if realism == MESSY and given["level"]:
        raise InputError("blind make: messy machines have no level; leave --level out")
    systems = {"robot"} if realism == ARMS else set(SYSTEMS)
    inside = [kind for kinds in CATALOGUE.values() for kind in kinds if systems & set(kind.systems)]
    unnamed = sorted(kind.formula for kind in OUTSIDE if systems & set(kind.systems))
    known = {
        "family": list(FAMILIES[ARMS if realism == ARMS else CLEAN]),
        "system": list(SYSTEMS),
        "effect": [*sorted({k.name for k in inside}), *sorted(k.formula for k in inside), *unnamed],
        "level": list(BANDS),
    }
    for option, value in given.items():
        if value is not None and value not in known[option]:
            close = difflib.get_close_matches(value, known[option], n=1)
            hint = f"did you mean '{close[0]}'?" if close else f"use one of {', '.join(known[option])}"
            raise InputError(f"blind make: {option} '{value}' is not known; {hint}")
    effect, family, outside = given["effect"], given["family"], given["effect"] in unnamed
    if effect and family not in (None, *SOUND) and outside != (family == "unknown"):
        where = "outside the catalogue; leave family out"
        if not outside:
            where = "in the catalogue; give family single or pair"
        raise InputError(f"blind make: effect '{effect}' is {where}")
    for option in ("effect", "level") if family in SOUND else ():
        if given[option] is not None:
            raise InputError(f"blind make: family '{family}' has nothing at work; leave {option} out")
