"""Arithmetic on rows: numbers that are the same for every sample, or tensors with a value for each.

A robot's geometry is mostly zeros and ones. They stay plain numbers and are folded here, so that what a compiled step
records of a whole arm holds only the products that differ from zero.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

Row = float | Tensor
"""One quantity: a number, or a value for each sample, ``(B,)``."""
Vector = tuple[Row, Row, Row]
Matrix = tuple[Vector, Vector, Vector]
"""Rows of a 3 x 3 matrix."""

ZERO: Vector = (0.0, 0.0, 0.0)


def add(a: Row, b: Row) -> Row:
    """Sum; nothing is computed where one of them is the number zero."""
    if isinstance(a, float):
        if a == 0.0:
            return b
    elif not isinstance(b, float):
        return a + b
    return a if _is(b, 0.0) else a + b


def subtract(a: Row, b: Row) -> Row:
    """Difference."""
    if _is(b, 0.0):
        return a
    return -b if _is(a, 0.0) else a - b


def multiply(a: Row, b: Row) -> Row:
    """Product; nothing is computed where one of them is the number zero or one."""
    if not isinstance(a, float):
        if not isinstance(b, float):
            return a * b
        a, b = b, a
    if a == 0.0 or _is(b, 0.0):
        return 0.0
    if a == 1.0:
        return b
    return -b if a == -1.0 else a * b


def total(terms: Sequence[Row]) -> Row:
    """Sum of several."""
    found: Row = 0.0
    for term in terms:
        found = add(found, term)
    return found


def dot(a: Vector, b: Vector) -> Row:
    """Scalar product."""
    (a_x, a_y, a_z), (b_x, b_y, b_z) = a, b
    return add(add(multiply(a_x, b_x), multiply(a_y, b_y)), multiply(a_z, b_z))


def cross(a: Vector, b: Vector) -> Vector:
    """Vector product."""
    (a_x, a_y, a_z), (b_x, b_y, b_z) = a, b
    return (
        subtract(multiply(a_y, b_z), multiply(a_z, b_y)),
        subtract(multiply(a_z, b_x), multiply(a_x, b_z)),
        subtract(multiply(a_x, b_y), multiply(a_y, b_x)),
    )


def plus(*vectors: Vector) -> Vector:
    """Sum of vectors."""
    x, y, z = (total(parts) for parts in zip(*vectors, strict=True))
    return x, y, z


def scale(factor: Row, vector: Vector) -> Vector:
    """Vector times a factor."""
    x, y, z = vector
    return multiply(factor, x), multiply(factor, y), multiply(factor, z)


def times(matrix: Matrix, vector: Vector) -> Vector:
    """Matrix times vector."""
    x, y, z = matrix
    return dot(x, vector), dot(y, vector), dot(z, vector)


def transposed(matrix: Matrix) -> Matrix:
    """Transposed matrix; the inverse of a rotation."""
    (a, b, c), (d, e, f), (g, h, i) = matrix
    return (a, d, g), (b, e, h), (c, f, i)


def product(a: Matrix, b: Matrix) -> Matrix:
    """Product of two matrices."""
    columns = transposed(b)
    x, y, z = (times(columns, row) for row in a)
    return x, y, z


def constant(matrix: Sequence[Sequence[float]], tiny: float = 1e-14) -> Matrix:
    """A matrix of numbers, those next to -1, 0 and 1 exact."""
    x, y, z = (_exact(row, tiny) for row in matrix)
    return x, y, z


def constant_vector(vector: Sequence[float]) -> Vector:
    """A vector of numbers."""
    x, y, z = (float(value) for value in vector)
    return x, y, z


def sine_and_cosine(angle: Row) -> tuple[Row, Row]:
    """Sine and cosine of an angle [rad]."""
    if isinstance(angle, float):
        return math.sin(angle), math.cos(angle)
    known = torch.as_tensor(angle, dtype=torch.float64)
    return torch.sin(known), torch.cos(known)


def _exact(row: Sequence[float], tiny: float) -> Vector:
    x, y, z = (float(round(value)) if abs(value - round(value)) < tiny else float(value) for value in row)
    return x, y, z


def _is(row: Row, value: float) -> bool:
    return isinstance(row, float) and row == value
