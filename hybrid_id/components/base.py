"""What every component is: a torch module with declared parameters that sits in one place of the drive chain.

A component reads its parameters from a *view* ``p`` (``p.F_c``, each shaped ``(1,)`` or ``(B,)``), never from its own
attributes, so that values shared by all lanes and values that differ from lane to lane run through the same equations.

A law's class holds all that is particular to it: its equations; as ``effect`` and ``starts`` what a diagnosis has to
know to suspect it; as ``mjcf`` what it becomes in MuJoCo. Friction needs no ``mjcf``: ``export/curves.py:
friction_curve`` samples its ``dry`` level and ``smooth`` torque, and ``export/drives.py`` writes the curve as
``frictionloss`` and ``damping``. Subclassing registers it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, cast

import torch
from torch import Tensor, nn

from hybrid_id.errors import InputError
from hybrid_id.parameters import Bounded, Parameter

if TYPE_CHECKING:
    from hybrid_id.components.site import Searches, Site

PLACES = ("input", "motor", "motor_friction", "transmission", "link_friction", "load", "sensor")
REGISTRY: dict[str, type[Component]] = {}
"""Every law by its kind."""
CATALOGUE: dict[str, Effect] = {}
"""Every effect that a diagnosis can name, by name; :class:`Component` fills it as each law's class is defined."""

Values = Mapping[str, float | Bounded | str]
"""Parameter values by symbol: a number takes the bounds of its declaration. What sits at a point has that, too."""
Counterpart = tuple[Mapping[str, Sequence[float]], str]
"""Attributes of an MJCF element, and the rest of a sentence on what of the law they leave out; empty for nothing."""


@dataclass(frozen=True)
class Effect:
    """What a diagnosis says of one effect, which one law models or several do.

    Attributes:
        name: how a diagnosis calls it.
        about: what it is; after a semicolon how large it usually is.
        source: where it is described: authors, title, where it appeared, year.
        mistaken_for: effects that records easily confuse with it, each with the excitation that distinguishes the two.
            Either of the two may state a pair.
        smoothness: of its torque or voltage: ``smooth``, or where it jumps or kinks.
        contains: effects that are special cases of it at the same place: it is no rival of theirs.
        over_angle: whether it is a torque over an angle: free runs then halt at one detent or the next.
        shape: fixed parameters that belong to the answer (the periods of a wave), each with the estimated one that it
            goes with.
        where_held: whether it is also looked for where its law is there with its parameters held.
        whole: parameters that are whole numbers in a machine whose gear ratio is right: a motor's periods per turn.
    """

    name: str
    about: str
    source: str
    mistaken_for: Mapping[str, str] = field(default_factory=dict)
    smoothness: str = "smooth"
    contains: tuple[str, ...] = ()
    over_angle: bool = False
    shape: Mapping[str, str] = field(default_factory=dict)
    whole: tuple[str, ...] = ()
    where_held: bool = False

    @property
    def laws(self) -> list[type[Component]]:
        """The laws that model it."""
        return [law for law in REGISTRY.values() if law.effect is not None and law.effect.name == self.name]

    @property
    def kinds(self) -> tuple[str, ...]:
        """Their names in model files."""
        return tuple(law.kind for law in self.laws)

    @property
    def places(self) -> tuple[str, ...]:
        """Where it may act, most usual first: where all of its laws may sit."""
        first, *others = self.laws
        return tuple(place for place in first.places if all(place in law.places for law in others))


class Component(nn.Module):
    """Base of everything that acts in the drive chain.

    A subclass sets ``kind`` (its name in model files), ``places`` (where it may sit), declares its parameters as
    class attributes of type :class:`Parameter`, lists its own ODE states in ``states`` and overrides the methods of
    its place's interface. Stored values are physical values in the declared unit.

    Args:
        values: parameter values by symbol, a number or a :class:`Bounded` (with bounds, role, prior).

    Raises:
        InputError: unknown parameter, or a value outside its bounds.
    """

    kind: ClassVar[str] = ""
    places: ClassVar[tuple[str, ...]] = ()
    single: ClassVar[bool] = False
    """Whether its place holds exactly one component (a new one replaces the old one)."""
    states: tuple[str, ...] = ()
    declared: ClassVar[dict[str, Parameter]] = {}
    effect: ClassVar[Effect | None] = None
    """What a diagnosis calls it; None for what is part of every model and never suspected."""
    at_motor: ClassVar[bool | None] = None
    """Whether it acts at the motor and not at the link, which matters behind a gear; None where its place says it."""
    splits_inertia: ClassVar[bool] = False
    """Whether it needs the split of inertia between rotor and link, which is then estimated with it."""
    left_out: ClassVar[str] = "is left out, MuJoCo has no counterpart"
    """What an export to MuJoCo says where it has no attributes for it."""

    def __init_subclass__(cls, **kwargs: object) -> None:
        super().__init_subclass__(**kwargs)
        own = {name: value for name, value in vars(cls).items() if isinstance(value, Parameter)}
        for name in own:
            delattr(cls, name)  # else the class attribute would hide the torch parameter of the same name
        cls.declared = {**cls.declared, **own}
        if cls.kind:
            REGISTRY[cls.kind] = cls
            if cls.effect is not None:
                CATALOGUE[cls.effect.name] = cls.effect

    def __init__(self, **values: float | Bounded) -> None:
        super().__init__()
        self.specs: dict[str, Bounded] = {}
        for name in values:
            if name not in self.declared:
                known = ", ".join(self.declared) or "none"
                raise InputError(f"{self.kind} has no parameter '{name}'; it has {known}.")
        for name, declaration in self.declared.items():
            value = values.get(name)
            spec = value if isinstance(value, Bounded) else declaration.bounded(value)
            self.specs[name] = spec.check(name)
            self.register_parameter(name, nn.Parameter(torch.tensor(spec.value, dtype=torch.float64)))
        self.register_load_state_dict_post_hook(_adopt_loaded)

    @classmethod
    def family(cls) -> type[Component]:
        """The base class of which a place holds exactly one, or the class itself."""
        return [base for base in cls.__mro__ if getattr(base, "single", False) or base is cls][-1]

    def view(self) -> SimpleNamespace:
        """The stored values as a view, each shaped ``(1,)``; gradients flow to the torch parameters."""
        return SimpleNamespace(**{name: getattr(self, name).reshape(1) for name in self.declared})

    @classmethod
    def restored(cls, values: Mapping[str, Bounded], options: Mapping, weights: Mapping) -> Component:
        """The component that a model file describes."""
        if options or weights:
            raise InputError(f"{cls.kind} has neither options nor weights; remove them.")
        return cls(**values)

    def options(self) -> dict[str, Any]:
        """What a model file says of it beside its parameters."""
        return {}

    @staticmethod
    def starts(site: Site) -> Sequence[Values]:
        """Start values of its fit where a diagnosis suspects it; none where it cannot act.

        Zero torque should be inside the bounds or on one, so that the model without it is a special case.
        """
        return ()

    def further(self, searches: Searches) -> Sequence[Values]:
        """Start values of what is held while it is looked for, and freed once it is chosen, where that pays."""
        return ()

    def mjcf(self, p: SimpleNamespace) -> Counterpart:
        """What it becomes in MuJoCo: attributes of its place's element, and what they leave out of it.

        Of a load they are ``bias``, a torque [N m], or ``stiffness`` [N m/rad] and ``rest`` [rad] of a spring; of
        a bristle its stiffness [N m/rad] and damping [N m s/rad]; a motor becomes a ``dcmotor`` by its ``motorconst``.
        """
        return {}, self.left_out

    def extra_repr(self) -> str:
        """Parameters in the printed module."""
        return ", ".join(f"{name}={getattr(self, name).item():g} {s.unit}" for name, s in self.specs.items())


def _adopt_loaded(part: nn.Module, _: object) -> None:
    """Let the specifications say what a loaded checkpoint has put into the torch parameters."""
    specs = cast(Component, part).specs
    specs |= {name: spec.at(getattr(part, name).item()).check(name) for name, spec in specs.items()}


class Input(Component):
    """Place ``input``: logged channels to the voltage (or torque, or current) at the motor."""

    places = ("input",)
    left_out = "stays with the controller"
    single = True
    gives: ClassVar[str] = "V"
    """Unit of its command."""
    channels: ClassVar[tuple[str, ...]] = ()
    """Channels that it reads, without the joint's number."""
    at_joint: ClassVar[bool] = False
    """Whether it reads the link's motion and commands a torque at the joint, not the rotor's and at the motor."""

    def command(
        self, p: SimpleNamespace, channels: Mapping[str, Tensor], angle: Tensor, speed: Tensor
    ) -> Tensor:
        """Effective command, ``(B,)``, in the unit that the motor takes."""
        raise NotImplementedError


class ServoLoop(Input):
    """An input that closes a position loop: it compares its channel ``goal`` with the angle that it reads.

    The channel ``integral`` [rad], which a :class:`LoopStage` may add, counts to the error.
    """

    def aim(self, p: SimpleNamespace, channels: Mapping[str, Tensor]) -> Tensor:
        """Goal [rad] as the loop takes it, ``(B,)``."""
        return channels["goal"]

    def error(self, p: SimpleNamespace, channels: Mapping[str, Tensor], angle: Tensor) -> Tensor:
        """Error [rad] that is left to a loop without an integral, ``(B,)``."""
        return self.aim(p, channels) - angle

    @staticmethod
    def with_integral(error: Tensor, channels: Mapping[str, Tensor]) -> Tensor:
        """The error with what an integral adds to it."""
        integral = channels.get("integral")
        return error if integral is None else error + integral


class StateUpdate(NamedTuple):
    """How one state that remembers goes on, ``dz/dt = drive - rate z``, no further than ``low`` and ``high``."""

    drive: Tensor
    rate: Tensor
    low: Tensor | None = None
    high: Tensor | None = None


class LoopStage(Component):
    """Place ``input``: one state of a position loop beside its gains, stepped exactly at constant motion."""

    places = ("input",)
    left_out = "is left out, MuJoCo's position actuator has no such part"

    def goal(self, p: SimpleNamespace, aim: Tensor, state: Tensor) -> Tensor:
        """Goal [rad] that the loop follows, ``(B,)``, of the one that it takes."""
        return aim

    def reading(
        self, p: SimpleNamespace, angle: Tensor, speed: Tensor, state: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Angle [rad] and speed [rad/s] that the loop reads, ``(B,)`` each, of the true ones."""
        return angle, speed

    def integral(self, p: SimpleNamespace, state: Tensor) -> Tensor | None:
        """What counts to the error [rad], ``(B,)``."""
        return None

    def state_update(
        self, p: SimpleNamespace, aim: Tensor, error: Tensor, speed: Tensor, state: Tensor
    ) -> StateUpdate:
        """How its state goes on.

        Args:
            p: parameter view.
            aim: goal that the loop takes [rad], ``(B,)``.
            error: what is left of it without an integral [rad], ``(B,)``.
            speed: true speed of what the loop reads [rad/s], ``(B,)``.
            state: the state, ``(B,)``.
        """
        raise NotImplementedError

    def start(self, p: SimpleNamespace, aim: Tensor, speed: Tensor) -> Tensor:
        """Its state after a long time at this goal and speed, ``(B,)``, as far as these tell."""
        return torch.zeros_like(aim)


class CommandMap(Component):
    """Place ``input``: changes the effective command on its way to the motor."""

    places = ("input",)
    left_out = "is left out, MuJoCo's actuators have no such map"
    stage: ClassVar[int] = 1
    """Where along the way: what a driver does to small commands (0), its limits (1), the supply behind them (2)."""

    def map(self, p: SimpleNamespace, command: Tensor, speed: Tensor) -> Tensor:
        """What becomes of the command, ``(B,)``, in its own unit, at a rotor speed [rad/s]."""
        raise NotImplementedError


class Motor(Component):
    """Place ``motor``: effective command and rotor speed to motor torque."""

    places = ("motor",)
    left_out = "is left out, MuJoCo has no such motor"
    single = True
    takes: ClassVar[str] = "V"
    """Unit of the command that it takes; empty where any will do."""

    def torque(self, p: SimpleNamespace, command: Tensor, speed: Tensor) -> Tensor:
        """Motor torque on the rotor [N m], ``(B,)``."""
        raise NotImplementedError

    def current(self, p: SimpleNamespace, torque: Tensor) -> Tensor:
        """Winding current [A] behind a motor torque [N m], ``(B,)``."""
        raise InputError(
            f"A {self.kind} has no current output; measure torque or use a dc_motor or current_motor."
        )


class RotorTorque(Component):
    """Place ``motor``: a torque on the rotor beside the motor's own, there with the motor switched off too."""

    places = ("motor",)
    left_out = "is left out, MuJoCo's motor has no such torque"

    def torque(self, p: SimpleNamespace, angle: Tensor, speed: Tensor) -> Tensor:
        """Torque that drives the rotor [N m], ``(B,)``, at its angle [rad] and speed [rad/s]."""
        raise NotImplementedError


class Winding(Component):
    """Place ``motor``: what the winding remembers, current or heat; it changes the motor's torque.

    Each state relaxes, ``dz/dt = drive - rate z``, and is stepped exactly.
    """

    places = ("motor",)

    def torque(self, p: SimpleNamespace, torque: Tensor, states: Sequence[Tensor]) -> Tensor:
        """Torque [N m], ``(B,)``, that becomes of the one without this component."""
        raise NotImplementedError

    def state_updates(
        self, p: SimpleNamespace, torque: Tensor, states: Sequence[Tensor]
    ) -> list[tuple[Tensor, Tensor]]:
        """Drive and rate [1/s] of each state, ``(B,)`` each; ``torque`` is the one without this component."""
        raise NotImplementedError

    def mjcf(self, p: SimpleNamespace, resistance: float, constant: float) -> Counterpart:
        """Attributes of MuJoCo's ``dcmotor`` of that resistance [ohm] and torque constant [N m/A]."""
        return {}, "is left out, MuJoCo's winding knows inductance and heat"


class Friction(Component):
    """Places ``motor_friction`` and ``link_friction``: speed to a torque that has the sign of the speed.

    The equation of motion subtracts it. A law contributes a ``smooth`` torque, a ``dry`` level, a ``load_factor``
    or a bristle; levels on one speed add up to the interval [-F, F] inside which dry friction holds the joint.
    """

    places = ("motor_friction", "link_friction")
    left_out = (
        ""  # the export samples a law's smooth torque and dry level, and says itself what else it leaves out
    )
    has_level: ClassVar[bool] = False
    """Whether it is a level of dry friction by itself, to which the laws of falls, waves and bristles add."""
    by_direction: ClassVar[bool] = False
    """Whether that level is a whole curve for each direction, beside which no other is looked for."""

    def smooth(self, p: SimpleNamespace, speed: Tensor) -> Tensor | None:
        """Torque that is smooth in ``speed`` [N m], ``(B,)``."""
        return None

    def dry(self, p: SimpleNamespace, magnitude: Tensor, forward: Tensor) -> Tensor | None:
        """Level of dry friction [N m] >= 0, ``(B,)``.

        Args:
            p: parameter view.
            magnitude: |speed|, ``(B,)``.
            forward: 1.0 in lanes that move (or are pushed) in the positive direction, else 0.0, ``(B,)``.
        """
        return None

    def dry_over(self, p: SimpleNamespace, angle: Tensor) -> Tensor | None:
        """What the joint's angle [rad, at the link] adds to the dry level [N m], ``(B,)``, of either sign."""
        return None

    def load_factor(self, p: SimpleNamespace) -> Tensor | None:
        """Dry friction per unit of torque through the gear [1], ``(1,)`` or ``(B,)``."""
        return None

    def effort_factor(self, p: SimpleNamespace) -> Tensor | None:
        """Dry friction per unit of the motor's torque [1], ``(1,)`` or ``(B,)``."""
        return None


class Transmission(Component):
    """Place ``transmission``: rotor and link motion to the torque in the gear."""

    places = ("transmission",)
    single = True
    rigid: ClassVar[bool] = False

    def torque(self, p: SimpleNamespace, deflection: Tensor, rate: Tensor, inertia: Tensor) -> Tensor:
        """Spring torque at the link [N m] from deflection q_m/r - q_a [rad] and its rate [rad/s], ``(B,)``.

        ``inertia`` is rotor and link in series, at the link [kg m^2]: with a stiffness it gives a frequency.
        """
        raise NotImplementedError

    def loaded(self, p: SimpleNamespace) -> Tensor | None:
        """A deflection [rad] at which the spring is as stiff as it gets, where that is not zero: steps suit it."""
        return None


class Inertia(Component):
    """Place ``load``: the moving masses of one joint, split at the gear."""

    places = ("load",)
    single = True
    carried: float = 0.0
    """Inertia at the link that a robot's tree adds with all joints at zero [kg m^2]: a scale, not in the motion."""

    def rotor(self, p: SimpleNamespace, gear_ratio: float) -> Tensor:
        """Inertia on the motor's side of the gear, at the motor [kg m^2]."""
        raise NotImplementedError

    def link(self, p: SimpleNamespace, gear_ratio: float) -> Tensor:
        """Inertia on the link's side of the gear, at the link [kg m^2]."""
        raise NotImplementedError

    def total(self, p: SimpleNamespace, gear_ratio: float) -> Tensor:
        """Both, seen at the motor through a rigid gear [kg m^2]."""
        return self.rotor(p, gear_ratio) + self.link(p, gear_ratio) / gear_ratio**2

    def behind_gear(self, p: SimpleNamespace, gear_ratio: float) -> Tensor:
        """How large the inertia at the link is, what a robot's tree carries there included [kg m^2]."""
        return self.link(p, gear_ratio) + self.carried

    def in_series(self, p: SimpleNamespace, gear_ratio: float) -> Tensor:
        """Rotor and link in series, at the link [kg m^2]: with a stiffness it gives a frequency."""
        rotor, link = self.rotor(p, gear_ratio) * gear_ratio**2, self.behind_gear(p, gear_ratio)
        return rotor * link / (rotor + link)


class LoadTorque(Component):
    """Place ``load``: a torque at the link that opposes the motor, from the link's motion."""

    places = ("load",)
    left_out = "is left out, MuJoCo has no such load"

    def torque(self, p: SimpleNamespace, angle: Tensor, speed: Tensor) -> Tensor:
        """Torque at the link [N m] that the drive must overcome, ``(B,)``."""
        raise NotImplementedError


class LoggedTorque(Component):
    """Place ``load``: a torque at the link that opposes the motor, from logged channels."""

    places = ("load",)
    channels: ClassVar[tuple[str, ...]] = ()
    """Channels that it reads, without the joint's number."""

    def torque(self, p: SimpleNamespace, channels: Mapping[str, Tensor]) -> Tensor:
        """Torque at the link [N m] that the drive must overcome, ``(B,)``."""
        raise NotImplementedError


class Coupling(Component):
    """Place ``load`` of either joint: acts on both links of an arm with two joints.

    Angles and speeds are those of the links, each joint's relative to the link before it.
    """

    places = ("load",)

    def inertia(self, p: SimpleNamespace, angle: Tensor) -> tuple[Tensor, Tensor] | None:
        """What the coupling adds to M_11 and M_12 [kg m^2] at the second joint's ``angle``, ``(B,)`` each.

        It has to be affine in the cosine of that angle: the mass matrix is checked at 0 and 180 degrees, and between
        them the determinant is then no smaller than at the worse of the two.
        """
        return None

    def torques(
        self, p: SimpleNamespace, angles: tuple[Tensor, Tensor], speeds: tuple[Tensor, Tensor]
    ) -> tuple[Tensor, Tensor]:
        """Torques at the two links [N m] that the drives must overcome, ``(B,)`` each."""
        raise NotImplementedError


class Shared(Component):
    """Place ``load`` of one joint: acts on all joints of a robot that it concerns, of which that one is listed."""

    places = ("load",)
    point: str = ""
    """Where it sits, by its name in the robot's description; empty for nowhere in particular."""


class Attached(Shared):
    """Place ``load``: sits at a named point of a robot's description, and so acts on all joints that carry it.

    Args:
        point: name of the site or body.
        values: see :class:`Component`.
    """

    option: ClassVar[str] = "point"
    """What a model file calls the name."""
    names: ClassVar[str] = "the name of a site or body of the robot"
    """What the name is of."""

    def __init__(self, point: str = "", **values: float | Bounded) -> None:
        super().__init__(**values)
        self.point = point

    def options(self) -> dict[str, str]:
        """What a model file says of it beside its parameters."""
        return {self.option: self.point}

    @classmethod
    def restored(cls, values: Mapping[str, Bounded], options: Mapping, weights: Mapping) -> Component:
        """The component that a model file describes."""
        if weights or set(options) != {cls.option} or not isinstance(options[cls.option], str):
            raise InputError(f"{cls.kind} needs one option, {cls.option}: {cls.names}.")
        return cls(options[cls.option], **values)


class Sensor(Component):
    """Place ``sensor``: the true quantity to the measured output."""

    places = ("sensor",)
    channel: ClassVar[str] = ""
    """Output that it reads, without the joint's number."""
    in_loop: ClassVar[bool] = True
    """Whether a position loop that reads this channel reads it as this sensor does."""

    def read(self, p: SimpleNamespace, value: Tensor) -> Tensor:
        """Measured output from the true quantity of its channel, ``(B,)``."""
        return value

    def mjcf(self, p: SimpleNamespace) -> Counterpart:
        """Nothing: a sensor that does something is left out."""
        acts = any(spec.value for spec in self.specs.values())
        return {}, "is left out, the exported sensors read true angles, in time" if acts else ""
