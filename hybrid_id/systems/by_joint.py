"""One joint of a robot by itself, or some of them, the others moving as they were measured."""

from __future__ import annotations

import copy
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
from torch.nn import Module, ModuleDict

from hybrid_id.components.base import Component, Shared
from hybrid_id.components.input.delay import CommonDelay, Delay
from hybrid_id.components.load.floor_contact import FloorContact
from hybrid_id.components.load.gravity_compensation import GravityCompensation
from hybrid_id.errors import InputError, close_match
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.derivatives import noise_level, smooth_derivatives
from hybrid_id.records.measures import sensor_noise
from hybrid_id.records.record import Record
from hybrid_id.records.units import number_of
from hybrid_id.robots.tree import RigidBodyTree
from hybrid_id.systems.arm import MOTION
from hybrid_id.systems.builders import joint_names
from hybrid_id.systems.chain import System
from hybrid_id.systems.joint import Joint

THRESHOLD = 0.25
"""Of the smoothing of the others' motion: six times below the usual one, for noise averages out and bias does not."""
NOISIER = 2
"""Times that a fit is made again with noisier motion of the others, for how far it moves the estimates."""
STILL = 10.0
"""Range of an angle, in standard deviations of its noise, up to which a joint has not moved."""
EVERYWHERE = FloorContact, CommonDelay, GravityCompensation
"""What acts on all joints and may be listed at any of them."""
STANDS = "stands still in all train records, so it is held where it was measured"
"""Why a joint is not diagnosed."""
UNITS = {"hinge": ("rad", "rad/s", "rad/s^2"), "slide": ("m", "m/s", "m/s^2")}


def joint_number(system: System, name: str) -> int:
    """Number, from 0, of a robot's joint by its name; InputError where it has none of that name."""
    names = _tree(system).names
    if name not in names:
        raise InputError(
            f"The robot has no joint '{name}'{close_match(name, names)}; it has {', '.join(names)}."
        )
    return names.index(name)


def named(system: System, place: str) -> str:
    """A place of a joint by itself (``joint3/motor``, ``play@joint3/motor``) with the joint's name in the robot.

    Places of any other system stay as they are.
    """
    names = () if system.tree is None or system.seats is None else system.tree.names
    own = {joint.name: names[joint.number - 1] for joint in system.joints if names}
    return re.sub(r"\bjoint\d+(?=/|$)", lambda found: own.get(found[0], found[0]), place)


def numbered(system: System, place: str) -> str:
    """A place, which may name a robot's joint as the robot does (``elbow/motor``), with the joint's number in it."""
    joint, _, where = place.rpartition("/")
    names = () if system.tree is None or system.seats is not None else system.tree.names
    return f"joint{names.index(joint) + 1}/{where}" if joint in names else place


def with_joint_names(channels: Sequence[Channel], system: System) -> tuple[Channel, ...]:
    """Channels that know the name of their joint, where the system is a robot with a description, or a part of one."""
    names = [] if system.tree is None else system.tree.names
    joints = {str(number): name for number, name in enumerate(names, 1)}
    return tuple(replace(channel, joint=joints.get(number_of(channel.name), "")) for channel in channels)


def alone(system: System, joint: int) -> System:
    """The drive of one joint of a robot, by its number from 0: :func:`some` of one."""
    return some(system, [joint])


def turned_together(system: System, joint: int) -> list[int]:
    """Numbers of the joints that are taken together with one, itself included: those of its coupled gear.

    Args:
        system: a robot with a tree.
        joint: number of the joint, from 0.
    """
    gear = _tree(system).coupling(joint)
    return [joint] if gear is None else sorted(gear.joints)


def joint_parts(system: System) -> dict[str, list[int]]:
    """Numbers of the joints that are taken together, by a name for them: ``elbow``, ``wrist_5 + wrist_6``.

    Args:
        system: a robot with a tree.
    """
    return {part_with(system, name): turned_together(system, k) for k, name in enumerate(_tree(system).names)}


def part_with(system: System, joint: str) -> str:
    """The name in :func:`joint_parts` of what a joint belongs to; InputError where the robot has none of its name."""
    names = _tree(system).names
    return " + ".join(names[k] for k in turned_together(system, joint_number(system, joint)))


def some(system: System, joints: Sequence[int]) -> System:
    """The drives of some joints in the robot's tree; the motion of the others comes with the records.

    ``M_ii a_i + sum_j M_ij a_j + h_i(q, v) = tau_i``, the sum and all q_j, v_j of the others as logged. Parameters,
    places and channels keep the names and numbers that they have in the robot, so that what is found goes back with
    ``with_specs``. Payloads and inertias that are listed at other joints stay at their values.

    Args:
        system: a robot with a tree.
        joints: numbers of the joints in the tree, from 0.
    """
    tree, here = _tree(system), tuple(f"joint{joint + 1}/" for joint in joints)
    parts, moved = [], {}
    delayed = _delayed(system.components)
    late = [joint for joint in here if joint not in delayed]
    for key, part in system.components.items():
        own = key.startswith(here)
        if own or isinstance(part, EVERYWHERE):
            if isinstance(part, CommonDelay) and not late:
                continue  # each of them has a delay of its own instead
            first = late[0] if isinstance(part, CommonDelay) else here[0]
            there = key if own else first + key.split("/", 1)[1]
            if there in moved.values():
                kind = cast(Component, part).kind
                raise InputError(
                    f"The model lists {kind} at several joints, which none takes by itself; keep one."
                )
            moved[key] = there
            parts.append((there.rpartition("/")[0], copy.deepcopy(cast(Component, part))))
    aliases = {(moved[i.component], i.symbol): i.name for i in system.table if i.component in moved}
    views = system.views([value.reshape(1) for value in system.theta().detach()])
    bodies = system.arm.bodies(views)
    # of a controller that may hold the links' weight, and knows no payload and no tilt
    tree = replace(tree, believed=tree.believed or tree)
    tree = tree.with_bodies([body.held() for key, body in bodies.items() if not key.startswith(here)])
    if not any(key.startswith(here) for key, _ in system.arm.tilts):
        tree = tree.falling(system.arm.gravity(views))
    one = System([system.gear_ratio[joint] for joint in joints], parts, aliases, system.name, tree, joints)
    one.whole = (system,)
    return one


def together(one: System) -> System:
    """The whole robot with the drives that :func:`some` took out of it, as they are now."""
    return with_drive(one.whole[0], one)


def with_drive(whole: System, one: System) -> System:
    """A robot with the drives that :func:`some` took out of it instead of its own.

    What acts on all joints is as the first of them says that has moved it: one that does not feel a floor leaves it
    where it was.
    """
    here = tuple(f"{joint.name}/" for joint in one.joints)
    before = one.whole[0].components
    was = {_what(part): key for key, part in before.items() if isinstance(part, EVERYWHERE)}
    parts = {
        key: part
        for key, part in whole.components.items()
        if not key.startswith(here) or isinstance(part, EVERYWHERE)
    }
    taken = {
        _what(part) for key, part in parts.items() if isinstance(part, Shared) and key not in was.values()
    }
    for key, part in one.components.items():
        if isinstance(part, Shared) and _what(part) in taken:
            continue  # another joint has said what is there, which acts on all that carry it
        place = was.get(_what(part), key)
        if place not in parts or _sizes(parts[place]) == _sizes(before[place]):
            parts[place] = part
    # a common dead time is listed at a joint that has none of its own, where there is one
    common = next((key for key, part in parts.items() if isinstance(part, CommonDelay)), "")
    delayed = _delayed(parts)
    if common.split("/")[0] + "/" in delayed:
        delay, free = parts.pop(common), sorted({key.split("/")[0] + "/" for key in parts} - delayed)
        parts |= {free[0] + common.split("/", 1)[1]: delay} if free else {}
    placed = [(k.rpartition("/")[0], copy.deepcopy(cast(Component, part))) for k, part in parts.items()]
    return System(whole.gear_ratio, placed, joint_names(_tree(whole), placed), whole.name, whole.tree)


def _sizes(part: object) -> dict[str, float]:
    return {symbol: spec.value for symbol, spec in cast(Component, part).specs.items()}


def _delayed(parts: Mapping[str, Module] | ModuleDict) -> set[str]:
    """Joints, ``joint2/``, that have a delay of their own."""
    return {key.split("/")[0] + "/" for key, part in parts.items() if isinstance(part, Delay)}


def _what(part: object) -> tuple[str, str]:
    """What a component that acts on several joints is, and where on the robot."""
    return getattr(part, "kind", ""), getattr(part, "point", "")


def asked_parts(system: System, names: Sequence[str]) -> list[str]:
    """Of names of joints, or of parts (:func:`joint_parts`), those of the parts; InputError where there is none."""
    parts = joint_parts(system)
    return [name if name in parts else part_with(system, name) for name in names]


def with_others_measured(dataset: Dataset, system: System, *joints: int) -> Dataset:
    """The records as :func:`some` reads them: the joints' own channels, and the smoothed motion of the others.

    The others' motion is that of the middle of each sample, during which it is held. It is smoothed little
    (:data:`THRESHOLD`): what smoothing takes from a motion no interval can know, noise is found by :func:`noisier`.

    Args:
        dataset: of the whole robot, its channels numbered as its joints are.
        system: the robot.
        joints: their numbers, from 0.

    Raises:
        InputError: an angle of another joint was not measured, or an output is of a joint that the robot lacks.
    """
    system.check_outputs([channel.name for channel in dataset.outputs])
    own = [str(joint + 1) for joint in joints]
    inputs, outputs = (
        tuple(c for c in channels if number_of(c.name) in own)
        for channels in (dataset.inputs, dataset.outputs)
    )
    records = []
    for record in dataset.records:
        given, measured = (
            {n: v for n, v in values.items() if number_of(n) in own}
            for values in (record.inputs, record.outputs)
        )
        motions = {}
        for k in range(len(system.joints)):
            if k in joints:
                continue
            for channel, rows in zip(MOTION, measured_motion(record, system, k, THRESHOLD), strict=True):
                middle = np.append(0.5 * (rows[1:] + rows[:-1]), rows[-1])
                motions[f"{channel}{k + 1}"] = middle
        records.append(replace(record, inputs={**given, **motions}, outputs=measured))
    motion = tuple(
        Channel(f"{name}{k + 1}", unit)
        for k, other in enumerate(_tree(system).joints)
        if k not in joints
        for name, unit in zip(MOTION, UNITS[other.kind], strict=True)
    )
    return replace(dataset, inputs=(*inputs, *motion), outputs=outputs, records=tuple(records))


def moving_records(dataset: Dataset, *joints: int) -> Dataset:
    """The dataset without the train and validation records in which no joint of these numbers, from 0, moves."""
    kept = (r for r in dataset.records if r.role == "test" or any(moves(r, joint) for joint in joints))
    return replace(dataset, records=tuple(kept))


def moves(record: Record, joint: int) -> bool:
    """Whether a joint, by its number from 0, moves in a record."""
    seen = (record.outputs[n] for n in (f"q_m{joint + 1}", f"q_a{joint + 1}") if n in record.outputs)
    return any(np.ptp(one) > STILL * max(float(noise_level(one)), 1e-12) for one in seen)


def joints_to_diagnose(dataset: Dataset, system: System) -> tuple[list[str], dict[str, str]]:
    """Names of the joints of a robot that can be diagnosed, and of the others, each with the reason.

    Joints of a coupled gear are one (:func:`joint_parts`), which stands still where all of them do.

    Args:
        dataset: of the whole robot.
        system: a robot with a tree.

    Raises:
        InputError: a joint's angle was not measured.
    """
    check_angles(dataset, system)
    moving = {
        name: any(moves(record, joint) for record in dataset.train for joint in part)
        for name, part in joint_parts(system).items()
    }
    return [n for n, able in moving.items() if able], {n: STANDS for n, able in moving.items() if not able}


def with_standing_held(dataset: Dataset, system: System) -> tuple[Dataset, System]:
    """A robot's records and drives without the joints that stand still, which are held where they were measured.

    Args:
        dataset: of the whole robot.
        system: the robot.

    Returns:
        Both as they were where all joints move, or none does.

    Raises:
        InputError: a joint's angle was not measured.
    """
    skipped = joints_to_diagnose(dataset, system)[1]
    standing = [joint for name in skipped for joint in joint_parts(system)[name]]
    moving = [k for k in range(len(system.joints)) if k not in standing]
    if not standing or not moving:
        return dataset, system
    return with_others_measured(dataset, system, *moving), some(system, moving)


def as_in_robot(inputs: Mapping[str, np.ndarray], system: System) -> dict[str, np.ndarray]:
    """Inputs of a joint by itself, with the angles at which the others stay and without their motion.

    Args:
        inputs: of a record as :func:`with_others_measured` makes it, ``(T,)`` each.
        system: the joint by itself; inputs of any other system stay as they are.
    """
    moving = MOTION[1:] if system.seats is not None else ()
    return {name: v for name, v in inputs.items() if name.removesuffix(number_of(name)) not in moving}


def noisier(dataset: Dataset, joint: int, seed: int) -> Dataset:
    """The records with as much noise again on what was measured at the other joints.

    Args:
        dataset: as for :func:`with_others_measured`.
        joint: number of the joint that is taken by itself, from 0.
        seed: of the noise.
    """
    rng, own = np.random.default_rng(seed), str(joint + 1)
    noise = sensor_noise(dataset)

    def drawn(name: str, values: np.ndarray) -> np.ndarray:
        return values if number_of(name) == own else values + rng.normal(0.0, noise[name], values.shape)

    records = (
        replace(one, outputs={name: drawn(name, values) for name, values in one.outputs.items()})
        for one in dataset.records
    )
    return replace(dataset, records=tuple(records))


def measured_motion(
    record: Record, system: System, joint: int, threshold: float | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Smoothed position [rad or m] of a robot's joint, with its speed and acceleration, ``(T,)`` each.

    Args:
        record: of the whole robot.
        system: the robot.
        joint: number of the joint, from 0.
        threshold: how little it is smoothed, see :func:`hybrid_id.records.derivatives.smooth_derivatives`.

    Raises:
        InputError: the record has no angle of the joint.
    """
    own = system.joints[joint]
    sides = {f"q_a{own.number}": 1.0, f"q_m{own.number}": 1.0 / own.gear_ratio}
    name = next((n for n in sides if n in record.outputs), None)
    if own.motors and f"q_a{own.number}" not in record.outputs:
        # a joint that several motors turn, from their angles
        found: list[np.ndarray] = []
        for motor, share in system.joints[joint].motors:
            if (name := f"q_m{motor.number}") not in record.outputs:
                raise InputError(
                    f"{record.title} has no angle of joint '{_tree(system).names[joint]}'; add q_a{joint + 1}, or "
                    f"{name} of a motor that turns it."
                )
            found.append(np.stack(_smoothed(record, motor, name, share, threshold)))
        angle, speed, acceleration = np.sum(found, 0)
        return angle, speed, acceleration
    if name is None:
        raise InputError(_without_angle(record.title, system, joint))
    return _smoothed(record, own, name, sides[name], threshold)


def check_angles(dataset: Dataset, system: System) -> None:
    """Raise InputError where a joint's angle, which the motion of a robot's others depends on, was not measured.

    Or where records hold a joint that the robot has not: a held one, after which all others count one lower.
    """
    measured = [channel.name for channel in dataset.outputs]
    system.check_outputs(measured)
    for k, joint in enumerate(system.joints):
        if not joint.motors and not {f"q_m{joint.number}", f"q_a{joint.number}"}.intersection(measured):
            raise InputError(_without_angle(f"Dataset '{dataset.name}'", system, k))


def _without_angle(who: str, system: System, joint: int) -> str:
    """That records lack the angle of a joint, and what to do about it."""
    names, file = _tree(system).names, Path(_tree(system).source).name
    after = "" if joint == len(names) - 1 else "; the channels of the joints after it then count one lower"
    return (
        f"{who} has no angle of joint '{names[joint]}'; add q_a{joint + 1} or q_m{joint + 1}, or, if the joint stands "
        f"still, hold it in the model file where it stands (robot: {{file: {file}, hold: {{{names[joint]}: 0.0}}}}; 0 "
        f"is the zero of the description){after}."
    )


def _smoothed(
    record: Record, joint: Joint, name: str, scale: float, threshold: float | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Smoothed angle of an output of a joint times a scale, with its derivatives, ``(T,)`` each."""
    sensors = [part for _, part in joint.sensing.sensors if part.channel == name[:3]]
    offset = sum(part.specs["offset"].value for part in sensors if "offset" in part.specs)
    steps = record.sample_time if record.is_uniform else record.time
    given = {} if threshold is None else {"threshold": threshold}
    return smooth_derivatives((record.outputs[name] - offset) * scale, steps, **given)


def _tree(system: System) -> RigidBodyTree:
    if system.tree is None or system.seats is not None:
        raise InputError(
            "Joints are taken one by one of a whole robot; give a model that names its description."
        )
    return system.tree
