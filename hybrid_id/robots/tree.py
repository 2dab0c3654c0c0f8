"""Rigid-body tree: mass matrix, bias and gravity torques of any open chain or tree of hinges and slides.

Every joint has a frame whose z axis is the joint's; its pose in its parent's frame is a constant one followed by a turn
about z or a shift along it. Forces and moments are taken at the joints' origins, in the joints' own frames.

Sources: R. Featherstone, Rigid Body Dynamics Algorithms, 2008: recursive Newton-Euler (section 5.3) and composite
rigid bodies (section 6.2), here with 3-vectors. Differs from them by a fixed base and one degree of freedom a joint.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, reduce
from typing import Literal, NamedTuple

from hybrid_id.errors import InputError, close_match
from hybrid_id.robots.couplings import GearCoupling
from hybrid_id.robots.rows import (
    ZERO,
    Matrix,
    Row,
    Vector,
    add,
    constant,
    constant_vector,
    cross,
    dot,
    multiply,
    plus,
    product,
    scale,
    sine_and_cosine,
    subtract,
    times,
    total,
    transposed,
)

Rows = Sequence[Row]
Pose = tuple[Matrix, Vector]
"""Rotation and position [m] of a frame in another one."""
Motion = tuple[Vector, Vector, Vector]
"""Angular velocity and acceleration of a frame, and the acceleration of its origin less gravity."""
Pair = tuple[Vector, Vector]
"""Spin of a body and speed of its point at a frame's origin, or a force and its moment about it."""


@dataclass(frozen=True)
class SpatialInertia:
    """Ten inertial parameters of a rigid body about the origin of a frame.

    Attributes:
        mass: [kg].
        moment: mass times the centre of mass [kg m].
        inertia: symmetric matrix about the frame's origin [kg m^2].
    """

    mass: Row
    moment: Vector
    inertia: Matrix

    @classmethod
    def about_centre(cls, mass: Row, centre: Vector, inertia: Matrix) -> SpatialInertia:
        """From the mass [kg], its centre [m] and the inertia about that centre [kg m^2], in one frame's axes."""
        return cls(mass, ZERO, inertia).seen_from(_IDENTITY, centre)

    def seen_from(self, rotation: Matrix, position: Vector) -> SpatialInertia:
        """The same body about another frame's origin, in that frame's axes.

        Args:
            rotation: turns vectors of this frame into the other's axes.
            position: of this frame's origin in the other frame [m].
        """
        moment = times(rotation, self.moment)
        turned = product(product(rotation, self.inertia), transposed(rotation))
        shift = multiply(2.0, dot(position, moment))
        square = dot(position, position)
        rows = []
        for i in range(3):
            row = []
            for j in range(3):
                mixed = add(multiply(position[i], moment[j]), multiply(moment[i], position[j]))
                steiner = multiply(position[i], position[j])
                diagonal = (shift, square) if i == j else (0.0, 0.0)
                weight = multiply(self.mass, subtract(diagonal[1], steiner))
                row.append(add(turned[i][j], add(subtract(diagonal[0], mixed), weight)))
            rows.append((row[0], row[1], row[2]))
        return SpatialInertia(
            self.mass, plus(moment, scale(self.mass, position)), (rows[0], rows[1], rows[2])
        )

    def at_centre(self) -> tuple[float, Vector, Matrix]:
        """Mass [kg], centre [m] and inertia about that centre [kg m^2] of a body of plain numbers."""
        mass = float(self.mass)
        centre = scale(1.0 / mass, self.moment)
        return mass, centre, self.seen_from(_IDENTITY, scale(-1.0, centre)).inertia

    def deviating(self, mass: Row, shift: Vector, stretch: Matrix) -> SpatialInertia:
        """The body with its mass multiplied, its centre shifted, and all of it stretched about the centre.

        ``S' = mass L S L^T`` with the second moments ``S = tr(I) / 2 - I`` about the centre: positive definite wherever
        S is and L has an inverse.

        Args:
            mass: factor of the mass [1].
            shift: of the centre [m].
            stretch: L, applied to vectors from the centre [1], ``(3, 3)``.
        """
        own, centre, about = self.at_centre()
        spread = product(product(stretch, _complement(about, 0.5)), transposed(stretch))
        x, y, z = _complement(spread, 1.0)
        inertia = scale(mass, x), scale(mass, y), scale(mass, z)
        return SpatialInertia.about_centre(multiply(mass, own), plus(centre, shift), inertia)

    @property
    def ten(self) -> tuple[Row, ...]:
        """The ten parameters in the order of :data:`TEN`."""
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = self.inertia
        return self.mass, *self.moment, xx, xy, xz, yy, yz, zz

    def less(self, other: SpatialInertia) -> SpatialInertia:
        """What this one has more than another."""
        x, y, z = (plus(a, scale(-1.0, b)) for a, b in zip(self.inertia, other.inertia, strict=True))
        moment = plus(self.moment, scale(-1.0, other.moment))
        return SpatialInertia(subtract(self.mass, other.mass), moment, (x, y, z))

    def __add__(self, other: SpatialInertia) -> SpatialInertia:
        x, y, z = (plus(a, b) for a, b in zip(self.inertia, other.inertia, strict=True))
        return SpatialInertia(add(self.mass, other.mass), plus(self.moment, other.moment), (x, y, z))


def _complement(matrix: Matrix, factor: float) -> Matrix:
    """``factor tr(A) 1 - A``: from an inertia to its second moments with 0.5, and back with 1."""
    half = multiply(factor, total([matrix[k][k] for k in range(3)]))
    x, y, z = ([subtract(half if i == j else 0.0, matrix[i][j]) for j in range(3)] for i in range(3))
    return (x[0], x[1], x[2]), (y[0], y[1], y[2]), (z[0], z[1], z[2])


_IDENTITY: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
TEN = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")
"""Inertial parameters of a body: mass [kg], mass times centre [kg m], inertia about the frame's origin [kg m^2]."""


def _of_ten(ten: Sequence[Row]) -> SpatialInertia:
    m, x, y, z, xx, xy, xz, yy, yz, zz = ten
    return SpatialInertia(m, (x, y, z), ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)))


_UNITS = tuple(_of_ten([float(i == k) for i in range(len(TEN))]) for k in range(len(TEN)))
_NOTHING = SpatialInertia(0.0, ZERO, (ZERO, ZERO, ZERO))


@dataclass(frozen=True)
class Within:
    """The frame of a joint as it moves within the frame of another one that carries it.

    Attributes:
        rotation, position: its pose [m].
        moves: spin and speed of the point at the other frame's origin, as if fixed to it.
        faster: rate of change of both.
    """

    rotation: Matrix
    position: Vector
    moves: Pair
    faster: Pair


@dataclass(frozen=True)
class Carried:
    """What one joint carries while the others move as given, seen from the joint's own frame at position 0.

    One body, which the others deform, and a torque by each component of the frame's spin: so little depends on the
    joint's own position and speed, and this, which does not, is found once a batch.

    Attributes:
        kind: of the joint, hinge or slide.
        motion: of the frame where the joint stands still at 0.
        body: all that the joint carries, as one.
        needed: torque or force at the joint that the motion of what it carries within the frame needs.
        coriolis: torque or force at the joint by each component of the frame's spin.
        base: turns vectors of the frame into the base's axes.
        height: of the frame's origin [m].
        places: of points that may touch something, in the frame [m].
        within: frames of the joints that it carries, by their numbers.
    """

    kind: str
    motion: Motion
    body: SpatialInertia
    needed: Row
    coriolis: Vector
    base: Matrix
    height: Row
    places: tuple[Vector, ...]
    within: Mapping[int, Within]

    @property
    def groups(self) -> dict[str, list[Row]]:
        """All of it as rows, by what they are needed for: ``link<k>`` for another inertia at joint k, from 1."""
        spin, turn, pull = self.motion
        found = {
            "load": [*spin, *turn, *pull, *self.body.ten, self.needed, *self.coriolis],
            "base": [*self.base[0], *self.base[1], *self.base[2]],
            "touch": [self.height, *(row for place in self.places for row in place)],
        }
        for number, one in self.within.items():
            rows = [*one.rotation[0], *one.rotation[1], *one.rotation[2], *one.position]
            found[f"link{number + 1}"] = [*rows, *one.moves[0], *one.moves[1], *one.faster[0], *one.faster[1]]
        return found

    @classmethod
    def of(cls, kind: str, groups: Mapping[str, Sequence[Row]]) -> Carried:
        """From its :attr:`groups`, of which all but ``load`` may be left out where nothing needs them."""
        load = groups["load"]
        spin, turn, pull, coriolis = _vectors([*load[:9], *load[20:23]])
        height, *touch = groups.get("touch", [0.0])
        base = _vectors(groups.get("base", [0.0] * 9))
        within = {}
        for name, rows in groups.items():
            if name.startswith("link"):
                one = _vectors(rows)
                pose = (one[0], one[1], one[2]), one[3]
                within[int(name[4:]) - 1] = Within(*pose, (one[4], one[5]), (one[6], one[7]))
        return cls(
            kind, (spin, turn, pull), _of_ten(load[9:19]), load[19], coriolis,
            (base[0], base[1], base[2]), height, tuple(_vectors(touch)), within,
        )  # fmt: skip

    def falling(self, more: Vector) -> Carried:
        """The same where gravity in the base's axes is more by a vector [m/s^2]."""
        spin, turn, pull = self.motion
        return replace(self, motion=(spin, turn, plus(pull, scale(-1.0, times(transposed(self.base), more)))))

    def heavier(self, joint: int, body: SpatialInertia) -> Carried:
        """The same with another body, fixed to what a joint moves that it carries.

        Args:
            joint: its number, from 0; of the joint itself, one that is not among ``within``.
            body: about that joint's origin, in its axes.
        """
        if joint not in self.within:
            return replace(self, body=self.body + body)
        frame = self.within[joint]
        one = body.seen_from(frame.rotation, frame.position)
        momentum = _momentum(one, *frame.moves)
        needed = _plus(_momentum(one, *frame.faster), _crossed(frame.moves, momentum))
        if self.kind == "hinge":  # by the inertia's rate of change, and by the momentum that the spin turns
            turned = momentum[1][1], multiply(-1.0, momentum[1][0]), 0.0
            coriolis = plus(_inertia_slope(one, *frame.moves), turned)
        else:
            coriolis = multiply(2.0, momentum[0][1]), multiply(-2.0, momentum[0][0]), 0.0
        return replace(
            self,
            body=self.body + one,
            needed=add(self.needed, needed[1][2] if self.kind == "hinge" else needed[0][2]),
            coriolis=plus(self.coriolis, coriolis),
        )


def _vectors(rows: Sequence[Row]) -> list[Vector]:
    return [(rows[k], rows[k + 1], rows[k + 2]) for k in range(0, len(rows) - 2, 3)]


@dataclass(frozen=True)
class Body:
    """A named body of the description, rigidly fixed to what one joint moves.

    Attributes:
        name: as in the file.
        joint: number of the joint that moves it, from 0.
        rotation: turns vectors of the body's axes into the joint's, ``(3, 3)``.
        position: of the body's origin in the joint's frame [m], ``(3,)``.
        inertia: about the body's origin, in its axes.
    """

    name: str
    joint: int
    rotation: Matrix
    position: Vector
    inertia: SpatialInertia

    def held(self) -> Body:
        """The body with plain numbers in the place of tensors of one value."""
        mass, moment, inertia = self.inertia.mass, self.inertia.moment, self.inertia.inertia
        x, y, z = (constant_vector([float(value) for value in row]) for row in inertia)
        still = SpatialInertia(float(mass), constant_vector([float(value) for value in moment]), (x, y, z))
        return replace(self, inertia=still)


@dataclass(frozen=True)
class Point:
    """A named point that moves with a joint, a site or a body's origin of the description.

    Attributes:
        joint: number of the joint that moves it, from 0.
        position: in the joint's frame [m], ``(3,)``.
        rotation: turns vectors of the site's or body's axes into the joint's, ``(3, 3)``.
    """

    joint: int
    position: Vector
    rotation: Matrix = _IDENTITY


@dataclass(frozen=True)
class Servo:
    """A position loop at a joint, MuJoCo's ``position`` actuator.

    Attributes:
        stiffness: torque or force per error [N m/rad or N/m].
        damping: [N m s/rad or N s/m].
        largest: torque or force that it does not exceed [N m or N]; None where there is no limit.
        goals: least and largest goal [rad or m], to which it clips; None where there is no limit.
    """

    stiffness: float
    damping: float = 0.0
    largest: float | None = None
    goals: tuple[float, float] | None = None


@dataclass(frozen=True)
class TreeJoint:
    """A joint of the tree.

    Attributes:
        name: as in the file.
        kind: ``hinge``, about its z axis, or ``slide``, along it.
        parent: number of the joint that carries it, from 0; -1 for the base.
        rotation: turns vectors of its frame at position zero into its parent's axes, ``(3, 3)``.
        position: of its origin at position zero in its parent's frame [m], ``(3,)``.
        limits: least and largest position [rad or m].
        speed_limit: largest speed [rad/s or m/s]; inf where the file names none.
        torque_limit: largest torque or force of its actuator [N m or N]; inf where the file names none.
        gear: by which the file multiplies the command of its motor; 1 where it says none, or where a servo turns it.
        gain: torque or force of that motor for one of its command, before the gear; 1 of MuJoCo's ``motor``.
        commands: least and largest command of that motor.
        by_speed: whether its actuator acts against the speed instead, as a loop of the speed and a back-EMF do.
        armature: inertia of its rotor at the joint [kg m^2 or kg].
        damping: [N m s/rad or N s/m].
        friction_loss: dry friction [N m or N].
        stiffness: of the spring at the joint [N m/rad or N/m], at rest at ``reference``.
        reference: [rad or m].
        servo: its position loop; None where it is driven by a torque or a force.
    """

    name: str
    kind: Literal["hinge", "slide"]
    parent: int
    rotation: Matrix
    position: Vector
    limits: tuple[float, float] = (-float("inf"), float("inf"))
    armature: float = 0.0
    damping: float = 0.0
    friction_loss: float = 0.0
    stiffness: float = 0.0
    reference: float = 0.0
    servo: Servo | None = None
    speed_limit: float = float("inf")
    torque_limit: float = float("inf")
    gear: float = 1.0
    gain: float = 1.0
    commands: tuple[float, float] = (-float("inf"), float("inf"))
    by_speed: bool = False


class Tie(NamedTuple):
    """What ties a joint to others or to a place, in words, and where the description draws it [rad or m]."""

    by: str
    at: float


@dataclass(frozen=True)
class RigidBodyTree:
    """An open chain or tree of rigid bodies on a fixed base.

    Attributes:
        joints: each after the joint that carries it.
        bodies: everything that moves and has a mass.
        gravity: acceleration of free fall in the base's axes [m/s^2].
        points: sites and origins of bodies, by name.
        source: the description that it was read from; empty where there is none.
        held: joints of that description that do not move, and where they stand [rad or m].
        couplings: gears that couple the motors of some of the joints.
        tied: joints that cannot move alone, as those of a gripper, and a floating base, by name, until they are held.
        believed: the robot whose weight a controller holds, of bodies as heavy as what it holds of them; None where the
            description says of none.

    Raises:
        InputError: a joint that stands before its parent, or two of one name; one that is not there, slides or stands
            twice in couplings.
    """

    joints: tuple[TreeJoint, ...]
    bodies: tuple[Body, ...]
    gravity: Vector = (0.0, 0.0, -9.81)
    points: Mapping[str, Point] = field(default_factory=dict, compare=False)
    source: str = field(default="", compare=False, repr=False)
    held: Mapping[str, float] = field(default_factory=dict, compare=False)
    couplings: tuple[GearCoupling, ...] = ()
    tied: Mapping[str, Tie] = field(default_factory=dict, compare=False)
    believed: RigidBodyTree | None = None
    _fixed: dict[str, SpatialInertia] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        for number, joint in enumerate(self.joints):
            if not -1 <= joint.parent < number:
                raise InputError(f"Joint '{joint.name}' stands before the joint that carries it; sort them.")
        names = [joint.name for joint in self.joints]
        if twice := {name for name in names if names.count(name) > 1}:
            raise InputError(f"Several joints are called '{min(twice)}'; give each a name of its own.")
        coupled = [k for one in self.couplings for k in one.joints]
        for k in coupled:
            if not 0 <= k < len(names):
                raise InputError(f"A coupling names joint {k + 1} of a robot that has {len(names)}.")
            if coupled.count(k) > 1:
                raise InputError(f"Joint '{names[k]}' stands in two couplings; put them into one matrix.")
            if self.joints[k].kind == "slide":
                raise InputError(f"Joint '{names[k]}' slides; only joints that turn can be coupled.")
        seen = {b.name: b.inertia.seen_from(b.rotation, b.position) for b in self.bodies}
        object.__setattr__(self, "_fixed", seen)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the joints."""
        return tuple(joint.name for joint in self.joints)

    @cached_property
    def at_zero(self) -> tuple[float, ...]:
        """Inertia that each joint moves with all joints at zero [kg m^2 or kg]."""
        mass = self.mass_matrix(self.poses([0.0] * len(self.joints)), self.inertias())
        return tuple(float(mass[k][k]) for k in range(len(self.joints)))

    @property
    def massless(self) -> tuple[str, ...]:
        """Bodies that a joint moves without any mass but what further joints carry."""
        rigid = self.inertias()
        return tuple(body.name for body in self.bodies if float(rigid[body.joint].mass) == 0.0)

    def coupling(self, joint: int) -> GearCoupling | None:
        """The gear that couples a joint's motor with others, by the joint's number from 0; None without one."""
        return next((one for one in self.couplings if joint in one.joints), None)

    @property
    def gearing(self) -> list[list[float]]:
        """What the motors turn behind their own gears for one turn of each joint: the identity but for couplings."""
        n = len(self.joints)
        found = [[float(i == j) for j in range(n)] for i in range(n)]
        for one in self.couplings:
            for motor, row in zip(one.joints, one.matrix, strict=True):
                for joint, entry in zip(one.joints, row, strict=True):
                    found[motor][joint] = entry
        return found

    def coupled(self, couplings: Sequence[tuple[Sequence[str], Sequence[Sequence[float]]]]) -> RigidBodyTree:
        """The tree with gears that couple joints.

        Args:
            couplings: names of the joints and matrix C of each, see :class:`GearCoupling`.

        Raises:
            InputError: a name that no joint has, or what a coupling cannot be.
        """
        found = []
        for names, matrix in couplings:
            if unknown := [name for name in names if name not in self.names]:
                near = close_match(unknown[0], self.names)
                raise InputError(
                    f"The robot has no joint '{unknown[0]}'{near} that moves; it has {', '.join(self.names)}."
                )
            rows = tuple(tuple(float(entry) for entry in row) for row in matrix)
            found.append(GearCoupling(tuple(self.names.index(name) for name in names), rows))
        return replace(self, couplings=tuple(found))

    def holding(self, at: Mapping[str, float]) -> RigidBodyTree:
        """The tree with some joints held still: what they carry is part of what carries them. Couple joints after it.

        Args:
            at: position of each held joint by its name [rad or m]; 0 of a floating base, which stays as it is drawn.

        Raises:
            InputError: a name that no joint has, a position that it cannot have, or no joint left that moves.
        """
        known = [*(name for name in self.tied if name not in self.names), *self.names]
        if unknown := [name for name in at if name not in known]:
            raise InputError(f"The robot has no joint '{unknown[0]}' to hold; it has {', '.join(known)}.")
        for name, place in at.items():
            if name not in self.names:
                if place != 0.0:
                    raise InputError(
                        f"The base '{name}' is held as the robot's file draws it; give it 0, and its pose there."
                    )
                continue
            joint = self.joints[self.names.index(name)]
            low, high = joint.limits
            slack = 0.1 * (high - low) if math.isfinite(high - low) else 0.0
            if not (math.isfinite(place) and low - slack <= place <= high + slack):
                unit = "m" if joint.kind == "slide" else "rad"
                raise InputError(
                    f"The joint '{name}' cannot be held at {place:g} {unit}: it reaches from {low:.4g} to "
                    f"{high:.4g} {unit}; correct 'hold' in the model (degrees are no radians)."
                )
        joints: list[TreeJoint] = []
        seat: list[tuple[int, Matrix, Vector]] = []  # of each joint: what moves it, and its frame there
        for joint in self.joints:
            parent, rotation, position = joint.parent, joint.rotation, joint.position
            if parent >= 0:
                parent, turned, origin = seat[parent]
                rotation, position = chained([(turned, origin), (rotation, position)])
            moved = replace(joint, parent=parent, rotation=rotation, position=position)
            if joint.name in at:
                seat.append((parent, *_pose(moved, at[joint.name])))
            else:
                seat.append((len(joints), _IDENTITY, ZERO))
                joints.append(moved)
        if not joints:
            raise InputError("Every joint of the robot is held; let one of them move.")
        bodies = []
        for body in self.bodies:
            number, turned, origin = seat[body.joint]
            rotation, position = chained([(turned, origin), (body.rotation, body.position)])
            if number >= 0:  # what stands on the base does not move
                bodies.append(replace(body, joint=number, rotation=rotation, position=position))
        points = {}
        for name, point in self.points.items():
            number, turned, origin = seat[point.joint]
            rotation, position = chained([(turned, origin), (point.rotation, point.position)])
            if number >= 0:
                points[name] = Point(number, position, rotation)
        tied = {name: tie for name, tie in self.tied.items() if name not in at}
        tree = replace(self, joints=tuple(joints), bodies=tuple(bodies), points=points, tied=tied)
        own = {name: place for name, place in at.items() if name in self.names}
        return replace(tree, held={**self.held, **at}, believed=self.believed and self.believed.holding(own))

    def carries(self, joint: int, other: int) -> bool:
        """Whether a joint moves what another one moves, by their numbers from 0."""
        while other > joint:
            other = self.joints[other].parent
        return other == joint

    def with_bodies(self, bodies: Sequence[Body]) -> RigidBodyTree:
        """The tree with bodies in the place of those of the same name, and the others beside them."""
        named = {body.name: body for body in (*self.bodies, *bodies)}
        return replace(self, bodies=tuple(named.values()))

    def falling(self, gravity: Vector) -> RigidBodyTree:
        """The tree under another gravity [m/s^2], tensors of one value as plain numbers."""
        return replace(self, gravity=constant_vector([float(value) for value in gravity]))

    def inertias(self, bodies: Sequence[Body] = ()) -> list[SpatialInertia]:
        """What each joint carries rigidly, about the joint's origin.

        Args:
            bodies: those that take the place of the description's of the same name, and others beside them.
        """
        seen = self._fixed | {b.name: b.inertia.seen_from(b.rotation, b.position) for b in bodies}
        found = [_NOTHING] * len(self.joints)
        for name, body in {body.name: body for body in (*self.bodies, *bodies)}.items():
            found[body.joint] = found[body.joint] + seen[name]
        return found

    def deviation(self, body: Body) -> SpatialInertia:
        """What a body adds to the description's of the same name, or all of it, about its joint's origin."""
        seen = body.inertia.seen_from(body.rotation, body.position)
        return seen.less(self._fixed[body.name]) if body.name in self._fixed else seen

    def poses(self, q: Rows) -> list[Pose]:
        """Pose of each joint's frame in its parent's: rotation and position [m].

        Args:
            q: positions of the joints [rad or m].
        """
        return [_pose(joint, angle) for joint, angle in zip(self.joints, q, strict=True)]

    def pose(self, poses: Sequence[Pose], joint: int) -> Pose:
        """Pose of a joint's frame in the base's axes: rotation and position [m]."""
        found = []
        while joint >= 0:
            found.append(poses[joint])
            joint = self.joints[joint].parent
        return chained(found[::-1])

    def place(self, poses: Sequence[Pose], point: Point) -> Vector:
        """Where a point is in the base's axes [m]."""
        rotation, position = self.pose(poses, point.joint)
        return plus(position, times(rotation, point.position))

    def mass_matrix(self, poses: Sequence[Pose], inertias: Sequence[SpatialInertia]) -> list[list[Row]]:
        """Mass matrix M(q), rotors' armature left out: rows of ``(B,)`` or numbers.

        Args:
            poses: see :meth:`poses`.
            inertias: see :meth:`inertias`.
        """
        n = len(self.joints)
        composite = list(inertias)
        for k in reversed(range(n)):
            parent = self.joints[k].parent
            if parent >= 0:
                composite[parent] = composite[parent] + composite[k].seen_from(*poses[k])
        found: list[list[Row]] = [[0.0] * n for _ in range(n)]
        for k, joint in enumerate(self.joints):
            force, moment = _unit_acceleration(joint, composite[k])
            found[k][k] = _along(joint, force, moment)
            below = k
            while (above := self.joints[below].parent) >= 0:
                force, moment = _carried(force, moment, *poses[below])
                found[k][above] = found[above][k] = _along(self.joints[above], force, moment)
                below = above
        return found

    def inverse_dynamics(
        self,
        poses: Sequence[Pose],
        inertias: Sequence[SpatialInertia],
        v: Rows,
        a: Rows | None = None,
        pushes: Sequence[tuple[Point, Vector]] = (),
        gravity: Vector | None = None,
    ) -> list[Row]:
        """Torques or forces at the joints for a motion, rotors' armature left out.

        With no acceleration this is the bias: gravity, centrifugal and Coriolis torques. At rest it is gravity's.

        Args:
            poses: see :meth:`poses`.
            inertias: see :meth:`inertias`.
            v: speeds [rad/s or m/s].
            a: accelerations [rad/s^2 or m/s^2]; None for none.
            pushes: forces from outside [N], in the base's axes, and the points where they act.
            gravity: acceleration of free fall [m/s^2], in the base's axes; None for the description's.
        """
        n = len(self.joints)
        forces, moments = [ZERO] * n, [ZERO] * n
        pull = self.gravity if gravity is None else gravity
        for k, motion in enumerate(self._motions(poses, v, [0.0] * n if a is None else a, pull)):
            forces[k], moments[k] = _needed(inertias[k], *motion)
        for point, push in pushes:
            force = scale(-1.0, times(transposed(self.pose(poses, point.joint)[0]), push))
            forces[point.joint] = plus(forces[point.joint], force)
            moments[point.joint] = plus(moments[point.joint], cross(point.position, force))
        found: list[Row] = [0.0] * n
        for k in reversed(range(n)):
            joint = self.joints[k]
            found[k] = _along(joint, forces[k], moments[k])
            if joint.parent >= 0:
                force, moment = _carried(forces[k], moments[k], *poses[k])
                forces[joint.parent] = plus(forces[joint.parent], force)
                moments[joint.parent] = plus(moments[joint.parent], moment)
        return found

    def carried(
        self,
        number: int,
        q: Rows,
        v: Rows,
        a: Rows,
        inertias: Sequence[SpatialInertia],
        points: Sequence[Point] = (),
    ) -> Carried:
        """What one joint carries while the others move as given; see :class:`Carried` and :meth:`opposing`.

        Args:
            number: of the joint, from 0.
            q: positions of all joints [rad or m]; that of the joint itself is not read, nor are its speed and
                acceleration.
            v: speeds [rad/s or m/s].
            a: accelerations [rad/s^2 or m/s^2].
            inertias: see :meth:`inertias`.
            points: of which those that the joint carries may touch something.
        """
        own = self.joints[number]
        poses = self.poses([0.0 if k == number else angle for k, angle in enumerate(q)])
        motion: Motion = ZERO, ZERO, scale(-1.0, self.gravity)
        for k in (k for k in range(number) if self.carries(k, number)):
            motion = _moved(self.joints[k], *poses[k], *motion, v[k], a[k])
        motion = _moved(own, *poses[number], *motion, 0.0, 0.0)
        within = {number: Within(_IDENTITY, ZERO, (ZERO, ZERO), (ZERO, ZERO))}
        for k in (k for k in range(number + 1, len(self.joints)) if self.carries(number, k)):
            joint, above = self.joints[k], within[self.joints[k].parent]
            pose = chained([(above.rotation, above.position), poses[k]])
            axis = transposed(pose[0])[2]
            along = (ZERO, axis) if joint.kind == "slide" else (axis, cross(pose[1], axis))
            changes = _scaled(a[k], along), _scaled(v[k], _crossed(above.moves, along))
            moves = _plus(above.moves, _scaled(v[k], along))
            within[k] = Within(*pose, moves, _plus(above.faster, *changes))
        base, origin = self.pose(poses, number)
        places = [
            plus(within[point.joint].position, times(within[point.joint].rotation, point.position))
            for point in points
            if point.joint in within
        ]
        del within[number]
        found = Carried(own.kind, motion, inertias[number], 0.0, ZERO, base, origin[2], tuple(places), within)
        return reduce(lambda one, k: one.heavier(k, inertias[k]), within, found)

    def opposing(
        self, number: int, load: Carried, q: Row, v: Row, forces: Sequence[Callable[[Row], Row]] = ()
    ) -> tuple[Row, Row]:
        """Inertia of one joint, and the torque or force that opposes it, while the others move as given.

        They are those of :meth:`mass_matrix` and :meth:`inverse_dynamics`.

        Args:
            number: of the joint, from 0.
            load: what it carries, by :meth:`carried`.
            q: its position [rad or m].
            v: its speed [rad/s or m/s].
            forces: upwards on each of the places [N], by its height [m].
        """
        own = replace(self.joints[number], rotation=_IDENTITY, position=ZERO)
        turn, shift = _pose(own, q)
        motion = _moved(own, turn, shift, *load.motion, v, 0.0)
        torques = [_along(own, *_needed(load.body, *motion)), load.needed, dot(load.coriolis, motion[0])]
        for place, force in zip(load.places, forces, strict=True):
            height = add(load.height, dot(load.base[2], plus(shift, times(turn, place))))
            push = scale(multiply(-1.0, force(height)), times(transposed(turn), load.base[2]))
            torques.append(_along(own, push, cross(place, push)))
        return _along(own, *_unit_acceleration(own, load.body)), total(torques)

    def regressor(self, poses: Sequence[Pose], v: Rows, a: Rows) -> list[list[Row]]:
        """W(q, v, a) with ``tau = W phi``: the inverse dynamics as it depends on the inertial parameters, linearly.

        phi holds :data:`TEN` of what each joint carries rigidly, about the joint's origin in its axes, as
        :meth:`inertias` has it; ten columns a joint, rotors' armature left out.

        Source: C. Atkeson, C. An, J. Hollerbach, Estimation of Inertial Parameters of Manipulator Loads and Links,
        Int. J. Robotics Research 5(3), 1986.

        Args:
            poses: see :meth:`poses`.
            v: speeds [rad/s or m/s].
            a: accelerations [rad/s^2 or m/s^2].
        """
        found: list[list[Row]] = [[0.0] * (len(TEN) * len(self.joints)) for _ in self.joints]
        for k, motion in enumerate(self._motions(poses, v, a, self.gravity)):
            for column, unit in enumerate(_UNITS, len(TEN) * k):
                (force, moment), below = _needed(unit, *motion), k
                while below >= 0:
                    found[below][column] = _along(self.joints[below], force, moment)
                    force, moment = _carried(force, moment, *poses[below])
                    below = self.joints[below].parent
        return found

    def _motions(self, poses: Sequence[Pose], v: Rows, a: Rows, gravity: Vector) -> list[Motion]:
        """Angular velocity and acceleration of each joint's frame, and the acceleration of its origin less gravity."""
        motion: list[Motion] = []
        base = (ZERO, ZERO, scale(-1.0, gravity))
        for k, joint in enumerate(self.joints):
            before = base if joint.parent < 0 else motion[joint.parent]
            motion.append(_moved(joint, *poses[k], *before, v[k], a[k]))
        return motion


def frame(axis: Sequence[float]) -> Matrix:
    """Rotation whose third column is an axis: a joint's frame in the axes that the axis is given in.

    Args:
        axis: unit vector.
    """
    x, y, z = axis
    if abs(z) > 1.0 - 1e-12:  # z itself, or turned about x by half a turn
        way = 1.0 if z > 0 else -1.0
        return constant([[1.0, 0.0, 0.0], [0.0, way, 0.0], [0.0, 0.0, way]])
    length = (x * x + y * y) ** 0.5
    first = (y / length, -x / length, 0.0)
    second = cross(constant_vector(axis), first)
    return constant([[first[i], float(second[i]), axis[i]] for i in range(3)], 1e-14)


def _pose(joint: TreeJoint, q: Row) -> Pose:
    if joint.kind == "slide":
        along = times(joint.rotation, (0.0, 0.0, q))
        return joint.rotation, plus(joint.position, along)
    sine, cosine = sine_and_cosine(q)
    turn: Matrix = ((cosine, multiply(-1.0, sine), 0.0), (sine, cosine, 0.0), (0.0, 0.0, 1.0))
    return product(joint.rotation, turn), joint.position


def _along(joint: TreeJoint, force: Vector, moment: Vector) -> Row:
    """What of a force and a moment acts on a joint's coordinate."""
    return moment[2] if joint.kind == "hinge" else force[2]


def _unit_acceleration(joint: TreeJoint, body: SpatialInertia) -> tuple[Vector, Vector]:
    """Force and moment that accelerate a body by 1 along a joint's coordinate."""
    if joint.kind == "hinge":
        x, y, _ = body.moment
        return (multiply(-1.0, y), x, 0.0), (body.inertia[0][2], body.inertia[1][2], body.inertia[2][2])
    return (0.0, 0.0, body.mass), cross(body.moment, (0.0, 0.0, 1.0))


def _carried(force: Vector, moment: Vector, rotation: Matrix, position: Vector) -> tuple[Vector, Vector]:
    """Force and moment at a joint's origin as the parent carries them, at the parent's origin."""
    turned = times(rotation, force)
    return turned, plus(times(rotation, moment), cross(position, turned))


def _moved(
    joint: TreeJoint,
    rotation: Matrix,
    position: Vector,
    spin: Vector,
    turn: Vector,
    pull: Vector,
    v: Row,
    a: Row,
) -> tuple[Vector, Vector, Vector]:
    """Angular velocity, angular acceleration and acceleration of a joint's origin, from those of its parent."""
    back = transposed(rotation)
    centripetal = cross(spin, cross(spin, position))
    pull = times(back, plus(pull, cross(turn, position), centripetal))
    spin, turn = times(back, spin), times(back, turn)
    along, faster = (0.0, 0.0, v), (0.0, 0.0, a)
    if joint.kind == "slide":
        return spin, turn, plus(pull, scale(2.0, cross(spin, along)), faster)
    return plus(spin, along), plus(turn, cross(spin, along), faster), pull


def _plus(*pairs: Pair) -> Pair:
    first, second = zip(*pairs, strict=True)
    return plus(*first), plus(*second)


def _scaled(factor: Row, pair: Pair) -> Pair:
    return scale(factor, pair[0]), scale(factor, pair[1])


def _crossed(moves: Pair, other: Pair) -> Pair:
    """Rate of change of a spin and a speed, or of a momentum and its moment, fixed to what moves."""
    return cross(moves[0], other[0]), plus(cross(moves[0], other[1]), cross(moves[1], other[0]))


def _momentum(body: SpatialInertia, spin: Vector, speed: Vector) -> Pair:
    """Momentum, and its moment about the frame's origin, of a body that turns and of which that point has a speed."""
    moment = plus(times(body.inertia, spin), cross(body.moment, speed))
    return plus(scale(body.mass, speed), cross(spin, body.moment)), moment


def _inertia_slope(body: SpatialInertia, spin: Vector, speed: Vector) -> Vector:
    """Rate of change of the inertia's last row while a body moves so."""
    x, y, z = body.inertia
    turned = plus(scale(spin[0], y), scale(multiply(-1.0, spin[1]), x), cross(spin, z))
    shifted = plus(scale(body.moment[2], speed), scale(speed[2], body.moment))
    return plus(turned, scale(-1.0, shifted), (0.0, 0.0, multiply(2.0, dot(speed, body.moment))))


def _needed(body: SpatialInertia, spin: Vector, turn: Vector, pull: Vector) -> tuple[Vector, Vector]:
    """Force and moment at a frame's origin that move a body so (Newton and Euler)."""
    force = plus(scale(body.mass, pull), cross(turn, body.moment), cross(spin, cross(spin, body.moment)))
    moment = plus(times(body.inertia, turn), cross(spin, times(body.inertia, spin)), cross(body.moment, pull))
    return force, moment


def chained(poses: Sequence[Pose]) -> Pose:
    """One pose after the other, the first one outermost."""

    def after(one: Pose, other: Pose) -> Pose:
        return product(one[0], other[0]), plus(one[1], times(one[0], other[1]))

    return reduce(after, poses, (_IDENTITY, ZERO))
