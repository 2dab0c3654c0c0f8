"""Parameters that a re-fit has moved beyond data-sheet tolerance, in words."""

from dataclasses import replace

import pytest
from gapcase import small_case

from hybrid_id.components import JointFlexibility
from hybrid_id.diagnosis.plausibility import (
    implausible_parameters,
    not_identifiable,
    torque_power,
    within_reach,
)
from hybrid_id.identification.fit import fit
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.statistics.identifiability import identifiability
from hybrid_id.systems import System

NOMINAL = small_case()[1]
VALUES = {info.name: info.spec.value for info in NOMINAL.table if info.spec.estimate}


def moved(system: System, **factors: float) -> list[str]:
    """What is said of parameters multiplied by factors."""
    return implausible_parameters(system, times(system, factors))


def times(system: System, factors: dict[str, float]) -> System:
    return system.with_values(
        {name: factor * system.parameter(name).spec.value for name, factor in factors.items()}
    )


def test_a_common_scale_of_torques_is_no_change() -> None:
    assert moved(NOMINAL, **{name: 1.0 if name == "P_m2" else 1.7 for name in VALUES}) == []
    # what has torque below the line falls as torques rise
    soft = NOMINAL.with_component("joint1/transmission", JointFlexibility(compliance=0.05, zeta=0.3))
    names = [info.name for info in soft.table if info.spec.estimate]
    factors = {name: {"P_m2": 1.0, "zeta": 1.0, "compliance": 1 / 1.7}.get(name, 1.7) for name in names}
    assert moved(soft, **factors) == []


def test_what_turns_a_command_into_torque_stays_within_reach() -> None:
    known = replace(NOMINAL.parameter("P_m1").spec, prior_mean=None, prior_std=None, estimate=True)
    system = NOMINAL.with_specs({"P_m1": known})
    near = within_reach(system)
    spec = near.parameter("P_m1").spec
    assert (spec.lower, spec.upper) == pytest.approx((known.value / 10.0, known.value * 10.0))
    others = {info.name: info.spec for info in system.table if info.name != "P_m1"}
    assert {info.name: info.spec for info in near.table if info.name != "P_m1"} == others
    prior = replace(known, prior_mean=known.value, prior_std=0.1 * known.value)
    assert within_reach(NOMINAL.with_specs({"P_m1": prior})).parameter("P_m1").spec == prior


def test_what_has_moved_is_named_with_its_factor() -> None:
    assert moved(NOMINAL, F_c=0.0) == ["Coulomb level F_c is driven to zero"]
    assert moved(NOMINAL, P_m2=1.5) == ["back-EMF (and torque) constant P_m2 is 1.50 times its nominal value"]
    assert moved(NOMINAL, P_m2=1.3, F_c=1.5) == []


def test_a_known_torque_fixes_the_scale() -> None:
    fixed = NOMINAL.with_specs({"P_m1": replace(NOMINAL.parameter("P_m1").spec, estimate=False)})
    assert moved(fixed, F_c=2.0, F_v=2.0) == [
        "Coulomb level F_c is 2.00 times its nominal value",
        "viscous coefficient F_v is 2.00 times its nominal value",
    ]


def test_a_prior_is_the_measure_where_there_is_one() -> None:
    spec = replace(NOMINAL.parameter("P_m1").spec, prior_std=0.05 * VALUES["P_m1"], prior_mean=VALUES["P_m1"])
    held = NOMINAL.with_specs({"P_m1": spec})
    assert moved(NOMINAL, P_m1=1 / 1.4) == []
    (words,) = moved(held, P_m1=1 / 1.4)
    assert words.endswith("P_m1 is 5.7 standard deviations of its prior too low")
    assert moved(held, P_m1=1.1) == []


def test_what_the_records_do_not_see_is_said_beside_what_it_may_have_moved() -> None:
    """At these speeds viscous friction and back-EMF are nearly one; the common scale is seen where a torque is."""
    records = [record for record in small_case()[0].train]
    batch = make_batch(NOMINAL, records, noise_std={"q_m1": 0.02}, signal_share=0.0)
    (found,) = fit(NOMINAL, batch, pooled=True)
    seen = identifiability(found.values, found.names, jacobian=found.jacobian)
    (words,) = implausible_parameters(NOMINAL, times(NOMINAL, {"F_v": 0.5}), seen)
    assert words.startswith("viscous coefficient F_v is 0.50 times its nominal value")
    assert (
        implausible_parameters(NOMINAL, times(NOMINAL, {"J": 2.0, "P_m1": 2.0, "F_c": 2.0, "F_v": 2.0}), seen)
        == []
    )
    full = replace(seen, directions=())
    assert (
        len(
            implausible_parameters(
                NOMINAL, times(NOMINAL, {"J": 2.0, "P_m1": 2.0, "F_c": 2.0, "F_v": 2.0}), full
            )
        )
        == 4
    )


@pytest.mark.parametrize(
    ("unit", "power"),
    [
        ("N m s/rad", 1),
        ("kg m^2", 1),
        ("rad/(N m)", -1),
        ("1/(N m)^2", -2),
        ("V s/rad", 0),
        ("N m/V", 1),
        ("1", 0),
    ],
)
def test_power_of_torque_in_a_unit(unit: str, power: int) -> None:
    assert torque_power(unit) == power


def test_what_holds_the_scale_is_said_and_free_scales_are_not_said_twice() -> None:
    dataset, nominal = small_case()
    assert any("one number" in words and "claim" not in words for words in not_identifiable(dataset, nominal))
    held = nominal.with_specs({"J": replace(nominal.parameter("J").spec, estimate=False)})
    words = not_identifiable(dataset, held)
    assert any("P_m1" in w and "only the claim of J at" in w for w in words), words
