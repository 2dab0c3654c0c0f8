"""Excitations by a model: the band in which a gear acts most or least, and the motion of all joints of a robot.

For one drive, of which nothing but its limit is known, :func:`hybrid_id.records.excitation.design_multisine` is all.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import Literal, cast

import numpy as np
import torch

from hybrid_id.components.base import Component
from hybrid_id.components.input.goal_rate_limit import GoalRateLimit
from hybrid_id.components.input.position_servo import PositionServo
from hybrid_id.components.input.torque_command import TorqueCommand
from hybrid_id.components.motor.torque_motor import TorqueMotor
from hybrid_id.components.transmission.rigid import Rigid
from hybrid_id.errors import InputError
from hybrid_id.records.excitation import Multisine, design_multisine
from hybrid_id.records.measures import DRIVES
from hybrid_id.records.record import Record
from hybrid_id.robots.base_parameters import BaseParameters, base_parameters
from hybrid_id.robots.tree import RigidBodyTree
from hybrid_id.simulation.compiled import compiled_for
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.stability import with_substeps
from hybrid_id.simulation.step import Engine
from hybrid_id.study.base_parameters import regressors, tree_of
from hybrid_id.systems.builders import joint_names
from hybrid_id.systems.chain import System

EDGES = 6
"""Frequencies, evenly on a logarithmic scale, between which the bands lie."""
STILL = 0.05
"""Motion, as a share of the largest, from which a band identifies anything at all."""
FADE = 2.0
"""Time [s] in which the motion grows from rest and dies away again."""
STARTS_A_JOINT = 20
"""Phase sets that the search for a joint starts from, unless another number is given."""
DRAWS = 40
"""Sets of shifts and signs from which the most informative is taken."""
COARSE = 12
"""Samples per period of the highest tone at which these are compared."""
HALVINGS = 20
"""Halvings of the interval in which the largest amplitude lies that the torques allow."""


@dataclass(frozen=True)
class GearBand:
    """A band, and what the gear does there.

    Attributes:
        band: lowest and highest frequency [Hz].
        share: RMS of the gear's deflection over that of the motor's angle at the joint.
        motion: RMS of the motor's angle at the joint [rad].
    """

    band: tuple[float, float]
    share: float
    motion: float


def bands_by_gear(
    system: System,
    band: tuple[float, float],
    act: Literal["most", "least"],
    *,
    sample_time: float,
    duration: float,
    amplitude: float,
    tones: int,
) -> list[GearBand]:
    """Parts of a band, simulated, the one in which play and flexibility of the first such gear act most or least first.

    A rigid model is identified best where they act least, a model with play or a spring where they act most.

    Args:
        system: its values are the ones that are believed before the experiment.
        band: lowest and highest frequency [Hz].
        act: what is wanted.
        sample_time: [s].
        duration: [s].
        amplitude: peak of the command, in its unit.
        tones: number of tones in each part.

    Raises:
        InputError: all gears are rigid, or no part of the band moves the joint or holds so many tones.
    """
    joint = next((one for one in system.joints if not one.rigid), None)
    if joint is None:
        raise InputError(
            "the model's gears are rigid: no band lets play or flexibility act more than another"
        )
    drive = next((f"{c}{joint.number}" for c in joint.channels if c in DRIVES), None)
    if drive is None:
        raise InputError(
            f"{joint.name} is driven by a servo's goal; give a model with voltage, duty, current or torque"
        )
    sides, found = (f"q_m{joint.number}", f"q_a{joint.number}"), []
    edges = np.geomspace(max(band[0], 1.0 / duration), band[1], EDGES)
    for low, high in combinations(edges.tolist(), 2):
        try:
            design = design_multisine(
                (low, high), sample_time=sample_time, duration=duration, amplitude_limits=amplitude, tones=tones,
                starts=1,
            )  # fmt: skip
        except InputError:
            continue  # too narrow for so many tones
        still = np.zeros(len(design.time))
        inputs = {f"{c}{one.number}": still for one in system.joints for c in one.channels} | {
            drive: design.signal
        }
        record = Record(
            name="excitation", time=design.time, inputs=inputs, outputs=dict.fromkeys(sides, still)
        )
        batch = make_batch(system, [record], noise_std=dict.fromkeys(sides, 1.0), signal_share=0.0)
        y = simulate(system, with_substeps(system, compiled_for(system, Engine()), batch), batch).y[0].numpy()
        motor, link = (
            y[:, batch.outputs.index(sides[0])] / joint.gear_ratio,
            y[:, batch.outputs.index(sides[1])],
        )
        if np.isfinite(y).all() and motor.std() > 0.0:
            found.append(GearBand((low, high), float((motor - link).std() / motor.std()), float(motor.std())))
    largest = max((one.motion for one in found), default=0.0)
    found = [one for one in found if one.motion >= STILL * largest]
    if not found:
        raise InputError(
            f"no part of {band[0]:g} to {band[1]:g} Hz moves {joint.name} and holds {tones} tones; raise --amplitude, "
            "lengthen --duration or ask for fewer tones"
        )
    return sorted(found, key=lambda one: one.share, reverse=act == "most")


@dataclass(frozen=True)
class JointLimits:
    """What a joint may do: position between two ends [rad or m], speed [rad/s or m/s], torque [N m or N] of its motor.

    The torque is seen at the joint.
    """

    name: str
    position: tuple[float, float]
    speed: float
    torque: float

    def within(self, share: float) -> JointLimits:
        """The limits shrunk to a share, the position about its middle."""
        low, high = self.position
        middle, half = 0.5 * (low + high), 0.5 * share * (high - low)
        return JointLimits(self.name, (middle - half, middle + half), share * self.speed, share * self.torque)


@dataclass(frozen=True, eq=False)
class ArmExcitation:
    """A designed motion of a robot, from rest in the middle of the ranges and back to it.

    Attributes:
        limits: of each joint, as they were used.
        designs: multisine of each joint before it was shifted, turned and scaled.
        time: ``(T,)`` [s].
        position, speed: ``(T, n)`` [rad, rad/s or m, m/s].
        torque: that the motors need by the model, at the joints, ``(T, n)`` [N m or N].
        scale: what the torques leave of the amplitude that position and speed allow.
        condition_number: of the base parameters and the friction that the motion excites, columns of length 1.
        std_ratio: geometric mean of the predicted standard errors of these over the one of the median draw.
    """

    limits: tuple[JointLimits, ...]
    designs: tuple[Multisine, ...]
    time: np.ndarray
    position: np.ndarray
    speed: np.ndarray
    torque: np.ndarray
    scale: float
    condition_number: float
    std_ratio: float


def joint_limits(
    system: System, speeds: Mapping[str, float] | None = None, torques: Mapping[str, float] | None = None
) -> tuple[JointLimits, ...]:
    """Limits of a robot's joints: of its description and its servos, or as given.

    Args:
        system: a robot with a tree.
        speeds: largest speed by joint [rad/s or m/s].
        torques: largest torque of the motor by joint, at the joint [N m or N].

    Raises:
        InputError: a joint without a range, a largest speed or a largest torque.
    """
    tree = tree_of(system)
    found = []
    for joint, known in zip(system.joints, tree.joints, strict=True):
        low, high = known.limits
        speed, torque = known.speed_limit, known.torque_limit
        own = [
            cast(Component, part)
            for key, part in system.components.items()
            if key.startswith(f"{joint.name}/")
        ]
        if (servo := next((part for part in own if isinstance(part, PositionServo)), None)) is not None:
            low, high = max(low, servo.specs["goal_min"].value), min(high, servo.specs["goal_max"].value)
            if servo.specs["tau_max"].value < servo.declared["tau_max"].default:
                torque = min(torque, servo.specs["tau_max"].value)
            rates = [part.specs["w_max"].value for part in own if isinstance(part, GoalRateLimit)]
            speed = min([speed, *rates])
        if not np.isfinite(known.limits).all() or not low < high:
            raise InputError(
                f"joint '{known.name}' has no position limits, within which a motion could be designed; give it a "
                "range in the robot's file."
            )
        speed, torque = (speeds or {}).get(known.name, speed), (torques or {}).get(known.name, torque)
        for value, what, option in ((speed, "speed", "--speed"), (torque, "torque", "--torque")):
            if not 0.0 < value < np.inf:
                raise InputError(
                    f"joint '{known.name}' has no largest {what} in the robot's file; give it as {option} "
                    f"{known.name}=VALUE, or one for all joints as {option} VALUE."
                )
        found.append(JointLimits(known.name, (low, high), speed, torque))
    return tuple(found)


def design_arm_motion(
    system: System,
    limits: tuple[JointLimits, ...],
    band: tuple[float, float],
    *,
    sample_time: float,
    duration: float,
    tones: int | None = None,
    rest: float = 0.1,
    starts: int = STARTS_A_JOINT,
    seed: int = 0,
) -> ArmExcitation:
    """Design a motion that fills the limits and excites the robot's base parameters and friction.

    Each joint moves by a multisine of least crest factor, in position and speed together, its amplitudes as 1 / f.
    All have the same tones. Shifts in time and signs, which leave the peaks as they are, are the draw whose
    information about base parameters, dry and viscous friction has the largest determinant; errors of the torques are
    taken to be in proportion to their limits. The torques that the model needs limit the amplitude of all joints by
    one factor; gears are taken as rigid.

    Source: J. Swevers, C. Ganseman, D. Bilgin Tukel, J. De Schutter, H. Van Brussel, Optimal robot excitation and
    identification, IEEE Trans. Robotics and Automation 13(5), 1997. Differs from it by tones of fixed amplitude and
    least crest factor, and by draws in place of a constrained search.

    Args:
        system: a robot with a tree; its values are those that are believed before the experiment.
        limits: see :func:`joint_limits`.
        band: lowest and highest frequency [Hz].
        sample_time: [s].
        duration: one period of the motion [s]; rest and the fades at its ends are added.
        tones: number of tones in the band; None for :func:`hybrid_id.records.excitation.usual_tones`.
        rest: at the middle of the ranges, before the motion [s].
        starts: phase sets that the search for each joint starts from.
        seed: of phases, shifts and signs.

    Raises:
        InputError: tones that do not fit, or a joint whose torque limit does not hold the robot in the middle.
    """
    designs = tuple(
        design_multisine(
            band, sample_time=sample_time, duration=duration, amplitude_limits=one.position, tones=tones,
            spectrum="flat rate", predicted=[(lambda f: 2j * np.pi * f, one.speed)], starts=starts, seed=seed + k,
        )
        for k, one in enumerate(limits)
    )  # fmt: skip
    torques, tree = MotorTorques(system, limits), tree_of(system)
    base = base_parameters(tree)
    length = rest + 2.0 * FADE + duration
    coarse = np.arange(0.0, length, max(1.0 / (COARSE * band[1]), sample_time))
    rng = np.random.default_rng(seed)
    drawn, found = [], []
    for _ in range(DRAWS):
        shifts, signs = rng.uniform(0.0, duration, len(designs)), rng.choice([-1.0, 1.0], len(designs))
        motion = _motion(designs, limits, shifts, signs, coarse - rest, duration)
        scale = torques.largest_scale(motion)
        drawn.append((shifts, signs))
        found.append(_information(tree, base, limits, _scaled(motion, limits, scale)))
    best = int(np.argmax([size for size, _ in found]))
    time = sample_time * np.arange(round(length / sample_time) + 1)
    shifts, signs = drawn[best]
    motion = _motion(designs, limits, shifts, signs, time - rest, duration)
    scale = torques.largest_scale(motion)
    motion = _scaled(motion, limits, scale)
    sizes, count = [size for size, _ in found], len(base.independent) + 2 * len(limits)
    ratio = float(np.exp(0.5 * (np.median(sizes) - sizes[best]) / count))
    return ArmExcitation(
        limits, designs, time, motion[0], motion[1], torques.needed(motion), scale, found[best][1], ratio
    )


def _motion(
    designs: tuple[Multisine, ...],
    limits: tuple[JointLimits, ...],
    shifts: np.ndarray,
    signs: np.ndarray,
    time: np.ndarray,
    duration: float,
) -> np.ndarray:
    """Positions, speeds and accelerations, ``(3, T, n)``, of multisines that grow from rest and die away."""
    own = np.empty((3, len(time), len(designs)))
    for k, design in enumerate(designs):
        own[0, :, k] = signs[k] * (design.at(time + shifts[k]) - design.offset)
        for order in (1, 2):
            own[order, :, k] = signs[k] * design.at(time + shifts[k], order)
    # smooth steps from 0 to 1 and back to 0, at rest at their ends, with their two derivatives
    x = np.clip(np.stack([time, duration + 2.0 * FADE - time]) / FADE, 0.0, 1.0)
    up, down = x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    faster, slower = 30.0 * x**2 * (1.0 - x) ** 2
    starts, ends = 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x)
    s, rate, bend = (
        (up * down)[:, None],
        (faster - slower)[:, None] / FADE,
        (starts + ends)[:, None] / FADE**2,
    )
    found = np.stack(
        [s * own[0], s * own[1] + rate * own[0], s * own[2] + 2.0 * rate * own[1] + bend * own[0]]
    )
    peaks = np.abs(found[1]).max(0) / [one.speed for one in limits]
    found /= max(float(peaks.max()), 1.0)  # the fades may be faster than the multisine
    found[0] += [0.5 * sum(one.position) for one in limits]
    return found


def _scaled(motion: np.ndarray, limits: tuple[JointLimits, ...], scale: float) -> np.ndarray:
    """A motion about the middle with its amplitude multiplied."""
    middle = np.zeros((3, 1, motion.shape[2]))
    middle[0] = [0.5 * sum(one.position) for one in limits]
    return middle + scale * (motion - middle)


def _information(
    tree: RigidBodyTree, base: BaseParameters, limits: tuple[JointLimits, ...], motion: np.ndarray
) -> tuple[float, float]:
    """Logarithm of the determinant of the information, and condition number with columns of length 1."""
    _, columns = regressors(tree, base, [motion])
    columns = columns / np.array([one.torque for one in limits])[:, None]
    flat = columns.reshape(-1, columns.shape[2])
    length = np.linalg.norm(flat, axis=0)
    singular = np.linalg.svd(flat / np.where(length > 0, length, 1.0), compute_uv=False)
    with np.errstate(divide="ignore"):
        size = float(2.0 * (np.log(length).sum() + np.log(singular).sum()))
    return size, float(singular[0] / singular[-1]) if singular[-1] > 0 else np.inf


class MotorTorques:
    """The torques that a robot's motors need for a motion, friction and rotors included, by its model with rigid gears.

    Args:
        system: a robot with a tree.
        limits: of its joints.
    """

    def __init__(self, system: System, limits: tuple[JointLimits, ...]) -> None:
        parts: list[tuple[str, Component]] = []
        for key, part in system.components.items():
            where = key.rpartition("/")[0]
            if where.split("/")[1] in ("motor_friction", "link_friction", "load"):
                parts.append((where, cast(Component, part)))
        for joint in system.joints:
            parts += [
                (f"{joint.name}/{place}", part)
                for place, part in (
                    ("input", TorqueCommand()), ("motor", TorqueMotor()), ("transmission", Rigid()),
                )
            ]  # fmt: skip
        tree = tree_of(system)
        self.system = System(system.gear_ratio, parts, joint_names(tree, parts), system.name, tree)
        self.gearing = np.array(tree.gearing).T * np.array(system.gear_ratio)
        self.views = self.system.views([value.reshape(1) for value in self.system.theta().detach()])
        self.limits = limits

    @torch.no_grad()
    def needed(self, motion: np.ndarray) -> np.ndarray:
        """Torques of the motors, seen at the joints, ``(T, n)`` [N m or N].

        Args:
            motion: positions, speeds and accelerations of the joints, ``(3, T, n)``.
        """
        q, v, a = torch.as_tensor(motion @ self.gearing).permute(0, 2, 1)  # at the motors, (n, T) each
        x = [torch.zeros(q.shape[1], dtype=q.dtype) for _ in self.system.state_names]
        for s, row in enumerate(self.system.speed_rows):
            x[row - 1], x[row] = q[s], v[s]
        still = {name: torch.zeros_like(q[0]) for name in self.system.input_names}
        balances = self.system.balances(x, still, self.views, list(v.abs()), list((v > 0).to(v.dtype)))
        found = []
        for k, (own, reaction) in enumerate(zip(balances.speeds, balances.reactions(list(a)), strict=True)):
            level = own.level
            if own.factor is not None:
                level = level + own.factor * own.transmitted(a[k], reaction).abs()
            force = own.inertia * a[k] + reaction - own.smooth + torch.sign(v[k]) * level
            found.append(self.system.gear_ratio[k] * force + torch.zeros_like(q[0]))
        return torch.stack(found, 1).numpy()

    def largest_scale(self, motion: np.ndarray) -> float:
        """Share of a motion's amplitude, 1 at most, at which no torque exceeds its limit.

        Raises:
            InputError: a joint's torque does not hold the robot in the middle of its ranges.
        """
        limit = np.array([one.torque for one in self.limits])

        def peaks(scale: float) -> np.ndarray:
            return np.abs(self.needed(_scaled(motion, self.limits, scale))).max(0) / limit

        if bool((peaks(1.0) <= 1.0).all()):
            return 1.0
        low, high = 0.0, 1.0
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if bool((peaks(middle) <= 1.0).all()) else (low, middle)
        if low == 0.0:
            worst = int(peaks(0.0).argmax())
            one = self.limits[worst]
            raise InputError(
                f"joint '{one.name}' cannot hold the robot in the middle of its ranges with {one.torque:.3g} N m; "
                "give a larger torque or a narrower range."
            )
        return low
