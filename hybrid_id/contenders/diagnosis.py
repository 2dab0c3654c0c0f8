"""The diagnosis of this package as a contender."""

from __future__ import annotations

from typing import Any

from hybrid_id.diagnosis.diagnose import diagnose
from hybrid_id.records.dataset import Dataset
from hybrid_id.systems.chain import System


def diagnosis(dataset: Dataset, system: System) -> dict[str, Any]:
    """Content of ``diagnosis.json``, the command of the best next experiment with it."""
    found = diagnose(dataset, system)
    content = found.as_dict()
    for told, experiment in zip(content["next_experiments"][:1], found.experiments, strict=False):
        told |= {
            "sample_time": float(experiment.time[1] - experiment.time[0]),
            "command": [round(float(u), 4) for u in experiment.command],
        }
    return content
