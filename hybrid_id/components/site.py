"""Where a law is suspected: the model at that place, how large things are in the records, what a fit leaves."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from hybrid_id.components.base import Component, Friction, ServoLoop, Values
from hybrid_id.parameters import Bounded

Wave = tuple[float, ...]
"""What a search finds: periods a turn, then amplitudes of cosine and sine."""
Searches = Mapping[str, Callable[[], list[Wave]]]
"""By name, searches for torques over an angle that would explain most of what a fit leaves, best first.

``rotor_waves``: torques on the rotor over its angle. ``gear_waves``: errors of the gear over the rotor's angle.
``friction_waves``: dry friction over the joint's angle. ``friction_spots``: dry friction about an angle of the joint
(angle, half width, height).
"""


@dataclass(frozen=True)
class Tip:
    """A point at the end of a robot that a joint raises and lowers.

    Attributes:
        name: in the robot's description, of a site or a body.
        lowest, highest: where it is over all records, in the base's axes [m].
    """

    name: str
    lowest: float
    highest: float


@dataclass(frozen=True)
class Scales:
    """Sizes of one joint's signals over all records, and of its fitted model.

    Attributes:
        joint: number, from 1.
        ratio: gear ratio.
        sample_time: [s].
        duration: of the longest record [s].
        command: largest command [its unit].
        command_rms: its RMS while it is not near zero.
        speed: 95th percentile of the rotor's speed while it turns [rad/s].
        turns: range of the rotor's angle [rad].
        angle: range of the link's angle [rad].
        middle: its middle [rad].
        torque: RMS of the motor's torque while it is not near zero [N m], at the motor.
        dry: level of dry friction at the motor [N m]; a tenth of ``torque`` where the model has none.
        inertia: everything that moves, at the motor [kg m^2].
        rotor: part of it on the rotor's side of the gear.
        shows_torque: whether the motor's current or torque is measured, or the motor switched off at times.
        measured: channels of the joint that are, without its number.
        bodies: that the joint of a robot carries and that have a mass, outermost first.
        tip: the lowest of the points at the robot's ends that the joint raises and lowers, if there is any.
    """

    joint: int
    ratio: float
    sample_time: float
    duration: float
    command: float
    command_rms: float
    speed: float
    turns: float
    angle: float
    middle: float
    torque: float
    dry: float
    inertia: float
    rotor: float
    shows_torque: bool = False
    measured: tuple[str, ...] = ()
    bodies: tuple[str, ...] = ()
    tip: Tip | None = None

    @property
    def series(self) -> float:
        """Inertia of rotor and link in series, at the link [kg m^2]."""
        whole, share = self.inertia * self.ratio**2, self.rotor / self.inertia
        return max(share * (1.0 - share) * whole, 1e-12)


@dataclass(frozen=True, kw_only=True)
class Site(Scales):
    """A place of a joint, as a law sees it that may be suspected there.

    Attributes:
        place: of the drive chain.
        components: of the whole model by key, ``joint1/motor/dc_motor``.
        rigid: whether the joint's gear is.
        ratios: gear ratios of all joints.
        searches: in what the model's fit leaves; none where it has not been fitted.
    """

    place: str
    components: Mapping[str, Component]
    rigid: bool
    ratios: tuple[float, ...]
    searches: Searches = field(default_factory=dict)

    @property
    def gearing(self) -> float:
        """Speed of the rotor over that of this place: torques here are larger by it than at the motor."""
        return self.ratio if self.place in ("link_friction", "load") else 1.0

    def at(self, place: str = "") -> dict[str, Component]:
        """Components at this place, or at another one of the joint, by kind."""
        where = f"joint{self.joint}/{place or self.place}/"
        return {key.removeprefix(where): c for key, c in self.components.items() if key.startswith(where)}

    def has(self, *kinds: str) -> bool:
        """Whether there is a component of one of the kinds at this place."""
        return any(kind in self.at() for kind in kinds)

    @property
    def servo(self) -> ServoLoop | None:
        """The position loop that drives the joint; None where the command is no goal."""
        return next((part for part in self.at("input").values() if isinstance(part, ServoLoop)), None)

    @property
    def frictions(self) -> list[Friction]:
        """The friction laws at this place."""
        return [law for law in self.at().values() if isinstance(law, Friction)]

    def search(self, name: str, otherwise: Wave = ()) -> list[Wave]:
        """What a search of :data:`Searches` finds, best first; ``otherwise`` where there is no fit to search."""
        if name in self.searches:
            return self.searches[name]()
        return [otherwise] if otherwise else []


def free(value: float, lower: float, upper: float) -> Bounded:
    """An estimated parameter inside its bounds, in the unit of its declaration."""
    lower, upper = float(lower), float(upper)
    return Bounded(min(max(float(value), lower), upper), lower, upper)


def second_wave(
    part: Component, waves: Callable[[], list[Wave]], symbols: tuple[str, str], most: float
) -> list[Values]:
    """A further wave beside the one that a component has: the strongest of another period, and the first's overtone.

    Args:
        part: with parameters ``n``, ``n_2`` and the amplitudes.
        waves: looks for waves, best first.
        symbols: of the second wave's cosine and sine; without their last letter, the first one's.
        most: largest amplitude, over the first wave's.
    """
    if part.specs[symbols[0]].estimate:
        return []
    spec = part.specs["n"]
    own, near = spec.value, spec.upper - spec.lower if spec.estimate else 0.0
    first = max(math.hypot(*(part.specs[symbol[:-1]].value for symbol in symbols)), 1e-12)
    others = [(n, size) for n, *size in waves() if abs(n - own) > near]
    if not others:
        return []
    overtone = min(others, key=lambda other: abs(other[0] - 2.0 * own))
    begun = [*(one for one in others[:1] if one is not overtone), (2.0 * own, overtone[1])]
    limit = most * first
    return [
        {"n_2": n} | {s: free(x, -limit, limit) for s, x in zip(symbols, size, strict=True)}
        for n, size in begun
    ]
