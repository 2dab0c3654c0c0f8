"""Ours beside the printed: rows of the paper's tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hybrid_id.machines.twin import paper
from hybrid_id.reproduction.result import StageResult


@dataclass(frozen=True)
class Printed:
    """What the paper prints of one stage: numbers and rows of its two tables, and how its names become ours."""

    parameters: int
    fits: int
    rows: Mapping[str, paper.Variation]
    fit_rows: Mapping[str, paper.Fit]
    names: Mapping[str, tuple[str, float]]


def _names(motor: str = "", **others: tuple[str, float]) -> dict[str, tuple[str, float]]:
    friction = ("f_11", "f_12", "f_13", "f_14", "f_21", "f_22", "f_23", "f_24", "f_3")
    return {f"{name}{motor}": (name, 1.0) for name in friction} | others


_LINK_2 = _names("m2", P_2=("J", paper.GEAR_RATIO[1] ** 2), q_m2=("q_m1", 1.0), v_m2=("v_m1", 1.0))
PRINTED = {
    "link1": Printed(2, 3, paper.TABLE_2, paper.TABLE_3, {}),
    "link1_flexible": Printed(4, 5, paper.TABLE_4, paper.TABLE_5, {}),
    "link2_high": Printed(6, 8, paper.TABLE_6, paper.TABLE_8, _LINK_2),
    "link2_low": Printed(7, 9, paper.TABLE_7, paper.TABLE_9, _LINK_2),
    "both_links": Printed(10, 11, paper.TABLE_10, paper.TABLE_11, {}),
}


@dataclass(frozen=True)
class ParameterRow:
    """One parameter of Tables 2, 4, 6, 7 and 10.

    Attributes:
        name: as printed.
        unit: its unit.
        value: our selected set's.
        truth: of that set's own run.
        interval: half-width of our 95 % interval.
        percent: our std/mean [%].
        predicted: standard error that the least informative record leaves [%].
        typical: the same of a typical record, the median [%].
        scatter: std/mean of the runs' own true values [%].
        printed: the paper's row.
        role: "free", "prior" or "stage", which says what holds it.
    """

    name: str
    unit: str
    value: float
    truth: float
    interval: float
    percent: float
    predicted: float
    typical: float
    scatter: float
    printed: paper.Variation
    role: str

    @property
    def covered(self) -> bool:
        """Whether the interval that is claimed holds the truth."""
        return bool(np.isfinite(self.interval)) and abs(self.value - self.truth) <= self.interval

    @property
    def below(self) -> bool:
        """Whether our std/mean lies below the printed one."""
        return self.percent < self.printed.percent

    @property
    def remark(self) -> str:
        """Why a row makes no claim, or why it is above."""
        if self.role == "stage":
            return "held from the stage before"
        if self.role == "prior":
            return "held by the data sheet's prior"
        if self.below:
            return ""
        if self.scatter > 0.5 * self.percent:
            return f"the runs' true values themselves scatter by {self.scatter:.2f} %"
        return f"± {self.predicted:.2g} % from the record that says least"


@dataclass(frozen=True)
class FitRow:
    """One signal of Tables 3, 5, 8, 9 and 11: fit % of the selected set over the records.

    Attributes:
        name: of the signal, as printed.
        mean, std: over the records.
        own: mean fit of each set on its own record, where friction has not drifted.
        truth, truth_std: mean and std with the true parameters of the selected set's run.
        printed: the paper's row.
    """

    name: str
    mean: float
    std: float
    own: float
    truth: float
    truth_std: float
    printed: paper.Fit

    @property
    def percent(self) -> float:
        """std/mean [%]."""
        return 100 * self.std / self.mean


def parameter_rows(stage: str, result: StageResult, truth: Mapping[str, float]) -> list[ParameterRow]:
    """The rows of a stage's table of parameters.

    Args:
        stage: name of the stage.
        result: what came of it.
        truth: the twin's own parameters, for those that are held.
    """
    rows, table = [], PRINTED[stage]
    for name, printed in table.rows.items():
        own, factor = table.names.get(name, (name, 1.0))
        if own in result.held:
            value = factor * result.held[own]
            rows.append(
                ParameterRow(
                    name, "", value, factor * truth[own], np.inf, 0.0, np.nan, np.nan, 0.0, printed, "stage"
                )
            )
            continue
        k = result.names.index(own)
        estimates, own_truths = factor * result.values[:, k], factor * result.truths[:, k]
        errors = 100 * result.std_error[:, k] / np.abs(result.values[:, k])
        rows.append(
            ParameterRow(
                name=name,
                unit=result.units[k],
                value=estimates[result.selected],
                truth=own_truths[result.selected],
                interval=factor * result.interval[k],
                percent=result.percent[k],
                predicted=float(errors.max()),
                typical=float(np.median(errors)),
                scatter=100 * own_truths.std(ddof=1) / abs(own_truths.mean()),
                printed=printed,
                role="prior" if own in result.by_prior else "free",
            )
        )
    return rows


def fit_rows(stage: str, result: StageResult) -> list[FitRow]:
    """The rows of a stage's table of fits."""
    rows, table = [], PRINTED[stage]
    fits = result.fits[result.selected]
    for name, printed in table.fit_rows.items():
        k = result.signals.index(table.names.get(name, (name, 1.0))[0])
        rows.append(
            FitRow(
                name,
                fits[:, k].mean(),
                fits[:, k].std(ddof=1),
                result.fits.diagonal()[k].mean(),
                result.truth_fits[:, k].mean(),
                result.truth_fits[:, k].std(ddof=1),
                printed,
            )
        )
    return rows


def inertia_rows(
    stages: Mapping[str, StageResult], truths: Mapping[str, Mapping[str, float]]
) -> dict[str, ParameterRow]:
    """P_2 in the three stages of Table 12."""
    names = dict(zip(("link2_high", "link2_low", "both_links"), paper.TABLE_12, strict=True))
    return {
        title: next(row for row in parameter_rows(stage, stages[stage], truths[stage]) if row.name == "P_2")
        for stage, title in names.items()
        if stage in stages
    }
