"""Changes of a model's parameters that its records do not identify, in words."""

from __future__ import annotations

from dataclasses import replace

from hybrid_id.records.dataset import Dataset
from hybrid_id.study.checks import check_identifiability
from hybrid_id.systems.chain import System


def not_identifiable(dataset: Dataset, system: System) -> tuple[str, ...]:
    """Changes of a fitted model's parameters that its records do not see.

    A weight or an inertia that is held at its claimed value lends its scale to all torques: it is freed here, so that a
    wrong claim is not taken for knowledge.

    Args:
        dataset: its train records tell.
        system: the fitted model.
    """
    words = [one.text for one in check_identifiability(dataset, system).directions]
    held = [
        i
        for i in system.table
        if not i.spec.estimate and i.spec.value > 0 and ("N" in i.spec.unit or "kg" in i.spec.unit)
    ]
    if held:
        freed = system.with_specs({i.name: replace(i.spec, estimate=True) for i in held})
        for one in check_identifiability(dataset, freed).directions:
            claims = [
                f"{i.name} at {i.spec.value:.4g} {i.spec.unit}" for i in held if _names(one.text, i.name)
            ]
            if claims:
                words.append(f"{one.text}; only the claim of {' and '.join(claims)} sets it")
    return tuple(words)


def _names(text: str, name: str) -> bool:
    return name in text.replace(",", " ").split()
