"""The arms that the package knows by name, as chains of components."""

from __future__ import annotations

from hybrid_id.components import (
    ArmGravity,
    AsymmetricStribeck,
    Coulomb,
    DCMotor,
    Gravity,
    JointCoupling,
    LinearSpring,
    LinkInertia,
    OneLink,
    Rigid,
    TwoInertias,
    Viscous,
    Voltage,
)
from hybrid_id.components.base import Component
from hybrid_id.systems.chain import System


def one_link(gear_ratio: float = 1.0, *, friction: Component | None = None, vertical: bool = False) -> System:
    """One rigid link: ``J a = P_m1 (u - P_m2 v) - F_c sgn v - F_v v - (G_l / r) sin(q / r)``, motor side.

    Args:
        gear_ratio: motor turns per joint turn.
        friction: law in place of Coulomb and viscous friction (for example ``AsymmetricStribeck()``).
        vertical: whether gravity acts (``G_l``), q = 0 hanging down.
    """
    where = "joint1/motor_friction"
    frictions = [(where, friction)] if friction else [(where, Coulomb()), (where, Viscous())]
    parts: list[tuple[str, Component]] = [
        ("joint1/input", Voltage()),
        ("joint1/motor", DCMotor()),
        *frictions,
        ("joint1/transmission", Rigid()),
        ("joint1/load", OneLink()),
    ]
    if vertical:
        parts.append(("joint1/load", Gravity()))
    return System([gear_ratio], parts, name="one_link")


def one_link_flexible(
    gear_ratio: float = 1.0, *, friction: Component | None = None, vertical: bool = False
) -> System:
    """One link behind a linear spring: rotor ``J_m, F_cm, F_vm``, link ``J_a, F_va``, spring ``k, d``.

    Args:
        gear_ratio: motor turns per joint turn.
        friction: motor-side law in place of Coulomb and viscous friction.
        vertical: whether gravity acts (``G_l``), q = 0 hanging down.
    """
    motor, link = "joint1/motor_friction", "joint1/link_friction"
    frictions = [(motor, friction)] if friction else [(motor, Coulomb()), (motor, Viscous())]
    parts: list[tuple[str, Component]] = [
        ("joint1/input", Voltage()),
        ("joint1/motor", DCMotor()),
        *frictions,
        ("joint1/transmission", LinearSpring()),
        (link, Viscous()),
        ("joint1/load", TwoInertias()),
    ]
    if vertical:
        parts.append(("joint1/load", Gravity()))
    return System([gear_ratio], parts, FLAT_NAMES["one_link_flexible"], name="one_link_flexible")


def two_link(gear_ratio: tuple[float, float] = (1.0, 1.0), *, vertical: bool = False) -> System:
    """Planar arm of two links behind rigid gears, paper eq. (13)-(14), its angles on the motors' side.

    ``M(q) a + c(q, v) = r (tau_m - F_c sgn v_m - F_v v_m)`` at the links, ``q_m = r q``, q_2 relative to link 1; M and
    c are those of :class:`~hybrid_id.components.JointCoupling` with the P of the two joints.

    Args:
        gear_ratio: motor turns per joint turn of both joints.
        vertical: whether gravity acts (``G_l1``, ``G_l2``), stretched and hanging down at q = 0.
    """
    parts: list[tuple[str, Component]] = []
    for joint, inertia in (("joint1", 1.0), ("joint2", 0.15)):
        parts += [
            (f"{joint}/input", Voltage()),
            (f"{joint}/motor", DCMotor()),
            (f"{joint}/motor_friction", Coulomb()),
            (f"{joint}/motor_friction", Viscous()),
            (f"{joint}/transmission", Rigid()),
            (f"{joint}/load", LinkInertia(P=inertia)),
        ]
    parts.append(("joint1/load", JointCoupling(P_3=0.15, P_4=0.07)))
    if vertical:
        parts.append(("joint1/load", ArmGravity(G_l1=10.0, G_l2=3.0)))
    return System(gear_ratio, parts, FLAT_NAMES["two_link"], name="two_link")


FLAT_NAMES: dict[str, dict[tuple[str, str], str]] = {
    "one_link": {},
    "one_link_flexible": {
        ("joint1/motor_friction/coulomb_friction", "F_c"): "F_cm",
        ("joint1/motor_friction/viscous_friction", "F_v"): "F_vm",
        ("joint1/link_friction/viscous_friction", "F_v"): "F_va",
        ("joint1/link_friction/coulomb_friction", "F_c"): "F_ca",
    },
    "two_link": {
        (f"joint{n}/{place}", symbol): f"{name}{n}"
        for n in (1, 2)
        for place, symbol, name in (
            ("load/link_inertia", "P", "P_"),
            ("load/link_inertia", "rotor_share", "rotor_share"),
            ("motor/dc_motor", "P_m1", "P_m1m"),
            ("motor/dc_motor", "P_m2", "P_m2m"),
            ("motor_friction/coulomb_friction", "F_c", "F_cm"),
            ("motor_friction/viscous_friction", "F_v", "F_vm"),
            ("link_friction/coulomb_friction", "F_c", "F_ca"),
            ("link_friction/viscous_friction", "F_v", "F_va"),
            *(
                ("motor_friction/asymmetric_stribeck", name, f"{name}m")
                for name in AsymmetricStribeck.declared
            ),
        )
    },
}
"""Result names where the bare symbol would be ambiguous: the flat names of the model file, and the paper's."""
