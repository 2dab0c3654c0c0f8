"""Places, composition, names and parameter vectors of a chain."""

# pyright: reportAttributeAccessIssue=false

import math

import numpy as np
import pytest
import torch
from drives import flexible_drive, rigid_drive, run

from hybrid_id.components import (
    AsymmetricStribeck,
    Coulomb,
    CurrentCommand,
    Dahl,
    DCMotor,
    Gravity,
    LinearSpring,
    LoadDependent,
    LuGre,
    OneLink,
    Rigid,
    Stribeck,
    TorqueMotor,
    TwoInertias,
    Viscous,
)
from hybrid_id.errors import InputError
from hybrid_id.parameters import Bounded
from hybrid_id.systems import one_link, one_link_flexible

FRICTION = "joint1/motor_friction"


@pytest.mark.parametrize(
    "where, part, words",
    [
        ("joint2/motor", DCMotor(), ("joint2/motor", "joint1")),
        ("joint1/gearbox", Rigid(), ("joint1/gearbox", "transmission")),
        ("motor", DCMotor(), ("'motor'",)),
        ("joint1/motor", Coulomb(), ("coulomb_friction", "joint1/motor", "motor_friction")),
        ("joint1/link_friction", LoadDependent(), ("load_dependent_friction", "motor_friction")),
        (FRICTION, DCMotor(), ("dc_motor", "'joint1/motor_friction'", "belongs in motor")),
    ],
)
def test_component_in_a_wrong_place_is_refused(where: str, part, words: tuple[str, ...]) -> None:
    with pytest.raises(InputError) as caught:
        one_link().with_component(where, part)
    assert all(word in str(caught.value) for word in words), caught.value
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", ["voltage", "dc_motor", "rigid", "one_link"])
def test_place_that_must_be_filled(kind: str) -> None:
    key = next(key for key in one_link().components if key.endswith(f"/{kind}"))
    with pytest.raises(InputError, match=r"joint1 has 0 components of type .*; it needs exactly one"):
        one_link().without_component(key.rsplit("/", 1)[0], kind)


def test_two_bristles_on_one_speed_are_refused() -> None:
    with pytest.raises(InputError, match="two bristle frictions on one speed"):
        one_link().with_component(FRICTION, Dahl()).with_component(FRICTION, LuGre())
    with pytest.raises(InputError, match="two bristle frictions on one speed"):
        one_link().with_component(FRICTION, Dahl()).with_component("joint1/link_friction", LuGre())
    flexible = one_link_flexible().with_component(FRICTION, Dahl())
    assert flexible.with_component("joint1/link_friction", LuGre()).state_names[-2:] == ["F_m1", "z_a1"]


def test_removal_of_what_is_not_there_names_what_is() -> None:
    with pytest.raises(InputError, match=r"no lugre at 'joint1/motor_friction'.*coulomb_friction"):
        one_link().without_component(FRICTION, "lugre")


def test_composition_leaves_the_old_system_alone() -> None:
    base = rigid_drive()
    names = [info.name for info in base.table]
    law = Stribeck(F_drop=0.007)
    richer = base.with_component(FRICTION, law)
    assert [info.name for info in base.table] == names
    assert set(names) < {info.name for info in richer.table}
    with torch.no_grad():
        law.F_drop.fill_(0.5)  # the system owns a copy
    assert richer.theta().tolist() != richer.with_values({"F_drop": 0.5}).theta().tolist()
    again = richer.without_component(FRICTION, "stribeck_friction")
    assert [info.name for info in again.table] == names
    assert torch.equal(again.theta(), base.theta())
    u = 5.0 * np.ones(20)
    np.testing.assert_array_equal(run(again, {"u1": u})["q_m1"], run(base, {"u1": u})["q_m1"])


def test_single_places_are_replaced_and_shared_ones_filled() -> None:
    system = one_link(10.0).with_component("joint1/motor", TorqueMotor())
    assert "joint1/motor/dc_motor" not in system.components
    flexible = one_link(10.0).with_component("joint1/transmission", LinearSpring())
    assert flexible.state_names == ["q_m1", "v_m1", "q_a1", "v_a1"]
    two = flexible.with_component("joint1/load", TwoInertias())
    assert "joint1/load/one_link" not in two.components and "J" not in {i.name for i in two.table}
    weighted = two.with_component("joint1/load", Gravity())
    assert {"joint1/load/two_inertias", "joint1/load/gravity_load"} <= set(weighted.components)
    assert system.with_component("joint1/input", CurrentCommand()).input_names == ["i1"]


def test_spring_with_one_inertia_splits_it_at_the_gear() -> None:
    system = one_link(10.0).with_values({"J": 4e-5, "rotor_share": 0.25})
    split = system.with_component("joint1/transmission", LinearSpring(k=50.0, d=0.1))
    two = split.with_component("joint1/load", TwoInertias(J_m=1e-5, J_a=3e-5 * 100))
    u = 6.0 * np.sin(0.05 * np.arange(100))
    np.testing.assert_allclose(run(split, {"u1": u})["q_a1"], run(two, {"u1": u})["q_a1"], rtol=1e-12)


def test_names_are_short_where_they_are_unique() -> None:
    assert {i.name for i in one_link(vertical=True).table} >= {"J", "P_m1", "P_m2", "F_c", "F_v", "G_l"}
    names = [i.name for i in one_link_flexible().table]
    assert {"J_m", "J_a", "k", "d", "P_m1", "P_m2", "F_cm", "F_vm", "F_va"} <= set(names)
    both = one_link().with_component("joint1/link_friction", Viscous())
    assert {"F_v_joint1_motor_friction_viscous_friction", "F_v_joint1_link_friction_viscous_friction"} <= {
        i.name for i in both.table
    }
    for system in (both, one_link(friction=AsymmetricStribeck()), flexible_drive()):
        names = [i.name for i in system.table]
        assert len(set(names)) == len(names)
        assert all(i.doc and i.spec.unit for i in system.table)


def test_values_and_specs_are_replaced_by_name() -> None:
    system = one_link().with_values({"J": 3e-5, "F_c": 0.0})
    assert system.parameter("J").spec.value == 3e-5
    assert system.theta()[[i.name for i in system.table].index("J")].item() == 3e-5
    with pytest.raises(InputError, match=r"no parameter 'j'.*J"):
        system.with_values({"j": 1.0})
    with pytest.raises(InputError, match=r"F_c.*outside its bounds"):
        system.with_values({"F_c": -1e-3})
    spec = Bounded(2e-5, lower=1e-5, upper=5e-5, unit="kg m^2", prior_mean=2e-5, prior_std=1e-6)
    held = system.with_specs({"J": spec})
    assert held.parameter("J").spec == spec
    with pytest.raises(InputError, match=r"J = 6e-05 kg m\^2 lies outside"):
        held.with_values({"J": 6e-5})
    for bad in (math.nan, math.inf):
        with pytest.raises(InputError, match="finite"):
            system.with_values({"J": bad})


@pytest.mark.parametrize("prior", [0.0, -1.0, math.nan])
def test_prior_must_have_a_width(prior: float) -> None:
    with pytest.raises(InputError, match="prior_std"):
        OneLink(J=Bounded(2e-5, prior_std=prior))


def test_table_has_one_order_however_a_system_was_built() -> None:
    law = Stribeck()
    one = one_link(friction=Coulomb()).with_component(FRICTION, law).with_component(FRICTION, Viscous())
    other = one_link().with_component(FRICTION, law)
    assert [i.name for i in one.table] == [i.name for i in other.table]
    replaced = one_link().with_component("joint1/load", OneLink(J=3e-5))
    assert [i.name for i in replaced.table] == [i.name for i in one_link().table]


@pytest.mark.parametrize("push, expected", [(400.0, 0.0), (600.0, 100.0), (-600.0, -100.0)])
def test_pushed_speed_is_held_by_friction_and_breaks_away_beyond_it(push: float, expected: float) -> None:
    system, x = rigid_drive(), [torch.zeros(1)] * 2  # its friction holds 0.01 N m of 2e-5 kg m^2
    p = system.views([*system.theta().detach()[:, None]])
    u = {"u1": torch.zeros(1), "push0": torch.tensor([push])}
    rates = system.rates(x, u, p, system.directions(x, u, p))
    assert float(rates[1]) == pytest.approx(expected)
