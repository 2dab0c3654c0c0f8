"""Effects at the link."""

from hybrid_id.gap.catalogue import Effect, free, has, register


def _weight(system, s, place):
    if has(system, f"joint{s.joint}/load", "gravity_load") or any(
        "arm_gravity" in key for key in system.components
    ):
        return []
    torque = s.torque * s.ratio
    size = free(0.05 * torque, -3.0 * torque, 3.0 * torque, "N m")
    if len(system.joints) == 1:
        return [("gravity_load", {"G_l": size})]
    first = s.joint == 1  # a weight on either link shows at both joints
    return (
        [("arm_gravity", {"G_l1": size, "G_l2": free(0.02 * torque, -3.0 * torque, 3.0 * torque, "N m")})]
        if first
        else []
    )


def _spring(system, s, place):
    if has(system, f"joint{s.joint}/load", "spring_load"):
        return []
    size = 0.05 * s.torque * s.ratio / s.angle
    reach = 3.0 * s.angle
    rest = free(s.middle, s.middle - reach, s.middle + reach, "rad")
    return [("spring_load", {"k_s": free(size, 0.0, 200.0 * size, "N m/rad"), "q_s": rest})]


def _constant(system, s, place):
    if has(system, f"joint{s.joint}/load", "constant_torque"):
        return []
    torque = s.torque * s.ratio
    return [("constant_torque", {"T_0": free(0.0, -3.0 * torque, 3.0 * torque, "N m")})]


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


register(Effect(
    "gravity_load", ("load",), _weight, ("spring_load", "constant_torque", "asymmetric_friction"),
    "holding at angles all over the range, more than a quarter turn apart",
    kinds=("gravity_load", "arm_gravity"),
))  # fmt: skip
register(Effect(
    "spring_load", ("load",), _spring, ("gravity_load", "constant_torque"),
    "holding at angles all over the range",
))  # fmt: skip
register(Effect(
    "constant_torque", ("load",), _constant, ("asymmetric_friction", "gravity_load"),
    "standstill and slow motion both ways: a bias torque acts at rest, too",
))  # fmt: skip
register(Effect(
    "joint_coupling", ("load",), _coupling, ("gravity_load",),
    "one joint accelerated while the other is free",
))  # fmt: skip
