"""From a seed to case folders with their answers beside them."""

import difflib
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from joblib import Parallel, delayed

from hybrid_id.errors import InputError, MachineError
from hybrid_id.machines import messy
from hybrid_id.machines.arms import case as arms
from hybrid_id.machines.arms.effects import KINDS as OF_ARMS
from hybrid_id.machines.arms.effects import OUTSIDE as OUTSIDE_OF_ARMS
from hybrid_id.machines.arms.motion import mujoco
from hybrid_id.machines.draw import FAMILIES, LEAST, SEEN, draw_case, family_and_level
from hybrid_id.machines.effects import CATALOGUE, OUTSIDE
from hybrid_id.machines.grading import BANDS
from hybrid_id.machines.ground_truth import ground_truth, messy_ground_truth
from hybrid_id.machines.judge import SOUND
from hybrid_id.machines.rivals import find_rivals, with_only
from hybrid_id.machines.robots import SYSTEMS
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.files import hidden_beside
from hybrid_id.records.yaml_file import write_yaml

NEEDED = 1.2
"""Re-fit with one effect of a pair alone over the error of both, at least, on the test records; on the train records,
where those who diagnose have to see it, `SEEN`."""
CLEAN, MESSY, ARMS = "clean", "messy", "arms"
"""Kinds of cases: one thing lacks, or a dominant one among small ones, or that in an arm of two to seven joints."""
MESSY_DRAWS = 22
"""Messy machines, and arms, that are tried for a case before it is given up."""
DESCRIPTION = "arm.xml"
"""File of an arm's description."""
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
    realism: str = CLEAN,
    grading: bool = True,
) -> Path:
    """Make one case; what is not given is drawn.

    Args:
        seed: source of all that is random.
        folder: the case becomes a folder in it, its answers `answers/NAME.yaml`.
        name: of the case; `c` and the seed by default.
        family: single, pair, none, parameters or unknown.
        system: one_link, one_link_flexible or two_link.
        effect: name of the effect, or the first one of a pair; of the class for effects outside the catalogue.
        level: strong, medium or weak.
        engine: in_house or mujoco.
        realism: clean, where nothing is at work beyond the family; or messy, where that is dominant among small ones,
            drift and imperfect encoders, and level and engine are not to be chosen; or arms, of two to seven joints in
            MuJoCo, as messy as that, where the system is not to be chosen either.
        grading: whether to look for other effects that explain the records as well; slower.

    Returns:
        The case's folder.

    Raises:
        InputError: a name is not known, or no machine could be drawn that the effect shows on.
    """
    _check(realism, family=family, system=system, effect=effect, level=level, engine=engine)
    name, asked = name or f"c{seed:03d}", level
    if realism == ARMS:
        return _make_arm(seed, Path(folder), name, family, effect)
    if realism == MESSY:
        return _make_messy(seed, Path(folder), name, family, system, effect)
    family, level = family_and_level(seed, family, effect, level)
    for draw in range(DRAWS):
        rng = np.random.default_rng([seed, 1, draw])
        graded = draw_case(rng, name, family, system, effect, level, engine)
        if graded is None:
            continue
        case, records, rivals, alone = graded.case, graded.records, [], None
        if grading and len(case.effects) > 1:
            alone = with_only(case, records)
            if alone is None or not all(a.test >= NEEDED and a.train >= SEEN for a in alone.values()):
                continue
        if grading:
            rivals = [find_rivals(case, records, seed, number) for number in range(len(case.effects))]
        # what a named effect explains but for less than is called an effect at all is not outside the catalogue
        if family == "unknown" and not all(rival.ratio >= LEAST for of_one in rivals for rival in of_one):
            continue
        truth = ground_truth(graded, family, (seed, draw), rivals=rivals, alone=alone)
        if asked in (None, truth["level"]):
            return _write(truth, graded.records.dataset, graded.case.model, Path(folder))
    raise InputError(
        f"case {name}: no machine of {DRAWS} shows {effect or family} at level {level}; give another level or seed"
    )


def _make_messy(
    seed: int, folder: Path, name: str, family: str | None, system: str | None, effect: str | None
) -> Path:
    """Make one messy machine."""
    family = messy.family_of(seed, family, effect)
    for draw in range(MESSY_DRAWS):
        made = messy.same_machine(seed, draw, name=name, family=family, system=system, effect=effect)
        if made is not None:
            truth = messy_ground_truth(made, family, (seed, draw))
            return _write(truth, made.graded.records.dataset, made.graded.case.model, folder)
    raise InputError(
        f"case {name}: no machine of {MESSY_DRAWS} has {effect or family} dominant; give another seed"
    )


def _make_arm(seed: int, folder: Path, name: str, family: str | None, effect: str | None) -> Path:
    """Make one arm."""
    family = arms.family_of(seed, family, effect)
    for draw in range(MESSY_DRAWS):
        made = arms.draw_arm_case(seed, draw, name, family, effect)
        if made is not None:
            model = {"robot": {"file": DESCRIPTION}}
            return _write(made.truth, made.dataset, model, folder, {DESCRIPTION: made.description})
    raise InputError(
        f"case {name}: no arm of {MESSY_DRAWS} has {effect or family} dominant; give another seed"
    )


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
    known = ("family", "system", "effect", "level", "engine")
    _check(options.get("realism", CLEAN), **{option: options.get(option) for option in known})
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


def _write(
    truth: Mapping[str, Any],
    dataset: Dataset,
    model: Mapping[str, Any],
    folder: Path,
    beside: Mapping[str, str] | None = None,
) -> Path:
    """Write a case, named like its dataset, and its answers; the folder appears only when it is complete."""
    path = folder / dataset.name
    if path.exists():
        raise InputError(f"{path} exists already; remove it or give another folder")
    folder.mkdir(parents=True, exist_ok=True)
    with hidden_beside(path) as temporary:
        made = dataset.save(temporary / path.name)
        write_yaml(made / "model.yaml", model)
        for file, text in (beside or {}).items():
            (made / file).write_text(text, encoding="utf-8")
        write_yaml(folder / "answers" / f"{path.name}.yaml", truth)
        made.replace(path)
    return path


def _check(realism: str = CLEAN, **given: str | None) -> None:
    """Refuse a kind of cases or a name that is not known, and what a kind of cases leaves no choice of."""
    if realism not in (CLEAN, MESSY, ARMS):
        raise InputError(f"blind make: realism '{realism}' is not known; use {CLEAN}, {MESSY} or {ARMS}")
    if realism == ARMS:
        if given["system"] or given["level"] or given["engine"]:
            raise InputError(
                "blind make: arms are of two to seven joints, in MuJoCo; leave --system, --level and --engine out"
            )
        mujoco()
    if realism == MESSY and (given["level"] or given["engine"] == "mujoco"):
        raise InputError(
            "blind make: messy machines have neither level nor MuJoCo; leave --level and --engine out"
        )
    unnamed = list(OUTSIDE_OF_ARMS) if realism == ARMS else [kind.__name__ for kind in OUTSIDE]
    formulas = [] if realism == ARMS else [kind.__name__ for kinds in CATALOGUE.values() for kind in kinds]
    known = {
        "family": list(arms.FAMILIES if realism == ARMS else FAMILIES),
        "system": list(SYSTEMS),
        "effect": [*sorted(OF_ARMS if realism == ARMS else CATALOGUE), *sorted((*formulas, *unnamed))],
        "level": list(BANDS),
        "engine": ["in_house", "mujoco"],
    }
    for option, value in given.items():
        if value is not None and value not in known[option]:
            close = difflib.get_close_matches(value, known[option], n=1)
            hint = f"did you mean '{close[0]}'?" if close else f"use one of {', '.join(known[option])}"
            raise InputError(f"blind make: {option} '{value}' is not known; {hint}")
    outside = given["effect"] in unnamed
    if (
        given["effect"]
        and given["family"] not in (None, *SOUND)
        and outside != (given["family"] == "unknown")
    ):
        where = (
            "outside the catalogue; leave family out"
            if outside
            else "in the catalogue; give family single or pair"
        )
        raise InputError(f"blind make: effect '{given['effect']}' is {where}")
    for option in ("effect", "level") if given["family"] in SOUND else ():
        if given[option] is not None:
            raise InputError(
                f"blind make: family '{given['family']}' has nothing at work; leave {option} out"
            )
