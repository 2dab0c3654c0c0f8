"""A load that was measured acts as measured, whatever the gear."""

import numpy as np
import pytest
import torch

from hybrid_id import InputError, Record, one_link, one_link_flexible
from hybrid_id.components import LoggedLoad
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.step import Engine

TIME = 0.002 * np.arange(200)


def test_constant_load_accelerates_a_free_rotor_by_its_inertia() -> None:
    load, ratio, inertia = 0.3, 20.0, 2e-5
    system = one_link(ratio).with_component("joint1/load", LoggedLoad(c_w=2.0))
    system = system.with_values({"P_m1": 1e-9, "F_c": 0.0, "F_v": 0.0, "J": inertia})
    assert system.input_names == ["u1", "w1"]
    record = Record("r", TIME, {"u1": 0.0 * TIME, "w1": load + 0.0 * TIME}, {"q_m1": 0.0 * TIME})
    batch = make_batch(system, [record], noise_std={"q_m1": 1e-3})
    exact = -0.5 * 2.0 * load / ratio / inertia * TIME**2
    np.testing.assert_allclose(
        simulate(system, Engine(), batch).y[0, :, 0], exact, atol=1e-6 * abs(exact[-1])
    )


def test_load_bends_the_spring_by_its_compliance() -> None:
    system = one_link_flexible(1.0).with_component("joint1/load", LoggedLoad(c_w=1.0))
    system = system.with_values({"F_cm": 100.0, "k": 50.0, "d": 0.0})
    key = next(k for k in system.components if k.endswith("logged_load"))
    x = [torch.zeros(1, dtype=torch.float64) for _ in system.state_names]
    u = {"u1": torch.zeros(1, dtype=torch.float64), "w1": torch.ones(1, dtype=torch.float64)}
    x[2] = x[2] - 1.0 / 50.0
    rates = system.rates(
        x, u, system.views(list(system.theta().detach()[:, None])), [torch.zeros(1), torch.ones(1)]
    )
    assert key == "joint1/load/logged_load"
    assert float(rates[3]) == pytest.approx(0.0, abs=1e-9)


def test_record_without_the_channel_is_refused() -> None:
    system = one_link(1.0).with_component("joint1/load", LoggedLoad())
    record = Record("r", TIME, {"u1": 0.0 * TIME}, {"q_m1": 0.0 * TIME})
    with pytest.raises(InputError, match="w1"):
        make_batch(system, [record])
