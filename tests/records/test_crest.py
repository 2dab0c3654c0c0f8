"""Crest factors of the phases that people use."""

import numpy as np
import pytest

from hybrid_id.records.excitation import crest_factor, design_multisine, usual_crest_factors


def test_crest_factor_of_a_sine_is_the_root_of_two() -> None:
    time = np.linspace(0, 1, 100_001)[:-1]
    assert crest_factor(3 + np.sin(2 * np.pi * time)) == pytest.approx(np.sqrt(2))


def test_usual_phases_of_twenty_flat_tones_are_those_of_the_literature() -> None:
    design = design_multisine(
        (0.5, 10.0), sample_time=0.002, duration=2.0, amplitude_limits=1.0, tones=20, starts=2
    )
    usual = usual_crest_factors(design)
    assert usual["Schroeder"] == pytest.approx(1.77, abs=0.02)
    assert usual["random"] == pytest.approx(2.7, abs=0.2)
    assert design.crest_factor < usual["Schroeder"]
