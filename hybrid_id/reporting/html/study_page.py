"""A study as one page: what was found, how far to trust it, and the pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from hybrid_id.records.dataset import Dataset
from hybrid_id.records.finding import Finding
from hybrid_id.reporting.html.interactive import Drawn
from hybrid_id.reporting.html.page import Page
from hybrid_id.reporting.parameter_tables import study_table
from hybrid_id.reporting.residual_words import Residuals, residual_blocks, sound
from hybrid_id.reporting.tables import (
    count,
    findings_list,
    identifiability_table,
    records_table,
)
from hybrid_id.study import Study

_CAPTIONS = {
    "parameters": "Each parameter over the experiments, with its interval where one may be claimed.",
    "cross_validation": "Fit of every parameter set on every record.",
    "profiles": "Profile likelihoods: the least cost over all other parameters, above the least of all; the interval "
    "is where it stays below the dashed line. The grey parabola is what the standard error says.",
    "residuals": "What the selected set leaves of the records that it was fitted to: distribution and autocorrelation.",
}


def study_page(
    dataset: Dataset,
    study: Study,
    figures: Mapping[str, Drawn],
    *,
    reach: float,
    level: float,
    findings: Sequence[Finding] = (),
    residuals: Residuals | None = None,
) -> Page:
    """The page of a study.

    Args:
        dataset: the records.
        study: the result.
        figures: its pictures by name, with their interactive twins.
        reach: half-width of an interval in standard errors.
        level: level of the intervals.
        findings: what the check of the records remarked.
        residuals: tests of what the selected set leaves.
    """
    page = Page(f"Identification of {dataset.name}", _lead(dataset, study, residuals))
    page.section("Parameters").add(study_table(study, reach, level, full=True))
    told = page.section("What these records can tell").add(identifiability_table(study.identifiability))
    left, fits = page.section("Residuals"), page.section("Measured and simulated")
    if residuals:
        left.add(*residual_blocks(residuals))
    for name, figure in figures.items():
        if name in ("parameters", "profiles"):
            told.figure(figure, _CAPTIONS[name])
        elif name == "residuals":
            left.figure(figure, _CAPTIONS[name])
        elif name == "cross_validation":
            page.section("Every set on every record").figure(figure, _CAPTIONS[name])
        else:
            fits.figure(figure, f"Record {name.removeprefix('fit_')}.")
    records = page.section("Records").add(records_table(dataset))
    if findings:
        records.add(findings_list(findings))
    return page


def _lead(dataset: Dataset, study: Study, residuals: Residuals | None) -> str:
    """The outcome in plain words: how many parameters to rely on, then how they were found and what they predict."""
    usable = sum(one.grade in ("A", "B") for one in study.trust)
    verdict = f"{usable} of {count(len(study.names), 'parameter')} can be relied on (trust A or B)."
    kind = "One parameter set over all records" if study.pooled else "One parameter set for each record"
    words = f"{verdict} {kind} ({count(len(dataset.train), 'train record')})."
    if not study.pooled and len(study.sets) > 1:
        words += f" Set {study.selection.name} carries over best."
    if study.test_nrmse:
        words += f" On {count(len(study.test_nrmse), 'unseen record')} its normalised RMSE is {study.test_error:.3g}."
    if residuals:
        noise = all(map(sound, residuals.values()))
        words += f" What it leaves is {'noise' if noise else 'not only noise: see Residuals'}."
    unclaimed = study.identifiability.not_claimable
    if unclaimed:
        words += f" These records tell {', '.join(unclaimed)} only in combinations."
    return words
