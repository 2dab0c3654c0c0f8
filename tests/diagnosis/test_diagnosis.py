"""The whole way from records to a verdict, on a drive whose truth is known."""

from dataclasses import replace

import pytest
from gapcase import RATIO, small_case

import hybrid_id.diagnosis.diagnose as module
from hybrid_id.components import Spring
from hybrid_id.diagnosis import starts
from hybrid_id.diagnosis.catalogue import CATALOGUE
from hybrid_id.diagnosis.result import Diagnosis
from hybrid_id.errors import InputError


def test_missing_spring_is_named(diagnosed) -> None:
    found: Diagnosis = diagnosed[2]
    assert found.verdict == "effects"
    assert [(s.name, s.where) for s in found.selected] == [("spring_load", "joint1/load")]
    assert found.effects[0].selected
    assert all(found.effects[0].probability >= other.probability for other in found.effects)
    rest, error = found.effects[0].parameters["q_s"]
    assert abs(rest - 0.3) < 5 * error + 1e-3


def test_gap_closes_on_the_unseen_record(diagnosed) -> None:
    found: Diagnosis = diagnosed[2]
    assert found.nominal is not None and found.refit is not None and found.with_effect is not None
    assert found.with_effect.nrmse < 0.1 * found.refit.nrmse < found.nominal.nrmse
    assert found.shrink is not None and found.shrink.share > 0.9


def test_torque_that_is_missing_goes_with_the_angle(diagnosed) -> None:
    found: Diagnosis = diagnosed[2]
    best = found.location[0]
    assert (best.joint, best.signal) == ("joint1", "angle")
    assert best.share > 0.5
    slope = (best.torque[-1] - best.torque[0]) / (best.grid[-1] - best.grid[0])
    # a spring pulls back; the motor's constant sets the scale of all torques
    ratio = found.search.base.system.parameter("P_m1").spec.value / 0.019
    assert -1.5 < slope * RATIO**2 / (0.6 * ratio) < -0.5
    assert max(one.share for one in found.residual_after) < 0.3


def test_nothing_is_named_where_nothing_is_missing(sound) -> None:
    found: Diagnosis = sound[2]
    assert found.verdict in ("parameters_only", "no_gap")
    assert not found.selected and not found.unknown
    assert not found.ties
    assert not found.effects and not found.search.steps  # in white noise nothing is searched
    assert found.as_dict()["no_gap"]


def test_contract_of_the_file(diagnosed) -> None:
    values = diagnosed[2].as_dict()
    assert {
        "case",
        "effects",
        "verdict",
        "unknown",
        "no_gap",
        "gap",
        "location",
        "horizon",
        "remainder",
    } <= set(values)
    assert {
        "nominal",
        "refit",
        "with_effect",
        "noise_floor",
        "shrink",
        "shrink_interval",
        "by_output",
    } <= set(values["gap"])
    for one in values["effects"]:
        assert {"name", "where", "probability", "tied_with", "parameters", "selected"} <= set(one)
        assert one["name"] in CATALOGUE
        assert one["where"].split("/")[1] in CATALOGUE[one["name"]].places
        assert 0.0 <= one["probability"] <= 1.0


def test_a_few_samples_are_too_short_to_say() -> None:
    dataset, today = small_case(Spring(k_s=3.0))
    few = slice(0, 25)
    cut = [
        replace(
            r,
            time=r.time[few],
            inputs={n: u[few] for n, u in r.inputs.items()},
            outputs={n: y[few] for n, y in r.outputs.items()},
        )
        for r in dataset.records[2:]
    ]
    found = module.diagnose(replace(dataset, records=tuple(cut)), today, max_effects=1)
    assert found.verdict == "inconclusive" and not found.selected and found.relative_std > 0.1


def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only what is missing and a rival are tried."""
    monkeypatch.setattr(starts, "CATALOGUE", {n: CATALOGUE[n] for n in ("spring_load", "constant_torque")})


def test_wrong_values_are_said_without_a_test_record_too(sound, monkeypatch: pytest.MonkeyPatch) -> None:
    few(monkeypatch)
    dataset, nominal, found = sound
    alone = replace(dataset, records=dataset.train)
    assert module.diagnose(alone, nominal, max_effects=1).verdict == found.verdict == "parameters_only"
    assert module.diagnose(alone, found.search.base.system, max_effects=1).verdict == "no_gap"


def test_a_single_train_record_is_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    few(monkeypatch)
    dataset, nominal = small_case()
    one = replace(dataset, records=(dataset.train[0], *dataset.test))
    found = module.diagnose(one, nominal, max_effects=1)
    assert found.verdict == "parameters_only" and not found.selected and found.shrink is not None


def test_validation_records_choose_and_the_final_model_has_seen_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """The train record hardly moves, so that a bias does as well as a spring; the validation records decide."""
    few(monkeypatch)
    dataset, nominal = small_case(Spring(k_s=0.6, q_s=0.3))
    roles = ("train", "validation", "validation", "test")
    chosen = replace(
        dataset, records=tuple(replace(r, role=role) for r, role in zip(dataset.records, roles, strict=True))
    )
    found = module.diagnose(chosen, nominal, max_effects=1)
    for one in found.fitted.values():
        assert len(one.result.residual) == 3
    both = {c.name: c.probability for c in found.effects}
    assert both["spring_load"] > both["constant_torque"]


def test_records_without_a_train_record_are_refused() -> None:
    dataset, nominal = small_case()
    with pytest.raises(InputError, match="no train record"):
        module.diagnose(replace(dataset, records=dataset.test), nominal)
