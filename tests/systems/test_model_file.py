"""Model files: round trip, canonical form, refusal by one sentence, the cases that come with their models."""

import re
from pathlib import Path

import pytest
import torch
import yaml
from drives import rigid_drive
from hypothesis import given, settings
from hypothesis import strategies as st
from malformed_models import malformed_models, write_sound_model

from hybrid_id.components import (
    REGISTRY,
    LuGre,
    MotorEncoder,
    Stribeck,
)
from hybrid_id.components.base import Coupling, Shared
from hybrid_id.components.load.rotor_inertia import RotorInertia
from hybrid_id.errors import InputError
from hybrid_id.parameters import Bounded
from hybrid_id.systems import System, one_link, one_link_flexible, two_link
from hybrid_id.systems.model_file import describe_model, load_model, save_model

CASES = malformed_models()
FRICTION = "joint1/motor_friction"


def equal(a: System, b: System) -> bool:
    """Whether two systems have the same structure, values, bounds, roles and priors."""
    same = a.name == b.name and a.gear_ratio == b.gear_ratio and a.state_names == b.state_names
    rows = [{(i.component, i.symbol, i.name, i.spec) for i in s.table} for s in (a, b)]
    return same and rows[0] == rows[1] and set(a.components) == set(b.components)


def copy_through_file(system: System, folder: Path) -> System:
    save_model(system, folder / "model.yaml")
    return load_model(folder / "model.yaml")


def test_table_is_broad_and_its_sound_model_is_sound(tmp_path: Path) -> None:
    assert len(CASES) >= 25
    assert len({case.name for case in CASES}) == len(CASES)
    system = load_model(write_sound_model(tmp_path))
    assert system.parameter("J").spec == Bounded(2.1e-5, 4e-6, 1e-4, "kg m^2")
    assert not system.parameter("P_m2").spec.estimate
    assert system.parameter("F_drop").spec.value == 0.004


SYSTEMS = {
    "vertical": one_link(156.0, vertical=True),
    "frictionless": one_link().without_component(FRICTION, "viscous_friction"),
    "richer": rigid_drive().with_component(FRICTION, Stribeck()).with_component(FRICTION, LuGre()),
    "arm vertical": two_link((156.0, 84.0), vertical=True),
    "arm not coupled": two_link((9.0, 8.0)).without_component("joint1/load", "joint_coupling"),
    "offset": one_link(50.0).with_component("joint1/sensor", MotorEncoder(offset=-0.2)),
}


@pytest.mark.parametrize("name", SYSTEMS)
def test_round_trip_of_structures(name: str, tmp_path: Path) -> None:
    system = SYSTEMS[name]
    again = copy_through_file(system, tmp_path)
    assert equal(again, system)
    first = (tmp_path / "model.yaml").read_text()
    save_model(again, tmp_path / "model.yaml")
    assert (tmp_path / "model.yaml").read_text() == first, "saving writes one canonical form"


@pytest.mark.parametrize(
    "kind", sorted(k for k, c in REGISTRY.items() if c.__module__.startswith("hybrid_id."))
)
def test_round_trip_with_every_component(kind: str, tmp_path: Path) -> None:
    part = REGISTRY[kind]()
    if isinstance(part, RotorInertia | Shared):
        pytest.skip("it needs a robot: tests/systems/test_robot_model.py writes and reads it")
    for place in part.places:
        host = one_link(20.0) if getattr(part, "rigid", False) else one_link_flexible(20.0)
        if isinstance(part, Coupling):
            host = two_link((50.0, 30.0)).without_component("joint1/load", "joint_coupling")
        system = host.with_component(f"joint1/{place}", part)
        assert equal(copy_through_file(system, tmp_path), system)


positive = st.floats(1e-9, 1e3, allow_nan=False)


@given(
    values=st.tuples(positive, positive, st.floats(0.0, 1e3), st.floats(0.0, 1e3)),
    widths=st.tuples(st.floats(0.0, 1.0), st.floats(0.0, 1e6)),
    prior=st.none() | st.tuples(st.floats(0.0, 1.0), st.floats(1e-6, 1e3)),
    estimate=st.booleans(),
    ratio=st.floats(1e-2, 1e4),
)
@settings(max_examples=60)
def test_round_trip_of_values(tmp_path_factory, values, widths, prior, estimate, ratio) -> None:
    system = one_link(ratio).with_values(dict(zip(("J", "P_m1", "P_m2", "F_c"), values, strict=True)))
    spec = system.parameter("J").spec
    lower, upper = max(spec.value * (1 - widths[0]), spec.lower), min(spec.value + widths[1], spec.upper)
    mean, std = (min(max(prior[0], lower), upper), prior[1]) if prior else (None, None)
    spec = Bounded(spec.value, lower, upper, spec.unit, estimate and lower < upper, mean, std)
    system = system.with_specs({"J": spec})
    again = copy_through_file(system, tmp_path_factory.getbasetemp())
    assert equal(again, system)
    assert torch.equal(again.theta(), system.theta())


def test_prior_around_the_nominal_value_and_elsewhere(tmp_path: Path) -> None:
    path = write_sound_model(tmp_path)
    content = yaml.safe_load(path.read_text())
    content["parameters"]["P_m1"]["prior_std"] = 0.001
    content["parameters"]["P_m2"] |= {"prior_std": 0.002, "prior_mean": 0.03}
    path.write_text(yaml.safe_dump(content))
    system = load_model(path)
    assert system.parameter("P_m1").spec.prior_mean == 0.0185
    assert (system.parameter("P_m2").spec.prior_mean, system.parameter("P_m2").spec.prior_std) == (
        0.03,
        0.002,
    )
    assert "prior_mean" not in describe_model(system)["parameters"]["P_m1"]
    moved = system.with_values({"P_m1": 0.02})  # after a fit the prior stays where it was
    again = copy_through_file(moved, tmp_path)
    assert again.parameter("P_m1").spec.prior_mean == 0.0185


def test_absent_friction_is_absent(tmp_path: Path) -> None:
    path = write_sound_model(tmp_path)
    content = yaml.safe_load(path.read_text())
    del content["parameters"]["F_c"], content["components"]
    path.write_text(yaml.safe_dump(content))
    assert f"{FRICTION}/coulomb_friction" not in load_model(path).components


ARM = {
    "system": "two_link",
    "gear_ratio": [156.0, 84.0],
    "parameters": {
        "P_1": 1.1,
        "P_2": 0.136,
        "P_m1m1": 0.019,
        "P_m2m1": 0.025,
        "P_m1m2": 0.043,
        "P_m2m2": 0.011,
    },
}


def write_arm(folder: Path, **parameters: float) -> Path:
    path = folder / "arm.yaml"
    path.write_text(yaml.safe_dump(ARM | {"parameters": ARM["parameters"] | parameters}))
    return path


def test_what_an_arm_does_not_list_is_absent(tmp_path: Path) -> None:
    bare = load_model(write_arm(tmp_path))
    assert not any("joint_coupling" in key or "friction" in key for key in bare.components)
    half = load_model(write_arm(tmp_path, P_3=0.1, F_cm2=0.003, F_va1=0.2))
    assert half.parameter("P_4").spec.value == 0.0 and not half.parameter("P_4").spec.estimate
    assert {"F_cm2", "F_va1"} <= {info.name for info in half.table}


@pytest.mark.parametrize(
    "parameters, change, words",
    [
        ({}, {"gear_ratio": [156.0]}, ("gear_ratio", "2 positive numbers", "two_link")),
        ({"P_3": 0.1, "P_4": 0.4}, {}, ("not positive definite", "P_4 = 0.4")),
        ({}, {"gravity": "vertical"}, ("gravity is vertical", "G_l1 and G_l2")),
        ({"G_l1": 2.0}, {}, ("gravity is none", "G_l1 and G_l2")),
    ],
)
def test_malformed_arm_is_refused(parameters: dict, change: dict, words: tuple, tmp_path: Path) -> None:
    path = write_arm(tmp_path, **parameters)
    path.write_text(yaml.safe_dump(yaml.safe_load(path.read_text()) | change))
    with pytest.raises(InputError) as caught:
        load_model(path)
    assert all(word in str(caught.value) for word in (str(path), *words)), caught.value
    assert "\n" not in str(caught.value) and not re.search(r"\. [A-Z]", str(caught.value))


def test_a_system_of_another_name_is_not_written(tmp_path: Path) -> None:
    parts = [(key.rsplit("/", 1)[0], part) for key, part in one_link(100.0).components.items()]
    with pytest.raises(InputError, match="named 'valve' with 1 joints cannot be written"):
        save_model(System([100.0], parts, name="valve"), tmp_path / "model.yaml")
