"""What an effect is: a name, a place, values, and what it does to a machine."""

from collections.abc import Mapping
from typing import Any, ClassVar, Self

import numpy as np

from hybrid_id.machines.physics.law import InputLaw, Lanes, Law, Push, Signals
from hybrid_id.machines.physics.machine import Drive, Machine
from hybrid_id.machines.physics.transmission import Spring
from hybrid_id.machines.robots import Robot

UNKNOWN = "unknown"
"""Name of all effects outside the catalogue."""

CATALOGUE: dict[str, list[type["Effect"]]] = {}
"""Formulas of each named effect."""
OUTSIDE: list[type["Effect"]] = []
"""Effects that the catalogue has no name for."""


class Effect:
    """One effect at one joint, in one formula; a subclass is a formula.

    Attributes:
        name: as in the table of names; `unknown` outside the catalogue.
        place: in the drive's chain.
        systems: where it can be met.
        sized: keys of `values` that grow with the effect.
        size_keys: key of `values` -> name in the ground truth.
        shapes: keys of `values`, beside the sized ones, that a re-fit may move.
        signed: keys of `values` that may be negative.
        substeps: steps a sample that a fit of it needs.
        replaces: whether it takes the place of a part of the drive: of size zero it is not gone.
        formula: what the ground truth calls it, and who asks for this formula alone; the name of the class by default.
        alias: a second name of the catalogue and its place that mean the same.
        memory: states (B,) of an effect that is a law itself, zero at rest.
        joint: 0 or 1.
        values: its parameters, each a number or one for each lane.
    """

    name: ClassVar[str]
    place: ClassVar[str]
    systems: ClassVar[tuple[str, ...]] = ("one_link", "one_link_flexible", "two_link")
    sized: ClassVar[tuple[str, ...]]
    size_keys: ClassVar[Mapping[str, str]] = {}
    shapes: ClassVar[tuple[str, ...]] = ()
    signed: ClassVar[tuple[str, ...]] = ()
    substeps: ClassVar[int] = 1
    replaces: ClassVar[bool] = False
    formula: ClassVar[str]
    alias: ClassVar[tuple[str, str] | None] = None
    memory: ClassVar[tuple[str, ...]] = ()

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        if "formula" not in cls.__dict__:
            cls.formula = cls.__name__
        if "draw" in cls.__dict__ or "place" in cls.__dict__:
            if cls.name == UNKNOWN:
                OUTSIDE.append(cls)
            else:
                CATALOGUE.setdefault(cls.name, []).append(cls)

    def __init__(self, joint: int, values: Mapping[str, Any]) -> None:
        self.joint = joint
        self.values: dict[str, Any] = dict(values)

    @classmethod
    def draw(cls, rng: np.random.Generator, robot: Any, joint: int) -> Self:
        """An effect of plausible size for a robot, or an arm."""
        raise NotImplementedError

    @classmethod
    def fits(cls, robot: Any) -> bool:
        """Whether a robot, or an arm, can have it."""
        return robot.system in cls.systems

    @classmethod
    def acts_at(cls, robot: Robot, joint: int) -> bool:
        """Whether it can act at a joint: uncoupled, a second link has no inertia behind its gear."""
        return not (joint and cls.place == "transmission" and "P_4" in robot.lacks)

    @property
    def where(self) -> str:
        """Joint and place."""
        return f"joint{self.joint + 1}/{self.place}"

    def scaled(self, factor: Lanes) -> Self:
        """The same effect, larger or smaller; a factor may differ from lane to lane, (B,)."""
        grown = {key: value * factor for key, value in self.values.items() if key in self.sized}
        return self.with_values(grown)

    def with_values(self, values: Mapping[str, Any]) -> Self:
        """The same effect with some other values."""
        return type(self)(self.joint, {**self.values, **values})

    def size(self) -> dict[str, float]:
        """What the ground truth says of it."""
        keys = self.size_keys or {key: key for key in self.values}
        return {name: float(f"{float(np.mean(self.values[key])):.4g}") for key, name in keys.items()}

    def alter(self, robot: Robot) -> Robot:
        """The robot with the effect, where it is a parameter that the nominal model lacks."""
        return robot

    def act(self, push: Push, x: Signals, m: Any) -> None:
        """What an effect that is a law itself adds at its place; `m` has its memory, each with `_`, and the `robot`."""

    def volts(self, volts: np.ndarray, x: Signals, m: Any) -> np.ndarray:
        """What an effect that is a law of the amplifier itself makes of a voltage (B,) [V]; `m` as above."""
        return volts

    def torque(self, twist: np.ndarray, rate: np.ndarray, step: float, m: Any) -> np.ndarray:
        """Torque on the link (B,) [N m] of an effect that is a gear's spring itself; `m` as above."""
        raise NotImplementedError

    def law(self, robot: Any) -> Law | InputLaw | None:
        """The law that it adds at its place, itself if it acts; None where it is a parameter, or replaces a part."""
        if type(self).volts is not Effect.volts:
            return ActingInput(self, robot)
        return Acting(self, robot) if type(self).act is not Effect.act else None

    def install(self, machine: Machine, robot: Any) -> None:
        """Build the effect into a machine, in place."""
        law, drive = self.law(robot), self.drive(machine)
        if isinstance(law, InputLaw):
            drive.amplifier.append(law)
        elif law is not None:
            (drive.link_laws if self.place in ("load", "link_friction") else drive.rotor_laws).append(law)

    def drive(self, machine: Machine) -> Drive:
        """The joint that it acts on, which may stand by itself."""
        return machine.drives[self.joint if len(machine.drives) > 1 else 0]


class _WithMemory:
    """An effect that is a law itself, the robot that it acts on, and its memory."""

    def __init__(self, effect: Effect, robot: Any) -> None:
        self.effect: Any = effect
        self.robot = robot

    def start(self, lanes: int) -> None:
        """Set the memory of B runs to rest."""
        for name in self.effect.memory:
            setattr(self, f"_{name}", np.zeros(lanes))


class Acting(_WithMemory, Law):
    """An effect as a law."""

    def act(self, push: Push, x: Signals) -> None:
        """Add what the effect contributes."""
        self.effect.act(push, x, self)


class ActingInput(_WithMemory, InputLaw):
    """An effect as a law of the amplifier."""

    def volts(self, volts: np.ndarray, x: Signals) -> np.ndarray:
        """Voltage behind the effect (B,) [V]."""
        return self.effect.volts(volts, x, self)


class ActingSpring(_WithMemory, Spring):
    """An effect as the spring of a gear."""

    def torque(self, twist: np.ndarray, rate: np.ndarray, step: float) -> np.ndarray:
        """Torque on the link (B,) [N m]."""
        return self.effect.torque(twist, rate, step, self)


def stall(robot: Robot, joint: int) -> Any:
    """Torque of a motor at full voltage and standstill [N m]."""
    return robot.value(joint, "P_m1") * robot.supply


def dry(robot: Robot, joint: int) -> Any:
    """A dry friction that suits the joint [N m]: its own, or a few per cent of the stall torque."""
    own = np.asarray(robot.value(joint, "F_c"))
    return np.where(own > 0, own, 0.03 * stall(robot, joint))[()]


def fast(robot: Robot, joint: int) -> Any:
    """A third of a motor's no-load speed [rad/s]."""
    return robot.supply / robot.value(joint, "P_m2") / 3


def link_inertia(robot: Robot, joint: int) -> Any:
    """Inertia behind a gear [kg m^2]."""
    return robot.inertia(joint) * robot.ratio[joint] ** 2 * (1 - robot.rotor_share[joint])
