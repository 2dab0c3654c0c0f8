"""Effects between the logged command and the motor."""

from hybrid_id.diagnosis.catalogue import Effect, free, has, part_of, register

SOFTEST_LIMIT = 3.0
"""Least exponent of a soft limit: at half of it 4 % of the command are lost. What bends more is no supply's limit."""
SOFTEST = 0.3
"""Largest resistance of a supply over that of the winding: a stalled motor at full duty lets it fall by a quarter."""


def _delay(system, s, place):
    if has(system, f"joint{s.joint}/input", "delay", "late_reading"):
        return []
    # a long history costs time, and few drives need one
    longest = min(0.06, 15.0 * s.sample_time)
    late = [
        ("delay", {"T_d": free(start * s.sample_time, 0.0, most, "s")})
        for start, most in ((0.5, longest), (3.0, longest), (25.0, 5.0 * longest))
    ]
    if len(system.joints) > 1:  # of a single joint it is the same
        read = free(3.0 * s.sample_time, 0.3 * s.sample_time, longest, "s")
        late.append(("late_reading", {"T_r": read}))
    return late


def _deadband(system, s, place):
    if has(system, f"joint{s.joint}/input", "voltage_deadband"):
        return []
    return [
        (
            "voltage_deadband",
            {"V_0": free(share * s.command_rms, 0.0, s.command_rms, "V"), "jump": free(jump, 0.0, 1.0),
             "width": max(0.002 * s.command_rms, 1e-6)},
        )
        for share in (0.05, 0.2) for jump in (0.05, 0.95)
    ]  # fmt: skip


def _saturation(system, s, place):
    # the duty that an amplifier has applied, beside the supply, has its limits in it
    if has(system, f"joint{s.joint}/input", "voltage_saturation", "soft_saturation", "duty_supply"):
        return []
    low, high = 0.2 * s.command, s.command
    hard = [("voltage_saturation", {"V_max": free(x * high, low, high, "V")}) for x in (0.95, 0.75, 0.55)]
    soft = [
        (
            "soft_saturation",
            {"V_max": free(x * high, low, 2.0 * high, "V"), "n": free(6.0, SOFTEST_LIMIT, 30.0)},
        )
        for x in (0.95, 0.65)
    ]
    return [*hard, *soft]


def _sag(system, s, place):
    joint = f"joint{s.joint}"
    motor = part_of(system, f"{joint}/motor", "dc_motor")
    # where the supply is logged, its sag is known
    if (
        motor is None
        or not has(system, f"{joint}/input", "voltage")
        or has(system, f"{joint}/input", "supply_sag")
    ):
        return []
    return [
        ("supply_sag", {"rho": free(0.1, 0.0, SOFTEST), "V_0": s.command, "k_e": motor.specs["P_m2"].value})
    ]


THRESHOLD = "slow ramps from rest at many angles: the threshold of a dead band is the same at all of them"
register(Effect(
    "delay", ("input",), _delay,
    {
        "electrical_lag": "a fast sweep: a delay turns the phase on and on and weakens nothing, a lag turns it by a "
        "quarter at most and weakens the response",
        "joint_flexibility": "a slow sweep through the resonance: a spring raises the response there and weakens it "
        "above, a delay only turns its phase",
        "voltage_deadband": "the same sweep at two amplitudes: a dead band counts for less the larger the command, a "
        "delay stays",
        "backlash": "the same sweep at two amplitudes: play counts for less the larger the move, a delay stays",
    },
    "K. J. Astrom, B. Wittenmark, Computer-Controlled Systems, 3rd ed., Prentice Hall, 1997",
    kinds=("delay", "late_reading"),
))  # fmt: skip
register(Effect(
    "voltage_deadband", ("input",), _deadband,
    {
        "coulomb_friction": "coasting, and braking by commands against the motion: friction helps to brake, a dead "
        "band takes from it",
        "stribeck_friction": "steady speeds from creeping upwards: a dead band costs the same voltage at each, what "
        "Stribeck friction adds falls off",
        "presliding_friction": "small steps from rest, below what breaks it away: a bristle gives way a little and "
        "springs back, in a dead band nothing moves",
        "position_dependent_friction": THRESHOLD,
        "cogging": THRESHOLD,
        "constant_torque": "the same small commands of either sign from rest: a dead band takes alike from both, a "
        "bias helps one and hinders the other",
        "backlash": "reversals with a weight or a spring that holds the teeth on one side: play is gone, a dead band "
        "is not",
    },
    "S.-G. Jeong, M.-H. Park, The analysis and compensation of dead-time effects in PWM inverters, IEEE Trans. "
    "Industrial Electronics 38(2), 1991",
    smoothness="kinks or jumps at the threshold",
))  # fmt: skip
register(Effect(
    "supply_sag", ("input",), _sag,
    {
        "voltage_saturation": "steps of growing height from standstill up to speed: a supply sags with the current and "
        "recovers as the motor gathers speed, a limit cuts alike at every speed",
        "thermal_derating": "the same full step cold and after minutes of heavy work: a sag comes and goes with the "
        "current, heat stays",
        "quadratic_drag": "full steps from standstill, then coasting: a sag is deepest at standstill, drag acts at "
        "speed, without current too",
        "load_dependent_friction": "a payload lifted and lowered slowly, with the supply's voltage on record: friction "
        "opposes both, a sag takes from the lifting only",
    },
    "R. W. Erickson, D. Maksimovic, Fundamentals of Power Electronics, 2nd ed., Kluwer, 2001",
))  # fmt: skip
register(Effect(
    "voltage_saturation", ("input",), _saturation,
    {
        "quadratic_drag": "steps of growing height from standstill: a limit shows in the first acceleration, drag at "
        "speed only",
        "thermal_derating": "the same full step cold and after minutes of heavy work: a limit cuts alike, heat takes "
        "more by then",
        "load_dependent_friction": "a heavy payload moved by commands well below the limit: friction under load still "
        "shows",
        "stribeck_friction": "steady slow speeds at small commands: Stribeck friction acts there, a limit does not",
        "kinematic_error": "slow turns at small commands, with an encoder on the link: an error of the gear repeats "
        "with the rotor's angle, a limit does not act",
    },
    "H. K. Khalil, Nonlinear Systems, 3rd ed., Prentice Hall, 2002, section 1.2.7",
    kinds=("voltage_saturation", "soft_saturation"),
    smoothness="kinks at the limit, or bends before it",
))  # fmt: skip
