"""The catalogue: complete, buildable, and what it builds goes through a model file."""

import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
from drives import flexible_drive, make_record, multisine, rigid_drive
from gapcase import STEP

from hybrid_id import InputError, Record, load_model, one_link, save_model, two_link
from hybrid_id.components import REGISTRY, Viscous
from hybrid_id.diagnosis.catalogue import CATALOGUE, JOINTS, SIDES, effect, rivals, separation, with_effect
from hybrid_id.diagnosis.scales import Scales, scales
from hybrid_id.simulation.compiled import source
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.systems import System

# Names and places as users and their answer sheets write them.
NAMES = {
    "delay": "input", "voltage_deadband": "input", "voltage_saturation": "input", "electrical_lag": "motor",
    "cogging": "motor", "thermal_derating": "motor", "coulomb_friction": "motor_friction link_friction",
    "viscous_friction": "motor_friction link_friction", "stribeck_friction": "motor_friction",
    "asymmetric_friction": "motor_friction", "presliding_friction": "motor_friction",
    "quadratic_drag": "motor_friction link_friction", "load_dependent_friction": "motor_friction",
    "position_dependent_friction": "motor_friction link_friction", "backlash": "transmission",
    "joint_flexibility": "transmission", "hardening_flexibility": "transmission", "kinematic_error": "transmission",
    "gravity_load": "load", "spring_load": "load", "constant_torque": "load", "joint_coupling": "load",
    "supply_sag": "input",
}  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_every_name_is_there_with_its_places(name: str) -> None:
    found = effect(name)
    assert set(NAMES[name].split()) <= set(found.places)
    assert found.smoothness.split()[0] in ("smooth", "kinks", "jumps")
    what, size = found.about.split("; ")  # what it is; how large it usually is
    assert what[0].islower() and size and "|" not in found.about and not size.endswith(".")


@pytest.mark.parametrize("name", CATALOGUE)
def test_every_effect_has_a_source_and_what_it_is_mistaken_for(name: str) -> None:
    assert re.search(r"\w\w.*, (1[6-9]|20)\d\d\b", effect(name).source), (
        "author, title, where it appeared, year"
    )
    others = rivals(name)
    assert others
    assert set(others) <= set(CATALOGUE) - {name}
    for other, words in others.items():
        # "What would: one; another.", on the screen without what comes after the colon, which says why
        assert words[0].islower() and not words.endswith(".") and ";" not in words
        assert words.count(": ") == 1
        assert rivals(other)[name] == words
        assert separation((name, "joint1/x"), (other, "joint1/y")) == words
    assert not [other for other in effect(name).mistaken_for if name in effect(other).mistaken_for], (
        "stated twice"
    )


def test_what_nobody_mistakes_and_what_acts_at_two_places() -> None:
    assert separation(("delay", "joint1/input"), ("gravity_load", "joint1/load")) == ""
    assert separation(("gremlins", "joint1/load"), ("delay", "joint1/input")) == ""
    sides = ("viscous_friction", "joint1/motor_friction"), ("viscous_friction", "joint1/link_friction")
    assert separation(*sides) == SIDES
    assert separation(("backlash", "joint1/transmission"), ("backlash", "joint2/transmission")) == JOINTS


def test_other_names_are_refused() -> None:
    with pytest.raises(InputError, match="'gremlins' is not in the catalogue; it has asymmetric_friction"):
        effect("gremlins")


def drives() -> dict[str, System]:
    """Systems that lack different things."""
    uncoupled = two_link((50.0, 40.0))
    uncoupled = uncoupled.without_component("joint1/load", "joint_coupling")
    return {
        "rigid": rigid_drive(ratio=50.0),
        "frictionless": one_link(50.0, friction=Viscous(F_v=5e-5)).with_values({"J": 2e-5}),
        "flexible": flexible_drive().without_component("joint1/link_friction", "viscous_friction"),
        "two": uncoupled,
    }


@cache
def models(kind: str) -> list[tuple[str, System]]:
    """Every model that the catalogue makes of a system, with the effect's name."""
    return list(_models(kind))


def _models(kind: str) -> Iterator[tuple[str, System]]:
    system = drives()[kind]
    if kind == "two":
        time = STEP * np.arange(200)
        wave = np.sin(3 * time)
        record = Record("r", time, {"u1": wave, "u2": wave}, {"q_m1": 20 * wave, "q_m2": 20 * wave})
    else:
        record = make_record(
            rigid_drive(ratio=50.0),
            multisine(0, samples=200, step=STEP),
            seed=0,
            noise={"q_m1": 0.01},
            step=STEP,
        )
    batch = make_batch(system, [record], noise_std={"q_m1": 0.01, "q_m2": 0.01})
    for size in scales(system, batch):
        for one in CATALOGUE.values():
            for starts in with_effect(one, system, size).values():
                yield from ((one.name, start) for start in starts)


@pytest.mark.parametrize("kind", drives())
def test_every_model_goes_through_a_file(kind: str, tmp_path: Path) -> None:
    made = models(kind)
    assert made
    for name, system in made:
        save_model(system, tmp_path / "model.yaml")
        again = load_model(tmp_path / "model.yaml")
        assert list(again.components) == list(system.components), name
        assert [i.spec for i in again.table] == [i.spec for i in system.table], name
        torch.testing.assert_close(again.theta(), system.theta(), rtol=0, atol=0)


def test_some_system_takes_each_effect() -> None:
    assert {name for kind in drives() for name, _ in models(kind)} >= set(NAMES)


def test_what_is_there_is_not_offered_again() -> None:
    offered = {name for name, _ in models("rigid")}
    assert not offered & {"coulomb_friction", "hardening_flexibility", "joint_coupling"}
    assert "viscous_friction" not in offered  # behind a rigid gear it is the back-EMF's


def test_a_weight_may_hang_at_any_angle() -> None:
    size = Scales(
        joint=1, ratio=50.0, sample_time=STEP, duration=2.0, command=12.0, command_rms=6.0, speed=100.0, turns=80.0,
        angle=1.6, middle=0.0, torque=0.05, dry=0.01, inertia=2e-5, rotor=1e-5,
    )  # fmt: skip
    for system in (one_link(50.0, vertical=True), two_link((50.0, 40.0), vertical=True), one_link(50.0)):
        found = with_effect(effect("gravity_load"), system, size)
        assert found
        for start in found["joint1/load"]:
            assert start.parameter("q_0").spec.estimate
            again = with_effect(effect("gravity_load"), start, size)
            assert not again, "a weight that is free already is not offered again"


@pytest.mark.parametrize("kind", drives())
def test_every_model_can_be_compiled(kind: str) -> None:
    for _, system in models(kind):
        arrived = [f"arrived{joint.number}" for joint in system.joints]  # what is left of a delay
        assert "equations" in source(system, [*system.input_names, *arrived])[0]


def test_play_starts_with_a_lighter_rotor_where_the_arm_needs_its_inertia() -> None:
    coupled = two_link((50.0, 40.0)).with_values({"P_1": 0.3443, "P_2": 0.19, "P_3": 0.1338, "P_4": 0.0311})
    size = Scales(
        joint=2, ratio=40.0, sample_time=STEP, duration=2.0, command=12.0, command_rms=6.0, speed=100.0, turns=80.0,
        angle=1.6, middle=0.0, torque=0.05, dry=0.01, inertia=8e-5, rotor=2e-5,
    )  # fmt: skip
    with pytest.raises(InputError, match="mass matrix"):
        coupled.with_component("joint2/transmission", REGISTRY["backlash"]())
    built = with_effect(effect("backlash"), coupled, size)["joint2/transmission"]
    share = next(i for i in built[0].table if i.symbol == "rotor_share" and i.component.startswith("joint2"))
    assert built and share.spec.value < 0.3 and share.spec.estimate
