"""The exported MuJoCo model moves as ours does, for every system and every effect that MuJoCo can carry."""

from dataclasses import replace

import numpy as np
import pytest

from hybrid_id.components import (
    AsymmetricFriction,
    AsymmetricStribeck,
    AsymmetricTanh,
    Backlash,
    BacklashFlexibility,
    Cogging,
    ConstantTorque,
    Coulomb,
    Dahl,
    Deadband,
    Delay,
    ElectricalLag,
    HardeningSpring,
    JointFlexibility,
    KinematicError,
    LinkEncoder,
    LoadDependent,
    LuGre,
    MotorEncoder,
    PositionDependent,
    PositionLoop,
    PositionServo,
    QuadraticDrag,
    ResidualNetwork,
    Saturation,
    SensorDelay,
    Spring,
    Stribeck,
    ThermalDerating,
    TorqueCommand,
    TorqueMotor,
    Viscous,
)
from hybrid_id.components.base import Component
from hybrid_id.errors import InputError
from hybrid_id.export.mjcf import to_mjcf
from hybrid_id.export.replay import agreement, free_runs_of, mujoco_replays
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.record import Record
from hybrid_id.statistics.fit import nrmse
from hybrid_id.systems import System, one_link, one_link_flexible, two_link

RATIO = 156.0


def dataset(
    joints: int = 1,
    outputs: tuple[str, ...] = ("q_m1",),
    channel: str = "u",
    size: float = 8.0,
    seconds: float = 1.6,
) -> Dataset:
    """Commands from rest, the outputs all zero: what was measured does not matter to the difference of two models."""
    t = np.arange(0.0, seconds, 0.002)
    inputs = {}
    for n in range(1, joints + 1):
        waves = 0.7 * np.sin(2 * np.pi * (0.8 + 0.2 * n) * t) + 0.5 * np.sin(2 * np.pi * 3.1 * t + n)
        inputs[f"{channel}{n}"] = size * np.where(t < 0.05, 0.0, waves)
    still = {name: np.zeros_like(t) for name in outputs}
    record = Record(name="waves", time=t, inputs=inputs, outputs=still)
    channels = (
        tuple(Channel(n, {"i": "A", "g": "rad", "t": "N m"}.get(n[0], "V")) for n in inputs),
        tuple(Channel(n, "rad/s" if n[0] == "v" else "rad") for n in outputs),
    )
    return Dataset(name="bench", inputs=channels[0], outputs=channels[1], records=(record,))


def apart(system: System, data: Dataset) -> float:
    return max(row.apart for row in agreement(system, to_mjcf(system), data))


def flexible() -> System:
    return one_link_flexible(RATIO, vertical=True).with_values(
        {"J_m": 1e-5, "J_a": 0.25, "k": 300.0, "G_l": 1.0}
    )


def servo(system: System) -> System:
    """The system with a position loop at its joint in the place of a voltage."""
    loop = PositionServo(k_p=30.0, k_d=1.0, tau_max=3.0)
    return system.with_component("joint1/motor", TorqueMotor()).with_component("joint1/input", loop)


SYSTEMS = {
    "one_link": one_link(RATIO),
    "weight": one_link(RATIO, vertical=True).with_values({"G_l": 0.8, "q_0": 0.4}),
    "all_rotor": one_link(RATIO, vertical=True).with_values({"rotor_share": 1.0}),
    "flexible": flexible(),
    "two_link": two_link((100.0, 100.0)),
    "arm_weight": two_link((100.0, 100.0), vertical=True).with_values({"q_0": 0.2}),
    "weightless_second_link": two_link((100.0, 100.0), vertical=True).with_values({"G_l2": 0.0}),
    "uncoupled": two_link((100.0, 100.0)).without_component("joint1/load", "joint_coupling"),
    "uneven": one_link(RATIO, friction=AsymmetricStribeck(f_21=0.012, f_22=0.026)),
}
EFFECTS: dict[str, tuple[str, Component, float]] = {
    "drag": ("motor_friction", QuadraticDrag(F_q=1e-7), 1e-3),
    "stribeck": ("motor_friction", Stribeck(F_drop=0.005, v_s=10.0), 4e-3),
    "dahl": ("motor_friction", Dahl(sigma=0.1), 2e-3),
    "lugre": ("motor_friction", LuGre(sigma_0=0.1, sigma_1=1e-4), 2e-3),
    "link_dry": ("link_friction", Coulomb(F_c=0.5), 1e-3),
    "link_tanh": ("link_friction", AsymmetricTanh(f_a1=0.3, f_a2=0.5), 3e-3),
    "cogging": ("motor", Cogging(T_c=3e-3, T_s=-2e-3, n=8), 1e-3),
    "lag": ("motor", ElectricalLag(T_e=3e-3), 2e-3),
    "heat": ("motor", ThermalDerating(T_w=1.0, c=30.0), 1e-3),
    "limit": ("input", Saturation(V_max=5.0), 1e-3),
    "delay": ("input", Delay(T_d=0.006), 1e-3),
    "spring": ("load", Spring(k_s=2.0, q_s=0.1), 1e-3),
    "bias": ("load", ConstantTorque(T_0=0.3), 1e-3),
}
NEAR_REST: dict[str, tuple[Component, ...]] = {
    "tanh": (AsymmetricTanh(f_a1=0.066, f_a2=0.05),),
    "exponential": (Coulomb(F_c=0.05), Stribeck(F_drop=0.03, v_s=0.1)),
    "cusp": (Coulomb(F_c=0.05), Stribeck(F_drop=0.03, v_s=0.1, p=0.5)),
    "uneven": (
        AsymmetricStribeck(
            f_11=0.05, f_12=0.08, f_13=0.0, f_14=0.1, f_21=0.04, f_22=0.06, f_23=0.0, f_24=0.1, f_3=0.0
        ),
    ),
}
GEARS: dict[str, tuple[Component, float]] = {
    "play": (Backlash(gap=0.01), 5e-3),
    "soft_play": (Backlash(gap=0.01, compliance=1 / 300), 4e-2),
    "hardening": (HardeningSpring(k=100.0, h=1e4, d=0.5), 1e-3),
    "compliance": (JointFlexibility(compliance=1 / 200, zeta=0.1), 1e-3),
    "eq_12": (BacklashFlexibility(), 2e-3),
}
LEFT_OUT: dict[str, tuple[str, Component]] = {
    "dead band": ("input", Deadband()),
    "load": ("motor_friction", LoadDependent()),
    "angle": ("motor_friction", PositionDependent()),
    "constant ratio": ("transmission", KinematicError()),
    "--to torch": ("motor", ResidualNetwork()),
    "in time": ("input", SensorDelay()),
    "whole number": ("motor", Cogging(n=2.5)),
    "has 6 periods per turn there, not 5.9998": ("motor", Cogging(n=5.9998)),
    "motor has one": ("motor", Cogging(n=2.0, T_c2=1e-4, n_2=4.0)),
}


@pytest.mark.parametrize("name", SYSTEMS)
def test_every_system_moves_as_ours(name: str) -> None:
    pytest.importorskip("mujoco")
    system = SYSTEMS[name]
    outputs = ("q_m1", "q_a1", "v_m1") if name == "flexible" else ("q_m1", "q_m2")[: len(system.joints)]
    assert not to_mjcf(system).notes
    assert apart(system, dataset(len(system.joints), outputs)) < (5e-3 if name == "uneven" else 2e-3)


@pytest.mark.parametrize("name", EFFECTS)
def test_effect_is_carried(name: str) -> None:
    pytest.importorskip("mujoco")
    place, part, limit = EFFECTS[name]
    assert apart(one_link(RATIO).with_component(f"joint1/{place}", part), dataset()) < limit


@pytest.mark.parametrize("name", NEAR_REST)
def test_friction_of_a_joint_without_a_gear_is_carried_near_rest(name: str) -> None:
    """Its drag at top speed is a hundred times what a slow motion meets, and no measure of it."""
    pytest.importorskip("mujoco")
    system = one_link(1.0, friction=Viscous(F_v=0.6)).with_values({"J": 0.02})
    system = system.with_component("joint1/motor", TorqueMotor()).with_component(
        "joint1/input", TorqueCommand()
    )
    for law in NEAR_REST[name]:
        system = system.with_component("joint1/motor_friction", law)
    assert not to_mjcf(system).notes
    assert apart(system, dataset(channel="tau", size=0.11, seconds=4.0)) < 2e-2


@pytest.mark.parametrize("name", GEARS)
def test_gear_is_carried(name: str) -> None:
    pytest.importorskip("mujoco")
    part, limit = GEARS[name]
    system = flexible().with_component("joint1/transmission", part)
    assert apart(system, dataset(outputs=("q_m1", "q_a1"))) < limit


def test_delay_of_a_position_loop_holds_back_the_goal_and_not_the_angle() -> None:
    pytest.importorskip("mujoco")
    system = one_link(RATIO).with_component("joint1/input", PositionLoop(duty_per_rad=0.5))
    late = system.with_component("joint1/input", Delay(T_d=0.02))
    exported = to_mjcf(late)
    assert any("delays the goal" in note for note in exported.notes) and " delay=" not in exported.text
    t = np.arange(0.0, 1.0, 0.002)
    goal = 30.0 * np.where(t < 0.05, 0.0, np.sin(2 * np.pi * 1.3 * t))
    inputs = {"goal1": goal, "gain1": np.full_like(t, 0.4), "supply1": np.full_like(t, 12.0)}
    record = Record(name="loop", time=t, inputs=inputs, outputs={"q_m1": np.zeros_like(t)})
    units = ("rad", "1", "V")
    channels = tuple(Channel(name, unit) for name, unit in zip(inputs, units, strict=True))
    data = Dataset(name="bench", inputs=channels, outputs=(Channel("q_m1", "rad"),), records=(record,))
    assert apart(late, data) < 2e-3


def test_a_position_servo_behind_a_compliant_gear_stays_with_the_controller() -> None:
    pytest.importorskip("mujoco")
    system = servo(one_link_flexible(100.0))
    (note,) = to_mjcf(system).notes
    assert "ctrl is the motor's torque [N m]; position_servo (goal) stays with the controller" in note
    assert apart(system, dataset(outputs=("q_m1", "q_a1"), channel="goal", size=0.4)) < 2e-3


@pytest.mark.parametrize("name", ["one_link", "flexible", "servo"])
def test_the_sensors_read_what_the_model_does(name: str) -> None:
    mujoco = pytest.importorskip("mujoco")
    system = servo(one_link(100.0)) if name == "servo" else SYSTEMS[name]
    read: dict[str, list[float]] = {output: [0.0] for output in ("q_m1", "v_m1", "q_a1", "v_a1")}
    channel, size = ("goal", 0.4) if name == "servo" else ("u", 8.0)
    (run,) = free_runs_of(system, dataset(1, tuple(read), channel, size))
    model = mujoco.MjModel.from_xml_string(to_mjcf(system).text)
    data = mujoco.MjData(model)
    for command in run.record.inputs[f"{channel}1"][:-1]:
        data.ctrl[0] = command
        mujoco.mj_step(model, data, 8)
        mujoco.mj_forward(model, data)  # sensors lag a step
        for output, values in read.items():
            values.append(float(data.sensor(output).data[0]))
    for output, values in read.items():
        assert nrmse(run.outputs[output], np.array(values)) < 5e-3, output


def test_friction_that_grows_in_one_direction_says_how_far() -> None:
    uneven = AsymmetricFriction(F_a=0.002, D_a=2e-5)
    notes = to_mjcf(one_link(RATIO).with_component("joint1/motor_friction", uneven)).notes
    assert any("in one direction alone" in note for note in notes), notes
    even = AsymmetricFriction(F_a=0.002, D_a=0.0)
    assert not to_mjcf(one_link(RATIO).with_component("joint1/motor_friction", even)).notes


def test_mujoco_starts_where_the_package_does() -> None:
    pytest.importorskip("mujoco")
    system, data = one_link(RATIO), dataset()
    record = data.records[0]
    rng = np.random.default_rng(0)
    moving = replace(
        record, outputs={"q_m1": 40.0 + 20.0 * record.time + 0.5 * rng.standard_normal(record.time.size)}
    )
    noisy = replace(data, records=(moving,), outputs=(Channel("q_m1", "rad", 0.5),))
    assert apart(system, noisy) < 2e-3


@pytest.mark.parametrize("words", LEFT_OUT)
def test_what_is_left_out_is_said(words: str) -> None:
    place, part = LEFT_OUT[words]
    exported = to_mjcf(one_link(RATIO).with_component(f"joint1/{place}", part))
    assert len(exported.notes) == 1
    assert words in exported.notes[0] and f"joint1/{place}" in exported.notes[0]
    assert exported.notes[0].replace("--", "- -") in exported.text


def test_check_reads_true_angles_through_the_encoders() -> None:
    pytest.importorskip("mujoco")
    system = one_link(RATIO, vertical=True).with_values({"G_l": 0.8, "q_0": 0.4})
    off = system.with_component("joint1/sensor", MotorEncoder(offset=3.0)).with_component(
        "joint1/sensor", LinkEncoder(offset=-0.2)
    )
    assert any("true angles" in note for note in to_mjcf(off).notes)
    assert apart(off, dataset(outputs=("q_m1", "q_a1"))) < 1e-2


def test_arm_that_no_bodies_have_is_refused() -> None:
    system = two_link((100.0, 100.0)).with_values({"P_2": 0.06})
    with pytest.raises(InputError, match="no two bodies"):
        to_mjcf(system)


@pytest.mark.parametrize(
    "system",
    [
        one_link(RATIO, vertical=True).with_values({"G_l": 0.8}),
        one_link(RATIO, vertical=True)
        .with_values({"G_l": 0.8})
        .with_component("joint1/input", Saturation(V_max=1.0)),
        one_link(RATIO).with_component("joint1/motor", ElectricalLag(T_e=3e-3)),
        one_link(RATIO).with_component("joint1/input", Delay(T_d=0.02)),
    ],
    ids=["weight", "limit", "lag", "delay"],
)
def test_motor_that_is_switched_off_runs_free_there_too(system: System) -> None:
    pytest.importorskip("mujoco")
    record = dataset().records[0]
    on = np.where((record.time > 0.5) & (record.time < 1.2), 0.0, 1.0)
    switched = replace(record, name="off", inputs={**record.inputs, "enable1": on})
    data = replace(dataset(), inputs=(Channel("u1", "V"), Channel("enable1", "1")), records=(switched,))
    lags = (
        "joint1/motor/electrical_lag" in system.components
    )  # its current dies out there, and is cut off here
    assert apart(system, data) < (2e-2 if lags else 4e-3)
    there, braked = (
        mujoco_replays(system, to_mjcf(system), free_runs_of(system, one))[0]["q_m1"]
        for one in (data, dataset())
    )
    assert np.abs(there - braked).max() > 0.1 * np.ptp(there), "the switch matters in this record"


def test_play_of_nothing_makes_a_file_that_mujoco_reads() -> None:
    mujoco = pytest.importorskip("mujoco")
    exported = to_mjcf(one_link(100.0).with_component("joint1/transmission", Backlash(gap=0.0)))
    assert mujoco.MjModel.from_xml_string(exported.text).njnt >= 2


def test_motor_without_back_emf_is_refused() -> None:
    with pytest.raises(InputError, match="P_m2 is 0, but MuJoCo's dcmotor needs a back-EMF"):
        to_mjcf(one_link(100.0).with_values({"P_m2": 0.0}))


def test_a_spring_that_is_too_stiff_for_mujocos_step_is_told() -> None:
    pytest.importorskip("mujoco")
    stiff = one_link_flexible(RATIO).with_values({"k": 5e7, "d": 0.0, "J_a": 1e-3})
    with pytest.raises(InputError, match="unstable in MuJoCo on record"):
        mujoco_replays(stiff, to_mjcf(stiff), free_runs_of(stiff, dataset(seconds=0.1)))
