"""Whether a model explains the records at all: less than their mean speaks for a wrong unit, sign or gear ratio."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hybrid_id.errors import listed
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.finding import Finding
from hybrid_id.study.comparison import replay
from hybrid_id.study.result import Study
from hybrid_id.systems.chain import System

FROM_PRIOR = 6.0
"""Standard deviations of a prior from which its parameter is called odd."""
ALIKE, UNIT = 0.9, 5.0
"""Correlation of a signal with its simulation, and factor between the two, from which its unit is doubted: 9.5 is a
speed's in rpm, 57 an angle's in degrees."""
FAR_OUT = 20.0
"""Error of a record over the median of all from which it contradicts the others."""


def check_start_values(dataset: Dataset, system: System) -> list[Finding]:
    """Simulate the train records with the model's start values; one warning where that explains nothing."""
    names = [record.name for record in dataset.train or dataset.records]
    runs = replay(dataset.select(names), system)
    words = _verdict("the model's start values", names, [list(run.nrmse.values()) for run in runs])
    found = [words] if words else []
    for output in runs[0].outputs:
        pairs = [(run.record.signal(output), run.outputs[output]) for run in runs if run.status == "ok"]
        if times := _times([(a - a.mean(), b - b.mean()) for a, b in pairs]):
            found.append(
                f"{output} moves {times:.3g} times as far in the records as with the model's start values, and alike "
                "otherwise; check its unit"
            )
    return [Finding("warning", "start_values", one) for one in found]


def _times(pairs: Sequence[tuple[np.ndarray, np.ndarray]]) -> float:
    """Factor between two signals that are alike but for one that no start value explains; 0 where there is none."""
    both, own, other = (float(sum(np.vdot(p[i], p[j]) for p in pairs)) for i, j in ((0, 1), (0, 0), (1, 1)))
    if (
        not all(np.isfinite((both, own, other)))
        or own <= 0
        or other <= 0
        or both < ALIKE * (own * other) ** 0.5
    ):
        return 0.0
    times = (own / other) ** 0.5
    return times if max(times, 1.0 / times) > UNIT else 0.0


def check_fit(study: Study) -> str:
    """The same of the selected set on train and test records; empty where it explains something."""
    cross, index = study.cross_validation, study.selection.index
    outputs = study.selected.residual[0].shape[-1]
    train = 1.0 - cross.fits[index, :, :outputs] / 100.0
    test = [[value] for value in study.test_nrmse.values()]
    who = "the identified parameters"
    return _verdict(who, cross.record_names, train) or _verdict(who, tuple(study.test_nrmse), test)


def check_priors(study: Study) -> list[str]:
    """Say which identified values lie further from their priors than data sheets are wrong: units are, or the model."""
    lines, selected = [], study.selected
    for name, value in zip(selected.names, selected.values, strict=True):
        spec = selected.system.parameter(name).spec
        if spec.prior_std is None or spec.prior_mean is None:
            continue
        away = abs(value - spec.prior_mean) / spec.prior_std
        if away > FROM_PRIOR:
            lines.append(
                f"{name} = {value:.4g} is {away:.0f} standard deviations from its prior {spec.prior_mean:.4g}; check "
                "the units of commands and outputs, and that nothing is missing ('hybrid-id diagnose')"
            )
    return lines


def _verdict(who: str, names: Sequence[str], nrmse: Sequence[Sequence[float]] | np.ndarray) -> str:
    """Say that the normalised RMSE (n_records, n_outputs) of the worst output, median of the records, is above 1.

    Or that of single records which stand far out of the others.
    """
    errors = np.array(nrmse, float)
    if not errors.size:
        return ""
    moving = errors[:, ~np.isnan(errors).all(0)]  # an output that stands still in all records has none
    worst = float(np.max(np.nanmedian(moving, axis=0), initial=0.0)) if moving.size else 0.0
    if worst > 1.0:
        size = f"normalised RMSE {worst:.3g}" if np.isfinite(worst) else "the simulation diverges"
        return f"{who} explain less than the mean of the records ({size}); check signs, units and gear ratio"
    largest = np.nanmax(np.where(np.isnan(errors), -np.inf, errors), axis=1)
    out = [k for k, error in enumerate(largest) if error > max(1.0, FAR_OUT * float(np.median(largest)))]
    if not out:
        return ""
    return (
        f"{who} explain the records but for {listed([names[k] for k in out])} (normalised RMSE {largest[out[0]]:.3g}, "
        f"median {np.median(largest):.2g}); check signs, units and columns there"
    )
