"""How hard a case is: what a re-fit leaves over the noise, and the size of an effect that gives a wanted level."""

from dataclasses import dataclass, replace

import numpy as np

from hybrid_id.blind.case import Case, Records, build, record, record_sizes
from hybrid_id.blind.refit import Bench, nominal_error, refit_model
from hybrid_id.errors import InputError

BANDS = {"strong": (3.2, 9.0), "medium": (1.6, 2.8), "weak": (1.18, 1.45)}
"""Ratio of re-fit to noise floor that is aimed at; a level's own limits are a little wider."""
QUICK = 3
"""Steps of the re-fits by which a size is found."""
FACTORS = np.geomspace(0.03, 8.0, 10)
"""Sizes that are tried, relative to the one drawn."""


@dataclass(frozen=True)
class Errors:
    """Normalised RMSE of today's simulator on the test records, as it stands and re-fitted on the train records.

    Attributes:
        nominal, refit: these.
        train: RMS error of the re-fit on the train records over that of the machine itself.
    """

    nominal: float
    refit: float
    train: float


@dataclass(frozen=True, eq=False)
class Graded:
    """A case of known difficulty.

    Attributes:
        case: with its effects in their final size.
        records: its records.
        errors: of today's simulator.
    """

    case: Case
    records: Records
    errors: Errors

    @property
    def ratio(self) -> float:
        """Re-fit over noise floor."""
        return self.errors.refit / self.records.noise_floor

    @property
    def level(self) -> str:
        """strong, medium, weak or none, as the format of cases defines them."""
        if not self.case.effects:
            return "none"
        return level_of(self.ratio)


def level_of(ratio: float) -> str:
    """Level of a ratio of re-fit to noise floor."""
    return "strong" if ratio >= 3 else "medium" if ratio >= 1.5 else "weak" if ratio >= 1.15 else "none"


def errors_of(case: Case, records: Records) -> Errors:
    """Errors of today's simulator."""
    found = refit_model(case, records)
    clean = float(np.mean(Bench(case, records, lambda _: build(case.robot, case.effects)).clean_error() ** 2))
    return Errors(nominal_error(case, records), found.test, float(np.sqrt(found.train / clean)))


def grade(case: Case) -> Graded:
    """Record a case and re-fit today's simulator."""
    records = record(case)
    return Graded(case, records, errors_of(case, records))


def scale_to_level(case: Case, wanted: str) -> Graded:
    """Scale all effects of a case by the one of `FACTORS` whose level comes next to the wanted one.

    All sizes are recorded side by side; as the level rises with the size, bisection decides which are re-fitted.
    """
    goal = float(np.sqrt(np.prod(BANDS[wanted])))
    made = record_sizes(replace(case, engine="in_house"), FACTORS)
    below, above, tried = -1, len(FACTORS), {}
    while above - below > 1:
        i = (below + above) // 2
        scaled = case.with_effects([effect.scaled(float(FACTORS[i])) for effect in case.effects])
        tried[i] = refit_model(scaled, made[i], rounds=QUICK).test / made[i].noise_floor
        if BANDS[wanted][0] <= tried[i] <= BANDS[wanted][1]:
            break
        below, above = (i, above) if tried[i] < goal else (below, i)
    known = [k for k, level in tried.items() if np.isfinite(level)]
    if not known:
        raise InputError("blind make: no size of the effect gives records that can be fitted")
    i = min(known, key=lambda k: abs(np.log(tried[k] / goal)))
    best = case.with_effects([effect.scaled(float(FACTORS[i])) for effect in case.effects])
    return Graded(best, made[i], errors_of(best, made[i])) if case.engine == "in_house" else grade(best)
