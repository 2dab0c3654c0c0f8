"""The package's own identification as the judge of difficulty; the only module here that knows it."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch

from hybrid_id.blind.levels import Errors
from hybrid_id.identification.fit import fit
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.yaml_file import validate
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.study.comparison import replay
from hybrid_id.systems.chain import System
from hybrid_id.systems.model_file import build_model
from hybrid_id.systems.model_schema import ModelFile


def refit(dataset: Dataset, model: Mapping[str, Any]) -> Errors:
    """Normalised RMSE on the test records of a model as it stands, and fitted to all train records at once."""
    torch.set_num_threads(1)
    system = build_model(validate(ModelFile, model, "model"))
    return Errors(test_error(dataset, system), test_error(dataset, fit_pooled(dataset, system)))


def fit_pooled(dataset: Dataset, system: System, *, warm: bool = True) -> System:
    """One parameter set for all train records."""
    noise = {channel.name: channel.noise_std for channel in dataset.outputs}
    return fit(system, make_batch(system, dataset.train, noise_std=noise), pooled=True, warm=warm)[0].system


def test_error(dataset: Dataset, system: System) -> float:
    """Normalised RMSE on the test records, averaged over outputs and records."""
    tests = dataset.select([record.name for record in dataset.test])
    return float(np.mean([error for run in replay(tests, system) for error in run.nrmse.values()]))
