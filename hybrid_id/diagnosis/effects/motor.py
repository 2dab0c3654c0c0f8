"""Effects in the motor."""

import math

from hybrid_id.diagnosis.catalogue import Effect, free, has, register
from hybrid_id.diagnosis.periodic import rotor_waves, second_wave

FASTEST = 1.0
"""Least time constant [s] with which the winding of a small motor warms, by data sheets."""
FIRST_SHARES = (1.0, 0.3)
"""Of the cogging that a linear estimate asks for: beside so much, the rotor may stop elsewhere than it did."""


def _lag(system, s, place):
    if has(system, f"joint{s.joint}/motor", "electrical_lag"):
        return []
    low, high = 0.25 * s.sample_time, 0.1
    return [("electrical_lag", {"T_e": free(start * s.sample_time, low, high, "s")}) for start in (1.0, 5.0)]


def _cogging(system, s, place, waves=((1.0, 1e-6, 0.0),)):
    if has(system, f"joint{s.joint}/motor", "cogging"):
        return []
    limit, near = 3.0 * s.torque, math.pi / s.turns
    return [
        (
            "cogging",
            {
                "T_c": free(share * c, -limit, limit, "N m"),
                "T_s": free(share * d, -limit, limit, "N m"),
                "n": free(n, n - near, n + near),
            },
        )
        for n, c, d in waves[:2]
        for share in FIRST_SHARES
    ]


def _thermal(system, s, place):
    if has(system, f"joint{s.joint}/motor", "thermal_derating"):
        return []
    return [
        (
            "thermal_derating",
            {"T_w": free(max(share * s.duration, FASTEST), FASTEST, max(30.0 * s.duration, 9.0 * FASTEST), "s"),
             "c": free(0.1 / s.torque**2, 0.0, 30.0 / s.torque**2, "1/(N m)^2")},
        )
        for share in (0.3, 3.0)
    ]  # fmt: skip


register(Effect(
    "electrical_lag", ("motor",), _lag,
    {
        "joint_flexibility": "a sweep through the resonance with two payloads: a resonance moves with the inertia, the "
        "winding's lag stays",
    },
    "W. Leonhard, Control of Electrical Drives, 3rd ed., Springer, 2001, chapter 5",
))  # fmt: skip
register(Effect(
    "cogging", ("motor",), _cogging,
    {
        "position_dependent_friction": "slow motion both ways over several turns: cogging pushes alike in both "
        "directions, friction opposes both",
        "kinematic_error": "slow and fast motion over the same turns: cogging keeps its torque, that of a gear's error "
        "grows with the square of the speed",
        "coulomb_friction": "released at many angles: cogging pulls the rotor into the next detent, dry friction lets "
        "it rest anywhere",
        "stribeck_friction": "creeping over several turns of the rotor: cogging ripples over the angle, Stribeck "
        "friction goes with the speed alone",
        "presliding_friction": "small reversals at many angles: detents stay where they are, a bristle springs about "
        "any angle",
    },
    "T. M. Jahns, W. L. Soong, Pulsating torque minimization techniques for permanent magnet AC motor drives - a "
    "review, IEEE Trans. Industrial Electronics 43(2), 1996",
    scan=rotor_waves,
    shape={"n": "T_c", "n_2": "T_c2"},
    further=second_wave(rotor_waves, ("T_c2", "T_s2"), 1.5),
))  # fmt: skip
register(Effect(
    "thermal_derating", ("motor",), _thermal,
    {
        "quadratic_drag": "the same fast move cold and after minutes of heavy work: drag is there at once and stays, "
        "heat builds up",
        "load_dependent_friction": "the same payload moved cold and after minutes of heavy work: friction under load "
        "is there at once, heat builds up",
        "kinematic_error": "the same slow turns cold and after minutes of heavy work: an error of the gear repeats "
        "with the rotor's angle, heat knows no angle",
    },
    "W. Leonhard, Control of Electrical Drives, 3rd ed., Springer, 2001, chapter 4",
))  # fmt: skip
