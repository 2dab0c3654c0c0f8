"""A ladder of nested friction models, fitted in the mean absolute error of whole free runs."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from hybrid_id.components import REGISTRY
from hybrid_id.identification.fit import fit
from hybrid_id.identification.least_squares import Options
from hybrid_id.identification.objective import Loss
from hybrid_id.identification.result import FitResult
from hybrid_id.parameters import Bounded
from hybrid_id.records.record import Record
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.chain import System
from hybrid_id.systems.model_file import ModelFile, build_model


@dataclass(frozen=True, eq=False)
class Rung:
    """One model of the ladder: its fit, its error on each record [rad] and the processor time [s] that it took."""

    result: FitResult
    errors: np.ndarray
    seconds: float


def build(config: Mapping[str, Any], drive: str, model: str) -> System:
    """The model of one rung, driven one way."""
    system = build_model(ModelFile.model_validate(config["model"])).with_component(
        "joint1/input", REGISTRY[drive]()
    )
    for kind, entries in config["ladder"][model]["adds"].items():
        if f"joint1/load/{kind}" not in system.components:
            system = system.with_component("joint1/motor_friction", REGISTRY[kind]())
        system = system.with_specs(
            {n: Bounded(*limits, unit=system.parameter(n).spec.unit) for n, limits in entries.items()}
        )
    return system


def prepare(config: Mapping[str, Any], system: System, records: Sequence[Record]) -> Batch:
    """Records as a batch in units of the encoder's step; each starts at its first measured position, at rest."""
    noise = {"q_m1": config["encoder_step"]}
    batch = make_batch(
        system, records, outputs=["q_m1"], noise_std=noise, signal_share=0.0, estimate_start=False
    )
    states = batch.x.clone()
    states[:, 0, 0], states[:, 0, 1] = batch.y[:, 0, 0], 0.0
    return replace(batch, x=states)


def mean_errors(system: System, engine: Engine, batch: Batch) -> np.ndarray:
    """Mean |measured - simulated| of each record [rad]."""
    misses = (simulate(system, engine, batch).y - batch.y).abs() * (batch.weight > 0)
    return (misses.sum((1, 2)) / (batch.weight > 0).sum((1, 2))).numpy()


def climb(
    config: Mapping[str, Any], drive: str, records: Sequence[Record], starts: int | None = None
) -> dict[str, Rung]:
    """Fit every model of the ladder, each started at the best of the models that it contains and around it."""
    torch.set_num_threads(1)
    options = Options(config["max_iterations"], config["tolerance"], loss=Loss("l1", delta=1.0))
    rungs: dict[str, Rung] = {}
    for model, entry in config["ladder"].items():
        begin, system = time.process_time(), build(config, drive, model)
        below = min((rungs[name].result for name in entry["contains"]), key=lambda r: r.cost, default=None)
        if below is not None:
            system = system.with_values(dict(zip(below.names, below.values, strict=True)))
        batch = prepare(config, system, records)
        (result,) = fit(
            system, batch, pooled=True, options=options, starts=starts or config["starts"], warm=below is None
        )
        rungs[model] = Rung(
            result, mean_errors(result.system, result.engine, batch), time.process_time() - begin
        )
    return rungs


def leave_one_out(
    config: Mapping[str, Any], rung: Rung, records: Sequence[Record]
) -> tuple[np.ndarray, np.ndarray]:
    """Re-fit without each record in turn, from the pooled optimum: held-out errors ``(R,)``, sets ``(R, n)``."""
    torch.set_num_threads(1)
    system = rung.result.system
    whole = prepare(config, system, records)
    near = replace(whole, x=simulate(system, rung.result.engine, whole).x)
    options = Options(
        config["max_iterations"], config["tolerance"], loss=Loss("l1", delta=1.0, widths=(3.0, 1.0))
    )
    errors, sets = [], []
    for k in range(whole.rows):
        rest = torch.tensor([i for i in range(whole.rows) if i != k])
        (result,) = fit(system, near.take(rest), pooled=True, options=options, warm=False)
        errors.append(mean_errors(result.system, result.engine, whole.take(torch.tensor([k])))[0])
        sets.append(result.values)
    return np.array(errors), np.array(sets)


def jackknife(sets: np.ndarray) -> np.ndarray:
    """Standard errors between records from the leave-one-record-out sets ``(R, n)``."""
    count = len(sets)
    return np.sqrt((count - 1) / count * ((sets - sets.mean(0)) ** 2).sum(0))
