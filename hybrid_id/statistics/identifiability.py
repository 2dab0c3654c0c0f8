"""What a set of records identifies: condition number, null directions in words, combinations that are determined."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, product
from math import comb

import numpy as np
from scipy.linalg import qr

from hybrid_id.errors import InputError
from hybrid_id.statistics.uncertainty import Arrays, prior_matrix

VAGUE = 0.5  # relative standard error from which a direction counts as not identified
_REACH = 1.96  # standard errors, for the 95 % that all words and tables mean
_ROUNDING = 1e-9  # singular values below this share of the largest are rounding
_HOPELESS = 30.0  # relative standard error from which a direction is as good as null
_SMALL_ENTRY = 0.1  # entries of a weak (not exact) direction below this are not worth words
_TINY = 1e-100
_SIMPLE = 2e-3  # exponents and factors this close to a simple number are that number
_EXACT = 1e-3  # entries of a numerical null vector closer than this are equal
_MOST_CIRCUITS = 3000
_MOST_SIGNS = 6


@dataclass(frozen=True, eq=False)
class Direction:
    """A relative change of parameters that the records do not see.

    Attributes:
        relative: ``d ln θ`` (p,), largest entry 1.
        relative_std: Standard error of the parameter that moves most, from the records alone; inf if they see nothing.
        with_prior: The same with the prior.
        text: The direction in words.
    """

    relative: np.ndarray
    relative_std: float
    with_prior: float
    text: str


@dataclass(frozen=True, eq=False)
class Identifiability:
    """What the records tell about the parameters.

    Attributes:
        names: Parameters (p).
        condition_number: Of the Jacobian with respect to ln θ, records alone; inf where a direction is null.
        directions: What the records alone do not identify.
        relative_std: Predicted relative standard error of each parameter, prior included (p,); inf if none.
        claimable: (p,) bool; whether an interval of the parameter on its own may be claimed.
        prior_share: Share of each parameter's information that is the prior's (p,), 0 to 1.
        combinations: p - len(directions) functions of the parameters that the records identify.
        combination_std: Their predicted relative standard errors, records alone.
    """

    names: tuple[str, ...]
    condition_number: float
    directions: tuple[Direction, ...]
    relative_std: np.ndarray
    claimable: np.ndarray
    prior_share: np.ndarray
    combinations: tuple[Combination, ...]
    combination_std: np.ndarray

    @property
    def not_claimable(self) -> tuple[str, ...]:
        """Names of the parameters without an interval of their own."""
        return tuple(name for name, claim in zip(self.names, self.claimable, strict=True) if not claim)

    def summary(self) -> str:
        """Directions in words, then what is identified."""
        if not self.directions:
            return (
                f"all {len(self.names)} parameters can be identified from these records "
                f"(condition number {self.condition_number:.3g})"
            )
        lines = [
            f"{len(self.directions)} of {len(self.names)} directions cannot be identified from these records:"
        ]
        lines += [
            f"  {number}. {direction.text}" for number, direction in enumerate(self.directions, start=1)
        ]
        lines.append("identified, with 95 % intervals: " + ", ".join(
            f"{c.text} (±{100 * error:.2g} %)"
            for c, error in zip(self.combinations, _REACH * self.combination_std, strict=True)
        ))  # fmt: skip
        lines.append(
            "no interval may be claimed for: "
            + (", ".join(self.not_claimable) or "none, thanks to the prior")
        )
        return "\n".join(lines)


def identifiability(
    values: np.ndarray,
    names: Sequence[str],
    *,
    jacobian: Arrays,
    prior_precision: np.ndarray | None = None,
    scale: np.ndarray | None = None,
    inflation: float = 1.0,
    references: Sequence[str] = (),
) -> Identifiability:
    """Singular value decomposition of the Jacobian with respect to relative changes of the parameters.

    A direction counts as not identified where the records leave the parameter that it moves most with a
    relative standard error above `VAGUE`, given the noise, or where they see nothing of it at all.

    Args:
        values: θ (p,) at which the Jacobian was taken.
        names: Names of the p parameters.
        jacobian: Weighted by 1 / noise (convention: `uncertainty`), one record or several.
        prior_precision: Inverse covariance of a Gaussian prior, (p, p) or its diagonal (p,).
        scale: Size that stands in for a parameter whose value is zero (p,).
        inflation: Factor on standard errors for correlated residuals.
        references: Names of parameters to divide by in combinations, motor constants say.

    Raises:
        InputError: A parameter of value zero without a scale.
    """
    values = np.asarray(values, float)
    size = np.where(values == 0, 0.0 if scale is None else scale, values)  # signed: d ln θ = d θ / θ
    if np.any(size == 0):
        zero = names[int(np.flatnonzero(size == 0)[0])]
        raise InputError(f"identifiability: {zero} is zero, so relative changes mean nothing; give its scale")
    records = [jacobian] if isinstance(jacobian, np.ndarray) else jacobian
    # a simulation that has diverged holds no information
    finite = (np.nan_to_num(np.reshape(j, (-1, np.shape(j)[-1])), posinf=0.0, neginf=0.0) for j in records)
    root = np.linalg.qr(np.concatenate([np.linalg.qr(j)[1] for j in finite]))[1]
    _, singular, rows = np.linalg.svd(root * size / inflation, full_matrices=True)
    singular = np.concatenate([singular, np.zeros(len(values) - len(singular))])
    vectors = rows.T
    with np.errstate(divide="ignore"):
        along = np.abs(vectors).max(axis=0) / singular  # relative error of the parameter that moves most
    null = singular <= _ROUNDING * len(values) * singular[0]
    hopeless = null | (along > _HOPELESS)
    weak = simple_basis(vectors[:, ~hopeless & (along > VAGUE)], _SMALL_ENTRY)
    moves = np.column_stack([simple_basis(vectors[:, hopeless]), weak])
    basis = np.column_stack([moves[:, : hopeless.sum()], *(normalise(v, _SMALL_ENTRY) for v in weak.T)])

    combinations = identifiable_combinations(basis, size, names, references)
    leading = vectors[:, ~hopeless] / singular[~hopeless]
    gradients = [c.gradient(size) / c.evaluate(size) for c in combinations]
    data = (vectors[:, ~hopeless] * singular[~hopeless] ** 2) @ vectors[:, ~hopeless].T
    prior = prior_matrix(prior_precision, len(values)) * np.outer(size, size)
    # errors of parameters in units of each one's own: else one that is known far better than another drowns it
    unit = np.sqrt(np.where(np.diag(data + prior) > 0, np.diag(data + prior), 1.0))
    squares, axes = np.linalg.eigh((data + prior) / np.outer(unit, unit))
    open_axes = squares <= 1e-13 * len(squares) * squares[-1]
    relative_std = np.linalg.norm(axes[:, ~open_axes] / np.sqrt(squares[~open_axes]), axis=1) / unit
    relative_std = np.where(np.linalg.norm(axes[:, open_axes], axis=1) > 1e-3, np.inf, relative_std)

    directions = []
    for move, vector in zip(moves.T, basis.T, strict=True):
        # Beyond hope the records leave nothing; `data` holds only what they do see. Errors are of the parameter that
        # moves most, when only this direction is free.
        seen = [float(move @ information @ move) for information in (data, data + prior)]
        floors = [
            1e-13 * float(np.trace(information) * (move @ move)) for information in (data, data + prior)
        ]
        alone, with_prior = (
            s**-0.5 if s > floor else float("inf") for s, floor in zip(seen, floors, strict=True)
        )
        text = _words(vector, names, alone, combinations)
        if with_prior < 0.8 * alone:
            text += f"; the prior holds it to ±{_REACH * 100 * with_prior:.2g} % (95 %)"
        directions.append(Direction(vector, alone, with_prior, text))
    return Identifiability(
        names=tuple(names),
        condition_number=float("inf") if null.any() else float(singular[0] / singular[-1]),
        directions=tuple(directions),
        relative_std=relative_std,
        claimable=relative_std < VAGUE,
        prior_share=np.minimum(np.where(np.isinf(relative_std), 0, relative_std) ** 2 * np.diag(prior), 1),
        combinations=combinations,
        combination_std=np.array([np.linalg.norm(g @ leading) for g in gradients]),
    )


def _words(
    vector: np.ndarray, names: Sequence[str], relative_std: float, combinations: Sequence[Combination]
) -> str:
    """The direction as a sentence."""
    moved = [int(k) for k in np.flatnonzero(vector)]
    group = ", ".join(names[k] for k in moved)
    null = relative_std > _HOPELESS
    how = (
        "without a change of the outputs"
        if null
        else f"and the records identify it only to ±{_REACH * 100 * relative_std:.0f} % (95 %)"
    )
    if len(moved) == 1:
        return (
            f"{group} has no effect on the outputs"
            if null
            else f"{group} is identified only to ±{_REACH * 100 * relative_std:.0f} % (95 %)"
        )
    if np.all(vector[moved] == 1):
        return f"{group} may all be multiplied by one number {how}"
    if len(moved) == 2:
        first, second = moved
        opposite = vector[second] * vector[first] < 0
        way, end = ("up and", "down") if opposite else ("and", "up")
        sums = [
            c.text
            for c in combinations
            if len(c.coefficients) > 1 and np.all(np.any(c.exponents[:, moved], axis=0))
        ]
        only = f" ({sums[0]} is what matters)" if sums else ""
        ratio = f"{abs(vector[second] / vector[first]):.3g} % for each % of {names[first]}"
        return f"{names[first]} {way} {names[second]} {end} together, {ratio}, {how}{only}"
    changes = ", ".join(f"{names[k]} {vector[k]:+.2g}" for k in moved)
    return f"relative changes in the ratio {changes} are possible {how}"


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
        basis: Relative changes (p, k) from `simple_basis`.
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


def simple_basis(null: np.ndarray, tolerance: float = _EXACT) -> np.ndarray:
    """The same space by simpler vectors.

    First come directions that multiply a group of parameters by one number (entries 0 and 1), then the vectors
    that move fewest parameters.

    Args:
        null: Orthonormal columns (p, k).
        tolerance: Entries below this share of the largest do not count as moved.

    Returns:
        (p, k); the largest entry of each column is 1.
    """

    def moved(vector: np.ndarray) -> int:
        return int(np.count_nonzero(normalise(vector, tolerance)))

    size, count = null.shape
    groups = [v for v in _sign_vectors(null) if np.all(v >= 0)] if count <= _MOST_SIGNS else []
    circuits = _circuits(null) if count and comb(size, count - 1) <= _MOST_CIRCUITS else []
    chosen: list[np.ndarray] = []
    for vector in [*sorted(groups, key=moved), *sorted(circuits, key=moved)]:
        words = np.stack([normalise(v, tolerance) for v in [*chosen, vector]])
        words /= np.linalg.norm(words, axis=1, keepdims=True)
        if len(chosen) < count and np.linalg.svd(words, compute_uv=False)[-1] > max(tolerance, 1e-2):
            chosen.append(normalise(vector))
    if len(chosen) < count:
        chosen = [normalise(vector) for vector in null.T]
    return np.reshape(chosen, (count, size)).T


def normalise(vector: np.ndarray, tolerance: float = _EXACT) -> np.ndarray:
    """Largest entry 1, entries below the tolerance 0, entries near -1 and 1 exact."""
    largest = vector[np.argmax(np.abs(vector) > (1 - tolerance) * np.abs(vector).max())]
    vector = vector / largest
    vector = np.where(np.abs(vector) < tolerance, 0.0, vector)
    return np.where(np.abs(np.abs(vector) - 1) < tolerance, np.sign(vector), vector)


def _sign_vectors(null: np.ndarray) -> list[np.ndarray]:
    """All vectors of the space with entries -1, 0 and 1: each is known by its entries in the pivot rows."""
    rows = np.asarray(qr(null.T, pivoting=True)[-1])[: null.shape[1]]
    to_vector = null @ np.linalg.inv(null[rows])
    found = []
    for signs in product((0, 1, -1), repeat=len(rows)):
        if next((s for s in signs if s), 0) != 1:
            continue
        vector = to_vector @ np.array(signs, float)
        if np.all(np.abs(vector - np.round(vector)) < _EXACT) and np.abs(vector).max() < 1.5:
            found.append(np.round(vector))
    return found


def _circuits(null: np.ndarray) -> list[np.ndarray]:
    """Vectors of the space that vanish in k - 1 rows, for every choice of rows: those of least support are here."""
    size, count = null.shape
    found = []
    for rows in combinations(range(size), count - 1):
        _, values, vectors = np.linalg.svd(null[list(rows)].reshape(count - 1, count))
        if count == 1 or values[-1] > 1e-6:
            found.append(normalise(null @ vectors[-1]))
    return found
