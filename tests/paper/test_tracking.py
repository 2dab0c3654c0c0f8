"""Computed torque turns the model round: with the right model the loop does what the design says."""

from itertools import pairwise

import numpy as np
import pytest
import torch

from hybrid_id.components import AsymmetricStribeck, BacklashFlexibility
from hybrid_id.paper.tracking import ComputedTorque, reference
from hybrid_id.simulation.step import Engine
from hybrid_id.systems import System, one_link, one_link_flexible, two_link

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


def test_right_model_tracks_and_friction_matters() -> None:
    motion = reference([[(0.3, 1.0)]], duration=1.4, sample_time=STEP, fade=0.5)
    bare = LINK.with_values(dict.fromkeys((*LEVELS, "f_3"), 0.0))
    right, frictionless = (errors(controller(model, motion), LINK, motion).item() for model in (LINK, bare))
    assert right < 1e-3 and frictionless > 3 * right


def test_error_decays_as_designed() -> None:
    smooth = LINK.with_values(dict.fromkeys(LEVELS, 0.0))
    rest = np.zeros((3, 100, 1))
    off = rest.copy()
    off[0] = 1.0 / 156.0  # the machine starts a radian of its motor away from the reference
    time = STEP * np.arange(100)
    exact = (1.0 + 20.0 * time) * np.exp(-20.0 * time)  # critically damped
    rms = errors(controller(smooth, off, 20.0, 1e3), smooth, off).item()
    assert rms == pytest.approx(np.sqrt(np.mean(exact**2)) / 156.0, rel=0.05)


def test_two_links_decouple() -> None:
    arm = two_link((156.0, 84.0))
    motion = reference([[(0.2, 0.8)], [(0.3, 1.2)]], duration=1.4, sample_time=STEP, fade=0.5)
    blind = arm.with_values({"P_3": 0.0, "P_4": 0.0})
    right, wrong = (errors(controller(model, motion, 25.0, 48.0), arm, motion) for model in (arm, blind))
    assert (right < 2e-3).all() and (wrong > right).all()


def test_spring_with_play_is_led() -> None:
    spring = BacklashFlexibility(k=380.16, alpha=0.31, beta=169.34)
    truth = one_link_flexible(156.0, friction=AsymmetricStribeck())
    truth = truth.with_component("joint1/transmission", spring).with_values({"J_m": 1.32e-5, "J_a": 0.09})
    rigid = LINK.with_values({"J": 1.32e-5 + 0.09 / 156.0**2})
    motion = reference([[(0.3, 0.5)]], duration=1.4, sample_time=STEP, fade=0.5)
    led, followed = (
        errors(controller(model, motion), truth, motion, substeps=4).item() for model in (truth, rigid)
    )
    assert led < 0.5 * followed
