"""Random arms: a tree of links, and a drive at every joint."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

JOINTS = (2, 7)
"""Fewest and most joints."""
BRANCH = 0.15
"""Share of links that are not carried by the one before them."""
SERVOS = 0.6
"""Share of arms whose servos follow goals."""
GEARED = 0.62
"""Share of a joint's damping that is its own where a controller commands torques."""
GRAVITY = 9.81
STEP = 5e-4
"""MuJoCo's step [s]."""
STIFF = 'solimpfriction="0.9999 0.9999 0.001" solreffriction="0.002 1"'
"""Dry friction that does not give way."""
ROTOR = '<inertial mass="1e-4" pos="0 0 0" diaginertia="1e-7 1e-7 1e-7"/>'
TWIST_DAMPING = 0.004
"""Damping of a gear that gives way, by its stiffness [s]."""


@dataclass(frozen=True)
class Link:
    """A body and the hinge that carries it.

    Attributes:
        parent: number of the link that carries it; -1 is the base.
        position: of its frame in the parent's, at its hinge [m].
        quaternion: of its frame in the parent's.
        axis: of the hinge, in its own frame.
        length: from its hinge to where it carries others, along its own z [m].
        centre: of its mass [m].
        mass: [kg].
        inertia: about the centre, along its own axes [kg m^2].
    """

    parent: int
    position: tuple[float, ...]
    quaternion: tuple[float, ...]
    axis: tuple[float, ...]
    length: float
    centre: tuple[float, ...]
    mass: float
    inertia: tuple[float, ...]


@dataclass(frozen=True)
class Drive:
    """What moves and brakes a joint; each value a number, or an array of several joints or variants side by side.

    Attributes:
        armature: of the rotor, at the joint [kg m^2].
        damping: [N m s/rad].
        friction: dry [N m].
        gain: of the servo, or of the controller that commands its torque [N m/rad].
        drop: what dry friction has more at rest [N m], and
        slip: the speed at which that falls off [rad/s].
        load: dry friction per torque of the motor [1].
        uneven: share of the dry friction by which one direction has more, the other less.
        ripple: share of the dry friction that waves over the angle,
        waves: how often [1/rad], and
        phase: where [rad].
        spring: [N m/rad], and
        rest: the angle at which it rests [rad].
        bias: constant torque [N m].
        zero: reading of the encoder at the angle of which the goal speaks [rad].
        delay: of the command [s].
        rate: largest rate of the goal that the servo follows [rad/s].
        twist: stiffness of the gear [N m/rad]; 0 where it is rigid.
        mass: of the link, relative to the described one, less 1.
    """

    armature: Any
    damping: Any
    friction: Any
    gain: Any
    drop: Any = 0.0
    slip: Any = 0.1
    load: Any = 0.0
    uneven: Any = 0.0
    ripple: Any = 0.0
    waves: Any = 3.0
    phase: Any = 0.0
    spring: Any = 0.0
    rest: Any = 0.0
    bias: Any = 0.0
    zero: Any = 0.0
    delay: Any = 0.0
    rate: Any = np.inf
    twist: Any = 0.0
    mass: Any = 0.0

    def dry(self, angle: Any, speed: Any, torque: Any) -> Any:
        """Dry friction [N m] at an angle [rad] and a speed [rad/s] under the motor's torque [N m]."""
        level = self.friction * (1.0 + self.uneven * np.sign(speed))
        level = level * (1.0 + self.ripple * np.sin(self.waves * angle + self.phase))
        return level + self.drop * np.exp(-((speed / self.slip) ** 2)) + self.load * np.abs(torque)

    def push(self, angle: Any) -> Any:
        """Torque of spring and bias [N m]."""
        return self.bias - self.spring * (angle - self.rest)


def stacked(drives: Sequence[Drive]) -> Drive:
    """Drives side by side, each value an array ``(len(drives),)``."""
    return Drive(**{f.name: np.array([getattr(d, f.name) for d in drives], float) for f in fields(Drive)})


@dataclass(frozen=True)
class Arm:
    """An arm.

    Attributes:
        links: in the order of their joints, each before what it carries, as the description nests them.
        drives: as they are, with all effects.
        servo: whether position servos follow goals; elsewhere a controller commands torques, which are logged.
        brake: torque per speed of that controller [N m s/rad].
        count: of the encoders [rad].
        jitter: standard deviation of their noise before they count [rad].
    """

    links: tuple[Link, ...]
    drives: tuple[Drive, ...]
    servo: bool
    brake: tuple[float, ...]
    count: float
    jitter: float

    @property
    def names(self) -> list[str]:
        """Of the joints."""
        return [f"j{k + 1}" for k in range(len(self.links))]

    @property
    def noise(self) -> float:
        """Standard deviation of what the encoders add [rad]."""
        return float(np.hypot(self.jitter, self.count / np.sqrt(12.0)))

    def carriers(self, link: int) -> list[int]:
        """Numbers of the joints that carry a link."""
        found = []
        while link >= 0:
            found.append(link)
            link = self.links[link].parent
        return found[::-1]


def draw_arm(rng: np.random.Generator) -> tuple[Arm, np.ndarray]:
    """An arm without effects, and the torque [N m] of the weight that each joint carries, ``(n,)``."""
    links = _links(rng, int(rng.integers(JOINTS[0], JOINTS[1] + 1)))
    moment, inertia = _carried(links)
    servo = bool(rng.random() < SERVOS)
    drives, brake = [], []
    for weight, own in zip(moment, inertia, strict=True):
        # a geared motor that is commanded in torque has a heavier rotor and more friction of its own
        heavy, dry, share = ((0.35, 0.9), (0.04, 0.14), 1.0) if servo else ((1.1, 3.5), (0.08, 0.21), GEARED)
        gain, armature = weight * rng.uniform(9.0, 18.0), own * rng.uniform(*heavy) + 5e-4
        damping = rng.uniform(0.7, 1.3) * np.sqrt(gain * (own + armature))
        brake.append((1.0 - share) * damping)
        drives.append(Drive(armature, share * damping, weight * rng.uniform(*dry), gain))
    count = 2 * np.pi / float(rng.choice([4096, 8192, 16384]))
    jitter = count * rng.uniform(0.35, 0.75)
    return Arm(tuple(links), tuple(drives), servo, tuple(brake), count, jitter), moment


def _links(rng: np.random.Generator, count: int) -> list[Link]:
    links: list[Link] = []
    for k in range(count):
        parent = k - 1 if k < 2 or rng.random() >= BRANCH else int(rng.integers(k - 1))
        along = links[parent].length if k else 0.12
        aside = rng.uniform(-0.025, 0.025, 2)
        length, mass = rng.uniform(0.07, 0.19), rng.uniform(0.14, 0.5) * 0.8**k
        width = length * rng.uniform(0.12, 0.24)
        axis, turn = rng.standard_normal(3), rng.standard_normal(4)
        swing = mass * (length**2 / 12 + width**2) * rng.uniform(0.92, 1.08, 2)
        centre = (*rng.uniform(-0.15, 0.15, 2) * length, length * rng.uniform(0.38, 0.64))
        links.append(
            Link(
                parent,
                (*aside, along),
                tuple(turn / np.linalg.norm(turn)),
                tuple(axis / np.linalg.norm(axis)),
                float(length),
                centre,
                float(mass),
                (*swing, mass * width**2),
            )
        )
    return _depth_first(links)


def _depth_first(links: Sequence[Link]) -> list[Link]:
    """The links in the order in which a description nests them, by which engines number their joints."""
    order, waiting = list[int](), [k for k, one in enumerate(links) if one.parent < 0][::-1]
    while waiting:
        order.append(waiting.pop())
        waiting += [k for k, one in enumerate(links) if one.parent == order[-1]][::-1]
    number = {-1: -1} | {old: new for new, old in enumerate(order)}
    return [replace(links[k], parent=number[links[k].parent]) for k in order]


def _carried(links: Sequence[Link]) -> tuple[np.ndarray, np.ndarray]:
    """Torque of the weight [N m] that each joint carries, seen at a right angle, and a typical inertia [kg m^2]."""
    turns, places, centres = [], [], []
    for one in links:
        turn = np.eye(3) if one.parent < 0 else turns[one.parent]
        place = np.zeros(3) if one.parent < 0 else places[one.parent]
        places.append(place + turn @ one.position)
        turns.append(turn @ _rotation(one.quaternion))
        centres.append(places[-1] + turns[-1] @ one.centre)
    moment, inertia = np.zeros(len(links)), np.zeros(len(links))
    for b, one in enumerate(links):
        k = b
        while k >= 0:
            away = float(np.linalg.norm(centres[b] - places[k]))
            moment[k] += GRAVITY * one.mass * away
            inertia[k] += 0.6 * one.mass * away**2
            k = links[k].parent
    return moment, inertia


def _rotation(quaternion: Sequence[float]) -> np.ndarray:
    w, x, y, z = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def described(arm: Arm, rng: np.random.Generator, wrong: float) -> Arm:
    """The arm as its description has it: without effects, values of its drives off by up to a share."""
    drives = []
    for one in arm.drives:
        off = 1.0 + wrong * rng.uniform(-1.0, 1.0, 4)
        values = (one.armature, one.damping, one.friction, one.gain)
        drives.append(Drive(*(float(v * f) for v, f in zip(values, off, strict=True))))
    return replace(arm, drives=tuple(drives))


def mjcf(arm: Arm) -> str:
    """The arm as MJCF; a gear that gives way is a hinge in series, ``twist``."""
    carried: dict[int, list[int]] = {}
    for k, link in enumerate(arm.links):
        carried.setdefault(link.parent, []).append(k)

    def body(k: int) -> str:
        link, own, name = arm.links[k], arm.drives[k], arm.names[k]
        hinge = (
            f'<joint name="{name}" axis="{_text(link.axis)}" armature="{own.armature:.5g}" '
            f'damping="{own.damping:.5g}" frictionloss="{own.friction:.5g}" {STIFF}/>'
        )
        heavier = 1.0 + own.mass
        inertial = (
            f'<inertial mass="{heavier * link.mass:.6g}" pos="{_text(link.centre)}" '
            f'diaginertia="{_text(heavier * np.array(link.inertia))}"/>'
        )
        inner = inertial + "".join(body(other) for other in carried.get(k, []))
        frame = f'pos="{_text(link.position)}" quat="{_text(link.quaternion)}"'
        if not own.twist:
            return f'<body name="link{k + 1}" {frame}>{hinge}{inner}</body>'
        twist = (
            f'<joint name="twist" axis="{_text(link.axis)}" stiffness="{own.twist:.5g}" '
            f'damping="{TWIST_DAMPING * own.twist:.5g}"/>'
        )
        return f'<body {frame}>{hinge}{ROTOR}<body name="link{k + 1}">{twist}{inner}</body></body>'

    motors = "".join(
        f'<position joint="{name}" kp="{own.gain:.5g}"/>' if arm.servo else f'<motor joint="{name}"/>'
        for name, own in zip(arm.names, arm.drives, strict=True)
    )
    return (
        f'<mujoco><compiler angle="radian"/><option timestep="{STEP}" integrator="RK4"/>'
        f"<worldbody>{''.join(body(k) for k in carried[-1])}</worldbody><actuator>{motors}</actuator></mujoco>\n"
    )


def _text(values: Any) -> str:
    return " ".join(f"{v:.6g}" for v in values)
