"""Values in the units that the user logged, and symbols with their names."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable

from hybrid_id.parameters import ParameterInfo
from hybrid_id.records.dataset import Channel
from hybrid_id.records.units import stem
from hybrid_id.reporting.style import unit as printed
from hybrid_id.systems.chain import System


def shown_unit(unit: str, outputs: Iterable[Channel]) -> tuple[str, float]:
    """Unit in which a parameter is shown, and its factor: an angle or a way at the joint has that of the logs."""
    places = (one.shown for one in outputs if stem(one.name) in ("q_a", "q_m") and one.unit == unit)
    return next(places, (unit, 1.0)) if unit in ("rad", "m") else (unit, 1.0)


def title(channel: str, outputs: Iterable[Channel]) -> str:
    """How an output is called on screen and pages: with the name of its joint where that is known."""
    return next((one.title for one in outputs if one.name == channel), channel)


def in_unit(
    channel: str, values: Iterable[float], outputs: Iterable[Channel], system: System
) -> tuple[str, ...]:
    """Values of a channel in the unit that was logged, and that unit; a motor's angle is seen at the joint.

    ``("0.71", "0.4", "deg at the joint")``.
    """
    unit, factor = next((one.shown for one in outputs if one.name == channel), ("", 1.0))
    ratio = geared(channel, system)
    where = f"{printed(unit)} at the joint" if ratio else printed(unit)
    return (*(f"{value * factor / (ratio or 1.0):.3g}" for value in values), where)


def geared(channel: str, system: System) -> float | None:
    """Gear ratio between a motor's angle or speed and its joint that turns; None where there is none."""
    kinds = ["hinge"] * len(system.joints)
    if system.tree is not None:
        kinds = [system.tree.joints[seat].kind for seat in system.arm.seats]
    for joint, ratio, kind in zip(system.joints, system.own_ratios, kinds, strict=True):
        if channel in (f"q_m{joint.number}", f"v_m{joint.number}") and kind == "hinge" and ratio != 1.0:
            return ratio
    return None


def symbols_line(infos: Iterable[ParameterInfo], words: str) -> list[str]:
    """Names of the parameters whose symbols stand in some words, as one line; none where there is none.

    What several joints have under their own names, ``k_p_elbow`` and ``k_p_wrist``, is named once, as ``k_p_...``.
    """
    used = set(re.findall(r"\w+", words))
    shown = [one for one in infos if one.name in used]
    alike = Counter((one.symbol, one.doc) for one in shown if one.name.startswith(f"{one.symbol}_"))
    names = {f"{one.symbol}_..." if alike[one.symbol, one.doc] > 1 else one.name: one.doc for one in shown}
    return [f"symbols: {'; '.join(f'{name} {doc}' for name, doc in names.items())}."] if names else []
