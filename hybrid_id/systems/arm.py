"""Joints that push each other: off-diagonal inertias and torques between the links of an arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import cast

import torch
from torch import Tensor

from hybrid_id.components.base import Attached, Component, Coupling, Shared
from hybrid_id.components.load.base_tilt import BaseTilt
from hybrid_id.components.load.body_inertia import BodyInertia
from hybrid_id.components.load.floor_contact import FloorContact
from hybrid_id.components.load.gravity_compensation import GravityCompensation
from hybrid_id.components.load.payload import Payload
from hybrid_id.components.load.rotor_inertia import RotorInertia
from hybrid_id.errors import InputError
from hybrid_id.robots.rows import ZERO, Vector, plus, scale
from hybrid_id.robots.tree import Body, Carried, Point, Pose, RigidBodyTree, SpatialInertia
from hybrid_id.systems.balance import Balances, Channels, Rows, SpeedBalance, Views
from hybrid_id.systems.joint import Joint

WEIGHT = "weight"
"""Group of what a joint by itself carries by the description, where all of it rests."""
LOAD = ":"
"""Between group and number in the name of a channel of what a joint by itself carries, see :meth:`Arm.with_loads`."""
MOTION = ("angle", "speed", "acceleration")
"""Channels of a joint whose motion is logged and not simulated, without its number [rad, rad/s, rad/s^2]."""
Mass = dict[tuple[int, int], Tensor | float]
"""Inertia that two joints share at their links, or that one has beside its own, by their numbers from 0."""


class Arm:
    """The couplings of a system's joints: a planar arm's by components, any other's by its rigid-body tree.

    Args:
        joints: the system's joints.
        components: the system's components by key; those that are no coupling are ignored.
        tree: of the robot; None for joints that stand alone or in a plane.
        seats: number in the tree, from 0, of each of the system's joints; None for all of them in order. The motion
            of the others is logged, see :data:`MOTION`.

    Raises:
        InputError: a coupling in a system that has not two joints, or has a tree, or the same one in both places; a
            tree of another number of joints, or none where a link's inertia is left to it.

    Attributes:
        channels: names of those that bring the motion of joints that are not the system's.
    """

    def __init__(
        self,
        joints: Sequence[Joint],
        components: Mapping[str, Component],
        tree: RigidBodyTree | None = None,
        seats: Sequence[int] | None = None,
    ) -> None:
        self.joints, self.tree = joints, tree
        self.seats = list(range(len(joints))) if seats is None else list(seats)
        others = [] if tree is None or seats is None else set(range(len(tree.joints))) - set(self.seats)
        self.channels = [f"{name}{k + 1}" for k in sorted(others) for name in MOTION]
        self.couplings = {key: part for key, part in components.items() if isinstance(part, Coupling)}
        if tree is not None and len(tree.joints) != len(joints) + len(others):
            raise InputError(
                f"The robot has {len(tree.joints)} joints and the system {len(joints)}; describe a drive for each."
            )
        if tree is not None:
            for seat, joint in zip(self.seats, joints, strict=True):
                joint.inertia[1].carried = tree.at_zero[seat]
        # which motors turn the joints of a coupled gear; none is without the others
        seated = dict(zip(self.seats, self.joints, strict=True))
        for seat, joint in seated.items():
            if self.tree is None or (gear := self.tree.coupling(seat)) is None:
                continue
            if others := [self.tree.names[k] for k in gear.joints if k not in seated]:
                raise InputError(
                    f"The motor of {self.tree.names[seat]} is coupled with {', '.join(others)}; take these joints "
                    "together."
                )
            ratios = {k: seated[k].gear_ratio for k in gear.joints}
            joint.couple(
                [(seated[k], share) for k, share in gear.motors_of(seat, ratios).items()],
                [(seated[k], turns) for k, turns in gear.joints_of(seat, ratios).items()],
                [seated[k] for k in gear.joints],
            )
        self.contacts = [(key, part) for key, part in components.items() if isinstance(part, FloorContact)]
        self.masses = [
            (key, part) for key, part in components.items() if isinstance(part, Payload | BodyInertia)
        ]
        self.tilts = [(key, part) for key, part in components.items() if isinstance(part, BaseTilt)]
        self.compensations = [
            key for key, part in components.items() if isinstance(part, GravityCompensation)
        ]
        self._groups, self._touching = list[str](), list[tuple[str, FloorContact]]()
        shared = [part for part in components.values() if isinstance(part, Shared)]
        for key, part in components.items():
            if isinstance(part, Attached):
                self._check_attached(key, part)
            elif isinstance(part, Shared) and tree is None:
                place = key.rsplit("/", 1)[0]
                raise InputError(
                    f"{part.kind} at '{place}' acts only on a robot whose description the model names; remove it."
                )
        if tree is not None and len(self.seats) == 1:
            # of a joint by itself, the contacts that it moves and what it reads of Carried.groups
            own, points = self.seats[0], tree.points
            self._touching = [one for one in self.contacts if tree.carries(own, points[one[1].point].joint)]
            self._groups = ["load"]
            if self.tilts or self._touching:
                self._groups.append("base")
            if self._touching:
                self._groups.append("touch")
            if self.compensations:
                self._groups.append(WEIGHT)
            named = {body.name: body.joint for body in tree.bodies}
            for _, part in self.masses:
                joint = points[part.point].joint if isinstance(part, Payload) else named[part.point]
                if joint != own and f"link{joint + 1}" not in self._groups:
                    self._groups.append(f"link{joint + 1}")
        known = [(part.kind, part.point) for part in shared if not isinstance(part, FloorContact)]
        for kind, point in known:
            if known.count((kind, point)) > 1:
                at, cure = f" at '{point}'" if point else "", "keep one of them"
                if kind == GravityCompensation.kind and tree is not None and tree.believed is not None:
                    cure = (
                        f"the robot's file brings one at {tree.names[0]} by its gravcomp, so list yours there"
                    )
                raise InputError(f"{kind} is listed twice{at}; {cure}.")
        for key, part in components.items():
            if tree is None and isinstance(part, RotorInertia):
                raise InputError(
                    f"{part.kind} at '{key.rsplit('/', 1)[0]}' has no link, which a robot's description carries; put "
                    "one_link or two_inertias there."
                )
        kinds = [part.kind for part in self.couplings.values()]
        for key, part in self.couplings.items():
            place = key.rsplit("/", 1)[0]
            if tree is not None:
                raise InputError(
                    f"{part.kind} at '{place}' couples links that the robot's own tree couples; remove it."
                )
            if len(joints) != 2:
                raise InputError(
                    f"{part.kind} at '{place}' couples two joints, but the system has {len(joints)}; remove it."
                )
            if kinds.count(part.kind) > 1:
                raise InputError(
                    f"{part.kind} sits at both joints; it acts on both from either, so keep one of them."
                )

    def _check_attached(self, key: str, part: Attached) -> None:
        """Refuse a part at a point that is not there, and a mass at a joint that does not carry it."""
        place, tree = key.rsplit("/", 1)[0], self.tree
        found = {} if tree is None else {name: point.joint for name, point in tree.points.items()}
        if tree is not None and isinstance(part, BodyInertia):
            found = {body.name: body.joint for body in tree.bodies if body.inertia.mass}
        if tree is None or part.point not in found:
            lacks = (
                "is no body of it with a mass" if isinstance(part, BodyInertia) else "the robot does not have"
            )
            raise InputError(
                f"{part.kind} at '{place}' acts at '{part.point}', which {lacks}; "
                f"give one of {', '.join(found) or 'a robot with a description'}."
            )
        seat = int(place.split("/")[0].removeprefix("joint")) - 1
        if isinstance(part, Payload | BodyInertia) and not tree.carries(seat, found[part.point]):
            fit = ", ".join(name for k, name in enumerate(tree.names) if tree.carries(k, found[part.point]))
            raise InputError(
                f"{part.kind} at '{place}' acts at '{part.point}', which that joint does not carry; list it at {fit}."
            )

    def bodies(self, p: Views) -> dict[str, Body]:
        """Bodies whose inertia components say, by their keys: of the tree, and payloads as bodies of their own."""
        found = {}
        for key, part in self.masses:
            tree = cast(RigidBodyTree, self.tree)
            if isinstance(part, Payload):
                mass, centre = part.mass(p[key])
                inertia = SpatialInertia.about_centre(mass, centre, (ZERO, ZERO, ZERO))
                point = tree.points[part.point]
                found[key] = Body(
                    f"{part.kind} {part.point}", point.joint, point.rotation, point.position, inertia
                )
                continue
            body = next(body for body in tree.bodies if body.name == part.point)
            inertia = body.inertia.deviating(p[key].c_m, part.shift(p[key]), part.stretch(p[key]))
            found[key] = replace(body, inertia=inertia)
        return found

    def gravity(self, p: Views) -> Vector:
        """Acceleration of free fall in the base's axes [m/s^2], of a robot with a tree."""
        found = cast(RigidBodyTree, self.tree).gravity
        for key, part in self.tilts:
            found = part.gravity(p[key], found)
        return found

    def couple(self, speeds: list[SpeedBalance], x: Rows, u: Channels, p: Views) -> Balances:
        """The balances of all speeds with what acts between the links; without couplings as they are."""
        if not self.couplings and self.tree is None:
            return Balances(speeds)
        links = [_link_motion(joint, x, p) for joint in self.joints]
        mass, torques = self._dynamics([link[0] for link in links], [link[1] for link in links], u, p)
        number, row = -1, {}  # of what turns each joint's link among the speeds, by its row in the state
        rotors = []
        for joint in self.joints:
            rotors.append(number + 1)
            number += len(joint.positions)
            row[joint.positions[-1]] = number
        turned: list[
            list[tuple[int, Tensor | float]]
        ] = []  # speeds that turn each link, and its speed by theirs
        for joint, (_, _, slope, _) in zip(self.joints, links, strict=True):
            motors = joint.motors or [(joint, slope)]
            turned.append([(row[motor.positions[-1]], share) for motor, share in motors])
        for k, (joint, torque) in enumerate(zip(self.joints, torques, strict=True)):
            own = torque + joint.link_load(x, u, p) if joint.motors else torque
            for speed, slope in turned[k]:
                _load(speeds[speed], own * slope)
        for k, weight in enumerate(self._held_up([link[0] for link in links], u, p)):
            soft = not self.joints[k].rigid
            for speed, slope in [(rotors[k], 1.0 / self.joints[k].gear_ratio)] if soft else turned[k]:
                speeds[speed].smooth = speeds[speed].smooth + weight * slope
        couplings: dict[tuple[int, int], Tensor] = {}
        for (i, j), inertia in mass.items():
            for a, slope in turned[i]:
                for b, other in turned[j]:
                    if a == b:
                        more = inertia * (slope**2 if i == j else 2.0 * slope * other)
                        total, share = speeds[a].inertia + more, speeds[a].link_share
                        if share is not None:
                            speeds[a].link_share = (share * speeds[a].inertia + more) / total
                        speeds[a].inertia = total
                    elif i != j or a < b:
                        shared, pair = inertia * (slope * other), (min(a, b), max(a, b))
                        shared = shared if isinstance(shared, Tensor) else x[0].new_full((1,), shared)
                        couplings[pair] = couplings[pair] + shared if pair in couplings else shared
            # what a gear's error accelerates while its rotor turns evenly
            if i != j and (turn := links[i][3]) is not None:
                for speed, slope in turned[j]:
                    _load(speeds[speed], inertia * slope * turn)
            if (turn := links[j][3]) is not None:
                for speed, slope in turned[i]:
                    _load(speeds[speed], inertia * slope * turn)
        return Balances(speeds, couplings)

    def _dynamics(
        self, angles: Rows, rates: Rows, u: Channels, p: Views
    ) -> tuple[Mass, list[Tensor | float]]:
        """Inertias beside the joints' own, and the torques that oppose each joint, at the links."""
        mass: Mass = {}
        torques: list[Tensor | float] = [0.0, 0.0]
        if self.tree is None:
            first, second = angles
            for key, part in self.couplings.items():
                for k, torque in enumerate(part.torques(p[key], (first, second), (rates[0], rates[1]))):
                    torques[k] = torques[k] + torque
                if (inertia := part.inertia(p[key], second)) is not None:
                    for pair, own in (((0, 0), inertia[0]), ((0, 1), inertia[1] * p[key].definite)):
                        mass[pair] = mass[pair] + own if pair in mass else own
            return mass, torques
        tree, n = self.tree, len(angles)
        if n == 1:
            number, forces = self.seats[0], [partial(part.force, p[key]) for key, part in self._touching]
            load = self._carried(tree, u)
            for body in self.bodies(p).values():
                load = load.heavier(body.joint, tree.deviation(body))
            if self.tilts:
                load = load.falling(plus(self.gravity(p), scale(-1.0, tree.gravity)))
            alone, torque = tree.opposing(number, load, angles[0], rates[0], forces)
            whole, torques = {(0, 0): alone}, [torque]
        else:
            poses, inertias, torques = self._needed(tree, angles, rates, [0.0] * n, u, p)
            matrix = tree.mass_matrix(poses, inertias)
            whole = {(i, j): matrix[self.seats[i]][self.seats[j]] for i in range(n) for j in range(i, n)}
        mass = {pair: m for pair, m in whole.items() if not isinstance(m, float | int) or m != 0.0}
        return mass, torques

    def _held_up(self, angles: Rows, u: Channels, p: Views) -> list[Tensor | float]:
        """Torque at each of the system's joints by which a controller holds the links' weight; none without one."""
        if not self.compensations or self.tree is None:
            return []
        share, tree = p[self.compensations[0]].c_g, self.tree.believed or self.tree
        still = [0.0] * len(angles)
        if len(self.seats) == 1:
            load = self._resting(u)
            weights = [tree.opposing(self.seats[0], load, angles[0], 0.0)[1]]
        else:
            q, v, _ = self._motion(tree, angles, still, still, u)
            found = tree.inverse_dynamics(tree.poses(q), tree.inertias(), v)
            weights = [found[number] for number in self.seats]
        return [share * weight for weight in weights]

    def _resting(self, u: Channels) -> Carried:
        """What a joint by itself carries of the weight that a controller holds, the other joints where they are."""
        own, tree = self.seats[0], cast(RigidBodyTree, self.tree)
        if self._known(u):
            rows = [channel for name, channel in u.items() if name.startswith(f"{WEIGHT}{LOAD}")]
            return Carried.of(tree.joints[own].kind, {"load": rows})
        tree, still = tree.believed or tree, [0.0] * len(tree.joints)
        q = self._motion(tree, [0.0], [0.0], [0.0], u)[0]
        return tree.carried(own, q, still, still, tree.inertias())

    def read(self, u: Channels) -> dict[str, Tensor]:
        """Those of the channels that the equations read: of a joint by itself what it carries, where that is known."""
        if not self._known(u):
            return {name: channel for name, channel in u.items() if LOAD not in name}
        others = {
            name: channel for name, channel in u.items() if name not in self.channels and LOAD not in name
        }
        return others | {
            n: c for group in self._groups for n, c in u.items() if n.startswith(f"{group}{LOAD}")
        }

    def _known(self, u: Channels) -> bool:
        """Whether channels tell all that a joint by itself carries by the description."""
        return bool(self.channels) and len(self.seats) == 1 and all(f"{g}{LOAD}0" in u for g in self._groups)

    @torch.no_grad()
    def with_loads(self, u: Channels) -> dict[str, Tensor]:
        """Channels with what a joint by itself carries by the description, from the motion of the others.

        They are the rows of :attr:`hybrid_id.robots.tree.Carried.groups`, so that no equation needs the tree: those
        that this system reads, and what may be tried: payloads of the joints at the ends of the tree, and a controller
        that holds the weight.
        """
        if self.tree is None or not self.channels or len(self.seats) > 1:
            return dict(u)
        like, inner = next(iter(u.values())), {f"link{joint.parent + 1}" for joint in self.tree.joints}
        found = {
            f"{group}{LOAD}{k}": torch.as_tensor(row, dtype=like.dtype, device=like.device).expand_as(like)
            for group, rows in (
                self._carried(self.tree, u).groups | {WEIGHT: self._resting(u).groups["load"]}
            ).items()
            if group not in inner or group in self._groups
            for k, row in enumerate(rows)
        }
        return {**u, **found}

    def _carried(self, tree: RigidBodyTree, u: Channels) -> Carried:
        """What a joint by itself carries by the description."""
        own = self.seats[0]
        if self._known(u):
            groups = {
                group: [channel for name, channel in u.items() if name.startswith(f"{group}{LOAD}")]
                for group in self._groups
            }
            return Carried.of(tree.joints[own].kind, groups)
        still: list[Tensor | float] = [0.0]
        q, v, a = self._motion(tree, still, still, still, u)
        points = [tree.points[part.point] for _, part in self._touching]
        return tree.carried(own, q, v, a, tree.inertias(), points)

    def _motion(
        self,
        tree: RigidBodyTree,
        angles: Sequence[Tensor | float],
        rates: Sequence[Tensor | float],
        accelerations: Sequence[Tensor | float],
        u: Channels,
    ) -> list[list[Tensor | float]]:
        """Positions, speeds and accelerations of all joints of the tree: the system's, and those that are logged."""
        seat = {number: k for k, number in enumerate(self.seats)}
        return [
            [own[seat[j]] if j in seat else u[f"{name}{j + 1}"] for j in range(len(tree.joints))]
            for name, own in zip(MOTION, (angles, rates, accelerations), strict=True)
        ]

    def _needed(
        self,
        tree: RigidBodyTree,
        angles: Rows,
        rates: Rows,
        accelerations: Sequence[Tensor | float],
        u: Channels,
        p: Views,
    ) -> tuple[list[Pose], list[SpatialInertia], list[Tensor | float]]:
        """Poses and inertias of the tree, and the torque that each of the system's links needs to move so."""
        every = self._motion(tree, angles, rates, accelerations, u)
        poses, inertias = tree.poses(every[0]), tree.inertias(tuple(self.bodies(p).values()))
        pushes: list[tuple[Point, Vector]] = []
        for key, part in self.contacts:
            point = tree.points[part.point]
            pushes.append((point, (0.0, 0.0, part.force(p[key], tree.place(poses, point)[2]))))
        torques = tree.inverse_dynamics(poses, inertias, every[1], every[2], pushes, self.gravity(p))
        return poses, inertias, [torques[number] for number in self.seats]

    def needed(self, x: Rows, accelerations: Rows, u: Channels, p: Views) -> list[Tensor | float]:
        """Torque [N m], ``(B,)`` or a number, that the links of a robot with a tree need to move as they do.

        Args:
            x: state rows, ``(B,)`` each.
            accelerations: of the links [rad/s^2], ``(B,)`` each.
            u: channels, ``(B,)`` each.
            p: parameter views.
        """
        links, tree = [_link_motion(joint, x, p) for joint in self.joints], cast(RigidBodyTree, self.tree)
        return self._needed(
            tree, [link[0] for link in links], [link[1] for link in links], accelerations, u, p
        )[2]

    def guard(self, p: Views) -> None:
        """Make the coupling's inertia not a number wherever the mass matrix is not positive definite for every angle.

        No step of a fit is then accepted there: it ends as a rollout that fails.
        """
        for key, part in self.couplings.items():
            if (least := self.determinant(p, key, part)) is not None:
                one = torch.ones_like(least)
                p[key].definite = torch.where(least.detach() > 0, one, torch.nan * one)

    def check(self, p: Views) -> None:
        """Raise InputError where the mass matrix of the stored values is not positive definite for every angle."""
        for key, part in self.couplings.items():
            least = self.determinant(p, key, part)
            if least is not None and not bool((least > 0).all()):
                values = {**vars(p[key])}
                values |= {f"P_{j.number}": self._link(j, p) for j in self.joints}
                listed = ", ".join(f"{n} = {v.item():.4g}" for n, v in values.items())
                share = "" if all(j.rigid for j in self.joints) else "the links' own (less rotor_share), "
                raise InputError(
                    f"The arm's mass matrix is not positive definite for every angle of joint 2 ({share}{listed} "
                    "kg m^2); bring the values of the coupling down, so that (P_1 + 2 P_3) P_2 exceeds (P_4 + P_3)^2 "
                    "and (P_1 - 2 P_3) P_2 exceeds (P_4 - P_3)^2."
                )

    def determinant(self, p: Views, key: str, part: Coupling) -> Tensor | None:
        """Least determinant of the links' mass matrix over the angles of joint 2; None without inertial coupling."""
        least = None
        first, second = (self._link(joint, p) for joint in self.joints)
        for angle in (0.0, torch.pi):
            inertia = part.inertia(p[key], torch.full_like(first, angle))
            if inertia is None:
                return None
            here = (first + inertia[0]) * second - inertia[1] ** 2
            least = here if least is None else torch.minimum(least, here)
        return least

    @staticmethod
    def _link(joint: Joint, p: Views) -> Tensor:
        """What a joint's link carries at the link, the rotor included behind a rigid gear [kg m^2]."""
        key, inertia = joint.inertia
        view, r = p[key], joint.gear_ratio
        return inertia.total(view, r) * r**2 if joint.rigid else inertia.link(view, r)


def _link_motion(joint: Joint, x: Rows, p: Views) -> tuple[Tensor, Tensor, Tensor | float, Tensor | None]:
    """Angle [rad] and speed [rad/s] of a link, its speed by that of what turns it, and its acceleration at even speed.

    What turns a link is the rotor behind a rigid gear, and the link itself behind a compliant one. The acceleration is
    None where there is none. Of a link that several motors turn, the joint has their shares.
    """
    if joint.motors or not joint.rigid:
        return *joint.link_motion(x, p), 1.0, None
    row = joint.positions[0]
    angle, slope, curvature = joint.gear.map(x[row], p)
    return angle, x[row + 1] * slope, slope, None if curvature is None else curvature * x[row + 1].square()


def _load(speed: SpeedBalance, torque: Tensor | float) -> None:
    """Let a torque oppose a speed."""
    speed.smooth = speed.smooth - torque
    if speed.load is not None:
        speed.load = speed.load + torque
