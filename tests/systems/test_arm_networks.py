"""Residual networks at the joints of an arm with more than two joints."""

import numpy as np
import pytest
import torch

from hybrid_id.components.residual import ResidualNetwork
from hybrid_id.errors import InputError
from hybrid_id.robots.tree import Body, RigidBodyTree, SpatialInertia, TreeJoint
from hybrid_id.simulation.solvers import OdeEngine
from hybrid_id.systems.builders import robot
from hybrid_id.systems.by_joint import numbered

IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
STEP = 0.004


def arm(count):
    """A chain of links whose axes are parallel, in a vertical plane."""
    joints = tuple(
        TreeJoint(
            f"j{k}", "hinge", k - 1, IDENTITY, (0.2 if k else 0.0, 0.0, 0.0), armature=0.02, damping=0.1
        )
        for k in range(count)
    )
    link = SpatialInertia.about_centre(
        0.3, (0.1, 0.0, 0.0), ((1e-3, 0.0, 0.0), (0.0, 1e-3, 0.0), (0.0, 0.0, 1e-3))
    )
    bodies = tuple(Body(f"b{k}", k, IDENTITY, (0.0, 0.0, 0.0), link) for k in range(count))
    return robot(RigidBodyTree(joints, bodies, (0.0, -9.81, 0.0)))


def with_network(system, place, inputs):
    part = ResidualNetwork(inputs=inputs, hidden=[3], seed=1)
    with torch.no_grad():  # else it starts at zero, where half of its weights have no gradient
        for weight in part.weights().values():
            weight += 0.3 * torch.randn(
                weight.shape, generator=torch.Generator().manual_seed(2), dtype=weight.dtype
            )
    return system.with_component(place, part)


@pytest.mark.parametrize(
    "place", ["joint1/motor_friction", "joint2/load", "joint3/motor", "joint3/link_friction"]
)
def test_gradients_through_a_network_at_any_joint(place: str) -> None:
    """Adjoint and finite differences agree, for the physics' parameters and a weight."""
    system = with_network(arm(3), place, ["speed", "angle1", "speed2", "angle3"])
    x = [torch.tensor([v], dtype=torch.float64) for v in (0.2, 0.5, -0.4, -0.3, 0.1, 0.7)]
    u = {f"tau{k}": torch.tensor([0.5 / k], dtype=torch.float64) for k in (1, 2, 3)}
    engine, dt = OdeEngine(substeps=2, fine=2, width=0.5), torch.tensor([STEP], dtype=torch.float64)

    def end():
        return torch.cat(engine.sample(system, x, u, dt, system.views(list(system.theta()[:, None]))))

    weights = [w for w in system.networks[f"{place}/residual_network"].parameters() if w.numel() > 1]
    rotor = [p for name, p in system.named_parameters() if name.endswith("J_m")]
    grads = torch.autograd.grad(end()[1::2].sum(), [*weights, *rotor])
    assert all(float(g.abs().max()) > 0 for g in grads)
    for parameter, grad in zip([*weights, *rotor], grads, strict=True):
        flat, at = parameter.data.view(-1), int(grad.abs().argmax())
        kept, h, found = float(flat[at]), 1e-6 * max(float(flat[at].abs()), 1e-2), []
        for way in (h, -h):
            flat[at] = kept + way
            with torch.no_grad():
                found.append(float(end()[1::2].sum()))
        flat[at] = kept
        assert float(grad.view(-1)[at]) == pytest.approx((found[0] - found[1]) / (2 * h), rel=1e-5)


def test_a_network_reads_a_joint_whose_number_has_two_digits() -> None:
    system = with_network(arm(11), "joint1/motor_friction", ["angle11", "speed10"])
    x = [torch.tensor([0.1 * k], dtype=torch.float64) for k in range(22)]
    signals, _ = system.joints[0].networks.signals(
        "motor_friction", x, {}, system.views(list(system.theta()[:, None]))
    )
    np.testing.assert_allclose([float(s) for s in signals], [2.0, 1.9])
    with pytest.raises(InputError, match="'angle12', a joint that is not there"):
        with_network(arm(11), "joint1/motor_friction", ["angle12"])


def test_a_place_may_name_the_joint_as_the_robot_does() -> None:
    system = arm(3)
    assert numbered(system, "j1/load") == "joint2/load"
    assert numbered(system, "joint3/load") == "joint3/load"
    assert numbered(system, "wrist/load") == "wrist/load"
