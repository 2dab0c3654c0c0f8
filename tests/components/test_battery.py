"""One battery that every component of the registry passes, a new one without a line of its own."""

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import cast

import pytest
import torch
from drives import STEP
from torch import Tensor

from hybrid_id.components import PLACES, REGISTRY
from hybrid_id.components.base import (
    Attached,
    CommandMap,
    Component,
    Coupling,
    Friction,
    Inertia,
    Input,
    LoadTorque,
    LoggedTorque,
    LoopStage,
    Motor,
    RotorTorque,
    Sensor,
    Shared,
    Transmission,
    Winding,
)
from hybrid_id.components.bristle import Bristle, relax
from hybrid_id.components.input.delay import DeadTime
from hybrid_id.components.input.position_servo import PositionServo
from hybrid_id.components.input.torque_command import TorqueCommand
from hybrid_id.components.load.base_tilt import BaseTilt
from hybrid_id.components.load.body_inertia import BodyInertia
from hybrid_id.components.load.floor_contact import FloorContact
from hybrid_id.components.load.gravity_compensation import GravityCompensation
from hybrid_id.components.load.payload import Payload
from hybrid_id.components.load.rotor_inertia import RotorInertia
from hybrid_id.components.residual import ResidualNetwork
from hybrid_id.components.sensor.sensor_delay import SensorDelay
from hybrid_id.components.sensor.torque_lag import TorqueLag
from hybrid_id.components.transmission.flexibility import JointFlexibility
from hybrid_id.components.transmission.kinematic_error import KinematicError
from hybrid_id.errors import InputError
from hybrid_id.parameters import Bounded
from hybrid_id.robots.tree import Body, Point, RigidBodyTree, SpatialInertia, TreeJoint
from hybrid_id.simulation.step import Engine
from hybrid_id.systems import System, one_link, one_link_flexible, two_link
from hybrid_id.systems.builders import robot

DIRECTED = {"asymmetric_friction", "asymmetric_stribeck", "asymmetric_stribeck_eq8", "asymmetric_tanh"}
"""Friction laws that claim to differ with the direction of motion; every other one is odd in the speed."""

CHANNELS = {
    "u": 6.0,
    "duty": 0.4,
    "supply": 12.0,
    "goal": 0.5,
    "gain": 400.0,
    "tau": 0.05,
    "i": 0.7,
    "w": 0.2,
}
"""A value for every input channel that a component may read."""

UNIT = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
LINK = SpatialInertia.about_centre(
    0.5, (0.1, 0.0, 0.0), ((0.01, 0.0, 0.0), (0.0, 0.01, 0.0), (0.0, 0.0, 0.01))
)
TREE = RigidBodyTree(
    (TreeJoint("a", "hinge", -1, UNIT, (0.0,) * 3), TreeJoint("b", "hinge", 0, UNIT, (0.3, 0.0, 0.0))),
    (Body("one", 0, UNIT, (0.0,) * 3, LINK), Body("two", 1, UNIT, (0.0,) * 3, LINK)),
    points={"tip": Point(1, (0.3, 0.0, 0.0))},
)

SPEED = torch.tensor([-300.0, -20.0, -0.3, 0.0, 0.2, 15.0, 90.0, 800.0], dtype=torch.float64)
LANES = len(SPEED)
ANGLE = torch.linspace(-2.0, 3.0, LANES, dtype=torch.float64)
OFF, ON = torch.zeros(LANES, dtype=torch.float64), torch.ones(LANES, dtype=torch.float64)


def of(base: type[Component]) -> pytest.MarkDecorator:
    """Every component of a family that the package brings; other tests may register their own."""
    own = {k: c for k, c in REGISTRY.items() if c.__module__.startswith("hybrid_id.")}
    return pytest.mark.parametrize("kind", sorted(k for k, c in own.items() if issubclass(c, base)))


kinds, frictions, bristles = of(Component), of(Friction), of(Bristle)


def made(kind: str) -> Component:
    """A component with limits that the probing signals reach, and at a point that the robot has."""
    if kind == PositionServo.kind:
        return PositionServo(tau_max=6.0, goal_min=0.2, goal_max=0.31)
    attached = {
        "floor_contact": ("tip", {"z_f": 0.05}),
        "payload": ("tip", {"x_l": 0.1}),
        "body_inertia": ("two", {}),
    }
    if kind in attached:
        point, values = attached[kind]
        return cast(type[Attached], REGISTRY[kind])(point, **values)
    return REGISTRY[kind]()


def answers(part: Component, p: SimpleNamespace, lanes: slice = slice(None)) -> dict[str, Tensor]:
    """All that a component contributes at the probing signals, by method."""
    v, q, one, zero = SPEED[lanes], ANGLE[lanes], ON[lanes], OFF[lanes]
    found: dict[str, Tensor | None] = {}
    if isinstance(part, Friction):
        found["smooth"] = part.smooth(p, v)
        found["dry forward"] = part.dry(p, v.abs(), one)
        found["dry backward"] = part.dry(p, v.abs(), zero)
        found["load_factor"] = part.load_factor(p)
        found["effort_factor"] = part.effort_factor(p)
        found["over the angle"] = part.dry_over(p, q)
    if isinstance(part, Bristle):
        state, level = 0.01 * torch.cos(q), 0.02 + 0.01 * torch.sin(q)
        states = [state / len(part.states)] * len(part.states)
        for name, own, pair in zip(part.states, states, part.state_updates(p, states, v, level), strict=True):
            found[f"drive of {name}"], found[f"rate of {name}"] = pair
            found[f"advance of {name}"] = relax(own, *pair, STEP * one)
        found["bristle torque"] = part.torque(p, states, v, level)
    if isinstance(part, Input):
        channels = {name: CHANNELS[name] * (0.5 + 0.1 * q) for name in part.channels}
        found["command"] = part.command(p, channels, 0.3 * q, v)
    if isinstance(part, DeadTime):
        found["held"] = part.held(p, [torch.sin(q + k) for k in range(4)], 0.002 * one)
    if isinstance(part, TorqueLag):
        found["drive"], found["rate"], _, _ = part.state_update(p, 0.1 * torch.cos(q))
    if isinstance(part, SensorDelay):
        found["drive"], found["rate"] = part.state_update(p, v)
        found["angle"], found["speed"] = part.motion(p, q, v, 0.1 * one)
    if isinstance(part, LoopStage):
        state, aim = 0.3 * torch.cos(q), 0.4 * torch.sin(q)
        went = part.state_update(p, aim, aim - 0.2 * q, v, state)
        bounds = {"low": went.low, "high": went.high}
        found |= {name: None if value is None else value * one for name, value in bounds.items()}
        found["drive"], found["rate"] = went.drive, went.rate
        found["angle"], found["speed"] = part.reading(p, q, v, state)
        found["goal"], found["integral"] = part.goal(p, aim, state), part.integral(p, state)
        found["start"] = part.start(p, aim, v)
    if isinstance(part, KinematicError):
        found["error"], found["slope"], found["bend"] = part.error(p, q)
    if isinstance(part, CommandMap):
        found["command"] = part.map(p, 12.0 * torch.sin(q) ** 5, v)
    if isinstance(part, RotorTorque):
        found["torque"] = part.torque(p, q, v)
    if isinstance(part, Winding):
        states = [0.1 * one for _ in part.states]
        found["torque"] = part.torque(p, 0.1 * torch.cos(q), states)
        for name, pair in zip(part.states, part.state_updates(p, 0.1 * torch.cos(q), states), strict=True):
            found[f"drive of {name}"], found[f"rate of {name}"] = pair
    if isinstance(part, FloorContact):
        found["force"] = part.force(p, 0.1 * q)
    if isinstance(part, Payload):
        mass, centre = part.mass(p)
        found |= {"mass": mass * one} | {
            f"centre {axis}": c * one for axis, c in zip("xyz", centre, strict=True)
        }
    if isinstance(part, BaseTilt):
        found |= {f"gravity {i}": e for i, e in enumerate(part.gravity(p, (0.0, 0.0, -9.81)))}
    if isinstance(part, GravityCompensation):
        found["share"] = p.c_g * one
    if isinstance(part, BodyInertia):
        found["mass"] = p.c_m * one
        found |= {f"shift {axis}": c * one for axis, c in zip("xyz", part.shift(p), strict=True)}
        found |= {
            f"stretch {i}{j}": e * one for i, row in enumerate(part.stretch(p)) for j, e in enumerate(row)
        }
    if isinstance(part, ResidualNetwork):
        found["output"] = part.output(p, [v], [])
    if isinstance(part, Motor):
        found["torque"] = part.torque(p, 5.0 * q, v)
        if type(part).current is not Motor.current:
            found["current"] = part.current(p, 0.1 * torch.cos(q))
    if isinstance(part, Transmission) and not part.rigid:
        found["torque"] = part.torque(p, 0.01 * q, 1e-3 * v, 0.05 * one)
        found["loaded"] = part.loaded(p)
    if isinstance(part, Inertia):
        found |= {"rotor": part.rotor(p, 50.0) * one, "link": part.link(p, 50.0) * one}
    if isinstance(part, Coupling):
        found["first"], found["second"] = part.torques(p, (q, -0.7 * q), (0.1 * v, -0.2 * v))
        found["M_11"], found["M_12"] = part.inertia(p, q) or (None, None)
    if isinstance(part, LoadTorque):
        found["torque"] = part.torque(p, q, v)
    if isinstance(part, LoggedTorque):
        found["torque"] = part.torque(p, {name: CHANNELS[name] * (0.5 + 0.1 * q) for name in part.channels})
    if isinstance(part, Sensor):
        found["reading"] = part.read(p, q)
    return {name: value * one for name, value in found.items() if value is not None}


def lane_values(part: Component) -> dict[str, Tensor]:
    """Values that differ from lane to lane, inside the bounds, around its own."""
    factors = torch.linspace(0.7, 1.3, LANES, dtype=torch.float64)
    found = {}
    for i, (name, d) in enumerate(part.declared.items()):
        own = part.specs[name].value
        moved = own * factors.roll(i) if own else 0.1 * (factors.roll(i) - 1.0)
        found[name] = moved.clamp(d.lower, d.upper)
    return found


@kinds
def test_describes_itself(kind: str) -> None:
    part = REGISTRY[kind]
    assert part.kind == kind
    assert part.places and set(part.places) <= set(PLACES)
    assert part.__doc__ and len(part.__doc__.strip()) > 20
    for name, declared in part.declared.items():
        assert declared.unit and declared.doc, f"{name} has no unit or no meaning"
        assert declared.lower <= declared.default <= declared.upper
        assert not hasattr(part, name), "a class attribute would hide the torch parameter"


@kinds
def test_is_float64_and_contributes(kind: str) -> None:
    part = made(kind)
    assert all(value.dtype == torch.float64 for value in part.parameters())
    found = answers(part, part.view())
    assert found or getattr(part, "rigid", False), "the component does nothing"
    for name, value in found.items():
        assert value.dtype == torch.float64, name
        assert value.shape == (LANES,), name
        assert torch.isfinite(value).all(), name


@kinds
def test_batched_equals_looped(kind: str) -> None:
    part = made(kind)
    values = lane_values(part)
    together = answers(part, SimpleNamespace(**values))
    for lane in range(LANES):
        alone = answers(
            part, SimpleNamespace(**{n: v[lane : lane + 1] for n, v in values.items()}), slice(lane, lane + 1)
        )
        for name, value in alone.items():
            torch.testing.assert_close(value[0], together[name][lane], rtol=1e-14, atol=0.0)


@kinds
def test_every_parameter_reaches_the_equation(kind: str) -> None:
    part = made(kind)
    values = {n: v.requires_grad_() for n, v in lane_values(part).items()}
    found = answers(part, SimpleNamespace(**values))
    for name, value in values.items():
        grads = [
            g
            for answer in found.values()
            if answer.requires_grad
            for g in torch.autograd.grad(answer.sum(), value, retain_graph=True, allow_unused=True)
            if g is not None
        ]
        assert any(bool((g != 0).any()) for g in grads), f"{kind}.{name} has a zero gradient everywhere"
        assert all(bool(torch.isfinite(g).all()) for g in grads), (
            f"{kind}.{name} has a gradient that is no number"
        )


@frictions
def test_gradient_to_the_speed_is_finite_at_rest(kind: str) -> None:
    part = made(kind)
    assert isinstance(part, Friction)
    v = torch.zeros(3, dtype=torch.float64, requires_grad=True)
    one = torch.ones_like(v)
    found = [part.smooth(part.view(), v), part.dry(part.view(), v.abs(), one)]
    if isinstance(part, Bristle):
        states = [0.01 * one / len(part.states)] * len(part.states)
        pairs = part.state_updates(part.view(), states, v, 0.02 * one)
        found += [relax(own, *pair, STEP * one) for own, pair in zip(states, pairs, strict=True)]
        found += [part.torque(part.view(), states, v, 0.02 * one)]
    for value in found:
        if value is not None and value.requires_grad:
            grads = torch.autograd.grad(value.sum(), v, allow_unused=True)
            assert all(g is None or bool(torch.isfinite(g).all()) for g in grads)


@frictions
def test_friction_is_odd_and_dissipates(kind: str) -> None:
    part = made(kind)
    assert isinstance(part, Friction)
    p, forward = part.view(), (SPEED > 0).to(SPEED.dtype)
    smooth, dry = part.smooth(p, SPEED), part.dry(p, SPEED.abs(), forward)
    if smooth is not None:
        assert (smooth * SPEED >= 0).all()
        if kind not in DIRECTED:
            torch.testing.assert_close(part.smooth(p, -SPEED), -smooth)
    if dry is not None:
        assert (dry >= 0).all()
        if kind not in DIRECTED:
            torch.testing.assert_close(part.dry(p, SPEED.abs(), 1.0 - forward), dry)
    for factor in (part.load_factor(p), part.effort_factor(p)):
        assert factor is None or bool((factor >= 0).all())
    if isinstance(part, Bristle):
        level = 0.02 + 0.01 * torch.sin(ANGLE)
        states = [0.01 * torch.cos(ANGLE) / len(part.states)] * len(part.states)
        turned = [-state for state in states]
        torch.testing.assert_close(
            part.torque(p, turned, -SPEED, level), -part.torque(p, states, SPEED, level)
        )
        for back, forth in zip(
            part.state_updates(p, turned, -SPEED, level),
            part.state_updates(p, states, SPEED, level),
            strict=True,
        ):
            torch.testing.assert_close(back[0], -forth[0])
            torch.testing.assert_close(back[1], forth[1])


@bristles
@torch.no_grad()
def test_bristle_takes_energy_over_a_cycle(kind: str) -> None:
    part = made(kind)
    assert isinstance(part, Bristle)
    p, step = part.view(), 1e-3
    level = torch.full((1,), 0.02, dtype=torch.float64)
    states, energy, cycles = [torch.zeros(1, dtype=torch.float64)] * len(part.states), 0.0, []
    for k in range(4000):
        v = torch.tensor([0.5 * math.sin(2 * math.pi * k * step)], dtype=torch.float64)
        pairs = part.state_updates(p, states, v, level)
        states = [
            relax(own, *pair, torch.full_like(v, step)) for own, pair in zip(states, pairs, strict=True)
        ]
        energy += float(part.torque(p, states, v, level) * v) * step
        if k % 1000 == 999:
            cycles.append(energy)
    assert all(b > a for a, b in zip([0.0, *cycles], cycles, strict=False))


@bristles
@torch.no_grad()
def test_exact_update_follows_the_rate(kind: str) -> None:
    part = made(kind)
    assert isinstance(part, Bristle)
    p, steps = part.view(), 20000
    v = torch.tensor([-2.0, 0.3, 5.0], dtype=torch.float64)
    level, stiff = torch.full_like(v, 0.02), []
    starts = [torch.full_like(v, 0.004 / len(part.states))] * len(part.states)
    for start, (drive, rate) in zip(starts, part.state_updates(p, starts, v, level), strict=True):
        state = start
        for _ in range(steps):  # Euler in steps of 1 microsecond
            state = state + 1e-6 * (drive - rate * state)
        exact = relax(start, drive, rate, torch.full_like(v, 1e-6 * steps))
        torch.testing.assert_close(exact, state, rtol=2e-4, atol=1e-7)
        stiff.append(relax(start, drive, rate, torch.full_like(v, 1e6)))
    torch.testing.assert_close(part.torque(p, stiff, v, level), level * v.sign())


@kinds
def test_state_dict_round_trip(kind: str) -> None:
    cls = REGISTRY[kind]
    moved = {n: float(v[1]) for n, v in lane_values(cls()).items()}
    source, target = cls(**moved), cls()
    target.load_state_dict(source.state_dict())
    for name, value in moved.items():
        assert getattr(target, name).item() == value
        assert target.specs[name].value == value, "the specification must say what is stored"


@kinds
def test_refuses_what_is_out_of_bounds(kind: str) -> None:
    cls = REGISTRY[kind]
    with pytest.raises(InputError, match="no parameter 'nonsense'"):
        cls(nonsense=1.0)
    for name, declared in cls.declared.items():
        bad: list[float | Bounded] = [math.nan, math.inf, Bounded(1.0, lower=2.0, upper=0.0)]
        bad += [declared.lower - 1.0] if math.isfinite(declared.lower) else []
        bad += [2.0 * declared.upper + 1.0] if math.isfinite(declared.upper) else []
        for value in bad:
            with pytest.raises(InputError, match=name) as caught:
                cls(**{name: value})
            assert "\n" not in str(caught.value)


def hosts(part: Component, place: str) -> list[Callable[[], System]]:
    """Systems into which a component fits."""
    arm = [lambda: two_link((50.0, 30.0))]
    if isinstance(part, RotorInertia | Shared):
        robots = [lambda: robot(TREE, (50.0, 30.0)).with_component("joint2/input", TorqueCommand())]
        return [
            *robots,
            lambda: robots[0]().with_component("joint1/transmission", JointFlexibility(compliance=1e-3)),
        ]
    if isinstance(part, Coupling | Inertia):
        arm = [lambda: two_link((50.0, 30.0)).without_component("joint1/load", "joint_coupling")]
    if isinstance(part, Coupling):
        return arm
    if getattr(part, "rigid", False):
        return [lambda: one_link(50.0), *arm]
    if isinstance(part, ResidualNetwork) and place == "transmission":
        return [lambda: one_link_flexible(50.0)]
    return [lambda: one_link(50.0), lambda: one_link_flexible(50.0), *arm]


@kinds
def test_runs_in_every_place_that_it_claims(kind: str) -> None:
    part = made(kind)
    channels = {
        f"{name}{n}": torch.full((3,), value, dtype=torch.float64)
        for name, value in CHANNELS.items()
        for n in (1, 2)
    }
    for place in part.places:
        for host in hosts(part, place):
            system = host().with_component(f"joint1/{place}", part)
            assert all(f"{name}1" in system.input_names for name in getattr(part, "channels", ()))
            p = system.views(list(system.theta().detach()[:, None]))
            dt = torch.full((3,), 0.001, dtype=torch.float64)
            channels |= {f"step{joint.number}": dt for joint in system.joints}
            for name, lags in [past for joint in system.joints for past in joint.drive.past(0.001).items()]:
                channels |= {f"{name}@{k}": channels[name] for k in range(1, lags + 1)}
            for engine in (Engine("dry", 2), Engine("smooth", 20)):
                x = [torch.zeros(3, dtype=torch.float64) for _ in system.state_names]
                for _ in range(3):
                    x = engine.sample(system, x, channels, dt, p)
                assert all(bool(torch.isfinite(row).all()) for row in x), (place, engine)
                rounding = (
                    1e-9 if isinstance(part, ResidualNetwork) else 0.0
                )  # of a matrix product, lane by lane
                assert all(bool(((row - row[0]).abs() <= rounding * row[0].abs()).all()) for row in x)
