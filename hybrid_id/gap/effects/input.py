"""Effects between the logged command and the motor."""

from hybrid_id.gap.catalogue import Effect, free, has, part_of, register

SOFTEST_LIMIT = 3.0
"""Least exponent of a soft limit: at half of it 4 % of the command are lost. What bends more is no supply's limit."""
SOFTEST = 0.3
"""Largest resistance of a supply over that of the winding: a stalled motor at full duty lets it fall by a quarter."""


def _delay(system, s, place):
    if has(system, f"joint{s.joint}/input", "delay", "late_reading"):
        return []
    # a long history costs time, and few drives need one
    longest = min(0.03, 15.0 * s.sample_time)
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
    if has(system, f"joint{s.joint}/input", "voltage_saturation", "soft_saturation"):
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


register(Effect(
    "delay", ("input",), _delay, ("electrical_lag", "joint_flexibility"),
    "a fast sweep: a delay turns the phase in proportion to frequency, a lag bends and weakens the response too",
    kinds=("delay", "late_reading"),
))  # fmt: skip
register(Effect(
    "voltage_deadband", ("input",), _deadband, ("coulomb_friction", "stribeck_friction", "presliding_friction"),
    "small voltages around zero at speed, driven by the load or by coasting: a dead band acts on the command, friction "
    "on the motion",
    smoothness="kinks or jumps at the threshold",
))  # fmt: skip
register(Effect(
    "supply_sag", ("input",), _sag, ("voltage_saturation", "thermal_derating", "quadratic_drag"),
    "steps of growing height, each from standstill up to speed: a supply sags at high voltage with the current and "
    "recovers as the motor gathers speed; a limit cuts alike at every speed, heat stays, and drag grows with speed",
))  # fmt: skip
register(Effect(
    "voltage_saturation", ("input",), _saturation, ("quadratic_drag", "thermal_derating"),
    "steps of growing height: a supply's limit cuts every command above one level",
    kinds=("voltage_saturation", "soft_saturation"),
    smoothness="kinks at the limit, or bends before it",
))  # fmt: skip
