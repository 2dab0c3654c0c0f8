"""Test records decide between effects that explain the train records alike."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import hybrid_id.diagnosis.arbiter as module
from hybrid_id.diagnosis.arbiter import Decision, decide
from hybrid_id.diagnosis.attribute import Attribution
from hybrid_id.diagnosis.evidence import Evidence
from hybrid_id.diagnosis.probability import Suspect, believed
from hybrid_id.diagnosis.round import Round

WHERE = "joint1/load"


class Model(SimpleNamespace):
    """A candidate's attributes, told from others by what it is."""

    __hash__, __eq__ = object.__hash__, object.__eq__


def blocks(size: float) -> Evidence:
    rng = np.random.default_rng(round(1000 * size))
    return Evidence(size * rng.uniform(0.8, 1.2, 200), 200, 200.0)


def model(name: str, train: float) -> Any:
    """A fitted candidate with its errors on parts of the train records left out."""
    effects = ((name, WHERE),) if name else ()
    system = SimpleNamespace(components={"joint1/load/one_link": None})
    result = SimpleNamespace(residual=[np.zeros((9, 1))], x0=None)
    return Model(effects=effects, evidence=blocks(train), result=result, system=system, finished=True)


TODAY, BIAS, WEIGHT = model("", 9.0), model("constant_torque", 1.01), model("gravity_load", 1.0)
SPRING = model("spring_load", 2.0)
SEARCH = Attribution(TODAY, (Round(TODAY, (BIAS, WEIGHT, SPRING)),), BIAS)


def decided(
    monkeypatch: pytest.MonkeyPatch, test: dict[Any, float], search: Attribution = SEARCH
) -> Decision:
    monkeypatch.setattr(module, "_on_test", lambda _, one: blocks(test[one]))
    refit: Any = SimpleNamespace(dataset=SimpleNamespace(test=(1,)), run=lambda *_: [])
    return decide(refit, search)


def test_the_simpler_one_goes_where_the_test_records_are_sure(monkeypatch: pytest.MonkeyPatch) -> None:
    found = decided(monkeypatch, {BIAS: 2.0, WEIGHT: 1.0})
    assert found.search.chosen is WEIGHT and found.search.rounds[0].best is WEIGHT
    assert set(found.outvoted) == {("constant_torque", WHERE)}
    assert len(found.search.rounds[0].candidates) == 3


def test_it_stays_where_they_are_not_and_its_rival_goes_where_they_are(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert decided(monkeypatch, {BIAS: 1.01, WEIGHT: 1.0}).search is SEARCH
    alike = decided(monkeypatch, {BIAS: 1.04, WEIGHT: 1.0})  # no more than a formula may be off
    assert alike.search is SEARCH and not alike.outvoted
    kept = decided(monkeypatch, {BIAS: 1.0, WEIGHT: 2.0})
    assert kept.search is SEARCH and set(kept.outvoted) == {("gravity_load", WHERE)}


def test_free_runs_that_may_be_lost_and_windows_have_no_word(monkeypatch: pytest.MonkeyPatch) -> None:
    test = {BIAS: 2.0, WEIGHT: 1.0}
    within = Attribution(TODAY, SEARCH.rounds, BIAS, window=0.5)
    assert decided(monkeypatch, test, within).search is within
    monkeypatch.setitem(WEIGHT.system.components, "joint1/transmission/backlash", None)
    assert decided(monkeypatch, test).search is SEARCH


def test_test_records_that_stand_still_have_no_word(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "errors", lambda *_, **__: None)
    refit: Any = SimpleNamespace(dataset=SimpleNamespace(test=(1,)), signal_share=0.004, run=lambda *_: [])
    for one in (BIAS, WEIGHT):
        one.result.engine = None
    assert decide(refit, SEARCH).search is SEARCH


def test_what_is_outvoted_hands_its_probability_on() -> None:
    def suspect(
        name: str, probability: float, *, selected: bool = False, ties: tuple[str, ...] = ()
    ) -> Suspect:
        return Suspect(name, WHERE, probability, selected, ties, {})

    found = [
        suspect(
            "gravity_load", 0.5, selected=True, ties=(f"constant_torque@{WHERE}", f"spring_load@{WHERE}")
        ),
        suspect("constant_torque", 0.4, ties=(f"gravity_load@{WHERE}",)),
    ]
    first, other = Decision(SEARCH, {("constant_torque", WHERE): 5.0}, ("gravity_load", WHERE)).weighed(found)
    assert first.probability == pytest.approx(0.9, abs=1e-4) and other.probability < 1e-4
    assert first.tied_with == (f"spring_load@{WHERE}",) and other.tied_with == ()


def test_a_name_beside_something_unknown_is_neither_sure_nor_impossible() -> None:
    found = [Suspect("delay", "joint1/input", 0.9, True, (), {})]
    assert [believed(found, False, left)[0].probability for left in (0.0, 1.0)] == pytest.approx([0.9, 0.27])
    assert believed(found, True, 0.0)[0].probability == 0.9
