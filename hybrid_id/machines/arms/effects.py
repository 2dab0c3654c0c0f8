"""What may act at a joint of an arm beyond its description."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hybrid_id.machines.arms.robot import Drive
from hybrid_id.machines.effects.base import UNKNOWN

Values = dict[str, float]


@dataclass(frozen=True)
class Effect:
    """One effect at one joint.

    Attributes:
        name: as in the table of names; `unknown` outside the catalogue.
        joint: its number from 0.
        values: of the drive that it changes, by name; outside the catalogue those of its formula.
        formula: of one outside the catalogue.
    """

    name: str
    joint: int
    values: Mapping[str, float]
    formula: str = ""

    def on(self, drive: Drive) -> Drive:
        """The drive with it; one outside the catalogue acts beside the drive."""
        return drive if self.formula else replace(drive, **self.values)


@dataclass(frozen=True)
class Kind:
    """An effect of the catalogue.

    Attributes:
        place: of a joint.
        draw: values of a dominant one, from a drive and the torque of the weight that its joint carries [N m].
        for_servo, for_torque: whether arms with servos, and with commanded torques, may have it.
    """

    place: str
    draw: Callable[[np.random.Generator, Drive, float], Values]
    for_servo: bool = True
    for_torque: bool = True

    def fits(self, servo: bool) -> bool:
        """Whether an arm may have it."""
        return self.for_servo if servo else self.for_torque


def _side(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(rng.uniform(low, high))


FRICTION = "motor_friction"
KINDS: Mapping[str, Kind] = {
    "stribeck_friction": Kind(
        FRICTION,
        lambda r, d, m: {"drop": d.friction * _uniform(r, 0.9, 2.1), "slip": _uniform(r, 0.06, 0.22)},
    ),
    "load_dependent_friction": Kind(FRICTION, lambda r, d, m: {"load": _uniform(r, 0.14, 0.36)}),
    "asymmetric_friction": Kind(FRICTION, lambda r, d, m: {"uneven": _side(r) * _uniform(r, 0.4, 0.75)}),
    "position_dependent_friction": Kind(
        FRICTION,
        lambda r, d, m: {
            "ripple": _uniform(r, 0.55, 0.92),
            "waves": _uniform(r, 2.2, 5.2),
            "phase": _uniform(r, -np.pi, np.pi),
        },
    ),
    "spring_load": Kind(
        "load", lambda r, d, m: {"spring": m * _uniform(r, 0.6, 1.6), "rest": _uniform(r, -0.55, 0.55)}
    ),
    "constant_torque": Kind("load", lambda r, d, m: {"bias": _side(r) * m * _uniform(r, 0.28, 0.62)}),
    "encoder_zero": Kind(
        "sensor", lambda r, d, m: {"zero": _side(r) * np.radians(_uniform(r, 1.9, 4.2))}, for_torque=False
    ),
    "delay": Kind("input", lambda r, d, m: {"delay": _uniform(r, 0.018, 0.055)}, for_torque=False),
    "goal_rate_limit": Kind("input", lambda r, d, m: {"rate": _uniform(r, 0.75, 1.45)}, for_torque=False),
    "joint_flexibility": Kind("transmission", lambda r, d, m: {"twist": m * _uniform(r, 11.0, 28.0)}),
    "link_mass": Kind(
        "load", lambda r, d, m: {"mass": float(r.choice([-0.48, 0.72])) * _uniform(r, 0.9, 1.12)}
    ),
}
"""Effects of the catalogue by name."""
SIGNED: Mapping[str, Callable[[Drive], float]] = {
    "uneven": lambda d: 0.4,
    "phase": lambda d: 1.1,
    "rest": lambda d: 0.45,
    "zero": lambda d: 0.04,
    "mass": lambda d: 0.35,
    "bias": lambda d: 0.8 * float(d.friction),
}
"""Values that may be negative, and what each is measured by in a fit of a drive."""
SMALL: Mapping[str, Callable[[np.random.Generator, Drive, float], Values]] = {
    "stribeck_friction": lambda r, d, g: {
        "drop": g * d.friction * _uniform(r, 0.01, 0.07),
        "slip": _uniform(r, 0.06, 0.22),
    },
    "asymmetric_friction": lambda r, d, g: {"uneven": g * _uniform(r, -0.025, 0.025)},
    "position_dependent_friction": lambda r, d, g: {
        "ripple": g * _uniform(r, 0.004, 0.03),
        "waves": _uniform(r, 2.2, 5.2),
        "phase": _uniform(r, -np.pi, np.pi),
    },
    "encoder_zero": lambda r, d, g: {"zero": g * np.radians(_uniform(r, -0.02, 0.02))},
    "link_mass": lambda r, d, g: {"mass": g * _uniform(r, -0.022, 0.022)},
}
"""Small things at every joint, larger on one arm than on another by a factor."""
GROWN = (0.8, 4.5)
"""Least and greatest of that factor."""


def _over_other(rng: np.random.Generator, drive: Drive, moment: float) -> Values:
    return {
        "share": _uniform(rng, 0.65, 0.95),
        "waves": _uniform(rng, 2.0, 4.4),
        "phase": _uniform(rng, -np.pi, np.pi),
    }


OUTSIDE: Mapping[str, Callable[[np.random.Generator, Drive, float], Values]] = {
    # dry friction that waves over the angle of another joint
    "friction_over_other_joint": _over_other,
    # a torque that swings by a clock of its own, not that of the record
    "torque_over_time": lambda r, d, m: {
        "torque": m * _uniform(r, 0.22, 0.5),
        "rate": _uniform(r, 0.35, 0.9),
    },
    # a detent that holds to the side from which the joint has come: a torque with a memory of the last end
    "latch": lambda r, d, m: {"torque": m * _uniform(r, 0.16, 0.4), "reach": _uniform(r, 0.18, 0.4)},
    # dry friction that falls while the joint travels, anew in every record
    "running_in": lambda r, d, m: {"share": _uniform(r, 1.3, 3.2), "travel": _uniform(r, 0.9, 2.6)},
}
"""Effects that the catalogue has no name for, by formula."""


def draw_effect(
    rng: np.random.Generator, name: str, joint: int, drive: Drive, moment: float, formula: str = ""
) -> Effect:
    """A dominant effect at a joint.

    Args:
        rng: source of its values.
        name: of the catalogue, or `unknown`.
        joint: its number from 0.
        drive: of the joint.
        moment: torque of the weight that the joint carries [N m].
        formula: of one outside the catalogue.
    """
    draw = OUTSIDE[formula] if name == UNKNOWN else KINDS[name].draw
    return Effect(name, joint, draw(rng, drive, moment), formula)


def draw_small(rng: np.random.Generator, drives: Sequence[Drive], servo: bool) -> list[list[Effect]]:
    """The small effects of every joint of an arm."""
    kinds = {name: draw for name, draw in SMALL.items() if KINDS[name].fits(servo)}
    grown = float(np.exp(rng.uniform(*np.log(GROWN))))
    return [
        [Effect(name, k, draw(rng, own, grown)) for name, draw in kinds.items()]
        for k, own in enumerate(drives)
    ]
