"""Losses and the weights by which they are re-weighted."""

import numpy as np
import pytest
import torch

from hybrid_id.errors import InputError
from hybrid_id.identification.objective import Loss

R = torch.linspace(-9.0, 9.0, 101, dtype=torch.float64)


@pytest.mark.parametrize("loss", [Loss(), Loss("huber", 2.0), Loss("l1", 0.5)], ids=lambda loss: loss.kind)
def test_weight_times_residual_is_the_slope(loss: Loss) -> None:
    r = R.clone().requires_grad_()
    (slope,) = torch.autograd.grad(loss.value(r).sum(), r)
    torch.testing.assert_close(loss.factor(R) * R, slope)
    assert (loss.factor(R) > 0).all() and loss.value(R).argmin() == 50


@pytest.mark.parametrize("loss", [Loss(), Loss("huber", 2.0), Loss("l1", 0.5)], ids=lambda loss: loss.kind)
def test_curvature_is_the_mean_of_the_second_derivative(loss: Loss) -> None:
    r = R.clone().requires_grad_()
    (slope,) = torch.autograd.grad(loss.value(r).sum(), r, create_graph=True)
    (bend,) = torch.autograd.grad(slope.sum(), r)
    assert loss.curvature(R) == pytest.approx(float(bend.mean()), rel=1e-12)
    assert loss.curvature(100.0 + R) > 0.0  # no residual inside: nothing is known, and nothing divided by


def test_limits() -> None:
    np.testing.assert_allclose(Loss().value(R), 0.5 * R**2)
    np.testing.assert_allclose(Loss("huber", 1e9).value(R), 0.5 * R**2)
    np.testing.assert_allclose(Loss("l1", 1e-9).value(R), R.abs(), atol=1e-8)
    far = torch.tensor([100.0], dtype=torch.float64)
    assert Loss("huber", 2.0).value(far).item() == pytest.approx(2.0 * (100.0 - 1.0))


@pytest.mark.parametrize(
    "wrong", [{"kind": "cauchy"}, {"kind": "huber", "delta": 0.0}, {"kind": "l1", "delta": -1.0}]
)
def test_unknown_loss_is_refused(wrong: dict) -> None:
    with pytest.raises(InputError, match=r"loss|delta"):
        Loss(**wrong)
