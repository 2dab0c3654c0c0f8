"""Combinations of parameters that the records do determine where the parameters themselves are not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

_TINY = 1e-100
_SIMPLE = 2e-3  # exponents and factors this close to a simple number are that number


@dataclass(frozen=True, eq=False)
class Combination:
    """A sum of products of powers, ``φ(θ) = Σ_m c_m Π_k θ_k^e_mk``.

    Attributes:
        text: As people write it, "P_m2 + f_3/P_m1".
        coefficients: c (m,).
        exponents: e (m, p).
    """

    text: str
    coefficients: np.ndarray
    exponents: np.ndarray

    def evaluate(self, parameter_sets: np.ndarray) -> np.ndarray:
        """Value for parameter sets (..., p) -> (...)."""
        return self._terms(parameter_sets).sum(axis=-1)

    def gradient(self, parameters: np.ndarray) -> np.ndarray:
        """``dφ / d ln θ`` (p,)."""
        return self._terms(parameters) @ self.exponents

    def std_error(self, parameters: np.ndarray, covariance: np.ndarray) -> float:
        """First-order standard error from a covariance (p, p) of the parameters; null directions cancel."""
        away = np.where(np.asarray(parameters) == 0, _TINY, parameters)  # the slope at zero is that beside it
        slope = self.gradient(away) / away
        return float(np.sqrt(slope @ covariance @ slope))

    def _terms(self, parameter_sets: np.ndarray) -> np.ndarray:
        sets = np.asarray(parameter_sets, float)[..., None, :]
        # Signs count where the exponent is odd; other powers of negative numbers go by their size.
        signs = np.where(self.exponents % 2 == 1, np.sign(sets), 1.0)
        with np.errstate(divide="ignore"):
            return self.coefficients * np.prod(signs * np.abs(sets) ** self.exponents, axis=-1)


def identifiable_combinations(
    basis: np.ndarray, values: np.ndarray, names: Sequence[str], references: Sequence[str] = ()
) -> tuple[Combination, ...]:
    """Functions that no direction of the basis changes, p - k of them for k directions.

    Parameters in no direction stand for themselves. A group that may be multiplied by one number is divided by one of
    its members. Two parameters of which one makes up for the other by a ratio that is no simple number act through a
    sum; other directions give products of powers, which are right near `values`.

    Args:
        basis: Relative changes (p, k) from `null_directions.simple_basis`.
        values: θ (p,), not zero where a direction moves it.
        names: Names of the p parameters.
        references: Names of parameters to divide by, where there is a choice.
    """
    groups = [a for a in range(basis.shape[1]) if set(np.unique(basis[:, a])) <= {0.0, 1.0}]
    pairs = {a: _pair(basis[:, a], basis[:, groups]) for a in range(basis.shape[1]) if a not in groups}
    pairs = {a: pair for a, pair in pairs.items() if pair is not None}
    taken = _references(basis, names, references, pairs)
    powers = -basis @ np.linalg.inv(basis[taken]) if taken else np.zeros((len(names), 0))

    found = []
    for k in range(len(names)):
        if k in taken:
            continue
        exponents = np.zeros(len(names))
        exponents[taken] = _simple(powers[k])
        exponents[k] = 1.0
        combination = Combination(_product_text(exponents, names), np.ones(1), exponents[None])
        for a, (lead, partner) in pairs.items():
            if lead == k:
                divisors = [taken[b] for b in groups]
                combination = _sum(basis, a, lead, partner, groups, divisors, values, names) or combination
        found.append(combination)
    return tuple(found)


def _pair(vector: np.ndarray, group_vectors: np.ndarray) -> tuple[int, int] | None:
    """(lead, partner) of a direction that moves two parameters by no simple ratio; the lead is in fewer groups."""
    members = np.flatnonzero(vector)
    if len(members) != 2 or np.abs(vector[members]).min() == 1:
        return None
    first, second = (int(k) for k in members)
    in_groups = group_vectors.sum(axis=1)
    return (first, second) if in_groups[first] <= in_groups[second] else (second, first)


def _references(
    basis: np.ndarray, names: Sequence[str], preferred: Sequence[str], pairs: dict[int, tuple[int, int]]
) -> list[int]:
    """One parameter for each direction, to be expressed by the others."""
    taken: list[int] = []
    for a in range(basis.shape[1]):
        order = [pairs[a][1]] if a in pairs else []
        order += [names.index(n) for n in preferred if n in names]
        order += [int(k) for k in np.argsort(-np.abs(basis[:, a]), kind="stable")]
        free = [k for k in order if k not in taken]
        # The square of the rows and columns so far must be invertible.
        volume = [abs(np.linalg.det(basis[np.ix_([*taken, k], range(a + 1))])) for k in free]
        good = [k for k, v in zip(free, volume, strict=True) if v > 1e-2 * max(volume)]
        taken.append(good[0])
    return taken


def _sum(
    basis: np.ndarray,
    a: int,
    lead: int,
    partner: int,
    groups: list[int],
    divisors: list[int],
    values: np.ndarray,
    names: Sequence[str],
) -> Combination | None:
    """``θ_lead + κ θ_partner``, each divided by the references of its groups; None if a direction changes it."""
    exponents = np.zeros((2, len(names)))
    for row, k in enumerate((lead, partner)):
        exponents[row, k] = 1.0
        exponents[row, divisors] -= basis[k, groups]
    terms = np.prod(np.asarray(values, float) ** exponents, axis=1)
    factor = float(_simple(-terms[0] * basis[lead, a] / (terms[1] * basis[partner, a])))
    sign = "+" if factor > 0 else "-"
    scaled = "" if abs(factor) == 1 else f"{abs(factor):.4g} "
    text = f"{_product_text(exponents[0], names)} {sign} {scaled}{_product_text(exponents[1], names)}"
    combination = Combination(text, np.array([1.0, factor]), exponents)
    gradient = combination.gradient(values)
    return combination if np.abs(gradient @ basis).max() < 1e-2 * np.abs(gradient).max() else None


def _simple(number: np.ndarray | float) -> np.ndarray:
    """Multiples of one half where that is near enough."""
    number = np.asarray(number, float)
    near = np.round(2 * number) / 2
    return np.where(
        (np.abs(number - near) < _SIMPLE) & (near != 0) | (np.abs(number) < _SIMPLE), near, number
    )


def _product_text(exponents: np.ndarray, names: Sequence[str]) -> str:
    """Numerator and denominator, "J/P_m1"."""
    powers = [f"{n}^{abs(e):.3g}" if abs(e) != 1 else n for n, e in zip(names, exponents, strict=True)]
    above = "·".join(p for p, e in zip(powers, exponents, strict=True) if e > 0) or "1"
    below = [p for p, e in zip(powers, exponents, strict=True) if e < 0]
    return above + (f"/{below[0]}" if len(below) == 1 else f"/({'·'.join(below)})" if below else "")
