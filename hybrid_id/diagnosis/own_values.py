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

from hybrid_id.diagnosis.catalogue import brought
from hybrid_id.diagnosis.criteria import CRITERIA
from hybrid_id.diagnosis.diagnose import Answer, freeze
from hybrid_id.diagnosis.fits import FULL, engine
from hybrid_id.diagnosis.model import FittedModel, Name
from hybrid_id.diagnosis.per_record import PerRecord, scatter, structural
from hybrid_id.diagnosis.select import refitted_without
from hybrid_id.diagnosis.validation import Validation, p_values, validation
from hybrid_id.errors import InputError
from hybrid_id.identification.fit import fit
from hybrid_id.identification.horizons import Horizon, shortest
from hybrid_id.identification.least_squares import Options
from hybrid_id.identification.result import FitResult
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.units import number_of, stem
from hybrid_id.simulation.prepare import SIGNAL_SHARE
from hybrid_id.study.replays import batch_of
from hybrid_id.systems.by_joint import alone, joint_number, some, with_drive, with_standing_held
from hybrid_id.systems.chain import System

COUPLED = 10
"""Iterations of a fit of the whole robot, which begins where the joints' own fits have ended."""


@dataclass(frozen=True, eq=False)
class OwnValues:
    """A robot fitted to its train records together and to each by itself, its effects as the first fit has them.

    Attributes:
        common: the fit of all records.
        sets: the fit of each record.
        outputs: names of the outputs, in the order of the fits' columns.
        sample_time: of the records [s].
    """

    common: FitResult
    sets: tuple[FitResult, ...]
    outputs: tuple[str, ...]
    sample_time: float

    def left(self, joint: str) -> float:
        """Share of the structure in a joint's errors that values of each record's own leave.

        Of the records in their geometric mean, so that one which runs away from its own values does not decide.
        """
        own = [structural(self._of(joint, one)) for one in self.sets]
        together = self._of(joint, self.common)
        records = np.array(self.common.records)
        common = [
            structural([together[k] for k in np.flatnonzero(records == one.records[0])]) for one in self.sets
        ]
        least = CRITERIA.negligible_structure**2
        ratio = np.minimum(np.maximum(own, least) / np.maximum(common, least), 1.0)
        return float(np.exp(np.log(ratio).mean()))

    def explain(self, joint: str) -> bool:
        """Whether values of each record's own explain what looks missing at a joint: little or no structure is left."""
        return (
            self.structure(joint) <= CRITERIA.negligible_structure**2 or self.left(joint) <= CRITERIA.coloured
        )

    def structure(self, joint: str) -> float:
        """Mean square of what these values leave of a joint's motion that is no white noise, in noise variances."""
        return float(np.mean([structural(self._of(joint, one)) for one in self.sets]))

    def validation(self, joint: str) -> Validation:
        """Blocks of the joint's errors, each record with values of its own."""
        errors = [piece for one in self.sets for piece in self._of(joint, one)]
        return validation(errors, self.sample_time, [name for one in self.sets for name in one.records])

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
) -> OwnValues | None:
    """Fit a robot to its train records together and to each by itself; None where one of the fits fails.

    Args:
        dataset: of all joints that move.
        system: their drives.
        effects: that it has: their parameters are those of all records.
        horizon: how long its free runs are.
        signal_share: see :func:`hybrid_id.simulation.prepare.make_batch`.
    """
    batch = horizon.cut(system, engine(), batch_of(dataset, system, dataset.train, signal_share, "cpu"))
    names, found = np.array(batch.names), list[FitResult]()
    try:
        common = _fit(system, batch, COUPLED)
        held = {
            info.name: replace(info.spec, estimate=False)
            for name, where in effects
            for info in brought(common.system, name, where).values()
        }
        for name in dict.fromkeys(batch.names):
            rows = torch.as_tensor(np.flatnonzero(names == name))
            found.append(_fit(common.system.with_specs(held), batch.take(rows), FULL))
    except (InputError, RuntimeError, np.linalg.LinAlgError):
        return None
    return OwnValues(common, tuple(found), tuple(batch.outputs), batch.sample_time)


def _fit(system: System, batch: object, iterations: int) -> FitResult:
    options = Options(max_iterations=iterations)
    return fit(system, batch, pooled=True, engine=engine(), options=options, warm=False)[0]  # type: ignore[arg-type]


def helps(richer: OwnValues, simpler: OwnValues, joint: str) -> bool:
    """Whether effects take enough, and surely, of the errors that records' own values leave at their joint."""
    if simpler.structure(joint) <= CRITERIA.negligible_structure**2:
        return False
    with_effect, without = richer.validation(joint), simpler.validation(joint)
    enough = with_effect.fall(without) >= CRITERIA.completing_fall
    return enough and float(p_values([with_effect], without)[0]) <= CRITERIA.false_alarms


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
    Where such values explain what is left, records differ and nothing is missing.

    Args:
        dataset: of the whole robot.
        nominal: the nominal robot.
        answers: of the joints by themselves, by name.
        seed: of the resampling.
        signal_share: see :func:`hybrid_id.simulation.prepare.make_batch`.
    """
    chosen = {name: one.found.chosen for name, one in answers.items()}
    unsure = [name for name, one in answers.items() if chosen[name].effects or one.grade.unknown]
    if not unsure:
        return dict(answers)
    horizon = shortest([one.fits.horizon for one in answers.values()])
    moving, held = with_standing_held(dataset, nominal)

    def of(models: Mapping[str, FittedModel]) -> OwnValues | None:
        robot = nominal
        for one in models.values():
            robot = with_drive(robot, one.system)
        robot = robot if held.seats is None else some(robot, held.seats)
        effects = [name for one in models.values() for name in one.effects]
        return own_values(moving, robot, effects, horizon, signal_share)

    found, now = dict(answers), of(chosen)
    for name in unsure:
        answer, number, refuted = answers[name], joint_number(nominal, name), list[Name]()
        key = f"joint{number + 1}"
        for one in reversed([e for e in answer.grade.effects if e.selected]):
            effect, last = (one.name, one.where), len(chosen[name].effects) == 1
            base = answer.found.base
            rest = base if last else refitted_without(answer.fits, base, chosen[name], effect)
            bare = None if rest is None else of({**chosen, name: rest})
            if rest is None or bare is None or now is None or helps(now, bare, key):
                continue
            chosen[name], now = rest, bare
            refuted.append(effect)
        differ = now is not None and not chosen[name].effects and now.explain(key)
        if not (refuted or differ):
            continue
        own = PerRecord(chosen[name], 0.0, scatter(now.of_joint(key)), True) if differ and now else None
        more = replace(answer.searched, chosen=chosen[name], own=own, refuted=tuple(refuted))
        found[name] = freeze(answer.fits, more, alone(nominal, number), seed=seed)
    return found
