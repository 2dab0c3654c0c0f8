"""A small drive with known truth, made in a second or two: for `demo`, and for the self-test of `doctor`."""

from __future__ import annotations

import tempfile
import time
from typing import Any

from hybrid_id.paper.twin import write_campaign
from hybrid_id.simulation.c_code import compiler
from hybrid_id.study.run import identify
from hybrid_id.systems.model_file import load_model

__all__ = ["DEMO", "FIT", "MOST_ERRORS", "compiler", "self_test"]

MOST_ERRORS = 4.0
"""Standard errors within which the self-test's estimates have to be: its records are drawn once and for all."""
FIT = 97.0
"""Fit [%] that the identified model has to reach on the record that was held back."""

#: A 24 V gear motor with an arm: five runs of 5 s for the fit, one to test with.
DEMO: dict[str, Any] = {
    "name": "demo_drive",
    "sample_time": 0.002,
    "rest": 0.1,
    "duration": 5.0,
    "substeps": 4,
    "gear_ratio": 100.0,
    "truth": {
        "J": 2.4e-5,
        "P_m1": 0.022,
        "P_m2": 0.031,
        "f_11": 0.012,
        "f_12": 0.028,
        "f_13": 9.0,
        "f_14": 45.0,
        "f_21": 0.014,
        "f_22": 0.033,
        "f_23": 11.0,
        "f_24": 55.0,
        "f_3": 6.0e-5,
    },
    "disturbances": {
        "friction_drift": 0.03,
        "torque_noise": 0.001,
        "encoder_counts": 256,
        "encoder_noise": 0.008,
        "start_angle": 1.0,
    },
    "excitation": {
        "starts": 10,
        "experiments": [
            {"band": [0.4, 8.0], "tones": 8, "peak": 7.0, "seed": 0},
            {"band": [0.4, 8.0], "tones": 8, "peak": 8.0, "seed": 0},
            {"band": [0.4, 8.0], "tones": 8, "peak": 10.0, "seed": 1},
            {"band": [0.4, 8.0], "tones": 8, "peak": 8.0, "seed": 1},
            {"band": [0.4, 12.0], "tones": 10, "peak": 6.0, "seed": 1},
            {"band": [0.4, 4.0], "tones": 10, "peak": 7.0, "seed": 1, "role": "test"},
        ],
    },
    "model": {
        "start_error": 0.3,
        "parameters": {
            "J": {"lower": 1e-6, "upper": 4e-4, "unit": "kg m^2"},
            "P_m1": {"nominal": 0.0225, "prior_std": 7e-4, "lower": 2e-3, "upper": 0.2, "unit": "N m/V"},
            "P_m2": {"nominal": 0.0305, "prior_std": 9e-4, "lower": 2e-3, "upper": 0.2, "unit": "V s/rad"},
            **{
                name: {"lower": 0.0, "upper": 0.2, "unit": "N m"} for name in ("f_11", "f_12", "f_21", "f_22")
            },
            **{name: {"lower": 0.0, "upper": 100.0, "unit": "rad/s"} for name in ("f_13", "f_23")},
            **{name: {"lower": 2.0, "upper": 500.0, "unit": "rad/s"} for name in ("f_14", "f_24")},
            "f_3": {"lower": 0.0, "upper": 1e-3, "unit": "N m s/rad"},
        },
    },
}


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
