"""What PyTorch computes in every lane is written down as C statements, or it is told why it cannot be."""

import pytest
import torch

from hybrid_id.errors import InputError
from hybrid_id.simulation.parts import in_lanes, stored
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
        "pick(x < (-1.0), (-1.0), pick(x > 2.0, 2.0, x));", "pick(x > 2.0, 2.0, x);", "x > 0.0;", "pick(t2, x, NAN);",
    ]  # fmt: skip
    statements, results = record(function, ["x"], [2.0])
    assert statements == ["const double t0 = x + 1.0;", "const double t1 = t0 * t0;"]
    assert results == ["t1", "0.0"]


def test_truths_are_no_numbers_of_several_lanes() -> None:
    """Vectors hold a truth as all bits, so that it becomes a number, and a number a truth, where it is used as one."""

    def function(x: torch.Tensor) -> list[torch.Tensor]:
        inside, always = (x > 0.0) & (x < 1.0), torch.ones_like(x, dtype=torch.bool)
        return [
            inside * x,
            (~inside).to(x),
            torch.where(inside & always, x, 0.0),
            torch.where(always, x, 1.0),
            x.bool() > 0,
        ]

    statements, results = record(function, ["x"], [2.0])
    assert [line.removeprefix("const ") for line in statements] == [
        "_Bool t0 = x > 0.0;", "_Bool t1 = x < 1.0;", "_Bool t2 = t0 & t1;",
        "double t3 = pick(t2, 1.0, 0.0) * x;", "_Bool t4 = t2 == 0;", "double t5 = pick(t4, 1.0, 0.0);",
        "double t6 = pick(t2, x, 0.0);", "_Bool t7 = (x != 0.0);", "_Bool t8 = pick(t7, 1.0, 0.0) > 0.0;",
    ]  # fmt: skip
    assert results == ["t3", "t5", "t6", "x", "t8"]


def test_statements_of_one_lane_become_those_of_a_vector() -> None:
    body = [
        "    const double x0 = x[0];", "    const _Bool t1 = fixed[2];", "    k[0] = t3;",
        "    const double t3 = pick(t1, sin(x0), 0.0);",
    ]  # fmt: skip
    assert in_lanes("\n".join(body)).splitlines() == [
        "    const V x0 = AT(x[0]);", "    const M t1 = AT(fixed[2]) != 0.0;", "    AT(k[0]) = ALL(t3);",
        "    const V t3 = v_pick(t1, v_sin(x0), 0.0);",
    ]  # fmt: skip
    assert stored("const _Bool", "t1", "fixed[2]") == "fixed[2] = pick(t1, 1.0, 0.0);"
    assert stored("const double", "t3", "fixed[3]") == "fixed[3] = t3;"
