"""One selection step: which candidates are fitted further, and which leads."""

import importlib
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any, cast

import pytest
from gapcase import small_case

from hybrid_id.components import Cogging
from hybrid_id.diagnosis.fits import COARSE, FINER, Task
from hybrid_id.diagnosis.screen import (
    _from_afar,
    best_of_each,
    better_ways,
    effects_of,
    promising,
    simplest_first,
)


@dataclass(eq=False)
class Fitted:
    """What a selection step asks of a candidate."""

    effects: tuple[Any, ...]
    error: float
    parameters: int = 1
    z: float = 0.0
    no_structure: bool = True
    white: bool = False
    judged: bool = True
    system: Any = None
    result: Any = field(init=False)

    def __post_init__(self) -> None:
        self.result = SimpleNamespace(names=("x",) * self.parameters, cost=self.error)
        self.trained = self.error
        self.validation = SimpleNamespace(effective=400.0)

    def ahead_of(self, other: "Fitted") -> float:
        return self.z

    def fall(self, before: "Fitted") -> float:
        return 1.0 - self.error / before.error


def test_of_equals_the_one_with_the_fewest_parameters_leads() -> None:
    def fitted(name: str, error: float, parameters: int, z: float = 0.0) -> Any:
        return Fitted(((name, "joint1/load"),), error, parameters, z)

    spring, bias, weight = (
        fitted("spring_load", 1.0, 7), fitted("constant_torque", 1.02, 6), fitted("gravity_load", 1.2, 5)
    )  # fmt: skip
    ranked = [spring, bias, weight]
    small, large = fitted("", 1.1, 5), fitted("", 2.0, 5)
    assert simplest_first(ranked, small) == [bias, spring, weight]  # the weight predicts worse
    # what was not fitted to the end does not lead
    bias.judged = weight.judged = False
    assert simplest_first(ranked, small) == ranked
    bias.judged = weight.judged = True
    assert simplest_first([], small) == []
    # of a small gap the bias leaves a fifth open, and the records tell; of a large one next to nothing
    sure = [fitted("spring_load", 1.0, 7, z=4.0), bias, weight]
    assert simplest_first(sure, small) == sure
    assert simplest_first(sure, large) == [bias, sure[0], weight]


def test_where_structure_is_left_a_simple_law_leads_that_does_most_of_it() -> None:
    """A flexible law takes some of whatever else is missing: that it predicts better says little for it."""

    def fitted(name: str, error: float, parameters: int, z: float = 2.0) -> Any:
        return Fitted(((name, "joint1/motor_friction"),), error, parameters, z, no_structure=False)

    before: Any = Fitted((), 10.0)
    waves, loaded = fitted("position_dependent_friction", 2.0, 9), fitted("load_dependent_friction", 4.0, 6)
    assert simplest_first([waves, loaded], before) == [loaded, waves]
    weak = fitted("quadratic_drag", 7.0, 6)  # does less than half of it
    assert simplest_first([waves, weak], before) == [waves, weak]
    sure = fitted("position_dependent_friction", 2.0, 9, z=3.0)
    assert simplest_first([sure, loaded], before) == [sure, loaded]


def test_an_effect_is_where_it_usually_acts_where_the_records_cannot_tell() -> None:
    def fitted(place: str, error: float, z: float = 0.0) -> Any:
        return Fitted((("asymmetric_friction", f"joint1/{place}"),), error, 1, z)

    at_link, at_rotor, before = fitted("link_friction", 1.0), fitted("motor_friction", 1.01), fitted("", 9.0)
    assert simplest_first([at_link, at_rotor], before) == [at_rotor, at_link]
    worse = fitted("motor_friction", 1.1)
    assert simplest_first([at_link, worse], before) == [at_link, worse]
    assert simplest_first([at_rotor, fitted("link_friction", 1.02)], before)[0] is at_rotor
    sure = fitted("link_friction", 1.0, z=3.0)
    assert simplest_first([sure, at_rotor], before) == [sure, at_rotor]


def test_waves_of_different_periods_are_different_models() -> None:
    _, nominal = small_case()
    place = "joint1/motor"

    def fitted(n: float, error: float) -> Any:
        return Fitted((("cogging", place),), error, system=nominal.with_component(place, Cogging(n=n)))

    three, four, worse = fitted(3.0, 1.0), fitted(4.0, 2.0), fitted(3.0, 3.0)
    assert best_of_each([worse, four, three]) == [three, four]
    assert best_of_each([worse, four, three], key=effects_of) == [three]


def test_of_fits_with_one_end_the_finished_one_is_kept() -> None:
    """What was fitted to the end may end a little above where it began: only then it has been judged."""
    coarse, done, other = (Fitted((("cogging", "joint1/motor"),), error) for error in (1.0, 1.001, 2.0))
    coarse.judged = other.judged = False
    found: Any = [coarse, done, other]
    assert best_of_each(found, 2, key=effects_of) == [done, other]
    assert best_of_each(found, 1, key=effects_of) == [done]


def test_beside_an_effect_nothing_is_fitted_to_the_end_that_cannot_be_accepted() -> None:
    def one(error: float, *names: str) -> Any:
        return Fitted(tuple(names), error, no_structure=False)

    weight = one(1.0, "gravity_load")
    assert promising(one(0.87, "gravity_load", "spring_load"), weight)
    assert not promising(one(0.97, "gravity_load", "spring_load"), weight)
    assert promising(one(0.98, "spring_load"), one(1.0))
    # what completes the answer needs less
    small, done = one(0.94, "gravity_load", "spring_load"), one(0.94, "gravity_load", "spring_load")
    done.no_structure = True
    assert promising(done, weight) and not promising(small, weight)


@pytest.mark.parametrize("structure", [False, True])
def test_from_afar_what_leaves_structure_is_fitted_without_priors_too(
    monkeypatch: pytest.MonkeyPatch, structure: bool
) -> None:
    """Over short windows what is right leaves none with its own values, which priors would keep from it."""
    module = importlib.import_module("hybrid_id.diagnosis.screen")
    monkeypatch.setattr(module, "hidden_links", lambda system, batch: False)
    _, nominal = small_case()
    inertia = nominal.parameter("J").spec
    held = nominal.with_specs({"J": replace(inertia, prior_mean=inertia.value, prior_std=1e-9)})
    asked: list[tuple[bool, int, int, bool]] = []

    @dataclass
    class Fits:
        whole: bool

        def over(self, horizon: Any) -> "Fits":
            return Fits(False)

        def records(self, system: Any) -> None:
            return None

        def run(self, tasks: Any, iterations: int, tick: Any = None) -> list[Any]:
            for one in tasks:
                is_held = one.system.parameter("J").spec.prior_std is not None
                asked.append((self.whole, iterations, len(one.effects), is_held))
            return [
                Fitted(
                    one.effects,
                    1.0 if one.effects else 9.0,
                    no_structure=not structure or one.system.parameter("J").spec.prior_std is None,
                    system=one.system,
                )
                for one in tasks
            ]

    before = Fitted((), 9.0, no_structure=False, system=held)
    far = [Task((("spring_load", "joint1/load"),), held)]
    found = _from_afar(cast(Any, Fits(True)), nominal, cast(Any, before), [], far, lambda: None)
    as_held = [
        (False, COARSE, 1, True),
        (False, FINER, 1, True),
        (False, FINER, 0, True),
        (True, FINER, 1, True),
    ]
    free = [(False, COARSE, 1, False), (False, FINER, 1, False), (True, FINER, 1, False)]
    assert asked == [*as_held, *(free if structure else [])]
    assert [one.system.parameter("J").spec.prior_std is not None for one in found] == [
        True,
        *[False] * structure,
    ]
    # what is held by nobody needs no fits of its own
    asked.clear()
    before.system, far = nominal, [Task((("spring_load", "joint1/load"),), nominal)]
    assert _from_afar(cast(Any, Fits(True)), nominal, cast(Any, before), [], far, lambda: None)
    assert len(asked) == 4


def test_where_a_wave_leads_all_its_initial_values_go_over_short_windows(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    module = importlib.import_module("hybrid_id.diagnosis.screen")
    wave, spring = ("cogging", "joint1/motor"), ("spring_load", "joint1/load")
    seen: list[list[Task]] = []
    _, nominal = small_case()

    def afar(fits: Any, nominal: Any, before: Any, ranked: Any, far: list[Task], tick: Any) -> list[Any]:
        seen.append(far)
        return []

    def asked(before: tuple[Any, ...], leader: tuple[Any, ...], **other: Any) -> list[tuple[Any, ...]]:
        best = Fitted(leader, 2.0, **{"no_structure": False, "system": nominal, **other})
        monkeypatch.setattr(module, "_finer", lambda *_: [best])
        fits: Any = SimpleNamespace(whole=True, run=lambda *_: [best], records=lambda _: None)
        near = [Task(tuple(sorted((*before, one))), cast(Any, None)) for one in (wave, wave, spring)]
        module.screen(fits, cast(Any, None), cast(Any, Fitted(before, 9.0)), near, lambda: None)
        return [one.effects for one in seen.pop()] if seen else []

    monkeypatch.setattr(module, "from_nominal", lambda *_: [])
    monkeypatch.setattr(module, "hidden_links", lambda *_: False)
    monkeypatch.setattr(module, "_freed", lambda fits, nominal, before, leader: list(leader))
    monkeypatch.setattr(module, "_from_afar", afar)
    assert asked((), (wave,)) == [(wave,), (wave,)]
    assert asked((), (spring,)) == []
    # beside a wave that is there it is the new effect that counts
    assert asked((wave,), (wave, spring)) == []
    # what leaves no structure needs no look from afar
    assert asked((), (wave,), no_structure=True) == []


@pytest.mark.parametrize(
    ("free", "structure", "starts"),
    [(0.95, True, ["held"]), (0.5, True, ["held", "free"]), (0.95, False, ["free"]), (None, True, ["held"])],
)
def test_what_errs_clearly_less_when_free_is_fitted_both_ways_to_the_end(
    monkeypatch: pytest.MonkeyPatch, free: float | None, structure: bool, starts: list[str]
) -> None:
    """Priors that hold a model which lacks much may keep the right effect from what it explains."""
    module = importlib.import_module("hybrid_id.diagnosis.screen")
    held = Fitted((("spring_load", "joint1/load"),), 1.0, no_structure=False, system="held")
    freed = None if free is None else Fitted(held.effects, free, no_structure=not structure, system="free")
    monkeypatch.setattr(module, "_unheld", lambda *_: freed)
    found = module._held_or_not(cast(Any, None), cast(Any, None), cast(Any, held))
    assert [one.system for one in found] == starts


@pytest.mark.parametrize(
    ("error", "z", "judged", "kept"),
    [
        (0.5, 3.0, True, "free"),
        (0.5, 2.0, True, "held"),
        (0.95, 3.0, True, "held"),
        (0.5, 3.0, False, "held"),
    ],
)
def test_of_both_ways_the_free_one_is_taken_where_records_left_out_say_so(
    error: float, z: float, judged: bool, kept: str
) -> None:
    held = Fitted((("spring_load", "joint1/load"),), 1.0, no_structure=False, system="held")
    free = Fitted(held.effects, error, z=z, no_structure=False, judged=judged, system="free")
    one, other = cast(Any, Fitted(held.effects, 1.2)), cast(Any, Fitted((), 2.0))
    found = better_ways([one, one, other, other], cast(Any, [held, free, None, held]))
    assert [end.system for end in found] == [kept, "held"]
