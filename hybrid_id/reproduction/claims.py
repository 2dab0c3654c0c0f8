"""What the reproduction was to show, and what it saw."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.stats import ttest_rel

from hybrid_id.machines.twin import paper
from hybrid_id.reproduction.comparison import PRINTED, FitRow, fit_rows, inertia_rows, parameter_rows
from hybrid_id.reproduction.result import StageResult, TrackingResult
from hybrid_id.statistics.variation import ACCEPTABLE_PERCENT as LIMIT


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
    return [
        *_of_parameters(stages, truths),
        *_of_fits(stages),
        *_of_inertia(stages, truths),
        *(one for case, result in tracking.items() for one in _of_tracking(case, result)),
    ]


def _of_parameters(
    stages: Mapping[str, StageResult], truths: Mapping[str, Mapping[str, float]]
) -> list[Claim]:
    """The free parameters' variation, and whether the intervals hold the truth."""
    rows = {s: parameter_rows(s, r, truths[s]) for s, r in stages.items() if s in PRINTED}
    free = [(s, row) for s, some in rows.items() for row in some if row.role == "free"]
    if not free:
        return []
    worst = max(free, key=lambda pair: pair[1].percent)[1]
    found = [
        Claim("std/mean of every free parameter, the 30 % rule", f"< {LIMIT:g} %",
              f"at most {worst.percent:.1f} % ({worst.name})", worst.percent < LIMIT)
    ]  # fmt: skip
    above = [f"{row.name} (Table {PRINTED[s].parameters})" for s, row in free if not row.below]
    share = 1 - len(above) / len(free)
    seen = f"{len(free) - len(above)} of {len(free)}" + (f"; above: {', '.join(above)}" if above else "")
    found.append(Claim("rows with std/mean below the printed one", "9 of 10", seen, share >= 0.9))
    own = [row for some in rows.values() for row in some if row.role != "stage"]
    every = [row for row in own if np.isfinite(row.interval)]  # of others nothing is claimed
    covered = sum(row.covered for row in every)
    found.append(
        Claim("95 % intervals of the selected sets that hold the truth", "about 95 %",
              f"{covered} of {len(every)}", covered >= 0.9 * len(every))
    )  # fmt: skip
    return found


def _of_fits(stages: Mapping[str, StageResult]) -> list[Claim]:
    """How well the models fit, beside the printed tables."""
    found = list[Claim]()
    fits = [(s, row) for s, r in stages.items() if s in PRINTED for row in fit_rows(s, r)]
    if not fits:
        return found
    for what, holds, show in (
        ("average fit at or above the printed one", lambda f: f.mean >= f.printed.mean, _mean),
        ("average fit within 1 point of replaying the truth", lambda f: f.mean >= f.truth - 1.0, _mean),
        ("std/mean of fit below the printed one", lambda f: f.percent < f.printed.percent, _spread),
    ):
        off = [
            f"{f.name} (Table {PRINTED[s].fits}; true parameters {show(f)})" for s, f in fits if not holds(f)
        ]
        seen = f"{len(fits) - len(off)} of {len(fits)}" + (f"; not: {', '.join(off)}" if off else "")
        found.append(Claim(what, "all", seen, not off))
    return found


def _of_inertia(stages: Mapping[str, StageResult], truths: Mapping[str, Mapping[str, float]]) -> list[Claim]:
    """Table 12: how the inertia varies with the velocity of the records."""
    inertia = inertia_rows(stages, truths)
    if len(inertia) != len(paper.TABLE_12):
        return []
    spread = {name: row.percent for name, row in inertia.items()}
    worst = max(spread, key=lambda name: spread[name])
    seen = ", ".join(
        f"{name} {row.percent:.2g} % (± {row.typical:.2g} % from a typical record)"
        for name, row in inertia.items()
    )
    what = "Table 12: std/mean of P_2 is worst at low velocity"
    return [Claim(what, "worst", seen, "low" in worst)]


def _of_tracking(case: str, result: TrackingResult) -> list[Claim]:
    """Errors of the closed loops with several feedforward models."""
    if case == "backlash":
        ratio = result.rms[1] / result.rms[0]
        return [
            Claim("Fig. 5: error with backlash model / with rigid model", "<= 0.5",
                  f"{ratio.mean():.3f} ± {ratio.std():.3f}", bool((ratio <= 0.5).all()))
        ]  # fmt: skip
    found = list[Claim]()
    for j in range(result.rms.shape[1]):
        means = [f"{1e3 * m.mean():.2f} ± {1e3 * m.std():.2f}" for m in result.rms[:, j]]
        pairs = list(zip(result.rms[:-1, j], result.rms[1:, j], strict=True))
        p = [float(ttest_rel(more, less, alternative="greater").pvalue) for more, less in pairs]
        seeds = [f"{np.sum(more > less)} of {len(more)}" for more, less in pairs]
        found.append(
            Claim(
                f"{'One link' if case == 'one_link' else 'Both links'}, joint {j + 1}: RMS error [mrad]",
                "MM > IFLRM > IFRM, paired over seeds, p < 0.05",
                f"{' > '.join(means)}; p = {p[0]:.2g} (larger in {seeds[0]} seeds) and {p[1]:.2g} ({seeds[1]})",
                max(p) < 0.05,
            )
        )
    return found


def _mean(row: FitRow) -> str:
    return f"{row.truth:.2f} against {row.printed.mean:.2f} %"


def _spread(row: FitRow) -> str:
    return f"{100 * row.truth_std / row.truth:.2f} against {row.printed.percent:.2f} %"
