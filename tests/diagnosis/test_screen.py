"""One selection step: which candidates are fitted further, and which leads."""

from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
from gapcase import small_case

from hybrid_id.components import Cogging
from hybrid_id.diagnosis.screen import best_of_each, effects_of, promising, simplest_first
from hybrid_id.diagnosis.validation import Validation


def judged(error: float, z: Callable[[Validation], float] = lambda _: 0.0) -> Validation:
    """Errors of a mean square, and how surely it is less than another's."""

    class Judged(Validation):
        error = property(lambda _: error)

        def z(self, other: Validation) -> float:
            return z(other)

    return Judged(np.zeros(1), np.ones(1), np.zeros(1, int), 2.0)


def test_of_equals_the_one_with_the_fewest_parameters_leads() -> None:
    def fitted(name: str, error: float, parameters: int, z: float = 0.0):
        effects = ((name, "joint1/load"),)
        result = SimpleNamespace(names=("x",) * parameters)
        told = judged(error, lambda _: z)
        return SimpleNamespace(effects=effects, validation=told, error=error, result=result, finished=True)

    spring, bias, weight = (
        fitted("spring_load", 1.0, 7), fitted("constant_torque", 1.02, 6), fitted("gravity_load", 1.2, 5)
    )  # fmt: skip
    ranked = [spring, bias, weight]
    small, large = fitted("", 1.1, 5), fitted("", 2.0, 5)
    assert simplest_first(ranked, small) == [bias, spring, weight]  # the weight predicts worse
    # what was not fitted to the end does not lead
    bias.finished = weight.finished = False
    assert simplest_first(ranked, small) == ranked
    bias.finished = weight.finished = True
    assert simplest_first([], small) == []
    # of a small gap the bias leaves a fifth open, and the records tell; of a large one next to nothing
    sure = [fitted("spring_load", 1.0, 7, z=4.0), bias, weight]
    assert simplest_first(sure, small) == sure
    assert simplest_first(sure, large) == [bias, sure[0], weight]


def test_an_effect_is_where_it_usually_acts_where_the_records_cannot_tell() -> None:
    def fitted(place: str, error: float, z: float = 0.0):
        effects = (("asymmetric_friction", f"joint1/{place}"),)
        result = SimpleNamespace(names=("x",))
        told = judged(error, lambda _: z)
        return SimpleNamespace(effects=effects, validation=told, error=error, result=result, finished=True)

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

    def fitted(n: float, error: float):
        system = nominal.with_component(place, Cogging(n=n))
        result = SimpleNamespace(cost=error)
        return SimpleNamespace(
            effects=(("cogging", place),), validation=judged(error), error=error, result=result, system=system
        )

    three, four, worse = fitted(3.0, 1.0), fitted(4.0, 2.0), fitted(3.0, 3.0)
    assert best_of_each([worse, four, three]) == [three, four]
    assert best_of_each([worse, four, three], key=effects_of) == [three]


def test_beside_an_effect_nothing_is_fitted_to_the_end_that_cannot_be_accepted() -> None:
    def one(error: float, *names: str):
        return SimpleNamespace(effects=tuple(names), validation=judged(error), error=error)

    weight = one(1.0, "gravity_load")
    assert promising(one(0.9, "gravity_load", "spring_load"), weight)
    assert not promising(one(0.97, "gravity_load", "spring_load"), weight)
    assert promising(one(0.98, "spring_load"), one(1.0))
