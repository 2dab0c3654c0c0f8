"""Which other effects explain a case as well as the true one does: they count as right answers.

Each named effect is built into the re-fitted nominal model in every place where it fits. Those that promise to close
enough of the gap in the linear prediction are fitted with it to the train records. A rival counts when it predicts the
test records within 6 % of the true effect's error, fitted alike, and leaves less than a tenth of what that closes.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hybrid_id.machines.effects import CATALOGUE, Effect
from hybrid_id.machines.effects.base import UNKNOWN
from hybrid_id.machines.trials import STEP, Measured, Simulator, Trials

CLOSE, REST = 1.06, 0.1
"""Largest error relative to the true effect's, and largest share of the gap left, of a rival that counts."""
WORTH, RIVALS = 0.42, 5
"""Share of what the true effect closes that a rival promises at least, and how many are fitted."""
DRAWS, SIZES = 6, (0.3, 1.1)
"""Draws of a rival's shape, and the sizes in which each is tried."""
LONGEST = 8.5
"""Factor on a tried size by which a rival's fit starts, at most."""
ROUNDS = 8
"""Evaluations of a rival's fit."""


@dataclass(frozen=True, eq=False)
class Rival:
    """Another effect on the records of a case.

    Attributes:
        effect: as it was fitted.
        rest: share of what the true effect closes (mean square) that it leaves on the test records.
        counts: whether it is as good an answer as the true effect.
    """

    effect: Effect
    rest: float
    counts: bool


def find_rivals(
    rng: np.random.Generator,
    trials: Trials,
    measured: Sequence[Measured],
    base: Simulator,
    own: Simulator,
    number: int,
    *,
    on_train: bool = False,
) -> list[Rival]:
    """Other effects that the nominal model may be given instead of one of several, the best first.

    Args:
        rng: source of their values.
        trials: with all effects of the machine.
        measured: its records.
        base: the re-fitted simulator without the effect; what it has beside that stays, and is fitted, too.
        own: the same with the effect.
        number: of the effect.
        on_train: whether a rival has to be as good on the train records, too.
    """
    truth = trials.effects[number]
    beside = [i for i, size in enumerate(base.sizes) if size]
    taken = {(trials.effects[i].name, trials.effects[i].joint) for i in beside}
    # every formula that the nominal model could have, or the first of a name and place: what no name stands for must
    # not be what another formula of a name explains
    formulas = dict[tuple[str, str, str], type[Effect]]()
    for name, kinds_of_name in sorted(CATALOGUE.items()):
        for kind in sorted(kinds_of_name, key=lambda kind: kind.__name__):
            if kind.fits(trials.bare) and kind.alter is Effect.alter:
                formulas.setdefault((name, kind.place, kind.__name__ if truth.name == UNKNOWN else ""), kind)
    kinds = [
        (kind, joint)
        for kind in formulas.values()
        for joint in trials.joints
        if kind.acts_at(trials.robot, joint)
        and (kind.name, kind.place, joint) != (truth.name, truth.place, truth.joint)
        and (kind.name, joint) not in taken
    ]
    drawn = [
        [kind.draw(rng, trials.bare, k) for _ in range(DRAWS if kind.shapes else 1)] for kind, k in kinds
    ]
    stay = [trials.with_values(base, i) for i in beside]
    tried, count = trials.having([*(draws[0] for draws in drawn), *stay]), len(kinds)
    free = tuple(range(count, count + len(stay)))
    start = Simulator(base.number, (0.0,) * count + (1.0,) * len(stay), base.values)
    moved = [replace(start, values={**start.values, n: v * (1 + STEP)}) for n, v in start.values.items()]
    rows = tried.residuals([start, *moved], measured)
    plane = np.linalg.qr((rows[1:] - rows[0]).T)[0]
    gap = rows[0] - plane @ (plane.T @ rows[0])
    promising = []
    for i, draws in enumerate(drawn):
        sizes = [tuple(s if j == i else v for j, v in enumerate(start.sizes)) for s in SIZES]
        some = [
            replace(start, sizes=size, shapes={(i, key): float(np.mean(v)) for key, v in one.values.items()})
            for one in draws
            for size in sizes
        ]
        best = (np.inf, start)
        for one, row in zip(some, tried.residuals(some, measured), strict=True):
            change = row - rows[0]
            change = change - plane @ (plane.T @ change)
            along = -float(change @ gap) / (float(change @ change) + 1e-9)
            if not set(kinds[i][0].signed) & set(kinds[i][0].sized):
                along = max(along, 0.0)
            left = float(np.mean((gap + along * change) ** 2))
            if left < best[0] and along:
                grown = one.sizes[i] * float(np.clip(along, -LONGEST, LONGEST))
                best = (
                    left,
                    replace(one, sizes=tuple(grown if j == i else s for j, s in enumerate(one.sizes))),
                )
        if base.train - best[0] >= WORTH * (base.train - own.train):
            shapes = tuple((i, key) for key in kinds[i][0].shapes if (i, key) in best[1].shapes)
            promising.append((best[0], i, replace(best[1], free=(i, *free), free_shapes=shapes)))
    promising = sorted(promising, key=lambda one: one[0])[:RIVALS]
    found = []
    fits = tried.fit([one for *_, one in promising], measured, rounds=ROUNDS)
    for (_, i, _), fit in zip(promising, fits, strict=True):
        rest = (fit.test**2 - own.test**2) / (base.test**2 - own.test**2)
        counts = fit.test <= CLOSE * own.test and rest < REST
        if on_train:
            counts &= fit.train <= CLOSE**2 * own.train
        found.append(Rival(tried.with_values(fit, i), float(rest), bool(counts)))
    return sorted(found, key=lambda rival: rival.rest)
