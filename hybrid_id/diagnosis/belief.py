"""When an effect is believed: by how much, and how surely, the model with it predicts better."""

from __future__ import annotations

from hybrid_id.diagnosis.explanation import Explanation
from hybrid_id.diagnosis.ranking import LEAST_RATIO, is_explained, is_white

MORE_RATIO = 1.15
"""Least fall of the RMS of the errors beside another effect, whose fit may leave what another can pick up."""
COMPLETE_RATIO = 1.05
"""The same for an effect that leaves white noise: what a wrong formula leaves, no other effect explains to the end. Or
that leaves so little beside it that nothing from outside the catalogue is called for, where without it something is."""
LEAST_Z = 3.0
"""An effect must also lower the errors of prediction by so many standard errors, block by block."""
LARGE_RATIO, LARGE_Z = 1.2, 1.5
"""A gain as large as this one is believed earlier: where a second effect is missing, blocks scatter."""


def better(richer: Explanation, simpler: Explanation, least: float | None = None) -> bool:
    """Whether a richer model predicts records that it has not seen clearly better.

    Args:
        richer: with more effects.
        simpler: with fewer.
        least: factor by which the RMS of the errors has to fall; by default as for one more effect.
    """
    ratio, z = richer.evidence.gain(simpler.evidence), richer.evidence.z(simpler.evidence)
    least = least_ratio(simpler) if least is None else least
    if is_white(richer) or (is_explained(richer) and not is_explained(simpler)):
        least = min(least, COMPLETE_RATIO)
    return (ratio >= least and z >= LEAST_Z) or (ratio >= LARGE_RATIO and z >= LARGE_Z)


def least_ratio(simpler: Explanation) -> float:
    """By which factor an effect beside a model's has to lower the RMS of the errors of prediction."""
    return MORE_RATIO if simpler.effects else LEAST_RATIO
