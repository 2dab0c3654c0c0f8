"""What every component is: a torch module with declared parameters that sits in one place of the drive chain.

A component reads its parameters from a *view* ``p`` (``p.F_c``, each shaped ``(1,)`` or ``(B,)``), never from its own
attributes, so that values shared by all lanes and values that differ from lane to lane run through the same equations.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import ClassVar, cast

import torch
from torch import Tensor, nn

from hybrid_id.errors import InputError
from hybrid_id.parameters import Bounded, Parameter

PLACES = ("input", "motor", "motor_friction", "transmission", "link_friction", "load", "sensor")
REGISTRY: dict[str, type[Component]] = {}


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

    def __init_subclass__(cls, **kwargs: object) -> None:
        super().__init_subclass__(**kwargs)
        own = {name: value for name, value in vars(cls).items() if isinstance(value, Parameter)}
        for name in own:
            delattr(cls, name)  # else the class attribute would hide the torch parameter of the same name
        cls.declared = {**cls.declared, **own}
        if cls.kind:
            REGISTRY[cls.kind] = cls

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
    single = True
    gives: ClassVar[str] = "V"
    """Unit of its command."""
    channels: ClassVar[tuple[str, ...]] = ()
    """Channels that it reads, without the joint's number."""

    def command(
        self, p: SimpleNamespace, channels: Mapping[str, Tensor], angle: Tensor, speed: Tensor
    ) -> Tensor:
        """Effective command, ``(B,)``, in the unit that the motor takes."""
        raise NotImplementedError


class Motor(Component):
    """Place ``motor``: effective command and rotor speed to motor torque."""

    places = ("motor",)
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


class Friction(Component):
    """Places ``motor_friction`` and ``link_friction``: speed to a torque that has the sign of the speed.

    The equation of motion subtracts it. A law contributes a ``smooth`` torque, a ``dry`` level, a ``load_factor``
    or a bristle; levels on one speed add up to the interval [-F, F] inside which dry friction holds the joint.
    """

    places = ("motor_friction", "link_friction")

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
        """Dry friction per unit of torque through the gear [1]."""
        return None

    def effort_factor(self, p: SimpleNamespace) -> Tensor | None:
        """Dry friction per unit of the motor's torque [1]."""
        return None


class Transmission(Component):
    """Place ``transmission``: rotor and link motion to the torque in the gear."""

    places = ("transmission",)
    single = True
    rigid: ClassVar[bool] = False

    def torque(self, p: SimpleNamespace, deflection: Tensor, rate: Tensor, inertia: Tensor) -> Tensor:
        """Spring torque at the link [N m] from deflection q_m/r - q_a [rad] and its rate [rad/s], ``(B,)``.

        ``inertia`` is rotor and link in series, at the link [kg m^2]: with a stiffness it tells a frequency.
        """
        raise NotImplementedError

    def loaded(self, p: SimpleNamespace) -> Tensor | None:
        """A deflection [rad] at which the spring is as stiff as it gets, where that is not zero: steps suit it."""
        return None


class Inertia(Component):
    """Place ``load``: the moving masses of one joint, split at the gear."""

    places = ("load",)
    single = True

    def rotor(self, p: SimpleNamespace, gear_ratio: float) -> Tensor:
        """Inertia on the motor's side of the gear, at the motor [kg m^2]."""
        raise NotImplementedError

    def link(self, p: SimpleNamespace, gear_ratio: float) -> Tensor:
        """Inertia on the link's side of the gear, at the link [kg m^2]."""
        raise NotImplementedError

    def total(self, p: SimpleNamespace, gear_ratio: float) -> Tensor:
        """Both, seen at the motor through a rigid gear [kg m^2]."""
        return self.rotor(p, gear_ratio) + self.link(p, gear_ratio) / gear_ratio**2


class LoadTorque(Component):
    """Place ``load``: a torque at the link that opposes the motor, from the link's motion."""

    places = ("load",)

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


class Sensor(Component):
    """Place ``sensor``: the true quantity to the measured output."""

    places = ("sensor",)
    channel: ClassVar[str] = ""
    """Output that it reads, without the joint's number."""

    def read(self, p: SimpleNamespace, value: Tensor) -> Tensor:
        """Measured output from the true quantity of its channel, ``(B,)``."""
        return value
