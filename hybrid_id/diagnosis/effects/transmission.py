"""Effects in the gear."""

import math

from hybrid_id.diagnosis.catalogue import Effect, free, has, part_of, register
from hybrid_id.diagnosis.periodic import gear_waves, second_wave

RESONANCES = (2.0, 4.0, 8.0, 16.0, 32.0)
"""Where rotor and link may swing against each other [Hz]: a fit finds what is half an octave away."""
SOFTEST = 10.0
"""Largest compliance, over that of the slowest swing: how the inertia divides between rotor and link is not known."""
GAPS = (0.0007, 0.0015, 0.003, 0.006, 0.012, 0.025, 0.05, 0.1)
"""Play as a share of the link's range: every size has a valley of its own."""
WORST_GEAR = 0.03
"""Largest error of a gear [rad at the link]: harmonic drives have 1e-3 and less, the moulded gears of toys 0.02."""
WAVES = 6
"""Periods of a gear's error that fits begin with."""


def _series(s):
    """Rotor and link in series, at the link [kg m^2]."""
    whole, share = s.inertia * s.ratio**2, s.rotor / s.inertia
    return share * (1.0 - share) * whole


def _flexibility(system, s, place):
    if not system.joints[s.joint - 1].rigid:
        return []
    series = max(_series(s), 1e-12)
    compliances = [1.0 / (series * (2 * math.pi * f) ** 2) for f in RESONANCES]
    soft = SOFTEST * max(compliances)
    return [
        ("joint_flexibility", {"compliance": free(c, 0.0, soft, "rad/(N m)"), "zeta": free(0.1, 0.0, 2.0)})
        for c in compliances
    ]


def _backlash(system, s, place):
    where = f"joint{s.joint}/transmission"
    # play has a compliance of its own, and would take the place of one that another effect has brought
    if has(system, where, "backlash", "backlash_flexibility", "hardening_flexibility", "joint_flexibility"):
        return []
    gaps = [free(share * s.angle, 0.0, 0.3 * s.angle, "rad") for share in GAPS]
    spring = part_of(system, where, "linear_spring")
    if spring is None:
        return [("backlash", {"gap": gap}) for gap in gaps]
    k, d = spring.specs["k"].value, spring.specs["d"].value
    zeta = d / (2.0 * math.sqrt(k * max(_series(s), 1e-12)))
    contact = {"compliance": free(1 / k, 0.0, 30 / k, "rad/(N m)"), "zeta": free(zeta, 0.0, 2.0)}
    return [("backlash", {"gap": gap, **contact}) for gap in gaps]


def _hardening(system, s, place):
    spring = part_of(system, f"joint{s.joint}/transmission", "linear_spring")
    if spring is None:
        return []
    twist = s.torque * s.ratio / spring.specs["k"].value
    return [
        (
            "hardening_flexibility",
            {"k": spring.specs["k"], "d": spring.specs["d"], "h": free(h / twist**2, 0.0, 9e4)},
        )
        for h in (0.1, 1.0)
    ]


def _kinematic(system, s, place, found=()):
    if has(system, f"joint{s.joint}/transmission", "kinematic_error"):
        return []
    small = 0.02 * min(0.01 * s.angle, 0.5 / s.ratio)
    limit, near = min(0.1 * s.angle, 0.9 / s.ratio, WORST_GEAR), math.pi / s.turns
    return [
        (
            "kinematic_error",
            {
                "E_c": free(c, -limit, limit, "rad"),
                "E_s": free(d, -limit, limit, "rad"),
                "n": free(n, n - near, n + near),
            },
        )
        # a linear estimate from whole runs tells little of the period, and the fits from all of them soon tell it
        for n, c, d in (*((n, small, small) for n in (1.0, 2.0)), *found[:WAVES])
    ]


HARMONIC = (
    "T. D. Tuttle, W. P. Seering, A nonlinear model of a harmonic drive gear transmission, IEEE Trans. Robotics and "
    "Automation 12(3), 1996"
)
UNLOADED = (
    "slow turns without load and with it, with an encoder on the link: an error of the gear repeats with the rotor's "
    "angle, a spring's twist goes with the load"
)
register(Effect(
    "backlash", ("transmission",), _backlash,
    {
        "joint_flexibility": "slow reversals under little load and much, with an encoder on the link: play is as wide "
        "under any load, a spring's twist grows with it",
        "hardening_flexibility": "loads from one side to the other, with an encoder on the link: play gives way "
        "without torque, a spring never does",
        "kinematic_error": "slow turns both ways, with an encoder on the link: play shifts with the direction, an "
        "error of the gear does not",
    },
    "M. Nordin, P.-O. Gutman, Controlling mechanical systems with backlash - a survey, Automatica 38(10), 2002",
    splits=("backlash",),
    smoothness="kinks where the teeth touch",
))  # fmt: skip
register(Effect(
    "joint_flexibility", ("transmission",), _flexibility,
    {
        "hardening_flexibility": "the same sweep at several amplitudes: a hardening spring moves its resonance",
        "kinematic_error": UNLOADED,
        "spring_load": "slow motion over the whole range: a spring at the load pulls the harder the further, that of a "
        "gear does not",
    },
    "M. W. Spong, Modeling and control of elastic joint robots, J. Dynamic Systems, Measurement, and Control 109(4), "
    "1987",
    splits=("joint_flexibility",),
))  # fmt: skip
register(Effect(
    "hardening_flexibility", ("transmission",), _hardening, {"kinematic_error": UNLOADED}, HARMONIC,
))  # fmt: skip
register(Effect(
    "kinematic_error", ("transmission",), _kinematic, {}, HARMONIC,
    splits=("kinematic_error",),
    scan=gear_waves,
    shape={"n": "E_c", "n_2": "E_c2"},
    further=second_wave(gear_waves, ("E_c2", "E_s2"), 1.5),
))  # fmt: skip
