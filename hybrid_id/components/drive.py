"""What may act between the logged command and the rotor beside the one input and the one motor."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import ClassVar

from torch import Tensor

from hybrid_id.components.base import Component


class CommandMap(Component):
    """Place ``input``: changes the effective command on its way to the motor."""

    places = ("input",)
    stage: ClassVar[int] = 1
    """Where along the way: what a driver does to small commands (0), its limits (1), the supply behind them (2)."""

    def map(self, p: SimpleNamespace, command: Tensor, speed: Tensor) -> Tensor:
        """What becomes of the command, ``(B,)``, in its own unit, at a rotor speed [rad/s]."""
        raise NotImplementedError


class RotorTorque(Component):
    """Place ``motor``: a torque on the rotor beside the motor's own, there with the motor switched off too."""

    places = ("motor",)

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

    def relaxations(
        self, p: SimpleNamespace, torque: Tensor, states: Sequence[Tensor]
    ) -> list[tuple[Tensor, Tensor]]:
        """Drive and rate [1/s] of each state, ``(B,)`` each; ``torque`` is the one without this component."""
        raise NotImplementedError
