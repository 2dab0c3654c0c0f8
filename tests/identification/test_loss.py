"""Losses and the weights by which they are re-weighted."""

import numpy as np
import pytest
import torch

from hybrid_id.errors import InputError
from hybrid_id.identification.objective import Loss

R = torch.linspace(-9.0, 9.0, 101, dtype=torch.float64)


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
