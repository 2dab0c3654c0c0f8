"""Linearisation and condensing against finite differences and explicit products; windows and padding."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch
from drives import STEP, batch_of, flexible_drive, multisine, rigid_drive, stored
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from hybrid_id.components import AsymmetricStribeck, Coulomb, LoadDependent, LuGre
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.lifted import (
    Linearisation,
    condense_compiled,
    condense_reference,
    linearise,
    shoot,
)
from hybrid_id.simulation.rollout import rollout
from hybrid_id.simulation.step import Engine
from hybrid_id.systems import System

FRICTION, LINK = "joint1/motor_friction", "joint1/link_friction"
SYSTEMS = {
    "rigid": rigid_drive(vertical=True),
    "asymmetric": rigid_drive(AsymmetricStribeck()),
    "load": rigid_drive(vertical=True).with_component(FRICTION, LoadDependent(mu=0.2)),
    "flexible": flexible_drive().with_component(LINK, Coulomb(F_c=0.4)),
    "bristle": rigid_drive().with_component(FRICTION, LuGre(sigma_0=0.5)),
}


def one_node(system: System, x: Tensor, u: Tensor, dt: Tensor) -> Batch:
    """A batch whose rows are single nodes, each with the sample that follows it."""
    batch = batch_of(
        system, {"u1": np.stack([u.numpy(), u.numpy()], 1)}, rows=len(u), outputs=("q_m1", "v_a1", "tau1")
    )
    both = torch.stack([x, x], 1)
    return replace(batch, x=both, dt=torch.stack([dt, torch.zeros_like(dt)], 1))


def finite_differences(
    system: System, engine: Engine, batch: Batch, theta: Tensor, free: list[int]
) -> tuple[Tensor, Tensor]:
    """Central differences of (next state, outputs) by (state, free parameters) at the first node of each row."""

    def value(x: Tensor, at: Tensor) -> Tensor:
        lin = linearise(system, engine, x, batch.u, batch.dt, at, [], batch.outputs)
        return torch.cat([lin.x_next[:, 0], lin.y[:, 0]], 1)

    columns = []
    n_x = batch.x.shape[2]
    for k in range(n_x + len(free)):
        sides = []
        for sign in (1.0, -1.0):
            x, at = batch.x.clone(), theta.clone()
            if k < n_x:
                size = 1e-5 * batch.x[:, 0, k].abs().max().clamp_min(0.1)
                x[:, :, k] += sign * size
            else:
                size = 1e-4 * (theta[free[k - n_x]].abs().max() or 1.0)
                at[free[k - n_x]] += sign * size
            sides.append(value(x, at))
        columns.append((sides[0] - sides[1]) / (2 * size))
    both = torch.stack(columns, -1)
    return both[:, :n_x], both[:, n_x:]


def assert_derivatives(system: System, engine: Engine, batch: Batch, rtol: float) -> Linearisation:
    free = list(range(len(system.table)))
    theta = stored(system, batch.rows)
    lin = linearise(system, engine, batch.x, batch.u, batch.dt, theta, free, batch.outputs)
    states, outputs = finite_differences(system, engine, batch, theta, free)
    for found, expected in (
        (torch.cat([lin.a, lin.b], -1)[:, 0], states),
        (torch.cat([lin.c, lin.d], -1)[:, 0], outputs),
    ):
        scale = expected.abs().amax(0).clamp_min(1e-12)
        torch.testing.assert_close(found / scale, expected / scale, rtol=rtol, atol=rtol)
    return lin


@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("engine", [Engine("dry", 2), Engine("smooth", 20)], ids=["dry", "smooth"])
def test_jacobians_away_from_events(name: str, engine: Engine) -> None:
    system, generator = SYSTEMS[name], np.random.default_rng(5)
    n, rows = len(system.state_names), 12
    x = torch.tensor(generator.normal(0, 1, (rows, n)) * np.array([3.0, 30.0, 0.02, 0.2])[:n])
    x[:, 1] += 20.0 * x[:, 1].sign()  # far enough from rest to stay away from it for a sample
    if "v_a1" in system.state_names:
        x[:, 2] = x[:, 0] / 156.0 + 1e-3 * x[:, 2]
        x[:, 3] += 1.0 * x[:, 3].sign()
    if "z_m1" in system.state_names:
        x[:, 2] *= 0.1
    batch = one_node(system, x, torch.tensor(generator.normal(0, 8, rows)), torch.full((rows,), STEP))
    assert_derivatives(system, engine, batch, 1e-5)


@pytest.mark.parametrize("name", ["rigid", "asymmetric", "load", "flexible"])
def test_jacobians_through_a_reversal(name: str) -> None:
    # speeds of +-2 rad/s under an opposing voltage: they reach zero within the sample and go on or stick
    system = SYSTEMS[name]
    start = torch.tensor([2.0, 1.0, -2.0, -1.0, 1.5, -1.5])
    volts = torch.tensor([-9.0, -5.0, 9.0, 5.0, 0.2, -0.2], dtype=torch.float64)
    x = torch.zeros(6, len(system.state_names), dtype=torch.float64)
    x[:, 1] = start
    if "v_a1" in system.state_names:
        x[:, 3] = 0.4 * start.sign()
    batch = one_node(system, x, volts, torch.full((6,), 0.008))
    lin = assert_derivatives(system, Engine("dry"), batch, 1e-5)
    after = lin.x_next[:, 0, 1]
    assert (after[:4] * x[:4, 1] < 0).all() and (after[4:] == 0).sum() >= (
        2 if "v_a1" not in system.state_names else 0
    )


def test_smooth_jacobians_at_rest() -> None:
    system = SYSTEMS["asymmetric"]
    x = torch.tensor([[0.0, 1e-4], [0.0, -1e-4], [1.0, 0.3]], dtype=torch.float64)
    batch = one_node(system, x, torch.tensor([0.1, 0.1, -2.0], dtype=torch.float64), torch.full((3,), STEP))
    assert_derivatives(system, Engine("smooth", 40), batch, 1e-5)


def test_a_held_joint_forgets_its_speed_and_friction_level() -> None:
    system = rigid_drive()
    x = torch.tensor([[0.3, 0.0]], dtype=torch.float64)
    batch = one_node(system, x, torch.tensor([0.1], dtype=torch.float64), torch.tensor([STEP]))
    free = list(range(len(system.table)))
    lin = linearise(system, Engine(), batch.x, batch.u, batch.dt, stored(system), free, ("q_m1",))
    assert lin.x_next[0, 0].tolist() == [0.3, 0.0]
    assert lin.a[0, 0].tolist() == [[1.0, 0.0], [0.0, 0.0]]
    assert (lin.b == 0).all()
    assert lin.c[0, 0].tolist() == [[1.0, 0.0]] and (lin.d == 0).all()


@given(
    rows=st.integers(1, 3),
    samples=st.integers(1, 23),
    n_x=st.integers(1, 4),
    n_f=st.integers(0, 3),
    seed=st.integers(0, 99),
)
@settings(max_examples=40)
def test_condensing_equals_the_explicit_recursion(
    rows: int, samples: int, n_x: int, n_f: int, seed: int
) -> None:
    g = torch.Generator().manual_seed(seed)

    def random(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=g, dtype=torch.float64)

    a, b, x = (
        0.7 * random(rows, samples, n_x, n_x),
        random(rows, samples, n_x, n_f),
        random(rows, samples, n_x),
    )
    lin = Linearisation(
        random(rows, samples, 0), a[:, :, :0], b[:, :, :0], (), x_next=random(rows, samples, n_x), a=a, b=b
    )
    chain = condense_reference(lin, x)
    across = a.permute(2, 3, 0, 1).contiguous().permute(2, 3, 0, 1)  # as a linearisation lays it out
    compiled = condense_compiled(x, across, b, lin.x_next)
    assert (compiled is None) == (not any(map(shutil.which, ("gcc", "clang", "cc"))))
    torch.testing.assert_close(chain if compiled is None else compiled, chain, rtol=1e-10, atol=1e-10)
    current = torch.zeros(rows, n_x, n_x + n_f + 1, dtype=torch.float64)
    current[:, :, :n_x] = torch.eye(n_x)
    for k in range(samples):
        torch.testing.assert_close(chain[:, k], current, rtol=1e-10, atol=1e-10)
        if k + 1 < samples:
            current = a[:, k] @ current
            current[:, :, n_x:-1] += b[:, k]
            current[:, :, -1] += lin.x_next[:, k] - x[:, k + 1]


@pytest.mark.parametrize("length", [1, 7, 16, 50, 64])
def test_shooting_keeps_the_chunk_starts_and_fills_the_rest(length: int) -> None:
    system = SYSTEMS["rigid"]
    batch = batch_of(system, {"u1": np.stack([multisine(k, samples=50, rest=2) for k in range(2)])}, rows=2)
    theta = stored(system, 2) * torch.tensor([1.0, 1.1])
    path = rollout(system, Engine(), batch, theta)
    guess = path + 0.01
    nodes = shoot(system, Engine(), guess, batch.u, batch.dt, theta, length)
    assert nodes.shape == guess.shape
    assert torch.equal(nodes[:, ::length], guess[:, ::length])
    truth = shoot(system, Engine(), path, batch.u, batch.dt, theta, length)
    torch.testing.assert_close(truth, path, rtol=1e-12, atol=1e-14)
    lin = linearise(system, Engine(), nodes, batch.u, batch.dt, theta, [], ())
    defect = (lin.x_next - torch.roll(nodes, -1, 1))[:, :-1].abs().amax(-1)
    inside = torch.ones(49, dtype=torch.bool)
    inside[length - 1 :: length] = False
    assert defect[:, inside].numel() == 0 or defect[:, inside].max() < 1e-12
