"""One joint of a robot with the others as measured: the same motion as all simulated, and the same parameters."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from servo_arm import ARM as SERVO_ARM

from hybrid_id.components import FloorContact, LinearSpring, Stribeck
from hybrid_id.components.input.delay import CommonDelay, Delay
from hybrid_id.errors import InputError
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.record import Record
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.step import Engine
from hybrid_id.study import identify
from hybrid_id.systems.by_joint import (
    alone,
    check_angles,
    joint_number,
    named,
    noisier,
    some,
    together,
    with_drive,
    with_others_measured,
)
from hybrid_id.systems.chain import System
from hybrid_id.systems.model_file import load_model, save_model

pytest.importorskip("mujoco")

STEP = 0.004
ENGINE = Engine("dry", 4, compiled=True)
ARM = SERVO_ARM.replace('0.0001"/>', '0.0001"/><site name="tip" pos="0 0 0.2"/>')


def arm(folder: Path) -> System:
    (folder / "arm.xml").write_text(ARM)
    (folder / "model.yaml").write_text("robot: {file: arm.xml}\n")
    return load_model(folder / "model.yaml")


def records_of(system: System, count: int = 2, noise: float = 0.0) -> Dataset:
    """Goals of the joints and what the whole arm does with them."""
    rng, time = np.random.default_rng(3), STEP * np.arange(750)
    channels = {"goal1": 0.5, "goal2": 0.4, "goal3": 0.5}
    records = []
    for k in range(count):
        inputs = {
            name: size
            * sum(np.sin(2 * np.pi * f * time + rng.uniform(0, 6.28)) for f in (0.5, 1.1, 1.9))
            * np.minimum(time / 0.2, 1.0)
            for name, size in channels.items()
        }
        blank = Record(f"run_{k}", time, inputs, {f"q_m{j}": 0.0 * time for j in (1, 2, 3)})
        batch = make_batch(system, [blank], noise_std={f"q_m{j}": 1e-6 for j in (1, 2, 3)})
        angles = simulate(system, ENGINE, batch).y[0].numpy()
        angles = angles + noise * rng.standard_normal(angles.shape)
        outputs = {f"q_m{j}": angles[:, j - 1] for j in (1, 2, 3)}
        records.append(Record(blank.name, time, inputs, outputs))
    return Dataset(
        "arm",
        (Channel("goal1", "rad"), Channel("goal2", "rad"), Channel("goal3", "rad")),
        tuple(Channel(f"q_m{j}", "rad", noise or None) for j in (1, 2, 3)),
        tuple(records),
        STEP,
    )


@pytest.mark.parametrize("joint", ["pan", "lift", "elbow"])
def test_a_joint_moves_as_in_the_whole_arm(tmp_path: Path, joint: str) -> None:
    system = arm(tmp_path).with_component("joint3/load", FloorContact("tip", z_f=-0.36, k_f=300.0))
    data = records_of(system)
    k = joint_number(system, joint)
    one, own = alone(system, k), with_others_measured(data, system, k)
    assert {i.name for i in one.table} <= {i.name for i in system.table}
    batch = make_batch(one, own.records, noise_std={f"q_m{k + 1}": 1e-6})
    found = simulate(one, ENGINE, batch).y[..., 0].numpy()
    for row, record in zip(found, data.records, strict=True):
        measured = record.outputs[f"q_m{k + 1}"]
        assert np.abs(row - measured).max() < 0.01 * np.ptp(measured)


def test_a_joint_that_stands_still_has_no_speed_of_rounding(tmp_path: Path) -> None:
    system = arm(tmp_path)
    (record,) = records_of(system, 1).records
    rng, step = np.random.default_rng(0), 2 * np.pi / 4096  # a servo's encoder
    for held in step * rng.integers(-2000, 2000, 20):
        still = replace(record, outputs={**record.outputs, "q_m3": np.full(record.n_samples, held)})
        (one,) = with_others_measured(replace(records_of(system, 1), records=(still,)), system, 0).records
        assert (one.inputs["speed3"] == 0.0).all() and (one.inputs["acceleration3"] == 0.0).all()


def test_two_joints_move_as_in_the_whole_arm_and_keep_their_names(tmp_path: Path) -> None:
    system = arm(tmp_path)
    data = records_of(system)
    pair, own = some(system, [0, 2]), with_others_measured(data, system, 0, 2)
    assert pair.input_names[:2] == ["goal1", "goal3"] and [c.name for c in own.outputs] == ["q_m1", "q_m3"]
    assert named(pair, "play@joint3/transmission") == "play@elbow/transmission"
    assert named(system, "joint3/motor") == "joint3/motor"
    found = simulate(pair, ENGINE, make_batch(pair, own.records, noise_std={"q_m1": 1e-6, "q_m3": 1e-6})).y
    for row, record in zip(found.numpy(), data.records, strict=True):
        measured = np.stack([record.outputs[name] for name in ("q_m1", "q_m3")], -1)
        assert (np.abs(row - measured).max(0) < 0.01 * np.ptp(measured, axis=0)).all()
    back = together(pair.with_values({"F_c_elbow": 0.07}))
    assert back.parameter("F_c_elbow").spec.value == 0.07 and len(back.joints) == 3


def test_a_joint_alone_gives_the_parameters_that_the_arm_has(tmp_path: Path) -> None:
    truth = arm(tmp_path)
    data = records_of(truth, count=3)
    guess = truth.with_values({i.name: 1.3 * i.spec.value for i in truth.table if i.spec.estimate})
    k = joint_number(truth, "lift")
    study = identify(with_others_measured(data, truth, k), alone(guess, k), pooled=True)
    for name, value in zip(study.names, study.selected.values, strict=True):
        assert value == pytest.approx(truth.parameter(name).spec.value, rel=0.05), name


def test_noise_of_the_others_is_in_the_intervals(tmp_path: Path) -> None:
    truth = arm(tmp_path)
    data = records_of(truth, count=3, noise=3e-4)
    k = joint_number(truth, "lift")
    own, *others = (
        with_others_measured(one, truth, k)
        for one in (data, noisier(data, k, seed=0), noisier(data, k, seed=1))
    )
    assert np.array_equal(others[0].records[0].outputs["q_m2"], own.records[0].outputs["q_m2"])
    bare = identify(own, alone(truth, k), pooled=True)
    study = identify(own, alone(truth, k), pooled=True, noisier=others)
    assert np.array_equal(study.values, bare.values) and bare.input_error is None
    assert (study.standard_errors(0) > bare.standard_errors(0)).all()
    known = np.array([truth.parameter(name).spec.value for name in study.names])
    z = np.abs(study.selected.values - known) / np.array([bare.standard_errors(0), study.standard_errors(0)])
    assert z[0].max() > 2.0 > z[1].max(), z


def test_what_a_joint_alone_lacks_is_said(tmp_path: Path) -> None:
    system = arm(tmp_path)
    data = records_of(system, count=1)
    record = data.records[0]
    blind = Dataset(
        "arm", data.inputs, data.outputs[1:],
        (Record("run", record.time, record.inputs, {n: record.outputs[n] for n in ("q_m2", "q_m3")}),),
    )  # fmt: skip
    with pytest.raises(InputError, match="no angle of joint 'pan'"):
        with_others_measured(blind, system, 1)
    with pytest.raises(
        InputError, match=r"no angle of joint 'pan'; add q_a1 .*hold: {pan: 0.0}.*after it then count"
    ):
        check_angles(blind, system)
    with pytest.raises(InputError, match="no joint 'elbo'"):
        joint_number(system, "elbo")
    with pytest.raises(InputError, match="whole robot"):
        alone(alone(system, 1), 0)


def test_what_two_joints_touch_is_one_floor_at_one_point_and_two_at_two(tmp_path: Path) -> None:
    system = arm(tmp_path)

    def touching(joint: int, point: str, height: float) -> System:
        return alone(system, joint).with_component(f"joint{joint + 1}/load", FloorContact(point, z_f=height))

    def floors(one: System) -> dict[str, float]:
        return {i.component.split("/")[0]: i.spec.value for i in one.table if i.symbol == "z_f"}

    lift, elbow = touching(1, "tip", -0.36), touching(2, "tip", -0.3)
    assert floors(with_drive(with_drive(system, lift), elbow)) == {"joint2": -0.36}
    other = next(name for name in system.tree.points if name != "tip")
    both = with_drive(with_drive(system, lift), touching(2, other, -0.3))
    assert floors(both) == {"joint2": -0.36, "joint3": -0.3}
    with pytest.raises(
        InputError, match="floor_contact at several joints, which none takes by itself; keep one"
    ):
        alone(both, 1)


def test_what_was_found_of_a_joint_goes_back_into_the_robot(tmp_path: Path) -> None:
    system = arm(tmp_path).with_component("joint3/load", FloorContact("tip", z_f=-0.36, k_f=300.0))
    one = alone(system, 1).with_values({"F_c_lift": 0.07, "z_f": -0.3})
    whole = together(one.with_component("joint2/motor_friction", Stribeck(F_drop=0.02, v_s=0.3)))
    assert {i.name: i.spec.value for i in whole.table if i.symbol in ("F_c", "F_drop", "z_f", "k_f")} == {
        "F_c_pan": 0.05, "F_c_lift": 0.07, "F_drop_lift": 0.02, "F_c_elbow": 0.03,
        "z_f_elbow": -0.3, "k_f_elbow": 300.0,
    }  # fmt: skip
    save_model(one, tmp_path / "found.yaml")
    found = load_model(tmp_path / "found.yaml")
    assert found.tree == system.tree
    assert found.parameter("F_c_lift").spec.value == 0.07


def test_a_joint_that_does_not_feel_what_acts_on_all_leaves_what_another_has_found(tmp_path: Path) -> None:
    system = arm(tmp_path).with_component("joint3/load", FloorContact("tip", z_f=-0.36, k_f=300.0))
    lift, elbow = alone(system, 1).with_values({"z_f": -0.3}), alone(system, 2)
    for first, then in ((lift, elbow), (elbow, lift)):
        assert with_drive(with_drive(system, first), then).parameter("z_f_elbow").spec.value == -0.3


def test_a_delay_of_its_own_stays_beside_that_of_all_joints(tmp_path: Path) -> None:
    """Wherever that of all is listed: a joint that lists both would lose one of them."""

    def delays(one: System) -> dict[str, float]:
        return {i.component: i.spec.value for i in one.table if i.symbol == "T_d"}

    system = arm(tmp_path).with_component("joint2/input", Delay(T_d=0.01))
    system = system.with_component("joint3/input", CommonDelay(T_d=0.02))
    expected = {"joint2/input/delay": 0.01, "joint3/input/common_delay": 0.02}
    assert delays(alone(system, 1)) == {"joint2/input/delay": 0.01}
    assert delays(some(system, [1, 2])) == expected
    assert delays(with_drive(system, alone(system, 1))) == expected
    late = alone(system, 2).with_component("joint3/input", Delay(T_d=0.03))
    assert delays(late) == {"joint3/input/delay": 0.03}
    back = delays(with_drive(system, late))
    assert back == {"joint1/input/common_delay": 0.02, "joint2/input/delay": 0.01, "joint3/input/delay": 0.03}


def flexible(folder: Path) -> System:
    """The arm whose lift has a spring in its gear that twists by some hundredths of a radian."""
    return arm(folder).with_component("joint2/transmission", LinearSpring(k=25.0, d=0.05))


@pytest.mark.parametrize("measured", ["q_m2", "q_a2"])
def test_a_hidden_side_of_a_gear_begins_in_motion_where_the_links_wind_it_up(
    tmp_path: Path, measured: str
) -> None:
    system = flexible(tmp_path)
    time, phase = STEP * np.arange(750), np.array([0.3, 1.2, 2.1])
    inputs = {f"goal{j + 1}": 0.4 * np.sin(4.0 * time + phase[j]) - 0.4 * np.sin(phase[j]) for j in range(3)}
    blank = Record("run", time, inputs, {f"q_m{j}": 0.0 * time for j in (1, 2, 3)})
    x = simulate(system, ENGINE, make_batch(system, [blank], noise_std={"q_m1": 1e-6})).x[0].numpy()
    rows = {name: k for k, name in enumerate(system.state_names)}
    seen = {"q_m1": "q_m1", measured: measured, "q_m3": "q_m3"}
    outputs = {name: x[:, rows[state]] for name, state in seen.items()}
    hidden = rows["q_a2" if measured == "q_m2" else "q_m2"]
    twist = x[:, rows["q_a2"]] - x[:, rows["q_m2"]]
    twist = twist if measured == "q_m2" else -twist
    off: dict[str, list[float]] = {"whole": [], "alone": []}
    for first in (60, 120, 260, 350, 430, 600):
        cut = [{n: v[first:] for n, v in channels.items()} for channels in (inputs, outputs)]
        later = Record("later", time[first:] - time[first], *cut)
        data = Dataset("arm", tuple(Channel(n, "rad") for n in inputs),
                       tuple(Channel(n, "rad") for n in outputs), (later,), STEP)  # fmt: skip
        for name, own, one in (
            ("whole", data, system),
            ("alone", with_others_measured(data, system, 1), alone(system, 1)),
        ):
            row = hidden if name == "whole" else 2 * (measured == "q_m2")
            found = make_batch(one, own.records, noise_std={n: 1e-5 for n in own.records[0].outputs}).x
            off[name].append((float(found[0, 0, row]) - x[first, hidden]) / np.sqrt(np.mean(twist**2)))
    for name, errors in off.items():
        assert np.sqrt(np.mean(np.square(errors))) < 0.2, (name, errors)  # 1 without what the links need
