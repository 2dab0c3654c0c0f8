"""Dry-friction levels of the twins: how much torque friction can oppose, by speed and side."""

from dataclasses import dataclass, fields
from typing import Protocol, Self

import numpy as np


class Lanes:
    """Base of frozen dataclasses whose fields hold one number, or one for each of B runs."""

    def __post_init__(self) -> None:
        for field in fields(self):  # type: ignore[arg-type]
            value = getattr(self, field.name)
            if not isinstance(value, Lanes):
                object.__setattr__(self, field.name, np.asarray(value, dtype=float))

    def take(self, lanes: np.ndarray) -> Self:
        """The same object for a selection of the runs."""

        def chosen(value):
            if isinstance(value, Lanes):
                return value.take(lanes)
            return value[lanes] if value.ndim else value

        return type(self)(**{f.name: chosen(getattr(self, f.name)) for f in fields(self)})  # type: ignore[arg-type]


class DryFriction(Protocol):
    """A level of dry friction that may depend on speed and direction."""

    def level(self, speed: np.ndarray | float, side: np.ndarray | float) -> np.ndarray:
        """Opposing torque (B,) in N m at `speed` >= 0 in rad/s on the forward (side > 0) or backward side.

        Smooth in `speed` through zero, so that a step can be tried beyond the instant of stopping.
        """
        ...

    def take(self, lanes: np.ndarray) -> Self:
        """The same law for a selection of the runs."""
        ...


@dataclass(frozen=True, eq=False)
class Stribeck(Lanes):
    """Symmetric Stribeck friction, eq. (6) of the paper without its viscous term.

    F = F_c + (F_s - F_c) exp(-(v / v_s)^2). Differs from the source by the fixed exponent p_s = 2.

    | symbol | meaning | unit |
    | --- | --- | --- |
    | F_c | Coulomb level | N m |
    | F_s | level at rest; F_s = F_c is Coulomb friction | N m |
    | v_s | Stribeck velocity | rad/s |
    """

    F_c: np.ndarray | float
    F_s: np.ndarray | float
    v_s: np.ndarray | float = 1.0

    def level(self, speed: np.ndarray | float, side: np.ndarray | float) -> np.ndarray:
        """Opposing torque (B,), the same on both sides."""
        return self.F_c + (self.F_s - self.F_c) * np.exp(-np.square(speed / self.v_s))


@dataclass(frozen=True, eq=False)
class AsymmetricStribeck(Lanes):
    """Asymmetric Stribeck friction, eq. (15) of the paper, its Neg read as -Pos(-v).

    F = f_i1 + (f_i2 - f_i1) exp(-((|v| - f_i3) / f_i4)^2) with i = 1 forwards, i = 2 backwards.

    | symbol | meaning | unit |
    | --- | --- | --- |
    | f_11, f_21 | level at high speed | N m |
    | f_12, f_22 | level at the peak | N m |
    | f_13, f_23 | speed of the peak | rad/s |
    | f_14, f_24 | width of the peak | rad/s |
    """

    f_11: np.ndarray | float
    f_12: np.ndarray | float
    f_13: np.ndarray | float
    f_14: np.ndarray | float
    f_21: np.ndarray | float
    f_22: np.ndarray | float
    f_23: np.ndarray | float
    f_24: np.ndarray | float

    def level(self, speed: np.ndarray | float, side: np.ndarray | float) -> np.ndarray:
        """Opposing torque (B,) of the given side."""
        forwards = self.f_11 + (self.f_12 - self.f_11) * np.exp(-np.square((speed - self.f_13) / self.f_14))
        backwards = self.f_21 + (self.f_22 - self.f_21) * np.exp(-np.square((speed - self.f_23) / self.f_24))
        return np.where(np.greater(side, 0), forwards, backwards)


@dataclass(frozen=True, eq=False)
class LinkFriction(Lanes):
    """Friction on the link's side, eq. (9) of the paper as the reading notes have it.

    tau_fa = (f_a1 Pos(v) + f_a2 Pos(-v)) tanh(70 v). Smooth at rest, so that it brakes and does not hold.

    | symbol | meaning | unit |
    | --- | --- | --- |
    | v | speed of the link | rad/s |
    | f_a1, f_a2 | level forwards and backwards, at the link | N m |
    """

    f_a1: np.ndarray | float
    f_a2: np.ndarray | float

    def torque(self, v: np.ndarray) -> np.ndarray:
        """tau_fa (B,) [N m], of the sign of v."""
        return np.where(v > 0, self.f_a1, self.f_a2) * np.tanh(70.0 * v)
