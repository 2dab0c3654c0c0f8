"""Which experiment would distinguish models that the records do not: of those simulated, the best."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from hybrid_id.components.input.position_servo import PositionServo
from hybrid_id.diagnosis.model import FittedModel
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.measures import DRIVES, estimate_noise
from hybrid_id.records.record import Record
from hybrid_id.records.units import stem
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.stability import with_substeps
from hybrid_id.systems.arm import MOTION
from hybrid_id.systems.chain import System
from hybrid_id.systems.joint import Joint

RESTING = (*DRIVES, *MOTION[1:])
"""Stems of the channels that are zero where a joint rests."""
DURATION = 8.0
"""Length [s] of a proposed record."""
REST = 0.1
"""Time [s] at rest at its start."""
BEYOND = 0.5
"""How far a robot's joint may go beyond where the records have been, over their range."""
LOOP, DAMPING = 3.0, 0.7
"""Frequency [Hz] and damping ratio of the position loop by which a robot's joint is thought to be moved, when it is
commanded in torque: its own controller is not known, but by torque alone it would fall."""
BY_CONTROLLER = " of goals for its own controller"
"""Added to the name of such an experiment."""
DISTINGUISHABLE = 0.5
"""Least RMS difference of two models' outputs, over the encoders' noise, from which a record distinguishes them."""

Signal = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class Experiment:
    """A proposed record.

    Attributes:
        name: what it is, in words.
        joint: whose command moves; the others rest.
        time: [s], ``(T,)``.
        inputs: all channels of the record, in SI units as the records hold them, ``(T,)`` each.
        channel: that of the command that moves; ``goal`` of a robot's joint that its records command in torque, which
            its own controller shall follow.
        start: outputs at which it begins, at rest.
        distance: RMS difference of the outputs of two such models, in units of the encoders' noise: the smallest of
            those pairs that the record distinguishes, or the largest where it distinguishes none.
        distance_now: the largest distance of these pairs on the records at hand.
        together: pairs of effects, ``name@where``, that it does not distinguish.
    """

    name: str
    joint: int
    time: np.ndarray
    inputs: Mapping[str, np.ndarray]
    channel: str
    start: Mapping[str, float]
    distance: float
    distance_now: float
    together: tuple[tuple[str, str], ...] = ()

    @property
    def command(self) -> np.ndarray:
        """Command of the moving joint, ``(T,)``."""
        return self.inputs[self.channel]

    @property
    def distinguishes(self) -> bool:
        """Whether its record would distinguish the models."""
        return self.distance >= DISTINGUISHABLE


def signals(amplitude: float, breakaway: float) -> dict[str, Signal]:
    """Commands that excite different effects, by their names.

    Args:
        amplitude: largest command that the records have seen.
        breakaway: command at which the joint begins to move.
    """
    low = min(1.6 * breakaway, 0.5 * amplitude)
    return {
        "slow reversals just above breakaway": lambda t: low * np.sin(2 * np.pi * 0.4 * t),
        "reversals of growing size": lambda t: amplitude * (t / t[-1]) * np.sin(2 * np.pi * 1.0 * t),
        "a fast sweep": lambda t: 0.6 * amplitude * np.sin(2 * np.pi * (0.5 * t + 1.8 * t**2)),
        "a staircase of both signs": lambda t: amplitude * np.round(4 * np.sin(2 * np.pi * 0.15 * t)) / 4,
        "full steps, coasting between them": lambda t: amplitude * np.sign(np.sin(2 * np.pi * 0.4 * t))
        * (np.sin(2 * np.pi * 0.8 * t) > 0),
        "small and fast on top of slow motion": lambda t: low * np.sin(2 * np.pi * 0.2 * t)
        + 0.25 * amplitude * np.sin(2 * np.pi * 6.0 * t),
    }  # fmt: skip


def next_experiment(dataset: Dataset, models: Sequence[FittedModel]) -> list[Experiment]:
    """Experiments that distinguish models, the best first; empty with fewer than two models.

    The best parts most pairs of them, and these most clearly: a bias and friction uneven by direction, say, move alike
    under any command, which is no reason not to part both from a spring. Each model keeps the parameters that the
    records gave it, so that the distance is what the next record will show.

    Args:
        dataset: its channels, amplitudes, noise and sample time.
        models: fitted models that explain the records alike.
    """
    if len(models) < 2:
        return []
    reference = dataset.train[0]
    noise = _noise(dataset)
    step = reference.sample_time
    time = np.arange(0.0, DURATION, step)
    moving = time >= REST
    found = []
    names = list(combinations(_names(models), 2))
    systems = [one.system for one in models]
    now = np.max(
        [_distances(_runs(record, systems, models, noise), noise) for record in dataset.train], axis=0
    )
    for joint in systems[0].joints:
        name = next(
            (f"{c}{joint.number}" for c in joint.channels if f"{c}{joint.number}" in reference.inputs), None
        )
        if name is None:
            continue
        name, moved = _by_controller(dataset, systems, joint, name)
        how = "" if name in reference.inputs else BY_CONTROLLER
        centre, amplitude = _room(dataset, joint, name)
        offered = signals(amplitude, 0.15 * amplitude).items()
        for (title, signal), (posture, angles) in product(offered, _postures(dataset).items()):
            command = centre + np.where(moving, signal(np.maximum(time - REST, 0.0)), 0.0)
            # a supply, a loop's gain and a switch stay as they were; the other joints and their drives rest
            inputs = {
                other: np.full_like(time, 0.0 if stem(other) in RESTING else float(np.median(values)))
                for other, values in reference.inputs.items()
            }
            inputs |= {other: np.full_like(time, angle) for other, angle in angles.items()} | {name: command}
            start = {other: float(values[0]) for other, values in reference.outputs.items()}
            outputs = {other: np.full_like(time, value) for other, value in start.items()}
            record = Record(name="proposed", time=time, inputs=inputs, outputs=outputs)
            runs = _runs(record, moved, models, noise)
            apart = _distances(runs, noise)
            if not np.isfinite(apart).all() or not _within_limits(dataset, systems[0], list(noise), runs):
                continue  # one of the models diverges under it, or leaves the joint's range
            distinguished = apart >= DISTINGUISHABLE
            shown = distinguished if distinguished.any() else apart == apart.max()
            found.append(
                Experiment(
                    title + how + posture, joint.number, time, inputs, name, start, float(apart[shown].min()),
                    float(now[shown].max()),
                    tuple(pair for pair, one in zip(names, distinguished, strict=True) if not one),
                )
            )  # fmt: skip
    return sorted(found, key=lambda e: (len(e.together), -e.distance))


def _by_controller(
    dataset: Dataset, systems: Sequence[System], joint: Joint, name: str
) -> tuple[str, Sequence[System]]:
    """The channel by which a joint is to be moved, and the systems with what follows it.

    A robot's joint that its records command in torque gets a position loop of :data:`LOOP`, of at most the torque that
    the records have seen, in place of that command; every other joint keeps its channel.
    """
    tree = systems[0].tree
    if tree is None or stem(name) != "tau":
        return name, systems
    torque = max(float(np.abs(record.inputs[name]).max()) for record in dataset.train)
    system = systems[0]
    rotor = sum(
        info.spec.value
        for info in system.table
        if info.component.startswith(f"{joint.name}/") and info.spec.unit == "kg m^2"
    )
    inertia = tree.at_zero[system.arm.seats[system.joints.index(joint)]] + rotor * joint.gear_ratio**2
    rate = 2.0 * np.pi * LOOP
    servo = PositionServo(k_p=inertia * rate**2, k_d=2.0 * DAMPING * inertia * rate, tau_max=torque)
    return f"goal{joint.number}", [one.with_component(f"{joint.name}/input", servo) for one in systems]


def _noise(dataset: Dataset) -> dict[str, float]:
    """Noise of each output, estimated from the train records where none is declared."""
    known = {channel.name: channel.noise_std for channel in dataset.outputs}
    return {
        name: std or float(np.median([estimate_noise(r.outputs[name]) for r in dataset.train])) or 1.0
        for name, std in known.items()
    }


def _room(dataset: Dataset, joint: Joint, name: str) -> tuple[float, float]:
    """Centre and amplitude of a command: a drive's around nothing, a goal's within what the records have reached."""
    if name in dataset.train[0].inputs:
        values = np.concatenate([record.inputs[name] for record in dataset.train])
    else:  # the goals were not logged: where the joint has been
        link, motor = f"q_a{joint.number}", f"q_m{joint.number}"
        values = np.concatenate([
            r.outputs[link] if link in r.outputs else r.outputs[motor] / joint.gear_ratio for r in dataset.train
        ])  # fmt: skip
    if stem(name) in DRIVES:
        return 0.0, float(np.abs(values).max())
    return float(values.max() + values.min()) / 2.0, float(np.ptp(values)) / 2.0


def _names(models: Sequence[FittedModel]) -> list[str]:
    """What each model has and not all of them, as ``name@where``."""
    common = set.intersection(*(set(e.effects) for e in models))
    return [" and ".join("@".join(n) for n in e.effects if n not in common) for e in models]


def _postures(dataset: Dataset) -> dict[str, dict[str, float]]:
    """Angles at which the other joints of a robot rest, by words for them; one posture without any elsewhere."""
    names = [c.name for c in dataset.inputs if stem(c.name) == MOTION[0]]
    if not names:
        return {"": {}}
    reached = {name: np.concatenate([record.inputs[name] for record in dataset.train]) for name in names}
    return {
        f", the other joints at the {words} of what they have reached": {
            name: float(np.quantile(values, share)) for name, values in reached.items()
        }
        for words, share in (("middle", 0.5), ("low end", 0.1), ("high end", 0.9))
    }


def _within_limits(
    dataset: Dataset, system: System, names: Sequence[str], runs: Sequence[np.ndarray]
) -> bool:
    """Whether a robot's joints stay near where the records have been, and inside their limits but for where they were.

    A command in torque takes a joint far in a few seconds, and nobody has said that there is room.
    """
    if system.tree is None:
        return True
    for column, name in enumerate(names):
        joint = next((j for j in system.joints if name in (f"q_m{j.number}", f"q_a{j.number}")), None)
        if joint is None:
            continue
        ratio = joint.gear_ratio if name.startswith("q_m") else 1.0
        limits = system.tree.joints[system.arm.seats[system.joints.index(joint)]].limits
        been = np.concatenate([r.outputs[name] for r in dataset.train if name in r.outputs])
        low, high = sorted(limit * ratio for limit in limits)
        near = BEYOND * float(np.ptp(been))
        low = max(been.min() - near, min(low, been.min()))
        high = min(been.max() + near, max(high, been.max()))
        if any(run[..., column].min() < low or run[..., column].max() > high for run in runs):
            return False
    return True


def _runs(
    record: Record, systems: Sequence[System], models: Sequence[FittedModel], noise: Mapping[str, float]
) -> list[np.ndarray]:
    """Outputs of every system on a record, ``(1, T, outputs)`` each, with its model's engine."""
    runs = []
    for system, model in zip(systems, models, strict=True):
        batch = make_batch(system, [record], outputs=list(noise), noise_std=noise)
        fine = with_substeps(system, model.result.engine, batch)
        runs.append(simulate(system, fine, batch).y.numpy())
    return runs


def _distances(runs: Sequence[np.ndarray], noise: Mapping[str, float]) -> np.ndarray:
    """RMS difference between the outputs of every two models ``(pairs,)``, in units of the noise."""
    scale = np.array(list(noise.values()))
    return np.array([np.sqrt(np.mean(np.square((a - b) / scale))) for a, b in combinations(runs, 2)])
