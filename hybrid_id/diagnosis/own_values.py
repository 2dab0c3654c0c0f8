"""What joints of a robot claim, held against values of each record's own, all joints simulated.

A joint by itself takes the motion of the others as it was measured, with its noise, and one set of values for all
records. Where friction is another one in every record, what that does adds up along the motion of all joints, and a
joint takes a part of it for something missing. An effect that a robot lacks shows within a record, too.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from hybrid_id.diagnosis.catalogue import brought
from hybrid_id.diagnosis.criteria import CRITERIA
from hybrid_id.diagnosis.diagnose import Answer
from hybrid_id.diagnosis.grade import of_robot
from hybrid_id.diagnosis.model import FittedModel, Name
from hybrid_id.diagnosis.per_record import PerRecord, scatter, structural
from hybrid_id.diagnosis.starts import with_values_of
from hybrid_id.diagnosis.validation import mean_square
from hybrid_id.diagnosis.whole_robot import UNFITTED, WholeRobot, fitted, train_rows, without_effect
from hybrid_id.identification.horizons import Horizon
from hybrid_id.identification.keep import Kept
from hybrid_id.identification.result import FitResult
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.units import number_of, stem
from hybrid_id.systems.chain import System


@dataclass(frozen=True, eq=False)
class OwnValues:
    """A robot fitted to its train records together and to each by itself, its effects as the first fit has them.

    Attributes:
        common: the fit of all records.
        sets: the fit of each record.
        outputs: names of the outputs, in the order of the fits' columns.
    """

    common: FitResult
    sets: tuple[FitResult, ...]
    outputs: tuple[str, ...]

    def left(self, *joints: str) -> float:
        """Share of the structure in a joint's errors, or in those of several, that values of each record's own leave.

        Of the records in which one set leaves any, in their geometric mean, so that one which runs away from its own
        values does not decide; 0 where these values leave next to none.
        """
        if self.nothing_left(*joints):
            return 0.0
        together, records = self._of(joints, self.common), np.array(self.common.records)
        least, ratios = CRITERIA.negligible_structure**2, list[float]()
        for one in self.sets:
            pieces = [together[k] for k in np.flatnonzero(records == one.records[0])]
            if (common := structural(pieces)) > least:
                ratios.append(min(max(structural(self._of(joints, one)), least) / common, 1.0))
        return float(np.exp(np.log(ratios).mean())) if ratios else 1.0

    def explain(self, *joints: str) -> bool:
        """Whether values of each record's own explain what looks missing at a joint: little or no structure is left."""
        return self.left(*joints) <= CRITERIA.coloured

    def nothing_left(self, *joints: str) -> bool:
        """Whether these values leave next to no structure at a joint."""
        return self.structure(*joints) <= CRITERIA.negligible_structure**2

    def structure(self, *joints: str) -> float:
        """Mean square of what these values leave of a joint's motion that is no white noise, in noise variances."""
        return float(np.mean([structural(self._of(joints, one)) for one in self.sets]))

    def mean_square(self, *joints: str) -> float:
        """Mean square of all that these values leave of a joint's motion, in noise variances."""
        return mean_square([piece for one in self.sets for piece in self._of(joints, one)])

    def of_joint(self, *joints: str) -> list[FitResult]:
        """The records' fits with the parameters of one joint alone."""
        found = []
        for one in self.sets:
            infos = [one.system.parameter(name) for name in one.names]
            own = [k for k, info in enumerate(infos) if info.component.split("/")[0] in joints]
            names, jacobian = (one.names[k] for k in own), (part[..., own] for part in one.jacobian)
            found.append(replace(one, names=tuple(names), values=one.values[own], jacobian=tuple(jacobian)))
        return found

    def _of(self, joints: Collection[str], one: FitResult) -> list[np.ndarray]:
        columns = [
            k
            for k, n in enumerate(self.outputs)
            if f"joint{number_of(n)}" in joints and stem(n) in ("q_m", "q_a")
        ]
        return [piece[:, columns] for piece in one.residual]


def own_values(
    dataset: Dataset,
    system: System,
    effects: Collection[Name],
    horizon: Horizon,
    kept: Kept | None = None,
) -> OwnValues | None:
    """Fit a robot to its train records together and to each by itself; None where a fit fails or runs away.

    Args:
        dataset: of the joints that are simulated.
        system: their drives.
        effects: that it has: their parameters are those of all records.
        horizon: how long its free runs are.
        kept: fits that an earlier run has kept, and where these are kept.
    """
    found = list[FitResult]()
    try:
        batch = train_rows(dataset, system, horizon)
        common, names = fitted(system, batch, kept), np.array(batch.names)
        # by bounds that meet, so that compiled steps, which are made for what a fit estimates, are those of `common`
        fixed = {
            info.name: replace(
                info.spec, lower=info.spec.value, upper=info.spec.value, prior_mean=None, prior_std=None
            )
            for name, where in effects
            for info in brought(common.system, name, where).values()
        }
        for name in dict.fromkeys(batch.names):
            rows = torch.as_tensor(np.flatnonzero(names == name))
            found.append(fitted(common.system.with_specs(fixed), batch.take(rows), kept))
    except UNFITTED:
        return None
    return OwnValues(common, tuple(found), tuple(batch.outputs))


def helps(richer: OwnValues, simpler: OwnValues, *joints: str) -> bool:
    """Whether effects take enough of what records' own values leave at their joint, where that has structure."""
    if simpler.nothing_left(*joints):
        return False
    return richer.mean_square(*joints) <= (1.0 - CRITERIA.completing_fall) * simpler.mean_square(*joints)


def borne_out(robot: WholeRobot) -> dict[str, Answer]:
    """The joints' answers as the whole robot bears them out.

    Effects that take nothing of what each record's own values leave are dropped, one at a time, the smallest first.
    Where such values explain what is left, records differ and nothing is missing. Where something is, the probabilities
    of the others are those of a robot that lacks several things. Joints that were not diagnosed move as they were
    measured.
    """
    answers = robot.answers
    chosen = {name: one.found.chosen for name, one in answers.items()}
    unsure = [name for name, one in answers.items() if chosen[name].effects or one.grade.unknown]
    if not unsure or len(robot.dataset.train) < 2:
        return _rated(answers, {})

    def values(models: Mapping[str, FittedModel], near: OwnValues | None = None) -> OwnValues | None:
        # fitted from where the models stand, or from where other fits of the robot have ended, as far as these go
        effects = [name for one in models.values() for name in one.effects]
        system = robot.system(models)
        if near is not None:
            system = with_values_of(system, near.common.system) or system
        return own_values(robot.records, system, effects, robot.horizon, robot.kept)

    # without any effect first: that robot is one program, and often explains most joints
    plain = values({name: one.searched.base for name, one in answers.items()})
    nothing = [name for name in unsure if plain is not None and plain.nothing_left(*robot.keys(name))]
    chosen |= {name: answers[name].searched.base for name in nothing}
    now = plain if not any(one.effects for one in chosen.values()) else values(chosen)
    claimed = {
        name: [(e.name, e.where) for e in answers[name].grade.effects if e.selected] for name in unsure
    }
    for name, effect in _smallest_first(answers, claimed):
        models = without_effect(robot, chosen, name, effect) if effect in chosen[name].effects else None
        bare = None if models is None else values(models)
        if models is None or bare is None or now is None:
            continue
        # the simpler robot errs less on its own records: the richer fit has not found its best
        if bare.common.cost < now.common.cost:
            again = values(chosen, bare)
            now = now if again is None or again.common.cost > now.common.cost else again
        # what acts on all joints stands by the one that it helps
        if any(
            helps(now, bare, *robot.keys(joint)) for joint in models if models[joint] is not chosen[joint]
        ):
            continue
        left = chosen | {name: models[name]}
        after = bare if models == left else values(left)
        if after is not None:
            chosen, now = left, after
    found = dict(answers)
    for name in unsure:
        refuted = [effect for effect in claimed[name] if effect not in chosen[name].effects]
        seen = plain if name in nothing else now
        rest = chosen[name] if chosen[name].effects else answers[name].searched.base
        own = None
        if seen is not None and not rest.effects and seen.explain(*robot.keys(name)):
            own = PerRecord(rest, 0.0, scatter(seen.of_joint(*robot.keys(name))), True)
        if refuted or own is not None:
            searched = replace(answers[name].searched, chosen=rest, own=own, refuted=tuple(refuted))
            found[name] = robot.frozen(name, searched)
    return _rated(found, {} if now is None else {name: now.left(*robot.keys(name)) for name in found})


def _smallest_first(
    answers: Mapping[str, Answer], claimed: Mapping[str, Sequence[Name]]
) -> list[tuple[str, Name]]:
    """What is claimed of all joints, by joint, the least of the robot's errors first."""
    size = {
        (name, (c.name, c.where)): (c.share or 0.0) * one.grade.gap
        for name, one in answers.items()
        for c in one.grade.effects
    }
    every = [(name, effect) for name, some in claimed.items() for effect in some]
    return sorted(every, key=lambda one: size[one])


def _rated(answers: Mapping[str, Answer], left: Mapping[str, float]) -> dict[str, Answer]:
    """The answers with the probabilities of a robot, where any says that something is missing."""
    if not any(one.found.chosen.effects or one.grade.unknown for one in answers.values()):
        return dict(answers)
    return {
        name: replace(one, grade=of_robot(one.grade, one.searched.refuted, left.get(name, 1.0)))
        for name, one in answers.items()
    }
