"""Sums of torques of which some are not there."""

from collections.abc import Sequence

from torch import Tensor


def sum_if_any(terms: Sequence[Tensor | None]) -> Tensor | None:
    """Sum of the terms that are there; None where there is none."""
    found = [t for t in terms if t is not None]
    return sum(found[1:], found[0]) if found else None


def sum_of(terms: Sequence[Tensor | None], like: Tensor) -> Tensor:
    """The same with a single zero, which costs nothing to add, where there is none."""
    found = sum_if_any(terms)
    return like.new_zeros(1) if found is None else found
