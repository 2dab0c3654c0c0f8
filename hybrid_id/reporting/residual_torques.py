"""Networks joint by joint: as plain data, a table, pictures and one page."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from rich.table import Table

from hybrid_id.records.dataset import Dataset
from hybrid_id.reporting.diagnosis_words import joined, percent
from hybrid_id.reporting.hybrid import map_figure
from hybrid_id.reporting.page import Page, records_section
from hybrid_id.reporting.style import pixels
from hybrid_id.reporting.tables import count, table
from hybrid_id.study.residual_torques import ArmHybrid

_HOW = (
    "Each joint is taken by itself, the others as measured. Physics is fitted alone, then a network of the joint's "
    "angle and speed beside it; no physical parameter moves by more than two of its standard errors without it. A "
    "network stays where it surely lowers the errors of records left out (95 % over all sizes of its weights that were "
    "tried). Errors are RMS of free runs in units of the standard deviation that a fit gives each measurement: its "
    "noise and 0.4 % of its signal."
)


MISSED = 1.5
"""Error from which on a joint without a network is said to be badly explained."""
OPEN = float(np.log(2.0))
"""End of a gain's interval above which records left out do not exclude that a network halves the error."""


def residuals_result(found: ArmHybrid) -> dict[str, Any]:
    """Everything that it says, as plain data."""
    return {
        "interrupted": found.interrupted,
        "skipped": dict(found.skipped),
        "joints": {
            name: {
                "network": one.size is not None,
                "size": one.size,
                "gain": {"mean": one.gain.mean, "lower": one.gain.lower, "upper": one.gain.upper},
                "left_out": _pairs(one.left_out),
                "tested": _pairs(one.tested),
                "drift_sigma": one.drift,
                "share_of_torque": None if one.map is None else one.map.share,
                "horizon": str(one.horizon),
            }
            for name, one in found.joints.items()
        },
        "tested": _pairs(found.tested),
    }


def _pairs(errors: Mapping[str, tuple[float, float]]) -> dict[str, dict[str, float]]:
    return {name: {"physics": a, "hybrid": b} for name, (a, b) in errors.items()}


def lead(found: ArmHybrid) -> str:
    """The outcome in plain words."""
    stay = [name for name, one in found.joints.items() if one.size is not None]
    others = "" if len(stay) == len(found.joints) else ", and at none of the others"
    said = (
        f"A network earns its place at {joined(stay)}{others}."
        if stay
        else "No network earns its place at any joint: physics alone is kept."
    )
    if stay and found.tested:
        before, after = _means(found.tested)
        said += (
            f" Error of the whole robot on {count(len(found.tested), 'test record')}, all joints simulated"
            f"{', those not taken as the model has them' if found.others else ''}: {before:.3g} by physics alone, "
            f"{after:.3g} with {'it' if len(stay) == 1 else 'them'} (1: as measurements are weighted)."
        )
    missed = {
        name: one.gain.upper > OPEN
        for name, one in found.joints.items()
        if one.size is None and _means(one.left_out)[0] > MISSED
    }
    if left := [name for name, unsure in missed.items() if not unsure]:
        said += f" What physics leaves at {joined(left)} is no torque over angle and speed: diagnose it."
    if few := [name for name, unsure in missed.items() if unsure]:
        said += f" At {joined(few)} too few records are left out to say whether a network helps: record more."
    return said + (" It was stopped: not all joints were taken." if found.interrupted else "")


def _means(errors: Mapping[str, tuple[float, float]]) -> tuple[float, float]:
    before, after = np.sqrt(np.mean(np.square(list(errors.values())), 0))
    return float(before), float(after)


def joints_table(found: ArmHybrid) -> Table:
    """A row a joint: whether its network stays, and both errors on records left out and on test records."""
    rows = []
    for name, one in found.joints.items():
        errors = [
            f"{error:.3g}" if of else ""
            for of in (one.left_out, one.tested)
            for error in (_means(of) if of else ("", ""))
        ]
        moved = ""  # the largest change of a physical parameter
        if one.size is not None and one.drift:
            most = max(one.drift, key=lambda parameter: abs(one.drift[parameter]))
            moved = f"at most {abs(one.drift[most]):.1f} ({most})"
        share = "" if one.map is None else percent(one.map.share)
        rows.append((name, "none" if one.size is None else "stays", *errors, share, moved))
    heads = ("joint", "network", "records left out: physics alone>", "with network>",
             "test records: physics alone>", "with network >", "its torque over the drive's>",
             "parameters moved [σ]>")  # fmt: skip
    return table(heads, rows)


def residuals_pictures(found: ArmHybrid) -> dict[str, np.ndarray]:
    """Figures by the name of their file."""
    maps = {name: one.map for name, one in found.joints.items() if one.map is not None}
    words = "opposing torque [N\u2009m]"
    return {
        f"map_{k}": pixels(map_figure(of.angle, of.speed, of.torque, of.seen, name, words))
        for k, (name, of) in enumerate(maps.items(), 1)
    }


def residuals_page(dataset: Dataset, found: ArmHybrid, pictures: Mapping[str, np.ndarray]) -> Page:
    """The page of networks joint by joint."""
    page = Page(f"Physics and networks on {dataset.name}", lead(found))
    joints = page.section("Joints").add(joints_table(found)).note(_HOW)
    joints.add(*(f"not taken: {name} ({why})." for name, why in found.skipped.items()))
    if pictures:
        maps = page.section("Networks")
        for picture in pictures.values():
            maps.figure(
                picture, "Torque that opposes the drive, over angle and speed; dots: where the records are."
            )
    records_section(page, dataset)
    return page
