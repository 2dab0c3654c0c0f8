"""Values go from one stage to the next; what is held is not estimated again."""

import pytest

from hybrid_id.components import AsymmetricStribeck
from hybrid_id.errors import InputError
from hybrid_id.parameters import Bounded
from hybrid_id.systems import one_link, one_link_flexible
from hybrid_id.systems.builders import carry_over

RIGID = one_link(156.0, friction=AsymmetricStribeck()).with_values(
    {"P_m1": 0.0187, "f_3": 4e-5, "f_12": 0.033}
)
FLEXIBLE = one_link_flexible(156.0, friction=AsymmetricStribeck())


def test_shared_values_go_on_and_held_ones_stay() -> None:
    system = carry_over(FLEXIBLE, RIGID, ["P_m1", "f_3"])
    assert system.parameter("P_m1").spec.value == 0.0187
    assert system.parameter("f_12").spec.value == 0.033
    assert not system.parameter("P_m1").spec.estimate
    assert not system.parameter("f_3").spec.estimate
    assert system.parameter("f_12").spec.estimate
    assert system.parameter("k").spec == FLEXIBLE.parameter("k").spec


def test_what_cannot_be_held_is_named() -> None:
    with pytest.raises(InputError, match="earlier stage's model has no parameter 'k' to hold"):
        carry_over(FLEXIBLE, RIGID, ["k"])
    with pytest.raises(InputError, match=r"The model has no parameter 'J' to hold; both models have P_m1"):
        carry_over(FLEXIBLE, RIGID, ["J"])


def test_value_outside_this_stages_bounds_is_named() -> None:
    narrow = FLEXIBLE.with_specs({"P_m1": Bounded(0.03, 0.02, 0.04, "N m/V")})
    with pytest.raises(InputError, match=r"P_m1 = 0\.0187 N m/V lies outside its bounds"):
        carry_over(narrow, RIGID)
