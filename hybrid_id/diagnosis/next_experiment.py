"""Which records would distinguish models that the records at hand do not: of those simulated, the best few.

What two models' outputs differ by under a command says little, for with the new records both are fitted anew: what
their parameters can follow distinguishes nothing. So the models are linearised where they are, and what counts is the
difference that is left when one has moved to what the other does, as far as the records at hand let it (T-optimal
design: A. C. Atkinson, V. V. Fedorov, The design of experiments for discriminating between two rival models, Biometrika
62, 1975). Free runs are as long as those of the fits: of a joint that is commanded in torque, its own controller hides
the difference in the motion, and the logged torque shows it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import combinations

import numpy as np
import torch

from hybrid_id.components.input.position_servo import PositionServo
from hybrid_id.diagnosis.model import FittedModel
from hybrid_id.identification.horizons import WHOLE, Horizon
from hybrid_id.identification.least_squares import reduced
from hybrid_id.identification.objective import Loss, evaluate
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.measures import DRIVES, sensor_noise
from hybrid_id.records.record import Record
from hybrid_id.records.units import stem
from hybrid_id.simulation.batch import Batch
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
RECORDS = 8
"""Records that are proposed at most. Where structure remains records are the witnesses: beside N that say nothing, k
that agree reach Student's t of ``sqrt((N + k) k / N)``, and with four beside four that is no distinction yet."""
STROKE = 1.0
"""Length [s] of the windows that stand for strokes."""
BEYOND = 0.5
"""How far a robot's joint may go beyond where the records have been, over their range."""
LOOP, DAMPING = 3.0, 0.7
"""Frequency [Hz] and damping ratio of the position loop by which a robot's joint is thought to be moved, when it is
commanded in torque: its own controller is not known, but by torque alone it would fall."""
DISTINGUISHABLE = 0.5
"""Least RMS difference of two models' outputs, over the errors that they leave, from which records distinguish them."""

Signal = Callable[[np.ndarray], np.ndarray]
Pair = tuple[int, int]


@dataclass(frozen=True, eq=False)
class Experiment:
    """A proposed record.

    Attributes:
        name: what is commanded, in words.
        posture: where the robot's other joints rest in what they have reached, in words; empty elsewhere.
        joint: whose command moves; the others rest.
        time: [s], ``(T,)``.
        inputs: all channels of the record, in SI units as the records hold them, ``(T,)`` each.
        channel: that of the command that moves; ``goal`` of a robot's joint that its records command in torque, which
            its own controller shall follow.
        start: outputs at which it begins, at rest.
        distance: RMS difference of the outputs of two such models in this record and those proposed before it, both
            fitted anew to all records, over the errors that they leave on the records at hand (the encoders' noise at
            least): of those pairs that these records distinguish the smallest, or the largest where they distinguish
            none.
        undistinguished: pairs of effects, ``name@where``, that they do not distinguish.
        by_controller: whether the joint's own controller has to follow the goal, in place of the torque that is logged.
    """

    name: str
    posture: str
    joint: int
    time: np.ndarray
    inputs: Mapping[str, np.ndarray]
    channel: str
    start: Mapping[str, float]
    distance: float = 0.0
    undistinguished: tuple[tuple[str, str], ...] = ()
    by_controller: bool = False

    @property
    def command(self) -> np.ndarray:
        """Command of the moving joint, ``(T,)``."""
        return self.inputs[self.channel]

    @property
    def distinguishes(self) -> bool:
        """Whether its record, with those before it, would distinguish the models."""
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
        "slowly through the whole range": lambda t: amplitude * np.sin(2 * np.pi * 0.125 * t),
        "reversals of growing size": lambda t: amplitude * (t / t[-1]) * np.sin(2 * np.pi * 1.0 * t),
        "a fast sweep": lambda t: 0.6 * amplitude * np.sin(2 * np.pi * (0.5 * t + 1.8 * t**2)),
        "a staircase of both signs": lambda t: amplitude * np.round(4 * np.sin(2 * np.pi * 0.15 * t)) / 4,
        "full steps, coasting between them": lambda t: amplitude * np.sign(np.sin(2 * np.pi * 0.4 * t))
        * (np.sin(2 * np.pi * 0.8 * t) > 0),
        "small and fast on top of slow motion": lambda t: low * np.sin(2 * np.pi * 0.2 * t)
        + 0.25 * amplitude * np.sin(2 * np.pi * 6.0 * t),
    }  # fmt: skip


def next_experiment(
    dataset: Dataset,
    tied: Sequence[Sequence[FittedModel]],
    horizon: Horizon = WHOLE,
    *,
    thinned: float = 1.0,
) -> list[Experiment]:
    """Records that together distinguish models, each the one that adds most to those before it; empty without a tie.

    What counts is how clearly every pair of them is distinguished that any record distinguishes: a bias and friction
    uneven by direction, say, move alike under any command, which is no reason not to distinguish both from a spring.

    Args:
        dataset: its channels, amplitudes, noise and sample time.
        tied: groups of fitted models that explain the records alike.
        horizon: how long free runs of their fits are; strokes, which depend on the model, count as windows.
        thinned: sample time of the records that they were fitted to, over that of the dataset.
    """
    if horizon.kind == "strokes":
        horizon = Horizon("windows", STROKE)
    models = [one for group in tied for one in group]
    if not models:
        return []
    groups = np.repeat(np.arange(len(tied)), [len(group) for group in tied])
    pairs = [(a, b) for a, b in combinations(range(len(models)), 2) if groups[a] == groups[b]]
    noise = {name: std or 1.0 for name, std in sensor_noise(dataset).items()}
    offers, every = list[Experiment](), list[dict[Pair, _Differences]]()
    for joint in models[0].system.joints:
        here = _offered(dataset, models[0].system, joint)
        if here is not None:
            able, logged = _simulated(dataset, models, here, noise)
            if able:
                offers += able
                every.append(_differences(dataset.signal_share, models, pairs, logged, noise, horizon))
    if not offers:
        return []
    names = [name for group in tied for name in _names(group)]
    # the records in the order in which they add most, each with what it and those before it distinguish
    columns = [field.name for field in fields(_Differences)]
    found = {
        p: _Differences(*(np.concatenate([getattr(one[p], name) for one in every]) for name in columns))
        for p in every[0]
    }
    leaves = np.array([max(1.0, min(models[a].trained, models[b].trained)) for a, b in pairs])
    known = [thinned * _information(one) for one in models]

    def distances(rows: Sequence[int], *, outputs: bool = False) -> np.ndarray:
        """Of each pair, by the one of both that follows the other better."""
        squares = [
            min(found[one].after(rows, known[one[1]], outputs=outputs) for one in ((a, b), (b, a)))
            for a, b in pairs
        ]
        return np.sqrt(np.array(squares) / leaves)

    def worth(rows: Sequence[int]) -> float:
        # a pair that is distinguished already adds little: the others' turn
        return float(np.log1p(len(rows) * np.square(distances(rows))).sum())

    rows, result = list[int](), list[Experiment]()
    usable = np.flatnonzero(np.all([one.finite for one in found.values()], axis=0)).tolist()
    able = [k for k in usable if distances([k], outputs=True).max() >= DISTINGUISHABLE]
    able = able or usable  # a record that shows nothing by itself is no witness
    while len(rows) < min(RECORDS, len(able)):
        rows.append(max((k for k in able if k not in rows), key=lambda k: worth([*rows, k])))
        apart = distances(rows, outputs=True)
        clear = apart >= DISTINGUISHABLE
        shown = clear if clear.any() else apart == apart.max()
        alike = tuple((names[a], names[b]) for (a, b), one in zip(pairs, clear, strict=True) if not one)
        result.append(replace(offers[rows[-1]], distance=float(apart[shown].min()), undistinguished=alike))
    return result


# ---- what is offered ----


@dataclass(frozen=True)
class _Loop:
    """The position loop by which a robot's joint is thought to be moved, its torque [N m] at the joint."""

    k_p: float
    k_d: float
    most: float

    def torque(
        self, system: System, number: int, x: torch.Tensor, experiments: Sequence[Experiment]
    ) -> np.ndarray:
        """What the motor is told on the way ``x`` (R, T, n_x), ``(R, T)``: the joint's torque over the gear's ratio."""
        joint = system.joint(number)
        angle, speed = joint.link_motion(list(x.unbind(-1)), system.views(list(system.theta().detach())))
        goal = np.array([one.command for one in experiments])
        torque = self.k_p * (goal - angle.numpy()) - self.k_d * speed.numpy()
        return np.clip(torque, -self.most, self.most) / joint.gear_ratio

    def on(self, system: System, joint: Joint) -> System:
        servo = PositionServo(k_p=self.k_p, k_d=self.k_d, tau_max=self.most)
        return system.with_component(f"{joint.name}/input", servo)


@dataclass(frozen=True, eq=False)
class _Offer:
    """Experiments of one joint; the loop that moves it where its records command a torque; and what is commanded."""

    joint: Joint
    experiments: tuple[Experiment, ...]
    loop: _Loop | None
    logged: str


def _offered(dataset: Dataset, system: System, joint: Joint) -> _Offer | None:
    """Every command in every posture of the others; None for a joint that nothing commands, or a coupled gear's.

    Where such a gear's motor is, one joint's angle does not say.
    """
    if joint.motors:
        return None
    reference = dataset.train[0]
    logged = next(
        (f"{c}{joint.number}" for c in joint.channels if f"{c}{joint.number}" in reference.inputs), None
    )
    if logged is None:
        return None
    # that of a robot's joint which its records command in torque, of at most the torque that they have seen
    if system.tree is None or stem(logged) != "tau":
        loop = None
    else:
        rotor = sum(
            info.spec.value
            for info in system.table
            if info.component.startswith(f"{joint.name}/") and info.spec.unit == "kg m^2"
        )
        inertia = (
            system.tree.at_zero[system.arm.seats[system.joints.index(joint)]] + rotor * joint.gear_ratio**2
        )
        rate = 2.0 * np.pi * LOOP
        most = joint.gear_ratio * max(float(np.abs(record.inputs[logged]).max()) for record in dataset.train)
        loop = _Loop(inertia * rate**2, 2.0 * DAMPING * inertia * rate, most)
    channel = logged if loop is None else f"goal{joint.number}"
    time = np.arange(0.0, DURATION, reference.sample_time)
    # centre and amplitude of a command: a drive's around nothing, a goal's within what the records have reached
    if channel in dataset.train[0].inputs:
        values = np.concatenate([record.inputs[channel] for record in dataset.train])
    else:  # the goals were not logged: where the joint has been
        link, motor = f"q_a{joint.number}", f"q_m{joint.number}"
        values = np.concatenate(
            [
                r.outputs[link] if link in r.outputs else r.outputs[motor] / joint.gear_ratio
                for r in dataset.train
            ]
        )
    if stem(channel) in DRIVES:
        centre, amplitude = 0.0, float(np.abs(values).max())
    else:
        centre, amplitude = float(values.max() + values.min()) / 2.0, float(np.ptp(values)) / 2.0
    start = {name: float(values[0]) for name, values in reference.outputs.items()}
    if stem(channel) == "goal" and system.tree is not None:  # to where its goals begin it is moved before
        here = {f"q_a{joint.number}": centre, f"q_m{joint.number}": centre * joint.gear_ratio}
        start |= {name: angle for name, angle in here.items() if name in start}
    # a supply, a loop's gain and a switch stay as they were; the other joints and their drives rest
    rest = {
        name: np.full_like(time, 0.0 if stem(name) in RESTING else float(np.median(values)))
        for name, values in reference.inputs.items()
        if name != logged
    }
    found = []
    for title, signal in signals(amplitude, 0.15 * amplitude).items():
        command = centre + np.where(time >= REST, signal(np.maximum(time - REST, 0.0)), 0.0)
        for posture, angles in _postures(dataset).items():
            held = {name: np.full_like(time, angle) for name, angle in angles.items()}
            inputs = rest | held | {channel: command}
            found.append(
                Experiment(
                    title, posture, joint.number, time, inputs, channel, start, by_controller=loop is not None
                )
            )
    return _Offer(joint, tuple(found), loop, logged)


# ---- what each model does under it, and how far the others can follow ----


def _simulated(
    dataset: Dataset, models: Sequence[FittedModel], offer: _Offer, noise: Mapping[str, float]
) -> tuple[list[Experiment], list[list[Record]]]:
    """The experiments that no model leaves its range in, and by model their records, as they would be logged."""
    commanded = [
        Record(str(k), one.time, one.inputs, {n: np.full_like(one.time, v) for n, v in one.start.items()})
        for k, one in enumerate(offer.experiments)
    ]
    limits, able, logged = _limits(dataset, models[0].system), set(range(len(commanded))), []
    for model in models:
        system = model.system if offer.loop is None else offer.loop.on(model.system, offer.joint)
        batch = make_batch(system, commanded, outputs=list(noise), noise_std=noise)
        run = simulate(system, with_substeps(system, model.result.engine, batch), batch)
        seen = [dict(zip(noise, outputs.T.numpy(), strict=True)) for outputs in run.y]
        for k, outputs in enumerate(seen):
            for name, values in outputs.items():
                low, high = limits.get(name, (-np.inf, np.inf))
                if not (np.isfinite(values).all() and low <= values.min() and values.max() <= high):
                    able.discard(k)
        inputs = [one.inputs for one in commanded]
        if offer.loop is not None:
            tau = offer.loop.torque(system, offer.joint.number, run.x, offer.experiments)
            goal = offer.experiments[0].channel
            inputs = [
                {n: v for n, v in given.items() if n != goal} | {offer.logged: torque}
                for given, torque in zip(inputs, tau, strict=True)
            ]
        logged.append(
            [replace(r, inputs=i, outputs=o) for r, i, o in zip(commanded, inputs, seen, strict=True)]
        )
    kept = sorted(able)
    return [offer.experiments[k] for k in kept], [[records[k] for k in kept] for records in logged]


@dataclass(frozen=True, eq=False)
class _Differences:
    """What one model leaves of another's outputs, record by record: half of a quadratic in its parameters.

    Attributes:
        cost: weighted squared differences, its start states moved to fit, ``(R,)``.
        gradient, hessian: of half of it by its parameters, ``(R, n_f)`` and ``(R, n_f, n_f)``.
        count: measurements, ``(R,)``.
    """

    cost: np.ndarray
    gradient: np.ndarray
    hessian: np.ndarray
    count: np.ndarray

    def after(self, rows: Sequence[int], known: np.ndarray, *, outputs: bool = False) -> float:
        """Mean square over some records once the parameters have moved, held by what is known of them (n_f, n_f).

        With what that costs on the records at hand, which decides between the two models; or of the ``outputs`` alone.
        """
        rows = list(rows)
        gradient, hessian = self.gradient[rows].sum(0), self.hessian[rows].sum(0)
        size = np.diag(hessian + known)
        scale = np.sqrt(np.where(size > 1e-280, size, np.inf))  # what nothing depends on does not move
        matrix = ((hessian + known) / scale / scale[:, None]).clip(-1.0, 1.0)
        step = np.linalg.lstsq(matrix, gradient / scale, rcond=1e-9)[0] / scale
        left = self.cost[rows].sum() - float(step @ gradient)
        if outputs:
            left -= float(step @ known @ step)
        return max(float(left), 0.0) / float(self.count[rows].sum())

    @property
    def finite(self) -> np.ndarray:
        """Whether a record's differences are, ``(R,)``."""
        return (
            np.isfinite(self.cost) & np.isfinite(self.gradient).all(1) & np.isfinite(self.hessian).all((1, 2))
        )


def _differences(
    signal_share: float,
    models: Sequence[FittedModel],
    pairs: Sequence[Pair],
    logged: Sequence[Sequence[Record]],
    noise: Mapping[str, float],
    horizon: Horizon,
) -> dict[Pair, _Differences]:
    """By pair (who moves, who follows): both over the same free runs from the states that the first one's show."""
    found = {}
    for a, (mover, records) in enumerate(zip(models, logged, strict=True)):
        own = _pieces(signal_share, mover, records, noise, horizon)
        truth = simulate(mover.system, with_substeps(mover.system, mover.result.engine, own), own).y
        for b, other in enumerate(models):
            if (a, b) in pairs or (b, a) in pairs:
                batch = replace(_pieces(signal_share, other, records, noise, horizon), y=truth)
                # what the other leaves of these outputs, its start states moved within their uncertainty
                system, free, titles = other.system, other.system.estimated, [one.name for one in records]
                engine = with_substeps(system, other.result.engine, batch)
                theta = system.theta().detach()[:, None].expand(-1, batch.rows)
                at = evaluate(
                    system, engine, batch, batch.x, theta, free, loss=Loss(), chunk=batch.x.shape[1]
                )
                record = torch.tensor([titles.index(name) for name in batch.names])
                free_starts = torch.zeros(batch.rows, dtype=theta.dtype)
                held = torch.zeros_like(batch.x0_std)
                hessian, gradient, gain, _ = reduced(at, record, len(titles), free_starts, held)
                cost, count = gain.new_zeros(2, len(titles))
                cost.index_add_(0, record, at.cost)
                count.index_add_(0, record, (batch.weight > 0).sum((1, 2)).to(count.dtype))
                parts = 2.0 * (cost - gain), gradient, hessian, count
                found[a, b] = _Differences(*(part.numpy() for part in parts))
    return found


def _pieces(
    signal_share: float,
    model: FittedModel,
    records: Sequence[Record],
    noise: Mapping[str, float],
    horizon: Horizon,
) -> Batch:
    outputs = list(noise)
    batch = make_batch(model.system, records, outputs=outputs, noise_std=noise, signal_share=signal_share)
    return horizon.cut(model.system, model.result.engine, batch)


# ---- which of them together ----


def _information(model: FittedModel) -> np.ndarray:
    """What the records at hand say of a model's parameters, its priors with it, ``(n_f, n_f)``."""
    parts = [part.reshape(-1, part.shape[-1]) for part in model.result.jacobian]
    return sum((part.T @ part for part in parts), np.diag(model.result.prior_precision))


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
        words: {name: float(np.quantile(values, share)) for name, values in reached.items()}
        for words, share in (("middle", 0.5), ("low end", 0.1), ("high end", 0.9))
    }


def _limits(dataset: Dataset, system: System) -> dict[str, tuple[float, float]]:
    """By output how far a robot's joints may go: near where the records have been, inside their limits but for that.

    A command in torque takes a joint far in a few seconds, and nobody has said that there is room.
    """
    found: dict[str, tuple[float, float]] = {}
    if system.tree is None:
        return found
    for joint in system.joints:
        limits = system.tree.joints[system.arm.seats[system.joints.index(joint)]].limits
        for name, ratio in ((f"q_m{joint.number}", joint.gear_ratio), (f"q_a{joint.number}", 1.0)):
            seen = [r.outputs[name] for r in dataset.train if name in r.outputs]
            if seen:
                been = np.concatenate(seen)
                low, high = sorted(limit * ratio for limit in limits)
                near = BEYOND * float(np.ptp(been))
                found[name] = (
                    max(been.min() - near, min(low, been.min())),
                    min(been.max() + near, max(high, been.max())),
                )
    return found
