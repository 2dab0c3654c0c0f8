"""Parameters that a re-fit has moved beyond data-sheet tolerance, to make up for what the model lacks."""

from __future__ import annotations

import math

from hybrid_id.parameters import Bounded
from hybrid_id.statistics.identifiability import Identifiability
from hybrid_id.systems.chain import System

BENT, BENT_TORQUE = math.log(1.4), math.log(1.7)
"""Change of a parameter against its nominal value that data sheets hardly allow; the same of a torque, whose common
scale is known no better than the others' median."""
UNLIKELY = 3.0
"""Standard deviations of a parameter's prior, where it has one, that are as much."""
LEAST = 1e-3
"""Entry of a direction below which a parameter does not belong to it."""


def implausible_parameters(nominal: System, fitted: System, told: Identifiability | None = None) -> list[str]:
    """Parameters that a re-fit has moved by more than their priors or, without one, data sheets are wrong, in words.

    Where a change that the records do not see (``told``, of the nominal model) has moved a parameter as far, with no
    other moved further than it may be, this is said beside it.

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
            words.append(f"{name} is driven to zero{_unseen(nominal, name, -1.0, told)}")
        elif abs(own) > (BENT_TORQUE if power[name] else BENT):
            excuse = _unseen(nominal, name, math.exp(own) - 1.0, told)
            words.append(f"{name} is {math.exp(own):.2f} times its nominal value{excuse}")
    return words


def _unseen(nominal: System, name: str, moved: float, told: Identifiability | None) -> str:
    """What else may have moved a parameter by a share of its value, unseen by the records; empty where nothing may."""
    if told is None or name not in told.names:
        return ""
    for one in told.directions:
        change = dict(zip(told.names, one.relative, strict=True))
        if abs(change[name]) < LEAST:
            continue
        others = {
            k: v * moved / change[name]
            for k, v in change.items()
            if k != name and abs(v) > LEAST * abs(change[name])
        }
        if others and all(abs(share) < _allowed(nominal.parameter(k).spec) for k, share in others.items()):
            words = " and ".join(f"{k} off by {100 * share:+.2g} %" for k, share in others.items())
            return f" (unseen by these records: {words} would move it as far)"
    return ""


def _allowed(spec: Bounded) -> float:
    """Share of its value by which a parameter may well be off."""
    return (
        0.3 if spec.prior_std is None else min(UNLIKELY * spec.prior_std / max(abs(spec.value), 1e-300), 0.3)
    )


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
