"""Hybrid of a robot, joint by joint: a small network for what the physics of a joint leaves, where that is not noise.

Each joint is taken by itself, the others as measured. Physics is fitted alone; a network of angle and speed is fitted
to what it leaves, by the same least squares, then both together, no physical parameter moving further than its standard
error without the network allows, so that it keeps its meaning. Records left out decide whether the network stays, and
how small its weights have to be.

Sources: Y. Yin et al., APHYNITY, ICLR 2021 (physics plus a network of least norm); C. Nadeau, Y. Bengio, Inference for
the Generalization Error, Machine Learning 52, 2003 (intervals over records that took turns).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
import torch
from torch import Tensor

from hybrid_id.components.load.residual_torque import ResidualTorque
from hybrid_id.errors import InputError, listed
from hybrid_id.identification.fit import fit
from hybrid_id.identification.horizons import WHOLE, Horizon, choose_horizon
from hybrid_id.identification.least_squares import Options
from hybrid_id.identification.result import FitResult
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.record import Record
from hybrid_id.simulation.compiled import compiled_for
from hybrid_id.simulation.step import Engine
from hybrid_id.statistics.uncertainty import robust_covariance
from hybrid_id.statistics.variation import PairedDifference, paired_difference
from hybrid_id.study.replay import batch_of, weighted_errors
from hybrid_id.systems.by_joint import (
    joint_number,
    moving_records,
    some,
    turned_together,
    with_drive,
    with_others_measured,
)
from hybrid_id.systems.chain import System
from hybrid_id.systems.joint import Joint

SIZES = (1.0, 0.1, 0.01)
"""Standard deviations that priors give the weights of the network's output, in units of its scale: which one, records
left out choose."""
SHAPES = 1.0
"""The same of the weights inside the network."""
HELD = 2.0
"""How far beside a network a physical parameter may move, in its standard errors without."""
FOLDS = 4
"""Parts of the train records that are left out in turn, at most."""
ITERATIONS = 40
GRID, SHOWN = 41, 600
"""Points of a map along either axis, and samples beside it, at most."""

Say = Callable[[str, int, int], None]


@dataclass(frozen=True, eq=False)
class TorqueMap:
    """Torque of a network over angle and speed of its joint, where the records have been.

    Attributes:
        angle, speed: grid, ``(n_q,)`` [rad] and ``(n_v,)`` [rad/s].
        torque: that it opposes the drive with, ``(n_v, n_q)`` [N m].
        seen: angle and speed at samples of the train records, ``(n, 2)``.
        share: RMS of the torque at all samples over that of the drive's torque.
    """

    angle: np.ndarray
    speed: np.ndarray
    torque: np.ndarray
    seen: np.ndarray
    share: float


@dataclass(frozen=True, eq=False)
class JointHybrid:
    """Physics of a joint, with and without a network; joints of a coupled gear share all but the map.

    Attributes:
        physics: fit of the physics alone to all train records.
        hybrid: fit of the network beside it to them; the physics alone where the network has not earned its place.
        size: of the network's weights, see :data:`SIZES`; None where there is none.
        gain: by how much the network lowers the logarithm of the RMS error on records left out, with its interval, at
            the best size.
        left_out: RMS of the weighted errors of each record while it was left out, physics alone and with the network.
        tested: the same of the test records.
        horizon: how long the free runs are.
        map: of the network that stays; None without.
    """

    physics: FitResult
    hybrid: FitResult
    size: float | None
    gain: PairedDifference
    left_out: Mapping[str, tuple[float, float]]
    tested: Mapping[str, tuple[float, float]]
    horizon: Horizon
    map: TorqueMap | None

    @property
    def drift(self) -> dict[str, float]:
        """By how many of its standard errors without the network each physical parameter has moved."""
        std = standard_errors(self.physics)
        after = dict(zip(self.hybrid.names, self.hybrid.values, strict=True))
        before = zip(self.physics.names, self.physics.values, strict=True)
        return {name: float(after[name] - value) / std[name] for name, value in before if name in std}


@dataclass(frozen=True, eq=False)
class ArmHybrid:
    """Result of :func:`learn_residuals`.

    Attributes:
        joints: by name.
        skipped: joints without a result, each with the reason.
        physics, system: the whole robot, physics re-fitted joint by joint, and with the networks that stay.
        tested: RMS of the weighted errors of both on each test record, all joints simulated.
        interrupted: whether it was stopped before the last joint.
    """

    joints: Mapping[str, JointHybrid]
    skipped: Mapping[str, str]
    physics: System
    system: System
    tested: Mapping[str, tuple[float, float]]
    interrupted: bool = False

    @property
    def others(self) -> list[str]:
        """Joints of the robot that were not taken."""
        names = () if self.system.tree is None else self.system.tree.names
        return [name for name in names if name not in self.joints]


def learn_residuals(
    dataset: Dataset,
    system: System,
    joints: Sequence[str] = (),
    *,
    horizon: Horizon | None = None,
    say: Say | None = None,
) -> ArmHybrid:
    """Let a network at each joint of a robot learn what physics leaves there, and keep those that earn their place.

    Args:
        dataset: of the whole robot: train records, validation records if there are any (else the train records are
            left out in turn), test records.
        system: the robot, with values to start from.
        joints: names; none for all. Those that a coupled gear turns together are taken together, with a network each,
            which all stay or none.
        horizon: how long free runs are; None for what the records of each joint ask for.
        say: called with (joint, done, total).

    Ctrl-C ends it with the joints that are done.

    Raises:
        InputError: a joint that the robot has not, too few records, or no joint that can be taken.
    """
    if system.tree is None:
        raise InputError(
            "Networks are learnt joint by joint for a robot; give a model that names its description."
        )
    if system.learned:
        raise InputError(
            f"The model has a network ({listed(system.learned)}); give the physics alone: a training writes it as "
            "physics.yaml beside its model.yaml."
        )
    names, skipped = list(joints or system.tree.names), dict[str, str]()
    numbers = {name: joint_number(system, name) for name in names}
    found: dict[str, JointHybrid] = {}
    physics = whole = system
    interrupted = False
    for done, (name, k) in enumerate(numbers.items()):
        if name in found:
            continue
        try:
            if say is not None:
                say(name, done, len(names))
            part = turned_together(system, k)
            one = some(system, part)
            own = with_others_measured(moving_records(dataset, *part), system, *part)
            learnt = _learn(own, one, horizon)
        except InputError as error:
            skipped[name] = str(error).removesuffix(".")
            continue
        except KeyboardInterrupt:
            if not found:
                raise
            skipped |= dict.fromkeys((n for n in names if n not in found and n not in skipped), "stopped")
            interrupted = True
            break
        found |= {system.tree.names[k]: each for k, each in zip(part, learnt, strict=True)}
        taken = [result.system for result in (learnt[0].physics, learnt[0].hybrid)]
        for each in taken:
            each.whole = one.whole
        physics, whole = with_drive(physics, taken[0]), with_drive(whole, taken[1])
    if not found:
        raise InputError(
            "No joint can be taken by itself: " + "; ".join(f"{n}: {w}" for n, w in skipped.items())
        )
    tested: dict[str, tuple[float, float]] = {}
    if dataset.test:
        errors = [_errors(dataset, one, dataset.test, WHOLE) for one in (physics, whole)]
        tested = {name: (errors[0][name], errors[1][name]) for name in errors[0]}
    return ArmHybrid(found, skipped, physics, whole, tested, interrupted)


def _learn(dataset: Dataset, system: System, horizon: Horizon | None) -> list[JointHybrid]:
    """Physics alone and with a network at each joint, of a joint by itself or of those of a coupled gear together."""
    train = dataset.train
    judges = "validation" if dataset.validation else "train"
    if not train or len(dataset.validation or train) < 2:
        raise InputError(
            f"Dataset '{dataset.name}' has {len(train)} train and {len(dataset.validation)} validation records where "
            "the joint moves; two validation records or more judge a network, or, without any, two train records or "
            f"more, left out in turn: give more records the role {judges if train else 'train'}."
        )
    engine = compiled_for(system, Engine())

    def fitted(start: System, records: Sequence[Record], over: Horizon) -> FitResult:
        """One set of the estimated parameters for all of some records."""
        batch = over.cut(start, engine, batch_of(dataset, start, records))
        return fit(start, batch, pooled=True, engine=engine, options=Options(max_iterations=ITERATIONS))[0]

    physics = fitted(system, train, horizon or WHOLE)
    if horizon is None:
        batch = batch_of(dataset, system, train)
        horizon = choose_horizon(system, physics.engine, batch, [physics])
        if horizon.kind != "whole":
            physics = fitted(system, train, horizon)
    held = (
        [dataset.validation]
        if dataset.validation
        else [train[k::FOLDS] for k in range(min(FOLDS, len(train)))]
    )
    errors: dict[float, dict[str, tuple[float, float]]] = {size: {} for size in SIZES}
    for part in held:
        rest = [record for record in train if record.name not in {r.name for r in part}]
        before = fitted(physics.system, rest, horizon)
        own = _errors(dataset, before.system, part, horizon)
        for size in SIZES:
            after = _with_network(dataset, before, rest, size, horizon)
            richer = _errors(dataset, after.system, part, horizon)
            errors[size] |= {name: (own[name], richer[name]) for name in own}
    apart = sum(map(len, held)) / len(held)
    overlap = apart / (len(train) if dataset.validation else len(train) - apart)
    best, gain, stays = _best_size(errors, overlap)
    hybrid = _with_network(dataset, physics, train, best, horizon) if stays else physics
    tested = [_errors(dataset, one.system, dataset.test, horizon) for one in (physics, hybrid)]
    found = JointHybrid(
        physics, hybrid, best if stays else None, gain, errors[best],
        {name: (tested[0][name], tested[1][name]) for name in tested[0]}, horizon, None,
    )  # fmt: skip
    joints = hybrid.system.joints
    return [replace(found, map=_map(dataset, hybrid.system, joint) if stays else None) for joint in joints]


def _best_size(
    errors: Mapping[float, Mapping[str, tuple[float, float]]], overlap: float
) -> tuple[float, PairedDifference, bool]:
    """The size that does best on records left out, its gain, and whether a network stays.

    One whose runs diverge where those of physics do not has no gain on other records that makes up for it.

    Args:
        errors: of physics and with the network, by size and record.
        overlap: see :func:`hybrid_id.statistics.variation.paired_difference`.
    """
    level = 1.0 - 0.05 / len(errors)  # the best of several
    gains = {
        size: paired_difference(*np.log(list(pairs.values())).T, overlap=overlap, level=level)
        for size, pairs in errors.items()
    }
    lost = [size for size, pairs in errors.items() if any(b == np.inf > a for a, b in pairs.values())]
    best = max(gains, key=lambda size: (size not in lost, np.nan_to_num(gains[size].mean, nan=-np.inf)))
    return best, gains[best], best not in lost and gains[best].lower > 0.0


def _with_network(
    dataset: Dataset,
    physics: FitResult,
    records: Sequence[Record],
    size: float,
    horizon: Horizon,
) -> FitResult:
    """Fit of a network at each joint to what a model leaves, first with the model held, then of both."""
    system = physics.system
    richer = system.with_specs({i.name: replace(i.spec, estimate=False) for i in system.table})
    for joint in system.joints:
        angle, speed, torque = _motion(dataset, system, joint, records)
        low, high = float(angle.min()), float(angle.max())
        network = ResidualTorque(
            S_r=_rms(torque), m_q=0.5 * (low + high), s_q=0.5 * (high - low) or 1.0, s_v=_rms(speed)
        )
        richer = richer.with_component(f"{joint.name}/load", network)
    priors = {
        info.name: replace(
            info.spec, prior_mean=info.spec.value, prior_std=size if info.symbol.startswith("c_") else SHAPES
        )
        for info in richer.table
        if info.component.endswith(f"/{ResidualTorque.kind}") and info.spec.estimate
    }
    richer = richer.with_specs(priors)
    engine = compiled_for(richer, physics.engine)
    part = horizon.cut(richer, engine, batch_of(dataset, richer, records))
    options = Options(max_iterations=ITERATIONS)
    settings = {"pooled": True, "engine": engine, "options": options, "warm": False}
    learnt = fit(richer, part, **settings)[0].system
    reach = {name: HELD * std for name, std in standard_errors(physics).items()}
    known = {name: learnt.parameter(name).spec for name in reach}
    freed = {
        name: replace(
            spec, estimate=True, lower=max(spec.lower, spec.value - reach[name]),
            upper=min(spec.upper, spec.value + reach[name]),
        )
        for name, spec in known.items()
    }  # fmt: skip
    both = fit(learnt.with_specs(freed), part, **settings)[0]
    ends = {  # those without a standard error, which have not moved, stay parameters to be estimated, too
        name: replace(learnt.parameter(name).spec.at(both.system.parameter(name).spec.value), estimate=True)
        for name in physics.names
    }
    return replace(both, system=both.system.with_specs(ends))


def _motion(
    dataset: Dataset, system: System, joint: Joint, records: Sequence[Record]
) -> tuple[Tensor, Tensor, Tensor]:
    """Angle [rad], speed [rad/s] and its own drive's torque [N m] of a joint at its link, ``(N,)`` each."""
    batch = batch_of(dataset, system, records)
    used = (batch.weight > 0).any(2)
    states = [column[used] for column in batch.x.unbind(2)]
    channels = {name: channel[used] for name, channel in batch.u.items()}
    with torch.no_grad():
        views = system.views([value.reshape(1) for value in system.theta()])
        torque = joint.drive.torque(states, channels, views) * joint.gear_ratio
        return *joint.link_motion(states, views), torque


def _rms(values: Tensor) -> float:
    """Root mean square, 1 of nothing."""
    return float(values.square().mean().sqrt()) or 1.0


@torch.no_grad()
def _map(dataset: Dataset, system: System, joint: Joint) -> TorqueMap:
    """What a joint's network does, over the range of its train records."""
    angle, speed, drive = _motion(dataset, system, joint, dataset.train)
    network = cast(ResidualTorque, system.components[f"{joint.name}/load/{ResidualTorque.kind}"])
    grids = [
        torch.linspace(float(s.min()), float(s.max()), GRID, dtype=torch.float64) for s in (angle, speed)
    ]
    over, along = torch.meshgrid(grids[1], grids[0], indexing="ij")
    share = _rms(network.torque(network.view(), angle, speed)) / _rms(drive)
    every = max(1, len(angle) // SHOWN)
    return TorqueMap(
        grids[0].numpy(), grids[1].numpy(), network.torque(network.view(), along, over).numpy(),
        torch.stack((angle, speed), 1)[::every].numpy(), share,
    )  # fmt: skip


def standard_errors(physics: FitResult) -> dict[str, float]:
    """Autocorrelation-robust standard errors of the parameters that have one, by name."""
    std = robust_covariance(*physics.of_records(), prior_precision=physics.prior_precision).std_error
    return {n: float(s) for n, s in zip(physics.names, std, strict=True) if 0.0 < s < np.inf}


def _errors(
    dataset: Dataset, system: System, records: Sequence[Record], horizon: Horizon
) -> dict[str, float]:
    """RMS of the weighted errors of a model's free runs, by record."""
    if not records:
        return {}
    batch = batch_of(dataset, system, records)
    return weighted_errors(system, compiled_for(system, Engine()), batch, horizon)
