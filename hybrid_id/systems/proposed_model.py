"""A first model for logs: parts that their commands demand, with starts from a data sheet or from the logs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from statistics import median
from typing import Any

import numpy as np

from hybrid_id.errors import InputError
from hybrid_id.records.proposal import DriveFit
from hybrid_id.records.proposal_parts import DriveFacts, MotorSheet, Question
from hybrid_id.robots.tree import RigidBodyTree, TreeJoint
from hybrid_id.systems.builders import started
from hybrid_id.systems.servos import SERVOS, drive_of

PLACEHOLDER = {
    "J": 2.0e-5,
    "P_m1": 0.019,
    "P_m2": 0.0254,
    "F_c": 0.01,
    "F_v": 5.0e-5,
    "k_t": 0.05,
    "k_p": 10.0,
}
"""Starts [SI] where neither a sheet nor the logs say more: a motor of some 10 W."""
EXPLAINED, PARTIAL = 0.3, 0.3
"""Share of the acceleration that a drive's fit has to explain, and the command's partial correlation, to be a start."""
GAINS = {
    "voltage": ("P_m1", "P_m2"),
    "duty": ("P_m1", "P_m2"),
    "current": ("k_t",),
    "goal": ("k_p",),
}
"""Gains between command and torque, by what is commanded."""
NOT_BACK_EMF = 0.1
"""Share of a drive's damping that starts as viscous friction and not as back-EMF."""
TIMES = 3.0
"""Times by which a servo's lag in the logs may differ from that of the gains in the robot's file."""
WEIGHS = 0.05
"""Share of the acceleration's variance that only a weight explains, from which one is taken to be there."""
SURE_OF, SURE_OF_STALL = 0.05, 0.1
"""Standard deviations of priors, relative: of a sheet's torque constant, and of stall torque per volt or per error."""
REGISTER = 16.0
"""What the register P of a servo is taken to hold where nothing says it."""


@dataclass
class ProposedModel:
    """Content of `model.yaml`.

    Attributes:
        values: as the file's keys.
        why: place in it, ``parameters.J`` or ``components.0``, and the evidence for what stands there.
        questions: what neither records nor robot say.
    """

    values: dict[str, Any]
    why: dict[str, str] = field(default_factory=dict)
    questions: list[Question] = field(default_factory=list)

    def ask(self, words: str, line: str = "") -> None:
        """Leave a question."""
        self.questions.append(Question(words, line, "model"))


def propose_model(
    drives: Sequence[DriveFacts],
    sheet: MotorSheet | None = None,
    tree: RigidBodyTree | None = None,
    held: Sequence[str] = (),
) -> ProposedModel:
    """The model of the drives that logs hold.

    Args:
        drives: in the order of their numbers; one without a robot.
        sheet: of the motor.
        tree: of the robot; None for one link.
        held: joints of the robot that no command moves in the logs.

    Raises:
        InputError: the sheet does not fit.
    """
    sheet = sheet or MotorSheet()
    if sheet.servo is not None and sheet.servo not in SERVOS:
        raise InputError(
            f"servo '{sheet.servo}' of the motor's sheet is not known; use one of {', '.join(SERVOS)}"
        )
    model = _one_link(drives[0], sheet) if tree is None else _robot(drives, sheet, tree, held)
    if sheet.servo and not any(drive.command == "goal" for drive in drives):
        commands = " and ".join(dict.fromkeys(drive.command.replace("_", " ") for drive in drives))
        model.ask(
            f"What is the servo '{sheet.servo}' of the motor's sheet for? It takes goals, and the command of the logs "
            f"is none ({commands}), so it is not used: give torque_constant and resistance instead, or log the goal."
        )
    return model


def _ratios(sheet: MotorSheet, joints: int) -> list[float]:
    given = sheet.gear_ratio
    found = [] if given is None else [given] * joints if isinstance(given, int | float) else list(given)
    if found and len(found) != joints:
        moved = "the one joint that moves" if joints == 1 else f"each of the {joints} joints that move"
        raise InputError(
            f"gear_ratio {given} of the motor's sheet has {len(found)} numbers; give one for {moved}"
        )
    if found and min(found) <= 0:
        raise InputError(
            f"gear_ratio {given} of the motor's sheet must be positive; of a gear that turns the joint the other way "
            "round, leave out the sign, and give the motor's angle and its command 'scale: -1' in dataset.yaml"
        )
    return [float(one) for one in found]


def _trusted(fit: DriveFit | None) -> DriveFit | None:
    fine = fit is not None and fit.alpha > 0 and fit.explained > EXPLAINED and fit.partial > PARTIAL
    return fit if fine else None


def _digits(value: float) -> float:
    return float(f"{value:.3g}")


def _entry(nominal: float, unit: str, prior: float = 0.0) -> dict[str, Any]:
    entry: dict[str, Any] = {"nominal": _digits(nominal)}
    return entry | ({"prior_std": _digits(prior * nominal)} if prior else {}) | {"unit": unit}


@dataclass
class _Start:
    """Start values of one drive, at its motor, and where each is from."""

    values: dict[str, float]
    why: dict[str, str]
    priors: dict[str, float]


def _start(drive: DriveFacts, sheet: MotorSheet, ratio: float, inertia: float | None) -> _Start:
    """Start values by the sheet, else by the fit of the acceleration, else placeholders.

    Args:
        drive: what the logs say.
        sheet: of the motor.
        ratio: of the gear.
        inertia: at the motor [kg m^2], where a description knows it.
    """
    fit = _trusted(drive.fit)
    seen = ratio if drive.side == "a" else 1.0  # of the motor, for one of the angle
    values, why, priors = dict(PLACEHOLDER), dict.fromkeys(PLACEHOLDER, "placeholder"), {}
    by_fit = "" if fit is None else f"fit of the logs' acceleration ({100 * fit.explained:.0f} % explained)"
    alpha = seen * fit.alpha if fit else 0.0
    constant = sheet.back_emf_constant or sheet.torque_constant
    if constant:
        values["P_m2"], why["P_m2"], priors["P_m2"] = constant, "motor's sheet", SURE_OF
    elif fit and fit.beta > 0:
        values["P_m2"], why["P_m2"] = (1.0 - NOT_BACK_EMF) * fit.beta / alpha, by_fit
    torque_constant = sheet.torque_constant or sheet.back_emf_constant
    if torque_constant:
        values["k_t"], why["k_t"], priors["k_t"] = torque_constant, "motor's sheet", SURE_OF
    if torque_constant and sheet.resistance:
        values["P_m1"], why["P_m1"] = (
            torque_constant / sheet.resistance,
            "motor's sheet: torque constant / resistance",
        )
        priors["P_m1"] = SURE_OF_STALL
    servo = sheet.servo is not None and drive.command == "goal"
    if sheet.servo is not None and servo:
        loop, friction = drive_of(SERVOS[sheet.servo], sheet.p or REGISTER, ratio, sheet.voltage)
        for name, part in (("k_p", loop), ("tau_max", loop), ("F_v", friction)):
            values[name], why[name] = part.specs[name].value, f"data sheet of {sheet.servo}"
        priors |= {"k_p": SURE_OF_STALL} if sheet.p else {}
    gain = {"voltage": "P_m1", "duty": "P_m1", "current": "k_t"}.get(drive.command)
    if fit and drive.command == "torque":
        values["J"], why["J"] = 1.0 / alpha, by_fit
    elif fit and gain and gain in priors:
        values["J"], why["J"] = values[gain] / alpha, f"{by_fit} with {gain} of the sheet"
    elif fit and servo:
        values["J"], why["J"] = values["k_p"] / (fit.alpha * ratio**2), f"{by_fit} with k_p of the data sheet"
    elif inertia or sheet.inertia:
        values["J"] = float(inertia or sheet.inertia or 0.0)
        why["J"] = "robot's description" if inertia else "motor's sheet: rotor alone, the link comes on top"
    j = values["J"]
    if fit and gain and gain not in priors:
        values[gain], why[gain] = alpha * j, f"{by_fit} with J as it stands here"
    if fit and drive.command == "goal" and not servo:
        values["k_p"], why["k_p"] = fit.alpha * j * ratio**2, f"{by_fit} with J as it stands here"
    if drive.lag:
        late = f"the lag of the angle behind its goal, {drive.lag:.3g} s, times k_p"
        values["F_v"], why["F_v"] = drive.lag * values["k_p"] / ratio**2, late
    if fit:
        damping = max(fit.beta, 0.0) * j
        electric = values["P_m1"] * values["P_m2"] if gain == "P_m1" else 0.0
        values["F_v"], why["F_v"] = max(damping - electric, NOT_BACK_EMF * damping, 1e-9), by_fit
        values["F_c"], why["F_c"] = max(seen * fit.gamma * j, 1e-3 * j), by_fit
    return _Start(values, why, priors)


def _one_link(drive: DriveFacts, sheet: MotorSheet) -> ProposedModel:
    ratios = _ratios(sheet, 1)
    ratio = ratios[0] if ratios else 1.0
    model = ProposedModel({"system": "one_link", "gear_ratio": [ratio]})
    model.why["system"] = "one motor, one joint, stiff gear: the simplest; no robot was given"
    model.why["gear_ratio"] = (
        "motor's sheet" if ratios else "not known: all values are then those at the angle's side"
    )
    if not ratios:
        model.ask(
            "How many turns of the motor make one of the joint? gear_ratio is 1, which puts all parameters at the side "
            "of the angle: J is then the inertia seen there. Give gear_ratio in --motor."
        )
    start = _start(drive, sheet, ratio, None)
    dc = drive.command in ("voltage", "duty", "position_loop")
    names = (
        {"J": "kg m^2"}
        | ({"P_m1": "N m/V", "P_m2": "V s/rad"} if dc else {})
        | {"F_c": "N m", "F_v": "N m s/rad"}
    )
    model.values["parameters"] = {
        name: _entry(start.values[name], unit, start.priors.get(name, 0.0)) for name, unit in names.items()
    }
    for name in names:
        model.why[f"parameters.{name}"] = start.why[name]
    components = _parts("joint1", drive, start, False, sheet, False)
    _add(model, components)
    goal = drive.command == "goal"
    if goal and sheet.servo and not sheet.p:
        _ask_of_gains(model, [], {}, register=True)
    elif "k_p" not in start.priors if goal else not (start.priors or drive.command == "torque"):
        what = (
            "How stiff is the servo's loop"
            if goal
            else "What is the motor's torque constant (and resistance)"
        )
        cure = "the servo (servo, p)" if goal else "torque_constant and resistance"
        model.ask(
            f"{what}? Without a known torque only ratios of parameters to J are identifiable, J itself is a "
            f"placeholder. Give {cure} in --motor."
        )
    if placeholders := [name for name in names if start.why[name] == "placeholder" and name != "J"]:
        model.ask(
            f"Where are {', '.join(placeholders)} from? They are placeholders: the logs' acceleration gives no start."
        )
    # gravity where the acceleration follows the angle's sine and cosine; asked about either way
    fit, line = drive.fit, "gravity: vertical   # and G_l: {nominal: 1.0, unit: N m}"
    if fit is None or not fit.gravity:
        model.ask("Does gravity act on the joint? None is assumed.", line)
    else:
        pull = f"{fit.gravity:.3g} rad/s^2 of the acceleration follow sine and cosine of the angle"
        if drive.side == "m" and ratio != 1.0:  # the fit has taken the motor's angle for the joint's
            model.ask("Does gravity act on the joint? None is assumed.", line)
        elif _trusted(fit) is None or fit.weight < WEIGHS:
            model.ask(f"Does gravity act on the joint? None is assumed, {pull}.", line)
        else:
            why = f"{pull}, and explain {100 * fit.weight:.0f} % of its variance that nothing else does"
            model.values["gravity"], model.why["gravity"] = "vertical", why
            model.values["parameters"] = model.values.pop("parameters")  # behind it
            load = _entry(fit.gravity * start.values["J"] * ratio**2, "N m")
            hang = {"nominal": _digits(fit.hang), "unit": "rad", "estimate": True}
            for name, entry in (("G_l", load), ("q_0", hang)):
                model.values["parameters"][name], model.why[f"parameters.{name}"] = (
                    entry,
                    "fit of the logs' acceleration",
                )
            model.ask("Is it gravity that pulls at the joint? A spring does so, too; 'diagnose' parts them.")
    return model


def _robot(
    drives: Sequence[DriveFacts], sheet: MotorSheet, tree: RigidBodyTree, held: Sequence[str]
) -> ProposedModel:
    entry: dict[str, Any] = {"file": tree.source}
    rest = {joint.name: float(np.clip(0.0, *joint.limits)) for joint in tree.joints if joint.name in held}
    rest |= {name: tie.at for name, tie in tree.tied.items()}
    if rest:
        entry["hold"] = rest
    model = ProposedModel({"robot": entry})
    order = ", ".join(drive.joint for drive in drives)
    model.why["robot"] = f"joints from the base outwards, as they are numbered: {order}"
    stand = {name: f"{name} at {value:.4g}" for name, value in rest.items()}
    lone = [name for name in rest if name not in tree.tied]
    tied, bases = ([name for name in tree.tied if (name in tree.names) == known] for known in (True, False))
    ties = " and ".join(dict.fromkeys(tree.tied[name].by for name in tied))
    for names, why in (
        (lone, "moved by no command in the logs"), (tied, f"tied by {ties}"), (bases, "a floating base")
    ):  # fmt: skip
        if names:
            model.why["robot"] += f"; {why}, so held: {', '.join(stand[name] for name in names)}"
    if lone or tied:
        whom = ["no command moves in the logs"] * bool(lone) + ["are tied to others"] * bool(tied)
        where = ", ".join(stand[name] for name in (*lone, *tied))
        model.ask(
            f"Where do joints stand that {' or '.join(whom)}? {where} (rad or m) is assumed, by the robot's file; "
            "correct 'hold' in model.yaml."
        )
    if tree.believed is not None:
        model.why["robot"] += (
            "; with gravcomp: a controller that holds the links' weight (gravity_compensation)"
        )
        model.ask(
            "Does the robot's own controller hold the weight of its links beside what the logs command, as gravcomp in "
            "its file says? Else list gravity_compensation with c_g 0 at the first joint."
        )
    if bases:
        model.ask(
            f"Does the base {bases[0]} stand still in all logs, turned as the robot's file draws it? It is taken so; "
            "leave out logs in which it moves."
        )
    ratios = _ratios(sheet, len(drives))
    if ratios:
        model.values["gear_ratio"], model.why["gear_ratio"] = ratios, "motor's sheet"
    else:
        model.why["robot"] += "; gear_ratio is 1, so that all parameters are seen at the joints"
    still = tree.holding(rest) if rest else tree
    gears = {joint.name: joint.gear for joint in still.joints if joint.gear not in (0.0, 1.0)}
    if gears and not bool(ratios):
        line = ", ".join(f"{abs(gears.get(joint.name, 1.0)):g}" for joint in still.joints)
        other = (
            " A minus turns the joint the other way: it is the 'scale: -1' of its command in dataset.yaml."
        )
        model.ask(
            f"Are the gears by which the robot's file multiplies commands those of the drives ({_at_joints(gears)})? "
            "They are not taken: torques and motors are those at the joints. Else give gear_ratio in --motor."
            + (other if min(gears.values()) < 0.0 else ""),
            f"gear_ratio: [{line}]",
        )
    torques = [joint for drive, joint in zip(drives, still.joints, strict=True) if drive.command == "torque"]
    if gains := {joint.name: joint.gain for joint in torques if joint.gain != 1.0}:
        model.ask(
            f"What are the commands that the robot's file multiplies by a gain ({_at_joints(gains)}): torques, volts, "
            "amperes or per cent? Torques are taken, without the gain; else name the columns of the logs after what "
            "they hold, or give them that 'scale' in dataset.yaml."
        )
    if braked := [joint.name for joint in torques if joint.by_speed]:
        model.ask(
            f"Are the commands of {', '.join(braked)} torques? They are taken as such, without the brake by the speed "
            "that the actuators in the robot's file have (<velocity>, or a back-EMF); else log torque or voltage."
        )
    servos: dict[str, dict[str, Any]] = {}
    placeholders: dict[str, list[str]] = {}
    late: list[str] = []
    joints = started(still)
    for k, (drive, joint) in enumerate(zip(drives, joints, strict=True)):
        ratio = ratios[k] if ratios else 1.0
        start = _start(drive, sheet, ratio, (still.at_zero[k] + joint.armature) / ratio**2)
        # where its own does not show, the lag of joints with the same actuator and damping, the median
        alike = [
            one.lag
            for one, other in zip(drives, joints, strict=True)
            if one.lag and other.damping == joint.damping and _gains(other) == _gains(joint)
        ]
        other_gains = _other_gains(drive, joint, float(median(alike)) if alike else 0.0)
        own = joint.servo is not None and other_gains is None
        if drive.command == "goal" and sheet.servo:
            servos[drive.joint] = {"preset": sheet.servo, "p": sheet.p or REGISTER}
            servos[drive.joint] |= {"voltage": sheet.voltage} if sheet.voltage else {}
            own, other_gains = True, None
        if other_gains:
            late.append(drive.joint)
            _add(model, [other_gains])
        _add(model, _parts(drive.joint, drive, start, own or bool(other_gains), sheet, True))
        for name in () if drive.command == "goal" and (own or other_gains) else GAINS.get(drive.command, ()):
            if name not in start.priors:
                placeholders.setdefault(name, []).append(drive.joint)
    if servos:
        model.values["servos"], model.why["servos"] = servos, "motor's sheet"
    _ask_of_gains(model, late, placeholders, register=bool(servos) and sheet.p is None)
    return model


def _at_joints(values: Mapping[str, float]) -> str:
    return ", ".join(f"{value:g} at {name}" for name, value in values.items())


def _ask_of_gains(
    model: ProposedModel, late: Sequence[str], placeholders: Mapping[str, Sequence[str]], *, register: bool
) -> None:
    """Ask for the gains that neither sheet nor robot say.

    Args:
        model: takes the questions.
        late: joints whose logs contradict the gains in the robot's file.
        placeholders: joints by the gain that starts from a placeholder.
        register: whether the servos' register P is unknown.
    """
    if register:
        model.ask(f"What does the register P of the servos hold? {REGISTER:g} is assumed. Give p in --motor.")
    if late:
        model.ask(
            f"How stiff are the servos of {', '.join(late)}? The logs contradict the gains in the robot's file, so k_p "
            "starts from the logs. Give the servo (servo, p) in --motor, or correct the file."
        )
    for name, joints in placeholders.items():
        cure = {
            "k_p": "it is a start only; give the servo (servo, p) in --motor, or the file a position actuator",
            "k_t": "give torque_constant in --motor",
        }.get(name, "give torque_constant and resistance in --motor")
        model.ask(
            f"How large is {name} of {', '.join(joints)}? Its start is from the logs or a placeholder: {cure}."
        )


def _gains(joint: TreeJoint) -> tuple[float, float] | None:
    return None if joint.servo is None else (joint.servo.stiffness, joint.servo.damping)


def _other_gains(drive: DriveFacts, joint: TreeJoint, same: float) -> tuple[dict[str, Any], str] | None:
    """A position loop by how late the logs' angle is, and why; None where the gains of the robot's file fit that.

    Args:
        drive: what the logs say of the joint.
        joint: of the robot's file.
        same: how late the angles of joints with the same actuator are [s]: what is taken where its own does not show.
    """
    servo, late = joint.servo, drive.lag or same
    if drive.command != "goal" or servo is None or not late:
        return None
    lag = (servo.damping + joint.damping) / servo.stiffness
    if late / TIMES < lag < TIMES * late or not joint.damping:
        return None
    limits = {} if servo.largest is None else {"tau_max": _entry(servo.largest, "N m")}
    if servo.goals is not None:
        limits |= {name: float(one) for name, one in zip(("goal_min", "goal_max"), servo.goals, strict=True)}
    k_p = _entry(joint.damping / late, "N m/rad")
    part = {"place": f"{drive.joint}/input", "kind": "position_servo", "parameters": {"k_p": k_p, **limits}}
    of = "" if drive.lag else "of joints with the same actuator "
    words = (
        f"the angle {of}is {1e3 * late:.3g} ms behind its goal, where the gains in the robot's file (kp "
        f"{servo.stiffness:g}, kv {servo.damping:g}) would give {1e3 * lag:.2g} ms; k_p from that and the file's "
        "damping, no kv"
    )
    return part, words


def _parts(
    at: str, drive: DriveFacts, start: _Start, own_loop: bool, sheet: MotorSheet, robot: bool
) -> list[tuple[dict[str, Any], str]]:
    """Components beyond the usual ones, and why each is there."""

    def part(place: str, kind: str, **parameters: Any) -> dict[str, Any]:
        return {"place": f"{at}/{place}", "kind": kind} | ({"parameters": parameters} if parameters else {})

    def value(name: str, unit: str) -> dict[str, Any]:
        return _entry(start.values[name], unit, start.priors.get(name, 0.0))

    constants = {"P_m1": value("P_m1", "N m/V"), "P_m2": value("P_m2", "V s/rad")}
    motor = [
        (part("motor", "dc_motor", **constants), f"P_m1: {start.why['P_m1']}; P_m2: {start.why['P_m2']}")
    ]
    motor = motor if robot else []
    found: list[tuple[dict[str, Any], str]] = []
    if drive.command == "voltage" and robot:
        found = [(part("input", "voltage"), "the command is a voltage"), *motor]
    elif drive.command == "duty":
        found = [(part("input", "duty_supply"), "the command is a duty of a logged supply"), *motor]
    elif drive.command == "position_loop":
        words = (
            "the command is a goal, its loop's gain and the supply are logged; duty_per_rad by your firmware"
        )
        found = [(part("input", "position_loop"), words), *motor]
    elif drive.command == "current":
        found = [
            (part("input", "current_command"), "the command is a current"),
            (part("motor", "current_motor", k_t=value("k_t", "N m/A")), f"k_t: {start.why['k_t']}"),
        ]
    elif drive.command == "torque" and not robot:
        found = [
            (part("input", "torque_command"), "the command is a torque"),
            (part("motor", "torque_motor"), "a torque that acts as commanded"),
        ]
    elif drive.command == "torque" and own_loop:
        found = [
            (
                part("input", "torque_command"),
                "the command is a torque, though the file has a position actuator",
            )
        ]
    elif drive.command == "goal" and not own_loop:
        top = {"tau_max": value("tau_max", "N m")} if "tau_max" in start.values else {}
        loop = part("input", "position_servo", k_p=value("k_p", "N m/rad"), **top)
        found = [(loop, f"the command is a goal; k_p: {start.why['k_p']}")]
        found += [] if robot else [(part("motor", "torque_motor"), "the loop gives a torque")]
    if drive.unsigned:
        found.append((part("sensor", "unsigned_current"), "the current is logged without its sign"))
    return found


def _add(model: ProposedModel, components: Sequence[tuple[dict[str, Any], str]]) -> None:
    listed = model.values.setdefault("components", [])
    for entry, why in components:
        model.why[f"components.{len(listed)}"] = why
        listed.append(entry)
    if not listed:
        del model.values["components"]
