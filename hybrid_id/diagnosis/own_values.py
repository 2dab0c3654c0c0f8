"""What joints of a robot claim, held against values of each record's own, all joints simulated.

A joint by itself takes the motion of the others as it was measured, with its noise, and one set of values for all
records. Where friction is another one in every record, what that does adds up along the motion of all joints, and a
joint takes a part of it for something missing. An effect that a robot lacks shows within a record, too.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch

from hybrid_id.components.base import Shared
from hybrid_id.diagnosis.catalogue import CATALOGUE, brought
from hybrid_id.diagnosis.criteria import CRITERIA
from hybrid_id.diagnosis.diagnose import Answer, freeze
from hybrid_id.diagnosis.fits import FULL, engine, with_priors_of, without_priors
from hybrid_id.diagnosis.model import FittedModel, Name
from hybrid_id.diagnosis.per_record import PerRecord, scatter, structural
from hybrid_id.diagnosis.select import refitted_without
from hybrid_id.diagnosis.validation import mean_square
from hybrid_id.errors import InputError
from hybrid_id.identification.fit import kept_fit
from hybrid_id.identification.horizons import Horizon, shortest
from hybrid_id.identification.keep import Kept
from hybrid_id.identification.least_squares import Options
from hybrid_id.identification.result import FitResult
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.units import number_of, stem
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.prepare import SIGNAL_SHARE
from hybrid_id.study.replays import batch_of
from hybrid_id.systems.by_joint import alone, joint_number, some, with_drive, with_others_measured
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

    def left(self, joint: str) -> float:
        """Share of the structure in a joint's errors that values of each record's own leave.

        Of the records in which one set leaves any, in their geometric mean, so that one which runs away from its own
        values does not decide.
        """
        together, records = self._of(joint, self.common), np.array(self.common.records)
        least, ratios = CRITERIA.negligible_structure**2, list[float]()
        for one in self.sets:
            pieces = [together[k] for k in np.flatnonzero(records == one.records[0])]
            if (common := structural(pieces)) > least:
                ratios.append(min(max(structural(self._of(joint, one)), least) / common, 1.0))
        return float(np.exp(np.log(ratios).mean())) if ratios else 1.0

    def explain(self, joint: str) -> bool:
        """Whether values of each record's own explain what looks missing at a joint: little or no structure is left."""
        return (
            self.structure(joint) <= CRITERIA.negligible_structure**2 or self.left(joint) <= CRITERIA.coloured
        )

    def structure(self, joint: str) -> float:
        """Mean square of what these values leave of a joint's motion that is no white noise, in noise variances."""
        return float(np.mean([structural(self._of(joint, one)) for one in self.sets]))

    def mean_square(self, joint: str) -> float:
        """Mean square of all that these values leave of a joint's motion, in noise variances."""
        return mean_square([piece for one in self.sets for piece in self._of(joint, one)])

    def of_joint(self, joint: str) -> list[FitResult]:
        """The records' fits with the parameters of one joint alone."""
        return [
            _columns(one, [k for k, n in enumerate(one.names) if _at(one, n, joint)]) for one in self.sets
        ]

    def _of(self, joint: str, one: FitResult) -> list[np.ndarray]:
        number = joint.removeprefix("joint")
        columns = [
            k for k, n in enumerate(self.outputs) if number_of(n) == number and stem(n) in ("q_m", "q_a")
        ]
        return [piece[:, columns] for piece in one.residual]


def _at(one: FitResult, parameter: str, joint: str) -> bool:
    return one.system.parameter(parameter).component.startswith(f"{joint}/")


def _columns(one: FitResult, columns: list[int]) -> FitResult:
    return replace(
        one,
        names=tuple(one.names[k] for k in columns),
        values=one.values[columns],
        jacobian=tuple(part[..., columns] for part in one.jacobian),
    )


def own_values(
    dataset: Dataset,
    system: System,
    effects: Collection[Name],
    horizon: Horizon,
    signal_share: float = SIGNAL_SHARE,
    kept: Kept | None = None,
) -> OwnValues | None:
    """Fit a robot to its train records together and to each by itself; None where a fit fails or runs away.

    Args:
        dataset: of the joints that are simulated.
        system: their drives.
        effects: that it has: their parameters are those of all records.
        horizon: how long its free runs are.
        signal_share: see :func:`hybrid_id.simulation.prepare.make_batch`.
        kept: fits that an earlier run has kept, and where these are kept.
    """

    def fitted(one: System, some_rows: Batch) -> FitResult:
        options = Options(max_iterations=FULL)
        return kept_fit(kept, one, some_rows, pooled=True, engine=engine(), options=options, warm=False)[0]

    found = list[FitResult]()
    try:
        batch = horizon.cut(system, engine(), batch_of(dataset, system, dataset.train, signal_share, "cpu"))
        common, names = fitted(system, batch), np.array(batch.names)
        held = {
            info.name: replace(info.spec, estimate=False)
            for name, where in effects
            for info in brought(common.system, name, where).values()
        }
        for name in dict.fromkeys(batch.names):
            rows = torch.as_tensor(np.flatnonzero(names == name))
            found.append(fitted(common.system.with_specs(held), batch.take(rows)))
    except (InputError, RuntimeError, np.linalg.LinAlgError):
        return None
    sound = all(np.isfinite(piece).all() for one in (common, *found) for piece in one.residual)
    return OwnValues(common, tuple(found), tuple(batch.outputs)) if sound else None


def helps(richer: OwnValues, simpler: OwnValues, joint: str) -> bool:
    """Whether effects take enough of what records' own values leave at their joint, where that has structure."""
    if simpler.structure(joint) <= CRITERIA.negligible_structure**2:
        return False
    return richer.mean_square(joint) <= (1.0 - CRITERIA.completing_fall) * simpler.mean_square(joint)


def borne_out(
    dataset: Dataset,
    nominal: System,
    answers: Mapping[str, Answer],
    *,
    seed: int = 0,
    signal_share: float = SIGNAL_SHARE,
) -> dict[str, Answer]:
    """The joints' answers as the whole robot bears them out.

    Effects that take nothing of what each record's own values leave are dropped, one at a time, the smallest first.
    Where such values explain what is left, records differ and nothing is missing. Joints that were not diagnosed move
    as they were measured.

    Args:
        dataset: of the whole robot.
        nominal: the nominal robot.
        answers: of the joints by themselves, by name.
        seed: of the resampling.
        signal_share: see :func:`hybrid_id.simulation.prepare.make_batch`.
    """
    chosen = {name: one.found.chosen for name, one in answers.items()}
    unsure = [name for name, one in answers.items() if chosen[name].effects or one.grade.unknown]
    if not unsure or len(dataset.train) < 2:
        return dict(answers)
    horizon = shortest([one.fits.horizon for one in answers.values()])
    numbers = {name: joint_number(nominal, name) for name in answers}
    drives = {name: alone(nominal, number) for name, number in numbers.items()}
    every = len(numbers) == len(nominal.joints)
    records = dataset if every else with_others_measured(dataset, nominal, *numbers.values())

    def of(models: Mapping[str, FittedModel]) -> OwnValues | None:
        robot = nominal
        for name, one in models.items():
            robot = with_drive(robot, without_priors(one.system, drives[name]))
        robot = robot if every else some(robot, list(numbers.values()))
        effects = [name for one in models.values() for name in one.effects]
        kept = next(iter(answers.values())).fits.kept
        return own_values(records, robot, effects, horizon, signal_share, kept)

    def lacking(name: str, effect: Name) -> dict[str, FittedModel] | None:
        """The models without an effect of a joint: of one that acts on several joints, wherever it is claimed."""
        shared = any(issubclass(law, Shared) for law in CATALOGUE[effect[0]].laws)
        found = dict(chosen)
        for joint, model in chosen.items():
            for one in model.effects:
                if (joint, one) == (name, effect) or (shared and one[0] == effect[0]):
                    rest = _rest(answers[joint], found[joint], one)
                    if rest is None:
                        return None
                    found[joint] = rest
        return found

    found, now = dict(answers), of(chosen)
    for name in unsure:
        answer, refuted, key = answers[name], list[Name](), f"joint{numbers[name] + 1}"
        for one in reversed([e for e in answer.grade.effects if e.selected]):
            models = lacking(name, (one.name, one.where))
            bare = None if models is None else of(models)
            if models is None or bare is None or now is None or helps(now, bare, key):
                continue
            chosen[name] = models[name]
            now = bare if models == chosen else of(chosen)
            refuted.append((one.name, one.where))
        differ = now is not None and not chosen[name].effects and now.explain(key)
        if not (refuted or differ):
            continue
        rest = chosen[name] if chosen[name].effects else answer.searched.base
        own = PerRecord(rest, 0.0, scatter(now.of_joint(key)), True) if differ and now else None
        more = replace(answer.searched, chosen=rest, own=own, refuted=tuple(refuted))
        again = freeze(answer.fits, more, drives[name], seed=seed)
        rejected = tuple(dict.fromkeys((*answer.rejected, *again.rejected)))
        found[name] = replace(again, rejected=rejected)
    return found


def _rest(answer: Answer, model: FittedModel, effect: Name) -> FittedModel | None:
    """A joint's model less one of its effects, as the search would have it; None where it cannot be fitted."""
    base = answer.searched.base
    if len(model.effects) == 1:
        return base
    held = replace(model, result=replace(model.result, system=with_priors_of(model.system, base.system)))
    return refitted_without(answer.fits, base, held, effect)
