"""One joint: input, motor, friction, gear, load and sensors, as torque balances of its speeds."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import cast

from torch import Tensor

from hybrid_id.components.base import (
    REGISTRY,
    CommandMap,
    Component,
    Friction,
    Inertia,
    Input,
    LoadTorque,
    LoggedTorque,
    LoopStage,
    Motor,
    RotorTorque,
    Sensor,
    ServoLoop,
    StateUpdate,
    Transmission,
    Winding,
)
from hybrid_id.components.bristle import Bristle
from hybrid_id.components.input.delay import DeadTime, Delay
from hybrid_id.components.load.rotor_inertia import RotorInertia
from hybrid_id.components.sensor.sensor_delay import SensorDelay
from hybrid_id.components.sensor.torque_lag import TorqueLag
from hybrid_id.components.transmission.kinematic_error import KinematicError
from hybrid_id.errors import InputError
from hybrid_id.systems.balance import Channels, Rows, SpeedBalance, Views
from hybrid_id.systems.networks import LINK_PLACES, Networks


def sum_if_any(terms: Sequence[Tensor | None]) -> Tensor | None:
    """Sum of the terms that are there; None where there is none."""
    found = [t for t in terms if t is not None]
    return sum(found[1:], found[0]) if found else None


def sum_of(terms: Sequence[Tensor | None], like: Tensor) -> Tensor:
    """The same with a single zero, which costs nothing to add, where there is none."""
    found = sum_if_any(terms)
    return like.new_zeros(1) if found is None else found


def _has(law: Friction, *terms: str) -> bool:
    """Whether a law of friction brings one of these terms."""
    return any(getattr(type(law), term) is not getattr(Friction, term) for term in terms)


def only(parts: Mapping[str, Component], kind: type, joint: str, what: str) -> tuple[str, Component]:
    """Key and component of the one of its kind; InputError where there is none or more."""
    found = [(key, part) for key, part in parts.items() if isinstance(part, kind)]
    if len(found) != 1:
        raise InputError(f"{joint} has {len(found)} components of type {what}; it needs exactly one.")
    return found[0]


class Gear:
    """Transmission and kinematic errors.

    Args:
        joint: name of the joint, for messages.
        ratio: motor turns per joint turn.
        parts: the joint's components by key.

    Raises:
        InputError: not exactly one transmission.
    """

    def __init__(self, joint: str, ratio: float, parts: Mapping[str, Component]) -> None:
        self.ratio = ratio
        found = only(parts, Transmission, joint, "transmission")
        self.transmission = cast("tuple[str, Transmission]", found)
        self.errors = [(key, part) for key, part in parts.items() if isinstance(part, KinematicError)]
        self.rigid = found[1].rigid  # type: ignore[attr-defined]

    def map(self, angle: Tensor, p: Views) -> tuple[Tensor, Tensor | float, Tensor | None]:
        """Angle of the link behind an unloaded gear [rad], its slope and its curvature over the rotor's angle.

        A gear without kinematic error has the slope 1/r everywhere and no curvature.
        """
        link, slope, curvature = angle / self.ratio, 1.0 / self.ratio, None
        for key, part in self.errors:
            value, first, second = part.error(p[key], angle)
            link, slope, curvature = (
                link + value,
                slope + first,
                second if curvature is None else curvature + second,
            )
        return link, slope, curvature

    def deflection(self, rotor: Rows, link: Rows, p: Views) -> list[Tensor]:
        """Deflection of a compliant gear [rad] and its rate [rad/s] from angle and speed of both sides."""
        angle, slope, _ = self.map(rotor[0], p)
        return [angle - link[0], rotor[1] * slope - link[1]]

    def torque(self, rotor: Rows, link: Rows, inertia: tuple[str, Inertia], p: Views) -> Tensor:
        """Torque of a compliant gear's spring at the link [N m], ``(B,)``."""
        (key, part), (spring_key, spring) = inertia, self.transmission
        deflection, rate = self.deflection(rotor, link, p)
        return spring.torque(p[spring_key], deflection, rate, part.in_series(p[key], self.ratio))

    def loaded(self, angle: Tensor, p: Views) -> Tensor | None:
        """Angle of the link [rad] with the spring fully loaded, None where zero load will do."""
        key, spring = self.transmission
        deflection = None if self.rigid else spring.loaded(p[key])
        return None if deflection is None else self.map(angle, p)[0] - deflection


class SensorDynamics:
    """Sensors of a joint.

    Args:
        number: joint number, from 1.
        parts: the joint's components by key, in their order.
        rotor: row of the rotor's angle in the system's state; its speed is the next.
        first_row: row of the first state that the readings own.

    Attributes:
        state_names: of the states that they own.
    """

    def __init__(self, number: int, parts: Mapping[str, Component], rotor: int, first_row: int) -> None:
        self.rotor, self.row = rotor, first_row
        self.sensors = cast(
            "list[tuple[str, Sensor]]", [(k, part) for k, part in parts.items() if isinstance(part, Sensor)]
        )
        self.late = next(((k, part) for k, part in parts.items() if isinstance(part, SensorDelay)), None)
        self.state_names = [f"{name}{number}" for name in self.late[1].states] if self.late else []
        self.lag = next(((k, part) for k, part in parts.items() if isinstance(part, TorqueLag)), None)
        self.lag_row = first_row + len(self.state_names)
        self.state_names += [f"{name}{number}" for name in self.lag[1].states] if self.lag else []

    def read(self, channel: str, value: Tensor, seen: float, x: Rows, p: Views) -> Tensor:
        """What is read where a channel (``q_m``, ``v_a`` ...) has a true value, ``(B,)``.

        Args:
            channel: without the joint's number.
            value: what it would read in time and at the model's zero.
            seen: what it turns for one turn of the motor, whose encoder measures it; 0 where that does not.
            x: state rows.
            p: parameter views.
        """
        if self.late is not None and seen:
            key, part = self.late
            angle, speed = x[self.rotor], x[self.rotor + 1]
            late = part.motion(p[key], angle, speed, x[self.row])
            value = value + seen * (late[channel[0] == "v"] - (angle, speed)[channel[0] == "v"])
        if self.lag is not None and channel == "tau_a":
            value = x[self.lag_row]
        for key, sensor in self.sensors:
            if sensor.channel == channel:
                value = sensor.read(p[key], value)
        return value

    def state_updates(self, x: Rows, p: Views) -> list[tuple[int, StateUpdate]]:
        """Row of each state, and how it goes on."""
        if self.late is None:
            return []
        key, part = self.late
        return [(self.row, StateUpdate(*part.state_update(p[key], x[self.rotor + 1])))]


class Drive:
    """Input, motor and what acts beside them.

    Args:
        number: joint number, from 1.
        parts: the joint's components by key, in their order.
        rotor: row of the rotor's angle in the system's state; its speed is the next.
        first_row: row of the first state that the drive owns.
        ratio: motor turns per joint turn.
        link: gives angle [rad] and speed [rad/s] behind the gear from state rows and parameter views.

    Attributes:
        state_names: of the states that it owns.
        networks: of the joint; those at its places act beside the components.

    Raises:
        InputError: no input or no motor.
    """

    def __init__(
        self,
        number: int,
        parts: Mapping[str, Component],
        rotor: int,
        first_row: int,
        ratio: float,
        link: Callable[[Rows, Views], tuple[Tensor, Tensor]],
    ) -> None:
        joint = f"joint{number}"
        self.number, self.rotor, self.ratio, self.link = number, rotor, ratio, link
        self.networks: Networks | None = None
        self.input = cast("tuple[str, Input]", only(parts, Input, joint, "input"))
        self.motor = cast("tuple[str, Motor]", only(parts, Motor, joint, "motor"))
        read = "q_a" if self.input[1].at_joint else "q_m"
        sensors = [(k, c) for k, c in parts.items() if isinstance(c, Sensor) and c.channel == read]
        self.encoders = [(k, c) for k, c in sensors if c.in_loop]
        own = ((key, part) for key, part in parts.items() if isinstance(part, Delay))
        self.delay: tuple[str, DeadTime] | None = next(own, None)
        maps = [(key, part) for key, part in parts.items() if isinstance(part, CommandMap)]
        self.maps = sorted(maps, key=lambda item: item[1].stage)
        self.torques = [(key, part) for key, part in parts.items() if isinstance(part, RotorTorque)]
        self.windings: list[tuple[str, Winding, range]] = []
        self.state_names: list[str] = []
        for key, part in parts.items():
            if isinstance(part, Winding):
                row = first_row + len(self.state_names)
                self.windings.append((key, part, range(row, row + len(part.states))))
                self.state_names += [f"{state}{number}" for state in part.states]
        self.stages: list[tuple[str, LoopStage, int]] = []
        for key, part in parts.items():
            if isinstance(part, LoopStage):
                self.stages.append((key, part, first_row + len(self.state_names)))
                self.state_names += [f"{state}{number}" for state in part.states]

    def check(self) -> None:
        """Raise InputError where the input gives not what the motor takes, or closes no loop that has stages."""
        joint, source, motor = f"joint{self.number}", self.input[1], self.motor[1]
        if self.stages and not isinstance(source, ServoLoop):
            loops = [k for k, c in REGISTRY.items() if issubclass(c, ServoLoop)]
            raise InputError(
                f"{self.stages[0][1].kind} at {joint}/input belongs to a position loop, which {source.kind} is not; "
                f"put {' or '.join(sorted(loops))} there, or remove it."
            )
        if motor.takes and source.gives != motor.takes:
            fits = sorted(k for k, c in REGISTRY.items() if issubclass(c, Motor) and c.takes == source.gives)
            inputs = sorted(k for k, c in REGISTRY.items() if issubclass(c, Input) and c.gives == motor.takes)
            raise InputError(
                f"{source.kind} at {joint}/input gives {source.gives}, but {motor.kind} at {joint}/motor takes "
                f"{motor.takes}; put {' or '.join(inputs)} at the input, or {' or '.join(fits)} at the motor."
            )

    def past(self, sample_time: float) -> dict[str, int]:
        """Channels whose past the drive needs, and how many samples of it."""
        if self.delay is None:
            return {}
        lags = self.delay[1].lags(sample_time)
        return {f"{name}{self.number}": lags for name in self.input[1].channels}

    def hold(self, u: Channels, p: Views) -> Channels:
        """Channels as they arrive after the delay; without one, or where that has been done before, as they are."""
        done, step = f"arrived{self.number}", f"step{self.number}"
        if self.delay is None or done in u:
            return u
        if step not in u:
            raise InputError(
                f"joint{self.number} has a delay, but its channels have no past; prepare them as a batch."
            )
        key, part = self.delay
        arrived = {**u, done: u[step]}
        for name in (f"{c}{self.number}" for c in self.input[1].channels):
            history = [u[name], *(u[f"{name}@{k}"] for k in range(1, len(u)) if f"{name}@{k}" in u)]
            arrived[name] = part.held(p[key], history, u[step])
        return arrived

    def command(self, x: Rows, u: Channels, p: Views, *, network: bool = True) -> Tensor:
        """Effective command at the motor, ``(B,)``; without what a network adds where ``network`` is false."""
        key, part = self.input
        channels, angle, speed = self._seen(x, self.hold(u, p), p)
        command = part.command(p[key], channels, angle, speed)
        if part.at_joint:
            command = command / self.ratio
        for key, step in self.maps:
            command = step.map(p[key], command, x[self.rotor + 1])
        added = self._added("input", x, u, p) if network else None
        return command if added is None else command + added

    def _motion(self, x: Rows, p: Views) -> tuple[Tensor, Tensor]:
        """Angle [rad] and speed [rad/s] of the side that the input reads, ``(B,)`` each."""
        return self.link(x, p) if self.input[1].at_joint else (x[self.rotor], x[self.rotor + 1])

    def _seen(self, x: Rows, u: Channels, p: Views) -> tuple[dict[str, Tensor], Tensor, Tensor]:
        """Channels, angle and speed as the input sees them, what the stages of a position loop do included."""
        part = self.input[1]
        channels = {name: u[f"{name}{self.number}"] for name in part.channels}
        angle, speed = self._motion(x, p)
        for name, encoder in self.encoders:  # a position loop compares its goal with what it reads
            angle = encoder.read(p[name], angle)
        if isinstance(part, ServoLoop):
            for name, stage, row in self.stages:
                angle, speed = stage.reading(p[name], angle, speed, x[row])
                channels["goal"] = stage.goal(p[name], channels["goal"], x[row])
                if (integral := stage.integral(p[name], x[row])) is not None:
                    channels["integral"] = integral
        return channels, angle, speed

    def starts(self, x: Rows, u: Channels, p: Views) -> dict[int, Tensor]:
        """By their rows, states of the position loop's stages after a long time at goal and speed."""
        key, part = self.input
        if not self.stages or not isinstance(part, ServoLoop):
            return {}
        aim = part.aim(p[key], {"goal": self.hold(u, p)[f"goal{self.number}"]})
        speed = self._motion(x, p)[1]
        return {row: stage.start(p[name], aim, speed) for name, stage, row in self.stages}

    def torque(self, x: Rows, u: Channels, p: Views) -> Tensor:
        """Torque on the rotor [N m], ``(B,)``."""
        torque = self.motor_torque(x, u, p)
        for key, part in self.torques:
            torque = torque + part.torque(p[key], x[self.rotor], x[self.rotor + 1])
        added = self._added("motor", x, u, p)
        return torque if added is None else torque + added

    def current(self, x: Rows, u: Channels, p: Views) -> Tensor:
        """Winding current [A], ``(B,)``."""
        key, motor = self.motor
        return motor.current(p[key], self.motor_torque(x, u, p))

    def motor_torque(self, x: Rows, u: Channels, p: Views, *, network: bool = True) -> Tensor:
        """Torque of the motor alone; one that is switched off is an open circuit (no back-EMF)."""
        key, motor = self.motor
        torque = motor.torque(p[key], self.command(x, u, p, network=network), x[self.rotor + 1])
        for key, part, rows in self.windings:
            torque = part.torque(p[key], torque, [x[row] for row in rows])
        return self._switched(torque, u)

    def _added(self, place: str, x: Rows, u: Channels, p: Views) -> Tensor | None:
        return None if self.networks is None else self.networks.output(place, x, u, p)

    def _switched(self, torque: Tensor, u: Channels) -> Tensor:
        enable = u.get(f"enable{self.number}")
        return torque if enable is None else torque * enable

    def state_updates(self, x: Rows, u: Channels, p: Views) -> list[tuple[int, StateUpdate]]:
        """Row of each state, and how it goes on."""
        found: list[tuple[int, StateUpdate]] = []
        key, loop = self.input
        if self.stages and isinstance(loop, ServoLoop):
            held, speed = self.hold(u, p), self._motion(x, p)[1]
            channels, angle, _ = self._seen(x, held, p)
            aim = loop.aim(p[key], {"goal": held[f"goal{self.number}"]})
            error = loop.error(p[key], channels, angle)
            for name, stage, row in self.stages:
                found.append((row, stage.state_update(p[name], aim, error, speed, x[row])))
        if not self.windings:
            return found
        key, motor = self.motor
        torque = motor.torque(p[key], self.command(x, u, p), x[self.rotor + 1])
        torque = self._switched(torque, u)
        for key, part, rows in self.windings:
            states = [x[row] for row in rows]
            pairs = part.state_updates(p[key], torque, states)
            found += [(row, StateUpdate(*pair)) for row, pair in zip(rows, pairs, strict=True)]
            torque = part.torque(p[key], torque, states)
        return found


SIDE = {"motor_friction": "m", "link_friction": "a"}
"""Letter of a friction's side of the gear in the names of its states."""


class Joint:
    """Paper, eq. (4) and (5): ``J_m a_m = tau_m - tau_s / r - tau_fm``, ``J_a a_a = tau_s - tau_fa``, by components.

    Motors of a coupled gear each keep their own balance of the rotor; what acts at the links reaches them through the
    gear (:class:`~hybrid_id.robots.couplings.GearCoupling`), which :class:`~hybrid_id.systems.arm.Arm` knows.

    State: ``q_m, v_m``, behind a spring ``q_a, v_a`` (x_1, x_2, x_4, x_5), then bristles, windings, networks, readings.

    Args:
        number: joint number, from 1.
        gear_ratio: motor turns per joint turn.
        parts: component key -> component, in the order in which they were added.
        first_row: row of the joint's q_m in the system's state.

    Attributes:
        motors: of a coupled gear, the joints whose motors turn the link, and how far it turns for one turn of each;
            empty where the joint's own motor alone does.
        links: the joints whose links turn with the motor, and how far it turns for one turn of each.
        joined: all joints of the coupled gear.

    Raises:
        InputError: a place that must hold a component is empty.
    """

    def __init__(
        self, number: int, gear_ratio: float, parts: Mapping[str, Component], first_row: int
    ) -> None:
        self.name, self.number, self.gear_ratio = f"joint{number}", number, gear_ratio

        def of(kind: type, place: str | None = None) -> list[tuple[str, Component]]:
            return [
                (key, part)
                for key, part in parts.items()
                if isinstance(part, kind) and (place is None or key.split("/")[1] == place)
            ]

        self.gear = Gear(self.name, gear_ratio, parts)
        masses = only(parts, Inertia, self.name, "inertia (one_link, two_inertias, link_inertia)")
        self.inertia = cast("tuple[str, Inertia]", masses)
        self.loads = cast("list[tuple[str, LoadTorque]]", of(LoadTorque))
        self.logged = cast("list[tuple[str, LoggedTorque]]", of(LoggedTorque))
        self.rigid = self.gear.rigid
        places = ("motor_friction", "link_friction")
        self.frictions = {w: cast("list[tuple[str, Friction]]", of(Friction, w)) for w in places}
        self.state_names = [f"q_m{number}", f"v_m{number}"]
        self.state_names += [] if self.rigid else [f"q_a{number}", f"v_a{number}"]
        self.positions = [first_row + row for row in range(0, len(self.state_names), 2)]
        self.bristles: dict[str, tuple[str, Bristle, range]] = {}
        for place, laws in self.frictions.items():
            for key, law in laws:
                if isinstance(law, Bristle):
                    if place in self.bristles or (self.rigid and self.bristles):
                        raise InputError(
                            f"{self.name} has two bristle frictions on one speed; keep one of them."
                        )
                    row, side = first_row + len(self.state_names), SIDE[place]
                    self.bristles[place] = (key, law, range(row, row + len(law.states)))
                    self.state_names += [f"{state}_{side}{number}" for state in law.states]

        self.drive = Drive(
            number, parts, first_row, first_row + len(self.state_names), gear_ratio, self.shaft_motion
        )
        self.state_names += self.drive.state_names
        self.networks = self.drive.networks = Networks(self, parts, first_row + len(self.state_names))
        self.state_names += self.networks.state_names
        self.sensing = SensorDynamics(number, parts, first_row, first_row + len(self.state_names))
        self.state_names += self.sensing.state_names
        self.channels = [c for _, part in (self.drive.input, *self.logged) for c in part.channels]
        dry = [self._is_dry(place) for place in self.frictions]
        self.dry = [any(dry)] if self.rigid else dry
        self.motors: list[tuple[Joint, float]] = []
        self.links: list[tuple[Joint, float]] = [(self, gear_ratio)]
        self.joined: list[Joint] = [self]

    def _is_dry(self, place: str) -> bool:
        """Whether set-valued friction acts in a place; a bristle takes it over, that of the load excepted."""
        laws, free = [law for _, law in self.frictions[place]], place not in self.bristles
        return any(
            (free and _has(law, "dry", "dry_over")) or _has(law, "load_factor", "effort_factor")
            for law in laws
        )

    def hidden_rows(self, outputs: Collection[str]) -> list[int]:
        """Rows of what outputs do not tell behind a gear that gives way: of its motor or its link, or of its twist."""
        if self.rigid:
            return []
        for side, row in zip("am", reversed(self.positions), strict=True):
            if not {f"q_{side}{self.number}", f"v_{side}{self.number}"} & set(outputs):
                return [row, row + 1]
        for side, row in zip("am", reversed(self.positions), strict=True):
            if f"q_{side}{self.number}" not in outputs:  # its speed is measured
                return [row]
        return []

    def dry_level(self, place: str, p: Views, magnitude: Tensor, forward: Tensor, x: Rows) -> Tensor:
        """Sum of the dry levels of a place, ``(B,)``, >= 0; under a bristle a trace more, which it divides by."""
        laws = self.frictions[place]
        level = sum_of([law.dry(p[key], magnitude, forward) for key, law in laws], magnitude)
        if any(type(law).dry_over is not Friction.dry_over for _, law in laws):
            motor = place == "motor_friction" or self.rigid
            angle = self.gear.map(x[self.positions[0]], p)[0] if motor else x[self.positions[1]]
            extra = [law.dry_over(p[key], angle) for key, law in laws]
            level = sum_of([level, *extra], magnitude).clamp_min(0.0)
        return level + 1e-12 if place in self.bristles else level

    def friction(
        self, place: str, x: Rows, u: Channels, p: Views, speed: Tensor, magnitude: Tensor, forward: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Smooth torque (bristles, networks included) and dry level of a place at its side's speed, ``(B,)`` each."""
        laws = self.frictions[place]
        terms = [law.smooth(p[key], speed) for key, law in laws]
        terms.append(self.networks.output(place, x, u, p))
        level = self.dry_level(place, p, magnitude, forward, x)
        if place in self.bristles:
            key, law, rows = self.bristles[place]
            terms.append(law.torque(p[key], [x[row] for row in rows], speed, level))
            level = speed.new_zeros(1)
        return sum_of(terms, speed), level

    def balances(
        self, x: Rows, u: Channels, p: Views, magnitudes: Rows, forwards: Rows, *, transmitted: bool = False
    ) -> list[SpeedBalance]:
        """Torque balance of each of the joint's speeds (one when rigid, two with a compliant gear).

        Args:
            x: state rows, ``(B,)`` each.
            u: channels, ``(B,)`` each.
            p: parameter views by component key.
            magnitudes: |speed| for each speed.
            forwards: whether dry friction acts forward (1.0 or 0.0), for each speed.
            transmitted: whether they are to tell the torque through a rigid gear where no friction needs it.
        """
        r = self.gear_ratio
        q, v = x[self.positions[0]], x[self.positions[0] + 1]
        motor_smooth, motor_level = self.friction("motor_friction", x, u, p, v, magnitudes[0], forwards[0])
        drive = self.drive.torque(x, u, p)
        laws = self.frictions["motor_friction"]
        if (effort := sum_if_any([law.effort_factor(p[key]) for key, law in laws])) is not None:
            motor_level = motor_level + effort * drive.abs()
        drive = drive - motor_smooth
        factor = sum_if_any([law.load_factor(p[key]) for key, law in laws])
        key, inertia = self.inertia
        if self.rigid:
            angle, slope, curvature = self.gear.map(q, p)
            total, level, load, turned = inertia.total(p[key], r), motor_level, v.new_zeros(1), 0.0
            if curvature is not None:
                carried = inertia.link(p[key], r)
                total = inertia.rotor(p[key], r) + carried * slope**2
                turned = carried * slope * curvature * v.square()  # the link's, while the rotor turns evenly
                drive = drive - turned
            network = any(place in self.networks.by_place for place in LINK_PLACES)
            acts = self.frictions["link_friction"] or self.loads or self.logged or network
            if acts and not self.motors:  # else the arm brings it to all motors of the coupled gear
                link_smooth, link_level = self.friction(
                    "link_friction", x, u, p, v * slope, magnitudes[0] * abs(slope), forwards[0]
                )
                load = (link_smooth + self._load(x, angle, v * slope, u, p)) * slope
                drive, level = drive - load, level + link_level * abs(slope)
            if factor is None and not transmitted:
                return [SpeedBalance(total, drive, level)]
            share = inertia.link(p[key], r) * slope**2 / total
            return [SpeedBalance(total, drive, level, factor, share, load + turned)]
        rotor, link = inertia.rotor(p[key], r), inertia.link(p[key], r)
        qa, va = x[self.positions[1]], x[self.positions[1] + 1]
        torque = self.spring_torque(x, p)
        slope = self.gear.map(q, p)[1]
        if (added := self.networks.output("transmission", x, u, p)) is not None:
            torque = torque + added
        if factor is not None:
            motor_level = motor_level + factor * (torque * slope).abs()
        link_smooth, link_level = self.friction("link_friction", x, u, p, va, magnitudes[1], forwards[1])
        return [
            SpeedBalance(rotor, drive - torque * slope, motor_level),
            SpeedBalance(link, torque - link_smooth - self._load(x, qa, va, u, p), link_level),
        ]

    def couple(
        self,
        motors: Sequence[tuple[Joint, float]],
        links: Sequence[tuple[Joint, float]],
        joined: Sequence[Joint],
    ) -> None:
        """Let a coupled gear join the motor and the link with those of other joints, see ``motors`` and ``links``.

        Raises:
            InputError: a part whose place in a coupled gear is not known, or whose friction several motors would share.
        """
        self.motors, self.links, self.joined = list(motors), list(links), list(joined)
        refused: list[tuple[str, Component]] = [*self.gear.errors]
        refused += [] if self.rigid else [self.gear.transmission]
        refused += [] if isinstance(self.inertia[1], RotorInertia) else [self.inertia]
        refused += [] if self.sensing.late is None else [self.sensing.late]
        # the loop of a servo closes over its own shaft
        refused += self.drive.encoders if self.drive.input[1].at_joint else []
        for key, part in refused:
            raise InputError(
                f"{part.kind} at '{key.rsplit('/', 1)[0]}' cannot sit at a joint whose motor is coupled with others; "
                "remove it, or the coupling."
            )
        for key, law in self.frictions["link_friction"]:
            if isinstance(law, Bristle) or _has(law, "dry", "dry_over", "load_factor", "effort_factor"):
                raise InputError(
                    f"{law.kind} at '{key.rsplit('/', 1)[0]}' is dry friction of a link that coupled motors turn "
                    "together; put it at motor_friction."
                )

    def link_load(self, x: Rows, u: Channels, p: Views) -> Tensor:
        """Torque of friction, loads and networks at the link of a coupled gear [N m], ``(B,)``."""
        angle, speed = self.link_motion(x, p)
        ahead = (speed > 0).to(speed.dtype)
        return self.friction("link_friction", x, u, p, speed, speed.abs(), ahead)[0] + self._load(
            x, angle, speed, u, p
        )

    def shaft_motion(self, x: Rows, p: Views) -> tuple[Tensor, Tensor]:
        """Angle [rad] and speed [rad/s] behind the joint's own gear: the link's, but for a coupled gear."""
        if not self.motors:
            return self.link_motion(x, p)
        row = self.positions[0]
        return x[row] / self.gear_ratio, x[row + 1] / self.gear_ratio

    def link_torque(
        self, transmitted: Mapping[int, Tensor], direction: Tensor | None, x: Rows, u: Channels, p: Views
    ) -> Tensor:
        """Torque that passes the gear to the link [N m], ``(B,)``; dry friction of a link at rest counts as none.

        Args:
            transmitted: torque through the rigid gear of each joint of the system at its motor [N m], ``(B,)``, by the
                joint's number.
            direction: of dry friction at a rigid gear's speed, None where there is none.
            x: state rows, ``(B,)`` each.
            u: channels, ``(B,)`` each.
            p: parameter views.
        """
        if not self.rigid:
            added = self.networks.output("transmission", x, u, p)
            torque = self.spring_torque(x, p)
            return torque if added is None else torque + added
        if self.motors:  # tau = C^T diag(r) tau_m
            shares = [
                turns * transmitted[motor.number]
                for motor in self.joined
                for link, turns in motor.links
                if link is self
            ]
            return sum_of(shares, x[0])
        row = self.positions[0]
        slope = self.gear.map(x[row], p)[1]
        torque = transmitted[self.number] / slope
        if direction is None or not self.frictions["link_friction"]:
            return torque
        speed = x[row + 1] * slope
        return torque + direction * self.dry_level(
            "link_friction", p, speed.abs(), (direction > 0).to(speed.dtype), x
        )

    def link_motion(self, x: Rows, p: Views) -> tuple[Tensor, Tensor]:
        """Angle [rad] and speed [rad/s] of the link, ``(B,)`` each."""
        if self.motors:
            angle, speed = (
                sum_of([x[one.positions[0] + order] * share for one, share in self.motors], x[0])
                for order in (0, 1)
            )
            return angle, speed
        if not self.rigid:
            return x[self.positions[1]], x[self.positions[1] + 1]
        angle, slope, _ = self.gear.map(x[self.positions[0]], p)
        return angle, x[self.positions[0] + 1] * slope

    def spring_torque(self, x: Rows, p: Views) -> Tensor:
        """Torque of a compliant gear's spring at the link [N m], ``(B,)``."""
        rotor, link = (x[row : row + 2] for row in self.positions)
        return self.gear.torque(rotor, link, self.inertia, p)

    def state_updates(self, x: Rows, u: Channels, p: Views) -> list[tuple[int, StateUpdate]]:
        """Row of each state that remembers, and how it goes on."""
        found = []
        for place, (key, law, rows) in self.bristles.items():
            motor = place == "motor_friction"
            v = x[self.positions[0] + 1] if motor or self.rigid else x[self.positions[1] + 1]
            v = v * self.gear.map(x[self.positions[0]], p)[1] if self.rigid and not motor else v
            level = self.dry_level(place, p, v.abs(), (v > 0).to(v.dtype), x)
            pairs = law.state_updates(p[key], [x[row] for row in rows], v, level)
            found += [(row, StateUpdate(*pair)) for row, pair in zip(rows, pairs, strict=True)]
        found += self.drive.state_updates(x, u, p) + self.networks.state_updates(x, u, p)
        return found + self.sensing.state_updates(x, p)

    def _load(self, x: Rows, angle: Tensor, speed: Tensor, u: Channels, p: Views) -> Tensor:
        """Torque of the load at the link with a network's, ``(B,)``."""
        load, added = self.load_torque(angle, speed, u, p), self.networks.output("load", x, u, p)
        return load if added is None else load + added

    def load_torque(self, angle: Tensor, speed: Tensor, u: Channels, p: Views) -> Tensor:
        """Torque of the load at the link, ``(B,)``."""
        logged = {name: u[f"{name}{self.number}"] for name in self.channels}
        torques = [part.torque(p[key], angle, speed) for key, part in self.loads]
        return sum_of([*torques, *(part.torque(p[key], logged) for key, part in self.logged)], angle)

    def output(self, channel: str, x: Rows, u: Channels, p: Views, torque: Tensor | None = None) -> Tensor:
        """A measured output by channel (``q_m``, ``v_m``, ``q_a``, ``v_a``, ``i``, ``tau``, ``tau_a``), ``(B,)``."""
        row, seen = self.positions[0], 0.0
        if channel in ("q_m", "v_m"):
            value, seen = x[row + (channel == "v_m")], 1.0
        elif channel in ("q_a", "v_a"):
            value = self.link_motion(x, p)[channel == "v_a"]
            seen = 1.0 / self.gear_ratio if self.rigid else 0.0  # no motor of a coupled gear is read late
        elif channel == "tau":
            value = self.drive.torque(x, u, p)
        elif channel == "i":
            value = self.drive.current(x, u, p)
        elif channel == "tau_a" and torque is not None:
            value = torque
        elif (added := self.networks.output(channel.removeprefix("r_"), x, u, p)) is not None:
            value = added
        else:
            raise InputError(
                f"Output '{channel}{self.number}' is not known; outputs are q_m, v_m, q_a, v_a, i, tau, tau_a with "
                "the joint's number."
            )
        return self.sensing.read(channel, value, seen, x, p)
