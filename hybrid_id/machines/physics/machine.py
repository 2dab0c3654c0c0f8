"""A machine: links, the drive of each joint, and the time stepping that carries them through dry friction.

Moreau's midpoint rule (J. J. Moreau, "Unilateral contact and dry friction in finite freedom dynamics", 1988): positions
go half a step, forces act there, speeds take the whole impulse, positions go the other half. Linear damping is taken in
the middle of old and new speed, other laws at the speed there as the last step went; dry friction takes at most its own
impulse off the new speed, so that a joint stops and stays. Second order while it slides or sticks, and stable at any
friction. Many runs go side by side.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from hybrid_id.machines.physics.law import Lanes, Law, Push, Signals
from hybrid_id.machines.physics.motor import Motor
from hybrid_id.machines.physics.steps import Place, Steps
from hybrid_id.machines.physics.transmission import Gear


@dataclass
class OneLink:
    """One link of inertia J [kg m^2]."""

    J: Lanes

    def mass(self, q: list[np.ndarray]) -> tuple[Lanes, Lanes, Lanes]:
        """Elements 11, 12, 22 of the mass matrix."""
        return self.J, 0.0, 1.0

    def bias(self, q: list[np.ndarray], v: list[np.ndarray]) -> list[Lanes]:
        """Torques that the motion itself asks for, each joint (B,)."""
        return [0.0]


@dataclass
class TwoLinks:
    """Two links in a plane, ``a`` and ``b`` about their joints with the other stretched along, ``c`` the coupling.

    ``M = [[a + 2 c cos q_2, b + c cos q_2], [., b]]``, all [kg m^2]; tilted out of the horizontal plane, the links pull
    with ``G_1 sin(q_1 - q_0)`` and ``G_2 sin(q_1 + q_2 - q_0)`` [N m].
    """

    a: Lanes
    b: Lanes
    c: Lanes
    G_1: Lanes = 0.0
    G_2: Lanes = 0.0
    q_0: Lanes = 0.0

    def mass(self, q: list[np.ndarray]) -> tuple[Lanes, Lanes, Lanes]:
        """Elements 11, 12, 22 of the mass matrix."""
        swing = self.c * np.cos(q[1])
        return self.a + 2 * swing, self.b + swing, self.b

    def bias(self, q: list[np.ndarray], v: list[np.ndarray]) -> list[Lanes]:
        """Coriolis and centrifugal torques and those of gravity, each joint (B,)."""
        swing = self.c * np.sin(q[1])
        second = self.G_2 * np.sin(q[0] + q[1] - self.q_0)
        first = self.G_1 * np.sin(q[0] - self.q_0) + second
        return [first - swing * (2 * v[0] + v[1]) * v[1], second + swing * v[0] ** 2]


@dataclass
class Drive:
    """The chain of one joint; effects add to its lists or replace its parts.

    Attributes:
        gear: ratio and errors.
        rotor: inertia of the rotor [kg m^2].
        motor: torque of the motor.
        amplifier: laws between command and terminals, in their order.
        rotor_laws, link_laws: what acts on rotor and link.
        spring: None where rotor and link move as one.
        sensor_zero: what the encoder reads at angle zero [rad].
    """

    gear: Gear
    rotor: Lanes
    motor: Motor
    amplifier: list[Law] = field(default_factory=list)
    rotor_laws: list[Law] = field(default_factory=list)
    link_laws: list[Law] = field(default_factory=list)
    spring: Law | None = None
    sensor_zero: Lanes = 0.0

    def start(self, lanes: int, angle: np.ndarray) -> None:
        """Set the joint of B runs to rest at a link angle (B,) [rad]."""
        for law in (self.motor, *self.laws()):
            law.start(lanes)
        self.x = x = Signals(lanes)
        x.q_m, x.q_a = angle * self.gear.ratio, angle.copy()
        self.needs_carried = any(law.needs_carried for law in self.rotor_laws)

    def laws(self) -> list[Law]:
        """What may have a memory beside the motor."""
        spring = [self.spring] if self.spring else []
        return [*self.amplifier, *self.rotor_laws, *self.link_laws, *spring]

    def push(self, time: float, step: float) -> None:
        """Move angles and, as the last step went, speeds on to the middle of the step, and sum what acts there."""
        x, half = self.x, 0.5 * step
        x.time, x.step = time + half, step
        x.q_m, x.v_m = x.q_m + half * x.v_m, _ahead(x.v_m, x.rise_m)
        if self.spring is not None:
            x.q_a, x.v_a = x.q_a + half * x.v_a, _ahead(x.v_a, x.rise_a)
        self.act()

    def act(self) -> None:
        """Sum what acts on rotor and link at their angles and speeds; a link without a spring goes with its rotor."""
        x = self.x
        self.slope = self.gear.slope(x.q_m)
        if self.spring is None:
            x.q_a, x.v_a = self.gear.angle(x.q_m), self.slope * x.v_m
        volts = x.command
        for law in self.amplifier:
            volts = law.volts(volts, x)
        x.volts = volts
        self.rotor_push, self.link_push = rotor, link = Push(), Push()
        self.motor.act(rotor, x)
        for law in self.rotor_laws:
            law.act(rotor, x)
        for law in self.link_laws:
            law.act(link, x)
        if self.spring is not None:
            twist, rate = self.gear.angle(x.q_m) - x.q_a, self.slope * x.v_m - x.v_a
            torque = self.spring.torque(twist, rate, x.step)
            x.carried = self.slope * torque
            rotor.torque = rotor.torque - x.carried
            link.torque = link.torque + torque


def _ahead(speed: np.ndarray, rise: np.ndarray) -> np.ndarray:
    """Speed in the middle of a step that goes like the one before; what stands or is about to stop stays as it is."""
    middle = speed + 0.5 * rise
    return np.where(speed * middle > 0, middle, speed)


SETTLING, SETTLING_STEP, BRAKE = 30.0, 1e-3, 8.0
"""Longest time and step [s] in which a machine comes to rest before its records start, and the braking then [1/s]."""
CALM = 100
"""Steps after which it is seen whether all have come to rest."""
SWEEPS = 6
"""Rounds in which two joints settle which of them stick; where both slide, their speeds are then solved for at once."""


class Machine:
    """Drives and links of one robot; B runs may differ in any parameter.

    Args:
        drives: one a joint.
        links: their inertia.
        substeps: steps a sample.
    """

    def __init__(self, drives: list[Drive], links: OneLink | TwoLinks, *, substeps: int = 8) -> None:
        self.drives, self.links, self.substeps = drives, links, substeps

    def begin(self, lanes: int, samples: int, sample_time: float, angles: np.ndarray | None = None) -> None:
        """Prepare B runs of so many samples [s], at rest with rotors where link angles (n_joints, B) [rad] have them.

        Without them the machines come to rest from angles zero, without voltage.
        """
        starts = np.zeros((len(self.drives), lanes)) if angles is None else angles
        for drive, angle in zip(self.drives, starts, strict=True):
            drive.start(lanes, np.array(angle, float))
            drive.x.history, drive.x.sample_time = np.zeros((samples, lanes)), sample_time
        if angles is None or any(drive.spring is not None for drive in self.drives):
            self._settle(held=angles is not None)
        self.prepare(lanes, samples, sample_time, 2 * len(self.drives))

    def prepare(self, lanes: int, samples: int, sample_time: float, signals: int) -> None:
        """Write the steps of B runs down, whose samples hold so many signals, commands first."""
        self.sample_time, self.samples_done = sample_time, 0
        h = sample_time / self.substeps
        times = (sample_time * np.arange(samples)[:, None] + h * np.arange(self.substeps)).ravel()
        self._steps = Steps(
            lambda time, inputs: self._driven(time, h, inputs),
            self._states(),
            lanes,
            times,
            inputs=signals,
            substeps=self.substeps,
            kept=2 * len(self.drives),
        )
        for i, drive in enumerate(self.drives):
            drive.x.history = self._steps.inputs[:, i]

    def advance(self, commands: np.ndarray, disturbance: np.ndarray) -> None:
        """Carry all runs over one sample with held commands and disturbing torques (n_joints, B) [V, N m]."""
        now = self._steps.inputs[self.samples_done]
        now[: len(commands)], now[len(commands) :] = commands, disturbance
        self._steps.play(self.samples_done, 1)
        self.samples_done += 1

    def carry(self, commands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Carry all runs through commands (T, n_joints, B) [V]: rotor and link angles, alike, [rad] at all samples."""
        self._steps.inputs[:, : commands.shape[1]] = commands
        self._steps.play(0, len(commands))
        return self._read(np.arange(len(commands)))

    def angles(self) -> tuple[np.ndarray, np.ndarray]:
        """Rotor and link angles (n_joints, B) [rad] as the sensors give them."""
        rotor, link = self._read(np.array([self.samples_done]))
        return rotor[0], link[0]

    def _read(self, samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rotor and link angles (T, n_joints, B) [rad] at some samples (T,)."""
        trail, now, joints = self._steps.trail, self.substeps * samples, len(self.drives)
        rotor, link = trail[now, :joints], trail[now, joints:]
        for i, drive in enumerate(self.drives):
            if drive.spring is None:
                link[:, i] = drive.gear.angle(rotor[:, i])
            rotor[:, i] += drive.sensor_zero
            link[:, i] += drive.sensor_zero
        return rotor, link

    def _states(self) -> list[Place]:
        """Where a step keeps what it carries on: angles of all rotors, then of all links, then the rest."""
        places: list[Place] = [(vars(drive.x), name) for name in ("q_m", "q_a") for drive in self.drives]
        for drive in self.drives:
            places += [(vars(drive.x), n) for n in ("v_m", "v_a", "rise_m", "rise_a", "effort", "carried")]
            for law in (drive.motor, *drive.laws()):
                for name, value in vars(law).items():
                    if name.startswith("_") and isinstance(value, np.ndarray):
                        places.append((vars(law), name))
                    elif name.startswith("_") and isinstance(value, list):
                        places += [(value, i) for i in range(len(value))]
        return places

    def _settle(self, *, held: bool) -> None:
        """Let what pulls at rest come to rest, before the clock starts: links alone where the rotors are held."""
        places, left = [drive.x.q_m for drive in self.drives], 1 - BRAKE * SETTLING_STEP
        still = np.zeros((2 * len(places), places[0].size))

        def step(time: float, inputs: Sequence[np.ndarray] | np.ndarray) -> None:
            self._driven(time, SETTLING_STEP, inputs)
            for drive, place in zip(self.drives, places, strict=True):
                # a hand holds back what would swing for long
                drive.x.v_m, drive.x.v_a = left * drive.x.v_m, left * drive.x.v_a
                if held:
                    drive.x.q_m, drive.x.v_m = place, 0.0 * place

        looks = round(SETTLING / SETTLING_STEP) // CALM
        times = SETTLING_STEP * np.arange(looks * CALM) - SETTLING
        step(times[0], still)  # some laws find their place only now
        steps = Steps(step, self._states(), still.shape[1], times, inputs=len(still), substeps=CALM)
        for k in range(looks):
            steps.play(k, 1)
            if all(np.abs([d.x.v_m, d.x.v_a]).max() < 1e-6 for d in self.drives):
                break
        for drive in self.drives:
            drive.x.v_m, drive.x.v_a = np.zeros_like(drive.x.v_m), np.zeros_like(drive.x.v_a)

    def _driven(self, time: float, h: float, inputs: Sequence[np.ndarray] | np.ndarray) -> None:
        """Carry all runs over one step with commands, then disturbances, of all joints."""
        for drive, command in zip(self.drives, inputs, strict=False):
            drive.x.command = command
            if not isinstance(command, np.ndarray):  # the step is being written down
                drive.x.history = command
        self.step(time, h, inputs[len(self.drives) :])

    def step(self, time: float, h: float, disturbance: Sequence[np.ndarray] | np.ndarray) -> None:
        """Carry all runs over one step of h seconds; disturbance (n_joints, B) [N m] acts on the rotors."""
        drives = self.drives
        before = [(d.x.v_m, d.x.v_a) for d in drives]
        for drive, torque in zip(drives, disturbance, strict=True):
            drive.push(time, h)
            drive.rotor_push.torque = drive.rotor_push.torque + torque
        angles, speeds = [d.x.q_a for d in drives], [d.x.v_a for d in drives]
        m_11, m_12, m_22 = self.links.mass(angles)
        bias = self.links.bias(angles, speeds)
        turning = [d.x.v_m for d in drives]
        for drive, (v_m, v_a) in zip(drives, before, strict=True):
            drive.x.v_m, drive.x.v_a = v_m, v_a
            if drive.spring is not None:  # its rotor is on its own
                drive.x.v_m = _stop(drive.rotor, drive.rotor_push, drive.x.v_m, h)
        if len(drives) == 2:
            self._move_two(drives[0], drives[1], (m_11, m_12, m_22), bias, turning, h)
        elif drives[0].spring is not None:
            drives[0].x.v_a = _stop(m_11, joined(drives[0], bias[0]), drives[0].x.v_a, h)
        else:  # rotor and link are one
            drive, old = drives[0], drives[0].x.v_m
            push, inertia = joined(drive, bias[0], [m_11], turning, [drive]), drive.slope**2 * m_11
            drive.x.v_m = _stop(drive.rotor + inertia, push, old, h)
            if drive.needs_carried:
                drive.x.carried = inertia * (drive.x.v_m - old) / h - drive.slope * drive.link_push.torque
        for drive, (v_m, v_a) in zip(drives, before, strict=True):
            x = drive.x
            x.rise_m, x.rise_a = x.v_m - v_m, x.v_a - v_a
            x.q_m = x.q_m + 0.5 * h * x.v_m
            if drive.spring is not None:
                x.q_a = x.q_a + 0.5 * h * x.v_a

    def _move_two(
        self, first: Drive, second: Drive, mass: tuple, bias: list, turning: Sequence[np.ndarray], h: float
    ) -> None:
        """New speeds of two coupled joints, whose friction is settled in turns (Gauss-Seidel)."""
        m_11, m_12, m_22 = mass
        pair = (first, second)
        old = [d.x.v_m if d.spring is None else d.x.v_a for d in pair]
        rows = ([m_11, m_12], [m_12, m_22])
        pushes = [joined(d, bias[i], rows[i], turning, pair) for i, d in enumerate(pair)]
        ratio = [d.slope if d.spring is None else 1.0 for d in pair]
        own = [
            ratio[i] ** 2 * rows[i][i] + (d.rotor if d.spring is None else 0.0) for i, d in enumerate(pair)
        ]
        cross = ratio[0] * ratio[1] * m_12
        left = [own[i] + 0.5 * h * p.slope for i, p in enumerate(pushes)]
        free = [
            ((own[i] - 0.5 * h * p.slope) * old[i] + cross * old[1 - i] + h * p.torque) / left[i]
            for i, p in enumerate(pushes)
        ]
        felt = [cross / mass for mass in left]
        limits = [_limits(p, h / left[i]) for i, p in enumerate(pushes)]
        new = list(old)
        for _ in range(SWEEPS):
            for i in (0, 1):
                new[i] = _shrink(free[i] - felt[i] * new[1 - i], *limits[i])
        # exact where both slide as their rounds have settled
        driven = [f - np.where(n > 0, high, low) for n, f, (low, high) in zip(new, free, limits, strict=True)]
        exact = [(driven[i] - felt[i] * driven[1 - i]) / (1 - felt[0] * felt[1]) for i in (0, 1)]
        slides = (new[0] * exact[0] > 0) & (new[1] * exact[1] > 0)
        new = [np.where(slides, e, n) for e, n in zip(exact, new, strict=True)]
        for i, drive in enumerate(pair):
            if drive.needs_carried and drive.spring is None:
                a = [(n - o) / h for n, o in zip(new, old, strict=True)]
                drive.x.carried = (
                    ratio[i] ** 2 * rows[i][i] * a[i]
                    + cross * a[1 - i]
                    + ratio[i] * (bias[i] - drive.link_push.torque)
                )
            if drive.spring is None:
                drive.x.v_m = new[i]
            else:
                drive.x.v_a = new[i]


def joined(
    drive: Drive,
    bias: Lanes,
    row: Sequence[Lanes] = (),
    turning: Sequence[np.ndarray] = (),
    drives: Sequence[Drive] = (),
) -> Push:
    """What pushes a link, together with its rotor where both are one body, without the coupling to the other joint.

    A row of the mass matrix, the rotors' speeds and all drives are needed where gears have errors.
    """
    link = drive.link_push
    torque = link.torque - bias
    for m, v, other in zip(row, turning, drives, strict=True):
        if other.gear.errors and other.spring is None:
            torque = torque - m * other.gear.curvature(other.x.q_m) * v**2
    if drive.spring is None and all(
        isinstance(v, float) and v == 0.0 for v in (torque, link.slope, link.plus, link.minus)
    ):
        return drive.rotor_push  # nothing acts on the link
    push = Push()
    if drive.spring is not None:
        push.torque, push.slope, push.plus, push.minus = torque, link.slope, link.plus, link.minus
        return push
    rotor, g = drive.rotor_push, drive.slope
    push.torque = rotor.torque + g * torque
    push.slope = rotor.slope + g**2 * link.slope
    push.plus, push.minus = rotor.plus + g * link.plus, rotor.minus + g * link.minus
    return push


def _stop(inertia: Lanes, push: Push, speed: np.ndarray, h: float) -> np.ndarray:
    """New speed (B,) of a body on its own."""
    left = inertia + 0.5 * h * push.slope
    free = ((inertia - 0.5 * h * push.slope) * speed + h * push.torque) / left
    return _shrink(free, *_limits(push, h / left))


def _limits(push: Push, per_torque: Lanes) -> tuple[Lanes, Lanes]:
    """Changes of speed that friction can make in one step, backwards and forwards."""
    return -per_torque * push.minus, per_torque * push.plus


def _shrink(free: np.ndarray, lower: Lanes, upper: Lanes) -> np.ndarray:
    """Take friction's impulse off a speed, at most to zero."""
    return free - np.minimum(np.maximum(free, lower), upper)
