"""How far each parameter may be off, as ranges for domain randomisation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from scipy.special import ndtri

from hybrid_id.errors import InputError
from hybrid_id.identification.result import NO_ESTIMATE
from hybrid_id.parameters import Bounded
from hybrid_id.reading import as_written, read_object
from hybrid_id.systems.chain import System


def to_ranges(system: System, result: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Range of each parameter, and where it comes from.

    ``profile``: its interval by profile likelihood, closed on both sides; ``interval``: what the identification claims
    otherwise. Both are widened to the smallest and largest value over the records' own sets, among which a machine
    moves, too. ``prior``: as much of the prior, where nothing is claimed. ``spread``: over the records' own sets alone,
    where there is none. ``unknown``: estimated, and nothing says how well: the value alone. ``held``: the value alone.
    A range never leaves the parameter's bounds; ``reliability`` is the identification's grade.

    Args:
        system: the model whose values are the centres.
        result: content of ``result.json`` of its identification; without it only priors tell.

    Raises:
        InputError: the result is not one of an identification of this model.
    """
    with as_written("the result", "give that of an identification of this model, as it was written"):
        return _ranges(system, result)


def _ranges(system: System, result: Mapping[str, Any] | None) -> dict[str, Any]:
    selected = (result or {}).get("selected") or {}
    values, intervals = selected.get("values") or {}, dict(selected.get("intervals") or {})
    for name in _at_bound(result or {}):  # nothing is claimed there
        intervals.pop(name, None)
    if result is not None and not values:
        raise InputError(
            "the result holds no identified values; give a folder that 'identify', or 'train' without networks, has "
            "written"
        )
    if foreign := set(values) - {info.name for info in system.table}:
        raise InputError(
            f"the result speaks of {min(foreign)}, which the model lacks; give both from one run"
        )
    sets = (
        [
            dict(zip(result["parameters"], s["values"], strict=True))
            for s in result["sets"]
            if s.get("status") not in NO_ESTIMATE
        ]
        if result
        else []
    )
    level, known = (result or {}).get("level", 0.95), result or {}
    ranges = {}
    for info in system.table:
        name, spec = info.name, info.spec
        claimed = _claimed(intervals.get(name), known.get("profiles", {}).get(name))
        spread = [s[name] for s in sets if name in s]
        grade = known.get("reliability", {}).get(name, {}).get("grade")
        low, high, source = _range(spec, claimed, spread, float(ndtri(0.5 + level / 2)), name in values)
        ranges[name] = {
            "nominal": spec.value,
            "lower": max(low, spec.lower),
            "upper": min(high, spec.upper),
            "unit": info.unit,
            "from": source,
            "reliability": grade,
            "component": info.component,
        }
    return {"level": level, "parameters": ranges}


def _at_bound(result: Mapping[str, Any]) -> list[str]:
    """Parameters of the selected set that lie at a bound."""
    name = (result.get("selected") or {}).get("set")
    return next(
        (s["at_bound"] for s in result.get("sets", []) if name is not None and s.get("set") == name), []
    )


def _claimed(
    interval: Sequence[float] | None, profile: Mapping[str, Any] | None
) -> tuple[float, float, str] | None:
    """Ends of the interval that an identification claims, and by what; None where it claims none."""
    if profile is not None and all(profile["closed"]):
        return profile["lower"], profile["upper"], "profile"
    if interval is not None:
        return interval[0], interval[1], "interval"
    return None


def _range(
    spec: Bounded, claimed: tuple[float, float, str] | None, spread: list[float], reach: float, fitted: bool
) -> tuple[float, float, str]:
    if claimed is not None:
        return min(claimed[0], *spread, spec.value), max(claimed[1], *spread, spec.value), claimed[2]
    if spec.estimate and spec.prior_std is not None and spec.prior_mean is not None:
        off = reach * spec.prior_std
        return min(spec.prior_mean - off, spec.value), max(spec.prior_mean + off, spec.value), "prior"
    if len(set(spread)) > 1:
        return min(*spread, spec.value), max(*spread, spec.value), "spread"
    return spec.value, spec.value, "unknown" if fitted and spec.estimate else "held"


def read_result(path: Path) -> dict[str, Any]:
    """Content of a ``result.json``; InputError where it is none."""
    try:
        found = read_object(path, "result of hybrid-id")
    except OSError:
        found = {}
    if not str(found.get("program")).startswith("hybrid_id "):
        raise InputError(f"{path} is no result of hybrid-id; give the folder of an identification") from None
    return found
