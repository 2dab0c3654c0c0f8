"""Ours beside the printed: rows of the paper's tables, and what the comparison claims."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hybrid_id.reproduction.result import StageResult, TrackingResult
from hybrid_id.twin import paper

LIMIT = 30.0
"""The paper's rule for std/mean [%]."""


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
        told: what the check predicts of one record [%].
        printed: the paper's row.
        role: "free", "prior" or "stage", which says what holds it.
    """

    name: str
    unit: str
    value: float
    truth: float
    interval: float
    percent: float
    told: float
    printed: paper.Variation
    role: str

    @property
    def covered(self) -> bool:
        """Whether the interval holds the truth."""
        return abs(self.value - self.truth) <= self.interval

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
        return f"one record tells it to ± {self.told:.2g} % only"


@dataclass(frozen=True)
class FitRow:
    """One signal of Tables 3, 5, 8, 9 and 11: fit % of the selected set over the records."""

    name: str
    mean: float
    std: float
    truth: float
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
                ParameterRow(name, "", value, factor * truth[own], np.inf, 0.0, np.nan, printed, "stage")
            )
            continue
        k = result.names.index(own)
        unit = result.units[k]
        rows.append(
            ParameterRow(
                name, unit, factor * result.values[result.selected, k],
                factor * result.truths[result.selected, k], factor * result.interval[k], result.percent[k],
                100 * result.told[k], printed, "prior" if own in result.by_prior else "free",
            )
        )  # fmt: skip
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
                result.truth_fits[:, k].mean(),
                printed,
            )
        )
    return rows


@dataclass(frozen=True)
class Claim:
    """What was to be shown, and what was seen."""

    claim: str
    target: str
    seen: str
    met: bool


def claims(
    stages: Mapping[str, StageResult],
    truths: Mapping[str, Mapping[str, float]],
    tracking: Mapping[str, TrackingResult],
) -> list[Claim]:
    """The issue's list, as measured in this run."""
    found = []
    rows = {s: parameter_rows(s, r, truths[s]) for s, r in stages.items() if s in PRINTED}
    free = [(s, row) for s, some in rows.items() for row in some if row.role == "free"]
    if free:
        worst = max(free, key=lambda pair: pair[1].percent)[1]
        found.append(
            Claim("std/mean of every free parameter, the 30 % rule", f"< {LIMIT:g} %",
                  f"at most {worst.percent:.1f} % ({worst.name})", worst.percent < LIMIT)
        )  # fmt: skip
        above = [f"{row.name} (Table {PRINTED[s].parameters})" for s, row in free if not row.below]
        share = 1 - len(above) / len(free)
        seen = f"{len(free) - len(above)} of {len(free)}" + (f"; above: {', '.join(above)}" if above else "")
        found.append(Claim("rows with std/mean below the printed one", "9 of 10", seen, share >= 0.9))
        every = [row for some in rows.values() for row in some if row.role != "stage"]
        covered = sum(row.covered for row in every)
        found.append(
            Claim("95 % intervals of the selected sets that hold the truth", "about 95 %",
                  f"{covered} of {len(every)}", covered >= 0.9 * len(every))
        )  # fmt: skip
    fits = [(s, row) for s, r in stages.items() if s in PRINTED for row in fit_rows(s, r)]
    if fits:
        for what, target, holds in (
            ("average fit at or above the printed one", "all", lambda f: f.mean >= f.printed.mean),
            ("average fit within 1 point of replaying the truth", "all", lambda f: f.mean >= f.truth - 1.0),
            ("std/mean of fit below the printed one", "all", lambda f: f.percent < f.printed.percent),
        ):
            off = [f"{f.name} (Table {PRINTED[s].fits})" for s, f in fits if not holds(f)]
            seen = f"{len(fits) - len(off)} of {len(fits)}" + (f"; not: {', '.join(off)}" if off else "")
            found.append(Claim(what, target, seen, not off))
    if len(inertia := inertia_rows(stages, truths)) == len(paper.TABLE_12):
        spread = {name: row.percent for name, row in inertia.items()}
        worst = max(spread, key=lambda name: spread[name])
        seen = ", ".join(f"{name} {value:.3g} %" for name, value in spread.items())
        found.append(
            Claim("Table 12: std/mean of P_2 is worst at low velocity", "worst", seen, "low" in worst)
        )
    for case, result in tracking.items():
        if case == "backlash":
            ratio = result.rms[1] / result.rms[0]
            found.append(
                Claim("Fig. 5: error with backlash model / with rigid model", "<= 0.5",
                      f"{ratio.mean():.2f} ± {ratio.std():.2f}", bool((ratio <= 0.5).all()))
            )  # fmt: skip
            continue
        for j in range(result.rms.shape[1]):
            means = [f"{1e3 * m.mean():.2f} ± {1e3 * m.std():.2f}" for m in result.rms[:, j]]
            order = result.rms[0, j].mean() > result.rms[1, j].mean() > result.rms[2, j].mean()
            first = int(np.sum(result.rms[0, j] > result.rms[1, j]))
            second = int(np.sum(result.rms[1, j] > result.rms[2, j]))
            of = result.rms.shape[2]
            found.append(
                Claim(
                    f"{'One link' if case == 'one_link' else 'Both links'}, joint {j + 1}: RMS error [mrad]",
                    "MM > IFLRM > IFRM",
                    f"{' > '.join(means)}; seed by seed MM > IFLRM in {first} of {of}, IFLRM > IFRM in {second}",
                    bool(order),
                )
            )
    return found


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
