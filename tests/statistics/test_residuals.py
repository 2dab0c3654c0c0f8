"""Tests of residuals against processes of which it is known what they are."""

import numpy as np
import pytest
from scipy.signal import lfilter

from hybrid_id.statistics.residuals import ResidualTest, residual_test, whiteness


def test_short_and_silent_records_are_borne() -> None:
    white = whiteness([np.zeros((8, 1))])
    assert white.lags[-1] == 2
    assert np.all(white.correlation == 0.0)


def commanded(generator: np.random.Generator, samples: int) -> np.ndarray:
    """A command that is slow against the sampling."""
    return lfilter([1.0], [1.0, -0.98], generator.standard_normal(samples))


def judged(
    generator: np.random.Generator, *, colour: float = 0.0, follows: float = 0.0, length: int = 1000
) -> ResidualTest:
    """Two records of residuals that are an AR(1) of a colour, and follow the command seven samples late."""
    residual, inputs = [], []
    for samples in (length, length + 500):
        command, noise = commanded(generator, samples), lfilter(
            [1.0], [1.0, -colour], generator.standard_normal(samples)
        )  # fmt: skip
        residual.append(0.1 * (noise + follows * np.roll(command, 7) / command.std()))
        inputs.append({"u1": command, "mode1": np.ones(samples)})
    return residual_test("q_m1", residual, inputs, [0.1, 0.1])


def test_white_residuals_pass_as_often_as_the_level_says(rng: np.random.Generator) -> None:
    found = [judged(rng) for _ in range(200)]
    assert sum(one.verdict == "white" for one in found) >= 194
    assert np.mean([one.rms for one in found]) == pytest.approx(1.0, abs=0.01)
    assert np.mean([one.outside for one in found]) == pytest.approx(0.01, abs=0.005)
    assert sum(bool(one.followed) for one in found) <= 4


@pytest.mark.parametrize(
    ("colour", "length", "verdict"), [(0.5, 1000, "not white"), (0.05, 40_000, "nearly white")]
)
def test_coloured_residuals_fail(rng: np.random.Generator, colour: float, length: int, verdict: str) -> None:
    found = [judged(rng, colour=colour, length=length) for _ in range(20)]
    assert {one.verdict for one in found} == {verdict}
    assert np.mean([one.shared for one in found]) == pytest.approx(colour, abs=0.02)
    assert not any(one.followed for one in found)


def test_residuals_that_follow_the_command_tell_which_and_when(rng: np.random.Generator) -> None:
    found = judged(rng, follows=0.3)
    (first,) = found.followed
    assert found.verdict == "not white"
    assert first.input == "u1"  # and not the one that stands still
    assert first.lag == pytest.approx(7, abs=4)
    assert first.correlation == pytest.approx(0.3 / np.hypot(1.0, 0.3), abs=0.1)


def test_colour_that_has_nothing_to_do_with_the_command_does_not_follow_it(rng: np.random.Generator) -> None:
    found = [judged(rng, colour=0.95) for _ in range(100)]
    assert sum(bool(one.followed) for one in found) <= 5


def test_a_lost_run_and_an_exact_one_are_borne() -> None:
    command = {"u1": np.sin(np.arange(50.0))}
    lost = residual_test("q_m1", [np.full(50, np.nan)], [command], [0.1])
    assert (lost.verdict, lost.rms) == ("diverged", np.inf)
    exact = residual_test("q_m1", [np.zeros(50)], [command], [0.0])
    assert exact.verdict == "white"
