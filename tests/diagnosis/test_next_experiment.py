"""Which record would part models that the records at hand do not: simulated before it is proposed."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from gapcase import small_case

from hybrid_id.components import ConstantTorque, PositionLoop, Stribeck
from hybrid_id.diagnosis.fits import engine
from hybrid_id.diagnosis.next_experiment import REST, next_experiment
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.record import Record
from hybrid_id.systems import System
from hybrid_id.systems.by_joint import alone, with_others_measured
from hybrid_id.systems.model_file import load_model

GOAL = Channel("goal1", "rad"), Channel("gain1", "1"), Channel("supply1", "V")


def explanation(system: System, name: str = "today") -> SimpleNamespace:
    """A model as a search ends with it."""
    effects = ((name, "joint1/load"),)
    return SimpleNamespace(system=system, effects=effects, result=SimpleNamespace(engine=engine()))


def test_the_experiment_that_parts_models_most_comes_first() -> None:
    dataset, today = small_case()
    falling = Stribeck(F_drop=0.005, v_s=20.0)
    other = today.with_component("joint1/motor_friction", falling)
    found = next_experiment(dataset, [explanation(today), explanation(other, "fall")])
    distances = [one.distance for one in found]
    assert len(found) == 6
    assert distances == sorted(distances, reverse=True)
    assert distances[0] > 0
    assert all(one.distance_now == found[0].distance_now > 0 for one in found)
    largest = max(np.abs(record.inputs["u1"]).max() for record in dataset.train)
    for one in found:
        assert one.joint == 1
        assert not one.command[one.time < REST].any()
        assert 0 < np.abs(one.command).max() <= largest * (1 + 1e-12)


def test_what_no_command_parts_is_said_and_the_rest_parted() -> None:
    dataset, today = small_case()
    other = today.with_component("joint1/motor_friction", Stribeck(F_drop=0.005, v_s=20.0))
    tied = [explanation(today, "bias"), explanation(today, "uneven"), explanation(other, "fall")]
    best = next_experiment(dataset, tied)[0]
    assert best.distinguishes and best.together == (("bias@joint1/load", "uneven@joint1/load"),)
    assert best.distance == pytest.approx(next_experiment(dataset, tied[1:])[0].distance)


def test_noise_that_nobody_declared_is_estimated() -> None:
    dataset, today = small_case()
    other = today.with_component("joint1/motor_friction", Stribeck(F_drop=0.005, v_s=20.0))
    tied = [explanation(today), explanation(other, "fall")]
    silent = replace(dataset, outputs=tuple(replace(one, noise_std=None) for one in dataset.outputs))
    declared, estimated = (next_experiment(one, tied)[0] for one in (dataset, silent))
    assert estimated.distance == pytest.approx(declared.distance, rel=0.1)


def test_goals_stay_where_the_records_have_been() -> None:
    dataset, today = small_case()
    servo = today.with_component("joint1/input", PositionLoop())
    goal = {"goal1": 1.5 + 0.5 * np.sin(dataset.train[0].time), "gain1": 1.0 + 0.0 * dataset.train[0].time}
    first = dataset.train[0]
    supply = {"supply1": np.full_like(first.time, 7.4)}
    record = replace(first, inputs=goal | supply, outputs={"q_m1": 1.5 + 0.0 * first.time})
    served = replace(dataset, inputs=GOAL, records=(record,))
    tied = [explanation(servo), explanation(servo, "other")]
    for one in next_experiment(served, tied):
        low, high = goal["goal1"].min(), goal["goal1"].max()
        assert low - 1e-9 <= one.command.min() and one.command.max() <= high + 1e-9
        assert one.command[0] == pytest.approx((low + high) / 2)


def test_models_that_are_alike_are_parted_by_none() -> None:
    dataset, today = small_case()
    short = replace(dataset, records=dataset.records[:1])
    found = next_experiment(short, [explanation(today), explanation(today)])
    assert found
    assert not any(one.distinguishes or one.distance for one in found)
    assert next_experiment(short, [explanation(today)]) == []


def test_a_robots_joint_stays_in_its_range_and_the_others_take_postures(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    text = (
        '<mujoco><compiler angle="radian"/><worldbody><body>'
        '<joint name="lift" axis="0 1 0" range="{}" armature="0.02" damping="0.1"/>'
        '<inertial mass="0.4" pos="0 0 0.1" diaginertia="0.001 0.001 0.0003"/><body pos="0 0 0.2">'
        '<joint name="elbow" axis="0 1 0" armature="0.01" damping="0.05"/><inertial mass="0.2" pos="0 0 0.08" '
        'diaginertia="0.0004 0.0004 0.0001"/></body></body></worldbody></mujoco>'
    )
    time = 0.01 * np.arange(100)
    torques = {f"tau{k}": 0.3 * np.sin(8.0 * time) for k in (1, 2)}
    angles = {"q_m1": 3.0 * np.sin(8.0 * time), "q_m2": np.linspace(0.0, 1.0, 100)}
    drives = (
        tuple(Channel(f"tau{k}", "N m") for k in (1, 2)),
        tuple(Channel(f"q_m{k}", "rad", 1e-3) for k in (1, 2)),
    )
    records = Dataset("arm", *drives, (Record("run", time, torques, angles),), 0.01)
    found = {}
    for name, limits in {"wide": "-100 100", "narrow": "-3.1 3.1"}.items():
        (tmp_path / "arm.xml").write_text(text.format(limits))
        (tmp_path / "model.yaml").write_text("robot: {file: arm.xml}\n")
        system = load_model(tmp_path / "model.yaml")
        lift, seen = alone(system, 0), with_others_measured(records, system, 0)
        biased = lift.with_component("joint1/load", ConstantTorque(T_0=0.05))
        found[name] = next_experiment(seen, [explanation(lift), explanation(biased, "bias")])
    postures = sorted({float(one.inputs["angle2"][0]) for one in found["wide"]})
    assert postures == pytest.approx([0.1, 0.5, 0.9], abs=0.03)
    assert len({one.name for one in found["wide"]}) == len(found["wide"]) > len(found["narrow"])
    for one in found[
        "wide"
    ]:  # by torque alone it would fall: its own controller follows goals where it has been
        assert one.channel == "goal1" and "own controller" in one.name
        assert np.abs(one.command).max() <= 3.0 + 1e-9
