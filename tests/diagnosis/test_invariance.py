"""Test records measure and change nothing: scrambling their outputs leaves the answer as it was, number by number."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from gapcase import only, small_case

from hybrid_id import Dataset, Diagnosis
from hybrid_id.components import REGISTRY
from hybrid_id.diagnosis.diagnose import diagnose
from hybrid_id.identification.keep import Kept

OF_TEST_RECORDS = (
    "gap", "extrapolation", "not_identifiable", "next_experiments",
)  # fmt: skip
"""Entries of the file that the test records may change: errors on them and where they go; the last two are asked of all
records and are no part of the answer."""


def scrambled(dataset: Dataset, how: str) -> Dataset:
    """The dataset with what its test records measured in another order, or noise in its place."""
    rng = np.random.default_rng(7)

    def other(y: np.ndarray) -> np.ndarray:
        return (
            rng.permutation(y)
            if how == "permuted"
            else y.mean() + 3.0 * y.std() * rng.standard_normal(len(y))
        )

    records = (
        replace(r, outputs={n: other(y) for n, y in r.outputs.items()}) if r.role == "test" else r
        for r in dataset.records
    )
    return replace(dataset, records=tuple(records))


def answer(found: Diagnosis) -> dict[str, Any]:
    """All that a diagnosis says but for what test records measure, with the values of the corrected model."""
    said = {key: value for key, value in found.as_dict().items() if key not in OF_TEST_RECORDS}
    values = {name: {i.name: i.spec.value for i in one.system.table} for name, one in found.fitted.items()}
    return said | {
        "models": values,
        "places": {name: list(m.system.components) for name, m in found.fitted.items()},
    }


@pytest.fixture
def few() -> Iterator[None]:
    """A catalogue of what is missing, a near rival and a far one."""
    with only("spring_load", "constant_torque", "quadratic_drag"):
        yield


@pytest.mark.usefixtures("few")
@pytest.mark.parametrize("missing", ["spring", "nothing", "unknown"])
def test_scrambled_test_records_change_no_answer(missing: str, kept: Kept) -> None:
    laws = {
        "spring": ("spring_load", {"k_s": 0.6, "q_s": 0.3}, "load"),
        "unknown": ("cogging", {"T_c": 0.01}, "motor"),
    }
    kind, values, place = laws.get(missing, (None, {}, "load"))
    dataset, nominal = small_case(kind and REGISTRY[kind](**values), f"joint1/{place}")
    found = diagnose(dataset, nominal, max_effects=1, kept=kept)
    assert [one.name for one in found.selected] == (["spring_load"] if missing == "spring" else [])
    assert found.unknown == (missing == "unknown")
    for how, fits in (
        ("permuted", None),
        ("noise", kept),
    ):  # once with no fit in common, then with those kept
        other = diagnose(scrambled(dataset, how), nominal, max_effects=1, kept=fits)
        assert answer(other) == answer(found)
        assert other.with_effect.nrmse > found.with_effect.nrmse
    without = diagnose(replace(dataset, records=dataset.train), nominal, max_effects=1, kept=kept)
    assert answer(without) == answer(found)
    assert without.shrink is None
