"""A system is a chain of places, and everything that acts is a component in a place."""

from __future__ import annotations

import copy
import difflib
from collections.abc import Collection, Mapping, Sequence
from types import SimpleNamespace
from typing import cast

import torch
from torch import Tensor, nn

from hybrid_id.components.base import PLACES, Component, Shared, StateUpdate
from hybrid_id.components.input.delay import CommonDelay
from hybrid_id.components.load.residual_torque import ResidualTorque
from hybrid_id.components.residual import ResidualNetwork
from hybrid_id.errors import InputError, close_match
from hybrid_id.parameters import Bounded, ParameterInfo
from hybrid_id.robots.tree import RigidBodyTree
from hybrid_id.systems.arm import Arm
from hybrid_id.systems.balance import Balances, Channels, Directions, Rest, Rows, SpeedBalance, Views
from hybrid_id.systems.joint import Joint

TURNING = ("input", "motor", "motor_friction", "sensor")
"""Places on the motor's side of a gear."""
PUSH = "push"
"""Channel of a torque that no law describes over the inertia at a speed [rad/s^2], by that speed's number from 0."""


class System(nn.Module):
    """Paper, eq. (1): ``x' = f(t, x, theta, u)``, ``y = h(t, x, theta, u) + e``, as components in places.

    Out of the components follow a state layout and the equations of motion; ``e`` is the noise of the sensors.

    Args:
        gear_ratio: motor turns per joint turn, one a joint.
        parts: (where, component) pairs, ``where`` as ``"joint1/motor_friction"``.
        aliases: preferred result names by (component key, symbol), as
            ``("joint1/motor/dc_motor", "P_m1"): "P_m1m1"``.
        name: kind of system in model files (``one_link`` ...).
        tree: what couples the joints of a robot; None for joints that stand alone or in a plane.
        seats: number in the tree, from 0, of each joint, which then keeps that number in places and channels
            (``joint3/motor``, ``q_m3`` of seat 2); None for all of them in order. Of the tree's other joints the
            records bring angle, speed and acceleration.

    Attributes:
        state_names: rows of the state, ``(n_x, B)``.
        speed_rows, memory_rows: which of them are speeds, and which remember (bristles, windings, networks, readings).
        networks: the residual networks by component key.
        dry: whether dry friction acts on each speed, in the order of ``speed_rows``.
        table: the parameters, in a fixed order; ``theta`` vectors follow it.
        estimated: rows of the table that a fit may move.
        whole: the robot that it is one joint of, where it is; in a tuple, for its parameters are not this system's.

    Raises:
        InputError: unknown place, a component in a place where it cannot sit, a place that is empty or crowded.
    """

    def __init__(
        self,
        gear_ratio: Sequence[float],
        parts: Sequence[tuple[str, Component]],
        aliases: Mapping[tuple[str, str], str] | None = None,
        name: str = "one_link",
        tree: RigidBodyTree | None = None,
        seats: Sequence[int] | None = None,
    ) -> None:
        super().__init__()
        self.name, self.tree = name, tree
        self.seats = None if seats is None else tuple(seats)
        self.whole: tuple[System, ...] = ()
        self.gear_ratio = tuple(float(r) for r in gear_ratio)
        self.aliases = dict(aliases or {})
        self.components = nn.ModuleDict()
        for where, part in parts:
            self._place(where, part)
        self._wire()
        self.register_load_state_dict_post_hook(_rewire)

    def _place(self, where: str, part: Component) -> None:
        check_place(where, type(part), [f"joint{n}" for n in self._numbers])
        if part.single:
            for key, other in list(self.components.items()):
                if key.startswith(f"{where}/") and isinstance(other, part.family()):
                    del self.components[key]
        self.components[f"{where}/{part.kind}"] = part

    @property
    def _numbers(self) -> list[int]:
        """Number of each joint, from 1: that in the robot, where the system is a part of one."""
        return [seat + 1 for seat in (range(len(self.gear_ratio)) if self.seats is None else self.seats)]

    def _wire(self) -> None:
        def order(key: str) -> tuple[int, int, bool, str]:
            joint, place, kind = key.split("/")
            return int(joint[5:]), PLACES.index(place), not cast(Component, self.components[key]).single, kind

        # one order however the system was built, so that vectors of parameters mean the same
        self.components = nn.ModuleDict(
            {key: self.components[key] for key in sorted(self.components, key=order)}
        )
        # the dead time that all joints share may be listed at any of them
        common = [(key, part) for key, part in self.components.items() if isinstance(part, CommonDelay)]
        if len(common) > 1:
            places = ", ".join(key.rpartition("/")[0] for key, _ in common)
            raise InputError(
                f"common_delay is listed at {places}; it acts on all joints, so keep one of them."
            )
        self.joints: list[Joint] = []
        self.state_names: list[str] = []
        for number, ratio in zip(self._numbers, self.gear_ratio, strict=True):
            parts = {
                k: cast(Component, c) for k, c in self.components.items() if k.startswith(f"joint{number}/")
            }
            joint = Joint(number, ratio, parts, len(self.state_names))
            joint.drive.delay = joint.drive.delay or next(iter(common), None)
            self.joints.append(joint)
            self.state_names += joint.state_names
        for joint in self.joints:
            joint.networks.connect(self.joints)
        self.networks = {k: c for k, c in self.components.items() if isinstance(c, ResidualNetwork)}
        self.speed_rows = [row + 1 for joint in self.joints for row in joint.positions]
        self.dry = [is_dry for joint in self.joints for is_dry in joint.dry]
        self.memory_rows = [
            row
            for joint in self.joints
            for row in range(joint.positions[-1] + 2, joint.positions[0] + len(joint.state_names))
        ]
        slides = {  # joints with a linear axis, and components that act along it
            f"joint{number}": ratio
            for number, ratio in zip(self._numbers, self.gear_ratio, strict=True)
            if self.tree is not None and self.tree.joints[number - 1].kind == "slide"
        }
        linear = set[str]()
        for key, part in self.components.items():
            joint, place, _ = key.split("/")
            if joint in slides and acts_along(type(cast(Component, part)), place, slides[joint]):
                linear.add(key)
        self.table = parameter_table(self.components, self.aliases, linear)
        self.estimated = [i for i, info in enumerate(self.table) if info.spec.estimate]
        parts = cast("dict[str, Component]", dict(self.components.items()))
        self.arm = Arm(self.joints, parts, self.tree, self.seats)
        with torch.no_grad():
            self.arm.check({key: cast(Component, part).view() for key, part in self.components.items()})

    @property
    def learned(self) -> tuple[str, ...]:
        """Keys of its networks, whether their weights are parameters or not."""
        return tuple(k for k, c in self.components.items() if isinstance(c, ResidualNetwork | ResidualTorque))

    def with_component(self, where: str, component: Component) -> System:
        """A new system that has ``component`` too (in a place that holds exactly one, instead of the old one)."""
        system = self._copied()
        system._place(where, copy.deepcopy(component))
        system._wire()
        return system

    def without_component(self, where: str, kind: str) -> System:
        """A new system that lacks the component of ``kind`` at ``where``."""
        if f"{where}/{kind}" not in self.components:
            near = close_match(f"{where}/{kind}", self.components)
            raise InputError(
                f"There is no {kind} at '{where}'{near}; the system has {', '.join(self.components)}."
            )
        system = self._copied()
        del system.components[f"{where}/{kind}"]
        system._wire()
        return system

    def with_values(self, values: Mapping[str, float]) -> System:
        """A new system with parameter values (by result name) replaced; bounds stay and are checked."""
        return self.with_specs({n: self.parameter(n).spec.at(v) for n, v in values.items()})

    def with_specs(self, specs: Mapping[str, Bounded]) -> System:
        """A new system with whole parameter specifications (value, bounds, role, prior) replaced by result name."""
        system = self._copied()
        for name, spec in specs.items():
            info = system.parameter(name)
            part = cast(Component, system.components[info.component])
            part.specs[info.symbol] = spec.check(name)
            with torch.no_grad():
                cast(Tensor, getattr(part, info.symbol)).fill_(spec.value)
        system._wire()
        return system

    def _copied(self) -> System:
        """A copy to be changed and wired anew, for which what is wired need not be copied.

        Neither need what never changes: a tree, and the robot that a joint was taken out of.
        """
        kept = self.joints, self.arm, self.table, self.tree, self.whole
        return copy.deepcopy(self, {id(one): one for one in kept})

    def parameter(self, name: str) -> ParameterInfo:
        """The table's row of a parameter by its result name."""
        for info in self.table:
            if info.name == name:
                return info
        known = [info.name for info in self.table]
        raise InputError(
            f"The system has no parameter '{name}'{close_match(name, known)}; it has {', '.join(known)}."
        )

    def theta(self) -> Tensor:
        """Stored parameter values in table order, ``(n_p,)``; gradients flow to the torch parameters."""
        return torch.stack(
            [cast(Tensor, getattr(self.components[i.component], i.symbol)) for i in self.table]
        )

    def views(self, theta: Rows) -> dict[str, SimpleNamespace]:
        """Parameter views by component key from rows in table order, each ``(1,)`` or ``(B,)``."""
        views: dict[str, SimpleNamespace] = {key: SimpleNamespace() for key in self.components}
        for info, row in zip(self.table, theta, strict=True):
            setattr(views[info.component], info.symbol, row)
        self.arm.guard(views)
        return views

    def joint(self, number: int) -> Joint:
        """The joint that places and channels call by a number, from 1."""
        return next(joint for joint in self.joints if joint.number == number)

    @property
    def own_ratios(self) -> list[float | None]:
        """Gear ratio of each joint; None where a coupled gear turns its motor with other joints, too."""
        return [None if joint.motors else joint.gear_ratio for joint in self.joints]

    @property
    def input_names(self) -> list[str]:
        """Channels that the system reads (``enable<joint>`` is read where a record has it)."""
        return [*(f"{c}{j.number}" for j in self.joints for c in j.channels), *self.arm.channels]

    def hold(self, u: Channels, p: Views) -> Channels:
        """Channels as they arrive at the motors; what stays the same over a sample is found once."""
        for joint in self.joints:
            u = joint.drive.hold(u, p)
        return u

    def balances(
        self, x: Rows, u: Channels, p: Views, magnitudes: Rows, forwards: Rows, *, transmitted: bool = False
    ) -> Balances:
        """Torque balance of every speed, in the order of ``speed_rows``; see :meth:`Joint.balances`."""
        found: list[SpeedBalance] = []
        for joint in self.joints:
            n = slice(len(found), len(found) + len(joint.positions))
            found += joint.balances(x, u, p, magnitudes[n], forwards[n], transmitted=transmitted)
        whole = self.arm.couple(found, x, u, p)
        for k, balance in enumerate(whole.speeds):
            if (push := u.get(f"{PUSH}{k}")) is not None:
                balance.smooth = balance.smooth + balance.inertia * push
        return whole

    def rest(self, x: Rows, u: Channels, p: Views, directions: Directions) -> Rest:
        """What may hold the speeds whose direction is 0: the balances with their friction either way."""
        speeds = [x[row] for row in self.speed_rows]
        magnitudes, back = _along(speeds, directions)
        ahead = [((v if d is None else d) >= 0).to(v.dtype) for v, d in zip(speeds, directions, strict=True)]
        return Rest(self.balances(x, u, p, magnitudes, ahead), self.balances(x, u, p, magnitudes, back))

    def signs(self, x: Rows) -> Directions:
        """Sign of each speed with dry friction: whether one of zero just breaks away is nothing to a filter."""
        speeds = zip(self.speed_rows, self.dry, strict=True)
        return [torch.sign(x[row]) if dry else None for row, dry in speeds]

    @torch.no_grad()
    def directions(self, x: Rows, u: Channels, p: Views) -> Directions:
        """Direction of dry friction for each speed: its sign, and at rest the push beyond the level, else 0."""
        signs = self.signs(x)
        if not any(sign is not None and bool((sign == 0).any()) for sign in signs):
            return signs
        return self.rest(x, u, p, signs).stick_slip(signs)

    def link_torques(
        self, x: Rows, u: Channels, p: Views, directions: Directions | None = None
    ) -> dict[int, Tensor]:
        """Torque that passes each joint's gear to its link [N m], ``(B,)``, by the joint's number.

        Dry friction is the set-valued law.
        """
        u = self.hold(u, p)
        signs = self.directions(x, u, p) if directions is None else directions
        balances = self.balances(
            x, u, p, *_along([x[row] for row in self.speed_rows], signs), transmitted=True
        )
        found = balances.accelerations(signs, held=True)
        reactions, through = balances.reactions(found), dict[int, Tensor]()
        rotors = [self.speed_rows.index(joint.positions[0] + 1) for joint in self.joints]
        for joint, k in zip(self.joints, rotors, strict=True):
            own = balances.speeds[k]
            through[joint.number] = own.transmitted(found[k], reactions[k]) if joint.rigid else x[0]
        return {
            joint.number: joint.link_torque(through, signs[k], x, u, p)
            for joint, k in zip(self.joints, rotors, strict=True)
        }

    def rates(
        self, x: Rows, u: Channels, p: Views, directions: Directions | None = None, width: float = 0.5
    ) -> list[Tensor]:
        """Time derivative of the state rows (those that remember excepted: zero here, see ``state_updates``).

        Args:
            x: state rows, ``(B,)`` each.
            u: channels, ``(B,)`` each.
            p: parameter views.
            directions: direction of dry friction for each speed, -1, 0 (held at rest) or 1, None where there is no
                dry friction; without it dry friction is smoothed as ``tanh(speed / width)``.
            width: smoothing speed [rad/s] of the side where the friction acts.
        """
        speeds = [x[row] for row in self.speed_rows]
        fixed = [None] * len(speeds) if directions is None else list(directions)
        signs = [torch.tanh(v / width) for v in speeds] if directions is None else fixed
        rates = [torch.zeros_like(x[0])] * len(x)
        found = self.balances(x, u, p, *_along(speeds, fixed))
        found = found.accelerations(signs, held=directions is not None)
        for row, acceleration in zip(self.speed_rows, found, strict=True):
            rates[row - 1], rates[row] = x[row], acceleration
        return rates

    def state_updates(self, x: Rows, u: Channels, p: Views) -> list[tuple[int, StateUpdate]]:
        """Row of each state that remembers, and how it goes on."""
        found = [one for joint in self.joints for one in joint.state_updates(x, u, p)]
        lags = [(joint, joint.sensing.lag) for joint in self.joints if joint.sensing.lag is not None]
        torques = self.link_torques(x, u, p, self.signs(x)) if lags else {}
        for joint, (key, part) in lags:
            found.append((joint.sensing.lag_row, part.state_update(p[key], torques[joint.number])))
        return found

    def check_outputs(self, names: Sequence[str]) -> None:
        """Raise InputError for an output of a joint that the system does not have."""
        for name in names:
            self._placed(name)

    def _placed(self, name: str) -> tuple[str, int]:
        """Channel and joint's number of an output's name."""
        channel = name.rstrip("0123456789")
        number = int(name[len(channel) :] or 0)
        if number not in self._numbers:
            ends = f"a number up to {len(self.joints)}" if self.seats is None else f"{self._numbers[0]}"
            held = [] if self.tree is None else list(self.tree.held)
            cure = (
                f"{', '.join(held)}, held in the model, {'have' if len(held) > 1 else 'has'} no number: number the "
                "columns without, or take 'hold' out"
                if held
                else "take a model of that joint, or leave the output out of the dataset"
            )
            raise InputError(
                f"Output '{name}' names no joint of {self.name}, whose outputs end in {ends}; {cure}."
            )
        return channel, number

    def outputs(
        self, names: Sequence[str], x: Rows, u: Channels, p: Views, directions: Directions | None = None
    ) -> list[Tensor]:
        """Measured outputs by name (``q_m1``, ``i1`` ...; ``r_motor1``: of the network there), ``(B,)`` each."""
        placed = [self._placed(name) for name in names]
        torques = self.link_torques(x, u, p, directions) if "tau_a" in dict(placed) else {}
        return [self.joint(n).output(channel, x, u, p, torques.get(n)) for channel, n in placed]


def _along(speeds: Rows, directions: Directions) -> tuple[list[Tensor], list[Tensor]]:
    """Size of each speed in its direction of dry friction, and whether that is forward; see :meth:`Joint.balances`."""
    each = list(zip(speeds, directions, strict=True))
    magnitudes = [v.abs() if sign is None else (sign * v).clamp_min(0.0) for v, sign in each]
    return magnitudes, [((v if sign is None else sign) > 0).to(v.dtype) for v, sign in each]


def _rewire(system: nn.Module, _: object) -> None:
    """Let the table say what a loaded checkpoint has put into the components."""
    cast(System, system)._wire()


def check_place(where: str, kind: type[Component], joints: Sequence[str]) -> None:
    """Raise InputError where a system with these joints has no such place, or the place takes no such component."""
    joint, _, place = where.rpartition("/")
    if not joint:  # a near name of some joint's place would be a guess which joint is meant
        usual = difflib.get_close_matches(place, kind.places, n=1) or kind.places
        raise InputError(
            f"Place '{where}' names no joint; write JOINT/{' or JOINT/'.join(usual)}, JOINT one of {', '.join(joints)}."
        )
    if joint not in joints or place not in PLACES:
        near = close_match(where, (f"{one}/{other}" for one in joints for other in kind.places))
        raise InputError(
            f"Place '{where}' is not known{near}; use one of {', '.join(joints)} with one of {', '.join(PLACES)}."
        )
    if place not in kind.places:
        raise InputError(f"{kind.kind} cannot sit in '{where}'; it belongs in {' or '.join(kind.places)}.")


def acts_along(kind: type[Component], place: str, gear_ratio: float) -> bool:
    """Whether a component at a joint that slides has a force and a way, and not a torque and an angle.

    Without a gear the whole drive moves along the axis; behind one, what is on the motor's side turns.
    """
    if issubclass(kind, Shared):
        return False
    at_motor = place in TURNING if kind.at_motor is None else kind.at_motor
    return gear_ratio == 1.0 or not at_motor


def parameter_table(
    components: nn.ModuleDict, aliases: Mapping[tuple[str, str], str], linear: Collection[str] = ()
) -> list[ParameterInfo]:
    """All parameters in the components' order.

    A name is the alias, or the symbol where no other component has it, or the symbol with the component's key.

    Args:
        components: by key, ``joint1/motor_friction/coulomb_friction``.
        aliases: preferred names by key and symbol.
        linear: keys of what acts along a linear axis.
    """
    entries = [(key, s) for key, c in components.items() for s in cast(Component, c).declared]
    symbols = [symbol for _, symbol in entries]
    table = []
    for key, symbol in entries:
        part = cast(Component, components[key])
        name = aliases.get((key, symbol))
        if name is None:
            joint, place, kind = key.split("/")
            name = symbol if symbols.count(symbol) == 1 else f"{symbol}_{joint}_{place}_{kind}"
        spec = part.specs[symbol]
        table.append(ParameterInfo(name, key, symbol, part.declared[symbol].doc, spec, key in linear))
    return table
