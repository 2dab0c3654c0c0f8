"""Trees of links in MuJoCo, each joint with a drive whose laws act on it at every step.

MuJoCo carries the bodies and holds the dry friction of the drives, which is a soft constraint there: it creeps, which
is the point, for it is another physics than the stepping in `machine`. Motor, springs and all other laws act on the
joints as torques. A drive is a hinge whose armature is the rotor; where rotor and link can move apart, a second hinge
in series is the twist between them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hybrid_id.machines.physics.machine import Drive, joined

STEP = 0.5e-3
"""MuJoCo's time step [s]."""
HARD = 'solreffriction="0.002 1" solimpfriction="0.9999 0.9999 0.001"'
"""Dry friction that gives way hardly."""
ROTOR = '<inertial mass="1e-6" pos="0 0 0" diaginertia="1e-9 1e-9 1e-9"/>'
"""A body in front of a twist: the inertia is that of the armature."""


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


class MujocoMachine:
    """A tree of links and the drives of its joints in MuJoCo, one simulation a run.

    Args:
        drives: one a joint, without gears, and without dry friction behind their springs.
        links: as `document` takes them.
        gravity: [m/s^2], along -z.

    Attributes:
        trail: true motion before each sample, see `motion`.
    """

    def __init__(self, drives: list[Drive], links: Sequence[Link], *, gravity: float) -> None:
        import mujoco

        self._mujoco: Any = mujoco
        self.drives = drives
        soft = [i for i, drive in enumerate(drives) if drive.spring is not None]
        text = document(
            links,
            [f'armature="{drive.rotor:.9g}" {HARD}' for drive in drives],
            twisting=soft,
            options=f'timestep="{STEP}" gravity="0 0 {-gravity}" integrator="Euler"',
        )
        self.model: Any = self._mujoco.MjModel.from_xml_string(text)
        self._rotors = [int(self.model.joint(f"j{i + 1}").qposadr[0]) for i in range(len(drives))]
        self._twists = {i: int(self.model.joint(f"t{i + 1}").qposadr[0]) for i in soft}

    def begin(self, lanes: int, samples: int, sample_time: float, angles: Any) -> None:
        """Prepare B runs of so many samples [s], at rest at link angles (n_joints, B) [rad]."""
        self._steps, self._sample_time = round(sample_time / STEP), sample_time
        self.trail: list[tuple[np.ndarray, ...]] = []
        self._runs = [self._mujoco.MjData(self.model) for _ in range(lanes)]
        for drive in self.drives:
            drive.start(lanes, np.zeros(lanes))
            drive.x.history, drive.x.sample_time = np.zeros((samples, lanes)), sample_time
        for b, run in enumerate(self._runs):
            run.qpos[self._rotors] = angles[:, b]

    def advance(self, commands: np.ndarray, disturbance: np.ndarray) -> None:
        """Carry all runs over one sample with held commands and torques (n_joints, B) that disturb the rotors [N m]."""
        sample = len(self.trail)
        self.trail.append(self.motion())
        for drive, command in zip(self.drives, commands, strict=True):
            drive.x.command = command
            drive.x.history[sample] = command
        for i in range(self._steps):
            self._move(sample * self._sample_time + i * STEP, disturbance)

    def angles(self) -> tuple[np.ndarray, np.ndarray]:
        """Rotor and link angles (n_joints, B) [rad] as the sensors give them."""
        rotor, link, *_ = self.motion()
        zero = np.array([np.broadcast_to(drive.sensor_zero, rotor[0].shape) for drive in self.drives])
        return rotor + zero, link + zero

    def motion(self) -> tuple[np.ndarray, ...]:
        """True angles of rotors and of links, and speeds of both, (n_joints, B) [rad, rad/s]."""
        found = []
        for every in (
            np.array([run.qpos for run in self._runs]).T,
            np.array([run.qvel for run in self._runs]).T,
        ):
            link = every[self._rotors]
            for i, at in self._twists.items():
                link[i] += every[at]
            found += [every[self._rotors], link]
        return tuple(found)

    def _move(self, time: float, disturbance: np.ndarray) -> None:
        """Carry all runs over one of MuJoCo's steps."""
        rotors, links, turning, swinging = self.motion()
        torque = np.zeros((self.model.nv, len(self._runs)))
        dry = np.zeros_like(torque)
        for i, drive in enumerate(self.drives):
            x, at = drive.x, self._rotors[i]
            x.time, x.step = time + 0.5 * STEP, STEP
            x.q_m, x.v_m, x.q_a, x.v_a = rotors[i], turning[i], links[i], swinging[i]
            drive.act()
            push = drive.rotor_push if i in self._twists else joined(drive, 0.0)
            torque[at] = push.torque - push.slope * x.v_m + disturbance[i]
            dry[at] = np.where(x.v_m >= 0, push.plus, push.minus)
            if i in self._twists:
                behind = drive.link_push.torque - drive.link_push.slope * x.v_a
                torque[at] += behind
                torque[self._twists[i]] = behind
        for b, run in enumerate(self._runs):
            run.qfrc_applied[:] = torque[:, b]
            self.model.dof_frictionloss[:] = dry[:, b]
            self._mujoco.mj_step(self.model, run)
