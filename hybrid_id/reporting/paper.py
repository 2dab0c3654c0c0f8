"""The paper's tables and figures, ours beside the printed, on one page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.table import Table
from rich.text import Text

from hybrid_id.machines.twin import paper
from hybrid_id.reporting.page import Page, Section
from hybrid_id.reporting.style import (
    COLOURS,
    DASHES,
    GREY,
    journal,
    legend_above,
    new_figure,
    pad,
    pixels,
    unit,
)
from hybrid_id.reporting.tables import table
from hybrid_id.reproduction.claims import Claim
from hybrid_id.reproduction.comparison import (
    PRINTED,
    FitRow,
    ParameterRow,
)
from hybrid_id.reproduction.curves import Curve, Preprocessed
from hybrid_id.reproduction.result import TrackingResult
from hybrid_id.reproduction.run import Reproduction
from hybrid_id.reproduction.tracking import inertia_signs


def motors_table() -> Table:
    """Table 1: the data sheets' motor constants, with which the mathematical model works."""
    rows = [
        (name, f"{value:.5g}", "N m/V" if name.startswith("P_m1") else "V s/rad")
        for name, value in paper.TABLE_1.items()
    ]
    return table(("parameter", "printed>", "unit"), rows)


def parameters_table(rows: Sequence[ParameterRow]) -> Table:
    """Tables 2, 4, 6, 7 and 10."""
    heads = (
        "parameter", "truth>", "ours>", "± (95 %)>", "printed>", "unit", "holds the truth", "std/mean, ours>",
        "printed >", "remark",
    )  # fmt: skip
    return table(heads, map(_parameter_cells, rows))


def _parameter_cells(row: ParameterRow) -> Sequence[str | Text]:
    held, claimed = row.role == "stage", np.isfinite(row.interval)
    inside = Text("yes", style="green") if row.covered else Text("no", style="yellow")
    spread = Text(f"{row.percent:.2f} %", style="yellow" if row.role == "free" and not row.below else "")
    best = row.printed.best
    return (
        row.name, _number(row.truth), _number(row.value),
        "held" if held else _number(row.interval, 2) if claimed else "none",
        "cut in print" if best is None else _number(best), unit(row.unit),
        Text("") if held else inside if claimed else Text("none claimed"),
        Text("0") if held else spread, f"{row.printed.percent:.2f} %", row.remark,
    )  # fmt: skip


def _number(value: float, digits: int = 4) -> str:
    """A number whose exponent no line breaks."""
    return f"{value:.{digits}g}".replace("e-0", "e-").replace("-", "\u2011")


def fits_table(rows: Sequence[FitRow]) -> Table:
    """Tables 3, 5, 8, 9 and 11."""
    heads = (
        "signal", "average fit, ours>", "printed>", "true parameters>", "own record>", "std, ours>", "printed >",
        "std/mean, ours>", "printed  >",
    )  # fmt: skip
    cells = [
        (
            row.name, Text(f"{row.mean:.2f} %", style="" if row.mean >= row.printed.mean else "yellow"),
            f"{row.printed.mean:.2f} %", f"{row.truth:.2f} %", f"{row.own:.2f} %", f"{row.std:.2f}",
            f"{row.printed.std:.2f}",
            Text(f"{row.percent:.2f} %", style="" if row.percent < row.printed.percent else "yellow"),
            f"{row.printed.percent:.2f} %",
        )
        for row in rows
    ]  # fmt: skip
    return table(heads, cells)


def inertia_table(rows: Mapping[str, ParameterRow]) -> Table:
    """Table 12, with how far one record identifies it."""
    heads = (
        "second link", "printed [kg m²]>", "ours [kg m²]>", "± (95 %)>", "truth>", "std/mean, ours>", "printed>",
        "typical record>", "least informative>",
    )  # fmt: skip
    cells = [
        (
            title, f"{paper.TABLE_12[title]:.3f}", f"{row.value:.6f}", f"{row.interval:.1g}", f"{row.truth:.6f}",
            f"{row.percent:.2g} %", f"{row.printed.percent:.2f} %", f"± {row.typical:.2g} %",
            f"± {row.predicted:.2g} %",
        )
        for title, row in rows.items()
    ]  # fmt: skip
    return table(heads, cells)


def tracking_table(results: Mapping[str, TrackingResult]) -> Table:
    """RMS and peak errors of every closed loop, mean ± standard deviation over the seeds."""
    heads = ("machine", "model", "joint>", "RMS error [mrad]>", "peak error [mrad]>", "at the voltage limit>")
    rows = [
        (
            case.replace("_", " "), model, str(j + 1),
            *(f"{1e3 * v[k, j].mean():.2f} ± {1e3 * v[k, j].std():.2f}" for v in (result.rms, result.peak)),
            f"{100 * result.saturated[k, j].mean():.1f} %",
        )
        for case, result in results.items()
        for j in range(result.rms.shape[1])
        for k, model in enumerate(result.models)
    ]  # fmt: skip
    return table(heads, rows)


def claims_table(claims: Sequence[Claim]) -> Table:
    """What was to be shown, and what was seen."""
    marks = {True: Text("yes", style="green"), False: Text("no", style="red")}
    rows = [(claim.claim, claim.target, claim.seen, marks[bool(claim.met)]) for claim in claims]
    return table(("claim", "target", "seen", "met"), rows)


@journal()
def preprocessing_figure(record: Preprocessed) -> Figure:
    """Fig. 3: voltage, position and velocity of one experiment, raw and preprocessed."""
    figure = new_figure(4.2)
    panels = figure.subplots(3, 2, sharex="col", width_ratios=(2.2, 1))
    begin = record.time[0] + 0.45 * np.ptp(record.time)
    inside = (record.time >= begin) & (record.time <= begin + 0.25)
    for column, part in enumerate((slice(None), inside)):
        time = record.time[part]
        voltage, angle, speed = panels[:, column]
        voltage.plot(time, record.voltage[part], color="black", lw=0.8)
        angle.plot(time, record.angle[part], color=GREY, lw=1.6, label="encoder")
        angle.plot(time, record.smooth_angle[part], color=COLOURS[0], lw=0.9, label="band-limited")
        speed.plot(time, record.difference[part], color=GREY, lw=0.6, label="differences")
        speed.plot(time, record.speed[part], color=COLOURS[0], lw=0.9, label=r"$j\omega$ in the band")
        speed.set_xlabel("time [s]")
        for axes in panels[:, column]:
            axes.margins(x=0)
            pad(axes)
    labels = (
        r"voltage $u_1$ [V]",
        r"motor angle $q_\mathrm{m1}$ [rad]",
        "motor speed\n" + r"$\dot q_\mathrm{m1}$ [rad/s]",
    )
    for axes, text in zip(panels[:, 0], labels, strict=True):
        axes.set_ylabel(text)
    for axes in panels[1:, 0]:
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=2, borderaxespad=0.0)
    panels[0, 0].set_title("the whole experiment", loc="left")
    panels[0, 1].set_title("a quarter of a second", loc="left")
    figure.align_ylabels(panels[:, 0])
    return figure


@journal()
def tracking_figure(result: TrackingResult, panels: Sequence[tuple[str, int, str]]) -> Figure:
    """Figs 4, 5, 8 and 9: joints under each model.

    Args:
        result: of the closed loops.
        panels: what each one shows, ``motion`` or ``error``, of which joint (from 0), and its title.
    """
    figure = new_figure(2.6)
    grid = figure.subplots(1, len(panels))
    for axes, (what, joint, title) in zip(grid, panels, strict=True):
        (_motion if what == "motion" else _error)(axes, result, joint)
        axes.set_title(title, loc="left")
    legend_above(figure, grid[0])
    return figure


def _motion(axes: Axes, result: TrackingResult, joint: int) -> None:
    axes.plot(result.time, result.desired[:, joint], color=GREY, lw=2.4, alpha=0.75, label="desired")
    for k, model in enumerate(result.models):
        axes.plot(result.time, result.angle[:, joint, k], color=COLOURS[k], ls=DASHES[k], lw=0.9, label=model)
    axes.set(xlabel="time [s]", ylabel=rf"joint angle $q_{joint + 1}$ [rad]")
    axes.margins(x=0)
    pad(axes)


def _error(axes: Axes, result: TrackingResult, joint: int) -> None:
    axes.axhline(0.0, color="black", lw=0.5)
    for k, model in enumerate(result.models):
        error = 1e3 * (result.desired[:, joint] - result.angle[:, joint, k])
        axes.plot(result.time, error, color=COLOURS[k], ls=DASHES[k], lw=0.9, label=model)
    axes.set(xlabel="time [s]", ylabel=rf"error of $q_{joint + 1}$ [mrad]")
    axes.margins(x=0)
    pad(axes)


@journal()
def spread_figure(results: Sequence[tuple[str, TrackingResult, int]]) -> Figure:
    """RMS error of every seed under each model: one panel for each (title, result, joint)."""
    figure = new_figure(2.2)
    panels = np.ravel(figure.subplots(1, len(results)))
    for axes, (title, result, joint) in zip(panels, results, strict=True):
        for k in range(len(result.models)):
            values = 1e3 * result.rms[k, joint]
            across = k + np.linspace(-0.18, 0.18, len(values))
            axes.plot(across, values, "o", ms=2.6, color=COLOURS[k], alpha=0.8, mew=0)
            axes.plot([k - 0.28, k + 0.28], [values.mean()] * 2, color="black", lw=1.0)
        names = [model.replace("backlash-flexible", "with backlash") for model in result.models]
        axes.set_xticks(range(len(names)), names)
        axes.set_title(title, loc="left")
        axes.set_ylim(0, None)
        axes.set_xlim(-0.6, len(names) - 0.4)
    panels[0].set_ylabel("RMS error [mrad]")
    return figure


@journal()
def friction_figure(curves: Sequence[Curve], link: Curve | None = None) -> Figure:
    """Figs 13 and 14: identified friction torque over velocity, each with its truth; the link's own beside it."""
    figure = new_figure(2.9)
    panels = np.ravel(figure.subplots(1, 2 if link else 1, width_ratios=(2, 1) if link else (1,)))
    exponent = 1e3
    for k, curve in enumerate(curves):
        for half in (curve.speed < 0, curve.speed > 0):
            panels[0].plot(
                curve.speed[half], exponent * curve.truth[half], color=COLOURS[k], lw=2.6, alpha=0.3,
                solid_capstyle="butt",
            )  # fmt: skip
            panels[0].plot(
                curve.speed[half], exponent * curve.torque[half], color=COLOURS[k], ls=DASHES[k],
                lw=1.1, label=curve.label if half[-1] else None,
            )  # fmt: skip
    panels[0].plot([], [], color=GREY, lw=2.6, alpha=0.5, label="truth (pale)")
    panels[0].set(xlabel="motor speed [rad/s]", ylabel="friction torque at the motor [mN m]")
    if link is not None:
        colour = COLOURS[len(curves)]
        panels[1].plot(link.speed, exponent * link.truth, color=colour, lw=2.6, alpha=0.3)
        panels[1].plot(
            link.speed,
            exponent * link.torque,
            color=colour,
            lw=1.1,
            label=r"$\tau_\mathrm{fa}$, flexible",
        )
        panels[1].set(xlabel="link speed [rad/s]", ylabel="friction torque at the link [mN m]")
        panels[1].legend(loc="upper left")
    for axes in panels:
        axes.axhline(0, color="black", lw=0.4)
        axes.axvline(0, color="black", lw=0.4)
    panels[0].legend(loc="upper left")
    return figure


LEAD = (
    "Bahrami, Keshmiri, Keshmiri and Taghirad, “Identifying a two linked robot with non-symmetrical modified friction "
    "and backlash-flexibility models”, walked through on digital twins whose truth is known. The twins' disturbances "
    "and seeds were fixed before the first fit; nothing is tuned to a printed value."
)
_SECTIONS = {
    "link1": "III.A-B: first link, solid body",
    "link1_flexible": "III.D: first link, flexible with backlash",
    "link2_high": "IV: second link, high velocity",
    "link2_low": "IV: second link, low velocity",
    "both_links": "V: both links",
}
LOW = (
    "Why low velocity identifies the inertia worse than high velocity: the motor stays on the flank of the friction "
    "peak and stands still in between, so accelerations are small and the inertia's torque is a small part of "
    "friction's, whose error then passes into P_2. Of the records of both links, too, those in which joint 2 moves "
    "slowest identify P_2 least. The paper's own 36 % between its stages does not come from this alone: here the model "
    "has the machine's structure."
)


DRIFT = (
    "A set fits its own record almost wholly. On the others it meets friction that has drifted from run to run: "
    "nothing pulls the angle back, so the difference adds up over a free run, and the position wanders. The true "
    "parameters of the same run wander alike; velocity hardly shows it."
)
QUICK = "In short: two records of a second in each stage, for which the targets are not meant."
SCALE = (
    "Pale: the machine's own. All levels scale with the data sheet's P_m1, and P_m2 and the viscous slope make up for "
    "each other: they are indistinguishable from voltage and angle. The intervals say so; the curves are those of "
    "one set."
)


def paper_figures(result: Reproduction) -> dict[str, np.ndarray]:
    """Every figure by the name of its file."""
    one, both = result.tracking["one_link"], result.tracking["both_links"]
    rigid = result.friction("link1", r"$\tau_\mathrm{f}$, rigid")
    flexible = result.friction("link1_flexible", r"$\tau_\mathrm{fm}$, flexible")
    second = [
        result.friction("link2_high", r"$\tau_\mathrm{f}$, high velocity"),
        result.friction("link2_low", r"$\tau_\mathrm{f}$, low velocity"),
        result.friction("both_links", r"$\tau_\mathrm{f2}$, both links", "m2"),
    ]
    spread = [
        ("one link", one, 0),
        ("both, joint 1", both, 0),
        ("both, joint 2", both, 1),
        ("backlash", result.tracking["backlash"], 0),
    ]
    alone = (("motion", 0, ""), ("error", 0, ""))
    figures = {
        "figure_03": preprocessing_figure(result.record),
        "figure_04": tracking_figure(one, alone),
        "figure_05": tracking_figure(result.tracking["backlash"], alone),
        "figure_08": tracking_figure(both, [("motion", k, f"joint {k + 1}") for k in (0, 1)]),
        "figure_09": tracking_figure(both, [("error", k, f"joint {k + 1}") for k in (0, 1)]),
        "figure_13": friction_figure([rigid, flexible], result.link_friction("link1_flexible")),
        "figure_14": friction_figure(second),
        "tracking_spread": spread_figure(spread),
    }
    return {name: pixels(figure) for name, figure in figures.items()}


def paper_page(result: Reproduction, figures: Mapping[str, np.ndarray], *, quick: bool = False) -> Page:
    """The page.

    Args:
        result: all results.
        figures: those of the paper by name.
        quick: whether the results are those of the short run.
    """
    claims = result.claims
    verdict = f"{sum(claim.met for claim in claims)} of {len(claims)} claims are met."
    page = Page("The paper on digital twins", " ".join([verdict, LEAD, *([QUICK] if quick else [])]))
    page.section("What was to be shown").add(claims_table(claims))
    motors = page.section("II: motors and preprocessing")
    motors.add("Table 1: motor constants of the data sheets.", motors_table())
    motors.figure(
        figures["figure_03"], "Fig. 3. Preprocessing of one experiment: the Fourier transform of the encoder's angle, "
        "unwanted frequencies dropped, differentiated by jω.",
    )  # fmt: skip
    for stage, title in _SECTIONS.items():
        section = page.section(title)
        _stage(section, stage, result)
        _pictures(section, stage, figures)
    comparison = page.section("VI-VII: friction and inertia compared")
    comparison.figure(
        figures["figure_13"],
        "Fig. 13. Friction torque over velocity of the first link: solid body and flexible model. " + SCALE,
    )
    comparison.figure(
        figures["figure_14"], "Fig. 14. Friction torque over velocity of the second link in three stages."
    )
    comparison.add(
        "Table 12: inertia of the second link. On the right the standard error from one record.",
        inertia_table(result.inertia),
        LOW,
    )
    tracking = page.section("Tracking errors")
    tracking.add(
        "Computed torque with the same gains and voltage limit for all models. MM: Table 1 and each link's inertia off "
        "by 25 %, up or down by seed; IFLRM: identified motor and inertia, no friction; IFRM: all that was identified. "
        "Errors at the link, mean ± standard deviation over the seeds.",
        tracking_table(result.tracking),
        "A mathematical model with too much inertia also closes a stiffer loop, since the gains act through it, and "
        "friction moves that less: a single seed may beat IFLRM; the table of claims has the paired test.",
    )
    tracking.figure(figures["tracking_spread"], "RMS error of every seed; the bar is their mean.")
    return page


def _stage(section: Section, stage: str, result: Reproduction) -> None:
    found, printed = result.stages[stage], PRINTED[stage]
    section.add(
        f"Table {printed.parameters}: {len(found.values)} experiments, set {found.selected + 1} is selected. "
        "The truth is that of the selected set's own run.",
        parameters_table(result.parameters(stage)),
    )
    for words in found.words:
        section.add(f"check: {words}")
    for words in found.failed:
        section.add(f"not converged: {words}")
    section.add(
        f"Table {printed.fits}: fit of the selected set over all experiments, and of each set on its own record.",
        fits_table(result.fits(stage)),
    )
    if stage == "link1":
        section.add(DRIFT)


def _pictures(section: Section, stage: str, figures: Mapping[str, np.ndarray]) -> None:
    captions = {
        "link1": {
            "figure_04": "Fig. 4. Three models follow a sine (left), and their tracking errors (right). "
            + _first_seed(1)
        },
        "link1_flexible": {
            "figure_05": "Fig. 5. The link behind a gear with play follows a sine: rigid model and backlash-flexible "
            "model of the same machine (left), and their tracking errors (right)."
        },
        "both_links": {
            "figure_08": "Fig. 8. Three models follow a trajectory: joint 1 (left), joint 2 (right).",
            "figure_09": "Fig. 9. Tracking errors of joint 1 (left) and joint 2 (right). " + _first_seed(2),
        },
    }
    for name, words in captions.get(stage, {}).items():
        section.figure(figures[name], words)


def _first_seed(links: int) -> str:
    """Which run a figure of MM, IFLRM and IFRM shows."""
    off = [
        f"{'much' if sign > 0 else 'little'} inertia at link {link}"
        for link, sign in enumerate(inertia_signs(0)[:links], start=1)
    ]
    return f"Shown is the first seed, whose mathematical model has too {' and too '.join(off)}."
