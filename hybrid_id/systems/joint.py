"""Torque balance of one joint: the drive chain from its command to the accelerations of its speeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import cast

from torch import Tensor

from hybrid_id.components.base import Component, Friction, Inertia, LoadTorque, LoggedTorque
from hybrid_id.components.bristle import Bristle
from hybrid_id.errors import InputError
from hybrid_id.systems.balance import SpeedBalance
from hybrid_id.systems.drive import Drive, only
from hybrid_id.systems.gear import Gear
from hybrid_id.systems.networks import LINK_PLACES, Networks
from hybrid_id.systems.sensor_dynamics import SensorDynamics
from hybrid_id.systems.terms import sum_if_any, sum_of

Views = Mapping[str, SimpleNamespace]


class Joint:
    """Paper, eq. (4) and (5): ``J_m a_m = tau_m - tau_s / r - tau_fm``, ``J_a a_a = tau_s - tau_fa``, by components.

    State: ``q_m, v_m``, behind a spring ``q_a, v_a`` (x_1, x_2, x_4, x_5), then bristles, windings, networks, readings.

    Args:
        number: joint number, from 1.
        gear_ratio: motor turns per joint turn.
        parts: component key -> component, in the order in which they were added.
        first_row: row of the joint's q_m in the system's state.

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
                    row, side = first_row + len(self.state_names), place[0].replace("l", "a")
                    self.bristles[place] = (key, law, range(row, row + len(law.states)))
                    self.state_names += [f"{state}_{side}{number}" for state in law.states]

        self.drive = Drive(number, parts, first_row, first_row + len(self.state_names))
        self.state_names += self.drive.state_names
        self.networks = self.drive.networks = Networks(self, parts, first_row + len(self.state_names))
        self.state_names += self.networks.state_names
        self.sensing = SensorDynamics(number, parts, first_row, first_row + len(self.state_names))
        self.state_names += self.sensing.state_names
        self.channels = [c for _, part in (self.drive.input, *self.logged) for c in part.channels]
        dry = [self._is_dry(place) for place in self.frictions]
        self.dry = [any(dry)] if self.rigid else dry

    def _is_dry(self, place: str) -> bool:
        """Whether set-valued friction acts in a place; a bristle takes it over, that of the load excepted."""
        laws = [type(law) for _, law in self.frictions[place]]

        def has(*terms: str) -> bool:
            return any(getattr(law, term) is not getattr(Friction, term) for law in laws for term in terms)

        free = place not in self.bristles
        return (free and has("dry", "dry_over")) or has("load_factor", "effort_factor")

    def dry_level(
        self, place: str, p: Views, magnitude: Tensor, forward: Tensor, x: Sequence[Tensor]
    ) -> Tensor:
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
        self,
        place: str,
        x: Sequence[Tensor],
        u: Mapping[str, Tensor],
        p: Views,
        speed: Tensor,
        magnitude: Tensor,
        forward: Tensor,
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
        self,
        x: Sequence[Tensor],
        u: Mapping[str, Tensor],
        p: Views,
        magnitudes: Sequence[Tensor],
        forwards: Sequence[Tensor],
    ) -> list[SpeedBalance]:
        """Torque balance of each of the joint's speeds (one when rigid, two with a compliant gear).

        Args:
            x: state rows, ``(B,)`` each.
            u: channels, ``(B,)`` each.
            p: parameter views by component key.
            magnitudes: |speed| for each speed.
            forwards: whether dry friction acts forward (1.0 or 0.0), for each speed.
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
            angle, slope, bend = self.gear.map(q, p)
            total, level, load, turned = inertia.total(p[key], r), motor_level, v.new_zeros(1), 0.0
            if bend is not None:
                carried = inertia.link(p[key], r)
                total = inertia.rotor(p[key], r) + carried * slope**2
                turned = carried * slope * bend * v.square()  # the link's, while the rotor turns evenly
                drive = drive - turned
            network = any(place in self.networks.by_place for place in LINK_PLACES)
            if self.frictions["link_friction"] or self.loads or self.logged or network:
                link_smooth, link_level = self.friction(
                    "link_friction", x, u, p, v * slope, magnitudes[0] * abs(slope), forwards[0]
                )
                load = (link_smooth + self._load(x, angle, v * slope, u, p)) * slope
                drive, level = drive - load, level + link_level * abs(slope)
            if factor is None:
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

    def link_motion(self, x: Sequence[Tensor], p: Views) -> tuple[Tensor, Tensor]:
        """Angle [rad] and speed [rad/s] of the link, ``(B,)`` each."""
        if not self.rigid:
            return x[self.positions[1]], x[self.positions[1] + 1]
        angle, slope, _ = self.gear.map(x[self.positions[0]], p)
        return angle, x[self.positions[0] + 1] * slope

    def spring_torque(self, x: Sequence[Tensor], p: Views) -> Tensor:
        """Torque of a compliant gear's spring at the link [N m], ``(B,)``."""
        rotor, link = (x[row : row + 2] for row in self.positions)
        return self.gear.torque(rotor, link, self.inertia, p)

    def relaxations(
        self, x: Sequence[Tensor], u: Mapping[str, Tensor], p: Views
    ) -> list[tuple[int, Tensor, Tensor]]:
        """Row, drive and rate [1/s] of each state that remembers, ``dz/dt = drive - rate z``."""
        found = []
        for place, (key, law, rows) in self.bristles.items():
            motor = place == "motor_friction"
            v = x[self.positions[0] + 1] if motor or self.rigid else x[self.positions[1] + 1]
            v = v * self.gear.map(x[self.positions[0]], p)[1] if self.rigid and not motor else v
            level = self.dry_level(place, p, v.abs(), (v > 0).to(v.dtype), x)
            pairs = law.relaxations(p[key], [x[row] for row in rows], v, level)
            found += [(row, *pair) for row, pair in zip(rows, pairs, strict=True)]
        found += self.drive.relaxations(x, u, p) + self.networks.relaxations(x, u, p)
        return found + self.sensing.relaxations(x, p)

    def _load(
        self, x: Sequence[Tensor], angle: Tensor, speed: Tensor, u: Mapping[str, Tensor], p: Views
    ) -> Tensor:
        """Torque of the load at the link with a network's, ``(B,)``."""
        load, added = self.load_torque(angle, speed, u, p), self.networks.output("load", x, u, p)
        return load if added is None else load + added

    def load_torque(self, angle: Tensor, speed: Tensor, u: Mapping[str, Tensor], p: Views) -> Tensor:
        """Torque of the load at the link, ``(B,)``."""
        logged = {name: u[f"{name}{self.number}"] for name in self.channels}
        torques = [part.torque(p[key], angle, speed) for key, part in self.loads]
        return sum_of([*torques, *(part.torque(p[key], logged) for key, part in self.logged)], angle)

    def output(self, channel: str, x: Sequence[Tensor], u: Mapping[str, Tensor], p: Views) -> Tensor:
        """A measured output by channel name (``q_m``, ``v_m``, ``q_a``, ``v_a``, ``i``, ``tau``), ``(B,)``."""
        row, seen = self.positions[0], 0.0
        if channel in ("q_m", "v_m"):
            value, seen = x[row + (channel == "v_m")], 1.0
        elif channel in ("q_a", "v_a"):
            value = self.link_motion(x, p)[channel == "v_a"]
            seen = 1.0 / self.gear_ratio if self.rigid else 0.0
        elif channel == "tau":
            value = self.drive.torque(x, u, p)
        elif channel == "i":
            value = self.drive.current(x, u, p)
        elif (added := self.networks.output(channel.removeprefix("r_"), x, u, p)) is not None:
            value = added
        else:
            raise InputError(
                f"Output '{channel}{self.number}' is not known; outputs are q_m, v_m, q_a, v_a, i, tau with the "
                "joint's number."
            )
        return self.sensing.read(channel, value, seen, x, p)
