"""A study as one page: what was found, how far to trust it, and the pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hybrid_id.records.dataset import Dataset
from hybrid_id.records.finding import Finding
from hybrid_id.reporting.html.live import Plot
from hybrid_id.reporting.html.page import Page
from hybrid_id.reporting.tables import (
    count,
    findings_list,
    identifiability_table,
    records_table,
    study_table,
)
from hybrid_id.study import Study

_CAPTIONS = {
    "parameters": "Each parameter over the experiments, with its interval where one may be claimed.",
    "cross_validation": "Fit of every parameter set on every record.",
    "profiles": "Profile likelihoods: the least cost over all other parameters, above the least of all; the interval "
    "is where it stays below the dashed line. The grey parabola is what the standard error says.",
    "residuals": "What the selected set leaves: its residuals, their distribution and their autocorrelation.",
}


def study_page(
    dataset: Dataset,
    study: Study,
    images: Mapping[str, np.ndarray],
    *,
    reach: float,
    level: float,
    findings: Sequence[Finding] = (),
    plots: Mapping[str, Plot] | None = None,
) -> Page:
    """The page of a study.

    Args:
        dataset: the records.
        study: the result.
        images: its pictures by name, (H, W, 3).
        reach: half-width of an interval in standard errors.
        level: level of the intervals.
        findings: what the check of the records remarked.
        plots: interactive twins of some pictures, by the same names.
    """
    plots = plots or {}
    page = Page(f"Identification of {dataset.name}", _lead(dataset, study))
    page.section("Parameters").add(study_table(study, reach, level))
    told = page.section("What these records can tell").add(identifiability_table(study.identifiability))
    records = page.section("Records").add(records_table(dataset))
    if findings:
        records.add(findings_list(findings))
    statistics, fits = page.section("Statistics"), page.section("Measured and simulated")
    for name, image in images.items():
        if name in ("parameters", "profiles"):
            told.picture(image, _CAPTIONS[name], plots.get(name))
        elif name in _CAPTIONS:
            statistics.picture(image, _CAPTIONS[name], plots.get(name))
        else:
            fits.picture(image, f"Record {name.removeprefix('fit_')}.", plots.get(name))
    return page


def _lead(dataset: Dataset, study: Study) -> str:
    """The outcome in plain words: how many parameters to rely on, then how they were found and what they predict."""
    sound = sum(one.grade in ("A", "B") for one in study.trust)
    verdict = f"{sound} of {count(len(study.names), 'parameter')} can be relied on (trust A or B)."
    kind = "One parameter set over all records" if study.pooled else "One parameter set for each record"
    words = f"{verdict} {kind} ({count(len(dataset.train), 'train record')})."
    if not study.pooled and len(study.sets) > 1:
        words += f" Set {study.selection.name} carries over best."
    if study.test_nrmse:
        words += f" On {count(len(study.test_nrmse), 'unseen record')} its normalised RMSE is {study.test_error:.3g}."
    unclaimed = study.identifiability.not_claimable
    if unclaimed:
        words += f" These records tell {', '.join(unclaimed)} only in combinations."
    return words
