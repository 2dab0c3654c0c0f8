"""Bounded, unit-bearing physical parameters and the view through which components read them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from hybrid_id.errors import InputError

MOST_NEURONS, MOST_LAYERS, MOST_STATES = 1000, 10, 100
"""Of a residual network at most: neurons of a hidden layer, hidden layers, hidden states."""
NARROWEST_PRIOR = 1e-9
"""Least standard deviation of a prior as a share of the parameter; a narrower one only spoils the numerics."""


@dataclass(frozen=True)
class Parameter:
    """Declaration of one physical parameter in the body of a component class.

    ``F_c = Parameter(0.01, upper=10.0, unit="N m", doc="Coulomb level")`` is all that a component needs.

    Attributes:
        default: value of a fresh component, in ``unit``.
        lower, upper: bounds in ``unit``; a value on a bound is legal (a nested fit starts there).
        unit: SI unit as text, "1" where there is none.
        doc: meaning, one line.
        estimate: whether a fit may move it by default.
    """

    default: float
    lower: float = 0.0
    upper: float = math.inf
    unit: str = "1"
    doc: str = ""
    estimate: bool = True

    def bounded(self, value: float | None = None) -> Bounded:
        """The declaration as a concrete parameter with ``value`` (default: its default)."""
        return Bounded(
            self.default if value is None else float(value), self.lower, self.upper, self.unit, self.estimate
        )


@dataclass(frozen=True)
class Bounded:
    """One concrete parameter of one component: value, bounds, unit, role in a fit, optional Gaussian prior.

    Raises:
        InputError: empty interval, non-finite value, value outside the bounds, or prior that no fit can use.
    """

    value: float
    lower: float = -math.inf
    upper: float = math.inf
    unit: str = "1"
    estimate: bool = True
    prior_mean: float | None = None
    prior_std: float | None = None

    def __post_init__(self) -> None:
        if self.prior_std is not None and self.prior_mean is None:  # or it would follow the estimate
            object.__setattr__(self, "prior_mean", self.value)

    def check(self, name: str) -> Bounded:
        """Return self, or raise with the parameter's name in the message."""
        if not math.isfinite(self.value):
            raise InputError(f"{name} is {self.value}; give a finite number in {self.unit}.")
        if math.isnan(self.lower) or math.isnan(self.upper) or self.lower > self.upper:
            raise InputError(f"{name} has an empty range [{self.lower}, {self.upper}]; swap or widen it.")
        if not self.lower <= self.value <= self.upper:
            raise InputError(
                f"{name} = {self.value:g} {self.unit} lies outside its bounds "
                f"[{self.lower:g}, {self.upper:g}]; move it inside, or widen the bounds where physics allows it."
            )
        if self.prior_std is not None:
            if not self.prior_std > 0.0:
                raise InputError(f"{name} has prior_std {self.prior_std}; give a positive number.")
            width = self.upper - self.lower
            size = abs(self.value) or (width if 0.0 < width < math.inf else 1.0)
            if self.prior_std < NARROWEST_PRIOR * size:
                raise InputError(
                    f"{name} has prior_std {self.prior_std:g}, too narrow beside {size:g} for any fit to move it; "
                    "set 'estimate: false' instead."
                )
            if self.prior_mean is not None and not self.lower <= self.prior_mean <= self.upper:
                raise InputError(
                    f"{name} has prior_mean {self.prior_mean:g} outside its bounds "
                    f"[{self.lower:g}, {self.upper:g}]; move it inside, or widen the bounds where physics allows it."
                )
        return self

    def __deepcopy__(self, _: object) -> Bounded:
        return self  # it never changes, and searches copy models by the thousand

    def at(self, value: float) -> Bounded:
        """The same parameter with another value."""
        return replace(self, value=float(value))


@dataclass(frozen=True)
class ParameterInfo:
    """One row of a system's parameter table.

    Attributes:
        name: name in results, unique in the system (``J``, ``F_c``, ``P_m1m2`` ...).
        component: key of the component that owns it (``joint1/motor_friction/coulomb_friction``).
        symbol: name inside that component.
        doc: meaning.
        spec: value, bounds, unit, role and prior.
        linear: whether it acts along a linear axis, where its law has a force and a way.
    """

    name: str
    component: str
    symbol: str
    doc: str
    spec: Bounded
    linear: bool = False

    @property
    def unit(self) -> str:
        """Unit of the value: that of its law, or what takes its place along a linear axis."""
        return linear_unit(self.spec.unit) if self.linear else self.spec.unit


def linear_unit(unit: str) -> str:
    """What takes the place of a unit along a linear axis: ``N s/m`` of ``N m s/rad``, ``kg`` of ``kg m^2``."""
    for turning, along in (("(N m)", "N"), ("N m", "N"), ("kg m^2", "kg"), ("rad", "m")):
        unit = unit.replace(turning, along)
    return unit
