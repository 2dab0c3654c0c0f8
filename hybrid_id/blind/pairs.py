"""Whether a pair needs both of its effects: each alone, fitted as far as it goes, against both together."""

from dataclasses import dataclass, replace

import numpy as np

from hybrid_id.blind.case import Case, Records
from hybrid_id.blind.effects import Effect
from hybrid_id.blind.refit import Refit, refit_model, true_values
from hybrid_id.blind.rivals import FARTHEST, fit_all

SIZES = (0.5, 1.0, 2.0, 4.0)
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
    """Best fit of today's simulator with some of a case's effects; None where none ends."""
    truth = case.truth()
    brought = {name for effect in effects for name in effect.alter(case.robot).lacks - case.robot.lacks}
    case = replace(case, robot=replace(truth, lacks=truth.lacks - brought), effects=())
    model, added = refit_model(case, records), tuple(e for e in effects if type(e).alter is Effect.alter)
    fits = [model]
    if added:
        true = replace(model, values=true_values(truth, model.values))
        starts = [(tuple(e.scaled(size) for e in added), m) for m in (model, true) for size in SIZES]
        fits = [fit for fit, _ in fit_all(case, records, starts)]
    return min((fit for fit in fits if np.isfinite(fit.test)), key=lambda fit: fit.train, default=None)
