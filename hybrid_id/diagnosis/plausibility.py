"""What a re-fit's parameters are worth: moved beyond what data sheets get wrong, or not identified by the records."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from hybrid_id.components.input.position_servo import PositionServo
from hybrid_id.parameters import Bounded, ParameterInfo
from hybrid_id.records.dataset import Dataset
from hybrid_id.statistics.identifiability import Identifiability
from hybrid_id.study.checks import check_identifiability
from hybrid_id.systems.chain import System

TOLERANCE, TORQUE_TOLERANCE = math.log(1.4), math.log(1.7)
"""Change of a parameter, as a logarithm, that data sheets hardly allow; the same of a torque, whose common scale is
known no better than the median of the torques."""
UNLIKELY = 3.0
"""Standard deviations of a parameter's prior, where it has one, that are as much."""
TO_ZERO = -3.0
"""Logarithm of a change that leaves nothing of a parameter."""
LATE = 0.008
"""Shift of a goal in time [s] from which it is said: less is within a cycle of a position loop of 125 Hz."""
REACH = 10.0
"""Ratio of what turns a command into torque to its nominal value, and the inverse, within which a search stays."""
NUISANCE = 0.3
"""Share of its value by which a parameter without a prior may well be off."""


def implausible_parameters(
    nominal: System, fitted: System, identifiability: Identifiability | None = None
) -> list[str]:
    """Parameters moved beyond data-sheet tolerance, or beyond their prior where they have one, each in words.

    Where a change that the records do not see (``identifiability``, of the nominal model) has moved a parameter as
    far, with no other moved further than it may be, this is said beside it. Torques, inertias and frictions may all be
    multiplied by one number where no torque is known: the median of their changes is taken for it.
    """
    words, change, power = [], {}, {}
    now = {(info.component, info.symbol): info.spec.value for info in fitted.table}
    for info in nominal.table:
        before, after = info.spec, now.get((info.component, info.symbol))
        if not before.estimate or after is None:  # an effect may have taken the component's place
            continue
        if before.prior_std is not None and before.prior_mean is not None:
            off = (after - before.prior_mean) / before.prior_std
            if abs(off) > UNLIKELY:
                way = "high" if off > 0 else "low"
                words.append(f"{named(info)} is {abs(off):.1f} standard deviations of its prior too {way}")
        elif before.value > 0.0 > after:
            words.append(f"{named(info)} has changed its sign")
        elif before.value > 0.0:
            change[info.name] = math.log(max(after, 1e-12 * before.value) / before.value)
            power[info.name] = torque_power(before.unit)
    scaled = sorted(change[name] / power[name] for name in change if power[name])
    common = scaled[len(scaled) // 2] if scaled and not _torque_is_known(nominal, identifiability) else 0.0
    for name, moved in change.items():
        own, who = moved - power[name] * common, named(nominal.parameter(name))
        if own < TO_ZERO:
            words.append(f"{who} is driven to zero{_unseen(nominal, name, -1.0, identifiability)}")
        elif abs(own) > (TORQUE_TOLERANCE if power[name] else TOLERANCE):
            excuse = _unseen(nominal, name, math.expm1(own), identifiability)
            late = as_late(fitted, nominal.parameter(name), own)
            words.append(f"{who} is {math.exp(own):.2f} times its nominal value{late}{excuse}")
    return words


def within_reach(system: System) -> System:
    """The model, whose command makes no torque that is far from the nominal one's, whatever a fit asks for.

    Where no torque is known, stiffness of a loop, friction and inertia may all be multiplied by one number: a large one
    makes links weightless, and hides whatever else there is.
    """

    def limited(info: ParameterInfo) -> bool:
        spec, place = info.spec, info.component.split("/")[1]
        gain = place in ("input", "motor") and "/" in spec.unit and torque_power(spec.unit) > 0
        return gain and spec.estimate and spec.prior_std is None and spec.value > 0.0

    return system.with_specs(
        {
            info.name: replace(
                info.spec,
                lower=max(info.spec.lower, info.spec.value / REACH),
                upper=min(info.spec.upper, info.spec.value * REACH),
            )
            for info in system.table
            if limited(info)
        }
    )


def named(info: ParameterInfo) -> str:
    """A parameter's name and symbol, such as ``Coulomb level F_c``."""
    return f"{info.doc} {info.name}"


def joint_of(info: ParameterInfo) -> int:
    """Number of the joint that a parameter belongs to."""
    return int(info.component.split("/")[0].removeprefix("joint"))


def as_late(system: System, info: ParameterInfo, own: float) -> str:
    """What looks like other viscous friction in a position loop: at a steady speed w the goal leads by F_v w / k_p.

    Args:
        system: whose loop it is.
        info: the parameter, with its nominal value.
        own: logarithm of its change.
    """
    joint = system.joint(joint_of(info))
    loop, viscous = joint.drive.input[1], info.spec.unit == "N m s/rad"
    if not (isinstance(loop, PositionServo) and "_friction/" in info.component and viscous):
        return ""
    geared = joint.gear_ratio**2 if "/motor_friction/" in info.component else 1.0
    late = geared * info.spec.value * math.expm1(own) / loop.specs["k_p"].value
    if abs(late) < LATE:
        return ""
    way = "later" if late > 0.0 else "earlier"
    return f" (a goal that acts {1e3 * abs(late):.0f} ms {way} looks alike in slow motion)"


def torque_power(unit: str) -> int:
    """Power of torque in a unit: 1 of ``N m s/rad`` or ``kg m^2``, -1 of ``rad/(N m)``, -2 of ``1/(N m)^2``."""
    over, _, under = unit.partition("/")
    if "N" in under:
        return -2 if ")^2" in under else -1
    return int("N" in over or "kg" in over)


def _torque_is_known(system: System, identifiability: Identifiability | None) -> bool:
    """Whether a torque is known from elsewhere than the motion, or the records identify the torques' scale."""
    torques = [info for info in system.table if torque_power(info.spec.unit) and info.spec.value != 0.0]
    if any(not info.spec.estimate or info.spec.prior_std is not None for info in torques):
        return True
    if any("tau" in joint.channels for joint in system.joints):
        return True
    if identifiability is None:
        return False
    powers = {info.name: torque_power(info.spec.unit) for info in torques}
    scale = np.array([powers.get(name, 0) for name in identifiability.names], float)
    directions = np.array([one.relative for one in identifiability.directions]).reshape(-1, scale.size)
    left = scale - directions.T @ np.linalg.lstsq(directions.T, scale, rcond=None)[0]
    return bool(np.linalg.norm(left) > 0.1 * np.linalg.norm(scale))


def _unseen(nominal: System, name: str, moved: float, identifiability: Identifiability | None) -> str:
    """What else may have moved a parameter by a share of its value, unseen by the records; empty where nothing may."""
    if identifiability is None or name not in identifiability.names:
        return ""
    for one in identifiability.directions:
        change = dict(zip(identifiability.names, one.relative, strict=True))
        if abs(change[name]) < 1e-3:
            continue
        others = {
            other: share * moved / change[name]
            for other, share in change.items()
            if other != name and abs(share) > 1e-3 * abs(change[name])
        }
        if others and all(abs(share) < _allowed(nominal.parameter(k).spec) for k, share in others.items()):
            words = " and ".join(
                f"{named(nominal.parameter(k))} off by {100 * share:+.2g} %" for k, share in others.items()
            )
            return f" (unseen by these records: {words} would move it as far)"
    return ""


def _allowed(spec: Bounded) -> float:
    """Share of its value by which a parameter may well be off."""
    if spec.prior_std is None:
        return NUISANCE
    return min(UNLIKELY * spec.prior_std / max(abs(spec.value), 1e-300), NUISANCE)


def not_identifiable(dataset: Dataset, system: System) -> tuple[str, ...]:
    """Changes of a fitted model's parameters that its records do not see.

    A weight or an inertia that is held at its claimed value lends its scale to all torques: it is freed here, so that a
    wrong claim is not taken for knowledge.

    Args:
        dataset: its train records tell.
        system: the fitted model.
    """
    words = [one.text for one in check_identifiability(dataset, system).directions]
    held = [
        i
        for i in system.table
        if not i.spec.estimate and i.spec.value > 0 and ("N" in i.spec.unit or "kg" in i.spec.unit)
    ]
    if held:
        freed = system.with_specs({i.name: replace(i.spec, estimate=True) for i in held})
        for one in check_identifiability(dataset, freed).directions:
            claims = [
                f"{i.name} at {i.spec.value:.4g} {i.unit}"
                for i in held
                if i.name in one.text.replace(",", " ").split()
            ]
            if claims:
                words.append(f"{one.text}; only the claim of {' and '.join(claims)} sets it")
    return tuple(words)
