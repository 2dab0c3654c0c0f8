"""What PyTorch computes in every lane is written down as C statements, or it is told why it cannot be."""

import pytest
import torch

from hybrid_id.errors import InputError
from hybrid_id.simulation.tracing import record


def test_what_has_no_c_expression_is_named() -> None:
    with pytest.raises(InputError, match="'cumsum'"):
        record(lambda x: [x.cumsum(0)], ["x"], [1.0])
    with pytest.raises(InputError, match="adds up lanes"):
        record(lambda x: [x / x.sum()], ["x"], [1.0])
    own = torch.tensor([1.0, 2.0, 3.0])
    with pytest.raises(InputError, match="array of its own"):
        record(lambda x: [x * own], ["x"], [1.0])
