"""A motor that turns with the joint before its own, which the model does not know: found, and not invented."""

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from command_line import text_of
from gapcase import only
from servo_arm import described, of_joint, simulated, tones
from servo_arm import records_of as answered

from hybrid_id import Dataset, diagnose_arm
from hybrid_id.components import REGISTRY
from hybrid_id.diagnosis import arm
from hybrid_id.diagnosis.coupled_gear import CoupledGear, coupled_gears, with_gears
from hybrid_id.diagnosis.whole_robot import WholeRobot
from hybrid_id.identification.horizons import WHOLE
from hybrid_id.reporting.arm_diagnosis import arm_headline, arm_page, part_words
from hybrid_id.systems.chain import System
from hybrid_id.systems.model_file import load_model, save_model

pytest.importorskip("mujoco")

TURNS = 0.7
WRIST = """<mujoco><compiler angle="radian"/><worldbody>
<body><joint name="yaw" axis="0 0 1" armature="0.004" damping="0.05" frictionloss="0.02"/>
<inertial mass="0.5" pos="0 0 0.05" diaginertia="0.002 0.002 0.002"/>
<body pos="0 0 0.1"><joint name="bend" axis="0 1 0" armature="0.003" damping="0.04" frictionloss="0.02"/>
<inertial mass="0.3" pos="0 0 -0.02" diaginertia="0.001 0.001 0.0008"/>
<body pos="0 0 0.05"><joint name="roll" axis="0 0 1" armature="0.003" damping="0.04" frictionloss="0.015"/>
<inertial mass="0.1" pos="0.01 0 0" diaginertia="0.0005 0.0005 0.0004"/>
</body></body></body></worldbody><actuator><motor joint="yaw"/><motor joint="bend"/><motor joint="roll"/></actuator>
</mujoco>"""
GEAR = CoupledGear("roll", "bend", TURNS, 0.0, 1.0, 1.0)


@pytest.fixture(autouse=True)
def few() -> Iterator[None]:
    with only("constant_torque", "quadratic_drag"):
        yield


@pytest.fixture
def nominal(tmp_path: Path) -> System:
    (tmp_path / "wrist.xml").write_text(WRIST)
    (tmp_path / "model.yaml").write_text("robot: {file: wrist.xml}\n")
    return load_model(tmp_path / "model.yaml")


def records_of(system: System, count: int = 5) -> Dataset:
    """Torques and the joint angles that a system answers with, the last record a test record."""
    return simulated(
        system,
        count,
        np.random.default_rng(3),
        ("tau", "N m", "q_a"),
        lambda rng: 0.06 * tones(rng, (0.5, 1.1, 2.3)),
    )


def test_a_gear_that_the_model_lacks_is_found_with_its_turns(nominal: System, tmp_path: Path) -> None:
    found = diagnose_arm(records_of(with_gears(nominal, [GEAR])), nominal)
    (gear,) = found.gears
    assert (gear.motor, gear.joint) == ("roll", "bend")
    assert abs(gear.turns - TURNS) < max(4.0 * gear.std, 0.03) and gear.std < 0.05
    assert gear.share > 0.5 and gear.probability > 0.5
    assert list(found.joints) == ["yaw", "bend + roll"]
    assert found.verdict == "effects" and not found.unknown and not found.selected
    assert found.refit_errors is not None and found.model_errors is not None
    assert found.model_errors.nrmse < 0.5 * found.refit_errors.nrmse
    # what was handed in, re-fitted, and what it lacks
    assert found.refit.tree is not None and not found.refit.tree.couplings
    save_model(found.model, tmp_path / "corrected.yaml")
    again = load_model(tmp_path / "corrected.yaml").tree
    assert again is not None and again.couplings[0].matrix == ((1.0, 0.0), (gear.turns, 1.0))
    said = json.loads(json.dumps(found.as_dict()))
    assert said["coupled_gears"][0]["motor"] == "roll" and not said["no_gap"]
    assert "The motor of roll turns with bend, too: " in arm_headline(found)
    shown = text_of(arm_page(found, {}, {}).screen())
    assert "bend + roll" in shown and "a coupled gear" in shown and "corrected" in shown
    assert "here the nominal model has it" in part_words(found, "bend + roll").lower()
    assert part_words(found, "yaw") == ""


@pytest.mark.parametrize(("joint", "k"), [("roll", 0.15), ("bend", 0.3)])
def test_no_gear_is_invented_where_something_else_is_outside_the_catalogue(
    nominal: System, joint: str, k: float
) -> None:
    place = f"joint{2 if joint == 'bend' else 3}/load"
    spring = REGISTRY["spring_load"](k_s=k, q_s=0.2)
    dataset = records_of(nominal.with_component(place, spring))
    found = diagnose_arm(dataset, nominal, joints=["bend", "roll"])
    assert found.verdict == "outside_catalogue" and found.joints_with_unknown == [joint] and not found.gears


def test_springs_at_two_neighbours_are_no_gear(nominal: System) -> None:
    system = nominal
    for place, k in (("joint2/load", 0.3), ("joint3/load", 0.15)):
        system = system.with_component(place, REGISTRY["spring_load"](k_s=k, q_s=0.2))
    found = diagnose_arm(records_of(system), nominal, joints=["bend", "roll"])
    assert sorted(found.joints_with_unknown) == ["bend", "roll"] and not found.gears


def test_nothing_is_asked_where_nothing_is_missing(nominal: System, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = list[tuple[CoupledGear, ...]]()

    def listened(robot: WholeRobot) -> tuple[CoupledGear, ...]:
        asked.append(coupled_gears(robot))
        return asked[-1]

    monkeypatch.setattr(arm, "coupled_gears", listened)
    found = diagnose_arm(records_of(nominal, 3), nominal)
    assert asked == [()] and not found.gears and found.verdict in ("no_gap", "parameters_only")


def test_motors_that_a_loop_holds_are_not_asked(tmp_path: Path) -> None:
    nominal = described(tmp_path)
    dataset = answered(nominal.with_component("joint3/load", REGISTRY["spring_load"](k_s=0.8, q_s=0.4)))
    with only("quadratic_drag"):
        elbow = of_joint(dataset, nominal, 2)
    assert elbow.grade.unknown
    stages = list[str]()
    robot = WholeRobot(
        dataset,
        nominal,
        {"lift": elbow, "elbow": elbow},
        WHOLE,
        progress=lambda stage, *_: stages.append(stage),
    )
    assert coupled_gears(robot) == () and not stages
