"""Effects at the link."""

import math

from hybrid_id.diagnosis.catalogue import Effect, free, has, part_of, register


def _weight(system, s, place):
    """A weight anywhere on the link, or a plane tilted in any direction: the hanging angle is free."""
    kind = "gravity_load" if len(system.joints) == 1 else "arm_gravity"
    if s.joint > 1:  # a weight on either link shows at both joints
        return []
    here = part_of(system, f"joint{s.joint}/load", kind)
    if here is not None and here.specs["q_0"].estimate:
        return []
    if here is not None:
        return [(kind, {**here.specs, "q_0": _hanging(here.specs["q_0"].value + a)}) for a in (0.3, -0.3)]
    torque = s.torque * s.ratio
    first, second = (free(share * torque, -3.0 * torque, 3.0 * torque, "N m") for share in (0.05, 0.02))
    size = {"G_l": first} if kind == "gravity_load" else {"G_l1": first, "G_l2": second}
    return [(kind, {**size, "q_0": _hanging(0.5 * math.pi * quarter)}) for quarter in range(4)]


def _hanging(angle):
    return free(angle, angle - 2.0 * math.pi, angle + 2.0 * math.pi, "rad")


def _spring(system, s, place):
    if has(system, f"joint{s.joint}/load", "spring_load"):
        return []
    size = 0.05 * s.torque * s.ratio / s.angle
    reach = 3.0 * s.angle
    rest = free(s.middle, s.middle - reach, s.middle + reach, "rad")
    return [("spring_load", {"k_s": free(size, 0.0, 200.0 * size, "N m/rad"), "q_s": rest})]


def _constant(system, s, place):
    if has(system, f"joint{s.joint}/load", "constant_torque", "rotor_bias"):
        return []
    at_link = s.torque * s.ratio
    found = [("constant_torque", {"T_0": free(0.0, -3.0 * at_link, 3.0 * at_link, "N m")})]
    if not system.joints[s.joint - 1].rigid:  # a gear that gives way parts it from an amplifier's offset
        found.append(("rotor_bias", {"T_0": free(0.0, -3.0 * s.torque, 3.0 * s.torque, "N m")}))
    return found


def _coupling(system, s, place):
    law = next((part for key, part in system.components.items() if key.endswith("joint_coupling")), None)
    if len(system.joints) < 2 or s.joint != 1:
        return []
    if law is not None and any(spec.estimate for spec in law.specs.values()):  # type: ignore[union-attr]
        return []
    second = system.joints[1]
    key, inertia = second.inertia
    view = system.components[key].view()  # type: ignore[operator]
    size = float(inertia.total(view, second.gear_ratio).detach()) * second.gear_ratio**2
    return [
        (
            "joint_coupling",
            {"P_3": free(0.2 * size, 0.0, 3 * size, "kg m^2"), "P_4": free(0.3 * size, 0.0, size, "kg m^2")},
        )
    ]


ALL_OVER = (
    "slow motion both ways over the whole range: a bias is the same all over, a weight or a spring is not"
)
ROBOTS = "W. Khalil, E. Dombre, Modeling, Identification and Control of Robots, Hermes Penton, 2002"
register(Effect(
    "gravity_load", ("load",), _weight,
    {
        "spring_load": "slow motion both ways over a quarter turn and more: the pull of a spring grows evenly, that of "
        "a weight bends over",
        "constant_torque": ALL_OVER,
        "joint_coupling": "each joint moved alone, slowly and fast: a weight acts at rest, a coupling with "
        "acceleration",
    },
    ROBOTS,
    kinds=("gravity_load", "arm_gravity"),
))  # fmt: skip
register(Effect(
    "spring_load", ("load",), _spring, {"constant_torque": ALL_OVER},
    "R. Hooke, Lectures de Potentia Restitutiva, or of Spring, London, 1678",
))  # fmt: skip
register(Effect(
    "constant_torque", ("load",), _constant, {},
    "A. Janot, P.-O. Vandanjon, M. Gautier, A generic instrumental variable approach for industrial robot "
    "identification, IEEE Trans. Control Systems Technology 22(1), 2014",
    kinds=("constant_torque", "rotor_bias"),
))  # fmt: skip
register(Effect("joint_coupling", ("load",), _coupling, {}, ROBOTS))
