"""What errors of prediction say."""

import numpy as np
import pytest

from hybrid_id.diagnosis.validation import BLOCK, coloured, effective_samples, evidence

STEP = 0.01


def noise(rng: np.random.Generator, size: float = 1.0) -> list[np.ndarray]:
    return [size * rng.standard_normal((n, 1)) for n in (120, 90, 100)]


def test_error_is_the_mean_square_and_blocks_are_parts_of_it(rng: np.random.Generator) -> None:
    errors = noise(rng)
    found = evidence(errors, STEP)
    assert found.error == pytest.approx(np.mean(np.concatenate(errors) ** 2))
    assert len(found.blocks) == sum(-(-len(e) // round(BLOCK / STEP)) for e in errors)


def test_same_model_is_not_better_than_itself(rng: np.random.Generator) -> None:
    found = evidence(noise(rng), STEP)
    assert found.z(found) == 0.0


def test_smaller_errors_are_better(rng: np.random.Generator) -> None:
    poor, good = evidence(noise(rng, 3.0), STEP), evidence(noise(rng), STEP)
    assert good.z(poor) > 2.0
    assert good.error < poor.error


@pytest.mark.parametrize("memory", [0.0, 0.5, 0.9])
def test_independent_samples_of_an_autoregression(rng: np.random.Generator, memory: float) -> None:
    """N (1 - a) / (1 + a) for x_t = a x_{t-1} + e_t."""
    records = []
    for _ in range(4):
        noise = rng.standard_normal(20_000)
        x = np.zeros_like(noise)
        for t in range(1, len(x)):
            x[t] = memory * x[t - 1] + noise[t]
        records.append(x[:, None])
    expected = 80_000 * (1 - memory) / (1 + memory)
    assert effective_samples(records) == pytest.approx(expected, rel=0.15)


def test_white_noise_has_no_colour_and_what_is_smooth_is_all_colour(rng: np.random.Generator) -> None:
    long = [rng.standard_normal((20_000, 1)) for _ in range(3)]
    smooth = [np.sin(np.linspace(0.0, 20.0, 20_000))[:, None]]
    assert coloured(long) < 0.02
    assert coloured(smooth) > 0.99
    assert coloured([a + 1.0 * np.sqrt(2.0) * smooth[0] for a in long]) == pytest.approx(0.5, abs=0.03)
    assert coloured([np.zeros((10, 1))]) == 0.0


def test_a_run_that_diverged_is_no_noise() -> None:
    assert coloured([np.array([[0.1], [np.nan], [0.2]])]) == 1.0
