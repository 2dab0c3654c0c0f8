"""Where the fits of a selection step start, and that an effect taken out again leaves nothing behind."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
from gapcase import small_case

from hybrid_id.components import AsymmetricFriction, PositionDependent
from hybrid_id.diagnosis.catalogue import CATALOGUE, with_effect
from hybrid_id.diagnosis.fits import Fits
from hybrid_id.diagnosis.scales import Scales, scales
from hybrid_id.diagnosis.starts import special_cases, with_values_of, without
from hybrid_id.systems import System

PLACE = "joint1/motor_friction"


def test_a_special_case_is_tried_where_the_richer_law_has_ended() -> None:
    dataset, nominal = small_case()
    bare = nominal.without_component(PLACE, "coulomb_friction")
    ended = bare.with_component(PLACE, PositionDependent(A_0=0.01)).with_values({"J": 3e-5})
    before = SimpleNamespace(effects=(("cogging", "joint1/motor"),), system=bare)
    richer = SimpleNamespace(
        effects=(*before.effects, ("position_dependent_friction", PLACE)), system=ended, result=None
    )
    (task,) = special_cases(Fits(dataset), before, richer)
    assert task.effects == (("cogging", "joint1/motor"), ("coulomb_friction", PLACE))
    assert set(task.system.components) == set(nominal.components)
    assert task.system.parameter("J").spec.value == 3e-5


def test_a_law_without_special_cases_has_none() -> None:
    dataset, nominal = small_case()
    ended = nominal.with_component(PLACE, AsymmetricFriction())
    before = SimpleNamespace(effects=(), system=nominal)
    richer = SimpleNamespace(effects=(("asymmetric_friction", PLACE),), system=ended)
    assert not special_cases(Fits(dataset), before, richer)


def test_the_rotor_has_its_share_again_once_nothing_identifies_it() -> None:
    _, nominal = small_case()
    share = replace(nominal.parameter("rotor_share").spec, lower=0.05, upper=0.6)
    nominal = nominal.with_specs({"rotor_share": share})  # below the shares that are tried: no error either
    (size,) = scales(nominal, Fits(small_case()[0]).records(nominal))
    loaded = with_effect(CATALOGUE["load_dependent_friction"], nominal, size)[PLACE]
    freed = next(s for s in loaded if f"{PLACE}/load_dependent_friction" in s.components)
    assert freed.parameter("rotor_share").spec.estimate
    rest = without(freed, nominal, ("load_dependent_friction", PLACE))
    assert rest is not None and rest.parameter("rotor_share").spec == share


@pytest.fixture(scope="module")
def offered() -> tuple[System, Scales]:
    """The nominal model, and how large effects on its records are."""
    dataset, nominal = small_case()
    return nominal, scales(nominal, Fits(dataset).records(nominal))[0]


NOT_OFFERED = (
    "coulomb_friction", "viscous_friction", "hardening_flexibility", "joint_coupling",
    "encoder_zero", "goal_rate_limit", "link_mass", "base_tilt", "cable_pull", "floor_contact",
    "gravity_compensation",  # of servos and robots
)  # fmt: skip


@pytest.mark.parametrize("name", sorted(set(CATALOGUE) - set(NOT_OFFERED)))
def test_model_without_an_effect_is_the_one_before(name: str, offered: tuple[System, Scales]) -> None:
    nominal, size = offered
    assert with_effect(CATALOGUE[name], nominal, size)
    for where, models in with_effect(CATALOGUE[name], nominal, size).items():
        for richer in models:
            assert set(richer.components) > set(nominal.components) or name in (
                "backlash",
                "joint_flexibility",
            )
            plain = without(richer, nominal, (name, where))
            assert plain is not None
            assert set(plain.components) == set(nominal.components)


def test_nominal_values_that_cannot_stand_beside_an_effect_are_left_out() -> None:
    _, nominal = small_case()
    assert with_values_of(nominal, nominal) is not None
    F_c = replace(nominal.parameter("F_c").spec, value=1e-9, upper=1e-8)
    assert with_values_of(nominal.with_specs({"F_c": F_c}), nominal) is None  # out of its bounds
