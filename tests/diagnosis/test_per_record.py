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
from hybrid_id.diagnosis import catalogue, starts
from hybrid_id.diagnosis.catalogue import CATALOGUE
from hybrid_id.diagnosis.criteria import CRITERIA
from hybrid_id.diagnosis.fits import Fits
from hybrid_id.diagnosis.model import FittedModel
from hybrid_id.diagnosis.per_record import per_record, scatter, structural
from hybrid_id.diagnosis.select import Selection
from hybrid_id.identification.horizons import Horizon
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.record import Record
from hybrid_id.systems import System

FRICTION = (0.0092, 0.0108, 0.0100, 0.0096)


def drifting() -> tuple[Dataset, System]:
    """A drive whose dry friction is another one on every record."""
    dataset, nominal = small_case()
    records = [
        make_record(
            rigid_drive(ratio=RATIO).with_values({"F_c": friction}),
            multisine(k, samples=SAMPLES, amplitude=6.0 + k, rest=20, step=STEP),
            seed=k, noise={"q_m1": NOISE}, name=one.name, step=STEP,
        )
        for k, (friction, one) in enumerate(zip(FRICTION, dataset.records, strict=True))
    ]  # fmt: skip
    roles = [replace(new, role=old.role) for new, old in zip(records, dataset.records, strict=True)]
    return replace(dataset, records=tuple(roles)), nominal


@pytest.fixture(scope="module")
def drift() -> tuple[Dataset, System]:
    return drifting()


def test_friction_that_drifts_is_said_by_name_and_size(drift) -> None:
    dataset, nominal = drift
    fits = Fits(dataset)
    own = per_record(fits, fits.base(nominal), nominal)
    assert own is not None and own.explained
    assert own.varying[0].startswith("F_c by "), own.varying
    assert float(own.varying[0].split()[2]) == pytest.approx(5.7, abs=2.0)
    ratio = own.model.system.parameter("P_m1").spec.value / 0.019
    own_friction = own.model.system.parameter("F_c").spec.value / ratio
    # one of the train records' own values, whose scale nothing identifies
    assert min(abs(own_friction / friction - 1.0) for friction in FRICTION[:3]) < 0.01


def test_records_that_one_set_explains_do_not_differ() -> None:
    dataset, nominal = small_case()
    fits = Fits(dataset)
    base = fits.base(nominal)
    own = per_record(fits, base, nominal)
    assert own is not None and own.model is base and own.explained and not own.varying


def test_what_is_missing_within_a_record_is_no_drift() -> None:
    dataset, nominal = small_case(REGISTRY["spring_load"](k_s=0.6, q_s=0.3))
    fits = Fits(dataset)
    base = fits.base(nominal)
    own = per_record(fits, base, nominal)
    assert own is not None and not own.explained and not own.varying
    assert own.autocorrelation > CRITERIA.coloured
    one = Fits(replace(dataset, records=dataset.records[:1]))
    assert per_record(one, base, nominal) is None  # a record alone says nothing of others
    assert per_record(fits.over(Horizon("windows", 0.3)), base, nominal) is None


def test_diagnosis_names_no_effect_but_the_drift(drift, monkeypatch) -> None:
    def nothing(fits: Fits, base: FittedModel, *_: object, **__: object) -> Selection:
        return Selection(base, (), base)

    monkeypatch.setattr(module, "select", nothing)
    found = module.diagnose(*drift)
    assert found.verdict == "parameters_only" and not found.unknown
    assert found.as_dict()["between_record_variation"][0].startswith("F_c by ")
    assert found.as_dict()["no_gap"]
    still = module.diagnose(*small_case(REGISTRY["spring_load"](k_s=0.6, q_s=0.3)))
    assert still.verdict == "outside_catalogue" and not still.varying


def test_no_effect_is_named_where_the_search_finds_one_in_the_drift(drift, monkeypatch) -> None:
    """A wave of any period finds a part of what differs from record to record, and leaves structure."""
    few = {name: CATALOGUE[name] for name in ("cogging", "kinematic_error", "position_dependent_friction")}
    for place in (starts, catalogue):
        monkeypatch.setattr(place, "CATALOGUE", few)
    found = module.diagnose(*drift)
    assert found.verdict == "parameters_only" and found.varying
    assert not any(one.selected for one in found.effects)
    assert all(one.probability <= CRITERIA.false_alarms for one in found.effects)


def test_a_record_that_does_not_see_a_parameter_says_nothing_of_it() -> None:
    seen, blind = np.array([[1.0, 0.0], [0.0, 1.0]] * 50) * 1e3, np.array([[1.0, 0.0], [0.0, 0.0]] * 50) * 1e3

    def one(values: list[float], jacobian: np.ndarray) -> Any:
        return SimpleNamespace(
            values=np.array(values), jacobian=[jacobian], noise_scale=1.0, names=("a", "b")
        )

    alike = [one([1.0, 1.3], seen), one([1.0, 1.3], seen), one([1.0, 1.0], blind)]
    assert scatter(alike) == ()
    differ = [one([1.0, 1.3], seen), one([1.0, 1.1], seen), one([1.0, 1.2], seen)]
    assert [words.split()[0] for words in scatter(differ)] == ["b"]
    turned = [one([1.0, 0.2], seen), one([1.0, -0.2], seen), one([1.0, 1e-9], seen)]  # a mean of nothing
    assert scatter(turned) == ("b by 1.2e+02 %",)


def test_what_an_encoder_rounds_is_no_sign_of_something_missing_within_a_record() -> None:
    """Small errors that dwell where the drive rests have a colour, and mean nothing."""
    slow = np.repeat([[0.3], [-0.3]], 50, axis=0)
    assert structural([slow]) < CRITERIA.negligible_structure**2
    assert structural([3.0 * slow]) > CRITERIA.negligible_structure**2


def test_an_encoder_that_ripples_hides_no_drift(drift) -> None:
    """A ripple with the angle is coloured in every record, and no set of parameters explains it."""
    dataset, nominal = drift

    def rippled(record: Record) -> Record:
        angle = record.outputs["q_m1"]
        return replace(record, outputs={"q_m1": angle + 0.9 * NOISE * np.sin(0.3 * angle)})

    fits = Fits(replace(dataset, records=tuple(map(rippled, dataset.records))))
    own = per_record(fits, fits.base(nominal), nominal)
    assert own is not None and own.autocorrelation > CRITERIA.white
    assert own.explained and own.varying[0].startswith("F_c by ")
