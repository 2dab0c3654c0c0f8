"""Answers as a markdown table; computes nothing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

HEAD = (
    "case", "agrees", "verdict", "named", "location", "unknown, remainder",
    "error: nominal, re-fit, corrected (floor)", "shrink", "horizon", "implausible", "window errors [mrad]", "s",
)  # fmt: skip


def table(found: Sequence[Mapping[str, Any]]) -> str:
    """One row a case."""
    rows = [HEAD, ("---",) * len(HEAD), *(_row(one) for one in found)]
    return "\n".join("| " + " | ".join(cell.replace("|", "/") for cell in row) + " |" for row in rows)


def _row(found: Mapping[str, Any]) -> tuple[str, ...]:
    seconds = f"{found['seconds']:.0f}"
    if "failed" in found:
        return (found["case"], "failed", found["failed"], *[""] * (len(HEAD) - 4), seconds)
    answer = found["answer"]
    gap = answer["gap"]
    errors = ", ".join(_number(gap.get(k)) for k in ("nominal", "refit", "with_effect"))
    windows = "; ".join(
        f"{model} " + "/".join(f"{1e3 * value:.1f}" for value in errors.values())
        for model, errors in found.get("window_errors", {}).items()
    )
    return (
        found["case"], found["agrees"], answer["verdict"], _named(answer["effects"]), _places(answer),
        _unknown(answer), f"{errors} ({_number(gap.get('noise_floor'))})",
        _share(gap.get("shrink"), gap.get("shrink_interval")), _horizon(answer), _implausible(answer), windows, seconds,
    )  # fmt: skip


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"


def _share(share: float | None, interval: Sequence[float] | None) -> str:
    """A share with its interval [%]."""
    if share is None:
        return ""
    ends = f" ({100 * interval[0]:.0f} to {100 * interval[1]:.0f})" if interval else ""
    return f"{100 * share:.0f}{ends} %"


def _named(effects: Sequence[Mapping[str, Any]]) -> str:
    """Selected effects with probability, share and values; the likeliest of the others where none is selected."""
    named = [effect for effect in effects if effect.get("selected")]
    told = []
    for effect in named or effects[:1]:
        share = _share(effect.get("share"), effect.get("share_interval"))
        values = ", ".join(f"{k} {v[0]:.3g}" for k, v in effect["parameters"].items()) if named else ""
        tied = f"indistinguishable from {', '.join(effect['tied_with'])}" if effect.get("tied_with") else ""
        about = "; ".join(part for part in (share, values, tied) if part)
        told.append(f"{effect['name']} {effect['probability']:.2f}" + (f" [{about}]" if about else ""))
    return ("" if named else "none; likeliest ") + ", ".join(told) if told else "none"


def _places(answer: Mapping[str, Any]) -> str:
    location = answer.get("location") or []
    return "; ".join(f"{o['joint']} {o['signal']} {100 * o['share']:.0f} %" for o in location[:1])


def _unknown(answer: Mapping[str, Any]) -> str:
    remainder = answer.get("remainder") or {}
    return " ".join(
        part
        for part in (
            "yes" if answer["unknown"] else "no",
            _share(remainder.get("share"), remainder.get("interval")),
        )
        if part
    )


def _horizon(answer: Mapping[str, Any]) -> str:
    seconds = answer["horizon"].get("seconds")
    return answer["horizon"]["kind"] + ("" if seconds is None else f" {seconds:g} s")


def _implausible(answer: Mapping[str, Any]) -> str:
    return "; ".join(map(str, answer.get("implausible_parameters") or []))
