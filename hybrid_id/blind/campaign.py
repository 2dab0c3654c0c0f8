"""The experiments of a case: which signals, how large, with which controller and which disturbances."""

from dataclasses import dataclass, replace

import numpy as np

from hybrid_id.blind import signals
from hybrid_id.blind.physics.bench import Encoders, Program
from hybrid_id.blind.robots import Robot

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
    """

    program: Program
    encoders: Encoders
    lengths: np.ndarray
    notes: tuple[str, ...]
    roles: tuple[str, ...]

    def repeated(self, times: int) -> "Campaign":
        """The same records several times over, side by side."""

        def tile(values: np.ndarray) -> np.ndarray:
            return np.concatenate([values] * times, axis=-1)

        p, e = self.program, self.encoders
        program = Program(*(tile(v) for v in (p.feed, p.reference, p.kp, p.kd, p.ki, p.limit, p.disturbance)))
        flaws = e.flaws and replace(e.flaws, lost=tile(e.flaws.lost))
        encoders = Encoders(e.quantum, tile(e.jitter), e.link, flaws)
        return Campaign(
            program, encoders, np.tile(self.lengths, times), self.notes * times, self.roles * times
        )


def draw_campaign(
    rng: np.random.Generator,
    robot: Robot,
    *,
    coarse: float | None = None,
    lengths: tuple[int, int] | None = None,
) -> Campaign:
    """Plan six train and two test records.

    Args:
        rng: source of all that is random.
        robot: sets amplitudes, gains and limits.
        coarse: quantum of the rotor's encoder [rad]; drawn from 8 to 128 counts a turn by default.
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
    encoders = _encoders(rng, robot, samples, lanes, coarse)
    roles = ("train",) * len(train) + ("test",) * len(test)
    return Campaign(program, encoders, counts, tuple(NOTES[kind] for kind in kinds), roles)


def _voltage(rng: np.random.Generator, robot: Robot, joint: int, kind: str, time: np.ndarray) -> np.ndarray:
    """An open-loop voltage (T,) that moves the link by about 0.2 to 1.2 rad."""
    reach = rng.uniform(0.2, 1.0)
    wave = signals.multisine(rng, time) if kind == "MV" else signals.sweep(rng, time)
    damping = robot.value(joint, "P_m2") + robot.value(joint, "F_v") / robot.value(joint, "P_m1")
    inertia = robot.inertia(joint) / robot.value(joint, "P_m1")
    speed = np.zeros_like(time)  # of the linear machine for a unit signal
    for k in range(len(time) - 1):
        rate = (wave[k] - damping * speed[k]) / inertia
        speed[k + 1] = speed[k] + SAMPLE_TIME * rate / (1 + SAMPLE_TIME * damping / inertia)
    travel = np.ptp(np.cumsum(speed) * SAMPLE_TIME) / robot.ratio[joint]
    dry = robot.value(joint, "F_c") / robot.value(joint, "P_m1")
    if robot.vertical:
        dry += 0.5 * robot.values["G_l"] / robot.ratio[0] / robot.value(0, "P_m1")
    size = 2 * reach / travel + rng.uniform(1.0, 1.6) * dry
    return np.clip(size * wave, -robot.supply, robot.supply)


def _reference(rng: np.random.Generator, robot: Robot, joint: int, kind: str, time: np.ndarray) -> np.ndarray:
    """A reference of the joint (T,) [rad] whose speed the motor can reach."""
    wave = {
        "MT": lambda: 0.5 * signals.multisine(rng, time, 0.1, rng.uniform(0.8, 2.0)),
        "TT": lambda: signals.trapezoid(rng, time),
        "PP": lambda: signals.pick_and_place(rng, time),
        "ST": lambda: signals.steps(rng, time),
        "SR": lambda: signals.slow_reversals(rng, time),
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
    wave = np.zeros_like(noise)
    for k in range(round(signals.RESTING / SAMPLE_TIME), len(time)):
        wave[k] = decay * wave[k - 1] + noise[k]
    return size * wave


def _encoders(
    rng: np.random.Generator, robot: Robot, samples: int, lanes: int, coarse: float | None
) -> Encoders:
    """Incremental encoders, jitter of a third to four fifths of a count."""
    count = coarse or 2 * np.pi / float(rng.choice([128, 64, 64, 64, 32, 16, 16, 8]))
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
