"""Every grade, and the reason that it gives."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hybrid_id.statistics.reliability import reliability_grades


def grade(errors, **state):
    return reliability_grades(
        ["J"], np.array([1.0]), {way: np.array([e]) for way, e in errors.items()}, **state
    )[0]


@pytest.mark.parametrize(
    ("errors", "expected", "words"),
    [
        ({"plain": 0.01, "robust": 0.012, "bootstrap": 0.011, "between records": 0.013}, "A", "agree"),
        (
            {"plain": 0.01, "robust": 0.03, "bootstrap": 0.035, "between records": 0.04},
            "B",
            "4.0 times too confident",
        ),
        ({"plain": 0.01, "robust": 0.012, "between records": 0.03}, "C", "differs from record to record"),
        ({"plain": 0.01, "robust": 0.012, "between records": 0.05}, "C", "4.2 times"),
        ({"plain": 0.03, "robust": 0.036, "between records": 0.15}, "D", "4.2 times"),
        ({"plain": 0.01, "robust": 0.6}, "D", "60 % of its value"),
        ({"plain": 0.01}, "C", "nothing checks it"),
        ({"plain": 0.01, "robust": np.nan}, "C", "nothing checks it"),
        ({"plain": 0.1, "robust": 0.01}, "C", "below the plain"),
        ({"plain": np.inf, "robust": np.inf}, "D", "inf"),
        ({}, "D", "no standard error"),
    ],
)
def test_grades(errors, expected, words):
    found = grade(errors)
    assert found.grade == expected
    assert words in found.reason


@pytest.mark.parametrize(
    ("state", "words"),
    [
        ("not_identifiable", "do not identify it"),
        ("held", "prior holds it"),
        ("at_bound", "bound; no interval is claimed"),
    ],
)
def test_no_agreement_rescues_these(state, words):
    found = grade({"plain": 0.01, "robust": 0.01}, **{state: ["J"]})
    assert found.grade == "D" and words in found.reason
    assert grade({"plain": 0.01, "robust": 0.01}, **{state: ["other"]}).grade == "A"


def test_not_identifiable_has_no_interval_at_all():
    assert grade({"plain": 0.01}, not_identifiable=["J"]).std_error == np.inf


@given(st.dictionaries(st.sampled_from(["plain", "robust", "bootstrap"]), st.floats(1e-6, 10), min_size=1))
def test_the_error_to_use_is_never_below_any_way(errors):
    assert grade(errors).std_error == max(errors.values())


def test_records_that_agree_to_the_last_digit_are_no_way_to_tell():
    (grade,) = reliability_grades(
        ["J"],
        np.array([1.0]),
        {"plain": np.array([0.02]), "robust": np.array([0.01]), "between records": np.array([0.0])},
    )
    assert np.isfinite(grade.std_error) and "e+" not in grade.reason
