"""Which price of the ladder the validation records choose."""

import math

import pytest
import torch

from hybrid_id.identification.hybrid import choose


def parts(*values: float, records: int = 1) -> torch.Tensor:
    """Losses ``(n_parts, records)``, record by record."""
    return torch.tensor(values, dtype=torch.float64).reshape(records, -1).T


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


def test_where_there_are_several_records_one_alone_chooses_no_network() -> None:
    alone = parts(2.0, 2.2, 2.1, 2.0, 2.0, 2.2, 2.1, 2.0, records=2)
    gains_in_one = parts(0.9, 1.0, 1.0, 0.9, 2.0, 2.3, 2.1, 2.1, records=2)
    assert choose([alone, gains_in_one], 0.02) == 0
    assert (
        choose([alone.T.reshape(-1, 1), gains_in_one.T.reshape(-1, 1)], 0.02) == 1
    )  # were it a single record
    assert choose([alone, alone / 2.0], 0.02) == 1


def test_a_record_that_every_rung_loses_says_nothing() -> None:
    lost = [parts(math.inf, 1.0, 1.0, 0.0), parts(math.inf, 0.4, 0.5, 0.0)]
    assert choose(lost, 0.02) == 0  # physics alone has the benefit of the doubt
    one_lost = [parts(1.0, 1.0, 0.0), parts(0.5, 0.4, 0.0)]
    assert choose(one_lost, 0.02) == 1
