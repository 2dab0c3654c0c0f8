"""Whether the validation records keep the networks."""

import math

import pytest
import torch

from hybrid_id.identification.hybrid import worth_it


def parts(*values: float, records: int = 1) -> torch.Tensor:
    """Losses ``(n_parts, records)``, record by record."""
    return torch.tensor(values, dtype=torch.float64).reshape(records, -1).T


@pytest.mark.parametrize(
    ("physics", "hybrid", "kept"),
    [
        (parts(0.5, 0.5, 0.5), parts(0.5, 0.495, 0.5), False),  # less than the share that it has to be worth
        (parts(4.0, 4.1, 3.9), parts(0.5, 0.6, 0.4), True),
        (parts(2.0, 1.0, 0.5), parts(0.3, 0.5, 0.5), True),
        (parts(0.9, 0.2, 0.5), parts(0.45, 0.5, 0.55), False),  # by chance
        (parts(math.inf, 1.0, 1.0), parts(0.5, 0.5, 0.5), True),
        (
            parts(1.0, 9.0, 40.0, 30.0),
            parts(0.5, 0.5, 0.6, 90.0),
            True,
        ),  # lost in the last part, as is the physics
        (parts(0.5, 0.5, 0.5), parts(0.6, 0.7, 0.6), False),
        # a record that both lose says nothing, and physics alone has the benefit of the doubt
        (parts(math.inf, 1.0, 1.0, 0.0), parts(math.inf, 0.4, 0.5, 0.0), False),
        (parts(1.0, 1.0, 0.0), parts(0.5, 0.4, 0.0), True),
    ],
)
def test_networks_are_kept_where_they_are_surely_better(
    physics: torch.Tensor, hybrid: torch.Tensor, kept: bool
) -> None:
    assert worth_it(physics, hybrid, 0.02) == kept


def test_where_there_are_several_records_one_alone_keeps_no_network() -> None:
    alone = parts(2.0, 2.2, 2.1, 2.0, 2.0, 2.2, 2.1, 2.0, records=2)
    gains_in_one = parts(0.9, 1.0, 1.0, 0.9, 2.0, 2.3, 2.1, 2.1, records=2)
    assert not worth_it(alone, gains_in_one, 0.02)
    assert worth_it(alone.T.reshape(-1, 1), gains_in_one.T.reshape(-1, 1), 0.02)  # were it a single record
    assert worth_it(alone, alone / 2.0, 0.02)
