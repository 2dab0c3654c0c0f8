"""How far the gap shrinks, with its interval."""

import numpy as np
import pytest

from hybrid_id.diagnosis.held_out import Errors
from hybrid_id.diagnosis.held_out import shrink


def errors(rng: np.random.Generator, size: float, blocks: int, noise: float = 0.0) -> Errors:
    """Errors of one record whose blocks scatter by a fifth about a size."""
    squares = size**2 * (1 + 0.2 * rng.standard_normal(blocks))
    nrmse = float(np.sqrt(squares.mean()))
    return Errors(nrmse, {"run": nrmse}, ((squares,),), noise)


def test_share_lies_in_its_interval(rng: np.random.Generator) -> None:
    found = shrink(errors(rng, 0.1, 16), errors(rng, 0.03, 16), 0.01)
    assert found.share == pytest.approx(
        (found.refit - found.with_effect) / (found.refit - found.floor), rel=1e-12
    )
    assert found.interval[0] < found.share < found.interval[1]
    assert 0.6 < found.share < 0.9


def test_more_blocks_tell_more(rng: np.random.Generator) -> None:
    few, many = (shrink(errors(rng, 0.1, n), errors(rng, 0.05, n, 0.049), 0.049) for n in (6, 600))
    assert np.ptp(many.interval) < 0.5 * np.ptp(few.interval)


def test_the_floor_is_known_to_lie_above_the_noise_only(rng: np.random.Generator) -> None:
    before = errors(rng, 0.1, 600)
    sure = shrink(before, errors(rng, 0.05, 600, noise=0.049), 0.049)
    unsure = shrink(before, errors(rng, 0.05, 600, noise=0.01), 0.049)
    assert sure.interval[0] > 0.9
    assert unsure.interval[0] == pytest.approx(0.05 / 0.09, abs=0.08)
    assert unsure.interval[1] >= unsure.share > 0.95


def test_same_seed_same_interval(rng: np.random.Generator) -> None:
    pair = errors(rng, 0.1, 16), errors(rng, 0.05, 16)
    assert shrink(*pair, 0.01, seed=3) == shrink(*pair, 0.01, seed=3)


def test_nothing_is_closed_where_nothing_changes(rng: np.random.Generator) -> None:
    same = errors(rng, 0.1, 16)
    assert shrink(same, same, 0.05).share == 0.0
    assert shrink(same, same, same.nrmse).share == 0.0


def test_a_model_may_do_better_by_chance_than_the_right_one(rng: np.random.Generator) -> None:
    before, after = errors(rng, 0.1, 30), errors(rng, 0.05, 30, noise=0.06)
    found = shrink(before, after, after.nrmse)
    right = 1.01 * after.nrmse  # the floor is a hundredth higher on these records
    assert found.interval[0] < (before.nrmse - after.nrmse) / (before.nrmse - right) < found.interval[1]
    assert found.interval[1] < 1.3
