"""The lifted Newton simulation ends where the loop ends, whatever the batch looks like."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from drives import batch_of, flexible_drive, multisine, rigid_drive, stored
from hypothesis import given, settings
from hypothesis import strategies as st

from hybrid_id.components import AsymmetricStribeck, Coulomb, Dahl, LoadDependent, PositionLoop
from hybrid_id.simulation.rollout import rollout, simulate
from hybrid_id.simulation.step import Engine
from hybrid_id.systems import one_link

FRICTION = "joint1/motor_friction"
SYSTEMS = {
    "rigid": rigid_drive(),
    "vertical": rigid_drive(vertical=True).with_component(FRICTION, LoadDependent(mu=0.2)),
    "asymmetric": rigid_drive(AsymmetricStribeck()),
    "flexible": flexible_drive().with_component("joint1/link_friction", Coulomb(F_c=0.2)),
    "dahl": rigid_drive(Coulomb(F_c=0.01)).with_component(FRICTION, Dahl(sigma=0.5)),
}


def assert_same(system, engine, batch, theta) -> None:
    free_run = simulate(system, engine, batch, theta)
    walked = rollout(system, engine, batch, theta)
    scale = walked.abs().amax((0, 1)).clamp_min(1e-3)
    assert free_run.status == ("ok",) * batch.rows
    torch.testing.assert_close(free_run.x / scale, walked / scale, rtol=0.0, atol=1e-9)
    torch.testing.assert_close(free_run.y[..., 0], free_run.x[..., 0])


@given(name=st.sampled_from(sorted(SYSTEMS)), seed=st.integers(0, 2**16), smooth=st.booleans())
@settings(max_examples=6)
def test_lifted_simulation_equals_the_loop(name: str, seed: int, smooth: bool) -> None:
    system, generator = SYSTEMS[name], np.random.default_rng(seed)
    u = np.stack([multisine(seed + k, samples=150, rest=7) for k in range(2)])
    batch = batch_of(system, {"u1": u}, rows=2, start={"v_m1": 5.0 * generator.normal()})
    theta = stored(system, 2) * torch.tensor(generator.uniform(0.6, 1.6, (len(system.table), 2)))
    assert_same(system, Engine("smooth", 20) if smooth else Engine(), batch, theta)


@pytest.mark.parametrize("samples", [2, 3, 16, 17, 31, 33])
def test_any_length_and_one_row(samples: int) -> None:
    system = SYSTEMS["flexible"]
    batch = batch_of(system, {"u1": 9.0 * np.sin(0.3 * np.arange(samples))})
    assert_same(system, Engine(), batch, stored(system))


def test_unequal_lengths_and_steps_are_rows_of_one_batch() -> None:
    system, generator = SYSTEMS["vertical"], np.random.default_rng(3)
    lengths, samples = (40, 90, 61), 90
    u = np.stack([multisine(k, samples=samples, rest=3) for k in range(3)])
    steps = 0.002 * generator.uniform(0.5, 1.5, (3, samples))
    for row, n in enumerate(lengths):
        steps[row, n - 1 :] = 0.0
        u[row, n:] = u[row, n - 1]
    batch = replace(batch_of(system, {"u1": u}, rows=3), dt=torch.tensor(steps))
    theta = stored(system, 3) * torch.tensor([0.8, 1.0, 1.3])
    free_run = simulate(system, Engine(), batch, theta)
    for row, n in enumerate(lengths):
        alone = batch_of(system, {"u1": u[row, :n]}, step=steps[row, : n - 1])
        x = simulate(system, Engine(), alone, theta[:, row : row + 1]).x[0]
        torch.testing.assert_close(free_run.x[row, :n], x, rtol=0, atol=1e-9)
        assert (free_run.x[row, n:] == free_run.x[row, n - 1]).all(), "padding must not move"


def test_closed_loop_and_its_switch() -> None:
    system = (
        one_link(1.0)
        .with_values({"J": 2e-5, "P_m1": 0.019})
        .with_component("joint1/input", PositionLoop(duty_per_rad=3e-3))
    )
    goal = np.where(np.arange(300) % 100 < 50, 1.0, -1.0)
    enable = (np.arange(300) < 250).astype(float)
    batch = batch_of(system, {"goal1": goal, "gain1": 300.0, "supply1": 12.0, "enable1": enable})
    assert_same(system, Engine(), batch, stored(system))


@pytest.mark.parametrize("engine", [Engine(), Engine("smooth")], ids=["dry", "smooth"])
def test_diverging_row_is_told_and_leaves_the_others_alone(engine: Engine) -> None:
    system = SYSTEMS["flexible"]
    u = np.stack([multisine(1, samples=50, rest=10)] * 3)
    batch = batch_of(system, {"u1": u}, rows=3)
    theta = stored(system, 3)
    names = [i.name for i in system.table]
    theta[names.index("k"), 1] = 1e9  # far outside the region of stability of one step a sample
    free_run = simulate(system, replace(engine, substeps=8), batch, theta)
    assert free_run.status == ("ok", "diverged", "ok")
    alone = simulate(system, replace(engine, substeps=8), batch.take(torch.tensor([0])), theta[:, :1])
    torch.testing.assert_close(free_run.x[0], alone.x[0], rtol=0, atol=1e-9 * alone.x.abs().max().item())


def test_half_the_step_tells_the_engines_error() -> None:
    system = SYSTEMS["asymmetric"]
    batch = batch_of(system, {"u1": multisine(2, samples=400)})
    assert Engine(substeps=2).halved().substeps == 4
    runs = [simulate(system, e, batch).y for e in (Engine(), Engine().halved(), Engine(substeps=16))]
    change, error = ((runs[k] - runs[j]).abs().max() for k, j in ((0, 1), (0, 2)))
    assert 0.5 * error < change < 2.0 * error
