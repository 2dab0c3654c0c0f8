"""Reference problem of the speed comparison: the paper's rigid link 1, ten records, one parameter set a record.

    J dv/dt = P_m1 (u - P_m2 v) - F(v) - f_3 v,        dq/dt = v                                 (3), (16)
    F(v) = (f_s1 + (f_s2 - f_s1) exp(-((|v| - f_s3) / f_s4)^2)) tanh(v / w),    s = 1 for v > 0, else 2     (15)

Motor side, SI units. Differs from the source by tanh(v / w), w = 0.5 rad/s, in place of the sign, so that every
peer (explicit RK4, any differentiation) can solve the same problem. F is continuous: where the level jumps
between the two directions, tanh is zero.

Records: 10 x 5000 samples at 500 Hz, a multisine within +-10 V held between samples, the motor's angle with
white noise of 0.5 % of its standard deviation. The truth is integrated at a tenth of the step that the fits use
(four RK4 steps a sample). Everything is fixed by `SEED`. Every record has a start of its own, each parameter up
to 50 % off. The start state of a record is free too.

A fit stops when its free run (RK4, four steps a sample) ends at most 1.05 times the noise floor and the next
Gauss-Newton step promises to lower the sum of squares by at most `DECREMENT` noise variances, which puts it within
0.3 standard errors of the optimum; 1.05 alone leaves room for estimates ten standard errors off. The twelve
parameters hold ten identifiable combinations (`combinations`), which must come out within three standard errors.

numpy only, so that every peer's environment can read it.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PARAMETERS = ("J", "P_m1", "P_m2", "f_11", "f_12", "f_13", "f_14", "f_21", "f_22", "f_23", "f_24", "f_3")
#: Table 2, best set; P_m1 is printed there in mN m/V.
TRUTH = np.array(
    [1.97e-5, 19.249e-3, 0.025, 0.010, 0.030, 10.541, 53.005, 0.010, 0.031, 11.313, 58.093, 5.04e-5]
)
COMBINATIONS = (
    "J/P_m1", "P_m2+f_3/P_m1", "f_11/P_m1", "f_12/P_m1", "f_13", "f_14", "f_21/P_m1", "f_22/P_m1", "f_23", "f_24"
)  # fmt: skip
SMOOTHING = 0.5  # rad/s, width of tanh
SAMPLE_TIME = 0.002  # s
SUB_STEPS = 4  # RK4 steps a sample: h |df/dv| = 1.5 at the truth, inside RK4's region of stability
N_RECORDS, N_SAMPLES = 10, 5000
AMPLITUDE = 10.0  # V
BASE_FREQUENCY = 0.1  # Hz, one period a record
TONES = np.arange(1, 41)  # its multiples: 0.1 ... 4 Hz
NOISE = 0.005  # of the angle's standard deviation
SPREAD = 0.5  # starts are drawn from truth x [1 - SPREAD, 1 + SPREAD]
STOP = 1.05  # x noise floor, of the free run's root mean square
DECREMENT = 0.1  # x noise variance: the fall of the sum of squares that the last linearisation still promises
BOUNDS = (0.1, 10.0)  # x Table 2, for peers that want bounds
SEED = 2013
CACHE = Path(__file__).resolve().parent / ".cache"


@dataclass(frozen=True, eq=False)
class Problem:
    """The records and starts, one row a record.

    Attributes:
        voltage: (R, T) V, held from sample k to k + 1.
        angle: (R, T) rad, measured at the samples.
        floor: (R,) rad, root mean square of the noise in each record.
        starts: (R, 12) start values, in the order of `PARAMETERS`.
        standard_errors: (R, 10) of `COMBINATIONS`, from the sensitivities at the truth.
    """

    voltage: Array
    angle: Array
    floor: Array
    starts: Array
    standard_errors: Array

    def head(self, n_records: int) -> Problem:
        """The first `n_records` records."""
        return Problem(*(getattr(self, name)[:n_records] for name in self.__dataclass_fields__))

    @property
    def n_records(self) -> int:
        return len(self.voltage)


@dataclass(frozen=True, eq=False)
class Estimate:
    """What a peer returns: parameters (R, 12), start state (R, 2) = (q, v), iterations (R,) or their total."""

    parameters: Array
    start_state: Array
    iterations: Array


def acceleration(v: Array, u: Array, theta: Array) -> Array:
    """dv/dt, rad/s^2, of lanes v (B,) with voltages u (B,) and parameters theta (12, B)."""
    inertia, p_m1, p_m2, f_11, f_12, f_13, f_14, f_21, f_22, f_23, f_24, f_3 = theta
    forward = v > 0
    base, peak = np.where(forward, f_11, f_21), np.where(forward, f_12, f_22)
    speed, width = np.where(forward, f_13, f_23), np.where(forward, f_14, f_24)
    level = base + (peak - base) * np.exp(-(((np.abs(v) - speed) / width) ** 2))
    return (p_m1 * (u - p_m2 * v) - level * np.tanh(v / SMOOTHING) - f_3 * v) / inertia


def simulate(voltage: Array, parameters: Array, start_state: Array, sub_steps: int = SUB_STEPS) -> Array:
    """Angles (B, T) of lanes with voltages (B, T), parameters (B, 12), start states (B, 2); classical RK4."""
    theta = np.ascontiguousarray(parameters.T)
    q, v = start_state.T
    h = SAMPLE_TIME / sub_steps
    angle = np.empty_like(voltage)
    for k, u in enumerate(voltage.T):
        angle[:, k] = q
        for _ in range(sub_steps):
            k1 = acceleration(v, u, theta)
            k2 = acceleration(v + 0.5 * h * k1, u, theta)
            k3 = acceleration(v + 0.5 * h * k2, u, theta)
            k4 = acceleration(v + h * k3, u, theta)
            q = q + h * (v + h / 6.0 * (k1 + k2 + k3))
            v = v + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return angle


def combinations(parameters: Array) -> Array:
    """(..., 10) identifiable combinations of parameters (..., 12), in the order of `COMBINATIONS`."""
    inertia, p_m1, p_m2, f_11, f_12, f_13, f_14, f_21, f_22, f_23, f_24, f_3 = np.moveaxis(parameters, -1, 0)
    levels = [f_11 / p_m1, f_12 / p_m1, f_13, f_14, f_21 / p_m1, f_22 / p_m1, f_23, f_24]
    return np.stack([inertia / p_m1, p_m2 + f_3 / p_m1, *levels], axis=-1)


def multisine(rng: np.random.Generator) -> Array:
    """(T,) V: equal tones with random phases (low speeds are met often), scaled to the amplitude limit."""
    time = SAMPLE_TIME * np.arange(N_SAMPLES)
    phase = rng.uniform(0.0, 2.0 * np.pi, len(TONES))
    signal = np.cos(2.0 * np.pi * BASE_FREQUENCY * TONES[:, None] * time + phase[:, None]).sum(axis=0)
    return AMPLITUDE * signal / np.abs(signal).max()


def standard_errors(voltage: Array, floor: Array) -> Array:
    """(R, 10) standard errors of the combinations at the truth, the start state estimated too.

    P_m1 and P_m2 are held, so that the other ten parameters are the combinations up to known factors
    (central differences of 1e-4 of each parameter; 1e-3 rad and rad/s of the start state).
    """
    free = [i for i, name in enumerate(PARAMETERS) if name not in ("P_m1", "P_m2")]
    n_free, n_records = len(free) + 2, len(voltage)
    point = np.concatenate([TRUTH, [0.0, 0.0]])
    step = np.concatenate([1e-4 * TRUTH, [1e-3, 1e-3]])
    lanes = np.tile(point, (2, n_free, 1))
    for column, i in enumerate([*free, 12, 13]):
        lanes[:, column, i] += [step[i], -step[i]]
    lanes = np.repeat(lanes.reshape(-1, 14), n_records, axis=0)
    angle = simulate(np.tile(voltage, (2 * n_free, 1)), lanes[:, :12], lanes[:, 12:])
    plus, minus = angle.reshape(2, n_free, n_records, -1)
    sensitivity = (plus - minus) / (2.0 * step[[*free, 12, 13]])[:, None, None]
    scale = np.concatenate([TRUTH[free], [1.0, 1.0]])
    errors = []
    for record in range(n_records):
        column = sensitivity[:, record] * scale[:, None]
        covariance = np.linalg.inv(column @ column.T) * floor[record] ** 2
        errors.append(np.sqrt(np.diag(covariance))[:10] * scale[:10])
    by_name = dict(zip([PARAMETERS[i] for i in free], np.array(errors).T, strict=True))
    torque = TRUTH[1]
    names = ("J", "f_3", "f_11", "f_12", "f_13", "f_14", "f_21", "f_22", "f_23", "f_24")
    divided = {"J", "f_3", "f_11", "f_12", "f_21", "f_22"}
    return np.stack([by_name[name] / (torque if name in divided else 1.0) for name in names], axis=-1)


def generate() -> Problem:
    """Makes the records (about half a minute)."""
    rng = np.random.default_rng(SEED)
    voltage = np.stack([multisine(rng) for _ in range(N_RECORDS)])
    truth = np.tile(TRUTH, (N_RECORDS, 1))
    clean = simulate(voltage, truth, np.zeros((N_RECORDS, 2)), sub_steps=10 * SUB_STEPS)
    noise = NOISE * clean.std(axis=1, keepdims=True) * rng.standard_normal(clean.shape)
    starts = truth * rng.uniform(1.0 - SPREAD, 1.0 + SPREAD, truth.shape)
    floor = np.sqrt((noise**2).mean(axis=1))
    return Problem(voltage, clean + noise, floor, starts, standard_errors(voltage, floor))


def load() -> Problem:
    """The reference problem, made once and kept in `.cache`."""
    path = CACHE / f"reference-{SEED}.npz"
    if not path.exists():
        CACHE.mkdir(exist_ok=True)
        problem = generate()
        part = path.with_suffix(f".{os.getpid()}.part.npz")
        np.savez(part, **{name: getattr(problem, name) for name in problem.__dataclass_fields__})
        part.replace(path)
    with np.load(path) as arrays:
        return Problem(**{name: arrays[name] for name in arrays.files})


@dataclass(frozen=True, eq=False)
class Score:
    """How well an estimate solves the problem: free-run error over the noise floor (R,), z scores (R, 10)."""

    cost_ratio: Array
    z: Array

    @property
    def solved(self) -> bool:
        return bool((self.cost_ratio <= STOP).all())


def score(problem: Problem, estimate: Estimate) -> Score:
    """Judges every peer by the same free run, whatever the peer says of itself."""
    residual = simulate(problem.voltage, estimate.parameters, estimate.start_state) - problem.angle
    ratio = np.sqrt((residual**2).mean(axis=1)) / problem.floor
    return Score(ratio, (combinations(estimate.parameters) - combinations(TRUTH)) / problem.standard_errors)
