"""What the chosen model leaves: how much of it is no noise, and whether the catalogue lacks something."""

from __future__ import annotations

import numpy as np

from hybrid_id.diagnosis.catalogue import over_angle
from hybrid_id.diagnosis.evidence import COLOURED, NEGLIGIBLE, coloured, negligible
from hybrid_id.diagnosis.explanation import Explanation
from hybrid_id.diagnosis.locate import Location
from hybrid_id.diagnosis.measure import Errors
from hybrid_id.diagnosis.ranking import LEFT_OPEN, is_explained
from hybrid_id.diagnosis.refit import STRAYED, WINDOW, Refit, engine
from hybrid_id.diagnosis.windows import window_errors
from hybrid_id.study.replays import batch_of

MOSTLY = 0.5
"""The same for test records, however small a part of the gap it is: more than half of what is left has a cause."""
SEEN = 4.0
"""Standard errors of white noise's colour from which errors over windows show that a model lacks something."""


def no_noise(chosen: Explanation, after: tuple[Location, ...], last: Errors) -> float:
    """Share of what a model leaves on the test records that a right one would not leave.

    That is what a torque of no name explains, or all that has colour where small random torques would leave less of it,
    or where no torque can be looked for: behind play.
    """
    if last.coloured > COLOURED or behind_play(chosen):
        return last.coloured
    share = max((one.share for one in after), default=0.0)
    return min(max(share, 0.0), coloured(chosen.result.residual))


def behind_play(chosen: Explanation) -> bool:
    """Whether a model has play, behind which nobody has measured where the link is."""
    return any("backlash" in key for key in chosen.system.components)


def halted_elsewhere(refit: Refit, base: Explanation, chosen: Explanation, last: Errors | None) -> bool:
    """Whether free runs over the test records are lost, although the model is right about them.

    A torque over the angle halts a free run at one detent or the next. Such a model is judged by windows that begin at
    measured states: of what the re-fitted model leaves there, it has to leave next to nothing.
    """
    if last is None or last.coloured <= COLOURED or not over_angle(chosen.effects) or behind_play(chosen):
        return False
    left = []
    for system in (base.system, chosen.system):
        batch = batch_of(refit.dataset, system, refit.dataset.test, refit.signal_share, "cpu")
        found = window_errors(system, engine(), batch, WINDOW)
        left.append(coloured(found) * sum(float(np.square(one).sum()) for one in found))
    seen = SEEN * sum(one.size for one in found) ** 0.5
    return left[0] > seen and left[1] < LEFT_OPEN * left[0]


def outside(chosen: Explanation, first: Errors | None, last: Errors | None, halted: bool = False) -> bool:
    """Whether the chosen model leaves something that the catalogue lacks.

    The test records count, too: a wrong formula may pass for a right one on the records that it has been fitted to.
    Not so behind play, whose fits end in ripples of their cost and predict other records no better than that. Beside an
    effect, what is left has to be a part of the gap that is worth a name, or more than the noise on records that the
    model follows, where no torque over the angle may halt it elsewhere; nothing where that is known (``halted``), and
    where errors are far below the noise and what a good model misses.
    """
    unseen = 0.0 if last is None or halted or behind_play(chosen) else last.coloured
    if negligible(chosen.result.residual) and max(last.over_noise.values() if last else (0.0,)) < NEGLIGIBLE:
        return False
    if is_explained(chosen) and unseen <= COLOURED:
        return False
    if not chosen.effects or first is None or last is None:
        return True
    if unseen > MOSTLY and last.nrmse < STRAYED and not over_angle(chosen.effects):
        return True
    return last.coloured * last.nrmse**2 > LEFT_OPEN * first.nrmse**2


def worst_unseen(chosen: Explanation, last: Errors | None, unknown: bool) -> str | None:
    """The test record that shows most of what the train records do not show.

    None where they show nothing else or the train records show it, too, where there is no other test record to bear out
    what explains it, behind play, and where a torque over the angle may halt a free run elsewhere, unless what is left
    is so much that the catalogue seems to lack its cause (``unknown``).
    """
    if last is None or last.coloured <= COLOURED or len(last.over_noise) < 2:
        return None
    if not is_explained(chosen) or behind_play(chosen) or (over_angle(chosen.effects) and not unknown):
        return None
    return max(last.over_noise, key=last.over_noise.__getitem__)
