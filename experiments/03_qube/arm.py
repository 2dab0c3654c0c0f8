"""The arm axis of the Furuta pendulum: its records, its models, and fits of short free runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from hybrid_id import Dataset, Engine, Record, System, fit, load_model, make_batch, simulate
from hybrid_id.components import Stribeck
from hybrid_id.identification.least_squares import Options
from hybrid_id.identification.result import FitResult
from hybrid_id.identification.windows import measured_windows
from hybrid_id.parameters import Bounded
from hybrid_id.simulation.batch import Batch
from hybrid_id.statistics.cross_validation import CrossValidation, select
from hybrid_id.statistics.reliability import reliability_grades
from hybrid_id.statistics.uncertainty import autocorrelation_robust, covariance
from hybrid_id.statistics.variation import error_of_mean, variation
from hybrid_id.study import Study
from hybrid_id.study.checks import identifiability_of
from hybrid_id.study.replay import engine_error

HERE = Path(__file__).parent
OPTIONS = Options(max_iterations=200)


def load(folder: Path) -> Dataset:
    """The records, with the pendulum's reaction in place of its angle.

    The pendulum obeys ``a'' = -k cos(a) q'' + w sin(a)``, so its pull on the arm, ``m l L (cos(a) a'' - sin(a) a'^2)``,
    is an inertia of the arm and ``c_w sin(a) cos(a)``; nothing is differentiated. The centrifugal rest is
    0.01 V RMS. The channel is held from sample to sample as the voltage is: each sample gets the mean of its two ends.
    """
    dataset = Dataset.load(HERE / "dataset.yaml", folder=folder)
    return replace(dataset, records=tuple(_reaction(record) for record in dataset))


def _reaction(record: Record) -> Record:
    pull = 0.5 * np.sin(2.0 * record.inputs["w1"])
    return replace(record, inputs={**record.inputs, "w1": 0.5 * (pull + np.append(pull[1:], pull[-1]))})


def delayed(dataset: Dataset, seconds: float) -> Dataset:
    """The records with a voltage that acts later by a part of a sample."""
    share = seconds / dataset.records[0].sample_time
    late = [
        replace(r, inputs={**r.inputs, "u1": (1 - share) * u + share * np.append(u[:1], u[:-1])})
        for r in dataset
        for u in [r.inputs["u1"]]
    ]
    return replace(dataset, records=tuple(late))


def build(rung: Mapping[str, Any], hold: Mapping[str, float]) -> System:
    """One model of the ladder, what cannot be told held."""
    system = load_model(HERE / "model.yaml")
    for key in rung.get("without", ()):
        system = system.without_component(*key.rsplit("/", 1))
    if extra := rung.get("with"):
        system = system.with_component(
            "joint1/motor_friction", Stribeck(**{n: Bounded(*limits) for n, limits in extra.items()})
        )
    return system.with_specs(
        {n: replace(system.parameter(n).spec, value=v, estimate=False) for n, v in hold.items()}
    )


@dataclass(frozen=True, eq=False)
class Fits:
    """One parameter set a record, each from many short free runs with start states of their own."""

    study: Study
    batch: Batch

    @property
    def table(self) -> np.ndarray:
        """Estimates, ``(records, parameters)``."""
        return self.study.values

    def held_out(self, seconds: float, *, own_bias: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """Fit [%] and RMS error [rad] of set i in free runs of record j, both ``(sets, records)``.

        Args:
            seconds: length of a free run; each starts at the smoothed measured state.
            own_bias: whether set i takes T_0 from record j's set: the encoders' zeros belong to a record.
        """
        system, count = self.study.system, len(self.table)
        found = measured_windows(system, self.batch, seconds)
        runs, row = found or (self.batch, torch.arange(self.batch.rows))
        theta = torch.stack([r.system.theta().detach() for r in self.study.sets], 1)
        theta = theta[:, :, None].repeat(1, 1, runs.rows)
        if own_bias:
            (k,) = [i for i, info in enumerate(system.table) if info.name == "T_0"]
            theta[k] = theta[k, row, 0]
        every = runs.take(torch.arange(runs.rows).repeat(count))
        error = (simulate(system, Engine(), every, theta.flatten(1)).y - every.y).square().mean((1, 2))
        moved = (runs.y - runs.y.mean(1, keepdim=True)).square().mean((1, 2))
        of_record = torch.nn.functional.one_hot(row).to(error) / torch.bincount(row)
        rms = (error.reshape(count, -1) @ of_record).sqrt().numpy()
        return 100 * (1 - rms / (moved @ of_record).sqrt().numpy()), rms


def identify_windows(dataset: Dataset, system: System, seconds: float, *, start: Fits | None = None) -> Fits:
    """One set a record from free runs of ``seconds``, started at a simpler model's sets, and their study."""
    batch = make_batch(system, dataset.records, noise_std={c.name: c.noise_std for c in dataset.outputs})
    sets, steps = [], []
    for k, record in enumerate(dataset):
        windows, _ = measured_windows(system, batch.take(torch.tensor([k])), seconds) or (batch, None)
        windows = replace(windows, names=tuple(f"{record.name}_{i}" for i in range(windows.rows)))
        first = dict(zip(start.study.names, start.table[k], strict=True)) if start else {}
        (result,) = fit(system.with_values(first), windows, pooled=True, warm=False, options=OPTIONS)
        steps.append(engine_error(result, windows))
        sets.append(replace(result, records=(record.name,)))
    return Fits(_study(system, sets, batch, seconds, max(steps)), batch)


def _study(
    system: System, sets: Sequence[FitResult], batch: Batch, seconds: float, engine_steps: float
) -> Study:
    """The statistics of the sets, cross-validated in free runs of the fitted length."""
    plain = tuple(covariance(r.jacobian, r.residual) for r in sets)
    robust = tuple(autocorrelation_robust(r.jacobian, r.residual) for r in sets)
    values, names = np.array([r.values for r in sets]), sets[0].names
    ways = {
        way: np.sqrt(np.mean([c.std_error**2 for c in each], 0) / len(sets))
        for way, each in (("plain", plain), ("robust", robust))
    }
    ways["between records"] = error_of_mean(values)
    axes = batch.names, batch.names, ("q_m1",), range(len(sets))
    matrix = CrossValidation(np.zeros((len(sets), batch.rows, 1)), *axes)
    study = Study(system, tuple(sets), False, variation(values, names), plain, robust, identifiability_of(sets[0]),
                  (), matrix, None, {}, engine_steps)  # type: ignore[arg-type]  # fmt: skip
    fits = Fits(study, batch).held_out(seconds)[0][..., None]
    matrix = CrossValidation(fits, *axes)
    selection = select(matrix)
    chosen = sets[selection.index]
    ratio = np.median(robust[selection.index].std_error / plain[selection.index].std_error)
    told = identifiability_of(chosen, inflation=max(float(ratio), 1.0))
    reliability = reliability_grades(
        names, values.mean(0), ways, not_identifiable=told.not_claimable, at_bound=chosen.at_bound
    )
    return replace(
        study, identifiability=told, reliability=reliability, cross_validation=matrix, selection=selection
    )
