"""Where fits of a round start."""

from dataclasses import replace
from types import SimpleNamespace

from gapcase import small_case

from hybrid_id.components import AsymmetricFriction, PositionDependent
from hybrid_id.diagnosis.candidates import special_cases, without
from hybrid_id.diagnosis.catalogue import CATALOGUE
from hybrid_id.diagnosis.fits import Fits
from hybrid_id.diagnosis.scales import scales

PLACE = "joint1/motor_friction"


def test_a_special_case_is_tried_where_the_richer_law_has_ended() -> None:
    dataset, today = small_case()
    bare = today.without_component(PLACE, "coulomb_friction")
    ended = bare.with_component(PLACE, PositionDependent(A_0=0.01)).with_values({"J": 3e-5})
    before = SimpleNamespace(effects=(("cogging", "joint1/motor"),), system=bare)
    richer = SimpleNamespace(
        effects=(*before.effects, ("position_dependent_friction", PLACE)), system=ended, result=None
    )
    (task,) = special_cases(Fits(dataset), before, richer)
    assert task.effects == (("cogging", "joint1/motor"), ("coulomb_friction", PLACE))
    assert set(task.system.components) == set(today.components)
    assert task.system.parameter("J").spec.value == 3e-5


def test_a_law_without_special_cases_has_none() -> None:
    dataset, today = small_case()
    ended = today.with_component(PLACE, AsymmetricFriction())
    before = SimpleNamespace(effects=(), system=today)
    richer = SimpleNamespace(effects=(("asymmetric_friction", PLACE),), system=ended)
    assert not special_cases(Fits(dataset), before, richer)


def test_the_rotor_has_its_share_again_once_nothing_tells_it() -> None:
    _, today = small_case()
    share = replace(today.parameter("rotor_share").spec, lower=0.05, upper=0.6)
    today = today.with_specs({"rotor_share": share})  # below the shares that are tried: no error either
    (size,) = scales(today, Fits(small_case()[0]).records(today))
    loaded = CATALOGUE["load_dependent_friction"].models(today, size)[PLACE]
    freed = next(s for s in loaded if f"{PLACE}/load_dependent_friction" in s.components)
    assert freed.parameter("rotor_share").spec.estimate
    rest = without(freed, today, ("load_dependent_friction", PLACE))
    assert rest is not None and rest.parameter("rotor_share").spec == share
