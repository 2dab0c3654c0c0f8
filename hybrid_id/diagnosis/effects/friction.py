"""Effects of friction, on either side of the gear."""

import math

from hybrid_id.diagnosis.catalogue import Effect, free, has, part_of, register
from hybrid_id.diagnosis.periodic import friction_spots, friction_waves

DRY = (
    "coulomb_friction",
    "stribeck_friction",
    "asymmetric_stribeck",
    "asymmetric_stribeck_eq8",
    "asymmetric_tanh",
)
BRISTLES = ("dahl", "lugre", "maxwell_slip")


def _side(s, place):
    """Ratio from the rotor to the speed of a place, and how much larger torques are there."""
    return s.ratio if place == "link_friction" else 1.0


def _coulomb(system, s, place):
    where = f"joint{s.joint}/{place}"
    law = part_of(system, where, "coulomb_friction")
    if has(system, where, *DRY[1:]) or (law is not None and law.specs["F_c"].estimate):
        return []
    r = _side(s, place)
    return [("coulomb_friction", {"F_c": free(0.1 * s.torque * r, 0.0, 3.0 * s.torque * r, "N m")})]


def _viscous(system, s, place):
    where = f"joint{s.joint}/{place}"
    law = part_of(system, where, "viscous_friction")
    motor = part_of(system, f"joint{s.joint}/motor", "dc_motor")
    # on the motor's side it hides in a back-EMF that is estimated, unless the motor's torque is seen
    unknown = motor is not None and motor.specs["P_m2"].estimate and not s.shows_torque
    if (place == "motor_friction" and unknown) or (law is not None and law.specs["F_v"].estimate):
        return []
    size = 0.1 * s.torque * _side(s, place) ** 2 / s.speed
    return [("viscous_friction", {"F_v": free(size, 0.0, 100.0 * size, "N m s/rad")})]


def _stribeck(system, s, place):
    where = f"joint{s.joint}/{place}"
    if has(system, where, "stribeck_friction", *DRY[2:]) or not has(system, where, "coulomb_friction"):
        return []
    r, v = _side(s, place), s.speed / _side(s, place)
    return [
        (
            "stribeck_friction",
            {"F_drop": free(0.3 * s.dry * r, 0.0, 5.0 * s.dry * r, "N m"),
                "v_s": free(share * v, 0.002 * v, 0.5 * v, "rad/s"),
             "p": free(p, 0.5, 3.0)},
        )
        for share in (0.03, 0.15) for p in (1.0, 2.0)
    ]  # fmt: skip


def _asymmetric(system, s, place):
    where = f"joint{s.joint}/{place}"
    if has(system, where, "asymmetric_friction", *DRY[2:]):
        return []
    r = _side(s, place)
    limit, damp = s.dry * r, 2.0 * s.torque * r**2 / s.speed
    return [
        (
            "asymmetric_friction",
            {
                "F_a": free(sign * 0.2 * limit, -3 * limit, 3 * limit, "N m"),
                "D_a": free(0.0, -damp, damp, "N m s/rad"),
            },
        )
        for sign in (1.0, -1.0)
    ]


def _presliding(system, s, place):
    where = f"joint{s.joint}/{place}"
    if has(system, where, *BRISTLES) or not has(system, where, *DRY):
        return []
    r, found = _side(s, place), []
    for stiffness in (s.dry * r**2 / (share * s.turns) for share in (0.001, 0.01)):
        spring = free(stiffness, 0.02 * stiffness, 50.0 * stiffness, "N m/rad")
        # a tenth of what would damp the rotor on its bristle aperiodically
        damping = 0.2 * (stiffness * s.rotor * r**2) ** 0.5
        damper = free(damping, 0.0, 100.0 * damping, "N m s/rad")
        found += [("dahl", {"sigma": spring}), ("maxwell_slip", {"sigma": spring})]
        found.append(("lugre", {"sigma_0": spring, "sigma_1": damper}))
    return found


def _drag(system, s, place):
    if has(system, f"joint{s.joint}/{place}", "quadratic_drag"):
        return []
    size = 0.05 * s.torque * _side(s, place) ** 3 / s.speed**2
    return [("quadratic_drag", {"F_q": free(size, 0.0, 100.0 * size, "N m s^2/rad^2")})]


def _load_dependent(system, s, place):
    kinds = ("load_dependent_friction", "effort_dependent_friction")
    if has(system, f"joint{s.joint}/motor_friction", *kinds):
        return []
    return [(kind, {"mu": free(0.1, 0.0, 0.9)}) for kind in kinds]


def _over_angle(left, joint, place):
    """What friction over the angle would explain most of what a fit leaves: waves and spots."""
    return friction_waves(left, joint, place), friction_spots(left, joint, place)


def _position(system, s, place, found=(((1.0, 1e-6, 0.0),), ((0.0, 0.1, 1e-6),))):
    where = f"joint{s.joint}/{place}"
    if has(system, where, "position_dependent_friction", "tight_spot"):
        return []
    waves, spots = found
    most, near = 3.0 * s.dry * _side(s, place), math.pi / s.angle

    def level(size):
        return free(size, -most, most, "N m")

    # a place without dry friction has no mean that the waves could be added to
    dry = has(system, where, *DRY, *BRISTLES)
    mean = {} if dry else {"A_0": free(0.1 * most, 0.0, most, "N m")}
    return [
        ("position_dependent_friction",
         {**mean, "A_c": level(c), "A_s": level(d), "n": free(n, n - near, n + near)})
        for n, c, d in waves
    ] + [
        ("tight_spot", {"A": level(height), "q_0": free(q, q - 0.2 * s.angle, q + 0.2 * s.angle, "rad"),
                        "w": free(w, 0.01 * s.angle, s.angle, "rad")})
        for q, w, height in spots
    ]  # fmt: skip


JUMPS = "jumps with the direction"
BOTH = ("motor_friction", "link_friction")
MODELS = (
    "H. Olsson, K. J. Astrom, C. Canudas de Wit, M. Gafvert, P. Lischinsky, Friction models and friction compensation, "
    "European Journal of Control 4(3), 1998"
)
register(Effect(
    "coulomb_friction", BOTH, _coulomb,
    {
        "viscous_friction": "steady speeds at several heights: dry friction stays, viscous friction grows with speed",
        "stribeck_friction": "steady speeds from creeping upwards: Coulomb friction stays, a Stribeck fall does not",
        "asymmetric_friction": "the same steady speeds both ways: Coulomb friction is the same either way",
        "presliding_friction": "small reversals from rest, below what breaks it away: a bristle gives and springs "
        "back, dry friction holds",
        "position_dependent_friction": "slow motion both ways over the whole range: Coulomb friction is the same all "
        "over",
        "load_dependent_friction": "the same slow move with two payloads: Coulomb friction stays as it is",
        "constant_torque": "the same slow move both ways: dry friction turns with the direction, a bias does not",
    },
    MODELS, smoothness=JUMPS,
))  # fmt: skip
register(Effect(
    "viscous_friction", BOTH, _viscous,
    {
        "stribeck_friction": "steady speeds from creeping to the top: a Stribeck fall is over early, viscous friction "
        "grows all the way",
        "quadratic_drag": "steady speeds up to the top: one grows with the speed, the other with its square",
        "joint_flexibility": "long steady speeds: viscous friction brakes, the damping of a spring acts only while its "
        "twist changes",
    },
    MODELS,
))  # fmt: skip
register(Effect(
    "stribeck_friction", BOTH, _stribeck,
    {
        "presliding_friction": "creeping at steady speeds, then small reversals from rest: the one shows a Stribeck "
        "fall, the other a bristle",
        "quadratic_drag": "steady speeds from creeping to the top: the slow end bends by a Stribeck fall, the fast by "
        "drag",
        "kinematic_error": "creeping at steady speeds over several turns: Stribeck friction goes with the speed alone, "
        "an error of the gear repeats with the rotor's angle",
    },
    "L. C. Bo, D. Pavelescu, The friction-speed relation and its influence on the critical velocity of stick-slip "
    "motion, Wear 82(3), 1982",
    smoothness=JUMPS,
))  # fmt: skip
ALL_OVER = "slow motion both ways over the whole range: uneven friction is the same all over, the load is not"
register(Effect(
    "asymmetric_friction", BOTH, _asymmetric,
    {
        "constant_torque": "steady speeds both ways at several heights, cold and warm: friction changes, a bias stays "
        "(an uneven dry level that never changes is the same law as a bias on its side of the gear)",
        "gravity_load": ALL_OVER,
        "spring_load": ALL_OVER,
        "quadratic_drag": "the same steady speeds both ways up to the top: drag is the same both ways",
        "load_dependent_friction": "the same moves both ways with two payloads: uneven friction keeps to the "
        "direction, the other grows with the load",
    },
    "B. Armstrong-Helouvry, P. Dupont, C. Canudas de Wit, A survey of models, analysis tools and compensation methods "
    "for the control of machines with friction, Automatica 30(7), 1994",
    smoothness=JUMPS,
))  # fmt: skip
register(Effect(
    "presliding_friction", BOTH, _presliding,
    {
        "backlash": "small reversals from rest of growing size: a bristle resists at once and springs back, play does "
        "neither",
        "joint_flexibility": "the same sweep from small amplitudes to large ones: a bristle gives way at breakaway, "
        "the spring of a gear stays",
    },
    "C. Canudas de Wit, H. Olsson, K. J. Astrom, P. Lischinsky, A new model for control of systems with friction, IEEE "
    "Trans. Automatic Control 40(3), 1995",
    kinds=("dahl", "maxwell_slip", "lugre"),
    smoothness="kinks at reversals",
))  # fmt: skip
register(Effect(
    "quadratic_drag", BOTH, _drag,
    {
        "kinematic_error": "steady high speeds over many turns: drag brakes evenly, an error of the gear ripples with "
        "the rotor's angle and takes nothing on average",
    },
    "J. E. Vrancik, Prediction of windage power loss in alternators, NASA TN D-4849, 1968",
    smoothness="smooth (its curvature jumps at rest)",
))  # fmt: skip
register(Effect(
    "load_dependent_friction", ("motor_friction",), _load_dependent,
    {"position_dependent_friction": "the same slow move with two payloads: friction over the angle stays as it is"},
    "A. C. Bittencourt, S. Gunnarsson, Static friction in a robot joint - modeling and identification of load and "
    "temperature effects, J. Dynamic Systems, Measurement, and Control 134(5), 2012",
    kinds=("load_dependent_friction", "effort_dependent_friction"),
    splits=("load_dependent_friction",),
    smoothness=JUMPS,
))  # fmt: skip
LOADED = (
    "slow motion both ways over the whole range: friction turns with the direction, a load torque does not"
)
register(Effect(
    "position_dependent_friction", BOTH, _position,
    {
        "gravity_load": LOADED,
        "spring_load": LOADED,
        "kinematic_error": "slow motion both ways over several turns: friction turns with the direction, an error of "
        "the gear does not",
    },
    "M. R. Popovic, A. A. Goldenberg, Modeling of friction using spectral analysis, IEEE Trans. Robotics and "
    "Automation 14(1), 1998",
    kinds=("position_dependent_friction", "tight_spot"),
    contains=("coulomb_friction",),
    scan=_over_angle,
    smoothness=JUMPS,
))  # fmt: skip
