"""What a report shows of a diagnosis beside its answer: maps, reversals, parameter statistics, tests of residuals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property

import numpy as np

from hybrid_id.diagnosis.errors_on_test import Errors
from hybrid_id.diagnosis.fits import Fits
from hybrid_id.diagnosis.locate import Location
from hybrid_id.diagnosis.maps import Reversals, TorqueMap, after_reversals, torque_map
from hybrid_id.diagnosis.model import FittedModel
from hybrid_id.identification.finite_differences import finite_difference_fit
from hybrid_id.records.dataset import Dataset
from hybrid_id.study import Comparison, Study, analyse_fits, check_identifiability, replay
from hybrid_id.study.checks import ResidualTest, residual_tests
from hybrid_id.systems.chain import System

JOINTS = 3
"""Joints of which maps are made at most."""


class Details:
    """Results that follow from a diagnosis. Each is computed when it is first asked for, and then kept.

    A board that scores a thousand diagnoses asks for none of them; the command ``diagnose`` lets :meth:`compute` have
    all of them before it draws anything.

    Args:
        fits: the records, their horizon and their noise.
        nominal: the nominal model.
        fitted: the models that were fitted, by name.
        location: where the re-fitted model lacks a torque, best first.
        errors: of the corrected model on the test records; None without test records.
        seed: of the bootstrap.
        level: confidence of the intervals.
    """

    def __init__(
        self,
        fits: Fits,
        nominal: System,
        fitted: Mapping[str, FittedModel],
        location: tuple[Location, ...],
        errors: Errors | None,
        *,
        seed: int = 0,
        level: float = 0.95,
    ) -> None:
        self.nominal, self.seed, self.level = nominal, seed, level
        self._fits, self._fitted, self._location, self._errors = fits.on_all(), fitted, location, errors

    @property
    def dataset(self) -> Dataset:
        """The records; those of validation are train records here, as in the final fit."""
        return self._fits.dataset

    def compute(self) -> None:
        """Fit and simulate all that pictures and page show: what renders them then only reads."""
        for name in ("maps", "reversals", "studies", "residual_tests", "worst_record"):
            getattr(self, name)

    @cached_property
    def maps(self) -> tuple[Mapping[str, TorqueMap], ...]:
        """Torque that each fitted model misses over angle and speed, of one joint each."""
        sides = {one.joint: one.side for one in reversed(self._location)}  # the best of a joint is the last
        return tuple(
            {
                name: torque_map(self._fits, m, int(joint[5:]), sides[joint])
                for name, m in self._fitted.items()
            }
            for joint in sorted(sides)[:JOINTS]
        )

    @cached_property
    def reversals(self) -> Mapping[str, tuple[Reversals, ...]]:
        """Mean errors of each fitted model after reversals of the motion, over all records."""
        return {name: tuple(after_reversals(self._fits, m)) for name, m in self._fitted.items()}

    @cached_property
    def studies(self) -> tuple[Study, ...]:
        """Each fitted model with the parameter statistics of ``identify``."""
        return tuple(
            as_identified(self._fits, model, seed=self.seed, level=self.level)
            for model in self._fitted.values()
        )

    @cached_property
    def residual_tests(self) -> Mapping[str, tuple[ResidualTest, ...]]:
        """Whether what each fitted model leaves is white and independent of the inputs."""
        return {
            name: residual_tests(self.dataset, m.system, m.result.engine) for name, m in self._fitted.items()
        }

    @cached_property
    def worst_record(self) -> Comparison:
        """All models on the test record that the corrected one predicts worst; on a train record without any."""
        errors = self._errors
        first = self.dataset.train[0].name
        name = first if errors is None else max(errors.by_record, key=errors.by_record.__getitem__)
        part = self.dataset.select([name])
        fitted = {n: replay(part, m.system, engine=m.result.engine) for n, m in self._fitted.items()}
        return Comparison({"nominal": replay(part, self.nominal)} | fitted, outputs=part.outputs)


def as_identified(fits: Fits, model: FittedModel, *, seed: int = 0, level: float = 0.95) -> Study:
    """The statistics of `identify` for a model that a search has fitted: intervals, reliability, what is identified.

    A search keeps of its sensitivities only their products; here they are computed again, at the values where it has
    ended. They come from finite steps, which see through events (play, stick and slip) and blur a change of the
    parameters that the outputs do not show at all: what the exact sensitivities show to be none is taken out.

    Args:
        fits: the records of the last fit, and its horizon.
        model: the fitted model.
        seed: of the bootstrap.
        level: confidence of the intervals.
    """
    found, system, dataset = model.result, model.system, fits.dataset
    batch = fits.batch(system)
    there = finite_difference_fit(system, batch, engine=found.engine, iterations=0, x0=found.x0)
    seen = check_identifiability(dataset, system)
    unseen = [one.relative for one in seen.directions if not np.isfinite(one.relative_std)]
    jacobian = there.jacobian
    if unseen:  # sensitivities (T, n_y, n_f) without what they show along relative changes that nothing sees
        axes = np.linalg.qr(np.where(there.values == 0.0, 0.0, np.array(unseen)).T)[0]
        size = np.where(there.values == 0.0, 1.0, there.values)
        scaled = (part * size for part in jacobian)
        jacobian = tuple((relative - (relative @ axes) @ axes.T) / size for relative in scaled)
    there = replace(there, status=found.status, iterations=found.iterations, jacobian=jacobian)
    return analyse_fits(dataset, system, [there], pooled=True, batch=batch, seed=seed, level=level)
