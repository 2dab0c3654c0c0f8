"""A study as tables and as one page: parameters with intervals and reliability, then what they rest on."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from hybrid_id.records.dataset import Dataset
from hybrid_id.records.quality import Finding
from hybrid_id.reporting.page import Page, records_section
from hybrid_id.reporting.residuals import Residuals, residual_blocks, sound
from hybrid_id.reporting.tables import (
    count,
    identifiability_table,
    interval_words,
    table,
    two_a_row,
)
from hybrid_id.reporting.units import in_unit, shown_unit, title
from hybrid_id.statistics.uncertainty import normal_interval
from hybrid_id.study import Study
from hybrid_id.systems.chain import System

LEGEND = (
    "reliability: good where the ways to compute the error agree (the plain covariance alone may be too confident), "
    "doubtful where they disagree or std/mean is 30 % or more, not on its own where the value must not be used alone"
)
ALONE = (
    "intervals: the motion of the other joints is taken as measured and held over each sample; its noise is {} them{}, "
    "the holding is not; the whole robot, identified without --joint, has narrower ones"
)
_STYLE = {"good": "green", "doubtful": "yellow", "not on its own": "red"}


def study_table(study: Study, *, full: bool = False) -> RenderableType:
    """Parameters of the selected set with intervals, their variation and reliability, and what follows.

    With ``full`` also the reasons of the reliability and, in a table of its own, what the fit started from (nominal
    value, prior, bounds), for which a terminal has no room; what matters most comes first, for a phone has no more.
    """
    intervals, spread = study.intervals(), study.variation
    value_heads = ["pooled set>" if study.pooled else f"set {study.selection.name}>"]
    value_heads += [f"{100 * study.level:g} % interval>", "unit"]
    spread_heads = [] if spread is None else ["mean of sets>", "std/mean>"]
    rows = []
    for k, name in enumerate(study.names):
        info = study.selected_model.parameter(name)
        unit, factor = shown_unit(info.unit, study.outputs)
        value = [f"{factor * study.selected.values[k]:.5g}", interval_words(*(factor * intervals[k])), unit]
        varies = []
        if spread is not None:
            colour = "" if spread.acceptable[k] or spread.held[k] else "red"
            varies = [f"{factor * spread.mean[k]:.5g}", Text(f"{spread.percent[k]:.2f} %", style=colour)]
        word, *_, why = reliability_cells(study, name)
        rows.append(
            [name, word, *value, info.doc, *varies, why] if full else [name, info.doc, *value, *varies, word]
        )
    heads = ["parameter", "meaning", *value_heads, *spread_heads, "reliability"]
    if full:
        heads = ["parameter", "reliability", *value_heads, "meaning", *spread_heads, "why"]
    found = table(heads, rows)
    starts = []
    if full:
        rows = []
        for name, unit in zip(study.names, study.selected.units, strict=True):
            unit, factor = shown_unit(unit, study.outputs)
            spec, prior = study.system.parameter(name).spec, "none"
            if spec.prior_std is not None:
                prior = f"{factor * spec.prior_std:.3g}"
                if spec.prior_mean is not None and spec.prior_mean != spec.value:
                    prior += f" about {factor * spec.prior_mean:.5g}"
            bounds = bound_cells(study.selected_model, name, factor)
            rows.append([name, f"{factor * spec.value:.5g}", prior, *bounds, unit])
        heads = ("parameter", "nominal>", "prior std>", "lower bound>", "upper bound>", "unit")
        starts.append(table(heads, rows))
    failed = [result for result in study.sets if not result.ok]
    ends = [f"{', '.join(list(dict.fromkeys(r.records))[:3])}: {r.message}" for r in failed[:3]]
    worse = [study.beside_nominal.words] if study.beside_nominal.worse else []
    first = [
        *([] if full else [Text(_usable(study))]),
        *(Text(line, style="red") for line in (*ends, *worse)),
    ]
    return Group(
        *first, found, *combinations_table(study), *starts, *(Text(line) for line in _remarks(study))
    )


def reliability_cells(study: Study, name: str) -> list[Text]:
    """Reliability, lower and upper bound of a parameter of the selected set, and why it is not more reliable."""
    one = study.reliability[study.names.index(name)]
    word, why = one.words, "" if one.grade == "A" else one.reason
    _, factor = shown_unit(study.selected_model.parameter(name).unit, study.outputs)
    return [Text(word, style=_STYLE[word]), *bound_cells(study.selected_model, name, factor), Text(why)]


def bound_cells(system: System, name: str, factor: float = 1.0) -> list[Text]:
    """Lower and upper bound of a parameter times a factor; the one that its value has reached is marked."""
    spec, cells = system.parameter(name).spec, []
    for bound in (spec.lower, spec.upper):
        at = abs(spec.value - bound) <= 1e-9 * max(abs(spec.value), 1e-300)
        words = f"{factor * bound:.4g}" if np.isfinite(bound) else "none"
        cells.append(Text(f"{words}, reached", style="red") if at else Text(words))
    return cells


def combinations_table(study: Study) -> list[Table]:
    """The functions of parameters that do have an interval where parameters alone have none; no table without any."""
    if study.identifiability.claimable.all():
        return []
    found, index = study.combinations, study.selection.index
    intervals = normal_interval(found.values[index], found.std_error[index], study.level)
    heads = ["what is identified", "value>", f"{100 * study.level:g} % interval>"]
    rows = [
        [name, f"{value:.5g}", interval_words(*ends)]
        for name, value, ends in zip(found.names, found.values[index], intervals, strict=True)
        if name not in study.names
    ]
    if not rows:
        return []
    if found.variation is None:
        return [two_a_row(heads, rows)]
    percent = dict(zip(found.names, found.variation.percent, strict=True))
    return [table([*heads, "std/mean>"], ([*row, f"{percent[row[0]]:.2f} %"] for row in rows))]


def _remarks(study: Study) -> list[str]:
    lines = [LEGEND]
    if study.system.seats is not None:
        but = ", not in profile likelihoods" if study.profiles else ""
        lines.append(ALONE.format("not in", "") if study.input_error is None else ALONE.format("in", but))
    lines += [] if study.horizon.kind == "whole" else [f"horizon: {study.horizon}"]
    lines += [f"identifiability: {direction.text}" for direction in study.identifiability.directions]
    hits = [sum(name in result.at_bound for result in study.sets) for name in study.names]
    if any(hits):
        of = f" (in {{}} of {len(study.sets)} sets)" if len(study.sets) > 1 else ""
        words = [name + of.format(n) for name, n in zip(study.names, hits, strict=True) if n]
        lines.append(f"at a bound: {', '.join(words)}")
    if len(study.sets) > 1 or not study.selection.candidate.any():
        lines.append(f"selection: {study.selection.summary()}")
    if study.test_nrmse:
        seen = count(len(study.test_nrmse), "record")
        lines.append(f"test: RMSE on {seen} that no fit has seen: {test_words(study)}")
    lines.append(f"integration error (step halved): {study.engine_error:.2g} standard errors at most")
    lines += [f"profile likelihood of {name}: {one.message}" for name, one in study.profiles.items()]
    return lines


def test_words(study: Study) -> str:
    """Error of the selected set in each output on the test records, in the unit that was logged, and normalised."""
    said = [
        f"{title(name, study.outputs)} {' '.join(in_unit(name, [one.rmse], study.outputs, study.system))} "
        f"({'it stands still' if math.isnan(one.nrmse) else f'normalised {one.nrmse:.4g}'})"
        for name, one in study.test_errors.items()
    ]
    mean = f"; normalised, mean of the outputs, {study.test_error:.4g}" if len(said) > 1 else ""
    return ", ".join(said) + mean


_CAPTIONS = {
    "parameters": "Each parameter over the experiments, with its interval where one may be claimed.",
    "cross_validation": "Fit of every parameter set on every record, by which the set is selected: mean of the outputs "
    "and, as in the paper, of the motors' speeds (v_m1 ...), which where they are not recorded are the smoothed "
    "derivatives of the angles.",
    "profiles": "Profile likelihoods: the least cost over all other parameters, above the least of all; the interval "
    "is where it stays below the dashed line. The grey parabola is what the standard error says.",
    "residuals": "Residuals of the selected set on the records that it was fitted to: autocorrelation, distribution.",
}


def study_page(
    dataset: Dataset,
    study: Study,
    figures: Mapping[str, np.ndarray],
    *,
    findings: Sequence[Finding] = (),
    residuals: Residuals | None = None,
) -> Page:
    """The page of a study, with what the check of the records remarked, and tests of the selected set's residuals."""
    page = Page(f"Identification of {dataset.name}", _lead(dataset, study, residuals))
    page.section("Parameters").add(study_table(study, full=True))
    identified = page.section("What these records identify").add(identifiability_table(study.identifiability))
    residual, fits = page.section("Residuals"), page.section("Measured and simulated")
    if residuals:
        residual.add(*residual_blocks(residuals, channels=study.outputs))
    for name, figure in figures.items():
        if name in ("parameters", "profiles"):
            identified.figure(figure, _CAPTIONS[name])
        elif name == "residuals":
            residual.figure(figure, _CAPTIONS[name])
        elif name == "cross_validation":
            page.section("Every set on every record").figure(figure, _CAPTIONS[name])
        else:
            fits.figure(figure, f"Record {name.removeprefix('fit_')}.")
    records_section(page, dataset, findings)
    return page


def _usable(study: Study) -> str:
    """How many parameters may be used by themselves."""
    usable = sum(one.grade in ("A", "B") for one in study.reliability)
    return f"{usable} of {count(len(study.names), 'parameter')} can be relied on."


def _lead(dataset: Dataset, study: Study, residuals: Residuals | None) -> str:
    """The outcome in plain words: how many parameters to rely on, then how they were found and what they predict."""
    kind = "One parameter set over all records" if study.pooled else "One parameter set for each record"
    words = f"{_usable(study)} {kind} ({count(len(dataset.train), 'train record')})."
    if not study.pooled and len(study.sets) > 1:
        words += f" Set {study.selection.name} carries over best."
    if study.test_nrmse:
        words += f" RMSE on {count(len(study.test_nrmse), 'unseen record')}: {test_words(study)}."
    if residuals:
        noise = all(map(sound, residuals.values()))
        words += f" Its residual is {'noise' if noise else 'not only noise: see Residuals'}."
    unclaimed = study.identifiability.not_claimable
    if unclaimed:
        words += f" These records give no interval for {', '.join(unclaimed)}."
    return words
