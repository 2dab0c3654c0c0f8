"""A robot's MJCF or URDF as a rigid-body tree; MuJoCo's own parser reads both."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from hybrid_id.errors import InputError
from hybrid_id.robots.rows import Vector, constant, constant_vector, scale
from hybrid_id.robots.tree import Body, Point, RigidBodyTree, Servo, SpatialInertia, Tie, TreeJoint, frame
from hybrid_id.robots.walk import walk

MASSLESS = 1e-12
"""Mass [kg] and inertia [kg m^2] of a body that has none."""

BROKEN = (ValueError, RuntimeError, MemoryError)
"""What MuJoCo raises of a description that it cannot take."""
Pose = tuple[np.ndarray, np.ndarray]
"""Rotation ``(3, 3)`` and position ``(3,)`` [m] in a parent's axes."""


def load_tree(path: str | Path) -> RigidBodyTree:
    """The rigid-body tree of a robot, with its joints named as in the file.

    Contacts and sensors are left out, and of the actuators all but MuJoCo's ``position`` at a joint. Of meshes that
    are not there a body does not need any, where its inertia is written down. Joints that tendons and equality
    constraints tie, as those of a gripper, are ``tied`` until they are held, and so is a floating base.

    Args:
        path: MJCF or URDF file.

    Raises:
        InputError: the file cannot be read, or it holds what is not supported: ball joints, or a fluid. The sentence
            names the element.
    """
    path = Path(path)
    spec = read_spec(path)
    model = compiled(path, spec)
    if model.opt.density or model.opt.viscosity:
        raise InputError(
            f"{path}: <option> has a fluid (density or viscosity), which is not simulated; set it to 0."
        )
    mujoco = _mujoco(path)
    # all but gravity is simulated whatever a flag switches off
    for word in ("actuation", "spring", "damper", "frictionloss", "clampctrl"):
        flag = getattr(mujoco.mjtDisableBit, f"mjDSBL_{word.upper()}", 0)
        if model.opt.disableflags & int(flag):
            raise InputError(
                f'{path}: <flag {word}="disable"/> switches off what is simulated here; take the flag out, and what it '
                "switches off."
            )
    return _tree(path, mujoco, model)


def read_spec(path: Path) -> Any:
    """A description as MuJoCo's specification, what the package cannot simulate refused.

    Raises:
        InputError: see :func:`load_tree`.
    """
    mujoco = _mujoco(path)
    try:
        walk(path)
        spec = mujoco.MjSpec.from_file(str(path))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give an MJCF or URDF file.") from error
    except BROKEN as error:
        raise InputError(
            f"{path}: MuJoCo cannot read it ({_first_line(error)}); correct it there."
        ) from error
    for joint in spec.joints:
        if joint.type == mujoco.mjtJoint.mjJNT_BALL:
            own = f"joint '{joint.name}'" if joint.name else "a joint without a name"
            raise InputError(
                f"{path}: {own} of body '{joint.parent.name}' is a ball joint, which is not supported; put hinges in "
                "its place, or take it out where it does not move."
            )
    for body in spec.bodies:
        if body.mass < 0.0:
            raise InputError(f"{path}: mass of body '{body.name}' is {body.mass:g} kg; give 0 or more.")
    without_missing_meshes(path, mujoco, spec)
    return spec


def compiled(path: Path, spec: Any) -> Any:
    """MuJoCo's model of a specification; ``path`` is for messages."""
    spec.compiler.fusestatic = False  # bodies keep their names
    # a joint may move links without a mass where it is held, or carries others; MuJoCo wants some
    spec.compiler.boundmass = max(spec.compiler.boundmass, MASSLESS)
    spec.compiler.boundinertia = max(spec.compiler.boundinertia, MASSLESS)
    try:
        return spec.compile()
    except BROKEN as error:
        raise InputError(
            f"{path}: {_first_line(error)}; MuJoCo cannot compile it, so mend it there."
        ) from error


def _mujoco(path: Path) -> Any:
    try:
        import mujoco
    except ImportError as error:
        raise InputError(
            f"{path}: reading a robot's description needs MuJoCo; install it with pip install 'hybrid_id[robots]'."
        ) from error
    return mujoco


def _first_line(error: Exception) -> str:
    words = str(error).strip().splitlines()
    plain = re.sub(r"^(XML )?Error: (Error: )?", "", " ".join(words[:2]))
    return plain[:300].rstrip(".") or "it cannot be parsed"


def without_missing_meshes(path: Path, mujoco: Any, spec: Any) -> None:
    """Take out shapes whose mesh is not there: only a body without an inertia of its own needs them."""
    # a URDF names its meshes as packages do
    home = path.parent / (spec.compiler.meshdir or "")
    missing = {mesh.name for mesh in spec.meshes if mesh.file and not (home / Path(mesh.file)).is_file()}
    missing |= {mesh.name or Path(mesh.file).stem for mesh in spec.meshes if mesh.name in missing}
    from_geom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    always = int(spec.compiler.inertiafromgeom) == int(from_geom)
    fault = "inertiafromgeom asks for it; add it" if always else "the body has no <inertial>; add one of them"
    for geom in list(spec.geoms):
        if geom.type == mujoco.mjtGeom.mjGEOM_MESH and geom.meshname in missing:
            body = geom.parent
            if body.name != "world" and (always or not body.explicitinertial):
                own = f"body '{body.name}'" if body.name else "a body without a name"
                raise InputError(f"{path}: the mesh '{geom.meshname}' of {own} is not there and {fault}.")
            spec.delete(geom)
    for mesh in list(spec.meshes):
        if mesh.name in missing:
            spec.delete(mesh)


def _tree(path: Path, mujoco: Any, model: Any) -> RigidBodyTree:
    """Joints and bodies of a compiled model, each body's pose in the frame of the joint that moves it."""
    joints: list[TreeJoint] = []
    bodies: list[Body] = []
    carried: list[Body] = []
    points: dict[str, Point] = {}
    speeds = _speed_limits(path)
    held: dict[int, tuple[int, Pose]] = {0: (-1, (np.eye(3), np.zeros(3)))}  # body: its joint, its pose there
    for b in range(1, model.nbody):
        joint, pose = held[int(model.body_parentid[b])]
        pose = _after(pose, (_rotation(mujoco, model.body_quat[b]), model.body_pos[b]))
        first = int(model.body_jntadr[b])
        for j in range(first, first + int(model.body_jntnum[b])):
            if _floats(mujoco, model, j):
                continue  # a base stays where it is drawn, and so does an object beside the robot
            turned = np.array(frame(model.jnt_axis[j].tolist()), dtype=float)
            there = (turned, np.array(model.jnt_pos[j]))  # in the body's axes
            start = _after(pose, there)
            found = _joint(path, mujoco, model, j, joint, start)
            joints.append(replace(found, speed_limit=speeds.get(found.name, np.inf)))
            joint, pose = len(joints) - 1, (there[0].T, -there[0].T @ there[1])
        held[b] = (joint, pose)
        if joint >= 0:
            bodies.append(_body(mujoco, model, b, joint, pose))
            if (share := float(model.body_gravcomp[b])) != 0.0:
                own = bodies[-1].inertia
                held_up = replace(own, mass=share * own.mass, moment=scale(share, own.moment))
                carried.append(replace(bodies[-1], inertia=held_up))
            points[bodies[-1].name] = Point(joint, bodies[-1].position, bodies[-1].rotation)
    for number in range(model.nsite):
        joint, pose = held[int(model.site_bodyid[number])]
        name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_SITE, number)
        if joint >= 0 and name:
            rotation, position = _after(
                pose, (_rotation(mujoco, model.site_quat[number]), model.site_pos[number])
            )
            points[name] = Point(joint, _vector(position), constant(rotation.tolist()))
    if not joints:
        raise InputError(f"{path}: it has no joint that moves; give the description of an arm.")
    off = model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
    tree = RigidBodyTree(
        tuple(joints),
        tuple(bodies),
        constant_vector([0.0] * 3 if off else model.opt.gravity.tolist()),
        points,
        source=str(path.resolve()),
        tied=_bases(path, mujoco, model) | _ties(path, mujoco, model),
    )
    if carried:
        believed = RigidBodyTree(tree.joints, tuple(carried), tree.gravity)
        tree = replace(tree, believed=believed)
    if max(own + joint.armature for own, joint in zip(tree.at_zero, joints, strict=True)) <= MASSLESS:
        raise InputError(
            f"{path}: no joint has an inertia to move (bodies {', '.join(body.name for body in bodies)}); give each "
            "body its mass and inertia as <inertial>."
        )
    return tree


def _ties(path: Path, mujoco: Any, model: Any) -> dict[str, Tie]:
    """Joints that tendons and equality constraints tie to others or to a place; those switched off tie none."""
    found: dict[str, Tie] = {}

    def tie(
        kind: Any, number: int, word: str, joints: Iterable[int], first: int = -1, apart: float = 0.0
    ) -> None:
        title = mujoco.mj_id2name(model, kind, number)
        by = f"{word} '{title}'" if title else f"{word} {number + 1}"
        for j in sorted(j for j in joints if not _floats(mujoco, model, j)):
            at = float(model.qpos0[int(model.jnt_qposadr[j])]) + (apart if j == first else 0.0)
            at = float(np.clip(at, *model.jnt_range[j])) if model.jnt_limited[j] else at
            found.setdefault(mujoco.mj_id2name(model, obj.mjOBJ_JOINT, j), Tie(by, at))

    eq, obj, trn = mujoco.mjtEq, mujoco.mjtObj, mujoco.mjtTrn
    pulled = model.actuator_trnid[model.actuator_trntype == trn.mjTRN_TENDON, 0]
    passive = (model.tendon_stiffness, model.tendon_damping, model.tendon_frictionloss, model.tendon_armature)
    for t in range(model.ntendon):
        if t in pulled or model.tendon_limited[t] or any(np.any(values[t]) for values in passive):
            tie(obj.mjOBJ_TENDON, t, "tendon", _wrapped(mujoco, model, t))
    off = model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_EQUALITY)
    for i in () if off else np.flatnonzero(model.eq_active0):
        ends = [int(end) for end in (model.eq_obj1id[i], model.eq_obj2id[i]) if end >= 0]
        kind = eq(int(model.eq_type[i]))
        if kind == eq.mjEQ_JOINT:
            joints = set(ends)
        elif kind == eq.mjEQ_TENDON:
            joints = set().union(*(_wrapped(mujoco, model, t) for t in ends))
        elif kind in (eq.mjEQ_CONNECT, eq.mjEQ_WELD):
            sites = model.eq_objtype[i] == obj.mjOBJ_SITE
            joints = _between(model, [int(model.site_bodyid[end]) if sites else end for end in ends])
        else:
            raise InputError(f"{path}: an equality constraint of a flex is not simulated; take it out.")
        # MuJoCo makes a URDF's <mimic> one
        word = "mimic" if path.suffix.lower() == ".urdf" else "equality"
        # it puts its first joint apart from where it is drawn
        first = ends[0] if kind == eq.mjEQ_JOINT else -1
        tie(obj.mjOBJ_EQUALITY, int(i), word, joints, first, float(model.eq_data[i][0]))
    return found


def _bases(path: Path, mujoco: Any, model: Any) -> dict[str, Tie]:
    """Floating bases that carry joints, by the name of their joint or else of their body."""
    found: dict[str, Tie] = {}
    taken = [model.joint(j).name for j in range(model.njnt) if not _floats(mujoco, model, j)]
    for j in (j for j in range(model.njnt) if _floats(mujoco, model, j)):
        body = int(model.jnt_bodyid[j])
        if np.count_nonzero(model.body_rootid[model.jnt_bodyid] == body) > 1:
            ways = ((mujoco.mjtObj.mjOBJ_JOINT, j), (mujoco.mjtObj.mjOBJ_BODY, body))
            names = [name for kind, number in ways if (name := mujoco.mj_id2name(model, kind, number))]
            if not names or names[0] in taken:
                fault = f"is called '{names[0]}' as another joint is" if names else "has no name"
                raise InputError(f"{path}: the floating base {fault}; give its joint a name of its own.")
            found[names[0]] = Tie("a floating base", 0.0)
    return found


def _floats(mujoco: Any, model: Any, j: int) -> bool:
    return bool(model.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE)


def _wrapped(mujoco: Any, model: Any, tendon: int) -> set[int]:
    """Numbers of the joints that change the length of a tendon."""
    wrap, first = mujoco.mjtWrap, int(model.tendon_adr[tendon])
    joints, bodies = set[int](), list[int]()
    for k in range(first, first + int(model.tendon_num[tendon])):
        kind, number = wrap(int(model.wrap_type[k])), int(model.wrap_objid[k])
        if kind == wrap.mjWRAP_JOINT:
            joints.add(number)
        elif kind == wrap.mjWRAP_SITE:
            bodies.append(int(model.site_bodyid[number]))
        elif kind in (wrap.mjWRAP_SPHERE, wrap.mjWRAP_CYLINDER):
            bodies.append(int(model.geom_bodyid[number]))
    return joints | _between(model, bodies)


def _between(model: Any, bodies: Sequence[int]) -> set[int]:
    """Numbers of the joints that move some of the bodies against others of them."""
    above = []
    for body in bodies:
        own = {body}
        while body := int(model.body_parentid[body]):
            own.add(body)
        above.append(own)
    apart = set[int]().union(*above) - set.intersection(*above) if above else set[int]()
    return {j for j in range(model.njnt) if int(model.jnt_bodyid[j]) in apart}


def _joint(path: Path, mujoco: Any, model: Any, j: int, parent: int, start: Pose) -> TreeJoint:
    """A joint whose frame at MuJoCo's zero is known: at ``qpos0`` it stands as the file draws it."""
    slide = model.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE
    zero, at = float(model.qpos0[int(model.jnt_qposadr[j])]), int(model.jnt_dofadr[j])
    sine, cosine = np.sin(-zero), np.cos(-zero)
    turn = np.eye(3) if slide else np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    rotation, position = _after(start, (turn, np.array([0.0, 0.0, -zero if slide else 0.0])))
    limited = bool(model.jnt_limited[j])
    low, high = (float(end) for end in model.jnt_range[j])
    name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, j)
    if not name:
        body = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, int(model.jnt_bodyid[j]))
        raise InputError(f"{path}: a joint of body '{body}' has no name; give it one.")
    # the actuators at the joint: those that drive it, and those that brake it by its speed alone, whatever they are
    # told (a loop of the speed brakes where another actuator drives the joint; alone it drives)
    trn, gain, bias = mujoco.mjtTrn, mujoco.mjtGain, mujoco.mjtBias
    kinds = (int(trn.mjTRN_JOINT), int(trn.mjTRN_JOINTINPARENT))  # of a hinge or slide both are the same
    here = np.isin(model.actuator_trntype, kinds) & (model.actuator_trnid[:, 0] == j)
    acting, passive = [int(i) for i in np.flatnonzero(here)], braking(model) | idle(model)
    driving = [i for i in acting if not passive[i]] or [i for i in acting if model.actuator_gainprm[i][0]]
    brakes = [i for i in acting if i not in driving]
    gears, fixed = model.actuator_gear[:, 0], model.actuator_gaintype == gain.mjGAIN_FIXED
    affine = model.actuator_biastype == bias.mjBIAS_AFFINE
    static = model.actuator_dyntype == mujoco.mjtDyn.mjDYN_NONE
    brake = 0.0 - sum(float(gears[i] ** 2 * model.actuator_biasprm[i][2]) for i in brakes)
    limits = [
        abs(float(gears[i])) * float(np.min(np.abs(model.actuator_forcerange[i])))
        for i in acting
        if model.actuator_forcelimited[i]
    ]
    limits += [float(np.min(np.abs(model.jnt_actfrcrange[j])))] if model.jnt_actfrclimited[j] else []
    torque_limit = min(limits, default=np.inf)
    # its position loop: an actuator whose force is kp (ctrl - l) - kv l', with l the gear times q
    servo: Servo | None = None
    for i in driving:
        stiffness, gear = float(model.actuator_gainprm[i][0]), float(gears[i])
        constant_part, by_angle, by_speed = (float(term) for term in model.actuator_biasprm[i][:3])
        loop = stiffness > 0.0 and by_angle == -stiffness and constant_part == 0.0
        if servo is None and gear > 0.0 and static[i] and fixed[i] and loop:
            least, most = (float(end) / gear for end in model.actuator_ctrlrange[i])
            goals = (least, most) if model.actuator_ctrllimited[i] else None
            largest = None if np.isinf(torque_limit) else torque_limit
            servo = Servo(gear**2 * stiffness, brake - gear**2 * by_speed, largest, goals)
    damping = float(np.ravel(model.dof_damping[at])[0])
    damping += sum(float(gears[i] ** 2 * model.actuator_damping[i]) for i in acting)
    damping += 0.0 if servo else brake
    dry = float(model.dof_frictionloss[at])
    for word, value in (("damping", damping), ("frictionloss", dry)):
        if value < 0.0:
            raise InputError(f"{path}: {word} of joint '{name}' is {value:g}; give 0 or more.")
    for word, further in (("damping", model.dof_dampingpoly[at]), ("stiffness", model.jnt_stiffnesspoly[j])):
        if np.any(further):
            raise InputError(
                f"{path}: {word} of joint '{name}' is a polynomial, which is not simulated; keep its first number."
            )
    for i in acting:
        if np.any(model.actuator_dampingpoly[i]):
            raise InputError(
                f"{path}: damping of the actuator of joint '{name}' is a polynomial, which is not simulated; keep its "
                "first number."
            )
        if delay := float(model.actuator_delay[i]):
            raise InputError(
                f"{path}: the actuator of joint '{name}' has a delay, which is not read from here; take it out and "
                f"list {{place: {name}/input, kind: delay, parameters: {{T_d: {delay:g}}}}} among the components of "
                "model.yaml."
            )
    if len(driving) > 1:
        raise InputError(
            f"{path}: joint '{name}' has {len(driving)} actuators, of which one can drive it; keep that one."
        )
    if any(model.actuator_forcelimited[i] for i in brakes):
        raise InputError(
            f"{path}: the velocity actuator that brakes joint '{name}' has a forcerange of its own, which is not "
            "simulated; give the damping as that of the joint."
        )
    # what the actuator that drives it makes of its command, where that or the speed alone makes its force
    motor: dict[str, Any] = {}
    for i in driving:
        stiffness, by_angle = float(model.actuator_gainprm[i][0]), float(model.actuator_biasprm[i][1])
        if affine[i] and fixed[i] and by_angle == -stiffness and stiffness <= 0.0:
            raise InputError(
                f"{path}: kp of the actuator of joint '{name}' is {stiffness:g}; give more than 0."
            )
        # the cogging of a motor is left out
        by_gain = not (fixed[i] or model.actuator_gaintype[i] == gain.mjGAIN_DCMOTOR)
        if model.actuator_gaintype[i] == gain.mjGAIN_AFFINE:
            by_gain = model.actuator_gainprm[i][1] != 0.0
        if (by_gain or (affine[i] and by_angle != 0.0)) and servo is None:
            raise InputError(
                f"{path}: the actuator of joint '{name}' acts by the angle in another way than a <position> that has "
                "kp, kv and a gear above 0, and no timeconst, which alone is simulated; make it one, or take it out."
            )
        if fixed[i] and static[i] and model.actuator_biastype[i] == bias.mjBIAS_NONE:
            motor = {"gear": float(gears[i]), "gain": stiffness}
            if model.actuator_ctrllimited[i]:
                motor["commands"] = tuple(float(end) for end in model.actuator_ctrlrange[i])
        elif fixed[i] and static[i] and affine[i] and servo is None:
            motor = {"by_speed": bool(model.actuator_biasprm[i][2])}
    armature = float(model.dof_armature[at])
    armature += sum(float(gears[i] ** 2 * model.actuator_armature[i]) for i in acting)
    return TreeJoint(
        name=name,
        kind="slide" if slide else "hinge",
        parent=parent,
        rotation=constant(rotation.tolist()),
        position=_vector(position),
        limits=(low, high) if limited else (-float("inf"), float("inf")),
        armature=armature,
        damping=damping,
        friction_loss=dry,
        stiffness=float(np.ravel(model.jnt_stiffness[j])[0]),
        reference=float(model.qpos_spring[int(model.jnt_qposadr[j])]),
        servo=servo,
        torque_limit=torque_limit,
        **motor,
    )


def _speed_limits(path: Path) -> dict[str, float]:
    """Largest speed of each joint of a URDF [rad/s or m/s], which MuJoCo's parser leaves out; MJCF has none."""
    try:
        root = ElementTree.parse(path).getroot()
    except (
        ElementTree.ParseError
    ) as error:  # a prefix that is not declared, which MuJoCo takes for a part of a name
        raise InputError(f"{path}: no XML ({error}); correct it there.") from None
    found = {}
    for joint in root.iter("joint") if root.tag == "robot" else ():
        limit = joint.find("limit")
        words = "" if limit is None else limit.get("velocity", "")
        try:
            speed = float(words or 0.0)
        except ValueError:
            raise InputError(
                f"{path}: the velocity '{words}' of joint '{joint.get('name')}' is no number."
            ) from None
        if speed > 0.0:  # 0 is what generators write where they know none
            found[joint.get("name", "")] = speed
    return found


def braking(model: Any) -> np.ndarray:
    """Whether the force of each actuator of a compiled MJCF depends, beside its command, on the speed alone."""
    import mujoco

    affine = model.actuator_biastype == mujoco.mjtBias.mjBIAS_AFFINE  # type: ignore[attr-defined]
    constant, by_angle, by_speed = model.actuator_biasprm[:, :3].T
    return affine & (constant == 0.0) & (by_angle == 0.0) & (by_speed != 0.0)


def idle(model: Any) -> np.ndarray:
    """Whether each actuator has no effect, as one that an export leaves at its place in ``ctrl``."""
    import mujoco

    without = model.actuator_biastype == mujoco.mjtBias.mjBIAS_NONE  # type: ignore[attr-defined]
    fixed = model.actuator_gaintype == mujoco.mjtGain.mjGAIN_FIXED  # type: ignore[attr-defined]
    return without & fixed & (model.actuator_gainprm[:, 0] == 0.0)


def _body(mujoco: Any, model: Any, b: int, joint: int, pose: Pose) -> Body:
    axes = _rotation(mujoco, model.body_iquat[b])
    mass, moments = (np.where(x > MASSLESS, x, 0.0) for x in (model.body_mass[b], model.body_inertia[b]))
    about_centre = axes @ np.diag(moments) @ axes.T
    x, y, z = (_vector(row) for row in about_centre)
    inertia = SpatialInertia.about_centre(float(mass), constant_vector(model.body_ipos[b]), (x, y, z))
    rotation, position = pose
    # one without a name is called by its number, told from what others are called by a sign
    kind = mujoco.mjtObj.mjOBJ_BODY
    name = mujoco.mj_id2name(model, kind, b) or f"body{b}"
    while mujoco.mj_name2id(model, kind, name) not in (-1, b):
        name += "_"
    return Body(name, joint, constant(rotation.tolist()), _vector(position), inertia)


def _rotation(mujoco: Any, quaternion: np.ndarray) -> np.ndarray:
    found = np.empty(9)
    mujoco.mju_quat2Mat(found, quaternion)
    return found.reshape(3, 3)


def _after(one: Pose, other: Pose) -> Pose:
    return one[0] @ other[0], one[1] + one[0] @ other[1]


def _vector(values: np.ndarray) -> Vector:
    return constant_vector(values.tolist())
