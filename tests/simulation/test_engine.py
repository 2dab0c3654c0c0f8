"""One sample of the engines: order of convergence, reversals, sticking, lanes, agreement with other integrators."""

import numpy as np
import pytest
import torch
from drives import STEP, batch_of, flexible_drive, rigid_drive, run, stored
from machines.scipy_reference import integrate_scipy
from paper.twins import rigid

from hybrid_id.components import AsymmetricStribeck, Coulomb, LoadDependent, LuGre, Stribeck
from hybrid_id.errors import InputError
from hybrid_id.machines.effects.friction import StribeckGaussian
from hybrid_id.machines.physics import friction
from hybrid_id.simulation.step import Engine
from hybrid_id.systems import System, one_link_flexible

FRICTION = "joint1/motor_friction"
LINK = "joint1/link_friction"


def errors(
    system: System,
    u: np.ndarray,
    start: dict,
    substeps: tuple[int, ...],
    friction: str = "dry",
    finer: int = 16,
) -> np.ndarray:
    """Largest difference of the motor's angle to a run with a step ``finer`` times smaller, compiled."""
    finest_engine = Engine(friction, finer * substeps[-1], compiled=True)
    finest = run(system, {"u1": u}, start=start, engine=finest_engine)["q_m1"]
    runs = [run(system, {"u1": u}, start=start, engine=Engine(friction, n))["q_m1"] for n in substeps]
    return np.array([np.abs(q - finest).max() for q in runs])


def slope(error: np.ndarray) -> float:
    """Order of convergence from errors at halved steps."""
    return float(np.mean(np.log2(error[:-1] / error[1:])))


def test_order_between_reversals_is_four() -> None:
    u = 8.0 + 2.0 * np.sin(0.3 * np.arange(20))
    for system in (rigid_drive(AsymmetricStribeck()), flexible_drive()):
        error = errors(
            system, u, {"v_m1": 30.0, **({"v_a1": 0.2} if len(system.state_names) > 2 else {})}, (1, 2, 4)
        )
        assert 3.7 < slope(error) < 4.6, error


def test_order_through_reversals_is_not_lost() -> None:
    u = 6.0 * np.sin(0.45 * np.arange(40))
    for system in (rigid_drive(AsymmetricStribeck()), rigid_drive(vertical=True)):
        error = errors(system, u, {}, (1, 4, 8))
        assert error[0] < 1e-5 * np.ptp(run(system, {"u1": u})["q_m1"])
        assert error[0] / error[-1] > 8**2.5, error


def test_link_that_sticks_behind_its_spring_and_breaks_away() -> None:
    # it breaks away at the start of the next sub-step, so the error falls by steps, but it falls
    system = flexible_drive().with_component(LINK, Coulomb(F_c=0.4))
    u = 5.0 * np.sin(0.3 * np.arange(60))
    x = run(system, {"u1": u})
    assert (x["v_a1"][5:] == 0).sum() > 5 and np.abs(x["v_a1"]).max() > 0.05
    error = errors(system, u, {}, (1, 4, 16), finer=4)
    assert error[0] < 2e-3 * np.ptp(x["q_m1"])
    assert error[0] > 4 * error[1] > 4**2 * error[2], error


def test_both_masses_stop_in_one_step_and_turn() -> None:
    # mirror-symmetric free swing: rotor and link pass zero speed at the same moment
    r, j_m, j_a = 10.0, 1e-4, 1e-2
    values = {
        "J_m": j_m,
        "J_a": j_a,
        "k": 40.0,
        "d": 0.0,
        "F_cm": 1e-5,
        "F_vm": 0.0,
        "F_va": 0.0,
        "P_m1": 1e-9,
    }
    system = one_link_flexible(r).with_values(values).with_component(LINK, Coulomb(F_c=1e-4))
    start = {"q_m1": 0.1 * r, "q_a1": -0.1}
    coarse, fine = (
        run(system, {"u1": np.zeros(120)}, start=start, engine=Engine(substeps=n, compiled=n > 1))
        for n in (1, 32)
    )
    for name in coarse:
        np.testing.assert_allclose(coarse[name], fine[name], atol=2e-4 * np.ptp(fine[name]))


@pytest.mark.parametrize("law", ["coulomb", "stribeck", "asymmetric"])
def test_agrees_with_an_independent_event_exact_integrator(law: str) -> None:
    table = dict(f_11=0.010, f_12=0.030, f_13=10.5, f_14=53.0, f_21=0.012, f_22=0.031, f_23=11.3, f_24=58.0)
    system = (
        rigid_drive(AsymmetricStribeck(**table, f_3=5e-5))
        if law == "asymmetric"
        else rigid_drive(vertical=True)
    )
    dry = [friction.AsymmetricStribeck(**table)]
    if law != "asymmetric":
        drop = 0.006 if law == "stribeck" else 0.0
        system = system.with_component(FRICTION, Stribeck(F_drop=drop, v_s=15.0, p=2.0))
        dry = [friction.Coulomb(0.01), StribeckGaussian(1, {"drop": drop, "v_s": 15.0})]
    G_l = 0.0 if law == "asymmetric" else 2.0
    twin = rigid(*dry, J=2e-5, P_m1=0.019, P_m2=0.0254, f_3=5e-5, G_l=G_l, r=156.0)
    k = np.arange(200)
    u, time = 5.0 * np.sin(0.1 * k) + 2.0 * np.sin(0.037 * k), STEP * k
    exact = integrate_scipy(twin, np.zeros(2), np.stack([u, 0 * u], 1), time, rtol=1e-9, atol=1e-11)
    found = run(system, {"u1": u}, engine=Engine(substeps=4))
    assert (np.diff(np.sign(exact[:, 1])) != 0).sum() >= 4
    np.testing.assert_allclose(found["q_m1"], exact[:, 0], atol=1e-6 * np.ptp(exact[:, 0]))
    np.testing.assert_allclose(found["v_m1"], exact[:, 1], atol=2e-5 * np.ptp(exact[:, 1]))
    assert ((found["v_m1"] == 0) == (exact[:, 1] == 0)).mean() > 0.98


def test_smooth_engine_tends_to_the_dry_one() -> None:
    system, u = rigid_drive(), 6.0 * np.sin(0.05 * np.arange(120))
    dry = run(system, {"u1": u}, engine=Engine(substeps=8, compiled=True))["q_m1"]
    gaps = []
    for width in (2.0, 0.5, 0.125):
        engine = Engine("smooth", round(16 / width**0.5), width, compiled=True)
        smooth = run(system, {"u1": u}, engine=engine)["q_m1"]
        gaps.append(np.abs(smooth - dry).max())
    assert gaps[0] > 2.5 * gaps[1] > 2.5**2 * gaps[2], gaps
    assert gaps[2] < 1e-3 * np.ptp(dry)


def test_order_of_the_smooth_engine_is_four() -> None:
    u = 6.0 * np.sin(0.3 * np.arange(25))
    error = errors(rigid_drive(), u, {}, (8, 16), "smooth")
    assert slope(error) > 3.5, error


def test_stiff_bristle_is_stepped_at_second_order_and_stays_bounded() -> None:
    system = rigid_drive(Coulomb(F_c=0.01)).with_component(FRICTION, LuGre(sigma_0=2.0, sigma_1=1e-3))
    error = errors(system, 6.0 * np.sin(0.3 * np.arange(25)), {}, (4, 8, 16))
    assert slope(error) > 1.5, error
    stiff = rigid_drive(Coulomb(F_c=0.01)).with_component(FRICTION, LuGre(sigma_0=1e5, sigma_1=0.0))
    x = run(
        stiff, {"u1": 12.0 * np.ones(100)}, start={"v_m1": 50.0}
    )  # slides: the bristle is exact, however stiff
    assert np.isfinite(x["v_m1"]).all()
    np.testing.assert_allclose(1e5 * x["z_m1"][5:], 0.01, rtol=1e-6)


@pytest.mark.parametrize(
    "system",
    [
        rigid_drive(vertical=True).with_component(FRICTION, LoadDependent(mu=0.3)),
        flexible_drive().with_component(LINK, Coulomb(F_c=0.4)),
        rigid_drive().with_component(FRICTION, LuGre(sigma_0=2.0)),
    ],
    ids=["rigid", "flexible", "bristle"],
)
@pytest.mark.parametrize("engine", [Engine("dry", 2), Engine("smooth", 20)], ids=["dry", "smooth"])
def test_lanes_do_not_mix(system: System, engine: Engine) -> None:
    generator = np.random.default_rng(1)
    lanes = 6
    x = [
        torch.tensor(generator.normal(0, s, lanes)) for s in (1.0, 20.0, 0.01, 0.1)[: len(system.state_names)]
    ]
    x[1][:3] = torch.tensor([0.0, 1e-3, -1e-3])  # at rest and about to reverse
    u = {"u1": torch.tensor(generator.normal(0, 8, lanes))}
    dt = torch.tensor([STEP, STEP, 0.0, STEP, 2 * STEP, STEP])
    values = stored(system).numpy() * generator.uniform(0.9, 1.1, (len(system.table), lanes))
    rows = list(torch.tensor(values))
    together = engine.sample(system, x, u, dt, system.views(rows))
    for k in range(lanes):
        alone = engine.sample(
            system,
            [row[k : k + 1] for row in x],
            {"u1": u["u1"][k : k + 1]},
            dt[k : k + 1],
            system.views([row[k : k + 1] for row in rows]),
        )
        for a, b in zip(alone, together, strict=True):
            torch.testing.assert_close(a[0], b[k], rtol=1e-13, atol=1e-16)
    still = [row[2] for row in together]  # no time, no motion
    for a, b in zip(still, x, strict=True):
        assert a == b[2]


@pytest.mark.parametrize("system", [rigid_drive(), flexible_drive()], ids=["rigid", "flexible"])
def test_rest_is_rest_and_zero_friction_is_no_friction(system: System) -> None:
    x = run(system, {"u1": np.zeros(30)})
    assert all((row == 0).all() for row in x.values())
    law = "F_c" if "F_c" in {i.name for i in system.table} else "F_cm"
    u = 5.0 * np.sin(0.2 * np.arange(60))
    zero = run(system.with_values({law: 0.0}), {"u1": u})["q_m1"]
    without = run(system.without_component(FRICTION, "coulomb_friction"), {"u1": u})["q_m1"]
    np.testing.assert_allclose(zero, without, atol=1e-6 * np.ptp(without))


def test_huge_step_stays_finite_where_the_motion_decays() -> None:
    slow = rigid_drive().with_values({"J": 2e-3})  # time constant 4 s
    x = run(slow, {"u1": np.r_[10.0 * np.ones(5), np.zeros(40)]}, step=0.5, start={"v_m1": -80.0})
    assert all(np.isfinite(row).all() for row in x.values())
    assert x["v_m1"][-1] == 0.0 and x["v_m1"][1] > -80.0


def test_held_input_acts_from_its_own_sample_on() -> None:
    u = np.zeros(6)
    u[3] = 10.0
    x = run(rigid_drive(), {"u1": u})
    assert x["v_m1"][3] == 0.0 and x["v_m1"][4] > 0.0
    batch = batch_of(rigid_drive(), {"u1": u})
    assert batch.dt[0, -1] == 0.0


@pytest.mark.parametrize("wrong", [{"friction": "sticky"}, {"substeps": 0}, {"width": 0.0}])
def test_unknown_engine_is_refused(wrong: dict) -> None:
    with pytest.raises(InputError, match="engine"):
        Engine(**wrong)
