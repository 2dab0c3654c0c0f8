"""Systems made of their usual parts, of networks alone, and of what an earlier stage has found."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from hybrid_id.components.base import Component, Input, Sensor
from hybrid_id.components.friction.asymmetric_stribeck import AsymmetricStribeck
from hybrid_id.components.friction.coulomb import Coulomb
from hybrid_id.components.friction.viscous import Viscous
from hybrid_id.components.input.position_servo import PositionServo
from hybrid_id.components.input.torque_command import TorqueCommand
from hybrid_id.components.load.arm_gravity import ArmGravity
from hybrid_id.components.load.constant_torque import ConstantTorque
from hybrid_id.components.load.gravity import Gravity
from hybrid_id.components.load.gravity_compensation import GravityCompensation
from hybrid_id.components.load.one_link import OneLink
from hybrid_id.components.load.rotor_inertia import RotorInertia
from hybrid_id.components.load.spring import Spring
from hybrid_id.components.load.two_link import JointCoupling, LinkInertia
from hybrid_id.components.motor.free_rotor import FreeRotor
from hybrid_id.components.motor.torque_motor import TorqueMotor
from hybrid_id.components.residual import ResidualNetwork
from hybrid_id.components.transmission.rigid import Rigid
from hybrid_id.errors import InputError
from hybrid_id.parameters import Bounded
from hybrid_id.robots.tree import RigidBodyTree, Servo, TreeJoint
from hybrid_id.systems.chain import System
from hybrid_id.systems.model_schema import FLAT, SKELETON

ROTOR_SHARE = 0.1
"""Start of a rotor's inertia at the joint, by the largest inertia that a joint of the arm carries."""
STOPPED_WITHIN = 0.3
"""Start of a damping: the time [s] in which it takes a joint's speed down to 37 %."""


def one_link(gear_ratio: float = 1.0, *, friction: Component | None = None, vertical: bool = False) -> System:
    """One rigid link: ``J a = P_m1 (u - P_m2 v) - F_c sgn v - F_v v - (G_l / r) sin(q / r)``, motor side.

    Args:
        gear_ratio: motor turns per joint turn.
        friction: law in place of Coulomb and viscous friction (for example ``AsymmetricStribeck()``).
        vertical: whether gravity acts (``G_l``), q = 0 hanging down.
    """
    return _single("one_link", gear_ratio, friction, [("joint1/load", Gravity())] if vertical else [])


def one_link_flexible(
    gear_ratio: float = 1.0, *, friction: Component | None = None, vertical: bool = False
) -> System:
    """One link behind a linear spring: rotor ``J_m, F_cm, F_vm``, link ``J_a, F_va``, spring ``k, d``.

    Args:
        gear_ratio: motor turns per joint turn.
        friction: motor-side law in place of Coulomb and viscous friction.
        vertical: whether gravity acts (``G_l``), q = 0 hanging down.
    """
    more: list[tuple[str, Component]] = [("joint1/link_friction", Viscous())]
    more += [("joint1/load", Gravity())] if vertical else []
    return _single("one_link_flexible", gear_ratio, friction, more)


def _single(
    name: str, gear_ratio: float, friction: Component | None, more: Sequence[tuple[str, Component]]
) -> System:
    """One joint: what its system always has, friction at the motor, and more."""
    frictions = [friction] if friction else [Coulomb(), Viscous()]
    parts = [(where, kind()) for where, kind in SKELETON[name]]
    parts += [("joint1/motor_friction", law) for law in frictions]
    return System([gear_ratio], [*parts, *more], FLAT_NAMES[name], name=name)


def two_link(gear_ratio: tuple[float, float] = (1.0, 1.0), *, vertical: bool = False) -> System:
    """Planar arm of two links behind rigid gears, paper eq. (13)-(14), its angles on the motors' side.

    ``M(q) a + c(q, v) = r (tau_m - F_c sgn v_m - F_v v_m)`` at the links, ``q_m = r q``, q_2 relative to link 1; M and
    c are those of :class:`~hybrid_id.components.JointCoupling` with the P of the two joints.

    Args:
        gear_ratio: motor turns per joint turn of both joints.
        vertical: whether gravity acts (``G_l1``, ``G_l2``), stretched and hanging down at q = 0.
    """
    parts = [(where, kind()) for where, kind in SKELETON["two_link"]]
    parts += [(f"joint{n}/motor_friction", law()) for n in (1, 2) for law in (Coulomb, Viscous)]
    parts += [(f"joint{n}/load", LinkInertia(P=inertia)) for n, inertia in ((1, 1.0), (2, 0.15))]
    parts.append(("joint1/load", JointCoupling(P_3=0.15, P_4=0.07)))
    if vertical:
        parts.append(("joint1/load", ArmGravity(G_l1=10.0, G_l2=3.0)))
    return System(gear_ratio, parts, FLAT_NAMES["two_link"], name="two_link")


def robot(tree: RigidBodyTree, gear_ratio: Sequence[float] | None = None) -> System:
    """Any arm: a rigid drive with dry and viscous friction at every joint of its rigid-body tree.

    A joint with a position loop is driven by its goal, any other by a torque. Gains, armature, damping, dry friction
    and springs of the description become the drives' start values, seen at the motor; :func:`started` says what stands
    in for those that it lacks.

    Args:
        tree: of the robot, see :func:`hybrid_id.robots.description.load_tree`.
        gear_ratio: motor turns per joint turn, one a joint; 1 where it is not given.

    Raises:
        InputError: joints that tendons or equality constraints tie are not held.
    """
    # refuse a tree whose joints do not all move by themselves
    if tree.tied:
        by = " and ".join(dict.fromkeys(tie.by for tie in tree.tied.values()))
        places = {**tree.held, **{name: tie.at for name, tie in tree.tied.items()}}
        hold = ", ".join(f"{name}: {at:g}" for name, at in places.items())
        entry = f"robot: {{file: {Path(tree.source).name}, hold: {{{hold}}}}}"
        raise InputError(
            f"{tree.source}: {', '.join(tree.tied)} cannot move freely here ({by}); hold what stands still, as a "
            f"gripper or a base on a rack, where it stands, in model.yaml ('{entry}'); where a wrist's gear couples "
            "joints, take that out and write 'couplings' in model.yaml."
        )
    ratios = [1.0] * len(tree.joints) if gear_ratio is None else [float(r) for r in gear_ratio]
    parts: list[tuple[str, Component]] = []
    for number, (joint, ratio) in enumerate(zip(started(tree), ratios, strict=True), 1):
        try:
            parts += [(f"joint{number}/{place}", one) for place, one in _drive(joint, ratio)]
        except InputError as error:
            where = Path(tree.source).name or "the robot's description"
            raise InputError(f"{where}, joint '{joint.name}': {error}") from None
    if tree.believed is not None:
        parts.append(("joint1/load", GravityCompensation(c_g=Bounded(1.0, 0.0, 2.0, "1", estimate=False))))
    return System(ratios, parts, joint_names(tree, parts), name="robot", tree=tree)


def _drive(joint: TreeJoint, ratio: float) -> list[tuple[str, Component]]:
    """The rigid drive of a joint by its description, its parameters seen at the motor."""
    spring = [("load", Spring(k_s=joint.stiffness, q_s=joint.reference))] if joint.stiffness else []
    return [
        ("input", TorqueCommand() if joint.servo is None else position_servo(joint.servo)),
        ("motor", TorqueMotor()),
        ("motor_friction", Coulomb(F_c=joint.friction_loss / ratio)),
        ("motor_friction", Viscous(F_v=joint.damping / ratio**2)),
        ("transmission", Rigid()),
        ("load", RotorInertia(J_m=joint.armature / ratio**2)),
        *spring,
    ]


def position_servo(servo: Servo) -> PositionServo:
    """The input that a description's position loop is."""
    limit = {} if servo.largest is None else {"tau_max": servo.largest}
    goals = {} if servo.goals is None else dict(zip(("goal_min", "goal_max"), servo.goals, strict=True))
    return PositionServo(k_p=servo.stiffness, k_d=servo.damping, **limit, **goals)


def started(tree: RigidBodyTree) -> list[TreeJoint]:
    """Joints of a tree, with a start for the rotors that its description does not know, as no URDF does.

    A rotor of no inertia starts no fit: its joint, if it carries little, runs away under any torque. So where the
    armature is 0 it starts at a share of the largest inertia that any joint of its kind carries at position zero, for
    drives of an arm are of a size; and where there is no damping either, that starts as one that stops the joint
    within a time (:data:`ROTOR_SHARE`, :data:`STOPPED_WITHIN`).
    """
    found = []
    for joint, own in zip(tree.joints, tree.at_zero, strict=True):
        if not joint.armature:
            alike = zip(tree.joints, tree.at_zero, strict=True)
            rotor = ROTOR_SHARE * max(mass for other, mass in alike if other.kind == joint.kind)
            joint = replace(joint, armature=rotor, damping=joint.damping or (rotor + own) / STOPPED_WITHIN)
        found.append(joint)
    return found


def joint_names(tree: RigidBodyTree, parts: Sequence[tuple[str, Component]]) -> dict[tuple[str, str], str]:
    """Result names of a robot's parameters: symbol and joint, ``F_c_elbow``; place and kind too where that is twice."""
    named: dict[tuple[str, str], tuple[str, str]] = {}
    for where, part in parts:
        joint, place = where.split("/")
        for symbol in part.declared:
            short = f"{symbol}_{tree.names[int(joint[5:]) - 1]}"
            named[f"{where}/{part.kind}", symbol] = short, f"{short}_{place}_{part.kind}"
    chosen = [short for short, _ in named.values()]
    return {key: short if chosen.count(short) == 1 else long for key, (short, long) in named.items()}


FLAT_NAMES: dict[str, dict[tuple[str, str], str]] = {
    system: {
        (f"{where}/{kind}", symbol): name for name, (where, kind, symbol) in flat.items() if name != symbol
    }
    for system, flat in FLAT.items()
}
FLAT_NAMES["two_link"] |= {
    (f"joint{n}/motor_friction/{AsymmetricStribeck.kind}", symbol): f"{symbol}m{n}"
    for n in (1, 2)
    for symbol in AsymmetricStribeck.declared
}
"""Result names where they differ from the bare symbol: the flat names of the model file, and the paper's."""


def black_box(
    system: System,
    accelerations: Sequence[float],
    *,
    inputs: Sequence[str] = (),
    hidden: Sequence[int] = (16,),
    seed: int = 0,
) -> System:
    """``dv/dt = a g(q, v, u) - b`` for each joint: a neural ODE of second order, network g, no law of physics.

    Channels, gear ratios and encoders are those of the given system, and nothing else of it: a link sits on its motor.
    The inertia 1 / a only scales the network, and the constant b, which the network can say as well, is there because
    a training begins with a fit of something.

    Source: R. T. Q. Chen et al., Neural Ordinary Differential Equations, NeurIPS 2018; of second order as in
    A. Norcliffe et al., On Second Order Behaviour in Augmented Neural ODEs, NeurIPS 2020.

    Args:
        system: model whose place it takes.
        accelerations: typical size a of each joint's acceleration at its motor [rad/s^2].
        inputs: what the networks read beside their joint's angle, speed and command, and the other links' motion.
        hidden: neurons of each hidden layer.
        seed: of the first weights.

    Raises:
        InputError: accelerations that are not positive, one a joint.
    """
    if len(accelerations) != len(system.joints) or not all(a > 0.0 for a in accelerations):
        raise InputError(
            f"accelerations {list(accelerations)} must be positive, one for each of {len(system.joints)} joints."
        )
    parts: list[tuple[str, Component]] = []
    for key, part in system.components.items():
        if isinstance(part, Input | Sensor):
            parts.append((key.rpartition("/")[0], copy.deepcopy(part)))
    for joint, acceleration in zip(system.joints, accelerations, strict=True):
        others = [f"{s}{j.number}" for j in system.joints if j is not joint for s in ("angle", "speed")]
        own = ["angle", "speed", "command", *others]
        reads = [*own, *(name for name in inputs if name not in own)]
        scale = Bounded(1.0 / acceleration, 1e-12, 1e6, "kg m^2", estimate=False)
        parts += [
            (f"{joint.name}/motor", FreeRotor()),
            (f"{joint.name}/motor", ResidualNetwork(inputs=reads, hidden=hidden, seed=seed)),
            (f"{joint.name}/transmission", Rigid()),
            (f"{joint.name}/load", OneLink(J=scale)),
            (f"{joint.name}/load", ConstantTorque()),
        ]
    return System(system.gear_ratio, parts, name=system.name)


def carry_over(
    system: System, previous: System, hold: Sequence[str] = (), names: Mapping[str, str] | None = None
) -> System:
    """The system started at the values that an earlier stage found.

    Paper, sections III.D and IV: the flexible model of link 1 keeps the motor and viscous parameters of the rigid
    one, link 2 is identified with joint 1 held, and so on.

    Args:
        system: model of this stage.
        previous: identified model of the earlier stage.
        hold: names of parameters that keep the earlier value; this fit does not move them.
        names: what the earlier stage calls parameters of this model, where it calls them otherwise.

    Raises:
        InputError: a parameter to hold that one of the models lacks, a unit that differs, or a value outside this
            stage's bounds.
    """
    found = {info.name: info.spec for info in previous.table}
    found |= {here: found[there] for here, there in (names or {}).items() if there in found}
    own = {info.name: info.spec for info in system.table}
    for name in hold:
        if name not in found or name not in own:
            lacking = "earlier stage's model" if name not in found else "model"
            shared = ", ".join(n for n in own if n in found) or "none"
            raise InputError(f"The {lacking} has no parameter '{name}' to hold; both models have {shared}.")
    specs = {}
    for name in (n for n in own if n in found):
        if own[name].unit != found[name].unit:
            raise InputError(
                f"Parameter {name} is in {found[name].unit} in the earlier stage and in {own[name].unit} here; "
                "rename one of them."
            )
        specs[name] = own[name].at(found[name].value)
        if name in hold:
            specs[name] = replace(specs[name], estimate=False, prior_mean=None, prior_std=None)
    return system.with_specs(specs)
