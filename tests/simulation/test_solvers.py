"""torchdiffeq behind the engine: truth by the matrix exponential, orders, held inputs, and gradients of each kind."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from drives import batch_of, flexible_drive, measure, multisine, rigid_drive, run, stored
from torch import Tensor, nn

from hybrid_id.components import AsymmetricStribeck, Coulomb, Dahl, LuGre
from hybrid_id.components.base import LoadTorque
from hybrid_id.errors import InputError
from hybrid_id.identification import costate
from hybrid_id.identification.costate import gradient
from hybrid_id.simulation import lifted
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.lifted import condense, linearise
from hybrid_id.simulation.rollout import rollout, simulate
from hybrid_id.simulation.solvers import ADAPTIVE, OdeEngine, extra_parameters
from hybrid_id.simulation.step import Engine
from hybrid_id.systems import System

FRICTION = "joint1/motor_friction"
LINEAR = flexible_drive().without_component(FRICTION, "coulomb_friction")
SWING = rigid_drive(vertical=True).without_component(FRICTION, "coulomb_friction")
PAPER = rigid_drive(AsymmetricStribeck(f_13=10.5, f_14=53.0, f_22=0.031))


def exact_linear(u: np.ndarray, dt: np.ndarray) -> np.ndarray:
    """States (T, 4) of the linear drive under held voltages, by the matrix exponential of each step."""
    value = {i.name: i.spec.value for i in LINEAR.table}
    r = LINEAR.gear_ratio[0]
    spring = np.array([value["k"] / r, value["d"] / r, -value["k"], -value["d"]])  # torque at the link
    a = np.zeros((5, 5))
    a[0, 1] = a[2, 3] = 1.0
    a[1, :4], a[3, :4] = -spring / r / value["J_m"], spring / value["J_a"]
    a[1, 1] -= (value["P_m1"] * value["P_m2"] + value["F_vm"]) / value["J_m"]
    a[3, 3] -= value["F_va"] / value["J_a"]
    a[1, 4] = value["P_m1"] / value["J_m"]
    x, path = np.zeros(5), [np.zeros(4)]
    for voltage, step in zip(u[:-1], dt, strict=True):
        x[4] = voltage
        x = torch.linalg.matrix_exp(torch.tensor(a * step)).numpy() @ x
        path.append(x[:4])
    return np.array(path)


def closed_loss(system: System, engine: Engine, batch: Batch, theta: Tensor) -> Tensor:
    """Weighted squared output error of the plain loop through the samples; gradients flow to theta (n_p, R)."""
    p, x = system.views(list(theta)), list(batch.x[:, 0].unbind(1))
    total = torch.zeros(())
    for k in range(batch.x.shape[1]):
        u = {name: channel[:, k] for name, channel in batch.u.items()}
        y = torch.stack(system.outputs(batch.outputs, x, u, p), 1)
        total = total + 0.5 * ((batch.y[:, k] - y) * batch.weight[:, k]).square().sum()
        x = engine.sample(system, x, u, batch.dt[:, k], p)
    return total


def measured_batch(system: System, u: np.ndarray, off: float = 0.05, **settings) -> Batch:
    """A batch whose measurements are those of the same drive with parameters that are off."""
    batch = batch_of(system, {"u1": u}, rows=len(np.atleast_2d(u)), **settings)
    theta = stored(system, batch.rows) * (
        1.0 + off * torch.linspace(-1, 1, len(system.table), dtype=torch.float64)[:, None]
    )
    run_ = simulate(system, OdeEngine(gradient="backprop"), batch, theta)
    return replace(batch, y=run_.y, weight=torch.full_like(run_.y, 50.0), x=run_.x)


def by_loop(system: System, engine: Engine, batch: Batch) -> Tensor:
    """Gradient (n_p, R) of the plain loop."""
    theta = stored(system, batch.rows).requires_grad_()
    return torch.autograd.grad(closed_loss(system, engine, batch, theta), theta)[0]


def by_costates(system: System, engine: OdeEngine, batch: Batch) -> Tensor:
    """Gradient (n_p, R) with all samples side by side."""
    every = list(range(len(system.table)))
    found = gradient(system, engine, batch, batch.x, stored(system, batch.rows), every)
    assert torch.isfinite(found.cost).all()
    return found.theta.T


def relative(found: Tensor, truth: Tensor) -> float:
    """Largest relative error of a row's gradient, its entries in units of their parameters' size."""
    return float(((found - truth).norm(dim=0) / truth.norm(dim=0)).max())


# --- against the truth ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ADAPTIVE)
def test_adaptive_methods_meet_the_matrix_exponential_under_held_inputs(method: str) -> None:
    rng = np.random.default_rng(3)
    u, dt = 8.0 * rng.standard_normal(12), rng.uniform(0.001, 0.004, 11)
    loose = 1e-9 if method.startswith("dopri") else 1e-5
    found = run(LINEAR, {"u1": u}, step=dt, engine=OdeEngine(method=method, rtol=loose, atol=1e-2 * loose))
    truth = exact_linear(u, dt)
    for row, name in enumerate(LINEAR.state_names):
        np.testing.assert_allclose(found[name], truth[:, row], atol=30 * loose * np.ptp(truth[:, row]))


@pytest.mark.parametrize(
    ("method", "order"), [("euler", 1), ("midpoint", 2), ("heun2", 2), ("heun3", 3), ("rk4", 4)]
)
def test_order_of_fixed_methods(method: str, order: int) -> None:
    u, dt = 8.0 * np.sin(0.9 * np.arange(10)), np.full(9, 0.004)
    truth = exact_linear(u, dt)[:, 0]
    error = [
        np.abs(run(LINEAR, {"u1": u}, step=0.004, engine=OdeEngine(method=method, substeps=n, fine=n))["q_m1"] - truth)
        for n in (4, 8, 16)
    ]  # fmt: skip
    largest = np.array([e.max() for e in error])
    slope = np.mean(np.log2(largest[:-1] / largest[1:]))
    assert abs(slope - order) < 0.25, largest


def test_fine_steps_near_rest_do_the_work_of_fine_steps_everywhere() -> None:
    u = {"u1": multisine(1, samples=40, rest=2)}

    def angle(substeps: int, fine: int) -> np.ndarray:
        return measure(PAPER, u, engine=OdeEngine(substeps=substeps, fine=fine, gradient="backprop"))["q_m1"]

    everywhere = angle(48, 48)
    coarse, local = (np.abs(angle(*steps) - everywhere).max() for steps in ((4, 4), (1, 48)))
    assert local < 0.02 * coarse
    assert local < 1e-5 * np.ptp(everywhere)


@pytest.mark.parametrize("law", [Dahl(sigma=0.5), LuGre(sigma_0=0.5, sigma_1=1e-4)], ids=["dahl", "lugre"])
def test_bristles_as_ode_states_agree_with_their_exact_update(law) -> None:
    system = rigid_drive(Coulomb(F_c=0.01)).with_component(FRICTION, law)
    u = 6.0 * np.sin(0.1 * np.arange(60))
    truth = run(system, {"u1": u}, engine=OdeEngine(method="dopri5", rtol=1e-9, atol=1e-11))
    ours = run(system, {"u1": u}, engine=Engine("smooth", 64, compiled=True))
    for name in truth:
        np.testing.assert_allclose(ours[name], truth[name], atol=3e-4 * np.ptp(truth[name]))


def test_lanes_have_their_own_sample_time_and_none_stands_still() -> None:
    engine, p = OdeEngine(substeps=32), SWING.views(list(stored(SWING)))
    one = torch.ones(3, dtype=torch.float64)
    x, u, dt = [0.1 * one, 3.0 * one], {"u1": one}, torch.tensor([0.002, 0.0, 0.004], dtype=torch.float64)
    together = engine.sample(SWING, x, u, dt, p)
    once = engine.sample(SWING, x, u, 0.002 * one, p)
    twice = engine.sample(SWING, once, u, 0.002 * one, p)
    for before, after, half in zip(x, together, twice, strict=True):
        assert after[1] == before[1]
        torch.testing.assert_close(after[2], half[2], rtol=1e-9, atol=1e-12)


def test_stable_raises_steps_where_stiffness_asks() -> None:
    u = multisine(0, samples=100, rest=5)
    batch = batch_of(PAPER, {"u1": u}, start={"v_m1": 20.0})
    assert OdeEngine().stable(PAPER, batch, stored(PAPER)).fine >= 32
    assert OdeEngine(width=5.0).stable(PAPER, batch, stored(PAPER)).substeps == 1
    bristle = rigid_drive(Coulomb(F_c=0.01)).with_component(FRICTION, LuGre(sigma_0=2.0, sigma_1=0.0))
    batch = batch_of(bristle, {"u1": u}, start={"v_m1": 20.0})  # sigma_0 v / F_c = 4000 1/s
    engine = OdeEngine().stable(bristle, batch, stored(bristle))
    assert engine.substeps >= 4
    path = run(bristle, {"u1": 0.0 * u}, start={"v_m1": 20.0}, engine=engine)
    assert np.abs(path["z_m1"]).max() < 1.01 * 0.01 / 2.0  # the bristle ends at F_c / sigma_0, without a fuss
    adaptive = OdeEngine(method="dopri5")
    assert adaptive.stable(bristle, batch, stored(bristle)) == adaptive


# --- gradients -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("engine", [Engine("smooth", 8), Engine("dry", 2)], ids=["smooth", "dry"])
def test_backprop_and_forward_sensitivities_agree_on_one_discretisation(engine: Engine) -> None:
    u = np.stack([multisine(k, samples=60, rest=5) for k in range(2)])
    batch = measured_batch(PAPER, u)
    theta, every = stored(PAPER, 2), list(range(len(PAPER.table)))
    x = rollout(PAPER, engine, replace(batch, x=torch.zeros_like(batch.x)), theta)
    lin = linearise(PAPER, engine, x, batch.u, batch.dt, theta, every, batch.outputs)
    n_x = x.shape[2]
    jacobian = (lin.c @ condense(lin, x))[..., n_x:-1] + lin.d
    residual = (batch.y - lin.y) * batch.weight.square()
    forward = -(jacobian * residual[..., None]).sum((1, 2)).T
    assert relative(forward, by_loop(PAPER, engine, replace(batch, x=torch.zeros_like(batch.x)))) < 1e-9


@pytest.mark.parametrize("kind", ["backprop", "adjoint"])
def test_costates_of_all_samples_are_the_loop_through_the_record(kind: str) -> None:
    u = np.stack([multisine(k, samples=60, rest=5) for k in range(2)])
    batch, engine = measured_batch(PAPER, u), OdeEngine(fine=16, gradient=kind)
    assert relative(by_costates(PAPER, engine, batch), by_loop(PAPER, engine, batch)) < 1e-9


@pytest.mark.parametrize("kind", ["backprop", "adjoint"])
def test_pieces_and_blocks_of_samples_are_all_samples_at_once(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    u = np.stack([multisine(k, samples=60, rest=5) for k in range(2)])
    batch, engine = measured_batch(PAPER, u), OdeEngine(fine=16, gradient=kind)
    whole = by_costates(PAPER, engine, batch)
    monkeypatch.setattr(lifted, "LANES", 17)
    monkeypatch.setattr(costate, "SHORTEST", 12)  # two rows of it are more than the lanes of a block
    assert relative(by_costates(PAPER, engine, batch), whole) < 1e-9


def test_adjoint_is_backprop_on_a_smooth_problem_at_tight_tolerance() -> None:
    batch = measured_batch(SWING, multisine(0, samples=60, rest=2))
    tight = OdeEngine(method="dopri5", rtol=1e-10, atol=1e-12)
    exact = by_costates(SWING, replace(tight, gradient="backprop"), batch)
    assert relative(by_costates(SWING, tight, batch), exact) < 1e-6
    fixed = OdeEngine(substeps=4, fine=4)
    assert relative(by_costates(SWING, fixed, batch), exact) < 1e-6


def test_adjoint_on_the_papers_drive_is_within_half_a_percent_and_shrinks_with_the_step() -> None:
    u = np.stack([multisine(k, samples=150, rest=5) for k in range(3)])
    batch = measured_batch(PAPER, u)
    errors = []
    for steps in (8, 16, 32):
        engine = OdeEngine(fine=steps)
        exact = by_costates(PAPER, replace(engine, gradient="backprop"), batch)
        errors.append(relative(by_costates(PAPER, engine, batch), exact))
    assert errors[2] < 5e-4 and errors[1] < 5e-3
    assert errors[0] > 4 * errors[1] > 16 * errors[2], errors


def test_gradients_reach_weights_beyond_the_table() -> None:
    class Net(LoadTorque):
        kind = "test_solvers_net"

        def __init__(self) -> None:
            super().__init__()
            self.layer = nn.Linear(2, 1, dtype=torch.float64)

        def torque(self, p, angle, speed):
            return self.layer(torch.stack([angle, speed], -1))[..., 0]

    torch.manual_seed(0)
    system = rigid_drive().with_component("joint1/load", Net())
    weights = extra_parameters(system)
    assert [tuple(w.shape) for w in weights] == [(1, 2), (1,)]
    batch = measured_batch(system, multisine(0, samples=40, rest=2), start={"v_m1": 5.0})
    engine = OdeEngine(fine=16, gradient="backprop")
    found = gradient(system, engine, batch, batch.x, stored(system), [0], extra=weights).extra
    loop = torch.autograd.grad(closed_loss(system, engine, batch, stored(system)), weights)
    for a, b in zip(found, loop, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-9, atol=0.0)
    adjoint = gradient(system, OdeEngine(fine=16), batch, batch.x, stored(system), [0], extra=weights).extra
    for a, b in zip(adjoint, loop, strict=True):
        torch.testing.assert_close(a, b, rtol=5e-3, atol=0.0)


# --- settings ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "settings",
    [
        {"friction": "dry"}, {"method": "rk5"}, {"gradient": "forward"}, {"compiled": True},
        {"width": 0.0}, {"fine": 0}, {"tolerances": 0.0},
    ],
    ids=lambda s: next(iter(s)),
)  # fmt: skip
def test_impossible_settings_are_refused_by_name(settings: dict) -> None:
    with pytest.raises(InputError, match=f"(?i){next(iter(settings))}"):
        OdeEngine(**{"rtol" if name == "tolerances" else name: value for name, value in settings.items()})
