"""The box problem of one step against scipy."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from hybrid_id.identification.least_squares import solve_box


def problem(seed: int, n: int, groups: int, stretch: float) -> tuple[np.ndarray, ...]:
    """Factors A (G, n + 3, n) and b (G, n + 3) of min |A s - b|^2 / 2, and limits around 0, some of them closed."""
    g = np.random.default_rng(seed)
    a = g.normal(size=(groups, n + 3, n)) * stretch ** g.uniform(-1, 0, n)
    b = g.normal(size=(groups, n + 3)) * 3
    low, high = -g.exponential(0.5, (groups, n)), g.exponential(0.5, (groups, n))
    low[g.random((groups, n)) < 0.3] = 0.0
    high[g.random((groups, n)) < 0.2] = 0.0
    low[g.random((groups, n)) < 0.2] = -1e6
    return a, b, low, high


def value(a: np.ndarray, b: np.ndarray, s: np.ndarray) -> float:
    return 0.5 * float(np.sum((a @ s - b) ** 2))


@given(
    seed=st.integers(0, 10_000),
    n=st.integers(1, 12),
    groups=st.integers(1, 3),
    stretch=st.sampled_from([1.0, 10.0]),
)
@settings(max_examples=80)
def test_step_is_the_least_in_its_box(seed: int, n: int, groups: int, stretch: float) -> None:
    a, b, low, high = problem(seed, n, groups, stretch)
    hessian = torch.tensor(a.transpose(0, 2, 1) @ a)
    gradient = torch.tensor(-(a.transpose(0, 2, 1) @ b[..., None])[..., 0])
    steps = solve_box(hessian, gradient, torch.tensor(low), torch.tensor(high)).numpy()
    for k in range(groups):
        assert (steps[k] >= low[k]).all() and (steps[k] <= high[k]).all()
        wide = np.maximum(high[k], low[k] + 1e-12)  # scipy wants an interior
        best = lsq_linear(a[k], b[k], (low[k], wide), method="bvls", tol=1e-14)
        start = value(a[k], b[k], np.zeros(n))
        assert value(a[k], b[k], steps[k]) <= value(a[k], b[k], best.x) + 1e-9 * start


def test_free_solution_inside_the_box_is_newton() -> None:
    hessian = torch.tensor([[[2.0, 0.5], [0.5, 1.0]]], dtype=torch.float64)
    gradient = torch.tensor([[1.0, -1.0]], dtype=torch.float64)
    wide = torch.full((1, 2), 1e9, dtype=torch.float64)
    step = solve_box(hessian, gradient, -wide, wide)
    torch.testing.assert_close(step[0], -torch.linalg.solve(hessian[0], gradient[0]))


@pytest.mark.parametrize("pull", [1.0, -1.0])
def test_parameter_on_its_bound_stays_or_leaves_by_its_slope(pull: float) -> None:
    low, high = torch.tensor([[0.0]]).double(), torch.tensor([[5.0]]).double()
    step = solve_box(torch.eye(1)[None].double(), torch.tensor([[pull]]).double(), low, high)
    assert step.item() == (0.0 if pull > 0 else 1.0)
