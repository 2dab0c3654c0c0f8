"""Compiled dry engine: rollouts with lanes side by side (``dry_lanes``), tangents one by one, each with its own events.

The equations of motion and what may hold a speed at rest are recorded (see :mod:`hybrid_id.simulation.dry_equations`);
the C code around them (``dry_code``) follows :mod:`hybrid_id.simulation.step`. Tangents
follow the same steps, the moments of events included: they are those of the discrete map, as the eager engine's are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from ctypes import CDLL
from typing import Any
from weakref import WeakKeyDictionary

import torch
from torch import Tensor

from hybrid_id.simulation.c_code import call, library
from hybrid_id.simulation.dry_code import FLAGS
from hybrid_id.simulation.dry_equations import source, structure
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.chain import System

_STRUCTURES: WeakKeyDictionary[System, tuple[Any, ...]] = WeakKeyDictionary()
_LIBRARIES: dict[tuple[Any, ...], tuple[CDLL, Tensor]] = {}
"""By structure, channels and free parameters: a search meets the same equations in hundreds of systems."""


def walks(system: System, engine: Engine, x: Tensor) -> bool:
    """Whether compiled steps with dry friction are asked for and possible here: no network or GPU."""
    here = x.device.type == "cpu" and x.dtype == torch.float64
    return engine.compiled and engine.friction == "dry" and not system.networks and here


def walk(
    system: System,
    engine: Engine,
    x: Tensor,
    u: Mapping[str, Tensor],
    dt: Tensor,
    theta: Tensor,
    length: int,
) -> Tensor:
    """Nodes ``(R, T, n_x)`` with those inside each chunk of ``length`` replaced by a rollout of its first.

    Args:
        system: equations of motion.
        engine: gives the number of sub-steps.
        x: nodes, ``(R, T, n_x)``.
        u: channels, ``(R, T)`` each.
        dt: sample times [s], ``(R, T)``.
        theta: all parameters in table order, ``(n_p, R)``.
        length: samples of a chunk.

    Raises:
        InputError: there is no C compiler, or the model uses an operation that has no C expression.
    """
    u, path = _arrived(system, u, theta), x.contiguous().clone()
    code, constants = _library(system, tuple(u))
    point, sizes = _point(u, dt / engine.substeps, theta, constants), (*dt.shape, length, engine.substeps)
    call(code, "shoot", path, *point, *sizes)
    return path


def tangents(
    system: System,
    engine: Engine,
    x: Tensor,
    u: Mapping[str, Tensor],
    dt: Tensor,
    theta: Tensor,
    free: Sequence[int],
) -> tuple[Tensor, Tensor]:
    """The sample after every node ``(R, T, n_x)``, and its Jacobian by states and parameters ``(.., n_x, n_x + n_f)``.

    Args:
        system: equations of motion, without a delay.
        engine: gives the number of sub-steps.
        x: nodes, ``(R, T, n_x)``.
        u: channels, ``(R, T)`` each.
        dt: sample times [s], ``(R, T)``.
        theta: all parameters in table order, ``(n_p, R)``.
        free: indices of the parameters to differentiate by.

    Raises:
        InputError: there is no C compiler, or the model uses an operation that has no C expression.
    """
    after = torch.empty_like(x, memory_format=torch.contiguous_format)
    jacobian = x.new_empty(*x.shape, x.shape[-1] + len(free))
    code, constants = _library(system, tuple(u), tuple(free))
    point, sizes = _point(u, dt / engine.substeps, theta, constants), (*dt.shape, engine.substeps)
    call(code, "linearise", after, jacobian, x.contiguous(), *point, *sizes)
    return after, jacobian


def _library(
    system: System, channels: tuple[str, ...], free: tuple[int, ...] | None = None
) -> tuple[CDLL, Tensor]:
    """The code of a system, and the constants that follow its parameters."""
    if system not in _STRUCTURES:
        _STRUCTURES[system] = structure(system)
    key = (_STRUCTURES[system], channels, free)
    if key not in _LIBRARIES:
        code, constants = source(system, channels, free)
        _LIBRARIES[key] = library(code, FLAGS), torch.tensor(constants, dtype=torch.float64)
    return _LIBRARIES[key]


def _point(
    u: Mapping[str, Tensor], step: Tensor, theta: Tensor, constants: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    held = torch.stack(list(u.values())) if u else step.new_empty(0)
    values = torch.cat([theta.T, constants.expand(theta.shape[1], -1)], 1)
    return held, step.contiguous(), values.contiguous()


def _arrived(system: System, u: Mapping[str, Tensor], theta: Tensor) -> Mapping[str, Tensor]:
    """Channels ``(R, T)`` as they arrive at the motors, without the past that a delay needs."""
    if not any(joint.drive.delay for joint in system.joints):
        return u
    shape = next(iter(u.values())).shape
    p = system.views(list(theta.repeat_interleave(shape[1], 1)))
    arrived = system.hold({name: channel.reshape(-1) for name, channel in u.items()}, p)
    return {name: channel.reshape(shape) for name, channel in arrived.items() if "@" not in name}
