"""Our side of the comparison, through the package's generic chain of components.

The same entries as the peers have, so that `run.py` treats everybody alike.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from benchmarks import reference
from benchmarks.reference import Estimate, Problem
from hybrid_id.components import AsymmetricStribeck
from hybrid_id.identification.fit import fit, make_bounds
from hybrid_id.identification.least_squares import Options
from hybrid_id.identification.objective import evaluate
from hybrid_id.parameters import Bounded
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.record import Record
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.step import Engine
from hybrid_id.statistics.fit import nrmse
from hybrid_id.systems import System, one_link
from hybrid_id.systems.model_file import load_model

TOLERANCE = float(np.sqrt(reference.DECREMENT))  # standard errors: the stop rule of the reference problem
NAMES = reference.PARAMETERS


def _system() -> System:
    system = one_link(1.0, friction=AsymmetricStribeck())
    low, high = reference.BOUNDS
    truth = dict(zip(NAMES, reference.TRUTH, strict=True))
    return system.with_specs(
        {n: Bounded(v, low * v, high * v, system.parameter(n).spec.unit) for n, v in truth.items()}
    )


def _batch(system: System, problem: Problem) -> Batch:
    time_stamps = reference.SAMPLE_TIME * np.arange(problem.voltage.shape[1])
    records = [
        Record(f"record_{i}", time_stamps, {"u1": voltage}, {"q_m1": angle})
        for i, (voltage, angle) in enumerate(zip(problem.voltage, problem.angle, strict=True))
    ]
    return make_batch(system, records, noise_std={"q_m1": float(problem.floor.mean())}, signal_share=0.0)


def _starts(system: System, problem: Problem) -> torch.Tensor:
    rows = [
        problem.starts[:, NAMES.index(i.name)]
        if i.name in NAMES
        else np.full(problem.n_records, i.spec.value)
        for i in system.table
    ]
    return torch.tensor(np.array(rows))


def prepare(problem: Problem, *, compiled: bool = False) -> Callable[[Problem], Estimate]:
    """Builds what can be built before the records are known (the model); timed apart as "build".

    compiled: the opt-in compiled sub-steps; else eager.

    Returns:
        solve(problem): one parameter set a record from `problem.starts`, smooth law tanh(v / 0.5), RK4 with four
        sub-steps, until `reference.DECREMENT` is met; (R, 12) in the order of `reference.PARAMETERS`, and the
        estimated start states (R, 2).
    """
    torch.set_num_threads(1)
    system = _system()
    engine = Engine("smooth", reference.SUB_STEPS, reference.SMOOTHING, compiled)

    def solve(problem: Problem) -> Estimate:
        batch = _batch(system, problem)
        options = Options(tolerance=TOLERANCE)
        found = fit(system, batch, engine=engine, options=options, start_values=_starts(system, problem))
        values = [[f.values[f.names.index(name)] for name in NAMES] for f in found]
        return Estimate(
            np.array(values), np.concatenate([f.x0 for f in found]), np.array([f.iterations for f in found])
        )

    return solve


def gradient_seconds(problem: Problem) -> float:
    """Seconds per record of one gradient of the loss by all parameters, in the batch of all records."""
    torch.set_num_threads(1)
    system = _system()
    batch, theta = _batch(system, problem), _starts(system, problem)
    free = [i for i, info in enumerate(system.table) if info.spec.estimate]
    make_bounds(system, free)
    engine, options = Engine("smooth", reference.SUB_STEPS, reference.SMOOTHING), Options()
    seconds = []
    for _ in range(3):
        begin = time.process_time()
        evaluate(system, engine, batch, batch.x, theta, free, loss=options.loss, chunk=options.chunk)
        seconds.append(time.process_time() - begin)
    return min(seconds) / problem.n_records


def fit_case(folder: str) -> dict[str, float]:
    """Re-fits a gap case on its train records from the nominal values, all identifiable combinations free.

    Returns:
        seconds (reading the files apart), free_parameters, nominal and refit: the normalised error on the test records.
    """
    torch.set_num_threads(1)
    dataset, system = Dataset.load(folder), load_model(Path(folder) / "model.yaml")
    noise = {channel.name: channel.noise_std for channel in dataset.outputs}

    def error(model: System, engine: Engine) -> float:
        batch = make_batch(model, dataset.test, noise_std=noise)
        y, measured = simulate(model, engine, batch).y.numpy(), batch.y.numpy()
        return float(
            np.mean(
                [
                    nrmse(m[:, c], s[:, c])
                    for m, s in zip(measured, y, strict=True)
                    for c in range(y.shape[-1])
                ]
            )
        )

    begin = time.process_time()
    (found,) = fit(system, make_batch(system, dataset.train, noise_std=noise), pooled=True)
    seconds = time.process_time() - begin
    return {
        "seconds": seconds,
        "free_parameters": len(found.names),
        "nominal": error(system, found.engine),
        "refit": error(found.system, found.engine),
    }
