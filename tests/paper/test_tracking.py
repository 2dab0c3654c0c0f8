"""Computed torque turns the model round: with the right model the loop does what the design says."""

from itertools import pairwise

import numpy as np
import pytest
import torch

from hybrid_id.components import AsymmetricStribeck
from hybrid_id.paper.tracking import ComputedTorque, reference
from hybrid_id.simulation.step import Engine
from hybrid_id.systems import System, one_link

STEP = 0.004
LINK = one_link(156.0, friction=AsymmetricStribeck())
LEVELS = ("f_11", "f_12", "f_21", "f_22")


def controller(
    system: System, motion: np.ndarray, bandwidth: float = 30.0, limit: float = 24.0
) -> ComputedTorque:
    theta = system.theta().detach()[:, None]
    return ComputedTorque(system, theta, motion, sample_time=STEP, bandwidth=bandwidth, limit=limit)


@torch.no_grad()
def errors(control: ComputedTorque, machine: System, motion: np.ndarray, substeps: int = 1) -> np.ndarray:
    """RMS errors [rad] of the links of a machine that is measured without noise."""
    p, engine = machine.views(list(machine.theta()[:, None])), Engine(substeps=substeps)
    x = [torch.zeros(1, dtype=torch.float64) for _ in machine.state_names]
    rotors, found = [joint.positions[0] for joint in machine.joints], []
    for k in range(motion.shape[1]):
        found.append([joint.link_motion(x, p)[0].item() for joint in machine.joints])
        angles, speeds = (np.array([x[row + i].numpy() for row in rotors]) for i in (0, 1))
        voltages = torch.as_tensor(control.command(k, angles, speeds))
        u = {f"u{joint.number}": v for joint, v in zip(machine.joints, voltages, strict=True)}
        x = engine.sample(machine, x, u, torch.full((1,), STEP, dtype=torch.float64), p)
    return np.sqrt(np.mean((np.array(found) - motion[0]) ** 2, 0))


def test_reference_derivatives_belong_together() -> None:
    motion = reference([[(0.3, 0.7), (0.1, 1.9)]], duration=4.0, sample_time=1e-3, fade=1.0)[:, :, 0]
    for low, high in pairwise(motion):
        np.testing.assert_allclose(np.gradient(low, 1e-3)[2:-2], high[2:-2], rtol=1e-3, atol=1e-3)
    assert not motion[:, 0].any()


def test_error_decays_as_designed() -> None:
    smooth = LINK.with_values(dict.fromkeys(LEVELS, 0.0))
    rest = np.zeros((3, 100, 1))
    off = rest.copy()
    off[0] = 1.0 / 156.0  # the machine starts a radian of its motor away from the reference
    time = STEP * np.arange(100)
    exact = (1.0 + 20.0 * time) * np.exp(-20.0 * time)  # critically damped
    rms = errors(controller(smooth, off, 20.0, 1e3), smooth, off).item()
    assert rms == pytest.approx(np.sqrt(np.mean(exact**2)) / 156.0, rel=0.05)
