"""Ranges for domain randomisation, and the step as a torch program."""

import io

import pytest
import torch

from hybrid_id.components import Delay, ResidualNetwork
from hybrid_id.errors import InputError
from hybrid_id.export.program import to_program
from hybrid_id.export.ranges import read_result, to_ranges
from hybrid_id.simulation.step import Engine
from hybrid_id.systems import one_link

RESULT = {
    "parameters": ["J", "F_c"],
    "level": 0.95,
    "selected": {"values": {"J": 2e-5, "F_c": 0.01}, "intervals": {"J": [1.9e-5, 2.1e-5], "F_c": None}},
    "sets": [{"values": [2e-5, 0.008]}, {"values": [2.1e-5, 0.013]}],
}


def test_ranges_say_where_they_come_from() -> None:
    system = one_link(100.0)
    system = system.with_specs({"P_m1": system.parameter("P_m1").spec.at(0.02)})
    found = to_ranges(system, RESULT)["parameters"]
    assert (found["J"]["lower"], found["J"]["upper"]) == pytest.approx((1.9e-5, 2.1e-5))
    assert found["J"]["from"] == "interval" and found["J"]["unit"] == "kg m^2"
    assert (found["F_c"]["lower"], found["F_c"]["upper"], found["F_c"]["from"]) == (0.008, 0.013, "spread")
    assert found["P_m1"]["from"] == "held" and found["P_m1"]["lower"] == found["P_m1"]["upper"]


def test_nothing_is_claimed_of_a_parameter_at_a_bound() -> None:
    ends = [
        {"set": "a", "values": [2e-5, 0.008], "at_bound": ["J"]},
        {"set": "b", "values": [2.1e-5, 0.013], "at_bound": []},
    ]
    result = RESULT | {"selected": RESULT["selected"] | {"set": "a"}, "sets": ends}
    assert to_ranges(one_link(100.0), result)["parameters"]["J"]["from"] == "spread"


def test_sets_that_are_no_estimates_widen_no_range() -> None:
    lost = {"values": [9e-5, 0.9], "status": "diverged"}
    found = to_ranges(one_link(100.0), RESULT | {"sets": [*RESULT["sets"], lost]})["parameters"]
    assert (found["F_c"]["lower"], found["F_c"]["upper"]) == (0.008, 0.013)


def test_a_step_that_would_be_unstable_beside_steep_friction_is_refused() -> None:
    drive = one_link(100.0).with_values({"J": 2e-5, "P_m1": 0.02, "F_c": 0.02})
    with pytest.raises(InputError, match="shorter --sample-time or a larger --width"):
        to_program(drive, sample_time=0.02, width=0.01)


def test_range_stays_within_bounds() -> None:
    wide = RESULT | {"selected": {"values": {"J": 2e-5}, "intervals": {"J": [-1.0, 1.0]}}}
    assert to_ranges(one_link(100.0), wide)["parameters"]["J"]["lower"] == 1e-12


def test_foreign_results_are_refused(tmp_path) -> None:
    with pytest.raises(InputError, match="which the model lacks"):
        to_ranges(one_link(100.0), RESULT | {"selected": {"values": {"k": 1.0}, "intervals": {}}})
    with pytest.raises(InputError, match="no identified values"):
        to_ranges(one_link(100.0), {"selected": None})
    (tmp_path / "result.json").write_text("[1]")
    with pytest.raises(InputError, match="no result of hybrid-id"):
        read_result(tmp_path / "result.json")


def test_program_is_the_hybrid_step() -> None:
    network = ResidualNetwork(inputs=("speed", "torque"), hidden=(4,), memory=1)
    with torch.no_grad():
        for weight in network.last_weights().values():
            weight.fill_(0.01)
    system = one_link(100.0).with_component("joint1/motor", network)
    program = to_program(system, sample_time=0.0005)
    assert program.difference < 1e-12
    assert program.interface["states"] == ["q_m1", "v_m1", "h1_motor1"]
    step = torch.export.load(io.BytesIO(program.content)).module()
    x, u = (
        torch.tensor([[0.1, 3.0, 0.2]] * 2, dtype=torch.float64),
        torch.tensor([[1.0], [2.0]], dtype=torch.float64),
    )
    views = system.views(list(system.theta().detach()[:, None]))
    engine = Engine("smooth", substeps=program.interface["substeps"])
    ours = engine.sample(
        system, x.unbind(1), {"u1": u[:, 0]}, torch.full((2,), 0.0005, dtype=torch.float64), views
    )
    torch.testing.assert_close(step(x, u), torch.stack(ours, 1).detach())


def test_program_without_the_past_is_refused() -> None:
    with pytest.raises(InputError, match="joint1 has a delay"):
        to_program(one_link(100.0).with_component("joint1/input", Delay()), sample_time=0.002)


def test_a_range_holds_what_the_records_own_sets_say() -> None:
    result = RESULT | {
        "selected": {"values": {"J": 2e-5, "F_c": 0.01}, "intervals": {"J": [1.99e-5, 2.01e-5], "F_c": None}},
        "reliability": {"J": {"grade": "C"}},
        "profiles": {"F_c": {"lower": 0.007, "upper": 0.011, "closed": [True, True]}},
    }
    found = to_ranges(one_link(100.0), result)["parameters"]
    assert (found["J"]["lower"], found["J"]["upper"]) == pytest.approx((1.99e-5, 2.1e-5))
    assert (found["J"]["reliability"], found["F_c"]["reliability"]) == ("C", None)
    assert (found["F_c"]["lower"], found["F_c"]["upper"], found["F_c"]["from"]) == (0.007, 0.013, "profile")


def test_what_nobody_knows_is_not_called_held() -> None:
    one = RESULT | {"sets": RESULT["sets"][:1]}
    found = to_ranges(one_link(100.0), one)["parameters"]
    assert (found["F_c"]["from"], found["F_c"]["lower"], found["F_c"]["upper"]) == ("unknown", 0.01, 0.01)
