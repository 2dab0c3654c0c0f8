"""A fleet as plain data, tables, pictures and one page: mean, spread, which robot stands out, and why."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from rich.table import Table

from hybrid_id.reporting.page import Page
from hybrid_id.reporting.results import write_rows
from hybrid_id.reporting.style import COLOURS, GREY, journal, label, new_figure, unit
from hybrid_id.reporting.tables import count, interval_words, table
from hybrid_id.study.fleet import FleetStudy

CSV_HEADS = (
    "robot", "parameter", "unit", "by_its_records", "std_error", "with_the_fleet", "std_error_with_the_fleet",
    "deviation", "odd",
)  # fmt: skip
_HOW = (
    "Each record of a robot gives one parameter set. Sets scatter by their own errors, by what varies between records "
    "of one robot, and by what varies between robots; both variations are estimated by restricted maximum likelihood. "
    "The deviation of a robot is from the mean of the others, in standard deviations of what spread and errors let one "
    "expect. A robot stands out where chance would let any robot do so in fewer than one fleet of twenty. Robots that "
    "stand out are left out of mean and spread."
)


def fleet_result(study: FleetStudy) -> dict[str, Any]:
    """Everything that is known of a fleet, as plain data."""
    of = study.fleet
    infos = [study.system.parameter(name) for name in study.names]
    return {
        "robots": [robot.name for robot in study.robots],
        "failed": study.failed,
        "horizon": dict(zip(("kind", "seconds"), study.robots[0].horizon, strict=True)),
        "parameters": {
            info.name: {
                "unit": info.unit,
                "held_by_prior": bool(of.held[k]),
                "mean": of.mean[k],
                "mean_interval": of.mean_interval[k],
                "spread": of.spread[k],
                "spread_interval": of.spread_interval[k],
                "spread_between_records": of.record_spread[k],
            }
            for k, info in enumerate(infos)
        },
        "odd": [
            {
                "robot": robot.name,
                "parameters": [name for name, odd in zip(study.names, of.odd[i], strict=True) if odd],
                "fit": bool(of.odd_fit[i]),
                "why": why(study, i),
            }
            for i, robot in enumerate(study.robots)
            if of.stands_out[i]
        ],
        "by_robot": {
            robot.name: {
                "values": dict(zip(study.names, of.values[i], strict=True)),
                "std_errors": dict(zip(study.names, of.errors[i], strict=True)),
                "by_its_records": dict(zip(study.names, of.own[i], strict=True)),
                "deviations": dict(zip(study.names, of.deviation[i], strict=True)),
                "error_of_fit_over_median": of.misfit[i],
                "records": robot.records,
                "unfinished": robot.unfinished,
            }
            for i, robot in enumerate(study.robots)
        },
    }


def verdict(study: FleetStudy) -> list[str]:
    """What a fleet comes to, in sentences; the first is the outcome."""
    of, n = study.fleet, len(study.robots)
    odd = [robot.name for robot, out in zip(study.robots, of.stands_out, strict=True) if out]
    records = sum(len(robot.records) for robot in study.robots)
    names = ", ".join(odd[:8]) + (f" and {len(odd) - 8} more" if len(odd) > 8 else "")
    outcome = f"{names} {'stands' if len(odd) == 1 else 'stand'} out" if odd else "none stands out"
    words = [f"{count(n, 'robot')}, {count(records, 'record')}: {outcome}."]
    if held := [name for name, of_prior in zip(study.names, of.held, strict=True) if of_prior]:
        words.append(
            f"Held by their priors, and so taken as the same in all robots: {', '.join(held)}. A robot in which they "
            "differ shows it in the other parameters."
        )
    unknown = ~np.isfinite(of.mean_error) & ~of.held
    if dark := [name for name, out in zip(study.names, unknown, strict=True) if out]:
        words.append(f"Not identifiable by these records: {', '.join(dark)}.")
    if unfinished := sum(len(robot.unfinished) for robot in study.robots):
        words.append(f"{count(unfinished, 'fit')} of {records} did not converge.")
    return words


def why(study: FleetStudy, i: int) -> list[str]:
    """Why a robot stands out, in sentences, the largest deviation first; none where it does not."""
    of, said = study.fleet, []
    for k in sorted(np.flatnonzero(of.odd[i]), key=lambda k: -abs(of.deviation[i, k])):
        info = study.system.parameter(study.names[k])
        change = 100.0 * (of.own[i, k] / of.mean[k] - 1.0) if of.mean[k] else np.inf
        size = (
            f"{abs(change):.0f} % {'above' if change > 0 else 'below'}"
            if abs(change) < 1000.0
            else "far from"
        )
        said.append(
            f"{info.doc or info.name} {info.name} is {of.own[i, k]:.4g} {unit(info.unit)}, {size} the fleet's "
            f"mean {of.mean[k]:.4g}: {abs(of.deviation[i, k]):.1f} standard deviations".replace(" ,", ",")
        )
    if of.odd_fit[i]:
        said.append(
            f"its error of fit is {of.misfit[i]:.2f} times the fleet's median: its records hold what the model "
            "lacks, and 'hybrid-id diagnose' of its folder says what"
        )
    return said


def fleet_table(study: FleetStudy) -> Table:
    """Mean and spread of each parameter."""
    of, rows = study.fleet, []
    for k, name in enumerate(study.names):
        info = study.system.parameter(name)
        if of.held[k] or not np.isfinite(of.mean_error[k]):
            mean, words = (
                (f"{of.mean[k]:.4g}", "held by its prior") if of.held[k] else ("", "not identifiable")
            )
            rows.append((name, info.doc, mean, words, info.unit, "", "", ""))
            continue
        share = f" ({100 * of.spread[k] / abs(of.mean[k]):.1f} %)" if of.mean[k] else ""
        within = f"{of.record_spread[k]:.3g}" if np.isfinite(of.record_spread[k]) else "one record each"
        rows.append(
            (
                name, info.doc, f"{of.mean[k]:.4g}", interval_words(*of.mean_interval[k]), info.unit,
                f"{of.spread[k]:.3g}{share}", interval_words(*of.spread_interval[k]), within,
            )
        )  # fmt: skip
    heads = (
        "parameter", "meaning", "fleet mean>", "95 % interval>", "unit", "spread between\nrobots>", "95 % interval>",
        "between records\nof one robot>",
    )  # fmt: skip
    return table(heads, rows)


def write_robots(path: Path, study: FleetStudy) -> None:
    """One row a robot and parameter: by its own records, with what the fleet knows, and its deviation."""
    of = study.fleet
    rows = [
        (
            robot.name, name, study.system.parameter(name).unit, of.own[i, k], of.own_error[i, k], of.values[i, k],
            of.errors[i, k], of.deviation[i, k], int(of.odd[i, k]),
        )
        for i, robot in enumerate(study.robots)
        for k, name in enumerate(study.names)
    ]  # fmt: skip
    write_rows(path, CSV_HEADS, rows)


def fleet_page(study: FleetStudy, picture: np.ndarray) -> Page:
    """The whole result as one page, with the picture of the robots."""
    first, *others = verdict(study)
    page = Page("Fleet", first)
    section = page.section("Who stands out").add(*others)
    if study.fleet.stands_out.any():
        reasons = [(robot.name, said) for i, robot in enumerate(study.robots) for said in why(study, i)]
        section.add(table(("robot", "why it stands out"), reasons))
    page.section("Mean and spread").add(fleet_table(study)).note(_HOW)
    page.section("Robots").figure(
        picture,
        "Each robot by its own records (points) in the order of their names; band: 95 % of the fleet; a robot that "
        "stands out in a parameter is marked there. Last: error of fit over the fleet's median.",
    )
    if study.failed:
        page.section("Robots without an estimate").add(table(("robot", "reason"), list(study.failed.items())))
    return page


@journal()
def robots_figure(study: FleetStudy) -> Figure:
    """Each parameter of each robot, in the order of their names, with the band of the fleet, and the errors of fit."""
    of, numbers = study.fleet, np.arange(1, len(study.robots) + 1)
    known = [k for k in range(len(study.names)) if np.isfinite(of.mean_error[k])]
    figure = new_figure(1.15 * (len(known) + 1) + 0.4)
    panels = np.atleast_1d(figure.subplots(len(known) + 1, 1, sharex=True))
    columns = [(np.where(np.isfinite(of.own_error[:, k]), of.own[:, k], np.nan), of.odd[:, k]) for k in known]
    for axes, (values, odd) in zip(panels, [*columns, (of.misfit, of.odd_fit)], strict=True):
        axes.plot(numbers[~odd], values[~odd], "o", ms=2.5, color=COLOURS[0])
        axes.plot(numbers[odd], values[odd], "D", ms=4.5, color=COLOURS[1])
        for i in np.flatnonzero(odd):
            at = {"xytext": (4, 2), "textcoords": "offset points", "fontsize": 7}
            axes.annotate(study.robots[i].name, (numbers[i], values[i]), **at)
    for axes, k in zip(panels, known, strict=False):
        reach, info = 1.96 * of.spread[k], study.system.parameter(study.names[k])
        axes.axhspan(of.mean[k] - reach, of.mean[k] + reach, color=GREY, alpha=0.2, lw=0)
        axes.axhline(of.mean[k], color=GREY, lw=0.8)
        axes.set_ylabel(label(info.name, info.unit))
    panels[-1].axhline(1.0, color=GREY, lw=0.8)
    panels[-1].set(ylabel="error of fit", xlabel="robot")
    return figure
