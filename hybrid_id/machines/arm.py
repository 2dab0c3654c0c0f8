"""Random arms: a tree of links, and a drive at every joint."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hybrid_id.machines.effects import Effect
from hybrid_id.machines.effects.arm import LinkMass
from hybrid_id.machines.physics.friction import Coulomb, Viscous
from hybrid_id.machines.physics.machine import Drive, Machine, OneLink
from hybrid_id.machines.physics.motor import Servo
from hybrid_id.machines.physics.mujoco import HARD, STEP, Link, MujocoMachine, document
from hybrid_id.machines.physics.transmission import Gear
from hybrid_id.records.dataset import Channel

JOINTS = (2, 7)
"""Fewest and most joints."""
BRANCH = 0.15
"""Share of links that are not carried by the one before them."""
SERVOS = 0.6
"""Share of arms whose servos follow goals."""
GEARED = 0.62
"""Share of a joint's damping that is its own where a controller commands torques."""
GRAVITY = 9.81


@dataclass(frozen=True)
class Arm:
    """An arm; a drive's parameters are the rotor's inertia J_m, friction F_v and F_c, and the servo's gain k_p.

    Attributes:
        links: in the order of their joints, each before what it carries, as the description nests them.
        values: true parameters by name, J_m1 that of joint 1, at the joint [kg m^2, N m s/rad, N m, N m/rad].
        servo: whether position servos follow goals; elsewhere a controller of the same gain commands torques.
        brake: torque per speed of that controller [N m s/rad].
        count: of the encoders [rad].
        jitter: standard deviation of their noise before they count [rad].
        moment: torque of the weight that each joint carries, seen at a right angle [N m].
        phase: of a clock of its own, at the start of each record (R,) [rad].
    """

    links: tuple[Link, ...]
    values: Mapping[str, Any]
    servo: bool
    brake: tuple[float, ...]
    count: float
    jitter: float
    moment: tuple[float, ...]
    phase: Any = 0.0

    system = "robot"
    lacks: frozenset[str] = frozenset()

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.links)

    @property
    def noise(self) -> float:
        """Standard deviation of what the encoders add [rad]."""
        return float(np.hypot(self.jitter, self.count / np.sqrt(12.0)))

    @property
    def inputs(self) -> list[Channel]:
        """Channels of the commands: goals, or torques."""
        name, unit = ("goal", "rad") if self.servo else ("tau", "N m")
        return [Channel(f"{name}{k + 1}", unit) for k in range(self.joints)]

    @property
    def outputs(self) -> list[str]:
        """Names of the encoders' channels."""
        return [f"q_a{k + 1}" for k in range(self.joints)]

    def free(self, joint: int) -> list[str]:
        """Parameters of a joint that its records can tell."""
        return [f"{symbol}{joint + 1}" for symbol in ("J_m", "F_v", "F_c", *(("k_p",) if self.servo else ()))]

    def value(self, joint: int, symbol: str) -> Any:
        """True value of a drive's parameter."""
        return self.values[f"{symbol}{joint + 1}"]

    def with_values(self, values: Mapping[str, Any]) -> "Arm":
        """The same arm with some parameters replaced."""
        return replace(self, values={**self.values, **values})

    def drifted(self, factor: np.ndarray) -> "Arm":
        """The arm whose joints' friction is off by a factor (n_joints, B)."""
        names = [(k, f"{symbol}{k + 1}") for k in range(self.joints) for symbol in ("F_c", "F_v")]
        return self.with_values({name: self.values[name] * factor[k] for k, name in names})

    def carriers(self, link: int) -> list[int]:
        """Numbers of the joints that carry a link."""
        found = []
        while link >= 0:
            found.append(link)
            link = self.links[link].parent
        return found[::-1]

    def drive(self, joint: int) -> Drive:
        """The drive of a joint without any effect."""
        gain = self.value(joint, "k_p") if self.servo else 0.0
        drive = Drive(Gear(1.0), self.value(joint, "J_m"), Servo(gain=gain))
        drive.rotor_laws = [Coulomb(self.value(joint, "F_c")), Viscous(self.value(joint, "F_v"))]
        return drive

    def weighed(self, shares: Sequence[float]) -> tuple[Link, ...]:
        """The links, each heavier by a share."""
        return tuple(
            replace(link, mass=(1 + more) * link.mass, inertia=tuple((1 + more) * v for v in link.inertia))
            for link, more in zip(self.links, shares, strict=True)
        )

    def assemble(self, effects: Sequence[Effect]) -> MujocoMachine:
        """The arm with effects, in MuJoCo."""
        machine = Machine([self.drive(k) for k in range(self.joints)], OneLink(1.0))
        masses = [0.0] * self.joints
        for effect in effects:
            effect.install(machine, self)  # type: ignore[arg-type]
            if isinstance(effect, LinkMass):
                masses[effect.joint] += effect.values["mass"]
        return MujocoMachine(machine.drives, self.weighed(masses), gravity=GRAVITY)

    def described(self, rng: np.random.Generator, wrong: float) -> "Arm":
        """The arm as its description has it, values of its drives off by up to a share."""
        return self.with_values(
            {n: float(v) * (1 + wrong * rng.uniform(-1, 1)) for n, v in self.values.items()}
        )

    def description(self) -> str:
        """The arm as MJCF, with servos or motors."""
        hinges = [
            f'armature="{self.value(k, "J_m"):.5g}" damping="{self.value(k, "F_v"):.5g}" '
            f'frictionloss="{self.value(k, "F_c"):.5g}" {HARD}'
            for k in range(self.joints)
        ]
        motors = "".join(
            f'<position joint="j{k + 1}" kp="{self.value(k, "k_p"):.5g}"/>'
            if self.servo
            else f'<motor joint="j{k + 1}"/>'
            for k in range(self.joints)
        )
        options = f'timestep="{STEP}" integrator="RK4"'
        return document(self.links, hinges, options=options, more=f"<actuator>{motors}</actuator>")

    def places(self, effect: Effect) -> list[str]:
        """Places of an effect that physics alone cannot tell apart: all joints that carry a link feel its mass."""
        if effect.name == LinkMass.name:
            return [f"j{k + 1}/load" for k in self.carriers(effect.joint)]
        here = f"j{effect.joint + 1}/{effect.place}"
        return [here, f"j{effect.joint + 1}/link_friction"] if effect.place == "motor_friction" else [here]


def draw_arm(rng: np.random.Generator) -> Arm:
    """An arm without effects."""
    links = _links(rng, int(rng.integers(JOINTS[0], JOINTS[1] + 1)))
    moment, inertia = _carried(links)
    servo = bool(rng.random() < SERVOS)
    values, brake = {}, []
    for k, (weight, own) in enumerate(zip(moment, inertia, strict=True)):
        # a geared motor that is commanded in torque has a heavier rotor and more friction of its own
        heavy, dry, share = ((0.35, 0.9), (0.04, 0.14), 1.0) if servo else ((1.1, 3.5), (0.08, 0.21), GEARED)
        gain, armature = weight * rng.uniform(9.0, 18.0), own * rng.uniform(*heavy) + 5e-4
        damping = rng.uniform(0.7, 1.3) * np.sqrt(gain * (own + armature))
        brake.append((1.0 - share) * damping)
        friction = weight * rng.uniform(*dry)
        values |= {f"J_m{k + 1}": armature, f"F_v{k + 1}": share * damping, f"F_c{k + 1}": friction}
        values[f"k_p{k + 1}"] = gain
    count = 2 * np.pi / float(rng.choice([4096, 8192, 16384]))
    jitter = count * rng.uniform(0.35, 0.75)
    return Arm(tuple(links), values, servo, tuple(brake), count, jitter, tuple(moment))


def _links(rng: np.random.Generator, count: int) -> list[Link]:
    """A tree of links, in the order in which a description nests them, by which engines number their joints."""
    links, lengths = list[Link](), list[float]()
    for k in range(count):
        parent = k - 1 if k < 2 or rng.random() >= BRANCH else int(rng.integers(k - 1))
        along = lengths[parent] if k else 0.12
        aside = rng.uniform(-0.025, 0.025, 2)
        length, mass = rng.uniform(0.07, 0.19), rng.uniform(0.14, 0.5) * 0.8**k
        width = length * rng.uniform(0.12, 0.24)
        axis, turn = rng.standard_normal(3), rng.standard_normal(4)
        swing = mass * (length**2 / 12 + width**2) * rng.uniform(0.92, 1.08, 2)
        centre = (*rng.uniform(-0.15, 0.15, 2) * length, length * rng.uniform(0.38, 0.64))
        turned = (tuple(turn / np.linalg.norm(turn)), tuple(axis / np.linalg.norm(axis)))
        links.append(Link(parent, (*aside, along), *turned, centre, float(mass), (*swing, mass * width**2)))
        lengths.append(float(length))
    order, waiting = list[int](), [k for k, one in enumerate(links) if one.parent < 0][::-1]
    while waiting:
        order.append(waiting.pop())
        waiting += [k for k, one in enumerate(links) if one.parent == order[-1]][::-1]
    number = {-1: -1} | {old: new for new, old in enumerate(order)}
    return [replace(links[k], parent=number[links[k].parent]) for k in order]


def _carried(links: Sequence[Link]) -> tuple[np.ndarray, np.ndarray]:
    """Torque of the weight [N m] that each joint carries, seen at a right angle, and a typical inertia [kg m^2]."""
    import mujoco

    mj: Any = mujoco
    model = mj.MjModel.from_xml_string(document(links, [""] * len(links)))
    data, moment, inertia = mj.MjData(model), np.zeros(len(links)), np.zeros(len(links))
    mj.mj_kinematics(model, data)
    for i, link in enumerate(links):
        k = i
        while k >= 0:
            away = float(np.linalg.norm(data.xipos[i + 1] - data.xanchor[k]))
            moment[k] += GRAVITY * link.mass * away
            inertia[k] += 0.6 * link.mass * away**2
            k = links[k].parent
    return moment, inertia
