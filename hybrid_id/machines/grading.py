"""Re-fit of a simulator to the records of a case, with the case's own physics and none of the package's.

Output error over whole records by Levenberg's and Marquardt's method. It may start from the truth, which a case knows,
so that a few steps find the optimum; derivatives are differences, and all perturbed machines run side by side, those of
several starts too.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hybrid_id.errors import InputError
from hybrid_id.machines.case import Case, Records, build, nrmse, record, record_sizes
from hybrid_id.machines.experiments import SAMPLE_TIME, noise_std
from hybrid_id.machines.physics.bench import Plant, replay
from hybrid_id.machines.robots import Robot

ROUNDS = 30
"""Steps of the method, at most."""
APART = 1.25
"""Factor by which two of the starts of a re-fit lie off the true values, every second parameter up, the others down."""
ENOUGH = 1e-4
"""Relative fall of the cost below which it ends."""
TRIAL, BEHIND = 4, 2.0
"""Steps after which a start is given up that is still so many times the best one's mean square error."""
STEP = 0.01
"""Relative change of a parameter for its derivative: large enough to be felt past stick and slip."""
DAMPINGS = (1e-4, 1e-2, 1e-1, 1.0, 10.0, 100.0)
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
    rounds: int | None = None,
) -> Refit:
    """Re-fit the nominal model of a case, without the effects, from several starts; the least error counts.

    Args:
        case: of the records.
        records: what is fitted.
        rounds: steps of the method from the true values alone, for a quick look.
    """
    robot = case.truth()

    def build(values: Mapping[str, np.ndarray]) -> Plant:
        return robot.with_values({**dict.fromkeys(robot.lacks, 0.0), **values}).assemble(substeps=1)

    true = true_values(robot, free_parameters(robot))
    if rounds is not None:
        return refit(build, [true], case, records, rounds=rounds)[0]
    given = case.model.get("parameters", {})
    starts = [true, {n: float(given[n]["nominal"] or v) if n in given else v for n, v in true.items()}]
    for turn in (0, 1):
        starts.append({n: v * APART ** (1 - 2 * ((i + turn) % 2)) for i, (n, v) in enumerate(true.items())})
    return min(refit(build, starts, case, records), key=lambda one: one.train)


def nominal_error(case: Case, records: Records) -> float:
    """Normalised RMSE of the nominal model as it stands, on the test records."""
    given = {name: entry["nominal"] for name, entry in case.model["parameters"].items()}
    robot = case.truth().with_values(dict.fromkeys(case.truth().values, 0.0)).with_values(given)
    return float(Bench(case, records, lambda values: robot.assemble(substeps=1)).test_errors({})[0])


def true_values(robot: Robot, names: Collection[str]) -> dict[str, float]:
    """Values of a robot's parameters, each as one number."""
    return {name: float(np.mean(robot.values[name])) for name in names}


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
    starts: Sequence[Mapping[str, float]],
    case: Case,
    records: Records,
    *,
    signed: Collection[str] = (),
    held: Sequence[Mapping[str, float]] | None = None,
    rounds: int = ROUNDS,
) -> list[Refit]:
    """Fit parameters from several starts to the train records, each on its own until it stays behind.

    Args:
        build: machines of given values.
        starts: values to start from, alike in their names.
        case: of the records.
        records: what is fitted.
        signed: names of those that may be negative; the others are positive and stepped on a logarithmic scale.
        held: further values of each start, which stay.
        rounds: steps of the method.
    """
    bench, names = Bench(case, records, build), list(starts[0])
    scale = np.array([[abs(start[n]) or 1.0 if n in signed else 1.0 for n in names] for start in starts])
    theta = (
        np.array([[start[n] if n in signed else np.log(start[n]) for n in names] for start in starts]) / scale
    )
    is_signed, fixed = np.array([n in signed for n in names]), held or [{} for _ in starts]

    def point(rows: np.ndarray, owner: np.ndarray) -> dict[str, np.ndarray]:
        own = rows * scale[owner]
        values = np.where(is_signed, own, np.exp(np.where(is_signed, 0.0, own)))
        given = {n: values[:, i] for i, n in enumerate(names)}
        return given | {n: np.array([fixed[k][n] for k in owner]) for n in fixed[0]}

    best, running, size = np.full(len(starts), np.inf), np.arange(len(starts)), len(names)
    for done in range(rounds):
        around = theta[running, None] + STEP * np.vstack([np.zeros(size), np.eye(size)])
        owner = np.repeat(running, size + 1)
        residuals = bench.residuals(point(around.reshape(-1, size), owner)).reshape(
            len(running), size + 1, -1
        )
        tries = {}
        for k, (base, *moved) in zip(running, residuals, strict=True):
            jacobian = (np.array(moved) - base).T / STEP
            best[k] = float(np.mean(base**2))
            normal, right = jacobian.T @ jacobian, jacobian.T @ base
            if np.trace(normal) > 0:  # else lost: no parameter makes a difference
                diagonal = np.diag(np.diag(normal)) + 1e-12 * np.trace(normal) * np.eye(size)
                steps = [np.linalg.solve(normal + d * diagonal, right) for d in DAMPINGS]
                tries[k] = np.clip(theta[k] - steps, theta[k] - 1.5, theta[k] + 1.5)
        if not tries:
            break
        owner = np.repeat(list(tries), len(DAMPINGS))
        costs = np.mean(bench.residuals(point(np.vstack(list(tries.values())), owner)) ** 2, axis=1)
        gains = {}
        for k, own in zip(tries, costs.reshape(len(tries), -1), strict=True):
            winner = int(np.argmin(own))
            gains[k] = 1 - own[winner] / best[k]
            if gains[k] > 0:
                theta[k], best[k] = tries[k][winner], float(own[winner])
        most = np.inf if done < TRIAL else BEHIND * best.min()
        running = np.array([k for k, gain in gains.items() if gain >= ENOUGH and best[k] <= most], int)
        if not len(running):
            break
    ends = point(theta, np.arange(len(starts)))
    test = bench.test_errors(ends)
    return [
        Refit({n: float(ends[n][k]) for n in names}, float(best[k]), float(test[k]))
        for k in range(len(starts))
    ]


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

    def test_errors(self, values: Mapping[str, np.ndarray]) -> np.ndarray:
        """Normalised RMSE (K,) of K parameter sets on the test records."""
        angles = self._replay(values, self.test)
        errors = [
            [
                nrmse(angles[: self.lengths[b], :, k, i], self.records.measured[: self.lengths[b], :, b])
                for i, b in enumerate(self.test)
            ]
            for k in range(angles.shape[2])
        ]
        return np.mean(errors, axis=(1, 2))

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


BANDS = {"strong": (3.2, 9.0), "medium": (1.6, 2.8), "weak": (1.18, 1.45)}
"""Ratio of re-fit to noise floor that is aimed at; a level's own limits are a little wider."""
QUICK = 3
"""Steps of the re-fits by which a size is found."""
FACTORS = np.geomspace(0.03, 8.0, 10)
"""Sizes that are tried, relative to the one drawn."""


@dataclass(frozen=True)
class Errors:
    """Normalised RMSE of the nominal model on the test records, as it stands and re-fitted on the train records.

    Attributes:
        nominal, refit: these.
        train: RMS error of the re-fit on the train records over that of the machine itself.
    """

    nominal: float
    refit: float
    train: float


@dataclass(frozen=True, eq=False)
class Graded:
    """A case of known difficulty.

    Attributes:
        case: with its effects in their final size.
        records: its records.
        errors: of the nominal model.
    """

    case: Case
    records: Records
    errors: Errors

    @property
    def ratio(self) -> float:
        """Re-fit over noise floor."""
        return self.errors.refit / self.records.noise_floor

    @property
    def level(self) -> str:
        """strong, medium, weak or none, as the format of cases defines them."""
        if not self.case.effects:
            return "none"
        return level_of(self.ratio)


def level_of(ratio: float) -> str:
    """Level of a ratio of re-fit to noise floor."""
    return "strong" if ratio >= 3 else "medium" if ratio >= 1.5 else "weak" if ratio >= 1.15 else "none"


def errors_of(case: Case, records: Records) -> Errors:
    """Errors of the nominal model."""
    found = refit_model(case, records)
    clean = float(np.mean(Bench(case, records, lambda _: build(case.robot, case.effects)).clean_error() ** 2))
    return Errors(nominal_error(case, records), found.test, float(np.sqrt(found.train / clean)))


def grade(case: Case) -> Graded:
    """Record a case and re-fit the nominal model."""
    records = record(case)
    return Graded(case, records, errors_of(case, records))


def scale_to_level(case: Case, wanted: str) -> Graded:
    """Scale all effects of a case by the one of `FACTORS` whose level comes next to the wanted one.

    All sizes are recorded side by side; as the level rises with the size, bisection decides which are re-fitted.
    """
    goal = float(np.sqrt(np.prod(BANDS[wanted])))
    made = record_sizes(replace(case, engine="in_house"), FACTORS)
    below, above, tried = -1, len(FACTORS), {}
    while above - below > 1:
        i = (below + above) // 2
        scaled = case.with_effects([effect.scaled(float(FACTORS[i])) for effect in case.effects])
        tried[i] = refit_model(scaled, made[i], rounds=QUICK).test / made[i].noise_floor
        if BANDS[wanted][0] <= tried[i] <= BANDS[wanted][1]:
            break
        below, above = (i, above) if tried[i] < goal else (below, i)
    known = [k for k, level in tried.items() if np.isfinite(level)]
    if not known:
        raise InputError("blind make: no size of the effect gives records that can be fitted")
    i = min(known, key=lambda k: abs(np.log(tried[k] / goal)))
    best = case.with_effects([effect.scaled(float(FACTORS[i])) for effect in case.effects])
    return Graded(best, made[i], errors_of(best, made[i])) if case.engine == "in_house" else grade(best)
