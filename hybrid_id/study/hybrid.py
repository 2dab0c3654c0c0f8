"""Physics alone and physics with networks on the same records, and whether the parameters keep their meaning."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from hybrid_id.errors import InputError, close_match, listed
from hybrid_id.identification.fit import fit
from hybrid_id.identification.hybrid import HybridOptions, HybridResult, physics_of, train_hybrid
from hybrid_id.identification.least_squares import Options
from hybrid_id.identification.networks import effects, networks_of, physical_names, span
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.record import Record
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.step import Engine
from hybrid_id.statistics.residuals import ResidualTest
from hybrid_id.statistics.uncertainty import autocorrelation_robust
from hybrid_id.study.checks import residual_tests
from hybrid_id.study.replay import batch_of, weighted_errors
from hybrid_id.study.result import Study
from hybrid_id.study.run import analyse_fits
from hybrid_id.systems.chain import System
from hybrid_id.systems.networks import HARMONIC, LINK_PLACES

OVERLAP, SMALL, DRIFT, BLUR = 0.2, 0.01, 3.0, 5.0
"""Overlap with the physics from which on a network is said to do its work, share of the torque under which it does next
to nothing, drift in standard errors from which on a parameter is said to have moved, and growth of its standard error
from which on the network is said to be able to do its work."""
MET, MISSED = 1.5, 3.0
"""Errors in units of the noise up to which records are said to be met, and from which on to be missed."""
GRID = 61


@dataclass(frozen=True, eq=False)
class HybridStudy:
    """Result of :func:`hybridise`.

    Attributes:
        result: the training.
        validation: names of the records that chose.
        names, units: of the estimated parameters.
        physics, hybrid: their values without and with the networks, ``(n_f,)``.
        physics_error, hybrid_error: their standard errors, ``(n_f,)``.
        roles: what each network does on the train records, also where physics alone is chosen.
        errors: RMS of the weighted output error by record, physics and hybrid; 1 is the noise floor.
        level: confidence of all intervals.
        pooled, own: RMS of the weighted residuals of physics alone on the train records, with one set of parameters for
            all and with a set for each.
    """

    result: HybridResult
    validation: tuple[str, ...]
    names: tuple[str, ...]
    units: tuple[str, ...]
    physics: np.ndarray
    hybrid: np.ndarray
    physics_error: np.ndarray
    hybrid_error: np.ndarray
    roles: tuple[NetworkRole, ...]
    errors: dict[str, tuple[float, float]]
    pooled: float
    own: float
    level: float = 0.95

    @property
    def drift(self) -> np.ndarray:
        """Change of each parameter from physics alone to hybrid in standard errors of the difference, ``(n_f,)``."""
        return (self.hybrid - self.physics) / np.hypot(self.physics_error, self.hybrid_error)

    @property
    def blur(self) -> np.ndarray:
        """Growth of each standard error, per unit of what the model misses, by the networks without a price."""
        first, chosen = self.result.models[0], self.result.models[self.result.chosen]
        return (chosen.plain / chosen.train**0.5) / np.maximum(first.plain / first.train**0.5, 1e-300)

    def against(self, name: str) -> list[str]:
        """What the networks may have done to a parameter, so that it does not mean what its name says."""
        k = self.names.index(name)
        said = {
            "moved by the networks": math.isfinite(self.drift[k]) and abs(self.drift[k]) > DRIFT,
            "a network could do its work": self.result.chosen > 0 and self.blur[k] > BLUR,
        }
        return [words for words, holds in said.items() if holds]

    @property
    def room(self) -> np.ndarray:
        """Half the 95 % interval of each parameter where the price alone separates it from the networks, ``(n_f,)``.

        The linear error without the price takes the networks as they are. But how much of their torque lies in the
        parameter, the price has chosen, and nothing that was measured. So a part as large as the networks' whole effect
        is taken as one more standard error.
        """
        hidden = np.array([[role.room.get(name, 0.0) for name in self.names] for role in self.roles])
        return 1.96 * np.hypot(self.result.models[self.result.chosen].loose, np.linalg.norm(hidden, axis=0))

    @property
    def warnings(self) -> list[str]:
        """In words, where a network does the physics' work and the parameters may not mean what their names say."""
        result, found = self.result, list[str]()
        if self.own < MET and self.pooled > MISSED:
            found.append(
                f"with parameters of its own each train record is met to {self.own:.2g} times the noise, with the same "
                f"for all to {self.pooled:.2g}: the parameters differ from record to record, which no network that all "
                "share can say, and what one learns here may be a makeshift; 'hybrid-id identify' says how far they "
                "differ"
            )
        if result.interrupted:
            found.append("stopped by Ctrl-C before the training was done: whether a network helps is open")
        if len(result.models) == 1:
            return found
        if result.chosen == 0:
            words = (
                "the validation records ask for no network: physics alone is as good, so it is what is kept"
            )
            return [words, *found]
        values = dict(zip(self.names, self.hybrid, strict=True))
        for role in self.roles:
            if role.share > SMALL and role.overlap > OVERLAP:
                names = [name for name, cosine in role.alike if cosine > OVERLAP] or [role.alike[0][0]]
                parts = []
                for name in names:
                    worth, value = role.worth[name], values[name]
                    share = f"{100 * worth / value:+.0f} %" if value else "from 0"
                    parts.append(f"{name} by {worth:+.2g} ({share})")
                found.append(
                    f"the network at {role.where} does work that the physics could do: {100 * role.overlap:.0f} % of "
                    f"the accelerations it causes look like a change of the parameters, of {', '.join(parts)}; these "
                    "may be wrong by as much and more, do not read them as physical"
                )
        for name, blur, room, value in zip(self.names, self.blur, self.room, self.hybrid, strict=True):
            if blur > BLUR:
                found.append(
                    f"the network could do the work of {name}, which the price alone keeps near its value without a "
                    "network: what biased it there biases it still. If as much of the missing effect lies in it as in "
                    f"the network, its 95 % interval is {value:.3g} ± {room:.2g}"
                )
        for name, drift in zip(self.names, self.drift, strict=True):
            if math.isfinite(drift) and abs(drift) > DRIFT:
                found.append(
                    f"{name} moved by {drift:+.1f} standard errors when the networks came in: without them it made up "
                    "for what the model lacks, or with them it lost a part of its meaning"
                )
        return found


def physics_alone(dataset: Dataset, study: HybridStudy) -> Study:
    """The physics alone of a hybrid training as :func:`hybrid_id.study.identify` would judge it."""
    physics = study.result.physics
    fitted = dataset.select(physics.records)  # the others have validated
    return analyse_fits(fitted, physics.system, [physics], pooled=True, level=study.level)


def hybridise(
    dataset: Dataset,
    system: System,
    *,
    options: HybridOptions | None = None,
    validation: Sequence[str] | None = None,
    device: str = "cpu",
    level: float = 0.95,
    **settings: Any,
) -> HybridStudy:
    """Train a model with networks on the train records, and say what the networks do there.

    Args:
        dataset: train records are trained on; test records are only scored, unless they have to validate.
        system: model with at least one residual network.
        options: settings of the training.
        validation: names of the records that say when to end and whether to keep the networks (default: see
            :func:`split`).
        device: torch device.
        level: confidence of the intervals.
        settings: further arguments of :func:`hybrid_id.identification.hybrid.train_hybrid`.
    """
    options = options or HybridOptions()
    train, held = split(dataset, validation)
    batch, looked = (batch_of(dataset, system, part, device) for part in (train, held))
    start = copy.deepcopy(system).to(device)
    result = train_hybrid(start, batch, looked, options=options, spread=correlated_errors, **settings)
    system, batch = copy.deepcopy(system).to("cpu"), batch.to("cpu")  # what follows is done once
    for trained in (result.physics, *result.models):
        trained.system.to("cpu")
    first, chosen = result.models[0], result.models[result.chosen]
    info = [i for i in first.system.table if i.spec.estimate]
    values = [np.array([s.parameter(i.name).spec.value for i in info]) for s in (first.system, chosen.system)]
    roles = network_roles(result.models[-1].system, result.engine, batch)
    everything = batch_of(dataset, system, dataset.records)
    misses = [weighted_errors(s, result.engine, everything) for s in (first.system, chosen.system)]
    # how far the records are met with parameters of their own, from those of the fit with one set for all
    physics, alone = result.physics, physics_of(system, batch)[1]
    smooth = Engine("smooth", physics.engine.substeps, physics.engine.width)
    sets = fit(physics.system, alone, engine=smooth, options=Options(loss=options.loss), warm=False)
    residuals = np.concatenate([row.reshape(-1) for one in sets for row in one.residual])
    own = float(np.sqrt(np.square(residuals).sum() / sum(one.n_samples for one in sets)))
    return HybridStudy(
        result, tuple(r.name for r in held), tuple(i.name for i in info), tuple(i.unit for i in info),
        values[0], values[1], first.errors, chosen.errors, roles,
        {name: (misses[0][name], misses[1][name]) for name in everything.names},
        result.physics.noise_scale, own, level,
    )  # fmt: skip


def correlated_errors(
    jacobians: list[np.ndarray], residuals: list[np.ndarray], prior: np.ndarray
) -> np.ndarray:
    """Standard errors that allow for correlated residuals, as those of a fit without networks do."""
    return autocorrelation_robust(jacobians, residuals, prior_precision=prior).std_error


def split(
    dataset: Dataset, names: Sequence[str] | None = None
) -> tuple[tuple[Record, ...], tuple[Record, ...]]:
    """Records to train on and to validate on.

    Named records validate, or those whose role it is. Without any the last fifth of the train records does (at least
    one), so that the test records stay unseen; with a single train record the test records have to.

    Raises:
        InputError: a name that is no record, or too few records.
    """
    train = list(dataset.train)
    if names is not None:
        known = [record.name for record in dataset]
        if unknown := [name for name in names if name not in known]:
            raise InputError(
                f"Record '{unknown[0]}' is not in dataset '{dataset.name}'{close_match(unknown[0], known)}; it has "
                f"{listed(known)}."
            )
        held = [dataset[name] for name in names]
        train = [record for record in train if record.name not in names]
    elif dataset.validation:
        held = list(dataset.validation)
    elif len(train) > 1:
        count = max(1, len(train) // 5)
        train, held = train[:-count], train[-count:]
    else:
        held = list(dataset.test)
    if not train or not held:
        raise InputError(
            f"Dataset '{dataset.name}' has {len(dataset.train)} train and {len(dataset.test)} test records; a hybrid "
            "training needs one to train on and another one to validate on."
        )
    return tuple(train), tuple(held)


@dataclass(frozen=True, eq=False)
class NetworkRole:
    """One network along the records.

    Attributes:
        where: its place, ``joint1/motor``.
        unit: of its output.
        rms: of its output.
        share: RMS of its output over that of the motor's torque (at the link where the place is there) or command.
        variance_share: the same of the variances.
        overlap: projection coefficient in 0 ... 1: length of the part of the accelerations it causes that lies in the
            span of those of the physics alone to its estimated parameters, over the whole length.
        alike: the parameters to whose effects its own is most alike, with the cosine between them.
        worth: the change of the estimated parameters, by name, that comes nearest to the accelerations it causes: so
            much of each lies in the network.
        room: the change of each estimated parameter alone, by name, that would cause accelerations as large (RMS) as
            the network's.
        speed, angle, map: its output ``(n_speed, n_angle)`` against both, of the side where it acts; other inputs at
            their mean, hidden states at rest.
        seen: speed and angle at each tenth sample, ``(n, 2)``: where the records support the map.
    """

    where: str
    unit: str
    rms: float
    share: float
    variance_share: float
    overlap: float
    alike: tuple[tuple[str, float], ...]
    worth: dict[str, float]
    room: dict[str, float]
    speed: np.ndarray
    angle: np.ndarray
    map: np.ndarray
    seen: np.ndarray


def network_roles(system: System, engine: Engine, batch: Batch) -> tuple[NetworkRole, ...]:
    """What each network of a trained system does along the free runs of a batch."""
    run = simulate(system, engine, batch)
    used = ((batch.weight > 0).any(2) & torch.isfinite(run.x).all(2)).reshape(-1)
    x = [column.reshape(-1)[used] for column in run.x.unbind(2)]
    u = {name: channel.reshape(-1)[used] for name, channel in batch.u.items()}
    values = list(system.theta().detach().to(batch.x)[:, None])
    p, found = system.views(values), []
    accelerations = effects(system, engine.width, x, u, values)
    free = physical_names(system)
    empty = x[0].new_zeros(len(x[0]) * len(system.speed_rows), 0)
    physical = torch.stack([accelerations[name] for name in free], 1) if free else empty
    basis = span(physical)
    for name, place, part, networks in networks_of(system):
        joint = networks.joint
        with torch.no_grad():
            output = system.outputs([name], x, u, p)[0].expand_as(x[0])
            drive = joint.drive
            reference = drive.command(x, u, p, network=False)
            if place != "input":
                reference = drive.motor_torque(x, u, p, network=False)
            if place in (*LINK_PLACES, "transmission"):
                reference = joint.gear_ratio * reference
        caused = accelerations[f"b_0 {joint.name}/{place}"] * output.repeat(len(system.speed_rows))
        length, lengths = float(caused.norm()), physical.norm(dim=0)
        cosines = (physical.T @ caused / (lengths * length).clamp_min(1e-300)).abs()
        alike = sorted(zip(free, cosines.tolist(), strict=True), key=lambda pair: -pair[1])[:3]
        # the least change of the parameters that comes nearest to what the network causes
        size = lengths.clamp_min(1e-300)
        nearest = (torch.linalg.pinv(physical / size, rtol=1e-6) @ caused / size).tolist()
        with torch.no_grad():  # its output on a grid of speeds and angles
            at_link = place in LINK_PLACES
            angle, speed = (
                joint.link_motion(x, p) if at_link else (x[joint.positions[0]], x[joint.positions[0] + 1])
            )[:2]
            turn = 2.0 * torch.pi
            low, high = float(angle.min()), float(angle.max())
            if high - low > turn and not any(name == "angle" for name in part.inputs):
                low, high = 0.0, turn  # what knows the angle by its sine and cosine alone repeats itself
            reach = float(speed.abs().max())
            speeds = torch.linspace(-reach, reach, GRID, dtype=speed.dtype, device=speed.device)
            angles = torch.linspace(low, high, GRID, dtype=angle.dtype, device=speed.device)
            v, q = (grid.reshape(-1) for grid in torch.meshgrid(speeds, angles, indexing="ij"))
            signals = []
            for read, signal in zip(part.inputs, networks.signals(place, x, u, p)[0], strict=True):
                if match := HARMONIC.fullmatch(read):
                    signals.append((torch.sin if match[1] == "sin" else torch.cos)(float(match[2]) * q))
                elif read in ("angle", "speed", "direction"):
                    signals.append(q if read == "angle" else v)
                else:
                    signals.append(signal.mean().expand_as(q))
            rest = [torch.zeros_like(q)] * part.memory
            key = networks.by_place[place][0]
            on_grid = part.output(p[key], signals, rest).reshape(GRID, GRID)
            wrapped = angle if high - low != turn else angle % turn
            seen = torch.stack([speed, wrapped], 1)[::10]
        found.append(
            NetworkRole(
                f"{joint.name}/{place}", joint.drive.input[1].gives if place == "input" else "N m",
                float(output.square().mean().sqrt()),
                _ratio(output.square().mean().sqrt(), reference.square().mean().sqrt()),
                _ratio(output.var(), reference.var()),
                float((basis.T @ caused).norm()) / length if length > 0 else 0.0,
                tuple(alike), dict(zip(free, nearest, strict=True)),
                dict(zip(free, (length / lengths.clamp_min(1e-300)).tolist(), strict=True)),
                *(grid.cpu().numpy() for grid in (speeds, angles, on_grid, seen)),
            )
        )  # fmt: skip
    return tuple(found)


def _ratio(part: Tensor, whole: Tensor) -> float:
    return float(part / whole) if float(whole) > 0 else 0.0


def hybrid_residuals(dataset: Dataset, study: HybridStudy) -> dict[str, tuple[ResidualTest, ...]]:
    """What physics alone leaves (``physics``), and the chosen system where that is another one (``hybrid``)."""
    result = study.result
    models = {"physics": result.models[0].system} | ({"hybrid": result.system} if result.chosen else {})
    return {name: residual_tests(dataset, one, result.engine) for name, one in models.items()}
