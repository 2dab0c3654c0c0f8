"""The paper's tables and figures, ours beside the printed, on one page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from hybrid_id.machines.physics.friction import AsymmetricStribeck
from hybrid_id.paper.comparison import PRINTED, Claim, fit_table, inertia_table, parameter_table
from hybrid_id.paper.run import Reproduction
from hybrid_id.paper.stages import StageResult
from hybrid_id.paper.tracking import TABLE_1, TrackingResult, inertia_signs
from hybrid_id.paper.twin import LEVELS
from hybrid_id.records.derivatives import differentiate
from hybrid_id.records.record import Record
from hybrid_id.reporting.page import Page
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


def _parameters(stage: str, result: StageResult) -> Table:
    """Tables 2, 4, 6, 7 and 10."""
    rows = []
    for name, row in parameter_table(stage, result).iterrows():
        held, inside = row.role == "stage", ("yes", "green") if row.covered else ("no", "yellow")
        spread = Text(f"{row.percent:.2f} %", style="yellow" if row.role == "free" and not row.below else "")
        rows.append(
            {
                "parameter": str(name),
                "truth>": _number(row.truth),
                "ours>": _number(row.value),
                "± (95 %)>": "held" if held else _number(row.interval, 2) if row.claimed else "none",
                "printed>": _number(row.printed) if np.isfinite(row.printed) else "cut in print",
                "unit": unit(row.unit),
                "holds the truth": Text("" if held else "none claimed") if not row.claimed else Text(*inside),
                "std/mean, ours>": Text("0") if held else spread,
                "printed >": f"{row.printed_percent:.2f} %",
                "remark": row.remark,
            }
        )
    return _table(rows)


def _table(rows: Sequence[Mapping[str, str | Text]]) -> Table:
    return table(tuple(rows[0]), [tuple(row.values()) for row in rows])


def _number(value: float, digits: int = 4) -> str:
    """A number whose exponent no line breaks."""
    return f"{value:.{digits}g}".replace("e-0", "e-").replace("-", "\u2011")


def _fits(stage: str, result: StageResult) -> Table:
    """Tables 3, 5, 8, 9 and 11."""
    rows = []
    for signal, row in fit_table(stage, result).iterrows():
        low, wide = row["mean"] < row.printed_mean, row.percent >= row.printed_percent
        rows.append(
            {
                "signal": str(signal),
                "average fit, ours>": Text(f"{row['mean']:.2f} %", style="yellow" if low else ""),
                "printed>": f"{row.printed_mean:.2f} %",
                "true parameters>": f"{row.truth_mean:.2f} %",
                "own record>": f"{row.alone:.2f} %",
                "std, ours>": f"{row['std']:.2f}",
                "printed >": f"{row.printed_std:.2f}",
                "std/mean, ours>": Text(f"{row.percent:.2f} %", style="yellow" if wide else ""),
                "printed  >": f"{row.printed_percent:.2f} %",
            }
        )
    return _table(rows)


def _inertia(stages: Mapping[str, StageResult]) -> Table:
    """Table 12, with how far one record identifies it."""
    return _table(
        [
            {
                "second link": str(title),
                "printed [kg m²]>": f"{row.printed:.3f}",
                "ours [kg m²]>": f"{row.value:.6f}",
                "± (95 %)>": f"{row.interval:.1g}",
                "truth>": f"{row.truth:.6f}",
                "std/mean, ours>": f"{row.percent:.2g} %",
                "printed>": f"{row.printed_percent:.2f} %",
                "typical record>": f"± {row.typical:.2g} %",
                "least informative>": f"± {row.predicted:.2g} %",
            }
            for title, row in inertia_table(stages).iterrows()
        ]
    )


def _tracking(results: Mapping[str, TrackingResult]) -> Table:
    """RMS and peak errors of every closed loop, mean ± standard deviation over the seeds."""
    rows = []
    for case, result in results.items():
        for j in range(result.rms.shape[1]):
            for k, model in enumerate(result.models):
                rms, peak, limited = (v[k, j] for v in (result.rms, result.peak, result.saturated))
                rows.append(
                    {
                        "machine": case.replace("_", " "),
                        "model": model,
                        "joint>": str(j + 1),
                        "RMS error [mrad]>": f"{1e3 * rms.mean():.2f} ± {1e3 * rms.std():.2f}",
                        "peak error [mrad]>": f"{1e3 * peak.mean():.2f} ± {1e3 * peak.std():.2f}",
                        "at the voltage limit>": f"{100 * limited.mean():.1f} %",
                    }
                )
    return _table(rows)


def claims_table(claims: Sequence[Claim]) -> Table:
    """What was to be shown, and what was seen."""
    marks = {True: Text("yes", style="green"), False: Text("no", style="red")}
    rows = [(claim.claim, claim.target, claim.seen, marks[bool(claim.met)]) for claim in claims]
    return table(("claim", "target", "seen", "met"), rows)


@journal()
def preprocessing_figure(record: Record) -> Figure:
    """Fig. 3: voltage, position and velocity of one experiment, raw and preprocessed (II.E).

    Frequencies in the noise are dropped, and the rest is differentiated in the frequency domain.
    """
    figure = new_figure(4.2)
    panels = figure.subplots(3, 2, sharex="col", width_ratios=(2.2, 1))
    measured = record.outputs["q_m1"]
    kept = differentiate(measured, record.sample_time)
    differences = np.gradient(measured, record.sample_time)
    begin = record.time[0] + 0.45 * np.ptp(record.time)
    inside = (record.time >= begin) & (record.time <= begin + 0.25)
    for column, part in enumerate((slice(None), inside)):
        time = record.time[part]
        voltage, angle, speed = panels[:, column]
        voltage.plot(time, record.inputs["u1"][part], color="black", lw=0.8)
        angle.plot(time, measured[part], color=GREY, lw=1.6, label="encoder")
        angle.plot(time, kept.position[part], color=COLOURS[0], lw=0.9, label="band-limited")
        speed.plot(time, differences[part], color=GREY, lw=0.6, label="differences")
        speed.plot(time, kept.velocity[part], color=COLOURS[0], lw=0.9, label=r"$j\omega$ in the band")
        speed.set_xlabel("time [s]")
        for axes in panels[:, column]:
            axes.margins(x=0)
            pad(axes)
    panels[0, 0].set_ylabel(r"voltage $u_1$ [V]")
    panels[1, 0].set_ylabel(r"motor angle $q_\mathrm{m1}$ [rad]")
    panels[2, 0].set_ylabel("motor speed\n" + r"$\dot q_\mathrm{m1}$ [rad/s]")
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
        desired, motions = result.desired[:, joint], result.angle[:, joint]
        if what == "motion":
            axes.plot(result.time, desired, color=GREY, lw=2.4, alpha=0.75, label="desired")
            axes.set_ylabel(rf"joint angle $q_{joint + 1}$ [rad]")
        else:
            axes.axhline(0.0, color="black", lw=0.5)
            motions = 1e3 * (desired[:, None] - motions)
            axes.set_ylabel(rf"error of $q_{joint + 1}$ [mrad]")
        for k, model in enumerate(result.models):
            axes.plot(result.time, motions[:, k], color=COLOURS[k], ls=DASHES[k], lw=0.9, label=model)
        axes.set_xlabel("time [s]")
        axes.margins(x=0)
        pad(axes)
        axes.set_title(title, loc="left")
    legend_above(figure, grid[0])
    return figure


@journal()
def friction_figure(
    motors: Sequence[tuple[str, StageResult, str]], link: StageResult | None = None, top: float = 300.0
) -> Figure:
    """Figs 13 and 14: identified friction torque over velocity, each with its truth; the link's own beside it.

    Args:
        motors: label, stage, and what the motor's parameters end in: eq. (15)-(16) with the stage's estimate.
        link: the stage whose friction at the link, eq. (9), is shown.
        top: largest speed of the motors [rad/s].
    """
    figure = new_figure(2.9)
    panels = np.ravel(figure.subplots(1, 2 if link else 1, width_ratios=(2, 1) if link else (1,)))
    for k, (label, result, motor) in enumerate(motors):
        for speed in (np.linspace(-top, -1e-6, 400), np.linspace(1e-6, top, 400)):  # with a gap at rest
            torques, forwards = [], bool(speed[0] > 0)
            for values in _truth_and_estimate(result):
                dry = AsymmetricStribeck(**{name: values[name + motor] for name in LEVELS})
                level = dry.levels(speed)[0 if forwards else 1]
                torques.append(1e3 * (np.sign(speed) * level + values["f_3" + motor] * speed))
            panels[0].plot(speed, torques[0], color=COLOURS[k], lw=2.6, alpha=0.3, solid_capstyle="butt")
            name = label if forwards else None
            panels[0].plot(speed, torques[1], color=COLOURS[k], ls=DASHES[k], lw=1.1, label=name)
    panels[0].plot([], [], color=GREY, lw=2.6, alpha=0.5, label="truth (pale)")
    panels[0].set(xlabel="motor speed [rad/s]", ylabel="friction torque at the motor [mN m]")
    if link is not None:
        speed, colour = np.linspace(-0.15, 0.15, 801), COLOURS[len(motors)]
        pale, plain = ({"lw": 2.6, "alpha": 0.3}, {"lw": 1.1, "label": r"$\tau_\mathrm{fa}$, flexible"})
        for values, look in zip(_truth_and_estimate(link), (pale, plain), strict=True):
            torque = np.where(speed > 0, values["f_a1"], values["f_a2"]) * np.tanh(70 * speed)
            panels[1].plot(speed, 1e3 * torque, color=colour, **look)
        panels[1].set(xlabel="link speed [rad/s]", ylabel="friction torque at the link [mN m]")
    for axes in panels:
        axes.axhline(0, color="black", lw=0.4)
        axes.axvline(0, color="black", lw=0.4)
        axes.legend(loc="upper left")
    return figure


def _truth_and_estimate(result: StageResult) -> list[dict[str, float]]:
    """Parameters of the selected set's own run, and the set itself; the machine's where a run does not tell them."""
    tables = ((result.truth, result.truths), (result.held, result.values))
    return [
        {**known, **dict(zip(result.names, values[result.selected], strict=True))} for known, values in tables
    ]


LEAD = (
    "Bahrami, Keshmiri, Keshmiri and Taghirad, “Identifying a two linked robot with non-symmetrical modified friction "
    "and backlash-flexibility models”, walked through on digital twins whose truth is known. The twins' disturbances "
    "and seeds were fixed before the first fit; nothing is tuned to a printed value."
)
QUICK = "In short: two records of a second in each stage, for which the targets are not meant."
SHOWN = "Shown is the first seed, whose mathematical model has too"
CAPTIONS = {
    "figure_03": "Fig. 3. Preprocessing of one experiment: the Fourier transform of the encoder's angle, unwanted "
    "frequencies dropped, differentiated by jω.",
    "figure_04": "Fig. 4. Three models follow a sine (left), and their tracking errors (right). {shown} {first}.",
    "figure_05": "Fig. 5. The link behind a gear with play follows a sine: rigid model and backlash-flexible model of "
    "the same machine (left), and their tracking errors (right).",
    "figure_08": "Fig. 8. Three models follow a trajectory: joint 1 (left), joint 2 (right).",
    "figure_09": "Fig. 9. Tracking errors of joint 1 (left) and joint 2 (right). {shown} {first} and too {second}.",
    "figure_13": "Fig. 13. Friction torque over velocity of the first link: solid body and flexible model. Pale: the "
    "machine's own. All levels scale with the data sheet's P_m1, and P_m2 and the viscous slope make up for each "
    "other: they are indistinguishable from voltage and angle. The intervals say so; the curves are those of one set.",
    "figure_14": "Fig. 14. Friction torque over velocity of the second link in three stages.",
}


def paper_page(result: Reproduction, *, quick: bool = False) -> tuple[Page, dict[str, np.ndarray]]:
    """The page, and every figure on it by the name of its file.

    Args:
        result: all results.
        quick: whether the results are those of the short run.
    """
    stages, loops = result.stages, result.tracking
    alone = (("motion", 0, ""), ("error", 0, ""))
    joints = ((0, "joint 1"), (1, "joint 2"))
    first_link = [
        (r"$\tau_\mathrm{f}$, rigid", stages["link1"], ""),
        (r"$\tau_\mathrm{fm}$, flexible", stages["link1_flexible"], ""),
    ]
    second_link = [
        (r"$\tau_\mathrm{f}$, high velocity", stages["link2_high"], ""),
        (r"$\tau_\mathrm{f}$, low velocity", stages["link2_low"], ""),
        (r"$\tau_\mathrm{f2}$, both links", stages["both_links"], "m2"),
    ]
    both = loops["both_links"]
    drawn = {
        "figure_03": preprocessing_figure(result.record),
        "figure_04": tracking_figure(loops["one_link"], alone),
        "figure_05": tracking_figure(loops["backlash"], alone),
        "figure_08": tracking_figure(both, [("motion", joint, title) for joint, title in joints]),
        "figure_09": tracking_figure(both, [("error", joint, title) for joint, title in joints]),
        "figure_13": friction_figure(first_link, stages["link1_flexible"]),
        "figure_14": friction_figure(second_link),
    }
    figures = {name: pixels(figure) for name, figure in drawn.items()}
    first, second = (
        f"{'much' if sign > 0 else 'little'} inertia at link {link}"
        for link, sign in enumerate(inertia_signs(0), start=1)
    )
    verdict = f"{sum(claim.met for claim in result.claims)} of {len(result.claims)} claims are met."
    page = Page("The paper on digital twins", " ".join([verdict, LEAD, *([QUICK] if quick else [])]))

    def section(title: str, *things: RenderableType) -> None:
        """A heading and, under it, what is on the page: words, tables, and figures by their names."""
        under = page.section(title)
        for thing in things:
            if isinstance(thing, str) and thing in figures:
                under.figure(figures[thing], CAPTIONS[thing].format(shown=SHOWN, first=first, second=second))
            else:
                under.add(thing)

    def stage(name: str, title: str, *things: RenderableType) -> None:
        found, numbers = stages[name], PRINTED[name].numbers
        section(
            title,
            f"Table {numbers[0]}: {len(found.values)} experiments, set {found.selected + 1} is selected. "
            "The truth is that of the selected set's own run.",
            _parameters(name, found),
            *(f"check: {words}" for words in found.words),
            *(f"not converged: {words}" for words in found.failed),
            f"Table {numbers[1]}: fit of the selected set over all experiments, and of each set on its own record.",
            _fits(name, found),
            *things,
        )

    section("What was to be shown", claims_table(result.claims))
    constants = [(n, f"{v:.5g}", "N m/V" if "P_m1" in n else "V s/rad") for n, v in TABLE_1.items()]
    section(
        "II: motors and preprocessing",
        "Table 1: motor constants of the data sheets.",
        table(("parameter", "printed>", "unit"), constants),
        "figure_03",
    )
    stage(
        "link1",
        "III.A-B: first link, solid body",
        "A set fits its own record almost wholly. On the others it meets friction that has drifted from run to run: "
        "nothing pulls the angle back, so the difference adds up over a free run, and the position wanders. The true "
        "parameters of the same run wander alike; velocity hardly shows it.",
        "figure_04",
    )
    stage("link1_flexible", "III.D: first link, flexible with backlash", "figure_05")
    stage("link2_high", "IV: second link, high velocity")
    stage("link2_low", "IV: second link, low velocity")
    stage("both_links", "V: both links", "figure_08", "figure_09")
    section(
        "VI-VII: friction and inertia compared",
        "figure_13",
        "figure_14",
        "Table 12: inertia of the second link. On the right the standard error from one record.",
        _inertia(stages),
        "Why low velocity identifies the inertia worse than high velocity: the motor stays on the flank of the "
        "friction peak and stands still in between, so accelerations are small and the inertia's torque is a small "
        "part of friction's, whose error then passes into P_2. Of the records of both links, too, those in which joint "
        "2 moves slowest identify P_2 least. The paper's own 36 % between its stages does not come from this alone: "
        "here the model has the machine's structure.",
    )
    section(
        "Tracking errors",
        "Computed torque with the same gains and voltage limit for all models. MM: Table 1 and each link's inertia off "
        "by 25 %, up or down by seed; IFLRM: identified motor and inertia, no friction; IFRM: all that was identified. "
        "Errors at the link, mean ± standard deviation over the seeds.",
        _tracking(loops),
        "A mathematical model with too much inertia also closes a stiffer loop, since the gains act through it, and "
        "friction moves that less: a single seed may beat IFLRM; the table of claims has the paired test.",
    )
    return page, figures
