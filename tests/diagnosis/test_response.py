"""The response to a torque of any shape, against a simulation with that torque."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from drives import flexible_drive, make_record, multisine, rigid_drive
from gapcase import STEP

from hybrid_id.components import LoggedLoad, Viscous
from hybrid_id.diagnosis.response import WINDOW, bumps, respond
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.step import Engine
from hybrid_id.systems import System

SAMPLES = round(WINDOW / STEP)


def linear_drive(kind: str) -> System:
    """A drive without dry friction, whose response does not depend on where it is."""
    if kind == "rigid":
        return rigid_drive(Viscous(F_v=5e-5), ratio=50.0)
    return flexible_drive().with_values({"F_cm": 0.0})


@pytest.mark.parametrize(("kind", "side"), [("rigid", "load"), ("rigid", "motor"), ("flexible", "load")])
def test_response_equals_a_simulated_torque(rng: np.random.Generator, kind: str, side: str) -> None:
    system, engine = linear_drive(kind), Engine(substeps=4)
    record = make_record(
        system, multisine(1, samples=SAMPLES, rest=5, step=STEP), seed=1, noise={"q_m1": 1e-3}, step=STEP
    )
    wave = np.repeat(rng.standard_normal(SAMPLES // 8), 8) * 0.1
    batch = make_batch(system, [record], noise_std={"q_m1": 1e-3})
    opened = respond(system, engine, batch, 1, side)
    found = opened.chained(opened.within(torch.tensor(wave)[None, :, None]))[0, :, 0]

    # a torque on the rotor of a rigid gear is one at the link over the gear ratio, and a load opposes
    loaded = system.with_component("joint1/load", LoggedLoad(c_w=-50.0 if side == "motor" else -1.0))
    runs = []
    for size in (0.0, 1.0):
        driven = replace(record, inputs={**record.inputs, "w1": size * wave})
        with_load = make_batch(loaded, [driven], noise_std={"q_m1": 1e-3})
        runs.append(simulate(loaded, engine, with_load).y[0, :, 0])
    exact = (runs[1] - runs[0]) * opened.weight[0, :, 0]
    exact = exact - opened.start[0] @ (opened.start[0].T @ exact)
    assert float((found - exact).norm()) < 0.02 * float(exact.norm())


def test_bumps_are_flat_together() -> None:
    signal = torch.linspace(-2.0, 2.0, 81, dtype=torch.float64)
    torch.testing.assert_close(bumps(signal, 7, -2.0, 2.0).sum(-1), torch.ones_like(signal))


def test_a_command_that_is_never_given_makes_no_bumps_of_nothing() -> None:
    assert torch.isfinite(bumps(torch.zeros(5, dtype=torch.float64), 9, 0.0, 0.0)).all()
