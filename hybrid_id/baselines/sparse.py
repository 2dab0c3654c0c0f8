"""Baseline: sparse regression on the reconstructed torque, as in SINDy.

Of the library in :mod:`.reconstruct`, groups that would hardly be missed are dropped one by one and the rest fitted
again (sequential thresholding: S. L. Brunton, J. L. Proctor and J. N. Kutz, PNAS 113, 2016); the threshold is the
largest whose error on records left out is within one standard error of the least.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from typing import Any

import numpy as np

from hybrid_id.baselines.answer import answer, named
from hybrid_id.baselines.reconstruct import Name, Torque, reconstructed
from hybrid_id.records.dataset import Dataset
from hybrid_id.systems.chain import System

THRESHOLDS = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2)
"""Least RMS of what only a group explains over that of all."""
RIDGE = 1e-8


def sparse(dataset: Dataset, system: System) -> dict[str, Any]:
    """Name the effects whose terms stay, the largest torque first; it has no model to simulate."""
    found: dict[Name, float] = {}
    stays: set[Name] = set()
    for joint in range(len(system.joints)):
        records = [reconstructed(dataset, record, system, joint) for record in dataset.train]
        active, gains = selected(records)
        stays |= active
        found |= gains
    total = sum(found.values()) or 1.0
    ranked = sorted(found, key=lambda name: (name not in stays, -found[name]))
    effects = [named(*name, found[name] / total, selected=name in stays) for name in ranked]
    return answer(dataset.name, effects, {})


def selected(records: Sequence[Torque]) -> tuple[set[Name], dict[Name, float]]:
    """Groups that stay at the chosen threshold, and what each of all groups explains alone beside the model's terms."""
    products = [Products(record) for record in records]
    by_threshold = []
    for threshold in THRESHOLDS:
        errors = []
        for k, held in enumerate(products):
            rest = _sum([one for i, one in enumerate(products) if i != k] or [held])
            errors.append(held.error(rest, thresholded(rest, threshold)))
        by_threshold.append(errors)
    mean = np.mean(by_threshold, axis=1)
    best = int(np.argmin(mean))
    slack = float(np.std(by_threshold[best])) / len(records) ** 0.5
    chosen = max(k for k in range(len(THRESHOLDS)) if mean[k] <= mean[best] + slack)
    whole = _sum(products)
    alone = {name: _size(whole.left(set()) - whole.left({name}), whole) for name in whole.groups}
    return thresholded(whole, THRESHOLDS[chosen]), alone


def thresholded(products: Products, threshold: float) -> set[Name]:
    """Sequential thresholding of whole groups, the one that would be missed least first."""
    active = set(products.groups)
    while active:
        left = products.left(active)
        sizes = {name: _size(products.left(active - {name}) - left, products) for name in active}
        least = min(active, key=lambda name: (sizes[name], name))
        if sizes[least] >= threshold:
            break
        active.remove(least)
    return active


def _size(explained: float, products: Products) -> float:
    """RMS of what is explained over that of all."""
    return float(np.sqrt(max(explained, 0.0) / max(products.square, 1e-300)))


class Products:
    """Inner products of all columns of a regression: all that its solutions need.

    Attributes:
        groups: indices of each group's columns; those of the nominal model come before them.
        gram: ``(m, m)``.
        right: of the columns with the target, ``(m,)``.
        square: of the target with itself.
    """

    def __init__(self, record: Torque) -> None:
        columns, self.groups, self.own = [record.own], {}, record.own.shape[1]
        count = self.own
        for name, terms in record.library.items():
            self.groups[name] = list(range(count, count + terms.shape[1]))
            count += terms.shape[1]
            columns.append(terms)
        whole = np.concatenate(columns, 1)
        self.gram, self.right = whole.T @ whole, whole.T @ record.target
        self.square = float(record.target @ record.target)

    def weights(self, active: set[Name]) -> tuple[np.ndarray, list[int]]:
        """Least squares with a slight ridge on columns of one size, and which columns they are."""
        kept = [*range(self.own), *(i for name in sorted(active) for i in self.groups[name])]
        gram, right = self.gram[np.ix_(kept, kept)], self.right[kept]
        size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
        return np.linalg.solve(
            gram / np.outer(size, size) + RIDGE * np.eye(len(kept)), right / size
        ) / size, kept

    def left(self, active: set[Name]) -> float:
        """Sum of squares that the model's own terms and some groups leave."""
        weights, kept = self.weights(active)
        return self.square - float(weights @ self.right[kept])

    def error(self, train: Products, active: set[Name]) -> float:
        """Share of the squares of this record that is left under the weights of others."""
        weights, kept = train.weights(active)
        cross = 2 * float(weights @ self.right[kept])
        return (self.square - cross + float(weights @ self.gram[np.ix_(kept, kept)] @ weights)) / max(
            self.square, 1e-300
        )


def _sum(several: Sequence[Products]) -> Products:
    """Products of several records taken together."""
    whole = copy(several[0])
    whole.gram = np.sum([one.gram for one in several], axis=0)
    whole.right = np.sum([one.right for one in several], axis=0)
    whole.square = float(np.sum([one.square for one in several]))
    return whole
