"""Computed torque turns the model round: with the right model the loop does what the design says."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
import torch

from hybrid_id.components import (
    AsymmetricStribeck,
    BacklashFlexibility,
    Dahl,
    EfficiencyLoss,
    ElectricalLag,
    FreeRotor,
    KinematicError,
    LinearSpring,
    LoadDependent,
    LoggedLoad,
    MotorEncoder,
    PositionServo,
    ResidualNetwork,
    Saturation,
    TorqueMotor,
)
from hybrid_id.components.base import Friction
from hybrid_id.control import ComputedTorque, Reference, sines, track
from hybrid_id.errors import InputError
from hybrid_id.simulation.step import Engine
from hybrid_id.systems import System, one_link, one_link_flexible, two_link
from hybrid_id.systems.by_joint import alone
from hybrid_id.systems.model_file import load_model

STEP = 0.004
ARM = """<mujoco><worldbody>
<body quat="0 1 0 0"><joint name="pan" axis="0 0 1" armature="0.02" damping="0.1" frictionloss="0.05"/>
<inertial mass="0.5" pos="0.02 0 0.05" diaginertia="0.001 0.001 0.001"/>
<body pos="0 0 0.1"><joint name="lift" axis="0 1 0" armature="0.015" damping="0.08" frictionloss="0.04"/>
<inertial mass="0.4" pos="0 0 0.1" diaginertia="0.001 0.001 0.0003"/>
<body pos="0 0 0.2"><joint name="elbow" axis="0 1 0" armature="0.01" damping="0.05" frictionloss="0.03"/>
<inertial mass="0.2" pos="0 0 0.08" diaginertia="0.0004 0.0004 0.0001"/></body></body></body>
</worldbody></mujoco>"""
LINK = one_link(156.0, friction=AsymmetricStribeck())
SINE = sines([[(0.3, 1.0)]], duration=1.4, sample_time=STEP, fade=0.5)


class Machine:
    """A system as the plant of its own: no noise, true angles."""

    def __init__(
        self,
        system: System,
        start: float = 0.0,
        substeps: int = 1,
        logged: Mapping[str, np.ndarray] | None = None,
    ) -> None:
        self.system, self.engine = system, Engine(substeps=substeps)
        self.p = system.views(list(system.theta().detach()[:, None]))
        self.x = [torch.zeros(1, dtype=torch.float64) for _ in system.state_names]
        self.x[0] += start
        self.logged, self.k = logged or {}, 0

    @torch.no_grad()
    def measure(self) -> np.ndarray:
        read = [f"q_m{joint.number}" for joint in self.system.joints]
        return np.array([value.numpy() for value in self.system.outputs(read, self.x, {}, self.p)])

    @torch.no_grad()
    def true_angles(self) -> np.ndarray:
        return np.array([joint.link_motion(self.x, self.p)[0].numpy() for joint in self.system.joints])

    @torch.no_grad()
    def step(self, command: np.ndarray) -> None:
        names = [f"{c}{j.number}" for j in self.system.joints for c in j.drive.input[1].channels]
        u = dict(zip(names, torch.as_tensor(command), strict=True))
        u |= {name: torch.as_tensor(values[self.k : self.k + 1]) for name, values in self.logged.items()}
        self.x = self.engine.sample(
            self.system, self.x, u, torch.full((1,), STEP, dtype=torch.float64), self.p
        )
        self.k += 1


def test_reference_derivatives_belong_together() -> None:
    found = sines([[(0.3, 0.7), (0.1, 1.9)]], duration=4.0, sample_time=1e-3)
    for low, high in ((found.angle, found.speed), (found.speed, found.acceleration)):
        np.testing.assert_allclose(np.gradient(low[:, 0], 1e-3)[2:-2], high[2:-2, 0], rtol=1e-3, atol=1e-3)
    assert found.angle[0, 0] == found.speed[0, 0] == found.acceleration[0, 0] == 0.0


def test_right_model_tracks_and_friction_matters() -> None:
    reference = sines([[(0.3, 1.0)]], duration=1.4, sample_time=STEP, fade=0.5)
    errors = {}
    for name, model in {
        "right": LINK,
        "frictionless": LINK.with_values(dict.fromkeys(("f_11", "f_12", "f_21", "f_22", "f_3"), 0.0)),
    }.items():
        control = ComputedTorque(model, reference, bandwidth=30.0, limit=24.0)
        errors[name] = track(control, Machine(LINK), reference, cutoff=1e3).rms.item()
    assert errors["right"] < 1e-3
    assert errors["frictionless"] > 3 * errors["right"]


def test_error_decays_as_designed() -> None:
    smooth = LINK.with_values(dict.fromkeys(("f_11", "f_12", "f_21", "f_22"), 0.0))
    time = STEP * np.arange(100)
    rest = Reference(time, *(np.zeros((100, 1)) for _ in range(3)))
    control = ComputedTorque(smooth, rest, bandwidth=20.0, limit=1e3)
    plant, angles = Machine(smooth, start=1.0), []
    for k in range(100):
        angles.append(plant.measure().item())
        speed = plant.x[1].numpy()[None]
        plant.step(control.command(k, plant.measure(), speed))
    exact = (1.0 + 20.0 * time) * np.exp(-20.0 * time)  # critically damped
    assert np.abs(np.array(angles) - exact).max() < 0.03  # the loop is closed only every 2 ms


def test_two_links_decouple() -> None:
    arm = two_link([156.0, 84.0])
    reference = sines([[(0.2, 0.8)], [(0.3, 1.2)]], duration=1.4, sample_time=STEP, fade=0.5)
    coupled = [n for n in ("P_3", "P_4") if n in {i.name for i in arm.table}]
    rigid = ComputedTorque(arm, reference, bandwidth=25.0, limit=48.0)
    found = track(rigid, Machine(arm), reference, cutoff=1e3)
    assert (found.rms < 2e-3).all()
    assert (np.abs(found.command) < 48.0).all()
    if coupled:
        blind = ComputedTorque(
            arm.with_values(dict.fromkeys(coupled, 0.0)), reference, bandwidth=25.0, limit=48.0
        )
        assert (track(blind, Machine(arm), reference, cutoff=1e3).rms > found.rms).all()


@pytest.fixture
def arm(tmp_path: Path) -> System:
    """A robot of three joints with a description."""
    pytest.importorskip("mujoco")
    (tmp_path / "arm.xml").write_text(ARM)
    (tmp_path / "model.yaml").write_text("robot: {file: arm.xml}\ngear_ratio: [2, 3, 4]\n")
    return load_model(tmp_path / "model.yaml")


def test_three_joints_of_a_description_decouple(arm: System) -> None:
    most = (0.6, 0.4, 0.2)
    swing = [[(0.4, 0.8)], [(0.3, 1.2)], [(0.3, 1.0)]]
    reference = sines(swing, duration=1.4, sample_time=STEP, fade=0.5)
    control = ComputedTorque(arm, reference, bandwidth=25.0, limit=most)
    found = track(control, Machine(arm), reference, cutoff=1e3)
    assert (found.rms < 1e-3).all() and (np.abs(found.command).max((0, 2)) < most).all()
    for name in ("F_v_lift", "J_m_elbow"):  # with a wrong model it is farther off
        wrong = arm.with_values({name: 3.0 * arm.parameter(name).spec.value})
        blind = ComputedTorque(wrong, reference, bandwidth=25.0, limit=most)
        assert track(blind, Machine(arm), reference, cutoff=1e3).rms.max() > 2.0 * found.rms.max()


def test_spring_with_play_is_led() -> None:
    spring = BacklashFlexibility(k=380.16, alpha=0.31, beta=169.34)
    truth = one_link_flexible(156.0, friction=AsymmetricStribeck()).with_component(
        "joint1/transmission", spring
    )
    truth = truth.with_values({"J_m": 1.32e-5, "J_a": 0.09})
    total = 1.32e-5 + 0.09 / 156.0**2
    rigid = LINK.with_values({"J": total})
    reference = sines([[(0.3, 0.5)]], duration=1.4, sample_time=STEP, fade=0.5)
    errors = [
        track(
            ComputedTorque(model, reference, bandwidth=30.0, limit=24.0),
            Machine(truth, substeps=4),
            reference,
            cutoff=1e3,
        ).rms.item()
        for model in (truth, rigid)
    ]
    assert errors[0] < 0.5 * errors[1]


def rms(model: System, plant: System | None = None, **logged: np.ndarray) -> float:
    """Error [rad] with which a model leads a machine, itself by default, along one sine."""
    control = ComputedTorque(model, SINE, bandwidth=30.0, limit=24.0, channels=logged)
    plant = Machine(plant or model, substeps=2, logged=logged)
    return track(control, plant, SINE, cutoff=1e3).rms.item()


def test_a_logged_load_is_none_of_the_commands() -> None:
    loaded = LINK.with_component("joint1/load", LoggedLoad(c_w=1.9))
    assert rms(loaded, w1=5.0 * np.sin(3.0 * SINE.time)) < 1e-3
    for wrong in ({}, {"w1": np.zeros(3)}, {"w1": np.full(len(SINE.time), np.nan)}):
        with pytest.raises(
            InputError, match="reads w1 beside its commands; give channels with 350 finite values"
        ):
            ComputedTorque(loaded, SINE, bandwidth=30.0, limit=24.0, channels=wrong)


@pytest.mark.parametrize("law", [EfficiencyLoss(mu=0.4), LoadDependent(mu=0.4)], ids=lambda law: law.kind)
def test_friction_that_grows_with_torque_is_that_of_the_torque_needed(law: Friction) -> None:
    lossy = LINK.with_component("joint1/motor_friction", law)
    assert rms(lossy) < 1e-3 < rms(LINK, lossy)


def test_the_encoders_zero_is_taken_back() -> None:
    assert rms(LINK.with_component("joint1/sensor", MotorEncoder(offset=0.2 * 156.0))) < 1e-3


def test_an_error_of_the_gear_is_planned_for() -> None:
    even = one_link(20.0, friction=AsymmetricStribeck())
    uneven = even.with_component("joint1/transmission", KinematicError(E_c=0.02, E_s=0.0))
    assert rms(uneven) < 2e-3 < 0.1 * rms(even, uneven)
    steep = even.with_component("joint1/transmission", KinematicError(E_c=0.03, E_s=0.04))
    with pytest.raises(InputError, match="kinematic_error of joint1 turns its link back"):
        rms(steep)
    # behind a spring, too, where the motor leads its link through the uneven gear
    spring = one_link_flexible(50.0)
    wavy = spring.with_component("joint1/transmission", KinematicError(E_c=0.002, E_s=0.0))
    assert rms(wavy) < 1.1 * rms(spring)


@pytest.mark.parametrize("spring", [None, LinearSpring(k=30.0, d=0.05)], ids=["rigid", "spring"])
def test_the_other_joints_motion_is_known(arm: System, spring: LinearSpring | None) -> None:
    elbow, angle = alone(arm, 2), 0.5 * np.sin(7.0 * SINE.time)
    elbow = elbow if spring is None else elbow.with_component("joint3/transmission", spring)
    motion = {"angle": angle, "speed": np.gradient(angle, STEP), "acceleration": -49.0 * angle}
    found = rms(elbow, **{f"{name}{k}": values for name, values in motion.items() for k in (1, 2)})
    assert found < 1e-3
    with pytest.raises(
        InputError, match="reads angle1, speed1, acceleration1, angle2, speed2, acceleration2 "
    ):
        rms(elbow)


def test_lanes_are_variants_of_the_model() -> None:
    reference = sines([[(0.3, 0.5)]], duration=0.5, sample_time=STEP)
    theta = LINK.theta().detach()[:, None].repeat(1, 3)
    theta[[i.name for i in LINK.table].index("J")] *= torch.tensor([0.75, 1.0, 1.25])
    many = ComputedTorque(LINK, reference, bandwidth=30.0, limit=24.0, theta=theta)
    alone = ComputedTorque(LINK, reference, bandwidth=30.0, limit=24.0)
    q, v = np.full((1, 3), 0.2), np.full((1, 3), 5.0)
    found = many.command(100, q, v)
    np.testing.assert_allclose(found[:, 1:2], alone.command(100, q[:, :1], v[:, :1]))
    assert len(set(found.flatten())) == 3


def test_what_cannot_be_turned_round_is_named() -> None:
    reference = sines([[(0.3, 0.5)]], duration=0.5, sample_time=STEP)
    with pytest.raises(InputError, match="moves 1 joints, but the model has 2"):
        ComputedTorque(two_link([156.0, 84.0]), reference, bandwidth=30.0, limit=24.0)
    servo = LINK.with_component("joint1/input", PositionServo()).with_component("joint1/motor", TorqueMotor())
    for undriven in (servo, LINK.with_component("joint1/motor", FreeRotor())):
        with pytest.raises(InputError, match="joint1 is not commanded by a voltage, current or torque"):
            ComputedTorque(undriven, reference, bandwidth=30.0, limit=24.0)
    for signal in ("command", "torque", "transmitted"):
        learnt = LINK.with_component("joint1/motor_friction", ResidualNetwork(inputs=(signal,)))
        with pytest.raises(InputError, match=f"joint1 has a network that reads {signal}, of which"):
            ComputedTorque(learnt, reference, bandwidth=30.0, limit=24.0)
    for where, part in (("input", Saturation()), ("motor", ElectricalLag()), ("motor_friction", Dahl())):
        with pytest.raises(
            InputError, match="joint1 has a delay, a limit, a dead band or a state that remembers"
        ):
            ComputedTorque(
                LINK.with_component(f"joint1/{where}", part), reference, bandwidth=30.0, limit=24.0
            )
