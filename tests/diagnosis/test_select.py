"""An effect that is taken out again leaves nothing behind; the search stops at noise and starts where it should."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from gapcase import small_case

from hybrid_id.components import AsymmetricFriction, Cogging, ConstantTorque
from hybrid_id.diagnosis.select import (
    Attribution,
    _alive,
    _in_their_place,
    _leaves_something,
    attribute,
    sure_though_small,
)
from hybrid_id.diagnosis.belief import better
from hybrid_id.diagnosis.plausibility import implausible_parameters
from hybrid_id.diagnosis.catalogue import CATALOGUE
from hybrid_id.diagnosis.validation import Evidence, evidence
from hybrid_id.diagnosis.exchange import exchanges
from hybrid_id.diagnosis.grade import suspects, tied_explanations
from hybrid_id.diagnosis.ranking import best_of_each, effects_of, simpler_ones, simplest_first
from hybrid_id.diagnosis.fits import LOOK, TO_THE_END, Task
from hybrid_id.diagnosis.round import (
    SECOND_LOOK,
    Round,
    _from_afar,
    _further,
    _promises,
)
from hybrid_id.diagnosis.scales import Scales, scales
from hybrid_id.diagnosis.candidates import as_today, without
from hybrid_id.study.replays import batch_of
from hybrid_id.systems import System


def told_by(error: float, z: Callable[[Evidence], float] = lambda _: 0.0) -> Evidence:
    """Evidence of an error and of how surely it is less than another's."""

    class Told(Evidence):
        error = property(lambda _: error)

        def z(self, other: Evidence) -> float:
            return z(other)

    return Told(np.zeros(1), 1, 2.0)


@pytest.fixture(scope="module")
def offered() -> tuple[System, Scales]:
    """Today's model, and how large effects on its records are."""
    dataset, today = small_case()
    return today, scales(today, batch_of(dataset, today, dataset.train, 0.1, "cpu"))[0]


NOT_OFFERED = ("coulomb_friction", "viscous_friction", "hardening_flexibility", "joint_coupling")


@pytest.mark.parametrize("name", sorted(set(CATALOGUE) - set(NOT_OFFERED)))
def test_model_without_an_effect_is_the_one_before(name: str, offered: tuple[System, Scales]) -> None:
    today, size = offered
    assert CATALOGUE[name].models(today, size)
    for where, models in CATALOGUE[name].models(today, size).items():
        for richer in models:
            assert set(richer.components) > set(today.components) or name in ("backlash", "joint_flexibility")
            plain = without(richer, today, (name, where))
            assert plain is not None
            assert set(plain.components) == set(today.components)


def test_nothing_is_looked_for_beside_an_effect_that_leaves_white_noise() -> None:
    rng = np.random.default_rng(0)
    noise, wave = rng.standard_normal((4000, 1)), np.sin(0.05 * np.arange(4000))[:, None]

    def model(residual: np.ndarray, effects: tuple):
        return SimpleNamespace(effects=effects, result=SimpleNamespace(residual=[residual]))

    some = (("backlash", "joint1/transmission"),)
    assert not _leaves_something(model(noise, some))
    assert _leaves_something(model(noise + wave, some))
    assert _leaves_something(model(noise, ()))  # the first round tells how probable each effect is


def test_a_second_effect_is_believed_at_a_small_gain_where_it_completes_the_explanation() -> None:
    rng = np.random.default_rng(0)
    noise, wave = rng.standard_normal((8000, 1)), np.sin(0.01 * np.arange(8000))[:, None]

    def model(residual: np.ndarray, effects: tuple):
        return SimpleNamespace(
            effects=effects, result=SimpleNamespace(residual=[residual]), evidence=evidence([residual], 0.002)
        )

    one, two = (
        (("backlash", "joint1/transmission"),),
        (("backlash", "joint1/transmission"), ("delay", "joint1/input")),
    )
    first = model(noise + 0.6 * wave, one)
    assert better(model(noise, two), first)  # 1.09 times smaller, and white
    assert not better(
        model(0.92 * (noise + 0.6 * wave), two), first
    )  # as much smaller, and the same waves are left
    assert not better(model(0.98 * noise, two), model(noise, one))
    # 1.07 times smaller each: here nothing from outside is called for any more, there it still is
    assert better(model(noise + 0.85 * wave, two), model(noise + 1.05 * wave, one))
    assert not better(model(noise + 1.1 * wave, two), model(noise + 1.3 * wave, one))


def test_of_equals_the_one_with_the_fewest_parameters_leads() -> None:
    def fitted(name: str, error: float, parameters: int, z: float = 0.0):
        effects = ((name, "joint1/load"),)
        result = SimpleNamespace(names=("x",) * parameters)
        told = told_by(error, lambda _: z)
        return SimpleNamespace(effects=effects, evidence=told, result=result, finished=True)

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
        told = told_by(error, lambda _: z)
        return SimpleNamespace(effects=effects, evidence=told, result=result, finished=True)

    at_link, at_rotor, before = fitted("link_friction", 1.0), fitted("motor_friction", 1.01), fitted("", 9.0)
    assert simplest_first([at_link, at_rotor], before) == [at_rotor, at_link]
    worse = fitted("motor_friction", 1.1)
    assert simplest_first([at_link, worse], before) == [at_link, worse]
    assert simplest_first([at_rotor, fitted("link_friction", 1.02)], before)[0] is at_rotor
    sure = fitted("link_friction", 1.0, z=3.0)
    assert simplest_first([sure, at_rotor], before) == [sure, at_rotor]


def test_waves_of_different_periods_are_different_models() -> None:
    _, today = small_case()
    place = "joint1/motor"

    def fitted(n: float, error: float):
        system = today.with_component(place, Cogging(n=n))
        result = SimpleNamespace(cost=error)
        return SimpleNamespace(
            effects=(("cogging", place),), evidence=told_by(error), result=result, system=system
        )

    three, four, worse = fitted(3.0, 1.0), fitted(4.0, 2.0), fitted(3.0, 3.0)
    assert best_of_each([worse, four, three]) == [three, four]
    assert best_of_each([worse, four, three], key=effects_of) == [three]


def test_values_of_today_that_cannot_stand_beside_an_effect_are_left_out() -> None:
    _, today = small_case()
    assert as_today(today, today) is not None
    F_c = replace(today.parameter("F_c").spec, value=1e-9, upper=1e-8)
    assert as_today(today.with_specs({"F_c": F_c}), today) is None  # out of its bounds


def test_a_part_that_an_effect_has_replaced_counts_as_not_bent() -> None:
    _, today = small_case()
    gone = today.without_component("joint1/motor_friction", "coulomb_friction")
    assert implausible_parameters(today, gone) == []
    assert implausible_parameters(today, today.with_values({"P_m2": 2.0 * today.parameter("P_m2").spec.value}))


def test_an_effect_that_is_sure_but_small_waits_for_the_test_records() -> None:
    rng = np.random.default_rng(0)
    noise, wave = rng.standard_normal((40000, 1)), np.sin(0.05 * np.arange(40000))[:, None]

    def model(residual: np.ndarray, *effects: tuple[str, str]):
        result = SimpleNamespace(residual=[residual])
        return SimpleNamespace(effects=effects, result=result, evidence=evidence([residual], 0.002))

    def found(size: float) -> Attribution:
        before, after = model(noise + size * wave), model(noise, ("quadratic_drag", "joint1/motor_friction"))
        return Attribution(before, (Round(before, (after,)),), before)

    sure = sure_though_small(found(0.15))
    assert sure is not None and sure.chosen.effects == (("quadratic_drag", "joint1/motor_friction"),)
    assert sure_though_small(found(0.5)) is None  # large enough to be believed without them
    assert sure_though_small(found(0.01)) is None  # not sure
    assert sure_though_small(Attribution(found(0.15).base, (), found(0.15).base)) is None
    assert sure_though_small(replace(found(0.15), window=0.4)) is None  # no errors of whole records


BIAS, UNEVEN = ("constant_torque", "joint1/load"), ("asymmetric_friction", "joint1/motor_friction")
COGGING = ("cogging", "joint1/motor")
SIZES = {
    (): 3.0,
    (BIAS,): 1.5,
    (UNEVEN,): 1.51,
    (COGGING,): 2.0,
    (COGGING, BIAS): 0.5,
    (UNEVEN, COGGING): 0.0,
}
"""Of the wave that models leave, by their effects."""


def models_that_leave(size: Mapping[tuple[tuple[str, str], ...], float]):
    """What makes models with effects, each of which leaves noise and a wave."""
    _, today = small_case()
    rng = np.random.default_rng(0)
    noise, wave = rng.standard_normal((8000, 1)), np.sin(0.01 * np.arange(8000))[:, None]
    parts = {BIAS: ConstantTorque(T_0=0.1), UNEVEN: AsymmetricFriction(), COGGING: Cogging(T_c=0.003)}

    def model(*effects: tuple[str, str]):
        system = today
        for effect in effects:
            system = system.with_component(effect[1], parts[effect])
        left = next(s for key, s in size.items() if set(key) == set(effects))
        residual = noise + left * wave
        result = SimpleNamespace(
            residual=[residual], names=("J",), jacobian=(np.ones((8000, 1, 1)),), values=[1.0], noise_scale=1.0,
            n_samples=8000, system=system, cost=left,
        )  # fmt: skip
        told = evidence([residual], 0.002)
        return SimpleNamespace(effects=tuple(sorted(effects)), system=system, result=result, evidence=told)

    return model


def test_a_pair_is_refused_only_after_rivals_of_its_first_effect(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside a bias cogging gains too little to be believed, beside uneven friction it explains everything."""
    model = models_that_leave({**SIZES, (COGGING, BIAS): 1.35})
    rounds = [Round(model(), (model(BIAS), model(UNEVEN))), Round(model(BIAS), (model(COGGING, BIAS),))]
    assert not better(rounds[1].candidates[0], model(BIAS))
    todo = list(rounds)
    monkeypatch.setattr("hybrid_id.diagnosis.select.one_round", lambda *_: todo.pop(0))
    monkeypatch.setattr("hybrid_id.diagnosis.select._freed", lambda _, chosen: chosen)
    refit = SimpleNamespace(
        base=lambda _: model(),
        run=lambda tasks, *_: [model(*task.effects) for task in tasks],
        strays=lambda _: False,
        dataset=SimpleNamespace(train=[]),
    )
    assert attribute(refit, model().system).chosen.effects == (UNEVEN, COGGING)


def test_a_rival_of_the_first_effect_is_tried_again_beside_the_second() -> None:
    """Alone a bias did as well as uneven friction; beside cogging only the friction leaves nothing but noise."""
    bias, uneven, cogging, size = BIAS, UNEVEN, COGGING, dict(SIZES)
    model = models_that_leave(size)
    refit = SimpleNamespace(run=lambda tasks, *_: [model(*task.effects) for task in tasks])
    rounds = [Round(model(), (model(bias), model(uneven))), Round(model(bias), (model(cogging, bias),))]
    (again,) = exchanges(refit, model(), model(cogging, bias), rounds)
    assert again.again and again.before.effects == (cogging,)
    assert [e.effects for e in again.candidates] == [(uneven, cogging), (cogging, bias)]
    told = suspects(Attribution(model(), (*rounds, again), again.candidates[0]))
    assert {s.name for s in told if s.selected} == {"asymmetric_friction", "cogging"}
    assert next(s for s in told if s.name == "asymmetric_friction").probability > 0.9
    assert next(s for s in told if s.name == "constant_torque").probability < 0.1  # it had a half alone
    # where both leave the same, an experiment is looked for that parts them
    size[(uneven, cogging)] = 0.5
    chosen = model(cogging, bias)
    (again,) = exchanges(refit, model(), chosen, rounds)
    assert again.best is chosen
    tied = tied_explanations(Attribution(model(), (*rounds, again), chosen))
    assert [e.effects for e in tied] == [(cogging, bias), (uneven, cogging)]
    # without rivals nothing is compared again
    assert not exchanges(refit, model(), model(cogging, bias), [Round(model(), (model(bias),)), rounds[1]])


def test_a_simpler_candidate_that_may_be_as_good_is_fitted_to_the_end_too() -> None:
    def fitted(name: str, error: float, parameters: int):
        result, told = SimpleNamespace(names=("x",) * parameters), told_by(error)
        effects = ((name, "joint1/load"),)
        return SimpleNamespace(effects=effects, evidence=told, result=result, finished=name == "a")

    best, simple, far, rich = (
        fitted("a", 1.0, 7),
        fitted("b", 1.05, 6),
        fitted("c", 1.3, 6),
        fitted("d", 1.01, 8),
    )
    assert simpler_ones([best, rich, simple, far]) == [simple]
    simple.finished = True
    assert simpler_ones([best, simple]) == []


def test_a_law_that_contains_another_is_no_rival_of_it() -> None:
    """Friction over the angle with a mean explains whatever dry friction alone does."""

    def model(error: float, *effects: str):
        told = told_by(error, lambda other: 5.0 * (other.error - error))
        system = SimpleNamespace(table=())
        result = SimpleNamespace(
            jacobian=(np.zeros((2, 1)),), names=(), values=(), noise_scale=1.0, n_samples=2, system=system,
            residual=[np.random.default_rng(0).standard_normal((400, 1))],
        )  # fmt: skip
        named = tuple((name, "joint1/motor_friction") for name in effects)
        return SimpleNamespace(effects=named, evidence=told, result=result, system=system)

    dry, waves, drop = (
        model(1.0, name) for name in ("coulomb_friction", "position_dependent_friction", "stribeck_friction")
    )
    before = model(3.0)
    one = Round(before, (dry, waves, drop))
    told = {s.name: s for s in suspects(Attribution(before, (one,), dry))}
    assert told["coulomb_friction"].tied_with == ("stribeck_friction@joint1/motor_friction",)
    assert told["position_dependent_friction"].probability == 0.0
    # where the waves predict better, dry friction alone is none of theirs
    better_waves = model(0.5, "position_dependent_friction")
    told = suspects(Attribution(before, (Round(before, (better_waves, dry)),), better_waves))
    assert told[0].name == "position_dependent_friction" and told[0].probability > 0.9


def test_a_candidate_that_closes_most_of_a_large_gap_is_fitted_to_the_end() -> None:
    """A spring whose fit is not through yet may stand behind a weight by more than what is hopeless of a small gap."""

    def fitted(name: str, error: float):
        told = told_by(error)
        residual = np.sin(0.01 * np.arange(400))[:, None]
        result = SimpleNamespace(names=("x",), cost=error, residual=[residual], x0=None)
        effects = ((name, "joint1/load"),) if name else ()
        return SimpleNamespace(effects=effects, evidence=told, result=result, system=name)

    taken: list[str] = []

    def run(tasks, *_):
        taken.extend(task.system for task in tasks)
        return [fitted(task.system, 0.9) for task in tasks]

    weight, spring, drag = (
        fitted("gravity_load", 1.0),
        fitted("spring_load", 2.7),
        fitted("quadratic_drag", 12.0),
    )
    candidates = [weight, spring, drag]
    for before, wanted in ((25.0, ["gravity_load", "spring_load"]), (3.0, ["gravity_load"])):
        taken.clear()
        _further(
            SimpleNamespace(run=run), fitted("", before), candidates, candidates, TO_THE_END, lambda: None
        )
        assert taken == wanted


def test_an_effect_that_made_the_first_needless_is_searched_on_from() -> None:
    def fitted(error: float, *names: str):
        return SimpleNamespace(effects=tuple(names), evidence=told_by(error))

    weight = fitted(8.0, "gravity_load")
    assert _in_their_place(fitted(2.0, "joint_flexibility"), weight)
    assert not _in_their_place(fitted(9.0, "joint_flexibility"), weight)  # worse than what it replaced
    assert not _in_their_place(fitted(7.0, "gravity_load"), weight)
    assert not _in_their_place(fitted(7.0), weight)


def test_beside_two_effects_only_what_has_brought_anything_beside_one_is_looked_at() -> None:
    def fitted(cost: float, *names: str):
        effects = tuple((name, "joint1/load") for name in names)
        return SimpleNamespace(effects=effects, result=SimpleNamespace(cost=cost))

    base, weight, both = fitted(9.0), fitted(8.0, "gravity_load"), fitted(4.0, "gravity_load", "spring_load")
    idle = fitted(7.99, "gravity_load", "joint_coupling")
    drag = fitted(7.0, "gravity_load", "quadratic_drag")
    first, second = Round(base, (weight,)), Round(weight, (both, drag, idle))
    assert _alive([first], weight) is None
    names = _alive([first, second], both)
    assert names == {("spring_load", "joint1/load"), ("quadratic_drag", "joint1/load")}
    # where the second effect has made the first needless all are looked at again
    assert _alive([first, second], fitted(5.0, "spring_load")) is None


def test_beside_an_effect_nothing_is_fitted_to_the_end_that_may_not_be_believed() -> None:
    def one(error: float, *names: str):
        return SimpleNamespace(effects=tuple(names), evidence=told_by(error))

    weight = one(1.0, "gravity_load")
    assert _promises(one(0.9, "gravity_load", "spring_load"), weight)
    assert not _promises(one(0.97, "gravity_load", "spring_load"), weight)
    assert _promises(one(0.99, "spring_load"), one(1.0))


def test_models_are_looked_at_from_afar_over_windows_and_play_only_where_nothing_explains_the_records() -> (
    None
):
    noise = np.random.default_rng(0).standard_normal((400, 1))
    wave, asked = np.sin(0.01 * np.arange(400))[:, None], []

    def model(name: str, error: float, residual: np.ndarray):
        result = SimpleNamespace(cost=error, residual=[residual])
        return SimpleNamespace(
            effects=((name, "joint1/input"),),
            evidence=told_by(error),
            result=result,
            system=name,
        )

    class Fits:
        def __init__(self, how: str, ends: dict[str, tuple[float, np.ndarray]]):
            self.how, self.ends = how, ends

        def within(self, _: float):
            return Fits("windows", self.ends)

        def records(self, _: object) -> None:
            return None

        def run(self, tasks, iterations, _):
            asked.append((self.how, iterations, [task.system for task in tasks]))
            return [model(task.system, *self.ends[task.system]) for task in tasks]

    todo = [Task(((n, "joint1/input"),), n) for n in ("voltage_deadband", "delay", "backlash")]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hybrid_id.diagnosis.round.hidden_links", lambda system, _: system == "backlash")
        ends = {"voltage_deadband": (1.0, noise), "delay": (9.0, wave), "backlash": (2.0, wave)}
        found = _from_afar(Fits("whole", ends), [model("drag", 8.0, wave)], todo, lambda: None)
        assert [e.system for e in found] == ["voltage_deadband"]
        assert asked == [
            ("windows", LOOK, ["voltage_deadband", "delay"]),
            ("whole", SECOND_LOOK, ["voltage_deadband"]),
        ]
        ends["voltage_deadband"] = (7.0, wave)
        found = _from_afar(Fits("whole", ends), [model("drag", 8.0, wave)], todo, lambda: None)
        assert [e.system for e in found] == ["voltage_deadband", "delay", "backlash"]
