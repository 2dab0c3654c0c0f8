"""Excitation in which play and flexibility of a gear act most, or least (paper, II.D)."""

import numpy as np
import pytest
from drives import flexible_drive, rigid_drive

from hybrid_id.errors import InputError
from hybrid_id.study.excitation import bands_by_gear

ASKED = {"sample_time": 0.002, "duration": 4.0, "amplitude": 8.0, "tones": 4}


def test_a_stiff_spring_bends_more_the_faster_the_link_is_moved() -> None:
    most = bands_by_gear(flexible_drive(), (0.5, 8.0), "most", **ASKED)
    least = bands_by_gear(flexible_drive(), (0.5, 8.0), "least", **ASKED)
    assert [one.band for one in most] == [one.band for one in reversed(least)]
    assert most[0].band[0] > least[0].band[0]
    assert most[0].share > 2.0 * least[0].share > 0.0


def test_below_resonance_the_deflection_is_the_links_inertia_over_the_stiffness() -> None:
    system = flexible_drive()
    values = {one.name: one.spec.value for one in system.table}
    slow = min(
        bands_by_gear(system, (1.0, 3.0), "least", **ASKED | {"tones": 1}), key=lambda one: one.band[1]
    )
    speed = 2.0 * np.pi * np.array(slow.band)
    ends = values["J_a"] * speed**2 / values["k"]
    friction = values["F_va"] * speed / values["k"]  # in quadrature with it
    assert 0.5 * ends[0] < slow.share < 2.0 * np.hypot(ends, friction)[1]


def test_a_rigid_gear_has_no_such_band() -> None:
    with pytest.raises(InputError, match="rigid"):
        bands_by_gear(rigid_drive(), (0.5, 8.0), "most", **ASKED)


def test_a_band_too_narrow_for_its_tones_is_refused() -> None:
    with pytest.raises(InputError, match="no part of 2 to 2"):
        bands_by_gear(flexible_drive(), (2.0, 2.1), "least", **ASKED)
