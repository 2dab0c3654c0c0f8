"""Whether the installed program finds a truth that is known: the self-test of `hybrid-id doctor`."""

from __future__ import annotations

import tempfile
import time
from typing import Any

from hybrid_id.machines.twin.campaign import write_campaign
from hybrid_id.machines.twin.demo import DEMO
from hybrid_id.simulation.c_code import compiler
from hybrid_id.study.run import identify
from hybrid_id.systems.model_file import load_model

__all__ = ["FIT", "MOST_ERRORS", "compiler", "self_test"]

MOST_ERRORS = 4.0
"""Standard errors within which the self-test's estimates have to be: its records are drawn once and for all."""
FIT = 97.0
"""Fit [%] that the identified model has to reach on the record that was held back."""


def self_test() -> dict[str, Any]:
    """Identify a small simulated drive, pooled over two records, and hold the estimates against its truth."""
    runs = [DEMO["excitation"]["experiments"][k] | {"tones": 6} for k in (1, 3, 5)]
    settings = DEMO | {"duration": 2.0, "excitation": DEMO["excitation"] | {"starts": 2, "experiments": runs}}
    settings["disturbances"] = DEMO["disturbances"] | {"friction_drift": 0.0}
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        dataset, truths = write_campaign(folder, settings, 0)
        study = identify(dataset, load_model(f"{folder}/model_priors.yaml"), pooled=True)
    values = dict(zip(study.names, study.selected.values, strict=True))
    errors = dict(zip(study.names, study.standard_errors(study.selection.index), strict=True))
    parameters = {
        name: {"truth": truths[0][name], "estimate": value, "standard_error": errors[name]}
        for name, value in values.items()
    }
    off = [
        n
        for n, row in parameters.items()
        if abs(row["estimate"] - row["truth"]) > MOST_ERRORS * row["standard_error"]
    ]
    fit = 100.0 * (1.0 - next(iter(study.test_nrmse.values())))
    return {
        "passed": not off and fit >= FIT,
        "off": off,
        "fit_percent": fit,
        "seconds": time.perf_counter() - start,
        "parameters": parameters,
    }
