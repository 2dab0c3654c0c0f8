"""What records tell about a model's parameters: before any fit, and at its end."""

from __future__ import annotations

import numpy as np
import torch

from hybrid_id.errors import InputError
from hybrid_id.identification.fit import make_bounds
from hybrid_id.identification.least_squares import Options
from hybrid_id.identification.objective import evaluate
from hybrid_id.identification.result import FitResult, sensitivities
from hybrid_id.records.dataset import Dataset
from hybrid_id.simulation.prepare import SIGNAL_SHARE
from hybrid_id.simulation.stability import with_substeps
from hybrid_id.simulation.step import Engine
from hybrid_id.statistics.identifiability import Identifiability, identifiability
from hybrid_id.study.replays import batch_of
from hybrid_id.systems.chain import System

REFERENCES = ("P_m1", "k_t", "P_m1m1", "P_m1m2")
"""Parameters by which identifiable combinations are divided, where the model has them."""


def told_by(result: FitResult, *, inflation: float = 1.0) -> Identifiability:
    """What the records of a fit tell about its parameters, at its estimates and its noise."""
    scale = max(result.noise_scale, 1e-300)
    bounds = [result.system.parameter(n).spec for n in result.names]
    size = np.array(
        [
            abs(v) or max((abs(b) for b in (s.lower, s.upper) if np.isfinite(b)), default=0.0) or 1.0
            for v, s in zip(result.values, bounds, strict=True)
        ]
    )
    return identifiability(
        result.values,
        result.names,
        jacobian=[j / scale for j in result.jacobian],
        prior_information=result.prior_precision,
        scale=size,
        inflation=inflation,
        references=REFERENCES,
    )


def check_identifiability(
    dataset: Dataset, system: System, *, signal_share: float = SIGNAL_SHARE
) -> Identifiability:
    """What the train records can tell about the model's parameters, before any fit, at its start values.

    The sensitivities are those of a free run linearised along the measured motion.

    Raises:
        InputError: nothing to estimate, or missing channels.
    """
    if not system.estimated:
        raise InputError("The model has no parameter to estimate; set 'estimate: true' for at least one.")
    batch = batch_of(dataset, system, dataset.train or dataset.records, signal_share, "cpu")
    free = system.estimated
    theta = system.theta().detach()[:, None].expand(-1, batch.rows)
    engine = with_substeps(system, Engine(), batch, theta)
    options = Options()
    at = evaluate(system, engine, batch, batch.x, theta, free, loss=options.loss, chunk=options.chunk)
    every = torch.arange(batch.rows)
    jacobian, _ = sensitivities(at, every, every, batch, options)
    info = [system.table[i] for i in free]
    bounds = make_bounds(system, free)
    return identifiability(
        np.array([i.spec.value for i in info]),
        [i.name for i in info],
        jacobian=jacobian,
        prior_information=bounds.prior_precision.numpy(),
        scale=(10.0 * bounds.scale).numpy(),
        references=REFERENCES,
    )
