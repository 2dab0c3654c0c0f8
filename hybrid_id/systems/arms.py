"""The arms that the package knows by name, as chains of components."""

from __future__ import annotations

from hybrid_id.components import (
    Coulomb,
    DCMotor,
    Gravity,
    LinearSpring,
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


FLAT_NAMES: dict[str, dict[tuple[str, str], str]] = {
    "one_link": {},
    "one_link_flexible": {
        ("joint1/motor_friction/coulomb_friction", "F_c"): "F_cm",
        ("joint1/motor_friction/viscous_friction", "F_v"): "F_vm",
        ("joint1/link_friction/viscous_friction", "F_v"): "F_va",
        ("joint1/link_friction/coulomb_friction", "F_c"): "F_ca",
    },
}
"""Result names of base components where the bare symbol would be ambiguous: the flat names of the model file."""
