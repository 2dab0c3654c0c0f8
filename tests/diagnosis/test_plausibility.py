"""Parameters that a re-fit has moved beyond data-sheet tolerance."""

from dataclasses import replace

from hybrid_id.components import JointFlexibility
from hybrid_id.diagnosis.plausibility import implausible_parameters
from hybrid_id.study.identifiable import preflight


def test_implausible_parameters_are_named_apart_from_the_common_scale(sound) -> None:
    nominal = sound[1]
    values = {i.name: i.spec.value for i in nominal.table if i.spec.estimate}
    scaled = {name: (1 if name == "P_m2" else 1.7) * value for name, value in values.items()}
    assert implausible_parameters(nominal, nominal.with_values(scaled)) == []
    words = implausible_parameters(nominal, nominal.with_values({"F_c": 0.0}))
    assert words == ["F_c is driven to zero"]
    # a resistance 40 % too high shows where a prior holds the motor's constant, which else is taken for a common scale
    high = {"P_m1": values["P_m1"] / 1.4}
    prior = replace(
        nominal.parameter("P_m1").spec, prior_std=0.05 * values["P_m1"], prior_mean=values["P_m1"]
    )
    held = nominal.with_specs({"P_m1": prior})
    assert implausible_parameters(nominal, nominal.with_values(high)) == []
    assert implausible_parameters(held, held.with_values(high)) == [
        "P_m1 is 5.7 standard deviations of its prior too low"
    ]
    assert implausible_parameters(held, held.with_values({"P_m1": 1.1 * values["P_m1"]})) == []
    # what moves unseen by the records is said beside what it may have moved
    told = preflight(sound[0], nominal)
    (line,) = implausible_parameters(nominal, nominal.with_values({"F_v": 0.5 * values["F_v"]}), told)
    assert line.startswith("F_v is 0.50 times its nominal value (unseen by these records: P_m2 off by +")
    assert implausible_parameters(nominal, nominal.with_values({"F_c": 0.0}), told) == words
    # where the scale is known, what has not moved is not implausible, and what has is
    fixed = nominal.with_specs({"P_m1": replace(nominal.parameter("P_m1").spec, estimate=False)})
    doubled = {"F_c": 2.0 * values["F_c"], "F_v": 2.0 * values["F_v"]}
    assert implausible_parameters(fixed, fixed.with_values(doubled)) == [
        f"{name} is 2.00 times its nominal value" for name in ("F_c", "F_v")
    ]
    # what has torque below the line falls as torques rise
    soft = nominal.with_component("joint1/transmission", JointFlexibility(compliance=0.05, zeta=0.3))
    flexible = {i.name: i.spec.value for i in soft.table if i.spec.estimate}
    torques = {name: v * (1.0 if name in ("P_m2", "zeta") else 1.7) for name, v in flexible.items()}
    torques["compliance"] = flexible["compliance"] / 1.7
    assert implausible_parameters(soft, soft.with_values(torques)) == []


def test_a_part_that_an_effect_has_replaced_has_not_moved(sound) -> None:
    nominal = sound[1]
    gone = nominal.without_component("joint1/motor_friction", "coulomb_friction")
    assert implausible_parameters(nominal, gone) == []
    twice = {"P_m2": 2.0 * nominal.parameter("P_m2").spec.value}
    assert implausible_parameters(nominal, nominal.with_values(twice))
