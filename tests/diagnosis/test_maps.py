"""Maps of what a model misses, against what was left out of it, and errors after reversals that were made."""

import numpy as np
import pytest

from hybrid_id.diagnosis.fits import Fits
from hybrid_id.diagnosis.maps import BINS, after_reversals, mean_after_reversals, torque_map
from hybrid_id.diagnosis.result import Diagnosis
from hybrid_id.records.dataset import Dataset
from hybrid_id.systems import System

Found = tuple[Dataset, System, Diagnosis]


def test_a_missing_spring_is_a_torque_over_the_angle(diagnosed: Found) -> None:
    dataset, _, found = diagnosed
    told = torque_map(Fits(dataset), found.search.base, 1, "load")
    seen = ~np.isnan(told.torque)
    assert told.share > 0.5 and 0.1 < seen.mean() < 1.0
    # over the angle it falls as the spring pulls back, 0.6 N m/rad, and the speed hardly matters
    angle, speed = np.meshgrid(told.angle, told.speed)
    design = np.stack(
        [angle[seen], speed[seen] / np.ptp(told.speed) * np.ptp(told.angle), np.ones(seen.sum())], 1
    )
    slopes = np.linalg.lstsq(design, told.torque[seen], rcond=None)[0]
    assert slopes[0] < 0.0 and abs(slopes[0]) > 4.0 * abs(slopes[1])
    right = torque_map(Fits(dataset), found.search.chosen, 1, "load")
    assert right.share < 0.05


def test_errors_after_reversals_are_those_that_were_made(rng: np.random.Generator) -> None:
    time = np.arange(0.0, 60.0, 0.005)
    speed = np.cos(2 * np.pi * time / 1.5)  # turns round every 0.75 s, first at 0.375 s
    since = (time - 0.375) % 0.75
    lag = 0.2 * np.exp(-since / 0.1) * np.sign(speed)
    noise = 0.05 * rng.standard_normal(time.size)
    told = mean_after_reversals("q_m1", [(time, speed, lag + noise)])
    assert told is not None and told.count == 80 and told.mean.size == BINS
    lasting = ~np.isnan(told.mean)
    assert told.time[lasting][-1] == pytest.approx(0.75, abs=0.025)
    expected = 0.2 * np.exp(-told.time[lasting] / 0.1)
    assert np.abs((told.mean[lasting] - expected) / told.error[lasting]).mean() < 2.0
    # five samples of the noise in each part, 80 times
    assert np.median(told.error[lasting]) == pytest.approx(0.05 / np.sqrt(5 * 80), rel=0.3)


def test_a_stop_and_a_noisy_standstill_are_no_reversals(rng: np.random.Generator) -> None:
    time = np.arange(0.0, 10.0, 0.01)
    speed = np.where(time % 2.0 < 1.0, 1.0, 0.0) + 0.003 * rng.standard_normal(time.size)
    assert mean_after_reversals("q_m1", [(time, speed, np.ones_like(time))]) is None


def test_a_lost_run_has_no_mean() -> None:
    time = np.arange(0.0, 60.0, 0.01)
    assert mean_after_reversals("q_m1", [(time, np.cos(time), np.full_like(time, np.nan))]) is None


def test_a_right_model_leaves_less_after_reversals(diagnosed: Found) -> None:
    dataset, _, found = diagnosed
    fits = Fits(dataset)
    (poorer,), (right,) = (after_reversals(fits, one) for one in found.fitted.values())
    assert poorer.count == right.count
    assert np.nanmean(np.abs(right.mean)) < 0.3 * np.nanmean(np.abs(poorer.mean))
