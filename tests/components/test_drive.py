"""What acts between command and rotor, against its own equations, alone and in a simulated drive."""

import numpy as np
import pytest
import torch
from drives import STEP, rigid_drive
from scipy.integrate import solve_ivp

from hybrid_id.components import (
    CurrentCommand,
    Deadband,
    ElectricalLag,
    Saturation,
    SoftSaturation,
    SupplySag,
    ThermalDerating,
)
from hybrid_id.errors import InputError
from hybrid_id.records.record import Record
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.stability import with_substeps
from hybrid_id.simulation.step import Engine

J, P_M1, P_M2, F_V = 2e-5, 0.019, 0.0254, 5e-5
DRIVE = rigid_drive().with_values({"J": J, "P_m1": P_M1, "P_m2": P_M2, "F_c": 0.0, "F_v": F_V})


def tensor(values: object) -> torch.Tensor:
    return torch.as_tensor(values, dtype=torch.float64)


def simulated(system, voltage: np.ndarray, channel: str = "v_m1") -> np.ndarray:
    time = STEP * np.arange(len(voltage))
    record = Record(
        "run", time, {"u1": voltage}, {channel: np.zeros_like(voltage), "q_m1": np.zeros_like(voltage)}
    )
    batch = make_batch(system, [record], outputs=[channel], noise_std={channel: 1.0})
    engine = with_substeps(system, Engine(), batch, system.theta()[:, None])
    with torch.no_grad():
        return simulate(system, engine, batch).y[0, :, 0].numpy()


def test_deadband_in_both_forms() -> None:
    u = tensor([-3.0, -0.5, 0.0, 0.5, 3.0])
    less, whole = Deadband(V_0=1.0, jump=0.0), Deadband(V_0=1.0, jump=1.0, width=1e-3)
    assert less.map(less.view(), u, 0 * u).tolist() == [-2.0, 0.0, 0.0, 0.0, 2.0]
    torch.testing.assert_close(whole.map(whole.view(), u, 0 * u), tensor([-3.0, 0.0, 0.0, 0.0, 3.0]))


def test_electrical_lag_against_the_winding_equation() -> None:
    # L di/dt + R i = u - k v, J dv/dt = k i - F_v v: two linear equations
    lag, volts = 4e-3, 6.0
    system = DRIVE.with_component("joint1/motor", ElectricalLag(T_e=lag))
    found = simulated(system, np.full(400, volts))

    def rates(_: float, x: np.ndarray) -> list[float]:
        return [(x[1] - F_V * x[0]) / J, (P_M1 * (volts - P_M2 * x[0]) - x[1]) / lag]

    time = STEP * np.arange(400)
    exact = solve_ivp(rates, (0.0, time[-1]), [0.0, 0.0], t_eval=time, rtol=1e-10, atol=1e-10).y[0]
    assert np.abs(found - exact).max() < 2e-3 * np.abs(exact).max()


def test_warm_winding_against_its_equation() -> None:
    settle, heat, volts = 5.0, 4000.0, 8.0
    system = DRIVE.with_component("joint1/motor", ThermalDerating(T_w=settle, c=heat))
    found = simulated(system, np.full(2000, volts))

    def rates(_: float, x: np.ndarray) -> list[float]:
        torque = P_M1 * (volts - P_M2 * x[0]) / (1.0 + x[1])
        return [(torque - F_V * x[0]) / J, (heat * torque**2 * (1.0 + x[1]) - x[1]) / settle]

    time = STEP * np.arange(2000)
    exact = solve_ivp(rates, (0.0, time[-1]), [0.0, 0.0], t_eval=time, rtol=1e-10, atol=1e-10).y[0]
    assert np.abs(found - exact).max() < 1e-3 * np.abs(exact).max()
    assert found[-1] < 0.99 * simulated(DRIVE, np.full(2000, volts))[-1]


def test_motor_must_take_what_its_input_gives() -> None:
    system = DRIVE.with_component("joint1/input", CurrentCommand())
    record = Record("run", STEP * np.arange(20), {"i1": np.zeros(20)}, {"q_m1": np.zeros(20)})
    with pytest.raises(
        InputError,
        match=r"dc_motor at joint1/motor takes V; put duty_supply or .*, or current_motor at the motor",
    ):
        make_batch(system, [record])


def test_a_command_meets_the_dead_band_first_and_the_supply_last() -> None:
    parts = (SupplySag(), Saturation(), Deadband(), SoftSaturation())
    system = rigid_drive()
    for part in parts:
        system = system.with_component("joint1/input", part)
    kinds = [type(part) for _, part in system.joints[0].drive.maps]
    assert kinds == [Deadband, SoftSaturation, Saturation, SupplySag]
