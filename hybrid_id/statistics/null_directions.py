"""Readable bases of null spaces: the simplest relative changes of parameters that leave the outputs as they are."""

from __future__ import annotations

from itertools import combinations, product
from math import comb

import numpy as np
from scipy.linalg import qr

_EXACT = 1e-3  # entries of a numerical null vector closer than this are equal
_MOST_CIRCUITS = 3000
_MOST_SIGNS = 6


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


def _pivots(null: np.ndarray) -> np.ndarray:
    """Rows (k,) that determine a vector of the space."""
    return np.asarray(qr(null.T, pivoting=True)[-1])[: null.shape[1]]


def _sign_vectors(null: np.ndarray) -> list[np.ndarray]:
    """All vectors of the space with entries -1, 0 and 1: each is known by its entries in the pivot rows."""
    rows = _pivots(null)
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
