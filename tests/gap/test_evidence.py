"""Errors of prediction without fitting again, against fitting again."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hybrid_id.gap.evidence import BLOCK, effective_samples, evidence

STEP = 0.01


def linear(
    rng: np.random.Generator, *, lengths: tuple[int, ...] = (120, 90, 100), off: float = 0.0
) -> tuple[Any, list[np.ndarray], list[np.ndarray]]:
    """A least-squares fit of a linear model to records, or values that are ``off`` from it; its matrices and data."""
    truth = np.array([1.0, -2.0, 0.5])
    matrices = [rng.standard_normal((n, 3)) for n in lengths]
    data = [a @ truth + 0.3 * rng.standard_normal(len(a)) for a in matrices]
    best = np.linalg.lstsq(np.concatenate(matrices), np.concatenate(data), rcond=None)[0] + off
    fitted = SimpleNamespace(
        names=("a", "b", "c"),
        at_bound=(),
        jacobian=[a[:, None, :] for a in matrices],
        residual=[(y - a @ best)[:, None] for a, y in zip(matrices, data, strict=True)],
        n_samples=sum(lengths),
    )
    return fitted, matrices, data


@pytest.mark.parametrize("off", [0.0, 0.7])  # a fit that has not come to its end predicts alike
def test_equals_leaving_records_out_of_a_linear_model(rng: np.random.Generator, off: float) -> None:
    fitted, matrices, data = linear(rng, off=off)
    total = 0.0
    for i, (a, y) in enumerate(zip(matrices, data, strict=True)):
        rest = [k for k in range(len(data)) if k != i]
        others, values = np.concatenate([matrices[k] for k in rest]), np.concatenate([data[k] for k in rest])
        total += np.square(y - a @ np.linalg.lstsq(others, values, rcond=None)[0]).sum()
    found = evidence(fitted, STEP)
    assert found.error == pytest.approx(total / fitted.n_samples, rel=1e-9)
    assert len(found.blocks) == sum(-(-len(a) // round(BLOCK / STEP)) for a in matrices)


def test_prediction_is_worse_than_the_fit(rng: np.random.Generator) -> None:
    fitted, _, _ = linear(rng, lengths=(12, 12, 12))
    inside = sum(np.square(r).sum() for r in fitted.residual) / fitted.n_samples
    assert evidence(fitted, STEP).error > inside


def test_parameter_at_a_bound_is_not_moved(rng: np.random.Generator) -> None:
    fitted, matrices, _ = linear(rng)
    held = SimpleNamespace(**{**vars(fitted), "at_bound": ("c",)})
    free = SimpleNamespace(
        **{**vars(fitted), "names": ("a", "b"), "jacobian": [a[:, None, :2] for a in matrices]}
    )
    assert evidence(held, STEP).error == pytest.approx(evidence(free, STEP).error)


def test_same_model_is_not_better_than_itself(rng: np.random.Generator) -> None:
    found = evidence(linear(rng)[0], STEP)
    assert found.gain(found) == 0.0
    assert found.z(found) == 0.0


def test_lost_column_shows(rng: np.random.Generator) -> None:
    fitted, matrices, data = linear(rng)
    poor = [a[:, :2] for a in matrices]
    best = np.linalg.lstsq(np.concatenate(poor), np.concatenate(data), rcond=None)[0]
    poorer = SimpleNamespace(
        names=("a", "b"),
        at_bound=(),
        jacobian=[a[:, None, :] for a in poor],
        residual=[(y - a @ best)[:, None] for a, y in zip(poor, data, strict=True)],
        n_samples=fitted.n_samples,
    )
    rich, simple = evidence(fitted, STEP), evidence(poorer, STEP)
    assert rich.z(simple) > 2.0
    assert rich.gain(simple) > 0.0 > simple.gain(rich)


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
