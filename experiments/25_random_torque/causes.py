"""What may be missing, as columns: what each candidate does to the next state and to the outputs, at its usual size."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import torch
from random_torque import RandomTorque
from torch import Tensor

from hybrid_id.components import CATALOGUE
from hybrid_id.diagnosis.catalogue import with_effect
from hybrid_id.diagnosis.scales import scales
from hybrid_id.errors import InputError
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.lifted import Linearisation
from hybrid_id.systems.chain import System

LOST = 10.0
"""Change of a state in one sample, over its largest value, at which a candidate has lost its own states."""
REPEATED, MOST_WAVES, WAVES = 2.0, 200, 3
"""Waves over all motion from which a torque over the angle is periodic, most a turn, and how many are candidates."""
SHARE = 0.1
"""Change of a value whose effect is its column."""


@dataclass(frozen=True, eq=False)
class Cause:
    """One candidate at one start point.

    Attributes:
        name: the effect's, or that of a parameter.
        where: its place; "value" of a parameter.
        state: change of the next state, ``(R, T, n_x)``.
        seen: change of the outputs, ``(R, T, n_y)``.
        one_sided: whether its size cannot be below zero.
        model: the system with it; None of a value.
    """

    name: str
    where: str
    state: Tensor
    seen: Tensor
    one_sided: bool
    model: System | None = None

    @property
    def kind(self) -> tuple[str, str]:
        """Of which a model has one at most."""
        return self.name, self.where


def causes(
    likelihood: RandomTorque, lin: Linearisation, theta: Tensor, records: Callable[[System], Batch]
) -> list[Cause]:
    """All candidates beside a model.

    Args:
        likelihood: of the records, about its smoothed states.
        lin: the model about them.
        theta: its parameters, ``(n_p,)``.
        records: prepared for a model.
    """
    system, found = likelihood.system, list[Cause]()
    for i, info in enumerate(system.table):
        if info.spec.value and i not in likelihood.free:
            moved = theta.clone()
            moved[i] *= 1.0 + SHARE
            with suppress(InputError):
                found += _cause(likelihood, lin, moved, system, likelihood.batch, info.name, "value", SHARE)
    found += _waves(likelihood, lin)
    fitted = system.with_values({info.name: float(v) for info, v in zip(system.table, theta, strict=True)})
    for size in scales(fitted, likelihood.batch):
        for effect in CATALOGUE.values():
            for where, models in with_effect(effect, fitted, size).items():
                for model in models:
                    with suppress(InputError):
                        found += _cause(
                            likelihood, lin, model.theta().detach(), model, records(model), effect.name, where
                        )
    return found


def _waves(likelihood: RandomTorque, lin: Linearisation) -> list[Cause]:
    """The strongest waves over each rotor's angle, as torques at it that were the random one before."""
    maps, n_x, found = likelihood.maps(lin), likelihood.x.shape[2], list[Cause]()
    for k, row in enumerate(likelihood.pushed):
        angle, pushes = likelihood.x[..., row - 1], maps.a[..., :n_x, n_x + k]
        turns = float(angle.max() - angle.min()) / (2.0 * math.pi)
        ranked = []
        for n in range(max(1, math.ceil(REPEATED / turns)), MOST_WAVES + 1) if turns > 0 else ():
            pair = torch.stack(
                [pushes * torch.cos(n * angle)[..., None], pushes * torch.sin(n * angle)[..., None]], -1
            )
            flat = likelihood.columns(lin, pair).errors.flatten(0, 2)
            known = 1 + len(likelihood.free)
            slope, left = flat[:, known:], flat[:, 0]
            base = flat[:, 1:known]
            slope = slope - base @ torch.linalg.lstsq(base, slope).solution
            size = -torch.linalg.lstsq(slope, left).solution
            ranked.append((float((slope @ size).square().sum()), n, pair @ size))
        for _, n, state in sorted(ranked, key=lambda one: -one[0])[:WAVES]:
            state[:, -1] = 0.0
            where = f"joint{likelihood.system.joints[0].number}/motor"
            found.append(Cause(f"wave of {n} a turn", where, state, torch.zeros_like(lin.y), one_sided=True))
    return found


def _cause(
    likelihood: RandomTorque,
    lin: Linearisation,
    theta: Tensor,
    model: System,
    batch: Batch,
    name: str,
    where: str,
    share: float = 0.0,
) -> list[Cause]:
    """The candidate; none where it changes nothing."""
    shared = [model.state_names.index(state) for state in likelihood.system.state_names]
    after = likelihood.beside(theta, model, batch)
    state, seen = after.x_next[..., shared] - lin.x_next, after.y - lin.y
    size = likelihood.x.abs().amax((0, 1)).clamp_min(1e-12)
    sane = bool((state.abs().amax((0, 1)) < LOST * size).all() and seen.isfinite().all())
    if not sane or float(state.abs().max() + seen.abs().max()) == 0.0:
        return []
    if share:
        return [Cause(name, where, state / share, seen / share, one_sided=False)]
    own = [
        info
        for info in model.table
        if info.component not in likelihood.system.components and info.spec.estimate
    ]
    return [Cause(name, where, state, seen, bool(own) and all(i.spec.lower >= 0.0 for i in own), model)]
