"""What a set of records can tell: condition number, worst directions in words, claims that may be made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybrid_id.errors import InputError
from hybrid_id.statistics.combinations import Combination, identifiable_combinations
from hybrid_id.statistics.null_directions import normalise, simple_basis
from hybrid_id.statistics.uncertainty import Arrays, prior_matrix

VAGUE = 0.5  # relative standard error from which a direction counts as not identified
_REACH = 1.96  # standard errors, for the 95 % that all words and tables mean
_NULL_JACOBIAN = 1e-9  # singular values below this share of the largest are rounding
_NULL_INFORMATION = 1e-6  # an information matrix has squared them
_HOPELESS = 30.0  # relative standard error from which a direction is as good as null
_SMALL_ENTRY = 0.1  # entries of a weak (not exact) direction below this are not worth words


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
        singular_values: Of that Jacobian (p,), descending: 1 / relative standard error along each direction.
        directions: What the records alone do not identify.
        relative_std: Predicted relative standard error of each parameter, prior included (p,); inf if none.
        claimable: (p,) bool; whether an interval of the parameter on its own may be claimed.
        prior_share: Share of each parameter's information that is the prior's (p,), 0 to 1.
        combinations: p - len(directions) functions of the parameters that the records identify.
        combination_std: Their predicted relative standard errors, records alone.
    """

    names: tuple[str, ...]
    condition_number: float
    singular_values: np.ndarray
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
    jacobian: Arrays | None = None,
    information: np.ndarray | None = None,
    prior_information: np.ndarray | None = None,
    scale: np.ndarray | None = None,
    inflation: float = 1.0,
    vague: float = VAGUE,
    references: Sequence[str] = (),
) -> Identifiability:
    """Singular value decomposition of the Jacobian with respect to relative changes of the parameters.

    A direction counts as not identified where the records leave the parameter that it moves most with a
    relative standard error above `vague`, given the noise, or where they see nothing of it at all.

    Args:
        values: θ (p,) at which the Jacobian was taken.
        names: Names of the p parameters.
        jacobian: Weighted by 1 / noise (convention: `uncertainty`), one record or several.
        information: ``JᵀJ`` (p, p) in its place; weak directions are seen less sharply.
        prior_information: Inverse covariance of a Gaussian prior, (p, p) or its diagonal (p,).
        scale: Size that stands in for a parameter whose value is zero (p,).
        inflation: Factor on standard errors for correlated residuals.
        vague: Relative standard error from which a direction counts as not identified.
        references: Names of parameters to divide by in combinations, motor constants say.

    Raises:
        InputError: A parameter of value zero without a scale.
    """
    values = np.asarray(values, float)
    size = np.where(values == 0, 0.0 if scale is None else scale, values)  # signed: d ln θ = d θ / θ
    if np.any(size == 0):
        zero = names[int(np.flatnonzero(size == 0)[0])]
        raise InputError(f"identifiability: {zero} is zero, so relative changes mean nothing; give its scale")
    root, rounding = _root(jacobian, information)
    _, singular, rows = np.linalg.svd(root * size / inflation, full_matrices=True)
    singular = np.concatenate([singular, np.zeros(len(values) - len(singular))])
    vectors = rows.T
    with np.errstate(divide="ignore"):
        along = np.abs(vectors).max(axis=0) / singular  # relative error of the parameter that moves most
    null = singular <= rounding * len(values) * singular[0]
    hopeless = null | (along > _HOPELESS)
    weak = simple_basis(vectors[:, ~hopeless & (along > vague)], _SMALL_ENTRY)
    moves = np.column_stack([simple_basis(vectors[:, hopeless]), weak])
    basis = np.column_stack([moves[:, : hopeless.sum()], *(normalise(v, _SMALL_ENTRY) for v in weak.T)])

    combinations = identifiable_combinations(basis, size, names, references)
    seen = vectors[:, ~hopeless] / singular[~hopeless]
    gradients = [c.gradient(size) / c.evaluate(size) for c in combinations]
    data = (vectors[:, ~hopeless] * singular[~hopeless] ** 2) @ vectors[:, ~hopeless].T
    prior = prior_matrix(prior_information, len(values)) * np.outer(size, size)
    relative_std = _marginal(data + prior)

    directions = []
    for move, vector in zip(moves.T, basis.T, strict=True):
        # Beyond hope the records leave nothing; `data` holds only what they do see.
        alone, with_prior = (_along(move, matrix) for matrix in (data, data + prior))
        text = _words(vector, names, alone, combinations)
        if with_prior < 0.8 * alone:
            text += f"; the prior holds it to ±{_REACH * 100 * with_prior:.2g} % (95 %)"
        directions.append(Direction(vector, alone, with_prior, text))
    return Identifiability(
        names=tuple(names),
        condition_number=float("inf") if null.any() else float(singular[0] / singular[-1]),
        singular_values=singular,
        directions=tuple(directions),
        relative_std=relative_std,
        claimable=relative_std < vague,
        prior_share=np.minimum(np.where(np.isinf(relative_std), 0, relative_std) ** 2 * np.diag(prior), 1),
        combinations=combinations,
        combination_std=np.array([np.linalg.norm(g @ seen) for g in gradients]),
    )


def _root(jacobian: Arrays | None, information: np.ndarray | None) -> tuple[np.ndarray, float]:
    """R (n, p) with ``RᵀR`` the information, and the relative size of its rounding errors."""
    if information is not None:
        unit = np.sqrt(np.where(np.diag(information) > 0, np.diag(information), 1.0))
        squares, vectors = np.linalg.eigh(information / np.outer(unit, unit))
        return np.sqrt(np.maximum(squares, 0.0))[:, None] * vectors.T * unit, _NULL_INFORMATION
    if jacobian is None:
        raise InputError("identifiability: there is neither a Jacobian nor an information matrix; give one")
    records = [jacobian] if isinstance(jacobian, np.ndarray) else jacobian
    # where a simulation has diverged, it tells nothing
    told = (np.nan_to_num(np.reshape(j, (-1, np.shape(j)[-1])), posinf=0.0, neginf=0.0) for j in records)
    factors = [np.linalg.qr(j)[1] for j in told]
    return np.linalg.qr(np.concatenate(factors))[1], _NULL_JACOBIAN


def _marginal(information: np.ndarray) -> np.ndarray:
    """Standard errors (p,) from an information matrix on a relative scale; inf where a null direction leads."""
    # in units of each parameter's own error: else one that is told far better than another drowns it
    unit = np.sqrt(np.where(np.diag(information) > 0, np.diag(information), 1.0))
    squares, vectors = np.linalg.eigh(information / np.outer(unit, unit))
    null = squares <= 1e-13 * len(squares) * squares[-1]
    std = np.linalg.norm(vectors[:, ~null] / np.sqrt(squares[~null]), axis=1) / unit
    return np.where(np.linalg.norm(vectors[:, null], axis=1) > 1e-3, np.inf, std)


def _along(vector: np.ndarray, information: np.ndarray) -> float:
    """Standard error of the parameter that moves most (entry 1) when only this direction is free."""
    seen = float(vector @ information @ vector)
    floor = 1e-13 * float(np.trace(information)) * float(vector @ vector)
    return seen**-0.5 if seen > floor else float("inf")


def _words(
    vector: np.ndarray, names: Sequence[str], relative_std: float, combinations: Sequence[Combination]
) -> str:
    """The direction as a sentence."""
    moved = [int(k) for k in np.flatnonzero(vector)]
    group = ", ".join(names[k] for k in moved)
    null = relative_std > _HOPELESS
    told = (
        "without a change of the outputs"
        if null
        else f"and the records tell it only to ±{_REACH * 100 * relative_std:.0f} % (95 %)"
    )
    if len(moved) == 1:
        return (
            f"{group} has no effect on the outputs"
            if null
            else f"{group} is told only to ±{_REACH * 100 * relative_std:.0f} % (95 %)"
        )
    if np.all(vector[moved] == 1):
        return f"{group} may all be multiplied by one number {told}"
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
        return f"{names[first]} {way} {names[second]} {end} together, {ratio}, {told}{only}"
    changes = ", ".join(f"{names[k]} {vector[k]:+.2g}" for k in moved)
    return f"relative changes in the ratio {changes} are possible {told}"
