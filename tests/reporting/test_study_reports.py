"""Pictures, tables and files of a study: complete, with units, and the same numbers everywhere."""

import csv
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import text_of
from drives import make_records, multisine, only, rigid_drive

from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.reporting.results import as_json, study_result, write_parameters
from hybrid_id.reporting.study import study_table
from hybrid_id.reporting.study_figures import (
    comparison_figure,
    cross_validation_figure,
    parameter_figure,
)
from hybrid_id.reporting.style import pixels
from hybrid_id.reporting.tables import comparison_table, identifiability_table, truth_table
from hybrid_id.statistics.identifiability import identifiability
from hybrid_id.study import (
    Comparison,
    Study,
    analyse_fits,
    check_fit,
    check_priors,
    compare,
    identify,
)
from hybrid_id.study.replay import beside_nominal

TRUTH = {"J": 2e-5, "P_m1": 0.019, "P_m2": 0.0254, "F_c": 0.01, "F_v": 5e-5}


@pytest.fixture(scope="module")
def dataset() -> Dataset:
    """Two train records and one test record of a drive with motor and link encoder."""
    truth, names = rigid_drive(), ("q_m1", "q_a1")
    noise = {"q_m1": 0.01, "q_a1": 1e-4}
    voltages = [multisine(k, samples=500, amplitude=7.0) for k in range(3)]
    records = make_records(truth, voltages, noise=noise, outputs=names)
    records[2] = replace(records[2], role="test")
    channels = (Channel("u1", "V"),), (Channel("q_m1", "rad", 0.01), Channel("q_a1", "rad", 1e-4))
    return Dataset("two encoders", *channels, tuple(records), 0.002)


@pytest.fixture(scope="module")
def study(dataset: Dataset) -> Study:
    """Its identification without priors: torques have no scale of their own."""
    return identify(dataset, rigid_drive().with_values({"J": 2.3e-5, "F_c": 0.008}))


@pytest.fixture(scope="module")
def pooled(dataset: Dataset) -> Study:
    return identify(dataset, rigid_drive(), pooled=True)


def test_pooled_study_and_diverged_sets_are_drawn(dataset: Dataset, pooled: Study, study: Study) -> None:
    assert pixels(parameter_figure(pooled)).shape[2] == 3
    assert pixels(cross_validation_figure(pooled)).any()
    fits = study.cross_validation.fits.copy()
    fits[0, 1] = -np.inf
    broken = replace(study, cross_validation=replace(study.cross_validation, fits=fits))
    figure = cross_validation_figure(broken)
    assert "div." in [text.get_text() for text in figure.axes[0].texts]
    sound = compare(dataset, {"sound": study.selected_model}).replays["sound"]
    nowhere = {name: np.full(500, np.nan) for name in ("q_m1", "q_a1")}
    fit, error = (dict.fromkeys(nowhere, value) for value in (-np.inf, np.inf))
    mad = tuple(replace(run, outputs=nowhere, status="diverged", fit=fit, nrmse=error) for run in sound)
    comparison = Comparison({"sound": sound, "mad": mad})
    assert pixels(comparison_figure(dataset, comparison, "run_1")).any()
    assert text_of(comparison_table(comparison)).splitlines()[0].count("sound") == 1
    assert "diverged" in text_of(comparison_table(comparison))


def test_a_fit_worse_than_the_mean_is_said(study: Study) -> None:
    assert check_fit(study) == ""
    fits = np.full_like(study.cross_validation.fits, -50.0)
    worse = replace(study, cross_validation=replace(study.cross_validation, fits=fits))
    assert "less than the mean of the records (normalised RMSE 1.5); check signs" in check_fit(worse)
    assert "check signs" in check_fit(replace(study, test_nrmse={"run_2": 1.2}))
    one = check_fit(replace(study, test_nrmse={"run_2": 0.01, "run_3": 2.7, "run_4": 0.02}))
    assert "but for run_3 (normalised RMSE 2.7, median 0.02); check signs, units and columns there" in one


@pytest.mark.parametrize("role", ["test", "validation"])
def test_that_a_fit_predicts_worse_than_the_nominal_values_is_said(dataset: Dataset, role: str) -> None:
    """The train records are of another drive than the last record, whose values are the nominal ones."""
    other = rigid_drive().with_values({"F_c": 0.014, "F_v": 7e-5})
    voltages = [multisine(k, samples=500, amplitude=7.0) for k in range(2)]
    noise = {"q_m1": 0.01, "q_a1": 1e-4}
    records = make_records(other, voltages, noise=noise, outputs=("q_m1", "q_a1"))
    last, system = dataset.records[2], only(rigid_drive(), "F_c", "F_v")
    found = identify(replace(dataset, records=(*records, replace(last, role=role))), system, pooled=True)
    beside = found.beside_nominal
    assert (beside.role, beside.count, beside.worse) == (role, 1, True)
    assert role == "validation" or beside.identified == pytest.approx(found.test_error)
    said = f"predict the 1 {role} record worse than the nominal values do: normalised RMSE"
    assert said in found.summary() and said in " ".join(text_of(study_table(found)).split())
    assert study_result(found)["beside_nominal"]["worse"]
    alone = replace(dataset, records=(replace(last, role="train"),))
    at_fit = beside_nominal(alone, system, found.selected)
    assert (at_fit.role, at_fit.worse) == ("train", True) and "--starts" in at_fit.words


def test_a_value_far_from_its_prior_is_said(study: Study) -> None:
    assert check_priors(study) == []
    index, chosen = study.selection.index, study.selected
    value = dict(zip(chosen.names, chosen.values, strict=True))["J"]
    spec = replace(chosen.system.parameter("J").spec, prior_mean=0.5 * value, prior_std=0.05 * value)
    odd = replace(chosen, system=chosen.system.with_specs({"J": spec}))
    (words,) = check_priors(replace(study, sets=(*study.sets[:index], odd, *study.sets[index + 1 :])))
    assert words.startswith("J = ") and "10 standard deviations from its prior" in words


def test_tables_claim_no_interval_where_there_is_none(study: Study) -> None:
    words = text_of(study_table(study))
    row = next(line for line in words.splitlines() if line.startswith("J "))
    assert "none" in row
    assert "J/P_m1" in words
    assert "may all be multiplied by one number" in text_of(identifiability_table(study.identifiability))
    told = text_of(truth_table(study, TRUTH))
    assert told.count("none claimed") == len(study.identifiability.not_claimable)


def test_combinations_come_out_right(study: Study) -> None:
    told = study.combinations
    truth = np.array(
        [c.evaluate(np.array([TRUTH[n] for n in study.names])) for c in study.identifiability.combinations]
    )
    assert told.values.shape == (2, len(told.names))
    assert np.all(np.abs(told.values - truth) < 4 * told.std_error)
    assert np.all(told.std_error < 0.2 * np.abs(truth))


def test_study_that_identifies_nothing_has_no_combinations(study: Study) -> None:
    p = len(study.names)
    told = identifiability(np.ones(p), study.names, jacobian=np.zeros((50, p)))
    nothing = replace(study, identifiability=told)
    assert nothing.combinations.values.shape == nothing.combinations.std_error.shape == (2, 0)
    assert study_result(nothing)["combinations"] == {}
    assert "what is identified" not in text_of(study_table(nothing))
    assert "what the records identify" not in text_of(identifiability_table(told))
    assert pixels(parameter_figure(nothing)).any()


def test_json_is_strict_and_agrees_with_the_table(study: Study, tmp_path: Path) -> None:
    def refuse(word: str) -> float:
        raise AssertionError(f"{word} is no JSON")

    text = as_json("identify", study_result(study))
    result = json.loads(text, parse_constant=refuse)
    assert result["selected"]["intervals"]["J"] is None
    assert (
        result["reliability"]["J"]["words"] == "not on its own" and result["reliability"]["J"]["grade"] == "D"
    )
    assert all("std_error_of_mean" in one for one in result["reliability"].values())
    assert result["identifiability"]["not_identifiable"] != []
    assert set(result["nominal_model"]) == {info.name for info in study.system.table}  # held ones, too
    start, spec = result["nominal_model"]["J"], study.system.parameter("J").spec
    assert (start["nominal"], start["lower"], start["prior_std"]) == (spec.value, spec.lower, spec.prior_std)
    assert result["program"].startswith("hybrid_id ")
    write_parameters(tmp_path / "parameters.csv", study)
    with (tmp_path / "parameters.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * len(study.names)
    for row in rows:
        assert (row["claimable"] == "0") == (row["std_error"] == "" == row["interval_lower"])
        k = study.names.index(row["parameter"])
        i = [r.records[0] for r in study.sets].index(row["set"])
        assert math.isclose(float(row["value"]), study.values[i, k], rel_tol=1e-9)


def test_nothing_is_claimed_beyond_or_at_a_bound(study: Study, tmp_path: Path) -> None:
    first = study.sets[0]
    k = study.names.index("F_v")
    value = first.values[k]
    spec = replace(first.system.parameter("F_v").spec, lower=value)
    stuck = replace(first, system=first.system.with_specs({"F_v": spec}))
    told = replace(study.identifiability, claimable=np.ones(len(study.names), bool))
    known = tuple(replace(c, std_error=0.1 * np.abs(first.values)) for c in study.covariances)
    sets = (stuck, *study.sets[1:])
    bounded = replace(study, sets=sets, identifiability=told, covariances=known, robust=known)
    write_parameters(tmp_path / "parameters.csv", bounded)
    with (tmp_path / "parameters.csv").open() as file:
        row = list(csv.DictReader(file))[k]
    assert (row["claimable"], row["at_bound"]) == ("0", "1")
    assert row["std_error"] == row["interval_lower"] == row["interval_upper"] == ""
    for index in (0, 1):  # whichever is selected
        chosen = replace(bounded, selection=replace(study.selection, index=index))
        assert "at a bound: F_v (in 1 of 2 sets)" in text_of(study_table(chosen))


def test_a_fit_that_was_stopped_claims_no_interval(dataset: Dataset, study: Study) -> None:
    stopped = [replace(study.sets[0], status="interrupted"), *study.sets[1:]]
    told = analyse_fits(dataset, study.system, stopped, pooled=False)
    assert np.isinf(told.standard_errors(0)).all()
    assert np.isinf(told.combinations.std_error[0]).all()
    assert np.isfinite(told.combinations.std_error[1]).any()
    assert {t.grade for t in told.reliability} == {"D"}
    assert "stopped before its end" in told.reliability[0].reason
    assert "stopped by the user" in " ".join(text_of(study_table(told)).split())
