"""Results as files: JSON for programs, CSV for spreadsheets, model files for the next command."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hybrid_id import __version__
from hybrid_id.identification.horizons import Horizon
from hybrid_id.plain import plain
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.finding import Finding
from hybrid_id.statistics.identifiability import Identifiability
from hybrid_id.study import Comparison, Replay, Study
from hybrid_id.systems.model_file import save_model


def horizon_result(horizon: Horizon) -> dict[str, Any]:
    """How long the free runs are, as plain data."""
    seconds = horizon.seconds if horizon.kind == "windows" else None
    return {"kind": horizon.kind, "seconds": seconds, "words": str(horizon)}


def study_result(study: Study, *, reach: float, level: float) -> dict[str, Any]:
    """A study as plain data."""
    index, variation = study.selection.index, study.variation
    return {
        "pooled": study.pooled,
        "horizon": horizon_result(study.horizon),
        "parameters": list(study.names),
        "units": list(study.selected.units),
        "level": level,
        "selected": {
            "set": study.selection.name,
            "reason": study.selection.reason,
            "set_by_the_papers_rule": study.selection.paper_name,
            "values": dict(zip(study.names, study.selected.values, strict=True)),
            "half_widths": dict(zip(study.names, reach * study.standard_errors(index), strict=True)),
        },
        "sets": [_set_result(study, i) for i in range(len(study.sets))],
        "variation": None
        if variation is None
        else {
            name: {
                "mean": variation.mean[k],
                "std": variation.std[k],
                "percent": variation.percent[k],
                "acceptable": variation.acceptable[k],
                "held_by_prior": variation.held[k],
            }
            for k, name in enumerate(variation.names)
        },
        "trust": {
            t.name: {"grade": t.grade, "std_error": t.std_error, "reason": t.reason} for t in study.trust
        },
        "identifiability": identifiability_result(study.identifiability),
        "combinations": {
            name: {
                "values": study.combinations.values[:, k],
                "std_error": study.combinations.std_error[:, k],
                "percent": None
                if study.combinations.variation is None
                else study.combinations.variation.percent[k],
            }
            for k, name in enumerate(study.combinations.names)
        },
        "cross_validation": {
            "sets": study.cross_validation.set_names,
            "records": study.cross_validation.record_names,
            "signals": study.cross_validation.signal_names,
            "fit_percent": study.cross_validation.fits,
            "mean": study.selection.mean,
            "std": study.selection.std,
        },
        "test_nrmse": study.test_nrmse,
        "engine_error": study.engine_error,
        "profiles": {
            name: {
                "lower": one.lower,
                "upper": one.upper,
                "closed": one.closed,
                "message": one.message,
                "values": one.values,
                "costs": one.costs,
                "threshold": one.threshold,
            }
            for name, one in study.profiles.items()
        },
    }


def _set_result(study: Study, index: int) -> dict[str, Any]:
    result = study.sets[index]
    return {
        "set": study.cross_validation.set_names[index],
        "records": list(dict.fromkeys(result.records)),
        "values": result.values,
        "std_error": study.covariances[index].std_error,
        "robust_std_error": study.robust[index].std_error,
        "status": result.status,
        "message": result.message,
        "at_bound": result.at_bound,
        "cost": result.cost,
        "weighted_residual": result.noise_scale,
        "iterations": result.iterations,
        "substeps": result.engine.substeps,
    }


def identifiability_result(told: Identifiability) -> dict[str, Any]:
    """What records tell about parameters as plain data."""
    return {
        "condition_number": told.condition_number,
        "directions": [
            {
                "text": d.text,
                "relative": dict(zip(told.names, d.relative, strict=True)),
                "relative_std": d.relative_std,
                "with_prior": d.with_prior,
            }
            for d in told.directions
        ],
        "combinations": [
            {"text": c.text, "relative_std": std}
            for c, std in zip(told.combinations, told.combination_std, strict=True)
        ],
        "relative_std": dict(zip(told.names, told.relative_std, strict=True)),
        "not_claimable": told.not_claimable,
    }


def check_result(
    dataset: Dataset, findings: Sequence[Finding], told: Identifiability | None
) -> dict[str, Any]:
    """Result of a check as plain data."""
    return {
        "dataset": dataset.name,
        "records": [
            {
                "name": r.name,
                "role": r.role,
                "samples": r.n_samples,
                "duration": r.duration,
                "sample_time": r.sample_time,
                "uniform": r.is_uniform,
            }
            for r in dataset
        ],
        "findings": [vars(finding) for finding in findings],
        "identifiability": None if told is None else identifiability_result(told),
    }


def comparison_result(comparison: Comparison) -> dict[str, Any]:
    """Fits of several models as plain data."""
    return {
        label: {
            r.record.name: {"role": r.record.role, "status": r.status, "fit_percent": r.fit, "nrmse": r.nrmse}
            for r in replays
        }
        for label, replays in comparison.replays.items()
    }


def write_parameters(path: Path, study: Study, reach: float) -> None:
    """One row for each parameter of each set: value, interval within the bounds, and whether it may be claimed.

    At a bound the errors are not normal, so nothing is claimed there.
    """
    heads = ["set", "selected", "parameter", "value", "unit", "std_error", "lower", "upper"]
    heads += ["claimable", "at_bound", "status"]
    rows = []
    for i, result in enumerate(study.sets):
        errors = study.standard_errors(i)
        for k, name in enumerate(study.names):
            known, at_bound = bool(np.isfinite(errors[k])), name in result.at_bound
            spec = result.system.parameter(name).spec
            ends = (result.values[k] + side * reach * errors[k] for side in (-1, 1))
            interval = [errors[k], *(min(max(end, spec.lower), spec.upper) for end in ends)]
            rows.append(
                [
                    study.cross_validation.set_names[i], int(i == study.selection.index), name,
                    f"{result.values[k]:.10g}", result.units[k], *(f"{v:.6g}" if known else "" for v in interval),
                    int(known), int(at_bound), result.status,
                ]
            )  # fmt: skip
    _write_rows(path, heads, rows)


def write_models(folder: Path, study: Study) -> None:
    """The selected model as ``model.yaml``, and every set's in ``models/``."""
    save_model(study.selected_model, folder / "model.yaml")
    if len(study.sets) > 1:
        (folder / "models").mkdir()
        for name, result in zip(study.cross_validation.set_names, study.sets, strict=True):
            save_model(result.system, folder / "models" / f"{name}.yaml")


def write_replay(path: Path, replay: Replay) -> None:
    """Time, inputs, measured and simulated outputs of one record."""
    record = replay.record
    columns = {"t": record.time, **record.inputs, **record.outputs}
    columns |= {f"{name}_simulated": values for name, values in replay.outputs.items()}
    rows = zip(*columns.values(), strict=True)
    # stamps may count from 1970
    _write_rows(path, tuple(columns), ([f"{t:.15g}", *(f"{v:.10g}" for v in row)] for t, *row in rows))


def write_comparison(path: Path, comparison: Comparison) -> None:
    """One row for each model, record and output: fit and normalised RMSE."""
    rows = (
        [
            label,
            r.record.name,
            r.record.role,
            signal,
            f"{r.fit[signal]:.6g}",
            f"{r.nrmse[signal]:.6g}",
            r.status,
        ]
        for label, replays in comparison.replays.items()
        for r in replays
        for signal in comparison.signals
    )
    _write_rows(path, ("model", "record", "role", "output", "fit_percent", "nrmse", "status"), rows)


def as_json(command: str, result: Mapping[str, Any]) -> str:
    """A result as strict JSON (what is not finite becomes null), with the program that made it."""
    return json.dumps({"program": f"hybrid_id {__version__}", "command": command} | plain(result), indent=1)


def _write_rows(path: Path, heads: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(heads)
        writer.writerows(rows)
