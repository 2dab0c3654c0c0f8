"""Axes that slide have kilograms, newtons and metres, in files and on the screen (class 13 of what breaks programs)."""

from pathlib import Path

import pytest
import yaml

from hybrid_id.components import REGISTRY
from hybrid_id.errors import InputError
from hybrid_id.parameters import linear_unit
from hybrid_id.records.dataset import Channel
from hybrid_id.reporting.units import shown_unit
from hybrid_id.systems.by_joint import alone
from hybrid_id.systems.chain import System
from hybrid_id.systems.model_file import load_model, save_model

ARM = (
    '<mujoco><worldbody><body><joint name="rail" type="slide" axis="1 0 0" armature="0.5" damping="2" '
    'frictionloss="0.1"/><inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/><body>'
    '<joint name="turn" axis="0 1 0" armature="0.1" damping="0.2" frictionloss="0.01"/>'
    '<inertial mass="1" pos="0.1 0 0" diaginertia="1 1 1"/></body></body></worldbody></mujoco>'
)


def arm(folder: Path, ratio: float = 1.0, **values: dict) -> System:
    (folder / "arm.xml").write_text(ARM)
    parts = [("rail/motor_friction", "viscous_friction", "F_v"), ("rail/link_friction", "viscous_friction", "F_v"),
             ("rail/transmission", "linear_spring", "k"), ("turn/load", "rotor_inertia", "J_m")]  # fmt: skip
    components = [
        {"place": place, "kind": kind, "parameters": {symbol: values.get(place.replace("/", "_"), 1.0)}}
        for place, kind, symbol in parts
    ]
    content = {"robot": {"file": "arm.xml"}, "gear_ratio": [ratio, 1.0], "components": components}
    (folder / "model.yaml").write_text(yaml.safe_dump(content))
    return load_model(folder / "model.yaml")


def units(system: System) -> dict[str, str]:
    return {f"{i.component.rpartition('/')[0]} {i.symbol}": i.unit for i in system.table}


def test_units_are_those_of_a_force_and_a_way(tmp_path: Path) -> None:
    direct, geared = units(arm(tmp_path)), units(arm(tmp_path, 200.0))
    assert direct["joint1/load J_m"] == "kg" and direct["joint1/motor_friction F_v"] == "N s/m"
    assert direct["joint1/motor_friction F_c"] == "N"
    assert geared["joint1/load J_m"] == "kg m^2" and geared["joint1/motor_friction F_v"] == "N m s/rad"
    for found in (direct, geared, units(alone(arm(tmp_path, 200.0), 0))):
        assert found["joint1/transmission k"] == "N/m" and found["joint1/link_friction F_v"] == "N s/m"
    assert direct["joint2/load J_m"] == "kg m^2" and direct["joint2/motor_friction F_c"] == "N m"


@pytest.mark.parametrize("unit", ["N s/m", "N m s/rad"])
def test_both_are_read_and_the_axis_own_are_written(tmp_path: Path, unit: str) -> None:
    system = arm(tmp_path, rail_motor_friction={"nominal": 3.0, "unit": unit})
    save_model(system, tmp_path / "again.yaml")
    written = yaml.safe_load((tmp_path / "again.yaml").read_text())["components"]
    entry = next(
        one for one in written if one["place"] == "rail/motor_friction" and "F_v" in one["parameters"]
    )
    assert entry["parameters"]["F_v"] | {"estimate": True} == {
        "nominal": 3.0, "lower": 0.0, "upper": entry["parameters"]["F_v"]["upper"], "unit": "N s/m", "estimate": True,
    }  # fmt: skip
    again = load_model(tmp_path / "again.yaml")
    assert [(i.name, i.unit, i.spec) for i in again.table] == [(i.name, i.unit, i.spec) for i in system.table]


def test_a_joint_that_turns_takes_no_kilograms(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"J_m has unit 'kg'; convert it to 'kg m\^2'"):
        arm(tmp_path, turn_load={"nominal": 0.1, "unit": "kg"})
    with pytest.raises(InputError, match="has unit 'N s/m'"):  # the motor behind a gear turns
        arm(tmp_path, 200.0, rail_motor_friction={"nominal": 0.1, "unit": "N s/m"})


def test_ways_are_shown_as_they_were_logged() -> None:
    outputs = Channel("q_m1", "m", logged="mm"), Channel("q_m2", "rad", logged="deg")
    assert shown_unit("m", outputs) == ("mm", pytest.approx(1000.0))
    assert shown_unit("rad", outputs) == ("deg", pytest.approx(57.2957795))
    assert shown_unit("N", outputs) == ("N", 1.0)


def test_no_unit_of_a_law_keeps_an_angle_along_an_axis() -> None:
    for kind in REGISTRY.values():
        for declared in kind.declared.values():
            along = linear_unit(declared.unit)
            assert "rad" not in along and "N m" not in along and linear_unit(along) == along, declared.unit
