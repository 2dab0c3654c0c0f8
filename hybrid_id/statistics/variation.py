"""Scatter over experiments and repeats: std/mean of parameters (paper, III.A), and paired differences."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from hybrid_id.errors import InputError

ACCEPTABLE_PERCENT = 30.0  # "if variations fall under 30 percent, results are acceptable"


@dataclass(frozen=True, eq=False)
class Variation:
    """Scatter of each parameter over the experiments, one parameter set per experiment.

    Attributes:
        names: Parameters (p).
        mean, std: Over the experiments (p,), std with n - 1.
        percent: 100 std / |mean| (p,); nan for a single experiment, inf for a mean of zero.
        held: (p,) bool; fixed or held by a prior, so that a small scatter says nothing about the records.
        acceptable: (p,) bool; percent within the limit and not held.
    """

    names: tuple[str, ...]
    mean: np.ndarray
    std: np.ndarray
    percent: np.ndarray
    held: np.ndarray
    acceptable: np.ndarray


def variation(parameter_sets: np.ndarray, names: Sequence[str], *, held: Collection[str] = ()) -> Variation:
    """std/mean in % of each parameter over the experiments, with the paper's rule of 30 %.

    Args:
        parameter_sets: (n, p), one row per experiment; rows with a value that is not finite (failed fits) are left out.
        names: Names of the p parameters.
        held: Names of parameters that were fixed or held by a prior: they take no part in claims.
    """
    sets = np.asarray(parameter_sets, float)
    sets = sets[np.all(np.isfinite(sets), axis=1)]
    nothing = np.full(len(names), np.nan)
    mean = sets.mean(axis=0) if len(sets) else nothing
    std = sets.std(axis=0, ddof=1) if len(sets) > 1 else nothing
    with np.errstate(divide="ignore", invalid="ignore"):
        percent = np.where((mean == 0) & (std > 0), np.inf, 100 * std / np.abs(mean))
    held_mask = np.isin(names, list(held))
    acceptable = (percent <= ACCEPTABLE_PERCENT) & ~held_mask
    return Variation(tuple(names), mean, std, percent, held_mask, acceptable)


def error_of_mean(parameter_sets: np.ndarray) -> np.ndarray:
    """Standard error (p,) of the mean over experiments (n, p), from the scatter between them alone.

    It asks nothing of the residuals; autocorrelation and small model errors that differ between experiments are
    in it. What all experiments share (a wrong gear ratio, say) is not. NaN where fewer than two experiments are left.
    """
    sets = np.asarray(parameter_sets, float)
    sets = sets[np.all(np.isfinite(sets), axis=1)]
    if len(sets) < 2:
        return np.full(sets.shape[1], np.nan)
    return sets.std(axis=0, ddof=1) / np.sqrt(len(sets))


def prior_variances(
    inverse_hessians: Sequence[np.ndarray], precision: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What a prior that all sets share adds to the variance of each set (n, p), and to that of their mean (p,).

    A prior whose mean is off by e moves set k by ``A_k P e``, and their mean by the mean of that: it does not average
    out, as errors do that each record has for itself.

    Args:
        inverse_hessians: ``A_k = (JᵀJ + P)⁻¹`` of each set, (p, p); see `uncertainty`.
        precision: P, of the prior of each parameter, 0 where it has none (p,).
    """
    sets, known = np.asarray(inverse_hessians), precision > 0
    pulls = sets * precision
    mean = pulls.mean(0)[:, known]
    return np.einsum("kij,kij->ki", pulls, sets), np.sum(mean**2 / precision[known], 1)


@dataclass(frozen=True)
class PairedDifference:
    """Mean of ``first - second`` over pairs, with its interval.

    Attributes:
        mean, lower, upper: of the difference; nan bounds where fewer than two pairs are left.
        std: between the pairs.
        level: confidence.
        n_pairs: pairs in which both values are finite.
    """

    mean: float
    lower: float
    upper: float
    std: float
    level: float
    n_pairs: int


def paired_difference(
    first: np.ndarray, second: np.ndarray, *, overlap: float = 0.0, level: float = 0.95
) -> PairedDifference:
    """Student's interval of the mean difference, corrected for training sets that share records.

    ``var(mean) = (1 / n + overlap) s^2``. Repeats whose training sets are drawn from the same records are not
    independent, and the usual ``s^2 / n`` is too confident by far; with ``overlap`` = 0 this is the paired t-interval.

    Source: C. Nadeau, Y. Bengio, Inference for the Generalization Error, Machine Learning 52, 2003: overlap = records
    tested on over records trained with.

    Args:
        first: values by repeat, ``(n,)``; pairs with a value that is not finite are left out.
        second: those of the same repeats that are subtracted.
        overlap: correction, at least 0.
        level: confidence.

    Raises:
        InputError: values that do not pair up, or a negative overlap.
    """
    a, b = np.asarray(first, float), np.asarray(second, float)
    if a.ndim != 1 or a.shape != b.shape:
        raise InputError(f"values of shapes {a.shape} and {b.shape} are no pairs; give one of each a repeat.")
    if not overlap >= 0.0:
        raise InputError(f"overlap is {overlap}; give a share of at least 0.")
    kept = np.isfinite(a) & np.isfinite(b)
    difference = a[kept] - b[kept]
    n = len(difference)
    if n < 2:
        return PairedDifference(float(difference.mean()) if n else np.nan, np.nan, np.nan, np.nan, level, n)
    mean, std = float(difference.mean()), float(difference.std(ddof=1))
    reach = float(stdtrit(n - 1, 0.5 + level / 2.0)) * std * (1.0 / n + overlap) ** 0.5
    return PairedDifference(mean, mean - reach, mean + reach, std, level, n)
