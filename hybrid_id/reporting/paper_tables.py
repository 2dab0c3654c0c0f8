"""Tables of the paper with ours beside the printed (rich)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from rich.table import Table
from rich.text import Text

from hybrid_id.reporting.style import unit
from hybrid_id.reporting.tables import open_table
from hybrid_id.reproduction.claims import Claim
from hybrid_id.reproduction.comparison import FitRow, ParameterRow
from hybrid_id.reproduction.result import TrackingResult
from hybrid_id.twin import paper


def motors_table() -> Table:
    """Table 1: the data sheets' motor constants, with which the mathematical model works."""
    table = open_table("parameter", "printed>", "unit")
    for name, value in paper.TABLE_1.items():
        table.add_row(name, f"{value:.5g}", "N m/V" if name.startswith("P_m1") else "V s/rad")
    return table


def parameters_table(rows: Sequence[ParameterRow]) -> Table:
    """Tables 2, 4, 6, 7 and 10."""
    table = open_table(
        "parameter", "truth>", "ours>", "± (95 %)>", "printed>", "unit", "holds the truth", "std/mean, ours>",
        "printed >", "remark",
    )  # fmt: skip
    for row in rows:
        held = row.role == "stage"
        inside = Text("yes", style="green") if row.covered else Text("no", style="yellow")
        inside = inside if np.isfinite(row.interval) else Text("none claimed")
        spread = Text(f"{row.percent:.2f} %")
        if row.role == "free" and not row.below:
            spread.stylize("yellow")
        best = row.printed.best
        table.add_row(
            row.name, _number(row.truth), _number(row.value),
            "held" if held else _number(row.interval, 2) if np.isfinite(row.interval) else "none",
            "cut in print" if best is None else _number(best), unit(row.unit), Text("") if held else inside,
            Text("0") if held else spread, f"{row.printed.percent:.2f} %", row.remark,
        )  # fmt: skip
    return table


def _number(value: float, digits: int = 4) -> str:
    """A number whose exponent no line breaks."""
    return f"{value:.{digits}g}".replace("e-0", "e-").replace("-", "\u2011")


def fits_table(rows: Sequence[FitRow]) -> Table:
    """Tables 3, 5, 8, 9 and 11."""
    table = open_table(
        "signal", "average fit, ours>", "printed>", "true parameters>", "own record>", "std, ours>", "printed >",
        "std/mean, ours>", "printed  >",
    )  # fmt: skip
    for row in rows:
        mean = Text(f"{row.mean:.2f} %", style="" if row.mean >= row.printed.mean else "yellow")
        spread = Text(f"{row.percent:.2f} %", style="" if row.percent < row.printed.percent else "yellow")
        table.add_row(
            row.name, mean, f"{row.printed.mean:.2f} %", f"{row.truth:.2f} %", f"{row.own:.2f} %",
            f"{row.std:.2f}", f"{row.printed.std:.2f}", spread, f"{row.printed.percent:.2f} %",
        )  # fmt: skip
    return table


def inertia_table(rows: Mapping[str, ParameterRow]) -> Table:
    """Table 12, with how far one record tells it."""
    table = open_table(
        "second link", "printed [kg m²]>", "ours [kg m²]>", "± (95 %)>", "truth>", "std/mean, ours>", "printed>",
        "typical record>", "least telling>",
    )  # fmt: skip
    for title, row in rows.items():
        table.add_row(
            title, f"{paper.TABLE_12[title]:.3f}", f"{row.value:.6f}", f"{row.interval:.1g}", f"{row.truth:.6f}",
            f"{row.percent:.2g} %", f"{row.printed.percent:.2f} %", f"± {row.typical:.2g} %", f"± {row.told:.2g} %",
        )  # fmt: skip
    return table


def tracking_table(results: Mapping[str, TrackingResult]) -> Table:
    """RMS and peak errors of every closed loop, mean ± standard deviation over the seeds."""
    table = open_table(
        "machine", "model", "joint>", "RMS error [mrad]>", "peak error [mrad]>", "at the voltage limit>"
    )
    for case, result in results.items():
        for j in range(result.rms.shape[1]):
            for k, model in enumerate(result.models):
                cells = [
                    f"{1e3 * values[k, j].mean():.2f} ± {1e3 * values[k, j].std():.2f}"
                    for values in (result.rms, result.peak)
                ]
                limit = f"{100 * result.saturated[k, j].mean():.1f} %"
                table.add_row(case.replace("_", " "), model, str(j + 1), *cells, limit)
    return table


def claims_table(claims: Sequence[Claim]) -> Table:
    """What was to be shown, and what was seen."""
    table = open_table("claim", "target", "seen", "met")
    for claim in claims:
        met = Text("yes", style="green") if claim.met else Text("no", style="red")
        table.add_row(claim.claim, claim.target, claim.seen, met)
    return table
