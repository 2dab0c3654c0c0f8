"""The experiments of a case: signals as engineers and robots command them, controllers, disturbances, encoders."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from hybrid_id.machines.physics.bench import Encoders, Program
from hybrid_id.machines.robots import Robot

RESTING = 0.1
"""Time at the start of each record without voltage [s]."""


def multisine(rng: np.random.Generator, time: np.ndarray, low: float = 0.15, high: float = 3.0) -> np.ndarray:
    """Sum of 8 to 14 sines of random phase between two frequencies [Hz], RMS 1, falling with frequency."""
    tones = rng.integers(8, 15)
    frequencies = np.exp(rng.uniform(np.log(low), np.log(high), tones))
    weights = frequencies ** -rng.uniform(0.0, 0.6)
    wave = np.sin(2 * np.pi * np.outer(time, frequencies) + rng.uniform(0, 2 * np.pi, tones)) @ weights
    return fade(time) * wave / np.sqrt(np.sum(weights**2) / 2)


def sweep(rng: np.random.Generator, time: np.ndarray) -> np.ndarray:
    """A sine whose frequency runs exponentially, up or down, between about 0.2 and 5 Hz; peak 1."""
    low, high = rng.uniform(0.15, 0.4), rng.uniform(2.5, 6.0)
    ends = (low, high) if rng.random() < 0.7 else (high, low)
    run = time / time[-1]
    frequency = ends[0] * (ends[1] / ends[0]) ** run
    phase = (
        2 * np.pi * np.concatenate([[0.0], np.cumsum(0.5 * (frequency[1:] + frequency[:-1]) * np.diff(time))])
    )
    return fade(time) * np.sin(phase)


def steps(rng: np.random.Generator, time: np.ndarray) -> np.ndarray:
    """Jumps to random levels within +-1 every 0.5 to 1.5 s."""
    level, wave, until = 0.0, np.zeros_like(time), RESTING
    for k, t in enumerate(time):
        if t >= until:
            until = t + rng.uniform(0.5, 1.5)
            level = _other(rng, level)
        wave[k] = level
    return wave


def trapezoid(rng: np.random.Generator, time: np.ndarray) -> np.ndarray:
    """Moves between random points within +-1 with a trapezoid of speed, and rests between them."""
    return _moves(rng, time, rest=(0.05, 0.5), cruise=rng.uniform(0.2, 0.6))


def pick_and_place(rng: np.random.Generator, time: np.ndarray) -> np.ndarray:
    """The same few points within +-1 again and again, quickly, with a rest at each: a robot at work."""
    points = rng.uniform(-1, 1, rng.integers(2, 5))
    points[np.argmax(np.abs(points))] /= np.max(np.abs(points))
    return _moves(rng, time, rest=(0.2, 0.4), cruise=0.1, points=points)


def slow_reversals(rng: np.random.Generator, time: np.ndarray) -> np.ndarray:
    """A slow sine or triangle between 0.1 and 0.4 Hz of changing size, peak about 1: many reversals near standstill."""
    frequency = rng.uniform(0.12, 0.45)
    angle = 2 * np.pi * frequency * np.maximum(time - RESTING, 0)
    wave = np.sin(angle) if rng.random() < 0.5 else 2 / np.pi * np.arcsin(np.sin(angle))
    if rng.random() < 0.4:
        wave = wave * (0.6 + 0.4 * np.cos(angle / rng.uniform(2, 5)))
    elif rng.random() < 0.5:
        wave = wave + 0.3 * np.sin(rng.uniform(2, 5) * angle)
    return wave


def fade(time: np.ndarray, length: float = 0.15) -> np.ndarray:
    """0 while at rest, then smoothly to 1 within `length` [s]."""
    run = np.clip((time - RESTING) / length, 0, 1)
    return run**2 * (3 - 2 * run)


def _other(rng: np.random.Generator, level: float) -> float:
    """A new level within +-1, at least 0.3 from the last."""
    while True:
        new = rng.uniform(-1, 1)
        if abs(new - level) > 0.3:
            return float(new)


def _moves(
    rng: np.random.Generator,
    time: np.ndarray,
    *,
    rest: tuple[float, float],
    cruise: float,
    points: np.ndarray | None = None,
) -> np.ndarray:
    """Point-to-point moves; `cruise` is the part of a move at full speed, the rest is spent on ramps."""
    at, start, wave, count = 0.0, RESTING, np.zeros_like(time), 0
    while start < time[-1]:
        goal = _other(rng, at) if points is None else float(points[count % len(points)])
        length = max(0.25, rng.uniform(0.5, 1.1) * abs(goal - at))
        run = np.clip((time - start) / length, 0, 1)
        ramp = 0.5 * (1 - cruise)
        peak = 1 / (1 - ramp)
        share = np.where(
            run < ramp,
            0.5 * peak / ramp * run**2,
            np.where(run > 1 - ramp, 1 - 0.5 * peak / ramp * (1 - run) ** 2, peak * (run - 0.5 * ramp)),
        )
        wave = np.where(time >= start, at + (goal - at) * share, wave)
        at, start, count = goal, start + length + rng.uniform(*rest), count + 1
    return wave


SAMPLE_TIME = 0.002
LENGTHS = (3000, 4500)
"""Shortest and longest record [samples]."""
PLANS = (
    "MV MV MT MT SR SR | TT SV",
    "MV SV MT TT SR SR | MV TT",
    "MV MV MV ST SR SR | MT SR",
    "MV MV TT TT SR MT | SR ST",
    "MV MV MT SR SR SV | TT ST",
    "MV SV MT PP SR TT | PP SR",
    "MV TT MT MT SR PP | SV SR",
)
"""Six train and two test records by their signals; each plan is met equally often."""
NOTES = {
    "MV": "multisine voltage",
    "SV": "sweep voltage",
    "MT": "multisine tracking",
    "TT": "trapezoid tracking",
    "ST": "step tracking",
    "PP": "pick and place",
    "SR": "slow reversals",
}


@dataclass(frozen=True, eq=False)
class Campaign:
    """Planned records of one robot, lanes last.

    Attributes:
        program: commands and controllers (T, n_joints, B).
        encoders: sensors with their noise.
        lengths: samples of each record (B,).
        notes: signal of each record.
        roles: train or test of each record.
        sample_time: [s].
    """

    program: Program
    encoders: Encoders
    lengths: np.ndarray
    notes: tuple[str, ...]
    roles: tuple[str, ...]
    sample_time: float = SAMPLE_TIME

    def repeated(self, times: int) -> "Campaign":
        """The same records several times over, side by side."""

        def tile(values: np.ndarray) -> np.ndarray:
            return np.concatenate([values] * times, axis=-1)

        p, e = self.program, self.encoders
        program = Program(*(tile(v) for v in (p.feed, p.reference, p.kp, p.kd, p.ki, p.limit, p.disturbance)))
        flaws = e.flaws and replace(e.flaws, lost=tile(e.flaws.lost))
        encoders = replace(e, jitter=tile(e.jitter), flaws=flaws)
        lengths, notes, roles = np.tile(self.lengths, times), self.notes * times, self.roles * times
        return replace(self, program=program, encoders=encoders, lengths=lengths, notes=notes, roles=roles)


def draw_campaign(
    rng: np.random.Generator,
    robot: Robot,
    *,
    lengths: tuple[int, int] | None = None,
) -> Campaign:
    """Plan six train and two test records.

    Args:
        rng: source of all that is random.
        robot: sets amplitudes, gains and limits.
        lengths: shortest and longest record [samples]; `LENGTHS` by default.
    """
    train, test = (part.split() for part in str(rng.choice(PLANS)).split("|"))
    kinds = [*train, *test]
    counts = rng.integers(*(lengths or LENGTHS), len(kinds))
    samples, joints, lanes = int(counts.max()), robot.joints, len(kinds)
    time = SAMPLE_TIME * np.arange(samples)
    feed, reference = np.zeros((samples, joints, lanes)), np.zeros((samples, joints, lanes))
    kp, kd, ki = (np.zeros((joints, lanes)) for _ in range(3))
    for b, kind in enumerate(kinds):
        for i in range(joints):
            if kind in ("MV", "SV"):
                feed[:, i, b] = _voltage(rng, robot, i, kind, time)
            else:
                reference[:, i, b] = robot.ratio[i] * _reference(rng, robot, i, kind, time)
                kp[i, b], kd[i, b], ki[i, b] = _gains(rng, robot, i)
    limit = np.full((joints, lanes), robot.supply)
    disturbance = np.stack([_torque(rng, robot, i, time, lanes) for i in range(joints)], axis=1)
    program = Program(feed, reference, kp, kd, ki, limit, disturbance)
    encoders = _encoders(rng, robot, samples, lanes)
    roles = ("train",) * len(train) + ("test",) * len(test)
    return Campaign(program, encoders, counts, tuple(NOTES[kind] for kind in kinds), roles)


def _voltage(rng: np.random.Generator, robot: Robot, joint: int, kind: str, time: np.ndarray) -> np.ndarray:
    """An open-loop voltage (T,) that moves the link by about 0.2 to 1.2 rad."""
    reach = rng.uniform(0.2, 1.0)
    wave = multisine(rng, time) if kind == "MV" else sweep(rng, time)
    damping = robot.value(joint, "P_m2") + robot.value(joint, "F_v") / robot.value(joint, "P_m1")
    inertia = robot.inertia(joint) / robot.value(joint, "P_m1")
    slowed = inertia / SAMPLE_TIME + damping
    # speed of the linear machine for a unit signal
    speed = lfilter([0.0, 1 / slowed], [1.0, damping / slowed - 1], wave)
    travel = np.ptp(np.cumsum(speed) * SAMPLE_TIME) / robot.ratio[joint]
    dry = robot.value(joint, "F_c") / robot.value(joint, "P_m1")
    if robot.vertical:
        dry += 0.5 * robot.values["G_l"] / robot.ratio[0] / robot.value(0, "P_m1")
    size = 2 * reach / travel + rng.uniform(1.0, 1.6) * dry
    return np.clip(size * wave, -robot.supply, robot.supply)


def _reference(rng: np.random.Generator, robot: Robot, joint: int, kind: str, time: np.ndarray) -> np.ndarray:
    """A reference of the joint (T,) [rad] whose speed the motor can reach."""
    wave = {
        "MT": lambda: 0.5 * multisine(rng, time, 0.1, rng.uniform(0.8, 2.0)),
        "TT": lambda: trapezoid(rng, time),
        "PP": lambda: pick_and_place(rng, time),
        "ST": lambda: steps(rng, time),
        "SR": lambda: slow_reversals(rng, time),
    }[kind]()
    size = rng.uniform(0.08, 0.9) if kind == "SR" else rng.uniform(0.3, 1.4)
    if kind != "ST":
        fastest = robot.supply / robot.value(joint, "P_m2") / robot.ratio[joint]
        size = min(size, 0.6 * fastest / np.abs(np.gradient(wave, SAMPLE_TIME)).max())
    return size * wave


def _gains(rng: np.random.Generator, robot: Robot, joint: int) -> tuple[float, float, float]:
    """Gains of a PD or PID controller for a bandwidth of 8 to 20 rad/s with good damping."""
    inertia = robot.inertia(joint) / robot.value(joint, "P_m1")
    damping = robot.value(joint, "P_m2") + robot.value(joint, "F_v") / robot.value(joint, "P_m1")
    band = rng.uniform(8, 20)
    if robot.system == "one_link_flexible":  # below the resonance
        band = min(band, 0.6 * float(np.sqrt(robot.values["k"] / robot.values["J_a"])))
    kp = inertia * band**2 + (0.2 * damping * band)
    kd = max(2 * rng.uniform(0.7, 1.0) * inertia * band - damping, 0.0)
    ki = kp * rng.uniform(0.3, 1.5) if rng.random() < 0.3 else 0.0
    return kp, kd, ki


def _torque(rng: np.random.Generator, robot: Robot, joint: int, time: np.ndarray, lanes: int) -> np.ndarray:
    """Small random torque (T, B) on a rotor: low-passed noise, some ten thousandths of the stall torque."""
    size = robot.value(joint, "P_m1") * robot.supply * rng.uniform(1e-4, 6e-4)
    corner = rng.uniform(5, 40)
    decay = np.exp(-corner * SAMPLE_TIME)
    noise = rng.standard_normal((len(time), lanes)) * np.sqrt(1 - decay**2)
    noise[: round(RESTING / SAMPLE_TIME)] = 0.0
    return size * lfilter([1.0], [1.0, -decay], noise, axis=0)


def _encoders(rng: np.random.Generator, robot: Robot, samples: int, lanes: int) -> Encoders:
    """Incremental encoders of 8 to 128 counts a turn, jitter of a third to four fifths of a count."""
    count = 2 * np.pi / float(rng.choice([128, 64, 64, 64, 32, 16, 16, 8]))
    quantum = [count] * robot.joints
    if robot.link_encoder:
        quantum.append(2 * np.pi / float(rng.choice([1024, 2048, 4096])))
    jitter = np.array(quantum) * rng.uniform(0.3, 0.8, len(quantum))
    noise = rng.standard_normal((samples, len(quantum), lanes)) * jitter[:, None]
    return Encoders(np.array(quantum), noise, robot.link_encoder)


def noise_std(encoders: Encoders) -> np.ndarray:
    """Standard deviation (n_outputs,) of what encoders add: jitter and rounding [rad]."""
    jitter = encoders.jitter.std(axis=(0, 2))
    return np.sqrt(jitter**2 + encoders.quantum**2 / 12)
