"""A network in place of all physics: the control arm of an ablation."""

from __future__ import annotations

import copy
from collections.abc import Sequence

from hybrid_id.components import ConstantTorque, FreeRotor, OneLink, ResidualNetwork, Rigid
from hybrid_id.components.base import Component, Input, Sensor
from hybrid_id.errors import InputError
from hybrid_id.parameters import Bounded
from hybrid_id.systems.chain import System


def black_box(
    system: System,
    accelerations: Sequence[float],
    *,
    inputs: Sequence[str] = (),
    hidden: Sequence[int] = (16,),
    seed: int = 0,
) -> System:
    """``dv/dt = a g(q, v, u) - b`` for each joint: a neural ODE of second order, network g, no law of physics.

    Channels, gear ratios and encoders are those of the given system, and nothing else of it: a link sits on its motor.
    The inertia 1 / a only scales the network, and the constant b, which the network can say as well, is there because
    a training begins with a fit of something.

    Source: R. T. Q. Chen et al., Neural Ordinary Differential Equations, NeurIPS 2018; of second order as in
    A. Norcliffe et al., On Second Order Behaviour in Augmented Neural ODEs, NeurIPS 2020.

    Args:
        system: model whose place it takes.
        accelerations: typical size a of each joint's acceleration at its motor [rad/s^2].
        inputs: what the networks read beside their joint's angle, speed and command, and the other links' motion.
        hidden: neurons of each hidden layer.
        seed: of the first weights.

    Raises:
        InputError: accelerations that are not positive, one a joint.
    """
    if len(accelerations) != len(system.joints) or not all(a > 0.0 for a in accelerations):
        raise InputError(
            f"accelerations {list(accelerations)} must be positive, one for each of {len(system.joints)} joints."
        )
    parts: list[tuple[str, Component]] = []
    for key, part in system.components.items():
        if isinstance(part, Input | Sensor):
            parts.append((key.rpartition("/")[0], copy.deepcopy(part)))
    for joint, acceleration in zip(system.joints, accelerations, strict=True):
        others = [f"{s}{j.number}" for j in system.joints if j is not joint for s in ("angle", "speed")]
        own = ["angle", "speed", "command", *others]
        reads = [*own, *(name for name in inputs if name not in own)]
        scale = Bounded(1.0 / acceleration, 1e-12, 1e6, "kg m^2", estimate=False)
        parts += [
            (f"{joint.name}/motor", FreeRotor()),
            (f"{joint.name}/motor", ResidualNetwork(inputs=reads, hidden=hidden, seed=seed)),
            (f"{joint.name}/transmission", Rigid()),
            (f"{joint.name}/load", OneLink(J=scale)),
            (f"{joint.name}/load", ConstantTorque()),
        ]
    return System(system.gear_ratio, parts, name=system.name)
