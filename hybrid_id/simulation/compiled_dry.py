"""Compiled dry engine: scalar code, one lane after the other, each with its own events.

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
from hybrid_id.simulation.dry_equations import source
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.chain import System

_LIBRARIES: WeakKeyDictionary[System, dict[tuple[Any, ...], CDLL]] = WeakKeyDictionary()


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
    point, sizes = _point(u, dt / engine.substeps, theta), (*dt.shape, length, engine.substeps)
    call(_library(system, tuple(u)), "shoot", path, *point, *sizes)
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
    point, sizes = _point(u, dt / engine.substeps, theta), (*dt.shape, engine.substeps)
    code = _library(system, tuple(u), tuple(free))
    call(code, "linearise", after, jacobian, x.contiguous(), *point, *sizes)
    return after, jacobian


def _library(system: System, channels: tuple[str, ...], free: tuple[int, ...] | None = None) -> CDLL:
    known, key = _LIBRARIES.setdefault(system, {}), (channels, free)
    if key not in known:
        known[key] = library(source(system, channels, free), FLAGS)
    return known[key]


def _point(u: Mapping[str, Tensor], step: Tensor, theta: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    held = torch.stack(list(u.values())) if u else step.new_empty(0)
    return held, step.contiguous(), theta.T.contiguous()


def _arrived(system: System, u: Mapping[str, Tensor], theta: Tensor) -> Mapping[str, Tensor]:
    """Channels ``(R, T)`` as they arrive at the motors, without the past that a delay needs."""
    if not any(joint.drive.delay for joint in system.joints):
        return u
    shape = next(iter(u.values())).shape
    p = system.views(list(theta.repeat_interleave(shape[1], 1)))
    arrived = system.hold({name: channel.reshape(-1) for name, channel in u.items()}, p)
    return {name: channel.reshape(shape) for name, channel in arrived.items() if "@" not in name}
