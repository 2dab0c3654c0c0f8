"""What an effect is: a name, a place, values, and what it does to a machine."""

import copy
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, Self

import numpy as np

from hybrid_id.machines.physics.law import Lanes, Law
from hybrid_id.machines.physics.machine import Drive, Machine
from hybrid_id.machines.robots import Robot

UNKNOWN = "unknown"
"""Name of all effects outside the catalogue."""

CATALOGUE: dict[str, list[type["Effect"]]] = {}
"""Formulas of each named effect."""
OUTSIDE: list[type["Effect"]] = []
"""Effects that the catalogue has no name for."""

Draw = Callable[[np.random.Generator, Any, int], Any]
"""Draws a value of an effect at a joint of a robot, or an arm."""
Unit = Callable[[Any, int], Any]
"""A size that suits a joint of a robot, or an arm."""


class Effect(Law):
    """One effect at one joint, in one formula; a subclass with a place is a formula.

    A formula is a law of the package's physics (`made`), a law itself that overrides `act` of a rotor or link, `volts`
    of an amplifier or `torque` of a gear's spring, or it alters the robot or the machine.

    Attributes:
        name: as in the table of names; `unknown` outside the catalogue.
        place: in the drive's chain.
        systems: where it can be met.
        drawn: how each of `values` is drawn, in plausible size.
        sized: keys of `values` that grow with the effect.
        shapes: keys of `values`, beside the sized ones, that a re-fit may move.
        signed: keys of `values` that may be negative.
        substeps: steps a sample that a fit of it needs.
        replaces: whether it takes the place of a part of the drive: of size zero it is not gone.
        formula: what the ground truth calls it, and who asks for this formula alone; the name of the class by default.
        alias: a second name of the catalogue and its place that mean the same.
        made, options: the law that it adds, called with its values, and further arguments.
        memory: states (B,) of an effect that is a law itself, each with `_` before its name, zero at rest.
        robot: that a law acts on.
        joint: 0 or 1.
        values: its parameters, each a number or one for each lane.
    """

    name: ClassVar[str]
    place: ClassVar[str]
    systems: ClassVar[tuple[str, ...]] = ("one_link", "one_link_flexible", "two_link")
    drawn: ClassVar[Mapping[str, Draw]] = {}
    sized: ClassVar[tuple[str, ...]]
    shapes: ClassVar[tuple[str, ...]] = ()
    signed: ClassVar[tuple[str, ...]] = ()
    substeps: ClassVar[int] = 1
    replaces: ClassVar[bool] = False
    formula: ClassVar[str]
    alias: ClassVar[tuple[str, str] | None] = None
    made: ClassVar[Any] = None
    options: ClassVar[Mapping[str, Any]] = {}
    memory: ClassVar[tuple[str, ...]] = ()
    robot: Any

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        if "formula" not in cls.__dict__:
            cls.formula = cls.__name__
        if hasattr(cls, "place"):
            (OUTSIDE if cls.name == UNKNOWN else CATALOGUE.setdefault(cls.name, [])).append(cls)

    def __init__(self, joint: int, values: Mapping[str, Any]) -> None:
        self.joint = joint
        self.values: dict[str, Any] = dict(values)

    @classmethod
    def draw(cls, rng: np.random.Generator, robot: Any, joint: int) -> Self:
        """An effect of plausible size for a robot, or an arm."""
        return cls(joint, {key: draw(rng, robot, joint) for key, draw in cls.drawn.items()})

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
        """What the ground truth says of it: its values, in the symbols of the formula."""
        return {key: float(f"{float(np.mean(value)):.4g}") for key, value in self.values.items()}

    def alter(self, robot: Robot) -> Robot:
        """The robot with the effect, where it is a parameter that the nominal model lacks."""
        return robot

    def start(self, lanes: int) -> None:
        """Set the memory of B runs to rest."""
        for name in self.memory:
            setattr(self, f"_{name}", np.zeros(lanes))

    def law(self, robot: Any) -> Any:
        """The law that it adds."""
        if self.made is not None:
            return self.made(*self.values.values(), **self.options)
        law = copy.copy(self)
        law.robot = robot
        return law

    def install(self, machine: Machine, robot: Any) -> None:
        """Build the effect into a machine, in place."""
        law, drive, kind = self.law(robot), self.drive(machine), type(self)
        if kind.torque is not Law.torque:
            drive.spring = law
        elif kind.volts is not Law.volts:
            drive.amplifier.append(law)
        elif law.act.__func__ is not Law.act:
            (drive.link_laws if self.place in ("load", "link_friction") else drive.rotor_laws).append(law)

    def drive(self, machine: Machine) -> Drive:
        """The joint that it acts on, which may stand by itself."""
        return machine.drives[self.joint if len(machine.drives) > 1 else 0]


def uniform(
    low: float, high: float, unit: Unit | None = None, *, either: bool = False, log: bool = False
) -> Draw:
    """Draws a number between two limits, in a unit, of either sign, evenly on a linear or a logarithmic scale."""

    def draw(rng: np.random.Generator, robot: Any, joint: int) -> Any:
        side = rng.choice([-1, 1]) if either else 1
        size = side * (1.0 if unit is None else unit(robot, joint))
        return size * (
            float(np.exp(rng.uniform(np.log(low), np.log(high)))) if log else rng.uniform(low, high)
        )

    return draw


def choice(values: Sequence[float]) -> Draw:
    """Draws one of several numbers."""
    return lambda rng, robot, joint: float(rng.choice(values))


def supply(rng: np.random.Generator, robot: Robot, joint: int) -> float:
    """Voltage that the amplifier is built for [V], as a value."""
    return robot.supply


def stall(robot: Robot, joint: int) -> Any:
    """Torque of a motor at full voltage and standstill [N m]."""
    return robot.value(joint, "P_m1") * robot.supply


def dry(robot: Robot, joint: int) -> Any:
    """A dry friction that suits the joint [N m]: its own, or a few per cent of the stall torque."""
    own = np.asarray(robot.value(joint, "F_c"))
    return np.where(own > 0, own, 0.03 * stall(robot, joint))[()]


def dry_at_link(robot: Robot, joint: int) -> Any:
    """The same behind the gear [N m]."""
    return dry(robot, joint) * robot.ratio[joint]


def fast(robot: Robot, joint: int) -> Any:
    """A third of a motor's no-load speed [rad/s]."""
    return robot.supply / robot.value(joint, "P_m2") / 3


def link_inertia(robot: Robot, joint: int) -> Any:
    """Inertia behind a gear [kg m^2]."""
    return robot.inertia(joint) * robot.ratio[joint] ** 2 * (1 - robot.rotor_share[joint])
