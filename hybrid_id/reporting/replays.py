"""Records replayed through models as one page: which follows them best, then record by record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hybrid_id.records.dataset import Dataset
from hybrid_id.records.quality import Finding
from hybrid_id.reporting.page import Page, records_section
from hybrid_id.reporting.study_figures import comparison_figure
from hybrid_id.reporting.style import pixels
from hybrid_id.reporting.tables import (
    comparison_table,
    count,
)
from hybrid_id.study import Comparison


def replay_figures(dataset: Dataset, comparison: Comparison) -> dict[str, np.ndarray]:
    """A picture a record, by its name."""
    return {name: pixels(comparison_figure(dataset, comparison, name)) for name in comparison.records}


def replay_page(
    dataset: Dataset,
    comparison: Comparison,
    figures: Mapping[str, np.ndarray],
    *,
    findings: Sequence[Finding] = (),
) -> Page:
    """The page of `simulate` (one model) and `compare` (several), with what the check of the records remarked."""
    labels = list(comparison.replays)
    title = (
        f"{labels[0]} on {dataset.name}" if len(labels) == 1 else f"{len(labels)} models on {dataset.name}"
    )
    page = Page(title, _lead(comparison))
    page.section("Errors").add(comparison_table(comparison), _HOW)
    pictures = page.section("Measured and simulated")
    for name, figure in figures.items():
        pictures.figure(figure, f"Record {name}.")
    records_section(page, dataset, findings)
    return page


_HOW = (
    "NRMSE: RMSE over the standard deviation of what was measured (0: exact, 1: as good as the signal's mean). Fit: "
    "100 % less the NRMSE in percent. All are means of the records."
)


def _lead(comparison: Comparison) -> str:
    """How well each model follows the records, the best one first."""
    errors = comparison.mean_error
    best, *others = sorted(errors, key=lambda label: errors[label])
    of = "records and outputs" if len(comparison.signals) > 1 else "records"
    first = f"{best}: NRMSE {errors[best]:.3g}, mean of {of}"
    after = "".join(f"; {label} {errors[label]:.3g}" for label in others)
    records = count(len(comparison.records), "record")
    return f"{first}{after} ({records}, horizon: {comparison.horizon})."
