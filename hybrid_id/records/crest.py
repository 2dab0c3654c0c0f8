"""Crest factors of a multisine with the phases that people use when they do not optimise them."""

from dataclasses import replace

import numpy as np

from hybrid_id.records.excitation import Multisine, schroeder_phases

POINTS = 40  # per period of the highest tone
DRAWS = 100


def crest_factor(signal: np.ndarray) -> float:
    """Peak over RMS of the alternating part of a signal (T,)."""
    moving = signal - np.mean(signal)
    return float(np.max(np.abs(moving)) / np.sqrt(np.mean(moving**2)))


def usual_crest_factors(design: Multisine, seed: int = 0) -> dict[str, float]:
    """Crest factor of the same tones with Schroeder's phases, and the median over random phases.

    Args:
        design: The multisine; its tones and their amplitudes are kept.
        seed: Of the random phases.
    """
    count = int(np.ceil(POINTS * design.period * design.frequencies[-1]))
    time = design.period * np.arange(count) / count
    random = np.random.default_rng(seed).uniform(0, 2 * np.pi, (DRAWS, len(design.frequencies)))
    drawn = [crest_factor(replace(design, phases=phases).at(time)) for phases in random]
    schroeder = replace(design, phases=schroeder_phases(design.amplitudes**2)).at(time)
    return {"Schroeder": crest_factor(schroeder), "random": float(np.median(drawn))}
