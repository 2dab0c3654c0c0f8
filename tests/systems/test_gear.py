"""A gear whose ratio is not constant carries the link as its map says; friction may follow the joint's angle."""

import numpy as np
import pytest
import torch
from drives import STEP
from scipy.integrate import solve_ivp

from hybrid_id.components import (
    AsymmetricFriction,
    EfficiencyLoss,
    KinematicError,
    LoadDependent,
)
from hybrid_id.records.record import Record
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.step import Engine
from hybrid_id.systems import System, one_link

RATIO, J, SHARE = 20.0, 3e-5, 0.4
FREE = one_link(RATIO).with_values(
    {"J": J, "rotor_share": SHARE, "P_m1": 0.02, "P_m2": 0.0, "F_c": 0.0, "F_v": 0.0}
)


def run(
    system: System, voltage: np.ndarray, outputs: tuple[str, ...] = ("q_m1",), substeps: int = 4
) -> np.ndarray:
    zeros = np.zeros_like(voltage)
    record = Record(
        "run", STEP * np.arange(len(voltage)), {"u1": voltage}, dict.fromkeys((*outputs, "q_m1"), zeros)
    )
    batch = make_batch(system, [record], outputs=outputs, noise_std=dict.fromkeys(outputs, 1.0))
    with torch.no_grad():
        return simulate(system, Engine(substeps=substeps), batch).y[0].numpy()


def test_rigid_gear_with_kinematic_error_against_its_lagrangian() -> None:
    # (J_m + g'^2 J_a) q'' + J_a g' g'' q'^2 = tau with g = q/r + E_c (cos q - 1) + E_s sin q + E_s2 sin 2q
    e_c, e_s, e_2, volts = 4e-3, -3e-3, 1e-3, 1.5
    error = KinematicError(E_c=e_c, E_s=e_s, n=1.0, E_s2=e_2, n_2=2.0)
    found = run(FREE.with_component("joint1/transmission", error), np.full(250, volts), ("q_m1", "q_a1"))
    rotor, link = SHARE * J, (1.0 - SHARE) * J * RATIO**2

    def rates(_: float, x: np.ndarray) -> list[float]:
        slope = 1.0 / RATIO - e_c * np.sin(x[0]) + e_s * np.cos(x[0]) + 2 * e_2 * np.cos(2 * x[0])
        bend = -e_c * np.cos(x[0]) - e_s * np.sin(x[0]) - 4 * e_2 * np.sin(2 * x[0])
        return [x[1], (0.02 * volts - link * slope * bend * x[1] ** 2) / (rotor + slope**2 * link)]

    time = STEP * np.arange(250)
    q = solve_ivp(rates, (0.0, time[-1]), [0.0, 0.0], t_eval=time, rtol=1e-11, atol=1e-11).y[0]
    np.testing.assert_allclose(found[:, 0], q, atol=1e-3)
    link_angle = q / RATIO + e_c * (np.cos(q) - 1) + e_s * np.sin(q) + e_2 * np.sin(2 * q)
    np.testing.assert_allclose(found[:, 1], link_angle, atol=1e-4)


def test_a_gear_of_constant_efficiency_passes_on_its_share_of_the_torque() -> None:
    # J a = (1 - mu) tau while the motor drives, (1 + mu) tau while it brakes; at rest mu < 1 holds nothing
    mu, volts = 0.3, 1.5
    lossy = FREE.with_component("joint1/motor_friction", EfficiencyLoss(mu=mu))
    pull = 0.02 * volts / J
    time = STEP * np.arange(60)
    driven = run(lossy, np.full(60, volts))[:, 0]
    np.testing.assert_allclose(driven, 0.5 * (1 - mu) * pull * time**2, rtol=1e-6, atol=1e-9)
    both = run(lossy, np.where(time < time[20], volts, -volts))[:, 0]
    speed, braked = (1 - mu) * pull * time[20], time[20:26] - time[20]
    expected = driven[20] + speed * braked - 0.5 * (1 + mu) * pull * braked**2
    np.testing.assert_allclose(both[20:26], expected, rtol=1e-6)


def test_asymmetric_friction_takes_either_sign() -> None:
    speed = torch.tensor([2.0, -2.0], dtype=torch.float64)
    forward = (speed > 0).to(speed.dtype)
    for excess, expected in ((3e-3, [3e-3, 0.0]), (-3e-3, [0.0, 3e-3])):
        law = AsymmetricFriction(F_a=excess, D_a=0.0)
        assert law.dry(law.view(), speed.abs(), forward).tolist() == expected


def test_friction_by_load_counts_what_the_gear_error_makes_the_link_pull() -> None:
    # the link is accelerated by slope q'' + bend q'^2: at constant speed the second term alone
    error = KinematicError(E_c=4e-3, E_s=0.0, n=1.0)
    system = FREE.with_component("joint1/transmission", error)
    system = system.with_component("joint1/motor_friction", LoadDependent(mu=0.1))
    p = system.views([value[None] for value in system.theta().detach()])
    angle, speed = torch.tensor([0.3], dtype=torch.float64), torch.tensor([200.0], dtype=torch.float64)
    volts = {"u1": torch.zeros(1, dtype=torch.float64)}
    (balance,) = system.joints[0].balances([angle, speed], volts, p, [speed], [torch.ones(1)])
    acceleration = balance.acceleration(torch.ones(1, dtype=torch.float64))
    slope, bend = 1.0 / RATIO - 4e-3 * np.sin(0.3), -4e-3 * np.cos(0.3)
    link = (1.0 - SHARE) * J * RATIO**2
    pulled = link * slope * (slope * float(acceleration) + bend * 200.0**2)
    assert float(balance.transmitted(acceleration, torch.zeros(1))) == pytest.approx(pulled)
