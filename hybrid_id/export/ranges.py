"""How far each parameter may be off, as ranges for domain randomisation."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from scipy.special import ndtri

from hybrid_id.errors import InputError
from hybrid_id.identification.result import NO_ESTIMATE
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
    result = result or {}
    ranges = {}
    with as_written("the result", "give that of an identification of this model, as it was written"):
        selected = result.get("selected") or {}
        values, intervals = selected.get("values") or {}, dict(selected.get("intervals") or {})
        if result and not values:
            raise InputError(
                "the result holds no identified values; give a folder that 'identify', or 'train' without networks, "
                "has written"
            )
        if foreign := set(values) - {info.name for info in system.table}:
            raise InputError(
                f"the result speaks of {min(foreign)}, which the model lacks; give both from one run"
            )
        for fit in result.get("sets", []):
            if fit.get("set") is not None and fit["set"] == selected.get("set"):
                for name in fit["at_bound"]:  # nothing is claimed there
                    intervals.pop(name, None)
        sets = [
            dict(zip(result["parameters"], fit["values"], strict=True))
            for fit in result.get("sets", [])
            if fit.get("status") not in NO_ESTIMATE
        ]
        level = result.get("level", 0.95)
        for info in system.table:
            name, spec = info.name, info.spec
            spread = [s[name] for s in sets if name in s]
            profile, interval = result.get("profiles", {}).get(name), intervals.get(name)
            ends, source = [spec.value], "unknown" if name in values and spec.estimate else "held"
            if profile is not None and all(profile["closed"]):
                ends, source = [profile["lower"], profile["upper"], *spread, spec.value], "profile"
            elif interval is not None:
                ends, source = [*interval, *spread, spec.value], "interval"
            elif spec.estimate and spec.prior_std is not None and spec.prior_mean is not None:
                off = float(ndtri(0.5 + level / 2)) * spec.prior_std
                ends, source = [spec.prior_mean - off, spec.prior_mean + off, spec.value], "prior"
            elif len(set(spread)) > 1:
                ends, source = [*spread, spec.value], "spread"
            ranges[name] = {
                "nominal": spec.value,
                "lower": max(min(ends), spec.lower),
                "upper": min(max(ends), spec.upper),
                "unit": info.unit,
                "from": source,
                "reliability": result.get("reliability", {}).get(name, {}).get("grade"),
                "component": info.component,
            }
    return {"level": level, "parameters": ranges}


def read_result(path: Path) -> dict[str, Any]:
    """Content of a ``result.json``; InputError where it is none."""
    try:
        found = read_object(path, "result of hybrid-id")
    except OSError:
        found = {}
    if not str(found.get("program")).startswith("hybrid_id "):
        raise InputError(f"{path} is no result of hybrid-id; give the folder of an identification") from None
    return found
