"""The tables of the experiment, as Markdown, and its pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from arm import Fits

from hybrid_id.reporting.study_figures import cross_validation_figure, parameter_figure, residual_figure
from hybrid_id.reporting.style import save
from hybrid_id.statistics.residuals import whiteness
from hybrid_id.study import Study

SCALED = ("J", "F_c", "F_drop", "c_w", "k_s", "T_0")
"""Parameters of which the records tell the ratio to P_m1 only."""


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""
    return "\n" + "\n".join(f"| {' | '.join(line)} |" for line in [head, ["---"] * len(head), *rows])


def _told(fits: Fits, name: str) -> tuple[str, np.ndarray]:
    """What the records tell of a parameter: its name as a ratio, and its value in each set."""
    column = fits.table[:, fits.study.names.index(name)]
    if name in SCALED:
        return f"{name}/P_m1", column / fits.study.system.parameter("P_m1").spec.value
    return ("P_m2 + F_v/P_m1" if name == "P_m2" else name), column


def parameter_table(fits: Fits) -> str:
    """Every set's values of what is told, mean, std/mean and trust grade."""
    rows = []
    for name, trust in zip(fits.study.names, fits.study.reliability, strict=True):
        label, values = _told(fits, name)
        mean, std = values.mean(), values.std(ddof=1)
        rows.append([label, *(f"{v:.4g}" for v in values), f"{mean:.4g}", f"{100 * std / abs(mean):.1f} %",
                     f"{trust.grade}: {trust.reason}"])  # fmt: skip
    return table(
        ["set of record", *(str(k + 1) for k in range(len(fits.table))), "mean", "std/mean", "trust"], rows
    )


def spread_table(title: str, variants: Mapping[str, Fits]) -> str:
    """Mean and std/mean over the records of what is told, for several variants of a fit."""
    names = list(dict.fromkeys(n for fits in variants.values() for n in fits.study.names))
    rows = []
    for label, fits in variants.items():
        cells = []
        for name in names:
            known = name in fits.study.names
            values = _told(fits, name)[1] if known else np.zeros(0)
            spread = 100 * values.std(ddof=1) / abs(values.mean()) if known else 0.0
            cells.append(f"{values.mean():.4g} ({spread:.3g} %)" if known else "")
        noise = np.mean([r.noise_scale for r in fits.study.sets])
        rows.append([label, *cells, f"{noise:.2f}", f"{sum(r.ok for r in fits.study.sets)}"])
    labels = [next(_told(f, n)[0] for f in variants.values() if n in f.study.names) for n in names]
    return table([title, *labels, "weighted residual", "converged"], rows)


def horizon_table(variants: Mapping[str, Fits], horizons: Sequence[float]) -> str:
    """Fit and RMS error over free runs of several lengths, on the own record and on the seven others."""
    rows = []
    for label, fits in variants.items():
        own = np.eye(len(fits.table), dtype=bool)
        plain = [fits.held_out(horizon) for horizon in horizons]
        found = [("own record", own, plain), ("others", ~own, plain)]
        if "T_0" in fits.study.names:
            found.append(("others, own T_0", ~own, [fits.held_out(h, own_bias=True) for h in horizons]))
        for words, mask, held in found:
            cells = [f"{fit[mask].mean():.1f} % ({1e3 * error[mask].mean():.0f} mrad)" for fit, error in held]
            rows.append([label, words, *cells])
    return table(["model", "replayed on", *(f"{h:g} s" for h in horizons)], rows)


def remarks(fits: Fits) -> str:
    """Selection, integration error, whiteness of the residuals, and the scale that the pendulum's weight gives."""
    study = fits.study
    white = whiteness(study.selected.residual)
    lines = [study.identifiability.summary(), study.selection.summary()]
    lines.append(f"integration error (step halved): {study.engine_error:.2g} standard errors at most")
    lines.append(f"residuals of the selected set: {100 * white.outside.max():.0f} % of {len(white.lags) - 1} lags "
                 f"leave the 99 % band of white noise; correlation at lag 1 {white.correlation[1, 0]:.2f}")  # fmt: skip
    if "c_w" in study.names:
        weight = 0.75 * 0.024 * 9.81 * 0.085
        scales = weight / _told(fits, "c_w")[1]
        lines.append(f"P_m1 from the pendulum's weight, c_w = 3/4 m g L = {weight:.4g} N m: {scales.mean():.4g} N m/V, "
                     f"std/mean {100 * scales.std(ddof=1) / scales.mean():.1f} %")  # fmt: skip
    return "\n" + "\n".join(lines)


def say_whole(title: str, study: Study) -> None:
    """Print what the usual study of whole records says."""
    spread = "one record only"
    if (over := study.variation) is not None:
        rows = zip(over.names, over.mean, over.percent, strict=True)
        spread = "\n".join(
            f"{name}: mean {mean:.4g}, std/mean {percent:.2f} %" for name, mean, percent in rows
        )
    print(f"\nwhole records as one free run, {title}\n{spread}\n{study.selection.summary()}")


def pictures(fits: Fits, folder: Path, sample_time: float) -> None:
    """Parameters over the records, cross-validation, residuals."""
    folder.mkdir(parents=True, exist_ok=True)
    save(parameter_figure(fits.study), folder / "parameters.png")
    save(cross_validation_figure(fits.study), folder / "cross_validation.png")
    save(residual_figure(fits.study, sample_time), folder / "residuals.png")
