"""The torques that a fitted model misses: what acted between a measured state and the next, beside what it knows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from hybrid_id.components.load.constant_torque import ConstantTorque
from hybrid_id.parameters import ParameterInfo
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.lifted import linearise
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.chain import System


@dataclass(frozen=True, eq=False)
class Torques:
    """What a model misses of one record between samples, as torques at the links.

    Attributes:
        record: its name.
        step: sample time [s].
        torque: ``(T, n_joints)`` [N m]; 0 where a joint sticks, which identifies nothing.
        own: what each parameter of :func:`own_parameters` takes from it per unit, ``(T, n_joints, n_p)``.
    """

    record: str
    step: float
    torque: np.ndarray
    own: np.ndarray


@torch.no_grad()
def missing_torques(system: System, engine: Engine, batch: Batch) -> list[Torques]:
    """Torques at the links that lead the model from each sample's state exactly to the next one's speeds.

    Args:
        system: fitted model.
        engine: how a sample is integrated; smooth friction identifies more, since a joint that sticks hides a torque.
        batch: records with one sample time, prepared for the model; its states ``x`` are taken as measured.
    """
    parts = [f"{joint.name}/load" for joint in system.joints]
    opened = system
    for place in parts:
        if f"{place}/{ConstantTorque.kind}" not in system.components:
            opened = opened.with_component(place, ConstantTorque(T_0=0.0))
    index = {(o.component, o.symbol): i for i, o in enumerate(opened.table)}
    loads = [index[f"{place}/{ConstantTorque.kind}", "T_0"] for place in parts]
    own = [index[o.component, o.symbol] for o in own_parameters(system)]
    theta = opened.theta().detach()[:, None].expand(-1, batch.rows)
    lin = linearise(opened, engine, batch.x, batch.u, batch.dt, theta, [*loads, *own], batch.outputs)
    speeds = [joint.positions[-1] + 1 for joint in opened.joints]
    missed = (batch.x[:, 1:] - lin.x_next[:, :-1])[:, :, speeds]
    gains = lin.b[:, :-1][:, :, speeds]
    # a load opposes; a joint that sticks has no gain, and the least torque is none
    inverse = torch.linalg.pinv(-gains[..., : len(loads)], rtol=1e-6)
    torque = (inverse @ missed[..., None])[..., 0]
    columns = inverse @ gains[..., len(loads) :]
    found = []
    for row, name in enumerate(batch.names):
        used = batch.dt[row, :-1] > 0
        step = float(batch.dt[row, :-1][used].median())
        found.append(Torques(name, step, torque[row, used].numpy(), columns[row, used].numpy()))
    return found


def own_parameters(system: System) -> list[ParameterInfo]:
    """The parameters that may explain a missing torque: those of a fit, but for constant loads, which are no pulses."""
    return [o for o in system.table if o.spec.estimate and not o.component.endswith(ConstantTorque.kind)]


def moved(system: System, change: np.ndarray) -> System:
    """The system with its own parameters moved, within their bounds."""
    values = {
        o.name: float(np.clip(o.spec.value + step, o.spec.lower, o.spec.upper))
        for o, step in zip(own_parameters(system), change, strict=True)
    }
    return system.with_values(values)
