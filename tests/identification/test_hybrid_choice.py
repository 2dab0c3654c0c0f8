"""Which price of the ladder the validation records choose."""

import math

import pytest
import torch

from hybrid_id.identification.hybrid import choose


def parts(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


@pytest.mark.parametrize(
    ("losses", "chosen"),
    [
        (
            [parts(0.5, 0.5, 0.5), parts(0.5, 0.495, 0.5)],
            0,
        ),  # less than the share that a rung has to be worth
        ([parts(4.0, 4.1, 3.9), parts(0.5, 0.6, 0.4), parts(0.49, 0.59, 0.4)], 1),
        ([parts(2.0, 1.0, 0.5), parts(0.3, 0.5, 0.5)], 1),
        ([parts(0.9, 0.2, 0.5), parts(0.45, 0.5, 0.55)], 0),  # by chance
        ([parts(math.inf, 1.0, 1.0), parts(0.5, 0.5, 0.5)], 1),
        (
            [parts(1.0, 9.0, 40.0, 30.0), parts(0.5, 0.5, 0.6, 90.0)],
            1,
        ),  # lost in the last part, as is the physics
    ],
)
def test_the_dearest_that_is_not_worse(losses: list[torch.Tensor], chosen: int) -> None:
    assert choose(losses, 0.02) == chosen
