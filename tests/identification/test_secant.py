"""A gear with play, fitted by finite steps."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch
from drives import batch_of, multisine, rigid_drive

from hybrid_id.components import Backlash, Delay
from hybrid_id.errors import InputError
from hybrid_id.identification.secant import Rollouts, secant_fit
from hybrid_id.parameters import Bounded
from hybrid_id.simulation.rollout import rollout
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.chain import System

QUICK = Engine("smooth", width=0.5, compiled=True)
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
    found = secant_fit(
        start, batch, engine=QUICK, iterations=30, starts=[loose_drive(0.1), loose_drive(0.002)]
    )
    gap = found.system.parameter("gap").spec.value
    assert gap == pytest.approx(0.03, rel=0.05)
    assert found.noise_scale < 1.5
    assert found.jacobian[0].shape == (*found.residual[0].shape, len(found.names))


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
        secant_fit(held, batch, engine=QUICK)
