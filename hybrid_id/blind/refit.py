"""Re-fit of a simulator to the records of a case, with the case's own physics and none of the package's.

Output error over whole records by Levenberg's and Marquardt's method. It may start from the truth, which a case knows,
so that a few steps find the optimum; derivatives are differences, and all perturbed machines run side by side.
"""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np

from hybrid_id.blind.campaign import SAMPLE_TIME, noise_std
from hybrid_id.blind.case import Case, Records, nrmse
from hybrid_id.blind.physics.bench import Plant, replay
from hybrid_id.blind.robots import Robot

ROUNDS = 12
"""Steps of the method, at most."""
ENOUGH = 1e-3
"""Relative fall of the cost below which it ends."""
STEP = 0.01
"""Relative change of a parameter for its derivative: large enough to be felt past stick and slip."""
DAMPINGS = (1e-4, 1e-2, 1e-1, 1.0, 10.0)
"""Dampings that are tried side by side, relative to the diagonal of the normal equations."""
SIGNAL_SHARE = 0.001
"""Added to the noise as a share of each signal, so that small errors of large signals weigh little."""

LOST = 1e6
"""Weighted error of a machine that diverged."""

Build = Callable[[Mapping[str, np.ndarray]], Plant]
"""From values (B,) of the free parameters to B machines side by side."""


@dataclass(frozen=True, eq=False)
class Refit:
    """What a simulator does on the records.

    Attributes:
        values: of its free parameters.
        train: weighted mean square error on the train records; 1 is the encoders' noise.
        test: normalised RMSE on the test records.
    """

    values: Mapping[str, float]
    train: float
    test: float


def refit_model(
    case: Case,
    records: Records,
    *,
    lacks: frozenset[str] | None = None,
    substeps: int = 1,
    rounds: int = ROUNDS,
) -> Refit:
    """Re-fit today's simulator of a case, without the effects.

    Args:
        case: of the records.
        records: what is fitted.
        lacks: parameters that it does without; by default those that the case's effects withhold.
        substeps: steps a sample.
        rounds: steps of the method.
    """
    robot = case.truth()
    if lacks is not None:
        robot = replace(robot, lacks=lacks)
    free = free_parameters(robot)

    def build(values: Mapping[str, np.ndarray]) -> Plant:
        return robot.with_values({**dict.fromkeys(robot.lacks, 0.0), **values}).assemble(substeps=substeps)

    return refit(
        build, {name: float(np.mean(robot.values[name])) for name in free}, case, records, rounds=rounds
    )


def nominal_error(case: Case, records: Records) -> float:
    """Normalised RMSE of today's simulator as it stands, on the test records."""
    given = {name: entry["nominal"] for name, entry in case.model["parameters"].items()}
    robot = case.truth().with_values(dict.fromkeys(case.truth().values, 0.0)).with_values(given)
    return Bench(case, records, lambda values: robot.assemble(substeps=1)).test_error({})


def free_parameters(robot: Robot) -> list[str]:
    """Parameters that records can tell: all but one torque constant (scale) and the motors' viscous frictions."""
    held = {robot.name(0, "P_m1"), *(robot.name(i, "F_v") for i in range(robot.joints))}
    return [
        name
        for name, value in robot.values.items()
        if name not in held | robot.lacks and np.all(np.asarray(value) > 0)
    ]


def refit(
    build: Build,
    start: Mapping[str, float],
    case: Case,
    records: Records,
    *,
    signed: Collection[str] = (),
    rounds: int = ROUNDS,
) -> Refit:
    """Fit parameters from a start to the train records.

    Args:
        build: machines of given values.
        start: values to start from.
        case: of the records.
        records: what is fitted.
        signed: names of those that may be negative; the others are positive and stepped on a logarithmic scale.
        rounds: steps of the method.
    """
    bench, names = Bench(case, records, build), list(start)
    scale = {name: abs(start[name]) or 1.0 for name in signed}
    theta = np.array([start[n] / scale[n] if n in scale else np.log(start[n]) for n in names])

    def point(rows: np.ndarray) -> dict[str, np.ndarray]:
        return {n: scale[n] * rows[:, i] if n in scale else np.exp(rows[:, i]) for i, n in enumerate(names)}

    best = np.inf
    for _ in range(rounds):
        residuals = bench.residuals(point(np.vstack([theta, theta + STEP * np.eye(len(names))])))
        base, jacobian = residuals[0], (residuals[1:] - residuals[0]).T / STEP
        best = float(np.mean(base**2))
        normal, right = jacobian.T @ jacobian, jacobian.T @ base
        if not np.trace(normal) > 0:  # lost: no parameter makes a difference
            break
        diagonal = np.diag(np.diag(normal)) + 1e-12 * np.trace(normal) * np.eye(len(names))
        tries = np.array([theta - np.linalg.solve(normal + d * diagonal, right) for d in DAMPINGS])
        tries = np.clip(tries, theta - 1.5, theta + 1.5)
        costs = np.mean(bench.residuals(point(tries)) ** 2, axis=1)
        winner = int(np.argmin(costs))
        gain = 1 - costs[winner] / best
        if gain > 0:
            theta, best = tries[winner], float(costs[winner])
        if gain < ENOUGH:
            break
    values = {name: float(value[0]) for name, value in point(theta[None]).items()}
    return Refit(values, best, bench.test_error({name: np.full(1, value) for name, value in values.items()}))


class Bench:
    """Replays of machines on the records of a case."""

    def __init__(self, case: Case, records: Records, build: Build) -> None:
        self.case, self.records, self.build = case, records, build
        campaign, joints = case.campaign, case.robot.joints
        self.lengths, self.link = campaign.lengths, campaign.encoders.link
        self.train = np.flatnonzero([role == "train" for role in campaign.roles[: len(self.lengths)]])
        self.test = np.setdiff1d(np.arange(len(self.lengths)), self.train)
        rest = records.measured[:50, :joints].mean(axis=0)
        self.start = rest / np.array(case.robot.ratio)[:, None]
        self.noise = noise_std(campaign.encoders)

    def residuals(self, values: Mapping[str, np.ndarray]) -> np.ndarray:
        """Weighted errors (K, N) of K parameter sets on the train records."""
        angles = self._replay(values, self.train)
        columns = []
        for i, b in enumerate(self.train):
            own = slice(None, self.lengths[b])
            measured = self.records.measured[own, :, b]
            weight = 1 / np.hypot(self.noise, SIGNAL_SHARE * measured.std(axis=0))
            error = (angles[own, :, :, i] - measured[:, :, None]) * weight[:, None]
            columns.append(error.reshape(-1, error.shape[-1]).T)
        return np.clip(np.nan_to_num(np.concatenate(columns, axis=1), nan=LOST), -LOST, LOST)

    def clean_error(self) -> np.ndarray:
        """Weighted errors (N,) of the machine that made the records, on the train records."""
        return self.residuals({})[0]

    def test_error(self, values: Mapping[str, np.ndarray]) -> float:
        """Normalised RMSE of one parameter set on the test records."""
        angles = self._replay(values, self.test)
        errors = [
            nrmse(angles[: self.lengths[b], :, 0, i], self.records.measured[: self.lengths[b], :, b])
            for i, b in enumerate(self.test)
        ]
        return float(np.mean(errors))

    def _replay(self, values: Mapping[str, np.ndarray], rows: np.ndarray) -> np.ndarray:
        """Angles (T, n_outputs, K, R) of K parameter sets on some records."""
        sets = max((len(value) for value in values.values()), default=1)
        plant = self.build({name: np.repeat(value, len(rows)) for name, value in values.items()})
        samples = int(self.lengths[rows].max())
        volts = np.tile(self.records.volts[:samples][..., rows], sets)
        start = np.tile(self.start[:, rows], sets)
        with np.errstate(all="ignore"):  # a machine that a bad step makes diverge costs much, which is all
            angles = replay(plant, volts, sample_time=SAMPLE_TIME, link=self.link, start=start)
        return angles.reshape(*angles.shape[:2], sets, len(rows))
