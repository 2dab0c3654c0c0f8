"""Cross-validation matrix and the two rules of selection."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hybrid_id.statistics.cross_validation import CrossValidation, select


def matrix(rows, set_names=("a", "b", "c", "d")):
    """Fits of some sets on some records, of one signal or of several."""
    fits = np.asarray(rows, float)
    fits = fits if fits.ndim == 3 else fits[:, :, None]
    n_sets, n_records, n_signals = fits.shape
    records, signals = (tuple(map(str, range(n))) for n in (n_records, n_signals))
    return CrossValidation(fits, tuple(set_names[:n_sets]), records, signals, range(n_sets))


def test_the_steadiest_of_the_good_ones_is_selected():
    fits = [[95, 85, 96], [93, 92, 92], [80, 80, 80]]
    selection = select(matrix(fits, set_names=["a", "b", "c"]))
    assert selection.name == "b"
    np.testing.assert_array_equal(selection.candidate, [True, True, False])
    assert "least std/mean" in selection.reason


def test_the_papers_rule_rewards_a_uniformly_bad_set():
    fits = [[95, 85, 96], [93, 92, 92], [20, 20, 20]]
    selection = select(matrix(fits, set_names=["a", "b", "c"]))
    assert selection.paper_name == "c"
    assert "would select c" in selection.summary()


def test_a_set_that_diverges_once_is_never_selected():
    selection = select(matrix([[99, 99, -np.inf], [60, 70, 50]]))
    assert selection.index == 1 and selection.paper_index == 1
    assert selection.mean[0] == -np.inf


def test_where_no_set_is_usable_the_least_bad_is_named_as_such():
    selection = select(matrix([[-5.0, -np.inf], [-1.0, -2.0], [-3.0, -9.0]]))
    assert selection.index == 1
    assert "no parameter set simulates the records better than their mean" in selection.reason
    assert not selection.candidate.any()
    assert select(matrix([[-np.inf, -np.inf]])).index == 0


def test_a_constant_signal_leaves_the_others_to_stand_for_the_record():
    fits = np.array([[[90, np.nan], [80, 90]], [[50, np.nan], [50, 50]]], float)
    selection = select(matrix(fits))
    assert selection.mean[0] == pytest.approx(87.5)


@given(arrays(float, (4, 5), elements=st.floats(1, 100)))
def test_the_selected_set_is_always_within_the_tolerance(fits):
    selection = select(matrix(fits))
    assert selection.mean[selection.index] >= selection.mean.max() - 2
    assert selection.percent[selection.paper_index] == selection.percent.min()
