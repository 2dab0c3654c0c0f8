"""A machine with some of many effects on its experiments: its records, and the re-fits of simulators that have others.

Everything that differs between two runs is a lane: sizes of effects, values of parameters, records. One pass of the
integrator replays all of them; derivatives of a re-fit are differences, all perturbed simulators side by side.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np
from scipy.optimize import least_squares

from hybrid_id.machines.effects import Effect
from hybrid_id.machines.experiments import SAMPLE_TIME, Campaign, noise_std
from hybrid_id.machines.physics.bench import replay, run
from hybrid_id.machines.physics.machine import Machine
from hybrid_id.machines.robots import Robot

FINE = 2
"""Steps a sample of the machines that are measured: 1 ms."""
STEP = 0.01
"""Relative change of a parameter for its derivative: large enough to be felt past stick and slip."""
GAIN = 3.6e-4
"""Relative fall of the cost below which a re-fit ends."""
SIGNAL_SHARE = 0.0013
"""Added to the noise as a share of each signal, so that small errors of large signals weigh little."""


@dataclass(frozen=True, eq=False)
class Measured:
    """One set of R records: commands ``volts`` (T, n_joints, R), and measured ``angles`` (T, n_outputs, R) [rad]."""

    volts: np.ndarray
    angles: np.ndarray


@dataclass(frozen=True)
class Simulator:
    """A simulator on one set of records.

    Attributes:
        number: of the set of records.
        sizes: factor of each effect, 0 of those that it has not.
        values: of its parameters, all of which a re-fit moves.
        shapes: values of effects other than drawn, by effect and key.
        free: effects whose size is fitted beside the parameters.
        free_shapes: effects and keys that are, too.
        train: weighted mean square error on the train records, once it is fitted; 1 is the encoders' noise.
        test: normalised RMSE on the test records, likewise.
    """

    number: int
    sizes: tuple[float, ...]
    values: Mapping[str, float]
    shapes: Mapping[tuple[int, str], float] = field(default_factory=dict)
    free: tuple[int, ...] = ()
    free_shapes: tuple[tuple[int, str], ...] = ()
    train: float = np.inf
    test: float = np.inf


class Trials:
    """A robot, effects that may act on it, and the experiments.

    Args:
        robot: without effects.
        effects: in their unit size.
        campaign: planned records.
        beside: effects that are parameters of the machine which every simulator here lacks.

    Attributes:
        true: values of the parameters that a re-fit moves.
        joints: numbers of the joints where effects may act.
        noise: standard deviation of each output's noise (n_outputs,) [rad].
        lengths: samples of each record (R,).
        train, test: numbers of the records.
        thin: every so many samples count in a re-fit.
        lost: weighted error of a machine that diverged.
    """

    thin = 3
    lost = 1e6

    def __init__(
        self, robot: Robot, effects: Sequence[Effect], campaign: Campaign, beside: Collection[Effect] = ()
    ) -> None:
        self.effects, self.campaign, self.bare = tuple(effects), campaign, robot
        truth = robot
        for effect in (*effects, *beside):
            truth = effect.alter(truth)
        self.true = {name: float(np.mean(truth.values[name])) for name in truth.free}
        self.joints: Sequence[int] = range(robot.joints)
        self.robot = truth.with_values(dict.fromkeys(truth.lacks, 0.0))
        self.noise, self.lengths = noise_std(campaign.encoders), campaign.lengths
        self.train = np.flatnonzero([role == "train" for role in campaign.roles])
        self.test = np.setdiff1d(np.arange(len(campaign.roles)), self.train)

    def machine(
        self,
        sizes: np.ndarray,
        values: Mapping[str, np.ndarray],
        shapes: Mapping[tuple[int, str], np.ndarray],
        *,
        least: int = 1,
        drift: np.ndarray | None = None,
    ) -> Machine:
        """Machines side by side.

        Args:
            sizes: factor of each effect (n_effects, B).
            values: of parameters, (B,) each.
            shapes: other values of effects, (B,) each.
            least: steps a sample, at least.
            drift: factor on each motor's friction (n_joints, B).
        """
        robot, acting = self.robot.with_values(values), []
        for i, effect in enumerate(self.effects):
            if np.any(sizes[i] != 0):
                moved = effect.with_values({key: v for (j, key), v in shapes.items() if j == i})
                acting.append(moved.scaled(sizes[i]))
        for effect in acting:
            robot = effect.alter(robot)
        if drift is not None:
            robot = robot.drifted(drift)
        machine = robot.assemble(substeps=max([least, *(e.substeps for e in acting)]))
        with np.errstate(divide="ignore"):
            for effect in acting:
                effect.install(machine, robot)
        return machine

    def record(self, mixtures: Sequence[Sequence[float]], drift: np.ndarray) -> list[Measured]:
        """Measure the machines of several mixtures, all records of all of them side by side.

        Args:
            mixtures: sizes of all effects, of each machine.
            drift: factor on each motor's friction (n_joints, R).
        """
        found: dict[int, Measured] = {}
        for rows in self.alike(mixtures):
            count, runs = len(rows), len(self.campaign.roles)
            campaign = self.campaign.repeated(count)
            sizes = np.repeat(np.array([mixtures[k] for k in rows], float).T, runs, axis=1)
            machine = self.machine(sizes, {}, {}, least=FINE, drift=np.tile(drift, count))
            with np.errstate(all="ignore"):
                volts, angles = run(machine, campaign.program, campaign.encoders, sample_time=SAMPLE_TIME)
            for i, k in enumerate(rows):
                own = slice(i * runs, (i + 1) * runs)
                found[k] = Measured(volts[..., own], angles[..., own])
        return [found[k] for k in range(len(mixtures))]

    def floors(self, mixtures: Sequence[Sequence[float]], measured: Sequence[Measured]) -> list[Simulator]:
        """The machines themselves, their friction that of no record, with their errors."""
        machines = [Simulator(k, tuple(sizes), {}) for k, sizes in enumerate(mixtures)]
        return self.errors(machines, measured, least=FINE, settled=False)

    def replay(
        self,
        simulators: Sequence[Simulator],
        measured: Sequence[Measured],
        rows: np.ndarray,
        *,
        least: int = 1,
        settled: bool = True,
    ) -> np.ndarray:
        """Angles (T, n_outputs, K, R) of simulators, alike in what they replace, on some of their records.

        Args:
            simulators: to replay.
            measured: sets of records.
            rows: numbers of records.
            least: see `machine`.
            settled: whether they start where the records do, and not where they come to rest by themselves.
        """
        joints, samples = self.robot.joints, int(self.lengths[rows].max())
        volts = [measured[one.number].volts[:samples][..., rows] for one in simulators]
        rest = [measured[one.number].angles[:50, :joints][..., rows].mean(axis=0) for one in simulators]
        start = np.concatenate(rest, axis=1) / np.array(self.robot.ratio)[:, None]
        with np.errstate(all="ignore"):  # a machine that diverges costs much, which is all
            machine = self.machine(*self.lanes(simulators, len(rows)), least=least)
            angles = replay(
                machine,
                np.concatenate(volts, axis=-1),
                sample_time=SAMPLE_TIME,
                link=self.campaign.encoders.link,
                start=start if settled else None,
            )
        return angles.reshape(*angles.shape[:2], len(simulators), len(rows))

    def lanes(
        self, simulators: Sequence[Simulator], runs: int
    ) -> tuple[np.ndarray, dict[str, np.ndarray], dict[tuple[int, str], np.ndarray]]:
        """Sizes, values and shapes of simulators, each for so many runs side by side."""
        names = {name for one in simulators for name in one.values}
        values = {n: np.repeat([float(one.values[n]) for one in simulators], runs) for n in names}
        sizes = np.repeat(np.array([one.sizes for one in simulators], float).T, runs, axis=1)
        shapes = {}
        for i, key in dict.fromkeys(key for one in simulators for key in one.shapes):
            drawn = np.mean(self.effects[i].values[key])
            shapes[i, key] = np.repeat([float(one.shapes.get((i, key), drawn)) for one in simulators], runs)
        return sizes, values, shapes

    def residuals(self, simulators: Sequence[Simulator], measured: Sequence[Measured]) -> np.ndarray:
        """Weighted errors (K, N) of any simulators on their train records."""
        found: dict[int, np.ndarray] = {}
        for rows in self.alike([one.sizes for one in simulators]):
            own = [simulators[k] for k in rows]
            angles = self.replay(own, measured, self.train)
            found |= dict(zip(rows, self._weighted(angles, own, measured), strict=True))
        return np.array([found[k] for k in range(len(simulators))])

    def _weighted(
        self, angles: np.ndarray, simulators: Sequence[Simulator], measured: Sequence[Measured]
    ) -> np.ndarray:
        """Errors (K, N) of angles (T, n_outputs, K, R) on the train records, in noise standard deviations."""
        columns = []
        for i, b in enumerate(self.train):
            samples = slice(None, self.lengths[b], self.thin)
            errors = []
            for k, one in enumerate(simulators):
                logged = measured[one.number].angles[samples, :, b]
                weight = 1 / np.hypot(self.noise, SIGNAL_SHARE * logged.std(axis=0))
                errors.append((angles[samples, :, k, i] - logged) * weight)
            columns.append(np.array(errors).reshape(len(simulators), -1))
        errors = np.nan_to_num(np.concatenate(columns, axis=1), nan=self.lost)
        return np.clip(errors, -self.lost, self.lost)

    def error(self, angles: np.ndarray, measured: Measured) -> float:
        """Normalised RMSE of angles (T, n_outputs, R) on the test records."""
        errors = []
        for i, b in enumerate(self.test):
            logged = measured.angles[: self.lengths[b], :, b]
            with np.errstate(all="ignore"):
                square = np.mean((angles[: self.lengths[b], :, i] - logged) ** 2, axis=0)
                errors.append(np.sqrt(square) / np.std(logged, axis=0))
        return float(np.mean(errors))

    def fit(
        self, simulators: Sequence[Simulator], measured: Sequence[Measured], *, rounds: int
    ) -> list[Simulator]:
        """Fit simulators to their train records from where they stand, in so many evaluations at most."""
        fits = []
        for one in simulators:
            around = STEP * np.eye(len(one.values) + len(one.free) + len(one.free_shapes))

            def left(step: np.ndarray, one: Simulator = one) -> np.ndarray:
                return self.residuals([self._moved(one, step)], measured)[0]

            def slopes(step: np.ndarray, one: Simulator = one, around: np.ndarray = around) -> np.ndarray:
                moved = [self._moved(one, step), *(self._moved(one, step + change) for change in around)]
                base, *others = self.residuals(moved, measured)
                return (np.array(others) - base).T / STEP

            start, jacobian = np.zeros(len(around)), cast(Any, slopes)  # SciPy's stubs know of names alone
            with np.errstate(all="ignore"):
                end = least_squares(left, start, jacobian, ftol=GAIN, max_nfev=rounds)
            fits.append(self._moved(one, end.x))
        return self.errors(fits, measured)

    def errors(
        self, simulators: Sequence[Simulator], measured: Sequence[Measured], **how: Any
    ) -> list[Simulator]:
        """Simulators as they stand, with their errors on the train and test records; `how` as of `replay`."""
        found: dict[int, Simulator] = {}
        for rows in self.alike([one.sizes for one in simulators]):
            own = [simulators[k] for k in rows]
            angles = self.replay(own, measured, np.arange(len(self.lengths)), **how)
            train = np.mean(self._weighted(angles[..., self.train], own, measured) ** 2, axis=1)
            for i, (k, one) in enumerate(zip(rows, own, strict=True)):
                test = self.error(angles[:, :, i][..., self.test], measured[one.number])
                found[k] = replace(one, train=float(train[i]), test=test)
        return [found[k] for k in range(len(simulators))]

    def having(self, effects: Sequence[Effect]) -> "Trials":
        """The same experiments with other effects, beside these."""
        return Trials(self.bare, effects, self.campaign, beside=self.effects)

    def with_values(self, fit: Simulator, number: int) -> Effect:
        """An effect as it was fitted."""
        shapes = {key: value for (i, key), value in fit.shapes.items() if i == number}
        return self.effects[number].with_values(shapes).scaled(fit.sizes[number])

    def alike(self, mixtures: Sequence[Sequence[float]]) -> list[list[int]]:
        """Numbers of mixtures, those together that are alike in what replaces a part or needs smaller steps."""
        groups: dict[tuple[bool, ...], list[int]] = {}
        for k, sizes in enumerate(mixtures):
            acting = zip(self.effects, sizes, strict=True)
            groups.setdefault(tuple(size != 0 for one, size in acting if one.replaces), []).append(k)
        return list(groups.values())

    def _moved(self, one: Simulator, step: np.ndarray) -> Simulator:
        """A simulator a step further, on logarithmic scales but for what may be negative."""
        steps = iter(step)
        values: dict[str, Any] = {n: v * float(np.exp(next(steps))) for n, v in one.values.items()}
        sizes, shapes = list(one.sizes), dict(one.shapes)
        for i in one.free:
            sizes[i] *= float(np.exp(next(steps)))
        for i, key in one.free_shapes:
            signed, change = key in self.effects[i].signed, float(next(steps))
            shapes[i, key] = shapes[i, key] + change if signed else shapes[i, key] * float(np.exp(change))
        return replace(one, values=values, sizes=tuple(sizes), shapes=shapes)
