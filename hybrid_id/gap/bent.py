"""Absorption: what a re-fit has bent to make up for what the model lacks."""

from __future__ import annotations

import math

from hybrid_id.systems.chain import System

BENT, BENT_TORQUE = math.log(1.4), math.log(1.7)
"""Change of a parameter against its nominal value that data sheets hardly allow; the same of a torque, whose common
scale is known no better than the others' median."""
UNLIKELY = 3.0
"""Standard deviations of a parameter's prior, where it has one, that are as much."""


def bent_parameters(nominal: System, fitted: System) -> list[str]:
    """Parameters that a re-fit has moved by more than their priors or, without one, data sheets are wrong, in words.

    Torques, inertias and frictions may all be multiplied by one number without a change of the motion; the median of
    their changes is taken for it, unless the command is a torque, or one of them is held or has a prior.
    """
    change, power, turned, words = {}, {}, set(), []
    now = {(info.component, info.symbol): info.spec.value for info in fitted.table}
    for info in nominal.table:
        value = now.get((info.component, info.symbol))  # none where an effect has taken the component's place
        if not info.spec.estimate or info.spec.value <= 0 or value is None:
            continue
        if info.spec.prior_std is not None and info.spec.prior_mean is not None:
            off = (value - info.spec.prior_mean) / info.spec.prior_std
            if abs(off) > UNLIKELY:
                words.append(
                    f"{info.name} is {abs(off):.1f} standard deviations of its prior too {'high' if off > 0 else 'low'}"
                )
            continue
        if value < 0.0:
            turned.add(info.name)
        change[info.name] = math.log(max(value, 1e-12 * info.spec.value) / info.spec.value)
        power[info.name] = _power(info.spec.unit)
    scaled = sorted(change[n] / power[n] for n in change if power[n])
    middle = scaled[len(scaled) // 2] if scaled and not _has_scale(nominal) else 0.0
    for name, moved in change.items():
        own = moved - power[name] * middle
        if name in turned:
            words.append(f"{name} has changed its sign")
        elif own < -3.0:
            words.append(f"{name} is driven to zero")
        elif abs(own) > (BENT_TORQUE if power[name] else BENT):
            words.append(f"{name} is {math.exp(own):.2f} times its nominal value")
    return words


def _has_scale(system: System) -> bool:
    """Whether a torque is known from elsewhere than the motion."""
    torques = (i.spec for i in system.table if _power(i.spec.unit) and i.spec.value != 0.0)
    known = any(not spec.estimate or spec.prior_std is not None for spec in torques)
    return known or any("tau" in joint.channels for joint in system.joints)


def _power(unit: str) -> int:
    """Power of torque in a unit: 1 of ``N m s/rad`` or ``kg m^2``, -1 of ``rad/(N m)``, -2 of ``1/(N m)^2``."""
    over, _, under = unit.partition("/")
    if "N" in under:
        return -2 if ")^2" in under else -1
    return int("N" in over or "kg" in over)
