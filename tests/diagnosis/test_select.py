"""Which effects: when a richer model is accepted, and when the search goes on."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from gapcase import small_case

from hybrid_id.components import REGISTRY
from hybrid_id.diagnosis.fits import FULL, Fits, Task, with_priors_of
from hybrid_id.diagnosis.model import FittedModel
from hybrid_id.diagnosis.screen import SelectionStep
from hybrid_id.diagnosis.select import (
    Selection,
    _necessary,
    _with_fit,
    _with_whole_numbers,
    accepted,
    chance,
    leaves_something,
    needed_fall,
    select,
)
from hybrid_id.diagnosis.validation import validation

PLAY, DELAY = ("backlash", "joint1/transmission"), ("delay", "joint1/input")
RNG = np.random.default_rng(0)
NOISE, WAVE = RNG.standard_normal((8000, 1)), np.sin(0.01 * np.arange(8000))[:, None]


def model(residual: np.ndarray, *effects: tuple[str, str]) -> FittedModel:
    """A model that leaves these weighted errors, seen or not."""
    result: Any = SimpleNamespace(residual=[residual], cost=1.0, system=None)
    return FittedModel(effects, result, validation([residual], 0.002, ("run",)))


def test_a_first_effect_is_accepted_where_it_is_sure_and_no_formula_explains_it() -> None:
    base = model(NOISE + 0.5 * WAVE)
    assert accepted(model(NOISE, PLAY), base)
    assert not accepted(model(NOISE + 0.48 * WAVE, PLAY), base)  # by less than a law's formula may be off
    other = np.random.default_rng(1).standard_normal((8000, 1))
    assert not accepted(model(other, PLAY), model(NOISE))
    assert chance(base, base) == 1.0
    begun = FittedModel((PLAY,), model(NOISE).result, model(NOISE).validation, judged=False)
    assert not accepted(begun, base)  # it has seen the records that would judge it


def test_a_second_effect_is_accepted_at_a_small_fall_only_where_it_completes_the_explanation() -> None:
    first = model(NOISE + 0.6 * WAVE, PLAY)
    both = model(NOISE, PLAY, DELAY)
    assert accepted(both, first)  # what is left is white
    assert not accepted(model(0.92 * (NOISE + 0.6 * WAVE), PLAY, DELAY), first)  # the same waves are left
    assert not accepted(model(0.98 * NOISE, PLAY, DELAY), model(NOISE, PLAY))
    assert needed_fall(both, first) < needed_fall(
        model(NOISE + 1.5 * WAVE, PLAY, DELAY), model(NOISE + 2.0 * WAVE, PLAY)
    )


def test_nothing_is_looked_for_in_white_noise_nor_far_below_it() -> None:
    assert not leaves_something(model(NOISE, PLAY))
    assert leaves_something(model(NOISE + WAVE, PLAY))
    assert not leaves_something(model(NOISE))
    assert leaves_something(model(NOISE + 0.3 * WAVE))  # as little as a first effect may take
    assert not leaves_something(model(0.05 * (NOISE + WAVE)))


def test_no_effect_is_looked_for_where_the_errors_are_far_below_the_noise(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    dataset, nominal = small_case()
    base = model(0.01 * WAVE)
    found = select(Fits(dataset), base, nominal)
    assert found.chosen is base and found.base is base and not found.steps


def test_periods_per_turn_are_whole_where_that_predicts_as_well() -> None:
    """A motor has whole ones; where the gear ratio in the model file is wrong, no whole number predicts as well."""
    name = "cogging", "joint1/motor"

    def chosen(periods: float, lower: float = 1.0) -> float:
        dataset, nominal = small_case(REGISTRY["cogging"](T_c=0.0, T_s=0.002, n=periods), name[1])
        fits = Fits(dataset)
        start = nominal.with_component(name[1], REGISTRY["cogging"](T_c=0.0, T_s=0.002, n=periods))
        table = {info.symbol: info for info in start.table}
        free = start.with_specs({table["n"].name: replace(table["n"].spec, estimate=True, lower=lower)})
        (one,) = fits.run([Task((name,), free)], FULL)
        assert one is not None
        return _with_whole_numbers(fits, one).system.parameter(table["n"].name).spec.value

    assert chosen(4.0) == 4.0
    assert abs(chosen(3.4) - 3.4) < 0.05
    assert abs(chosen(3.4, lower=3.35) - 3.4) < 0.05  # the nearest whole number lies outside the bounds


def test_of_needless_effects_the_one_whose_loss_costs_least_goes(monkeypatch: pytest.MonkeyPatch) -> None:
    both = model(NOISE, DELAY, PLAY)
    rests = {DELAY: model(1.0 * NOISE, PLAY), PLAY: model(0.999 * NOISE, DELAY)}
    for name in ("hybrid_id.diagnosis.select.best_without",):
        monkeypatch.setattr(name, lambda fits, base, richer, effect, steps: rests[effect])
    fits: Any = None
    assert _necessary(fits, model(2.0 * NOISE), both, []) is rests[PLAY]


def test_a_candidate_whose_fit_has_failed_takes_the_one_that_is_found_later() -> None:
    """Its probability would be that of the failure, and what the search has chosen would not be asserted."""

    def named(residual: np.ndarray, *effects: tuple[str, str]) -> FittedModel:
        one = model(residual, *effects)
        return replace(one, result=SimpleNamespace(**vars(one.result), names=("x",)))

    base, rival, failed = (
        named(NOISE + 9.0 * WAVE),
        named(NOISE + WAVE, DELAY),
        named(NOISE + 5.0 * WAVE, PLAY),
    )
    step, later = SelectionStep(base, (rival, failed)), named(NOISE, PLAY)
    assert _with_fit(step, later).candidates == (later, rival)
    assert _with_fit(step, named(NOISE + 6.0 * WAVE, PLAY)) is step
    assert _with_fit(replace(step, swap=True), later).candidates == (rival, failed)
    assert _with_fit(step, replace(later, judged=False)) is step
    assert _with_fit(step, named(NOISE, DELAY, PLAY)) is step


def test_short_runs_say_how_probable_the_first_effects_are_and_whole_records_what_comes_beside() -> None:
    base = model(NOISE + WAVE)
    first, short, beside = (SelectionStep(base, (model(NOISE, PLAY),)) for _ in range(3))
    near = Selection(base, (short,), short.candidates[0])
    whole = Selection(base, (first, beside), beside.candidates[0], near=near)
    assert whole.compared == (short, beside) and near.compared == (short,)


def test_parameters_are_held_as_those_of_another_model() -> None:
    _, nominal = small_case()
    richer = nominal.with_component("joint1/motor", REGISTRY["thermal_derating"](T_w=1.0, c=10.0))
    (name,) = (info.name for info in nominal.table if info.symbol == "J")
    held = nominal.with_specs({name: replace(nominal.parameter(name).spec, prior_mean=1e-5, prior_std=1e-6)})
    spec = with_priors_of(richer, held).parameter(name).spec
    assert (spec.prior_mean, spec.prior_std) == (1e-5, 1e-6)
    assert with_priors_of(with_priors_of(richer, held), nominal).table == richer.table


def test_a_value_from_where_no_fit_comes_back_begins_where_it_is_held() -> None:
    _, nominal = small_case()
    (name,) = (info.name for info in nominal.table if info.symbol == "J")
    spec = nominal.parameter(name).spec
    held = nominal.with_specs({name: replace(spec, prior_mean=spec.value, prior_std=1e-5 * spec.value)})
    for factor, begins in ((2.0, 2.0), (1e6, 1.0)):  # a fit without the prior had run away
        far = nominal.with_specs({name: replace(spec, upper=1e9).at(factor * spec.value)})
        assert with_priors_of(far, held).parameter(name).spec.value == begins * spec.value
