"""Whether a model explains the records at all: less than their mean speaks for a wrong unit, sign or gear ratio."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hybrid_id.records.dataset import Dataset
from hybrid_id.records.finding import Finding
from hybrid_id.study.comparison import replay
from hybrid_id.study.result import Study
from hybrid_id.systems.chain import System


def check_start_values(dataset: Dataset, system: System) -> list[Finding]:
    """Simulate the train records with the model's start values; one warning where that explains nothing."""
    runs = replay(dataset.select([record.name for record in dataset.train or dataset.records]), system)
    words = _verdict("the model's start values", [list(run.nrmse.values()) for run in runs])
    return [Finding("warning", "start_values", words)] if words else []


def check_fit(study: Study) -> str:
    """The same of the selected set on train and test records; empty where it explains something."""
    cross, index = study.cross_validation, study.selection.index
    outputs = study.selected.residual[0].shape[-1]
    train = 1.0 - cross.fits[index, :, :outputs] / 100.0
    test = [[value] for value in study.test_nrmse.values()]
    return _verdict("the identified parameters", train) or _verdict("the identified parameters", test)


def _verdict(who: str, nrmse: Sequence[Sequence[float]] | np.ndarray) -> str:
    """Say that the normalised RMSE (n_records, n_outputs) of the worst output, median of the records, is above 1."""
    errors = np.array(nrmse, float)
    if not errors.size:
        return ""
    moving = errors[:, ~np.isnan(errors).all(0)]  # an output that stands still in all records has none
    worst = float(np.max(np.nanmedian(moving, axis=0), initial=0.0)) if moving.size else 0.0
    size = f"normalised RMSE {worst:.3g}" if np.isfinite(worst) else "the simulation diverges"
    return (
        f"{who} explain less than the mean of the records ({size}); check signs, units and gear ratio"
        if worst > 1.0
        else ""
    )
