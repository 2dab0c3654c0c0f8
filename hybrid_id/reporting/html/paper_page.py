"""The paper's tables and figures on one page, ours beside the printed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from hybrid_id.reporting.html.interactive import Drawn, drawn
from hybrid_id.reporting.html.page import Page, Section
from hybrid_id.reporting.paper_figures import (
    friction_figure,
    preprocessing_figure,
    spread_figure,
    tracking_figure,
    two_errors_figure,
    two_motions_figure,
)
from hybrid_id.reporting.paper_tables import (
    claims_table,
    fits_table,
    inertia_table,
    motors_table,
    parameters_table,
    tracking_table,
)
from hybrid_id.reproduction.claims import Claim
from hybrid_id.reproduction.comparison import PRINTED, fit_rows, inertia_rows, parameter_rows
from hybrid_id.reproduction.curves import friction_curve, link_friction_curve
from hybrid_id.reproduction.run import Reproduction
from hybrid_id.reproduction.tracking import inertia_signs

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
    "Why low velocity tells the inertia worse than high velocity: the motor stays on the flank of the friction peak "
    "and stands still in between, so accelerations are small and the inertia's torque is a small part of friction's, "
    "whose error then passes into P_2. Of the records of both links, too, those in which joint 2 moves slowest tell "
    "P_2 least. The paper's own 36 % between its stages does not come from this alone: here the model has the "
    "machine's structure."
)


DRIFT = (
    "A set fits its own record almost wholly. On the others it meets friction that has drifted from run to run: "
    "nothing pulls the angle back, so the difference adds up over a free run, and the position wanders. The true "
    "parameters of the same run wander alike; velocity hardly shows it."
)
QUICK = "In short: two records of a second in each stage, for which the targets are not meant."
SCALE = (
    "Pale: the machine's own. All levels scale with the data sheet's P_m1, and P_m2 and the viscous slope make up for "
    "each other: voltage and angle do not tell them apart. The intervals say so; the curves are those of one set."
)


def paper_figures(result: Reproduction) -> dict[str, Drawn]:
    """Every figure by the name of its file."""
    stages, truths, tracking = result.stages, result.truths, result.tracking
    one, both = tracking["one_link"], tracking["both_links"]
    rigid, flexible = (
        friction_curve(label, stages[name], truths[name])
        for label, name in (
            (r"$\tau_\mathrm{f}$, rigid", "link1"),
            (r"$\tau_\mathrm{fm}$, flexible", "link1_flexible"),
        )
    )
    second = [
        friction_curve(label, stages[name], truths[name], motor=motor)
        for label, name, motor in (
            (r"$\tau_\mathrm{f}$, high velocity", "link2_high", ""),
            (r"$\tau_\mathrm{f}$, low velocity", "link2_low", ""),
            (r"$\tau_\mathrm{f2}$, both links", "both_links", "m2"),
        )
    ]
    spread = [
        ("one link", one, 0),
        ("both, joint 1", both, 0),
        ("both, joint 2", both, 1),
        ("backlash", tracking["backlash"], 0),
    ]
    figures = {
        "figure_03": preprocessing_figure(result.record),
        "figure_04": tracking_figure(one),
        "figure_05": tracking_figure(tracking["backlash"]),
        "figure_08": two_motions_figure(both),
        "figure_09": two_errors_figure(both),
        "figure_13": friction_figure([rigid, flexible], link_friction_curve(stages["link1_flexible"])),
        "figure_14": friction_figure(second),
        "tracking_spread": spread_figure(spread),
    }
    return {name: drawn(figure) for name, figure in figures.items()}


def paper_page(
    result: Reproduction, claims: Sequence[Claim], figures: Mapping[str, Drawn], *, quick: bool = False
) -> Page:
    """The page.

    Args:
        result: all results.
        claims: what was to be shown, and what was seen.
        figures: those of the paper by name.
        quick: whether the results are those of the short run.
    """
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
        "Table 12: inertia of the second link. On the right the standard error that one record leaves.",
        inertia_table(inertia_rows(result.stages, result.truths)),
        LOW,
    )
    tracking = page.section("Tracking errors")
    tracking.add(
        "Computed torque with the same gains and voltage limit for all models. MM: Table 1 and each link's inertia off "
        "by 25 %, up or down by seed; IFLRM: identified motor and inertia, no friction; IFRM: all that was identified. "
        "Errors at the link, mean ± standard deviation over the seeds.",
        tracking_table(result.tracking),
        "A mathematical model with too much inertia also closes a stiffer loop, since the gains act through it, and "
        "friction moves that less: seed by seed such a model may beat IFLRM, on average it does not.",
    )
    tracking.figure(figures["tracking_spread"], "RMS error of every seed; the bar is their mean.")
    return page


def _stage(section: Section, stage: str, result: Reproduction) -> None:
    found, table = result.stages[stage], PRINTED[stage]
    rows = parameter_rows(stage, found, result.truths[stage])
    section.add(
        f"Table {table.parameters}: {len(found.values)} experiments, set {found.selected + 1} is selected. "
        "The truth is that of the selected set's own run.",
        parameters_table(rows),
    )
    for words in found.words:
        section.add(f"check: {words}")
    for words in found.failed:
        section.add(f"not converged: {words}")
    section.add(
        f"Table {table.fits}: fit of the selected set over all experiments, and of each set on its own record.",
        fits_table(fit_rows(stage, found)),
    )
    if stage == "link1":
        section.add(DRIFT)


def _pictures(section: Section, stage: str, figures: Mapping[str, Drawn]) -> None:
    if stage == "link1":
        section.figure(
            figures["figure_04"],
            "Fig. 4. Three models follow a sine (left), and their tracking errors (right). " + _first_seed(1),
        )
    elif stage == "link1_flexible":
        section.figure(
            figures["figure_05"], "Fig. 5. The link behind a gear with play follows a sine: rigid model and "
            "backlash-flexible model of the same machine (left), and their tracking errors (right).",
        )  # fmt: skip
    elif stage == "both_links":
        section.figure(
            figures["figure_08"], "Fig. 8. Three models follow a trajectory: joint 1 (left), joint 2 (right)."
        )
        section.figure(
            figures["figure_09"],
            "Fig. 9. Tracking errors of joint 1 (left) and joint 2 (right). " + _first_seed(2),
        )


def _first_seed(links: int) -> str:
    """Which run a figure of MM, IFLRM and IFRM shows."""
    off = [
        f"{'much' if sign > 0 else 'little'} inertia at link {link}"
        for link, sign in enumerate(inertia_signs(0)[:links], start=1)
    ]
    return f"Shown is the first seed, whose mathematical model has too {' and too '.join(off)}."
