"""A hybrid training as one page: what the networks win, then what they do to the parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping

from rich.text import Text

from hybrid_id.records.dataset import Dataset
from hybrid_id.reporting.html.interactive import Drawn
from hybrid_id.reporting.html.page import Page
from hybrid_id.reporting.hybrid import drift_table, error_table, ladder_table, role_table
from hybrid_id.reporting.parameter_tables import GRADES
from hybrid_id.reporting.residual_words import Residuals, residual_blocks
from hybrid_id.reporting.tables import count, records_table
from hybrid_id.study import Study
from hybrid_id.study.hybrid import HybridStudy

_LADDER = (
    "1 is as the weights say. All are errors of free runs from measured first states; the typical validation error is "
    "the geometric mean over ten parts of each record, for a run that has lost its record says little from there on. "
    "The errors further down are the RMS of whole free runs."
)
_GRADED = (
    "A grade is that of physics alone, as identify would give it: beside a network there is no second way to compute "
    "an error. A network that could do a parameter's work leaves only the price to hold its value."
)


def _lead(study: HybridStudy) -> str:
    """The outcome in plain words."""
    rungs, chosen, warnings = study.result.rungs, study.result.chosen, study.warnings
    if not chosen:
        words = warnings[0] if warnings else "physics alone is kept"
        return f"{words[0].upper()}{words[1:]}."
    before, after = (math.sqrt(2.0 * rungs[k].validation) for k in (0, chosen))
    words = (
        f"{count(len(study.roles), 'network')} beside the physics, at the price {rungs[chosen].price:g}: the "
    )
    words += (
        f"typical error on validation records falls from {before:.3g} to {after:.3g} (1: as the noise says)."
    )
    told = count(len(warnings), "warning")
    return (
        f"{words} Read the {told} below before you read the parameters."
        if warnings
        else (f"{words} No network does the physics' work.")
    )


def hybrid_page(
    dataset: Dataset,
    study: HybridStudy,
    pictures: Mapping[str, Drawn],
    *,
    reach: float,
    level: float,
    alone: Study,
    residuals: Residuals,
) -> Page:
    """The page of a hybrid training.

    Args:
        dataset: the records.
        study: the result.
        pictures: its pictures by name.
        reach: half-width of an interval in standard errors.
        level: level of the intervals.
        alone: physics alone as `identify` would judge it.
        residuals: tests of what physics alone and the chosen system leave.
    """
    result = study.result
    page = Page(f"Physics and networks on {dataset.name}", _lead(study))
    warnings = (Text(f"{words[0].upper()}{words[1:]}.", style="yellow") for words in study.warnings)
    parameters = page.section("Parameters").add(
        drift_table(study, reach, level, alone), GRADES, _GRADED, *warnings
    )
    networks = page.section("Networks")
    if result.chosen:
        parameters.figure(
            pictures["drift"],
            "How far each parameter moved when the networks came in; grey: within three standard errors.",
        )
    else:
        networks.add("What the networks of the lowest price have learnt; they are not kept.")
    networks.add(role_table(study.roles))
    for name, picture in pictures.items():
        if name.startswith("map_"):
            networks.figure(picture, "Output over speed and angle; black: where the records have been.")
    page.section("Ladder of prices").add(_LADDER, ladder_table(study))
    page.section("Errors").add(error_table(study, dataset))
    role = "test" if dataset.test else "train"
    records = count(len(dataset.test or dataset.train), f"{role} record")
    page.section("Residuals").add(*residual_blocks(residuals, records))
    page.section("Records").add(records_table(dataset))
    return page
