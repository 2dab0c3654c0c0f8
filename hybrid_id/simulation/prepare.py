"""From records to tensors: channels, sample times, measurements, weights, and a first guess of the states."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from hybrid_id.components.input.servo_integral import ServoIntegral
from hybrid_id.errors import InputError
from hybrid_id.records.dataset import SIGNAL_SHARE
from hybrid_id.records.derivatives import noise_level, smooth_derivatives
from hybrid_id.records.measures import noise_of, quantisation_step, rest_samples, spread_of
from hybrid_id.records.record import Record
from hybrid_id.records.units import stem
from hybrid_id.simulation.batch import Batch
from hybrid_id.systems.chain import Channels, System
from hybrid_id.systems.joint import Joint

RESTING = 5
"""Samples at rest from which on a record counts as one that starts at rest, and fewest samples of any record."""
START = RESTING - 1
"""Samples over which the acceleration at the start is taken, which a gear's deflection there follows from."""
LEAST = 0.1
"""Least standard deviation of a record's measurements, relative to the typical one of its dataset."""
STANDING = 10
"""Samples through which a joint stands where its servo holds it."""
TRIAL = 1e-4
"""What an integral is let gather [rad] to see what it moves."""
SMALLEST, LARGEST, HALVINGS = 1e-5, 2.0, 50
"""Twists [rad at the link] between which the balance is looked for, and steps of the bisection."""


def make_batch(
    system: System,
    records: Sequence[Record],
    *,
    outputs: Sequence[str] | None = None,
    noise_std: Mapping[str, float | None] | None = None,
    signal_share: float = SIGNAL_SHARE,
    estimate_start: bool = True,
    typical: Mapping[str, float] | None = None,
) -> Batch:
    """Prepare records for simulation and fitting.

    The start angle is the mean of the samples at rest; a record that starts in motion starts from a local polynomial.
    The side of a gear that nobody has measured starts at rest where the load has wound it up, bristles unloaded.

    Args:
        system: has channels and states.
        records: at least one; lengths and sample times may differ.
        outputs: outputs to compare (default: all that the first record has).
        noise_std: standard deviation of the noise by output; estimated from the record where it is None.
        signal_share: added to the noise as a share of the signal's standard deviation.
        estimate_start: whether a fit may move the start state within its uncertainty.
        typical: what :func:`typical_deviations` says of the dataset; of these records by default.

    Raises:
        InputError: no record, a channel that the system needs is missing, or a motor that takes no such command.
    """
    if not records:
        raise InputError("There is no record to simulate; give at least one.")
    for joint in system.joints:
        joint.drive.check()
    outputs = tuple(outputs if outputs is not None else records[0].outputs)
    for record in records:
        for name in system.input_names:
            if name not in record.inputs and name not in record.outputs:
                raise InputError(
                    f"{record.title} has no channel '{name}', which the model needs; "
                    "add it to the dataset or change the model's input."
                )
        for name in outputs:
            if name not in record.outputs:
                raise InputError(
                    f"{record.title} has no output '{name}' to compare with; it has {', '.join(record.outputs)}, so "
                    "choose among those."
                )
        if record.n_samples < RESTING:
            raise InputError(f"{record.title} has {record.n_samples} samples; give at least {RESTING}.")

    samples = max(record.n_samples for record in records)
    u = {name: _padded([r.signal(name) for r in records], samples) for name in system.input_names}
    u = system.arm.with_loads(u)
    for name in (f"enable{joint.number}" for joint in system.joints):
        if any(name in r.inputs for r in records):  # a motor without a switch is on
            u[name] = _padded([r.inputs.get(name, np.ones(r.n_samples)) for r in records], samples)
    shortest = min(record.sample_time for record in records)
    for joint in system.joints:  # past samples that a delay reaches back to, and the step [s] between them
        for name, lags in joint.drive.past(shortest).items():
            for k in range(1, lags + 1):
                signals = (r.signal(name) for r in records)
                past = [
                    np.concatenate([np.repeat(s[:1], min(k, len(s))), s[: max(len(s) - k, 0)]])
                    for s in signals
                ]
                u[f"{name}@{k}"] = _padded(past, samples)
            steps = [np.full(r.n_samples, r.sample_time) for r in records]
            u[f"step{joint.number}"] = _padded(steps, samples)
    dt = _padded([np.append(np.diff(record.time), 0.0) for record in records], samples, hold=False)
    y = torch.stack([_padded([record.outputs[name] for record in records], samples) for name in outputs], -1)

    # Where a joint stands, a record shows next to nothing of its sensor's noise and of what a good model misses: its
    # deviations are a tenth of the typical ones at least. For an output that never changes the typical one stands, or
    # that of an output of its kind, or 1.
    noises = [{name: _noise(record, name, noise_std) for name in record.outputs} for record in records]
    typical = typical or typical_deviations(records, noise_std=noise_std, signal_share=signal_share)
    usual, kinds = (
        np.array([typical.get(name, 0.0) for name in outputs]),
        np.array([stem(name) for name in outputs]),
    )
    alike = np.array([usual[kinds == kind].max() for kind in kinds])
    instead = np.where(usual > 0, usual, np.where(alike > 0, alike, 1.0))
    weight, guess, start_std = torch.zeros_like(y), [], []
    for row, (record, noise) in enumerate(zip(records, noises, strict=True)):
        shown = np.array([_deviation(record, name, noise[name], signal_share) for name in outputs])
        deviation = np.where(shown > 0, np.maximum(shown, LEAST * usual), instead)
        weight[row, : record.n_samples] = torch.tensor(1.0 / deviation)
        states, stds = _measured_states(system, record, noise)
        guess.append(states)
        start_std.append(stds if estimate_start else np.zeros_like(stds))
    x = torch.stack([_padded([g[:, i] for g in guess], samples) for i in range(len(system.state_names))], -1)
    x0_std = torch.tensor(np.array(start_std), dtype=torch.float64)
    _wind_up(system, records, x, x0_std, u)
    _begin_loops(system, records, x, x0_std, u, estimate_start)
    if estimate_start:
        _free_in_motion(system, records, x, x0_std, u)
    _start_sensor_states(system, x, u)
    return Batch(u, dt, y, weight, x, x0_std, outputs, tuple(record.name for record in records))


def typical_deviations(
    records: Sequence[Record],
    *,
    noise_std: Mapping[str, float | None] | None = None,
    signal_share: float = SIGNAL_SHARE,
) -> dict[str, float]:
    """Median over records of the standard deviation of each output's measurements; 0 where it changes in none.

    Args:
        records: of one dataset.
        noise_std: as for :func:`make_batch`.
        signal_share: as for :func:`make_batch`.
    """
    found = {}
    for name in records[0].outputs if records else ():
        each = [_deviation(r, name, _noise(r, name, noise_std), signal_share) for r in records]
        shown = [std for std in each if std > 0.0]
        found[name] = float(np.median(shown)) if shown else 0.0
    return found


def _deviation(record: Record, name: str, noise: float, signal_share: float) -> float:
    """Standard deviation of an output's measurements by one record alone; of values that are all the same the noise."""
    return float(np.hypot(noise, signal_share * spread_of(record, name)))


def _padded(rows: Sequence[np.ndarray], samples: int, hold: bool = True) -> Tensor:
    """Rows of different length as one tensor; the end repeats the last value (or is 0)."""
    ends = (np.full(samples - len(row), row[-1] if hold else 0.0, row.dtype) for row in rows)
    return torch.tensor(np.stack([np.concatenate(pair) for pair in zip(rows, ends, strict=True)]))


def _noise(record: Record, name: str, noise_std: Mapping[str, float | None] | None) -> float:
    given = (noise_std or {}).get(name)
    return noise_of(record, name) if given is None else float(given)


def _measured_states(
    system: System, record: Record, noise: Mapping[str, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Guess of all states (T, n_x) of one record, and the uncertainty of its first row (n_x,)."""
    states = np.zeros((record.n_samples, len(system.state_names)))
    stds = np.zeros(len(system.state_names))
    rest = rest_samples(record)
    for joint in system.joints:
        rotor = slice(joint.positions[0], joint.positions[0] + 2)
        states[:, rotor], stds[rotor] = _rotor_motion(joint, record, noise, rest)
        if joint.rigid:
            continue
        link, name = slice(joint.positions[1], joint.positions[1] + 2), f"q_a{joint.number}"
        if name in record.outputs:
            states[:, link], stds[link] = _motion(joint, record, name, noise, rest)
        else:
            states[:, link], stds[link] = states[:, rotor] / joint.gear_ratio, stds[rotor] / joint.gear_ratio
    return states, stds


@torch.no_grad()
def _wind_up(
    system: System, records: Sequence[Record], x: Tensor, x0_std: Tensor, u: Mapping[str, Tensor]
) -> None:
    """Put the hidden side of a gear where the load puts it at the start; a fit may move it as far.

    In motion that is known of a robot alone, whose description says what the links need.
    """
    sides = [joint.hidden_rows(records[0].outputs)[:1] for joint in system.joints]
    if not any(sides):
        return
    still = torch.tensor([rest_samples(record) >= RESTING for record in records])
    steps = torch.tensor([record.sample_time for record in records])
    first = {name: channel[:, 0] for name, channel in u.items()}
    for number, (joint, side) in enumerate(zip(system.joints, sides, strict=True)):
        if not side:
            continue
        (hidden,) = side
        begun = list(x[:, 0].unbind(1))
        needed = torch.zeros_like(x[:, 0, 0])
        if system.tree is not None:
            accelerations = [
                torch.where(still, 0.0, (x[:, START, row] - x[:, 0, row]) / (START * steps))
                for row in (joint.positions[-1] + 1 for joint in system.joints)
            ]
            torques = system.arm.needed(
                begun, accelerations, first, system.views(list(system.theta()[:, None]))
            )
            needed = torch.as_tensor(torques[number]).to(x).expand(len(records))
        twist = _loaded_twist(system, joint, begun, first, needed, still)
        if system.tree is None:
            twist = twist * still
        turn = twist if hidden == joint.positions[1] else -joint.gear_ratio * twist
        x[:, :, hidden] += turn[:, None]
        std = x0_std[:, hidden]
        x0_std[:, hidden] = torch.where(std > 0, torch.hypot(std, turn), std)


@torch.no_grad()
def _free_in_motion(
    system: System, records: Sequence[Record], x: Tensor, x0_std: Tensor, u: Mapping[str, Tensor]
) -> None:
    """Let a fit wind up a hidden side of a gear that begins in motion as far as the RMS of the motor's torque does.

    Nobody knows how the spring swings there; a gear that may begin anywhere explains whatever a short record lacks.
    """
    hidden = [(joint, rows) for joint in system.joints if (rows := joint.hidden_rows(records[0].outputs))]
    moving = [k for k, record in enumerate(records) if rest_samples(record) < RESTING] if hidden else []
    p, still = system.views(list(system.theta()[:, None])), torch.tensor([False])
    for k in moving:
        own = list(x[k, : records[k].n_samples].unbind(1))
        channels = {name: channel[k, : records[k].n_samples] for name, channel in u.items()}
        first = {name: channel[:1] for name, channel in channels.items()}
        for joint, rows in hidden:
            (key, motor), (rotor, link) = joint.drive.motor, joint.positions
            # of a winding that lags it is the torque before
            torque = motor.torque(p[key], joint.drive.command(own, channels, p), own[joint.drive.rotor + 1])
            needed = joint.gear_ratio * torch.as_tensor(torque).to(x).square().mean().sqrt().reshape(1)
            begun = [row[:1] for row in own]
            begun[link] = begun[rotor] / joint.gear_ratio
            ends = [_loaded_twist(system, joint, begun, first, sign * needed, still) for sign in (1.0, -1.0)]
            reach = 0.5 * (ends[0] - ends[1]).abs().squeeze()
            reach *= 1.0 if rows[0] == link else joint.gear_ratio
            angle, speed = own[rows[0]].std(), own[rows[0] + 1].std()
            spread = [reach, reach * speed / angle.clamp_min(1e-12)][: len(rows)]
            x0_std[k, rows] += torch.stack(spread) * (x0_std[k, rows] > 0)


def _stopped(system: System, x: Sequence[Tensor]) -> list[Tensor]:
    """State rows without speed."""
    return [torch.zeros_like(row) if k in system.speed_rows else row for k, row in enumerate(x)]


def _stands(joint: Joint, record: Record) -> bool:
    """Whether a record begins with a joint that stands still at a goal, which its servo may push against."""
    goal = record.signal(f"goal{joint.number}")[:STANDING]
    seen = (record.outputs[n] for n in (f"q_m{joint.number}", f"q_a{joint.number}") if n in record.outputs)
    moves = [
        np.ptp(angle[:STANDING]) > 6 * max(noise_level(angle), quantisation_step(angle)) for angle in seen
    ]
    return np.ptp(goal) == 0.0 and moves != [] and not any(moves)


@torch.no_grad()
def _begin_loops(
    system: System,
    records: Sequence[Record],
    x: Tensor,
    x0_std: Tensor,
    u: Mapping[str, Tensor],
    estimate_start: bool,
) -> None:
    """Put the states of position loops where a long time at the goal leaves them; integrals where they hold the load.

    What an integral has gathered before a record is not known beyond that: a fit may move it as far as friction could
    have held the joint as well, and of a record that begins in motion as far as the loop's errors go.
    """
    if not any(joint.drive.stages for joint in system.joints):
        return
    rows, samples = x.shape[:2]
    p = system.views(list(system.theta()[:, None]))
    flat = [column.reshape(-1) for column in x.unbind(2)]
    channels = {name: channel.reshape(-1) for name, channel in u.items()}
    for joint in system.joints:
        for row, values in joint.drive.starts(flat, channels, p).items():
            x[:, :, row] = values.reshape(rows, samples)
    first = list(x[:, 0].clone().unbind(1))
    held = {name: channel[:, 0] for name, channel in u.items()}
    zero = [torch.zeros_like(first[0])] * len(system.speed_rows)
    for joint in system.joints:
        for key, part, row in joint.drive.stages:
            if not isinstance(part, ServoIntegral):
                continue
            angle = x[:, :, joint.positions[0]]
            errors = (angle - angle.mean(1, keepdim=True)).std(1) / joint.gear_ratio
            number = system.speed_rows.index(joint.positions[0] + 1)
            balance = system.balances(_stopped(system, first), held, p, zero, zero).speeds[number]
            pulls = []
            for gathered in (0.0, TRIAL):
                first[row] = torch.full_like(first[row], gathered)
                pulls.append(joint.drive.torque(_stopped(system, first), held, p))
            first[row] = torch.zeros_like(first[row])
            slope, limit = (pulls[1] - pulls[0]) / TRIAL, p[key].z_max
            able = torch.tensor([_stands(joint, record) for record in records]) & (slope > 0)
            slope = torch.where(able, slope, torch.ones_like(slope))
            found = torch.minimum(torch.maximum(-balance.smooth / slope, -limit), limit)
            x[:, :, row] = torch.where(able, found, torch.zeros_like(found))[:, None]
            if estimate_start:
                around = torch.minimum(balance.level / slope + 0.1 * found.abs(), limit)
                x0_std[:, row] = torch.where(able, around, torch.minimum(errors, limit))


@torch.no_grad()
def _start_sensor_states(system: System, x: Tensor, u: Mapping[str, Tensor]) -> None:
    """Let torque sensors that lag read the torques of the guess at once."""
    if not any(joint.sensing.lag for joint in system.joints):
        return
    rows = [column.reshape(-1) for column in x.unbind(2)]
    channels = {name: channel.reshape(-1) for name, channel in u.items()}
    torques = system.link_torques(rows, channels, system.views(list(system.theta()[:, None])))
    for joint in system.joints:
        if joint.sensing.lag is not None:
            x[:, :, joint.sensing.lag_row] = torques[joint.number].expand(len(rows[0])).reshape(x.shape[:2])


@torch.no_grad()
def _loaded_twist(
    system: System, joint: Joint, x: list[Tensor], u: Channels, needed: Tensor, still: Tensor
) -> Tensor:
    """Link angle less the rotor's over the ratio [rad], ``(B,)``, at which a joint's spring carries its load.

    0 where dry friction at the link can hold a load at rest, and where no twist carries it. Of an arm without a
    description only loads of the joint's own count, not what its links do to each other.

    Args:
        system: of the joint.
        joint: with a compliant gear.
        x: state rows, ``(B,)`` each, the link where the rotor is.
        u: channels, ``(B,)`` each.
        needed: torque that the link's motion in a robot's tree needs [N m], ``(B,)``.
        still: whether it is at rest, ``(B,)``.
    """
    nothing = torch.zeros_like(x[0])
    pulled = system.tree is not None or joint.loads or joint.logged or joint.gear.errors or needed.any()
    if not pulled:
        return nothing
    p = system.views(list(system.theta().to(x[0])[:, None]))
    link = joint.positions[1]

    def pull(twist: Tensor) -> Tensor:
        """Torque on the link that twists it further."""
        rows = list(x)
        rows[link] = x[link] + twist
        return joint.spring_torque(rows, p) - joint.load_torque(rows[link], nothing, u, p) - needed

    held = pull(nothing).abs() <= joint.dry_level("link_friction", p, nothing, nothing, x) + 1e-12
    held = held & still
    reach = torch.full_like(nothing, SMALLEST)
    while float(reach.max()) < LARGEST and bool(((pull(reach) > 0) | (pull(-reach) < 0)).any()):
        reach = 2.0 * reach
    carried = (pull(reach) <= 0) & (pull(-reach) >= 0) & ~held
    low, high = -reach, reach
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        further = pull(middle) > 0
        low, high = torch.where(further, middle, low), torch.where(further, high, middle)
    return torch.where(carried, 0.5 * (low + high), nothing)


def _rotor_motion(
    joint: Joint, record: Record, noise: Mapping[str, float], rest: int
) -> tuple[np.ndarray, np.ndarray]:
    """Angle and speed (T, 2) of a rotor from either side of its gear, and the uncertainty of the first sample (2,)."""
    n = joint.number
    sides = [f"q_m{n}", f"q_a{n}", f"v_m{n}", f"v_a{n}"]
    measured = [name for name in sides if name in record.outputs]
    linked = [one for one, _ in joint.links]
    for name in measured:
        if name[2] == "m":
            return _motion(joint, record, name, noise, rest)
        others = [f"{name[:3]}{one.number}" for one in linked]
        if all(other in record.outputs for other in others):
            each = [
                (*_motion(one, record, other, noise, rest), turns)
                for other, (one, turns) in zip(others, joint.links, strict=True)
            ]
            moved = sum(motion * turns for motion, _, turns in each)
            start_std = np.sqrt(sum((std * turns) ** 2 for _, std, turns in each))
            return np.asarray(moved), np.asarray(start_std)
    others = (
        f", the links' at joints {' and '.join(str(one.number) for one in linked)}" if joint.motors else ""
    )
    raise InputError(
        f"{record.title} measures neither angle nor speed of joint {n}; add {', '.join(sides)}{others}."
    )


def _motion(
    joint: Joint, record: Record, name: str, noise: Mapping[str, float], rest: int
) -> tuple[np.ndarray, np.ndarray]:
    """Angle and speed (T, 2) of one side from its output ``name``, and the uncertainty of the first sample (2,)."""
    steps = np.asarray(record.sample_time if record.is_uniform else record.time, float).tobytes()
    std, channel = noise[name], name.rstrip("0123456789")
    if name.startswith("v"):
        speed = _smooth(record.outputs[name].tobytes(), steps, std)[0].copy()
        turned = np.diff(record.time) * (speed[1:] + speed[:-1]) / 2.0
        angle, first = np.concatenate([[0.0], np.cumsum(turned)]), (0.0, std)
    else:
        # what the sensors read at the model's zero [rad], and whether a fit may move it
        sensors = [part for _, part in joint.sensing.sensors if part.channel == channel]
        zero = torch.zeros(
            (), dtype=torch.float64, device="cpu"
        )  # without dimensions it goes with every device
        with torch.no_grad():
            measured = record.outputs[name] - sum(part.read(part.view(), zero).item() for part in sensors)
        angle, speed = (signal.copy() for signal in _smooth(measured.tobytes(), steps, std))
        # at its end a cubic through nine samples, the smoothing's short window, has this slope's error
        first = std, std / record.sample_time
        if rest >= RESTING:
            # readings that stay on one count do not average: the angle lies anywhere within it
            count = quantisation_step(measured) / np.sqrt(12) if np.ptp(measured[:rest]) == 0.0 else 0.0
            angle[:rest], first = np.mean(measured[:rest]), (max(std / np.sqrt(rest), count), 0.0)
        if any(spec.estimate for part in sensors for spec in part.specs.values()):
            first = np.ptp(angle) + 1.0, first[1]
    if rest >= RESTING:
        speed[:rest], first = 0.0, (first[0], 0.0)
    return np.stack([angle, speed], 1), np.array(first)


@lru_cache(maxsize=64)
def _smooth(values: bytes, steps: bytes, std: float) -> tuple[np.ndarray, np.ndarray]:
    """Smoothed samples and their derivative: a search prepares the same records for hundreds of models."""
    stamps = np.frombuffer(steps)
    return smooth_derivatives(np.frombuffer(values), stamps if len(stamps) > 1 else float(stamps[0]), std)[:2]
