"""Parameters that differ from record to record are no effect that a model lacks."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from drives import make_record, multisine, rigid_drive
from gapcase import NOISE, RATIO, SAMPLES, STEP, small_case

import hybrid_id.diagnosis.diagnose as module
from hybrid_id.components import REGISTRY
from hybrid_id.diagnosis.attribute import Attribution
from hybrid_id.diagnosis.own_sets import _explained, _scatter, own_sets
from hybrid_id.diagnosis.refit import Refit
from hybrid_id.records.dataset import Dataset
from hybrid_id.reporting.gap import summary
from hybrid_id.systems import System

FRICTION = (0.0092, 0.0108, 0.0100, 0.0096)


def drifting() -> tuple[Dataset, System]:
    """A drive whose dry friction is another one on every record."""
    dataset, today = small_case()
    records = [
        make_record(
            rigid_drive(ratio=RATIO).with_values({"F_c": friction}),
            multisine(k, samples=SAMPLES, amplitude=6.0 + k, rest=20, step=STEP),
            seed=k, noise={"q_m1": NOISE}, name=one.name, step=STEP,
        )
        for k, (friction, one) in enumerate(zip(FRICTION, dataset.records, strict=True))
    ]  # fmt: skip
    roles = [replace(new, role=old.role) for new, old in zip(records, dataset.records, strict=True)]
    return replace(dataset, records=tuple(roles)), today


@pytest.fixture(scope="module")
def drift() -> tuple[Dataset, System]:
    return drifting()


def test_friction_that_drifts_is_said_by_name_and_size(drift) -> None:
    dataset, today = drift
    refit = Refit(dataset)
    own = own_sets(refit, refit.base(today), today)
    assert own is not None
    assert own.varying[0].startswith("F_c by "), own.varying
    assert float(own.varying[0].split()[2]) == pytest.approx(5.7, abs=2.0)
    ratio = own.common.system.parameter("P_m1").spec.value / 0.019
    own_friction = own.common.system.parameter("F_c").spec.value / ratio
    # one of the train records' own values, whose scale nothing tells
    assert min(abs(own_friction / friction - 1.0) for friction in FRICTION[:3]) < 0.01


def test_records_that_one_set_explains_do_not_differ() -> None:
    dataset, today = small_case()
    refit = Refit(dataset)
    base = refit.base(today)
    own = own_sets(refit, base, today)
    assert own is not None and own.common is base and not own.varying


def test_what_is_missing_within_a_record_is_no_drift() -> None:
    dataset, today = small_case(REGISTRY["spring_load"](k_s=0.6, q_s=0.3))
    refit = Refit(dataset)
    base = refit.base(today)
    assert own_sets(refit, base, today) is None
    one = Refit(replace(dataset, records=dataset.records[:1]))
    assert own_sets(one, base, today) is None  # a record alone says nothing of others


def test_diagnosis_names_no_effect_but_the_drift(drift, monkeypatch) -> None:
    monkeypatch.setattr(
        module, "attribute", lambda refit, system, **_: (lambda b: Attribution(b, (), b))(refit.base(system))
    )
    found = module.diagnose(*drift)
    assert found.verdict == "parameters_only" and not found.unknown
    assert found.as_dict()["varying_parameters"][0].startswith("F_c by ")
    assert found.as_dict()["no_gap"]
    words = " ".join(summary(found).split())
    assert words.startswith("No effect is missing, but the parameters differ from record to record")
    assert "differ from record to record (standard deviation): F_c by" in words
    still = module.diagnose(*small_case(REGISTRY["spring_load"](k_s=0.6, q_s=0.3)))
    assert still.verdict == "outside_catalogue" and not still.varying


def test_a_record_that_does_not_see_a_parameter_says_nothing_of_it() -> None:
    seen, blind = np.array([[1.0, 0.0], [0.0, 1.0]] * 50) * 1e3, np.array([[1.0, 0.0], [0.0, 0.0]] * 50) * 1e3

    def one(values: list[float], jacobian: np.ndarray) -> Any:
        return SimpleNamespace(
            values=np.array(values), jacobian=[jacobian], noise_scale=1.0, names=("a", "b")
        )

    alike = [one([1.0, 1.3], seen), one([1.0, 1.3], seen), one([1.0, 1.0], blind)]
    assert _scatter(alike) == ()
    differ = [one([1.0, 1.3], seen), one([1.0, 1.1], seen), one([1.0, 1.2], seen)]
    assert [words.split()[0] for words in _scatter(differ)] == ["b"]
    turned = [one([1.0, 0.2], seen), one([1.0, -0.2], seen), one([1.0, 1e-9], seen)]  # a mean of nothing
    assert _scatter(turned) == ("b by 1.2e+02 %",)


def test_what_an_encoder_rounds_is_no_sign_of_something_missing_within_a_record() -> None:
    """Small errors that dwell where the drive rests have a colour, and mean nothing."""
    slow = np.repeat([[0.3], [-0.3]], 50, axis=0)
    assert _explained(SimpleNamespace(residual=[slow]))  # type: ignore[arg-type]
    assert not _explained(SimpleNamespace(residual=[3.0 * slow]))  # type: ignore[arg-type]
