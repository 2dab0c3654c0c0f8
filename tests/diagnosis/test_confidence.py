"""Intervals and grades of a diagnosis's models: those of `identify`, and none for what the records do not show."""

import numpy as np

from hybrid_id.diagnosis.details import as_identified
from hybrid_id.diagnosis.fits import Fits
from hybrid_id.diagnosis.result import Diagnosis
from hybrid_id.records.dataset import Dataset
from hybrid_id.systems import System


def test_what_only_the_scale_of_all_torques_sets_has_no_interval(
    diagnosed: tuple[Dataset, System, Diagnosis],
) -> None:
    dataset, _, found = diagnosed
    told = as_identified(Fits(dataset), found.search.chosen)
    assert told.names == found.search.chosen.result.names
    np.testing.assert_allclose(told.selected.values, found.search.chosen.result.values)
    # voltage and angle: all torques and inertias may be multiplied by one number
    assert {"J", "k_s", "P_m1"} <= set(told.identifiability.not_claimable)
    grades = {one.name: one.grade for one in told.reliability}
    errors = dict(zip(told.names, told.standard_errors(0), strict=True))
    assert grades["k_s"] == "D" and errors["k_s"] == np.inf
    # where the spring pulls nowhere does not depend on that scale
    assert np.isfinite(errors["q_s"]) and grades["q_s"] != "D"
    names = list(told.combinations.names)
    ratio = names.index("k_s/P_m1")
    value, error = told.combinations.values[0, ratio], told.combinations.std_error[0, ratio]
    assert abs(value - 0.6 / 0.019) < 4.0 * error < 0.2 * value
