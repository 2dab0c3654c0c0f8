"""Results as data frames, and what a notebook shows of them."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from drives import make_records, multisine, rigid_drive

from hybrid_id import Channel, Dataset
from hybrid_id.diagnosis.result import Diagnosis
from hybrid_id.study import Study, identify

BAD = "<script>alert(1)</script>"


@pytest.fixture(scope="module")
def study() -> Study:
    voltages = [multisine(k, samples=500, amplitude=7.0) for k in range(3)]
    records = make_records(rigid_drive(), voltages, noise={"q_m1": 0.01})
    records[2] = replace(records[2], role="test")
    data = Dataset("drive", (Channel("u1", "V"),), (Channel("q_m1", "rad"),), tuple(records), 0.002)
    return identify(data, rigid_drive())


def test_table_of_a_study_holds_its_numbers(study: Study) -> None:
    table = study.table()
    assert isinstance(table, pd.DataFrame) and tuple(table.index) == study.names
    assert np.array_equal(table["value"], study.selected.values)
    assert np.array_equal(table[["lower", "upper"]].to_numpy(), study.intervals(), equal_nan=True)
    assert table.loc["J", "unit"] == "kg m^2" and table.loc["J", "meaning"] == "inertia at the motor"
    assert np.array_equal(table["std_over_mean"], study.variation.percent / 100.0)
    assert list(table["reliability"]) == [one.words for one in study.reliability]
    assert "mean" not in replace(study, variation=None).table()


def test_notebook_shows_a_study(study: Study) -> None:
    text = study._repr_html_()
    for words in (*study.names, "inertia at the motor", "normalised RMSE on 1 test record"):
        assert words in text
    assert study.summary().splitlines()[0] in text.replace("&#x27;", "'")


def test_table_of_a_diagnosis_holds_its_effects(diagnosed) -> None:
    found: Diagnosis = diagnosed[2]
    table = found.table()
    assert list(table["effect"]) == [one.name for one in found.effects]
    first = table.iloc[0]
    assert first["selected"] and first["share"] == found.effects[0].share
    assert first["parameters"] == {k: v for k, (v, _) in found.effects[0].parameters.items()}
    assert first["share_lower"] <= first["share"] <= first["share_upper"]
    nothing = replace(found, effects=()).table()
    assert list(nothing.columns) == list(table.columns) and not len(nothing)


def test_notebook_shows_a_diagnosis(diagnosed) -> None:
    found: Diagnosis = diagnosed[2]
    text = replace(found, case=BAD)._repr_html_()
    assert (
        "<script" not in text
        and "&lt;script&gt;" in text
        and "verdict: effects" in text
        and "spring_load" in text
    )
    assert "no_gap" in replace(found, effects=(), verdict="no_gap")._repr_html_()
