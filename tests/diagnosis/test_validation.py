"""Errors on records that an estimate has not seen, and what they say of one model against another."""

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter
from scipy.stats import binom
from scipy.stats import t as student

from hybrid_id.diagnosis.criteria import CRITERIA
from hybrid_id.diagnosis.validation import (
    BLOCK,
    FEWEST,
    Validation,
    autocorrelation,
    effective_samples,
    mean_square,
    p_values,
    validation,
)

STEP = 0.01
BLOCKS, ROWS = 40, 6


def seen(errors: Sequence[np.ndarray]) -> Validation:
    """Errors of records, one each."""
    return validation(errors, STEP, [f"run{k}" for k in range(len(errors))])


def noise(rng: np.random.Generator, size: float = 1.0) -> list[np.ndarray]:
    return [size * rng.standard_normal((n, 1)) for n in (120, 90, 100)]


def from_blocks(blocks: np.ndarray) -> Validation:
    """Blocks ``(ROWS * BLOCKS,)`` of records of one length."""
    row = np.repeat(np.arange(ROWS), BLOCKS)
    return Validation(blocks, np.full(len(blocks), 25), row, 100.0, row)


def autoregression(rng: np.random.Generator, shape: tuple[int, ...], memory: float) -> np.ndarray:
    """``x_t = a x_{t-1} + e_t`` along the last axis, of unit variance."""
    start = rng.standard_normal((*shape[:-1], 200 + shape[-1]))
    series = np.asarray(lfilter([np.sqrt(1.0 - memory**2)], [1.0, -memory], start, axis=-1))
    return series[..., 200:]


@given(st.lists(st.integers(1, 130), min_size=1, max_size=4), st.integers(1, 3), st.integers(0, 99))
def test_blocks_are_parts_of_the_mean_square(lengths: list[int], outputs: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    errors = [rng.standard_normal((n, outputs)) for n in lengths]
    found, length = seen(errors), round(BLOCK / STEP)
    assert found.error == pytest.approx(mean_square(errors))
    assert found.sizes.sum() == sum(e.size for e in errors)
    assert [int((found.row == k).sum()) for k in range(len(errors))] == [-(-n // length) for n in lengths]
    for k, error in enumerate(errors):
        assert found.blocks[found.row == k].sum() == pytest.approx(np.square(error).sum())


def test_records_are_the_witnesses_where_errors_last_as_long_as_they_do(rng: np.random.Generator) -> None:
    """One of two records better and one worse says nothing, however many blocks each has."""
    base = 1e6 * rng.uniform(0.9, 1.1, ROWS * BLOCKS)  # far above the noise
    better = np.repeat([0.2, 5.0] * (ROWS // 2), BLOCKS)
    mixed, surplus = from_blocks(base * better), from_blocks(0.5 * base)
    (t, n), (sure, _) = mixed.over_records(from_blocks(base)), surplus.over_records(from_blocks(base))
    assert n == ROWS and abs(t) < 0.1 and sure > 50.0
    assert from_blocks(base).over_records(mixed)[0] == pytest.approx(-t)


def test_records_below_the_noise_are_no_witnesses(rng: np.random.Generator) -> None:
    """A joint that stands still errs by next to nothing with one model and by nothing with another."""
    sizes, row = np.full(36 * BLOCKS, 25), np.repeat(np.arange(36), BLOCKS)
    moving, still = 25.0 * rng.uniform(5.0, 15.0, 6 * BLOCKS), np.zeros(30 * BLOCKS)
    one, other = (
        Validation(np.r_[more * moving, still + rest], sizes, row, 100.0, row)
        for more, rest in ((1.1, 0.0), (1.0, 10.0))
    )
    t, n = one.over_records(other)
    assert n == 6 and t < -2.0
    assert other.over_records(one) == (pytest.approx(-t), 6)


def test_few_records_are_divided(rng: np.random.Generator) -> None:
    for rows in (1, 2, 3):
        row = np.repeat(np.arange(rows), BLOCKS)
        one, other = (
            Validation(size * rng.uniform(0.9, 1.1, len(row)), np.full(len(row), 25), row, 100.0, row)
            for size in (0.8, 1.0)
        )
        t, n = one.over_records(other)
        assert n == rows * -(-FEWEST // rows) >= FEWEST and t > 4.0


@pytest.mark.parametrize("rows", [4, 12])
def test_the_record_wise_difference_of_equals_is_student_s(rows: int) -> None:
    """Two models that err alike: their difference over records exceeds a quantile as often as it says."""
    rng, beyond = np.random.default_rng(5), 0
    for _ in range(400):
        row = np.repeat(np.arange(rows), BLOCKS)
        own = np.exp(rng.standard_normal((2, rows)))[:, row]
        one, other = (Validation(size, np.full(len(row), 25), row, 100.0, row) for size in own)
        t, n = one.over_records(other)
        beyond += abs(t) > student.isf(0.05, n - 1)
    assert 0.06 < beyond / 400 < 0.14


def test_samples_without_a_measurement_count_for_nothing(rng: np.random.Generator) -> None:
    (error,) = [rng.standard_normal((100, 2))]
    missing = error.copy()
    missing[::2, 1] = 0.0  # its weight is zero
    found = seen([missing])
    assert found.error == pytest.approx(np.square(missing).sum() / 150)
    assert seen([np.zeros((100, 1))]).error == 0.0


def test_fall_is_the_relative_fall_of_the_mean_square(rng: np.random.Generator) -> None:
    errors = noise(rng)
    whole, half = seen(errors), seen([0.5 * e for e in errors])
    assert half.fall(whole) == pytest.approx(0.75)
    assert whole.fall(whole) == 0.0
    assert whole.fall(half) == pytest.approx(-3.0)


def test_no_record_counts_for_more_than_the_next(rng: np.random.Generator) -> None:
    """One record that every model loses decides nothing; of windows, all of a record's share its weight."""
    errors = [rng.standard_normal((200, 1)) * size for size in (1.0, 2.0, 2.0, 50.0, 50.0)]
    found = validation(errors, STEP, ("a", "b", "b", "c", "c"))
    weights = found.even_weights()
    assert weights[:2] == pytest.approx([1.0, 1.0]) and weights[2] < 0.01
    even = found.weighted(weights)
    sums = np.bincount(even.record, even.blocks) / np.bincount(even.record, even.sizes)
    assert sums[2] == pytest.approx(sums[1])
    assert seen(errors[:1]).even_weights() == pytest.approx([1.0])
    better = validation([0.5 * e for e in errors[:3]] + errors[3:], STEP, ("a", "b", "b", "c", "c"))
    assert better.fall(found) < 0.01 and better.weighted(weights).fall(even) > 0.3


def test_smaller_errors_are_better_and_none_is_better_than_itself(rng: np.random.Generator) -> None:
    poor, good = seen(noise(rng, 3.0)), seen(noise(rng))
    assert good.z(poor) > 2.0
    assert poor.z(good) == pytest.approx(-good.z(poor))
    assert good.z(good) == 0.0


def test_an_improvement_at_the_start_is_not_drowned_by_the_end_of_free_runs(rng: np.random.Generator) -> None:
    growth = np.tile(np.linspace(0.1, 3.0, BLOCKS) ** 4, ROWS)
    simpler = from_blocks(growth * rng.uniform(0.5, 1.5, ROWS * BLOCKS))
    richer = from_blocks(simpler.blocks * rng.uniform(0.6, 1.0, ROWS * BLOCKS))
    assert richer.z(simpler) > 5.0
    assert p_values([richer], simpler)[0] < 0.01


def under_the_null(
    rng: np.random.Generator, candidates: int, memory: float
) -> tuple[list[Validation], Validation]:
    """Models none of which predicts better: relative differences of symmetric signs, which go together."""
    common = autoregression(rng, (ROWS, BLOCKS), memory).ravel()
    own = autoregression(rng, (candidates, ROWS, BLOCKS), memory).reshape(candidates, -1)
    relative = np.clip(0.1 * (0.8 * common + 0.6 * own), -0.9, 0.9)
    level = rng.uniform(0.5, 2.0, ROWS).repeat(BLOCKS)
    return [from_blocks(level * (1.0 + one) / (1.0 - one)) for one in relative], from_blocks(level)


@pytest.mark.parametrize("memory", [0.0, 0.6])
@pytest.mark.parametrize("candidates", [1, 5, 30])
def test_a_search_where_nothing_is_missing_errs_at_most_at_its_level(candidates: int, memory: float) -> None:
    """Over all candidates together, however they and neighbouring blocks go together."""
    seeds, wrong = 200, 0
    for seed in range(seeds):
        found = p_values(*under_the_null(np.random.default_rng(seed), candidates, memory), seed=seed)
        wrong += found.min() <= CRITERIA.false_alarms
    # the binomial 99.9 % point of the level
    assert wrong <= binom.ppf(0.999, seeds, CRITERIA.false_alarms), wrong / seeds


@pytest.mark.parametrize("candidates", [1, 5, 30])
def test_a_search_finds_the_one_that_is_better(candidates: int) -> None:
    found = 0
    for seed in range(20):
        richer, simpler = under_the_null(np.random.default_rng(seed), candidates, 0.6)
        richer[0] = from_blocks(0.8 * richer[0].blocks)
        found += p_values(richer, simpler, seed=seed)[0] <= CRITERIA.false_alarms
    assert found >= 18


def test_an_effect_that_acts_at_few_instants_is_seen(rng: np.random.Generator) -> None:
    """Where it acts the errors fall tenfold, elsewhere a needless parameter makes them a little worse."""
    blocks = 1e4 * rng.uniform(0.9, 1.1, ROWS * BLOCKS)  # far above the noise
    acts = np.arange(ROWS * BLOCKS) % 20 == 0
    simpler = from_blocks(np.where(acts, 10.0, 1.0) * blocks)
    richer = from_blocks(np.where(acts, 1.0, 1.1) * blocks)
    assert richer.z(simpler) < 0.0
    assert p_values([richer], simpler)[0] < 0.05


def test_all_candidates_are_judged_by_the_same_draws(rng: np.random.Generator) -> None:
    richer, simpler = under_the_null(rng, 1, 0.0)
    alone = p_values(richer, simpler, seed=3)
    # twins have one statistic: a search over both is no longer a search
    np.testing.assert_array_equal(p_values(richer * 7, simpler, seed=3), np.repeat(alone, 7))
    np.testing.assert_array_equal(p_values(richer, simpler, seed=3), alone)
    assert not np.array_equal(p_values(richer, simpler, seed=4), alone)


@given(st.integers(1, 8), st.integers(0, 30))
def test_the_order_of_candidates_says_nothing(candidates: int, seed: int) -> None:
    richer, simpler = under_the_null(np.random.default_rng(seed), candidates, 0.5)
    found, order = p_values(richer, simpler), np.random.default_rng(seed).permutation(candidates)
    np.testing.assert_allclose(p_values([richer[k] for k in order], simpler), found[order])
    assert ((found > 0.0) & (found <= 1.0)).all()
    assert p_values([], simpler).shape == (0,)


def test_a_model_against_itself_is_no_finding(rng: np.random.Generator) -> None:
    _, simpler = under_the_null(rng, 1, 0.0)
    assert p_values([simpler], simpler)[0] == 1.0


@pytest.mark.parametrize("memory", [0.0, 0.5, 0.9])
def test_independent_samples_of_an_autoregression(rng: np.random.Generator, memory: float) -> None:
    """N (1 - a) / (1 + a) for x_t = a x_{t-1} + e_t."""
    records: Sequence[np.ndarray] = list(autoregression(rng, (4, 20_000), memory)[..., None])
    expected = 80_000 * (1 - memory) / (1 + memory)
    assert effective_samples(records) == pytest.approx(expected, rel=0.15)


def test_white_noise_has_no_colour_and_what_is_smooth_is_all_colour(rng: np.random.Generator) -> None:
    long = [rng.standard_normal((20_000, 1)) for _ in range(3)]
    smooth = [np.sin(np.linspace(0.0, 20.0, 20_000))[:, None]]
    assert autocorrelation(long) < 0.02
    assert autocorrelation(smooth) > 0.99
    assert autocorrelation([a + 1.0 * np.sqrt(2.0) * smooth[0] for a in long]) == pytest.approx(0.5, abs=0.03)
    assert autocorrelation([np.zeros((10, 1))]) == 0.0


def test_a_run_that_diverged_is_no_noise() -> None:
    assert autocorrelation([np.array([[0.1], [np.nan], [0.2]])]) == 1.0


def test_a_draw_of_records_weighs_them_whole_and_lacks_none() -> None:
    one, generator = from_blocks(np.ones(ROWS * BLOCKS)), np.random.default_rng(3)
    for records, spread in (
        (True, 1.0 + 2.0 / BLOCKS),
        (False, 1.0 / BLOCKS),
    ):  # variances of a record's mean weight
        draws = one.drawn(generator, records=records).reshape(-1, ROWS, BLOCKS)
        assert draws.min() > 0.0 and draws.mean() == pytest.approx(1.0, abs=0.05)
        assert draws.mean(2).var(0).mean() == pytest.approx(spread, rel=0.2)


def test_errors_of_all_records_but_one(rng: np.random.Generator) -> None:
    errors = noise(rng)
    rest = seen(errors).without(1)
    assert rest.error == pytest.approx(mean_square([errors[0], errors[2]]))
    assert set(rest.record) == set(rest.row) == {0, 2}


def test_the_record_that_an_effect_rests_on_is_told() -> None:
    def of(*sizes: float) -> Validation:
        return validation([np.full((100, 1), size) for size in sizes], 0.01, ["a", "b", "c"])

    simpler = of(2.0, 2.0, 2.0)
    assert of(1.0, 2.1, 2.0).rests_on(simpler) == 0
    assert of(1.0, 1.5, 2.5).rests_on(simpler) == 0  # without the first the third outweighs the second
    assert of(1.0, 2.1, 1.8).rests_on(simpler) is None
    assert of(2.1, 2.1, 2.1).rests_on(simpler) is None  # it rests on nothing
