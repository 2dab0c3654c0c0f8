"""Trees of links in MuJoCo, each joint with a drive whose laws act on it at every step.

MuJoCo carries the bodies and holds the dry friction, which is a soft constraint there: it creeps, which is the point,
for it is another physics than the stepping in `machine`. Motor, springs and all other laws act on the joints as
torques. A drive is a hinge whose armature is the rotor seen behind the gear; where rotor and link can move apart, a
second hinge in series is the twist between them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hybrid_id.machines.physics.law import Lanes
from hybrid_id.machines.physics.machine import BRAKE, SETTLING, Drive, Machine, OneLink, joined

STEP = 0.5e-3
"""MuJoCo's time step [s]."""
HARD = 'solreffriction="0.002 1" solimpfriction="0.9999 0.9999 0.001"'
"""Dry friction that gives way hardly."""
ROTOR = '<inertial mass="1e-6" pos="0 0 0" diaginertia="1e-9 1e-9 1e-9"/>'
"""A body in front of a twist: the inertia is that of the armature."""
LENGTH = 0.3
"""Of the first of two links [m]; any will do that the coupling and the inertias allow."""
CALM = 1e-5
"""Speed [rad/s] below which a machine has come to rest."""


class Unsupported(Exception):
    """What MuJoCo has no counterpart for."""


@dataclass(frozen=True)
class Link:
    """A body and the hinge that carries it.

    Attributes:
        parent: number of the link that carries it; -1 is the base.
        position: of its frame in the parent's, at its hinge [m].
        quaternion: of its frame in the parent's.
        axis: of the hinge, in its own frame.
        centre: of its mass [m].
        mass: [kg].
        inertia: about the centre, along its own axes [kg m^2].
    """

    parent: int
    position: tuple[float, ...]
    quaternion: tuple[float, ...]
    axis: tuple[float, ...]
    centre: tuple[float, ...]
    mass: float
    inertia: tuple[float, ...]


def document(
    links: Sequence[Link],
    hinges: Sequence[str],
    *,
    twisting: Sequence[int] = (),
    options: str = "",
    more: str = "",
) -> str:
    """A tree as MJCF, its joints called j1, j2, ...

    Args:
        links: each before those that it carries, as the document nests them.
        hinges: attributes of each joint, say its armature.
        twisting: numbers of the joints that have a twist behind their rotor, called t1, t2, ...
        options: attributes of the simulation.
        more: actuators.
    """

    def body(k: int) -> str:
        link = links[k]
        axis = f'axis="{_text(link.axis)}"'
        hinge = f'<joint name="j{k + 1}" {axis} {hinges[k]}/>'
        inner = f'<inertial mass="{link.mass:.9g}" pos="{_text(link.centre)}" diaginertia="{_text(link.inertia)}"/>'
        inner += "".join(body(other) for other, one in enumerate(links) if one.parent == k)
        frame = f'pos="{_text(link.position)}" quat="{_text(link.quaternion)}"'
        if k not in twisting:
            return f'<body name="link{k + 1}" {frame}>{hinge}{inner}</body>'
        twist = f'<joint name="t{k + 1}" {axis}/>'
        return f'<body {frame}>{hinge}{ROTOR}<body name="link{k + 1}">{twist}{inner}</body></body>'

    bodies = "".join(body(k) for k, one in enumerate(links) if one.parent < 0)
    return (
        f'<mujoco><compiler angle="radian"/><option {options}/>'
        f"<worldbody>{bodies}</worldbody>{more}</mujoco>\n"
    )


def _text(values: Any) -> str:
    return " ".join(f"{v:.9g}" for v in values)


def planar(machine: Machine) -> tuple[list[Drive], list[Link]]:
    """Drives and links of a machine, which all its runs share but for the laws of its drives.

    Raises:
        Unsupported: an arm that is tilted, or no two bodies have its inertias.
    """
    links, plain = machine.links, ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    if isinstance(links, OneLink):
        return machine.drives, [Link(-1, *plain, (0.0, 0.0, 0.0), 1.0, (_one(links.J),) * 3)]
    if any(np.any(value) for value in (links.G_1, links.G_2)):
        raise Unsupported("a tilted arm")
    a, b, c = _one(links.a), _one(links.b), _one(links.c)
    mass = max(1.05 * c**2 / (LENGTH**2 * b), 0.1)
    centre = c / (LENGTH * mass)
    first = a - b - mass * LENGTH**2
    if first <= 0:
        raise Unsupported("links that no two bodies have")
    return machine.drives, [
        Link(-1, *plain, (0.0, 0.0, 0.0), 0.1, (first,) * 3),
        Link(0, (LENGTH, 0.0, 0.0), *plain[1:], (centre, 0.0, 0.0), mass, (b - mass * centre**2,) * 3),
    ]


def _one(value: Lanes) -> float:
    """The one value that all runs have."""
    if np.ptp(value) > 0:
        raise Unsupported("inertias that differ from run to run")
    return float(np.mean(value))


class MujocoMachine:
    """A tree of links and the drives of its joints in MuJoCo, one simulation a run.

    Args:
        drives: one a joint, as `Machine` takes them.
        links: as `document` takes them.
        gravity: [m/s^2], along -z.

    Raises:
        Unsupported: gear errors, late sensors, or a law that reads the torque through a rigid gear.
    """

    def __init__(self, drives: list[Drive], links: Sequence[Link], *, gravity: float = 0.0) -> None:
        import mujoco

        self._mujoco: Any = mujoco
        self.drives = drives
        for drive in drives:
            if drive.gear.errors or drive.sensor_delay is not None:
                raise Unsupported("gear errors and late sensors")
            if drive.spring is None and any(law.needs_carried for law in drive.rotor_laws):
                raise Unsupported("the torque through a rigid gear")
        soft = [i for i, drive in enumerate(drives) if drive.spring is not None]
        tendons = "".join(
            f'<fixed name="l{i + 1}" {HARD}><joint joint="j{i + 1}" coef="1"/>'
            f'<joint joint="t{i + 1}" coef="1"/></fixed>'
            for i in soft
        )
        text = document(
            links,
            [f'armature="{drive.gear.ratio**2 * _one(drive.rotor):.9g}" {HARD}' for drive in drives],
            twisting=soft,
            options=f'timestep="{STEP}" gravity="0 0 {-gravity}" integrator="Euler"',
            more=f"<tendon>{tendons}</tendon>",
        )
        self.model: Any = self._mujoco.MjModel.from_xml_string(text)
        self._rotors = [int(self.model.joint(f"j{i + 1}").qposadr[0]) for i in range(len(drives))]
        self._twists = {i: int(self.model.joint(f"t{i + 1}").qposadr[0]) for i in soft}
        self._tendons = {i: int(self.model.tendon(f"l{i + 1}").id) for i in soft}

    def begin(self, lanes: int, samples: int, sample_time: float, angles: np.ndarray | None = None) -> None:
        """Prepare B runs of so many samples [s], at rest at link angles (n_joints, B) [rad].

        Without them the machines come to rest from angles zero, without voltage.
        """
        self._steps, self._sample_time, self._sample = round(sample_time / STEP), sample_time, 0
        self._runs = [self._mujoco.MjData(self.model) for _ in range(lanes)]
        still = np.zeros((len(self.drives), lanes))
        for drive in self.drives:
            drive.start(lanes, np.zeros(lanes))
            drive.x.history, drive.x.sample_time = np.zeros((samples, lanes)), sample_time
        if angles is not None:
            for b, run in enumerate(self._runs):
                run.qpos[self._rotors] = angles[:, b]
            return
        steps = round(SETTLING / STEP)
        for k in range(steps):
            self._move((k - steps) * STEP, still)
            for run in self._runs:
                run.qvel *= 1 - BRAKE * STEP  # a hand holds back what would swing for long
            if k % 200 == 19 and max(np.abs(run.qvel).max() for run in self._runs) < CALM:
                break
        for run in self._runs:
            run.qvel[:] = 0.0

    def advance(self, commands: np.ndarray, disturbance: np.ndarray) -> None:
        """Carry all runs over one sample with held commands and disturbing torques (n_joints, B) [V, N m]."""
        for drive, command in zip(self.drives, commands, strict=True):
            drive.x.command = command
            drive.x.history[self._sample] = command
        for i in range(self._steps):
            self._move(self._sample * self._sample_time + i * STEP, disturbance)
        self._sample += 1

    def carry(self, commands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Carry all runs through commands (T, n_joints, B) [V]: rotor and link angles, alike, [rad] at all samples."""
        seen = []
        for command in commands:
            seen.append(self.angles())
            self.advance(command, np.zeros_like(command))
        rotor, link = (np.array(one) for one in zip(*seen, strict=True))
        return rotor, link

    def angles(self) -> tuple[np.ndarray, np.ndarray]:
        """Rotor and link angles (n_joints, B) [rad] as the sensors give them."""
        rotor, link = self.motion()[0]
        ratio = np.array([drive.gear.ratio for drive in self.drives])[:, None]
        zero = np.array([np.broadcast_to(drive.sensor_zero, rotor[0].shape) for drive in self.drives])
        return ratio * rotor + zero, link + zero

    def motion(self) -> tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
        """True angles, and speeds, of rotors behind their gears and of links (n_joints, B) [rad, rad/s]."""
        found = []
        for every in (
            np.array([run.qpos for run in self._runs]).T,
            np.array([run.qvel for run in self._runs]).T,
        ):
            link = every[self._rotors]
            for i, at in self._twists.items():
                link[i] += every[at]
            found.append((every[self._rotors], link))
        return found[0], found[1]

    def _move(self, time: float, disturbance: np.ndarray) -> None:
        """Carry all runs over one of MuJoCo's steps; disturbance (n_joints, B) [N m] acts on the rotors."""
        (rotors, links), (turning, swinging) = self.motion()
        torque = np.zeros((self.model.nv, len(self._runs)))
        dry, dry_links = np.zeros_like(torque), np.zeros((max(len(self._tendons), 1), len(self._runs)))
        for i, drive in enumerate(self.drives):
            x, r, at = drive.x, drive.gear.ratio, self._rotors[i]
            x.time, x.step = time + 0.5 * STEP, STEP
            x.q_m, x.v_m = r * rotors[i], r * turning[i]
            x.q_a, x.v_a = links[i], swinging[i]
            drive.act()
            push = drive.rotor_push if i in self._twists else joined(drive, 0.0)
            torque[at] = r * (push.torque - push.slope * x.v_m + disturbance[i])
            dry[at] = r * np.where(x.v_m >= 0, push.plus, push.minus)
            if i in self._twists:
                link = drive.link_push
                behind = link.torque - link.slope * x.v_a
                torque[at] += behind
                torque[self._twists[i]] = behind
                dry_links[self._tendons[i]] = np.where(x.v_a >= 0, link.plus, link.minus)
        for b, run in enumerate(self._runs):
            run.qfrc_applied[:] = torque[:, b]
            self.model.dof_frictionloss[:] = dry[:, b]
            if self._tendons:
                self.model.tendon_frictionloss[:] = dry_links[:, b]
            self._mujoco.mj_step(self.model, run)
