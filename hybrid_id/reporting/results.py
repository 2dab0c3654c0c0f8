"""Results as files: JSON for programs, CSV for spreadsheets, model files for the next command."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hybrid_id import __version__
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.files import plain
from hybrid_id.records.quality import Finding
from hybrid_id.statistics.identifiability import Identifiability
from hybrid_id.statistics.uncertainty import normal_interval
from hybrid_id.study import Comparison, Horizon, ModelCheck, Replay, Study
from hybrid_id.study.residual_torques import ArmHybrid, standard_errors
from hybrid_id.systems.model_file import save_model


def horizon_result(horizon: Horizon) -> dict[str, Any]:
    """How long the free runs are, as plain data."""
    seconds = horizon.seconds if horizon.kind == "windows" else None
    return {"kind": horizon.kind, "seconds": seconds, "words": str(horizon)}


def study_result(study: Study) -> dict[str, Any]:
    """A study as plain data."""
    selection, cross, variation = study.selection, study.cross_validation, study.variation
    combinations = study.combinations
    return {
        "pooled": study.pooled,
        "horizon": horizon_result(study.horizon),
        "parameters": list(study.names),
        "units": list(study.selected.units),
        "level": study.level,
        # start value, bounds and prior of every parameter, held ones too, under the keys of a model file
        "nominal_model": {
            info.name: {
                "nominal": info.spec.value,
                "lower": info.spec.lower,
                "upper": info.spec.upper,
                "unit": info.unit,
                "estimate": info.spec.estimate,
                "prior_mean": info.spec.prior_mean,
                "prior_std": info.spec.prior_std,
            }
            for info in study.system.table
        },
        "selected": {
            "set": selection.name,
            "reason": selection.reason,
            "set_by_the_papers_rule": selection.paper_name,
            "values": dict(zip(study.names, study.selected.values, strict=True)),
            "intervals": {
                name: ends if np.isfinite(ends).all() else None
                for name, ends in zip(study.names, study.intervals(), strict=True)
            },
        },
        "sets": [
            {
                "set": name,
                "records": list(dict.fromkeys(result.records)),
                "values": result.values,
                "std_error": study.covariances[i].std_error,
                "robust_std_error": study.robust[i].std_error,
                "input_std_error": None if study.input_error is None else study.input_error[i],
                "status": result.status,
                "message": result.message,
                "at_bound": result.at_bound,
                "cost": result.cost,
                "weighted_residual": result.noise_scale,
                "iterations": result.iterations,
                "substeps": result.engine.substeps,
            }
            for i, (name, result) in enumerate(zip(cross.set_names, study.sets, strict=True))
        ],
        # over the sets; None with fewer than two
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
        "reliability": {
            one.name: {
                "grade": one.grade,
                "words": one.words,
                "std_error_of_mean": one.std_error,  # of the sets, not the selected set's
                "reason": one.reason,
            }
            for one in study.reliability
        },
        "identifiability": identifiability_result(study.identifiability),
        "combinations": {
            name: {
                "values": combinations.values[:, k],
                "std_error": combinations.std_error[:, k],
                "percent": None if combinations.variation is None else combinations.variation.percent[k],
            }
            for k, name in enumerate(combinations.names)
        },
        "cross_validation": {
            "sets": cross.set_names,
            "records": cross.record_names,
            "signals": cross.signal_names,
            "fit_percent": cross.fits,
            "mean": selection.mean,
            "std": selection.std,
        },
        "test_nrmse": study.test_nrmse,
        "test_errors": {name: vars(one) for name, one in study.test_errors.items()},
        "beside_nominal": vars(study.beside_nominal) | {"worse": study.beside_nominal.worse},
        "engine_error": study.engine_error,
        "profiles": {name: vars(one) for name, one in study.profiles.items()},
    }


def identifiability_result(identified: Identifiability) -> dict[str, Any]:
    """What records identify of the parameters, as plain data."""
    return {
        "condition_number": identified.condition_number,
        "directions": [
            {
                "text": d.text,
                "relative": dict(zip(identified.names, d.relative, strict=True)),
                "relative_std": d.relative_std,
                "with_prior": d.with_prior,
            }
            for d in identified.directions
        ],
        "combinations": [
            {"text": c.text, "relative_std": std}
            for c, std in zip(identified.combinations, identified.combination_std, strict=True)
        ],
        "relative_std": dict(zip(identified.names, identified.relative_std, strict=True)),
        "not_identifiable": identified.not_claimable,
    }


def check_result(
    dataset: Dataset,
    findings: Sequence[Finding],
    found: ModelCheck | None,
) -> dict[str, Any]:
    """Result of a check as plain data."""
    identified, based = (None, None) if found is None else (found.identified, found.based)
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
        "identifiability": None if identified is None else identifiability_result(identified),
        "base_parameters": None
        if based is None
        else {
            "inertial_parameters": len(based.base.names),
            "without_effect": based.base.without_effect,
            "condition_number": based.condition_number,
            "missing": based.missing,
            "parameters": [
                {
                    "text": based.base.text(k),
                    "coefficients": based.base.coefficients(k),
                    "value": value,
                    "std_error": std,
                    "relative_std": relative,
                }
                for k, (value, std, relative) in enumerate(
                    zip(based.values, based.std, based.relative_std, strict=True)
                )
            ],
        },
    }


def comparison_result(comparison: Comparison) -> dict[str, Any]:
    """Fits of several models as plain data."""
    return {
        label: {
            r.record.name: {
                "role": r.record.role,
                "status": r.status,
                "fit_percent": r.fit,
                "nrmse": r.nrmse,
                "rmse": r.rmse,
            }
            for r in replays
        }
        for label, replays in comparison.replays.items()
    }


PARAMETER_HEADS = (
    "set", "selected", "parameter", "value", "unit", "std_error", "interval_lower", "interval_upper", "claimable",
    "at_bound", "status",
)  # fmt: skip
"""Columns of ``parameters.csv``."""


def write_parameters(path: Path, study: Study) -> None:
    """One row for each parameter of each set: value, interval, and whether it may be claimed.

    At a bound the errors are not normal, so nothing is claimed there.
    """
    rows = []
    for i, result in enumerate(study.sets):
        label, chosen = study.cross_validation.set_names[i], int(i == study.selection.index)
        errors, intervals = study.standard_errors(i), study.intervals(i)
        for k, (name, value, unit) in enumerate(zip(study.names, result.values, result.units, strict=True)):
            known = bool(np.isfinite(errors[k]))
            ends = ("" if np.isnan(v) else f"{v:.6g}" for v in intervals[k])
            interval = f"{errors[k]:.6g}" if known else "", *ends
            flags = int(known), int(name in result.at_bound), result.status
            rows.append([label, chosen, name, f"{value:.10g}", unit, *interval, *flags])
    write_rows(path, PARAMETER_HEADS, rows)


def write_physics(path: Path, found: ArmHybrid) -> None:
    """Physical parameters of each joint, alone and beside the network that stays: columns of :func:`write_parameters`.

    Of a value beside a network no interval is claimed: it is held to where the physics alone has put it.
    """
    rows, level = [], 0.95
    joints: dict[int, list[str]] = {}
    for name, one in found.joints.items():  # those of a coupled gear share their fits
        joints.setdefault(id(one.physics), []).append(name)
    for names in joints.values():
        one, label = found.joints[names[0]], " and ".join(names)
        stays, errors = one.size is not None, standard_errors(one.physics)
        sets = [("physics alone", one.physics, int(not stays), errors)]
        sets += [("with network", one.hybrid, 1, {})] if stays else []
        for words, fit, chosen, known in sets:
            values = {name: fit.system.parameter(name).spec.value for name in one.physics.names}
            for name, unit in zip(one.physics.names, one.physics.units, strict=True):
                std = known.get(name) if name not in fit.at_bound else None
                ends = [""] * 3
                if std is not None:
                    interval = normal_interval(np.array(values[name]), np.array(std), level)
                    ends = [f"{v:.6g}" for v in (std, *interval)]
                flags = int(std is not None), int(name in fit.at_bound), fit.status
                rows.append([f"{label}: {words}", chosen, name, f"{values[name]:.10g}", unit, *ends, *flags])
    write_rows(path, PARAMETER_HEADS, rows)


def write_models(folder: Path, home: Path, study: Study) -> None:
    """The selected model as ``model.yaml``, and every set's in ``models/``; ``home`` is the folder's name at last."""
    save_model(study.selected_model, folder / "model.yaml", home)
    if len(study.sets) > 1:
        (folder / "models").mkdir()
        for name, result in zip(study.cross_validation.set_names, study.sets, strict=True):
            save_model(result.system, folder / "models" / f"{name}.yaml", home / "models", moved=folder)


def write_replay(path: Path, replay: Replay) -> None:
    """Time, inputs, measured and simulated outputs of one record."""
    record = replay.record
    columns = {"t": record.time, **record.inputs, **record.outputs}
    columns |= {f"{name}_simulated": values for name, values in replay.outputs.items()}
    rows = zip(*columns.values(), strict=True)
    # stamps may count from 1970
    write_rows(path, tuple(columns), ([f"{t:.15g}", *(f"{v:.10g}" for v in row)] for t, *row in rows))


def write_comparison(path: Path, comparison: Comparison) -> None:
    """One row for each model, record and output: fit, normalised RMSE, and RMSE in SI."""
    heads = ("model", "record", "role", "output", "fit_percent", "nrmse", "rmse", "status")
    rows = (
        (label, record, r["role"], signal, *(f"{r[name][signal]:.6g}" for name in heads[4:7]), r["status"])
        for label, records in comparison_result(comparison).items()
        for record, r in records.items()
        for signal in comparison.signals
    )
    write_rows(path, heads, rows)


def as_json(command: str, result: Mapping[str, Any]) -> str:
    """A result as strict JSON (what is not finite becomes null), with the program that made it."""
    return json.dumps({"program": f"hybrid_id {__version__}", "command": command} | plain(result), indent=1)


def write_rows(path: Path, heads: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """A table as CSV."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(heads)
        writer.writerows(rows)
