"""Which records would distinguish models that the records at hand do not: simulated before they are proposed."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from gapcase import small_case

from hybrid_id.components import AsymmetricFriction, ConstantTorque, PositionLoop, Stribeck
from hybrid_id.components.load.spring import Spring
from hybrid_id.diagnosis.fits import engine
from hybrid_id.diagnosis.model import FittedModel
from hybrid_id.diagnosis.next_experiment import RECORDS, REST, _Loop, next_experiment
from hybrid_id.diagnosis.validation import validation
from hybrid_id.identification.fit import fit
from hybrid_id.identification.horizons import Horizon
from hybrid_id.identification.least_squares import Options
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.record import Record
from hybrid_id.study.replay import batch_of
from hybrid_id.systems import System, one_link_flexible
from hybrid_id.systems.by_joint import alone, with_others_measured
from hybrid_id.systems.model_file import load_model

GOAL = Channel("goal1", "rad"), Channel("gain1", "1"), Channel("supply1", "V")
FALLING = Stribeck(F_drop=0.01, v_s=20.0)


def explanation(
    dataset: Dataset,
    system: System,
    name: str = "today",
    *,
    horizon: Horizon | None = None,
    iterations: int = 0,
) -> FittedModel:
    """A model as a search ends with it."""
    batch = batch_of(replace(dataset, signal_share=0.0), system, dataset.train)
    batch = batch if horizon is None else horizon.cut(system, engine(), batch)
    found = fit(
        system, batch, pooled=True, engine=engine(), options=Options(max_iterations=iterations), warm=False
    )[0]
    seen = validation(found.residual, dataset.sample_time, found.records)
    return FittedModel(((name, "joint1/load"),), found, seen, judged=False)


def test_each_record_adds_what_those_before_it_lack() -> None:
    dataset, today = small_case()
    tied = [
        explanation(dataset, today),
        explanation(dataset, today.with_component("joint1/motor_friction", FALLING), "fall"),
    ]
    found = next_experiment(dataset, [tied])
    assert 0 < len(found) <= RECORDS and len(found) == len({one.name for one in found})
    assert found[0].distinguishes and not found[0].undistinguished
    largest = max(np.abs(record.inputs["u1"]).max() for record in dataset.train)
    for one in found:
        assert one.joint == 1 and not one.by_controller
        assert not one.command[one.time < REST].any()
        assert 0 < np.abs(one.command).max() <= largest * (1 + 1e-12)


def test_what_no_command_distinguishes_is_said_and_the_rest_distinguished() -> None:
    dataset, today = small_case(ConstantTorque(T_0=0.01), "joint1/load")
    bias = explanation(
        dataset, today.with_component("joint1/load", ConstantTorque(T_0=0.01)), "bias", iterations=20
    )
    uneven = explanation(
        dataset,
        today.with_component("joint1/motor_friction", AsymmetricFriction(F_a=0.0004)),
        "uneven",
        iterations=20,
    )
    spring = explanation(
        dataset, today.with_component("joint1/load", Spring(k_s=0.05)), "spring", iterations=20
    )
    best = next_experiment(dataset, [[bias, uneven, spring]])[-1]
    assert best.distinguishes and best.undistinguished == (("bias@joint1/load", "uneven@joint1/load"),)


def test_pairs_of_two_ties_are_compared_within_each() -> None:
    dataset, today = small_case()
    one, other = (
        explanation(dataset, today),
        explanation(dataset, today.with_component("joint1/motor_friction", FALLING), "fall"),
    )
    found = next_experiment(dataset, [[one, other], [one, one]])
    assert found[-1].distinguishes and found[-1].undistinguished == (("", ""),)


def test_noise_that_nobody_declared_is_estimated() -> None:
    dataset, today = small_case()
    tied = [
        explanation(dataset, today),
        explanation(dataset, today.with_component("joint1/motor_friction", FALLING), "fall"),
    ]
    silent = replace(dataset, outputs=tuple(replace(one, noise_std=None) for one in dataset.outputs))
    declared, estimated = (next_experiment(one, [tied])[-1] for one in (dataset, silent))
    assert estimated.distance == pytest.approx(declared.distance, rel=0.1)


def test_goals_stay_where_the_records_have_been() -> None:
    dataset, today = small_case()
    servo = today.with_component("joint1/input", PositionLoop())
    goal = {"goal1": 1.5 + 0.5 * np.sin(dataset.train[0].time), "gain1": 1.0 + 0.0 * dataset.train[0].time}
    first = dataset.train[0]
    supply = {"supply1": np.full_like(first.time, 7.4)}
    record = replace(first, inputs=goal | supply, outputs={"q_m1": 1.5 + 0.0 * first.time})
    served = replace(dataset, inputs=GOAL, records=(record,))
    tied = [explanation(served, servo), explanation(served, servo, "other")]
    found = next_experiment(served, [tied])
    assert found
    for one in found:
        low, high = goal["goal1"].min(), goal["goal1"].max()
        assert low - 1e-9 <= one.command.min() and one.command.max() <= high + 1e-9
        assert one.command[0] == pytest.approx((low + high) / 2)


def test_models_that_are_alike_are_distinguished_by_none() -> None:
    dataset, today = small_case()
    one = explanation(dataset, today)
    found = next_experiment(dataset, [[one, one]])
    assert found and not any(each.distinguishes or each.distance for each in found)
    assert next_experiment(dataset, []) == []


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
        short = Horizon("windows", 0.2)
        tied = [explanation(seen, lift, horizon=short), explanation(seen, biased, "bias", horizon=short)]
        found[name] = next_experiment(seen, [tied], short)
    postures = {float(one.inputs["angle2"][0]) for one in found["wide"]}
    assert all(min(abs(one - level) for level in (0.1, 0.5, 0.9)) < 0.03 for one in postures)
    assert len({(one.name, one.posture) for one in found["wide"]}) == RECORDS
    for one in (*found["wide"], *found["narrow"]):
        # by torque alone it would fall: its own controller follows goals where it has been
        assert one.channel == "goal1" and one.by_controller
        assert np.abs(one.command).max() <= 3.0 + 1e-9


def test_soft_and_rigid_rivals_are_compared_in_either_order() -> None:
    dataset, today = small_case()
    soft = one_link_flexible(today.joints[0].gear_ratio).with_values({"k": 5.0})
    rivals = [explanation(dataset, today, "rigid"), explanation(dataset, soft, "soft")]
    one, other = (next_experiment(dataset, [tied]) for tied in (rivals, rivals[::-1]))
    assert [e.name for e in one] == [e.name for e in other]
    assert one[-1].distance == pytest.approx(other[-1].distance)


def test_a_geared_joint_is_moved_by_its_motors_torque() -> None:
    _, geared = small_case()
    ratio, loop = geared.joints[0].gear_ratio, _Loop(k_p=4.0, k_d=0.5, most=2.0)
    assert ratio == 50.0
    goals = SimpleNamespace(command=np.array([1.0, 0.0, -1.0]))
    # states are the rotor's, goals the link's
    x = torch.tensor([[[0.5, 0.2], [0.1, -0.3], [0.0, 0.0]]], dtype=torch.float64) * ratio
    told = loop.torque(geared, 1, x, [goals])  # type: ignore[list-item]
    np.testing.assert_allclose(told, np.array([[1.9, -0.25, -2.0]]) / ratio)
