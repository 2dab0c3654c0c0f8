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


def test_recording_follows_aliases_and_writes_in_place() -> None:
    def function(x: torch.Tensor) -> list[torch.Tensor]:
        y = x.clone()
        alias = y.detach()
        y += 1.0
        return [alias * 0.0 + y.square() * 1.0, torch.zeros_like(x) * x]

    def limited(x: torch.Tensor) -> list[torch.Tensor]:
        return [x.clamp(-1.0, 2.0), x.clamp(max=2.0), torch.where(x > 0, x, torch.nan)]

    statements, _ = record(limited, ["x"], [2.0])
    assert [line.split(" = ")[1] for line in statements] == [
        "x < (-1.0) ? (-1.0) : x > 2.0 ? 2.0 : x;", "x > 2.0 ? 2.0 : x;", "x > 0.0;", "t2 ? x : NAN;",
    ]  # fmt: skip
    statements, results = record(function, ["x"], [2.0])
    assert statements == ["const double t0 = x + 1.0;", "const double t1 = t0 * t0;"]
    assert results == ["t1", "0.0"]
