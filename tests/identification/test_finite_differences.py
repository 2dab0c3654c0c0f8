"""A gear with play, fitted by finite steps."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch
from drives import batch_of, multisine, rigid_drive

from hybrid_id.components import Backlash, Delay, Gravity
from hybrid_id.errors import InputError
from hybrid_id.identification.finite_differences import (
    Rollouts,
    finite_difference_fit,
    slopes_at,
)
from hybrid_id.identification.fit import fit
from hybrid_id.identification.restarts import perturbed_restarts
from hybrid_id.parameters import Bounded
from hybrid_id.simulation.rollout import rollout
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.chain import System

QUICK = Engine("smooth", width=0.5, compiled=True)
DRY = Engine(compiled=True)
NOISE = 0.2
"""Of the encoder [rad], beside motion of some 40 rad."""
pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="needs a C compiler")


def loose_drive(gap: float) -> System:
    play = Backlash(gap=Bounded(gap, 0.0, 0.5, "rad"))
    return rigid_drive().with_component("joint1/transmission", play)


def measured(system: System, engine: Engine):
    inputs = {"u1": np.stack([multisine(k, samples=600, rest=20) for k in range(2)])}
    batch = batch_of(system, inputs, rows=2, outputs=("q_m1",))
    theta = system.theta().detach()[:, None].expand(-1, 2)
    row = system.joints[0].positions[0]
    run = rollout(system, engine, batch, theta)[..., row : row + 1]
    noise = NOISE * torch.randn(run.shape, generator=torch.Generator().manual_seed(0), dtype=run.dtype)
    return replace(batch, y=run + noise, weight=torch.full_like(run, 1.0 / NOISE))


def test_play_is_recovered_from_the_motors_side() -> None:
    truth = loose_drive(0.03)
    batch = measured(truth, Rollouts(truth, measured(truth, QUICK), QUICK, [0]).engine)
    start = loose_drive(0.027)
    found = finite_difference_fit(start, batch, engine=QUICK, iterations=30)
    gap = found.system.parameter("gap").spec.value
    assert gap == pytest.approx(0.03, rel=0.05)
    assert found.noise_scale < 1.5
    assert found.jacobian[0].shape == (*found.residual[0].shape, len(found.names))


def test_a_look_with_borrowed_slopes_finds_what_its_neighbour_lacks() -> None:
    truth = rigid_drive().with_component("joint1/load", Gravity(G_l=0.1, q_0=Bounded(0.8, -6.0, 6.0, "rad")))
    batch, plain = measured(truth, DRY), rigid_drive()
    today = finite_difference_fit(plain, batch, engine=DRY, iterations=10)
    start = today.system.with_component("joint1/load", Gravity(G_l=0.02, q_0=Bounded(1.6, -6.0, 6.0, "rad")))
    near = slopes_at(today.system, batch, DRY)
    look = finite_difference_fit(start, batch, engine=DRY, iterations=5, near=near)
    full = finite_difference_fit(start, batch, engine=DRY, iterations=20)
    assert full.noise_scale < 1.1
    assert look.cost < 0.5 * today.cost
    assert set(near.parameters) == {(i.component, i.symbol) for i in plain.table if i.spec.estimate}
    # further steps of the look simulate no slope anew, and come to where the fit comes to
    assert finite_difference_fit(start, batch, engine=DRY, iterations=40, near=near).cost < 1.05 * full.cost


def test_a_look_begins_at_the_first_states_of_its_neighbour() -> None:
    plain = rigid_drive()
    batch = measured(plain, DRY)
    batch = replace(batch, x0_std=torch.full_like(batch.x0_std, 0.1))
    shifted = batch.x[:, 0].numpy() + 0.05
    near = slopes_at(plain, batch, DRY, shifted)
    look, own = (finite_difference_fit(plain, batch, engine=DRY, iterations=0, near=n) for n in (near, None))
    np.testing.assert_allclose(look.x0, shifted)
    np.testing.assert_allclose(own.x0, batch.x[:, 0].numpy())
    # one row of them, too
    some = near.of_rows(np.array([1]))
    np.testing.assert_allclose([some.x0[name][0] for name in plain.state_names], shifted[1])


@pytest.mark.parametrize(("low", "high"), [(0.01, 0.01), (0.01, 0.010001), (0.0, 0.0)])
def test_bounds_narrower_than_a_step_hold(low: float, high: float) -> None:
    batch = measured(rigid_drive(), DRY)
    start = rigid_drive().with_specs(
        {"F_c": Bounded(low, low, high, "N m"), "J": Bounded(2.3e-5, 0.0, 1e-3, "kg m^2")}
    )
    found = finite_difference_fit(start, batch, engine=DRY, iterations=5)
    assert low <= found.system.parameter("F_c").spec.value <= high
    assert np.isfinite(found.jacobian[0]).all()
    assert found.cost < found.history[0]


def test_a_delays_channels_arrive_before_the_rollout() -> None:
    system = rigid_drive().with_component("joint1/input", Delay(T_d=0.003))
    batch = measured(loose_drive(0.0), QUICK)
    past = {f"u1@{k}": torch.roll(batch.u["u1"], k, 1) for k in range(1, 6)}
    for channel in past.values():
        channel[:, :6] = 0.0
    batch = replace(
        batch, x=batch.x[..., :2], x0_std=batch.x0_std[:, :2],
        u={**batch.u, **past, "step1": batch.dt.amax(1, keepdim=True).expand_as(batch.dt).contiguous()},
    )  # fmt: skip
    point = system.theta().detach().numpy()[:1][None]
    fast = Rollouts(system, batch, QUICK, [0]).residuals(point)
    plain = Rollouts(system, batch, Engine("smooth", width=0.5), [0]).residuals(point)
    np.testing.assert_allclose(fast, plain, rtol=1e-8, atol=1e-6)


def test_nothing_to_estimate_is_told() -> None:
    system = loose_drive(0.01)
    batch = measured(system, QUICK)
    held = system.with_specs({info.name: replace(info.spec, estimate=False) for info in system.table})
    with pytest.raises(InputError, match="no parameter to estimate"):
        finite_difference_fit(held, batch, engine=QUICK)


def test_priors_hold_what_the_records_do_not_tell() -> None:
    system = rigid_drive()
    name = next(info.name for info in system.table if info.spec.estimate)
    spec = replace(system.parameter(name).spec, prior_mean=system.parameter(name).spec.value, prior_std=1e-6)
    held = system.with_specs({name: spec})
    inputs = {"u1": multisine(0, samples=200, rest=20)[None]}
    batch = batch_of(system, inputs, rows=1, outputs=("q_m1",))
    batch = replace(batch, weight=torch.full_like(batch.y, 1.0 / NOISE))
    found = finite_difference_fit(held, batch, engine=DRY, iterations=5)
    assert found.system.parameter(name).spec.value == pytest.approx(spec.value, rel=0.01)


def test_perturbed_restarts_never_ends_higher_and_says_the_same_again() -> None:
    truth = loose_drive(0.03)
    batch = measured(truth, Rollouts(truth, measured(truth, QUICK), QUICK, [0]).engine)
    early = finite_difference_fit(loose_drive(0.02), batch, engine=QUICK, iterations=2)
    found = perturbed_restarts(early, batch, seed=1)
    assert found.cost <= early.cost
    assert np.array_equal(found.values, perturbed_restarts(early, batch, seed=1).values)


def test_first_states_are_found_within_what_is_known_of_them() -> None:
    truth = rigid_drive()
    inputs = {"u1": multisine(0, samples=300, rest=20)[None]}
    batch = batch_of(truth, inputs, rows=1, outputs=("q_m1",))
    run = rollout(truth, DRY, batch, truth.theta().detach()[:, None])[..., :1]
    batch = replace(
        batch,
        y=run + 0.5,
        weight=torch.full_like(run, 1.0 / NOISE),
        x0_std=torch.tensor([[1.0, 0.0]]).to(run),
    )
    found = finite_difference_fit(truth, batch, engine=DRY)
    assert found.x0[0, 0] == pytest.approx(float(batch.x[0, 0, 0]) + 0.5, abs=0.02)
    assert found.x0[0, 1] == 0.0


def test_a_fit_leaves_its_records_as_they_were_and_goes_on_from_where_it_has_ended() -> None:
    truth = rigid_drive()
    batch = batch_of(truth, {"u1": multisine(0, samples=300, rest=20)[None]}, rows=1, outputs=("q_m1",))
    run = rollout(truth, DRY, batch, truth.theta().detach()[:, None])[..., :1]
    weight, std = torch.full_like(run, 1.0 / NOISE), torch.tensor([[0.1, 0.0]]).to(run)
    batch = replace(batch, y=run + 0.5, weight=weight, x0_std=std)
    before = batch.x.clone()
    found = finite_difference_fit(truth, batch, engine=DRY, iterations=2)
    assert found.x0[0, 0] != before[0, 0, 0]
    again = finite_difference_fit(found.system, batch, engine=DRY, iterations=2, x0=found.x0)
    assert again.history[0] == pytest.approx(found.cost, rel=1e-9)
    assert torch.equal(batch.x, before)


def test_sensitivities_are_those_of_a_fit_whose_first_states_follow() -> None:
    truth = rigid_drive()
    batch = measured(truth, DRY)
    loose = replace(batch, x0_std=torch.tensor([[0.5, 5.0]], dtype=torch.float64).expand(2, -1))
    exact = fit(truth, loose, pooled=True, engine=DRY, warm=False)[0]
    again = finite_difference_fit(exact.system, loose, engine=DRY, iterations=0, x0=exact.x0)
    held = finite_difference_fit(exact.system, batch, engine=DRY, iterations=0)
    for k, name in enumerate(exact.names):
        size = np.sqrt(sum(np.square(j[..., k]).sum() for j in exact.jacobian))
        own = np.sqrt(sum(np.square(j[..., k]).sum() for j in again.jacobian))
        assert own == pytest.approx(size, rel=0.05), name
        assert own < np.sqrt(sum(np.square(j[..., k]).sum() for j in held.jacobian))
