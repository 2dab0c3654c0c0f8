"""Mixtures of effects on one robot: their records, and the fits of simulators that have some of them.

Everything that differs between two runs is a lane: sizes of effects, values of parameters, records. One pass of the
integrator replays all of them.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hybrid_id.machines.case import nrmse
from hybrid_id.machines.effects import Effect
from hybrid_id.machines.experiments import SAMPLE_TIME, Campaign, noise_std
from hybrid_id.machines.grading import LOST, SIGNAL_SHARE, STEP, free_parameters, true_values
from hybrid_id.machines.physics.bench import replay, run
from hybrid_id.machines.physics.machine import Machine
from hybrid_id.machines.robots import Robot

FINE = 2
"""Steps a sample of the machines that are measured: 1 ms."""
ENOUGH = 4e-3
"""Relative fall of the mean square error below which a fit ends."""
THIN = 3
"""Every so many samples count in a fit."""
DAMPINGS = (1e-4, 1e-2, 1.0, 100.0)
"""Dampings that are tried side by side, relative to the diagonal of the normal equations."""
FARTHEST = 1.6
"""Longest step of a parameter, on its logarithmic scale."""


@dataclass(frozen=True, eq=False)
class Measured:
    """One set of records.

    Attributes:
        volts: (T, n_joints, R).
        angles: measured, (T, n_outputs, R) [rad].
    """

    volts: np.ndarray
    angles: np.ndarray


@dataclass(frozen=True)
class Simulator:
    """A simulator on one set of records.

    Attributes:
        number: of the set of records.
        sizes: factor of each effect, 0 of those that it has not.
        values: of its parameters.
        shapes: values of effects other than drawn, by effect and key.
        free: effects whose size is fitted beside the parameters.
        free_shapes: effects and keys that are, too.
    """

    number: int
    sizes: tuple[float, ...]
    values: Mapping[str, float]
    shapes: Mapping[tuple[int, str], float] = field(default_factory=dict)
    free: tuple[int, ...] = ()
    free_shapes: tuple[tuple[int, str], ...] = ()


@dataclass(frozen=True)
class Fit:
    """A fitted simulator.

    Attributes:
        simulator: with its fitted values.
        train: weighted mean square error on the train records; 1 is the encoders' noise.
        test: normalised RMSE on the test records.
    """

    simulator: Simulator
    train: float
    test: float


class Mixtures:
    """A robot, effects that may act on it, and the experiments.

    Args:
        robot: without effects.
        effects: in their unit size.
        campaign: planned records.
        beside: effects that are parameters of the machine which every simulator here lacks.
    """

    def __init__(
        self, robot: Robot, effects: Sequence[Effect], campaign: Campaign, beside: Collection[Effect] = ()
    ) -> None:
        self.effects, self.campaign, self.bare = tuple(effects), campaign, robot
        truth = robot
        for effect in (*effects, *beside):
            truth = effect.alter(truth)
        self.true = true_values(truth, free_parameters(truth))
        self.robot = truth.with_values(dict.fromkeys(truth.lacks, 0.0))
        self.noise = noise_std(campaign.encoders)
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
            names = [(i, robot.name(i, symbol)) for i in range(robot.joints) for symbol in ("F_c", "F_v")]
            robot = robot.with_values({name: robot.values[name] * drift[i] for i, name in names})
        machine = robot.assemble(substeps=max([least, *(e.substeps for e in acting)]))
        with np.errstate(divide="ignore"):
            for effect in acting:
                effect.install(machine, robot)
        return machine

    def record(self, mixtures: Sequence[Sequence[float]], drift: np.ndarray) -> list[Measured]:
        """Measure the machines of several mixtures, all records of all of them side by side."""
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

    def floors(self, mixtures: Sequence[Sequence[float]], measured: Sequence[Measured]) -> np.ndarray:
        """Normalised RMSE of each machine itself, its friction that of no record, on its test records."""
        found = np.zeros(len(mixtures))
        for rows in self.alike(mixtures):
            simulators = [Simulator(i, tuple(mixtures[k]), {}) for i, k in enumerate(rows)]
            own = [measured[k] for k in rows]
            angles = self.replay(simulators, own, self.test, least=FINE, settled=False)
            for i, k in enumerate(rows):
                found[k] = self.error(angles[:, :, i], measured[k])
        return found

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
        runs, joints = len(rows), self.robot.joints
        names = {name for one in simulators for name in one.values}
        values = {n: np.repeat([float(one.values[n]) for one in simulators], runs) for n in names}
        sizes = np.repeat(np.array([one.sizes for one in simulators], float).T, runs, axis=1)
        shaped = dict.fromkeys(key for one in simulators for key in one.shapes)
        shapes = {
            (i, key): np.repeat(
                [float(one.shapes.get((i, key), np.mean(self.effects[i].values[key]))) for one in simulators],
                runs,
            )
            for i, key in shaped
        }
        used = sorted({one.number for one in simulators})
        samples = int(self.campaign.lengths[rows].max())
        volts = {k: measured[k].volts[:samples][..., rows] for k in used}
        rest = {k: measured[k].angles[:50, :joints][..., rows].mean(axis=0) for k in used}
        ratio = np.array(self.robot.ratio)[:, None]
        start = np.concatenate([rest[one.number] / ratio for one in simulators], axis=1) if settled else None
        with np.errstate(all="ignore"):  # a machine that diverges costs much, which is all
            machine = self.machine(sizes, values, shapes, least=least)
            angles = replay(
                machine,
                np.concatenate([volts[one.number] for one in simulators], axis=-1),
                sample_time=SAMPLE_TIME,
                link=self.campaign.encoders.link,
                start=start,
            )
        return angles.reshape(*angles.shape[:2], len(simulators), runs)

    def responses(self, simulators: Sequence[Simulator], measured: Sequence[Measured]) -> np.ndarray:
        """Angles (T, n_outputs, K, R) of any simulators on all of their records."""
        rows = np.arange(len(self.campaign.roles))
        found: np.ndarray | None = None
        for group in self.alike([one.sizes for one in simulators]):
            angles = self.replay([simulators[k] for k in group], measured, rows)
            if found is None:
                found = np.zeros((*angles.shape[:2], len(simulators), len(rows)))
            found[:, :, group] = angles
        assert found is not None
        return found

    def residuals(self, simulators: Sequence[Simulator], measured: Sequence[Measured]) -> np.ndarray:
        """Weighted errors (K, N) of simulators, alike in what they replace, on their train records."""
        angles = self.replay(simulators, measured, self.train)
        numbers = [one.number for one in simulators]
        columns = []
        for i, b in enumerate(self.train):
            own = slice(None, self.campaign.lengths[b], THIN)
            logged = {k: measured[k].angles[own, :, b] for k in set(numbers)}
            weight = {
                k: 1 / np.hypot(self.noise, SIGNAL_SHARE * one.std(axis=0)) for k, one in logged.items()
            }
            errors = [(angles[own, :, k, i] - logged[n]) * weight[n] for k, n in enumerate(numbers)]
            columns.append(np.array(errors).reshape(len(numbers), -1))
        return np.clip(np.nan_to_num(np.concatenate(columns, axis=1), nan=LOST), -LOST, LOST)

    def error(self, angles: np.ndarray, measured: Measured) -> float:
        """Normalised RMSE of angles (T, n_outputs, R) on the test records."""
        lengths = self.campaign.lengths
        with np.errstate(all="ignore"):
            errors = [
                nrmse(angles[: lengths[b], :, i], measured.angles[: lengths[b], :, b])
                for i, b in enumerate(self.test)
            ]
        return float(np.mean(errors))

    def fit(self, simulators: Sequence[Simulator], measured: Sequence[Measured], *, rounds: int) -> list[Fit]:
        """Fit simulators to their train records from where they stand, each until it gains little."""
        found: dict[int, Fit] = {}
        for rows in self.alike([one.sizes for one in simulators]):
            fits = self._fit([simulators[k] for k in rows], measured, rounds)
            found |= dict(zip(rows, fits, strict=True))
        return [found[k] for k in range(len(simulators))]

    def _fit(self, simulators: Sequence[Simulator], measured: Sequence[Measured], rounds: int) -> list[Fit]:
        """Fit simulators that are alike in what they replace, by Levenberg's and Marquardt's method."""
        now, cost, running = list(simulators), np.full(len(simulators), np.inf), list(range(len(simulators)))
        for _ in range(rounds):
            around = {
                k: [now[k], *(self._moved(now[k], step) for step in STEP * np.eye(_size(now[k])))]
                for k in running
            }
            residuals = iter(self.residuals([one for own in around.values() for one in own], measured))
            tries = {}
            for k, own in around.items():
                base, *moved = (next(residuals) for _ in own)
                cost[k] = float(np.mean(base**2))
                jacobian = (np.array(moved) - base) / STEP
                normal, right = jacobian @ jacobian.T, jacobian @ base
                if np.trace(normal) > 0:
                    diagonal = np.diag(np.diag(normal)) + 1e-12 * np.trace(normal) * np.eye(len(right))
                    steps = [np.linalg.solve(normal + d * diagonal, right) for d in DAMPINGS]
                    tries[k] = [self._moved(now[k], -np.clip(step, -FARTHEST, FARTHEST)) for step in steps]
            if not tries:
                break
            flat = [one for own in tries.values() for one in own]
            costs = np.mean(self.residuals(flat, measured) ** 2, axis=1).reshape(len(tries), -1)
            running = []
            for k, own in zip(tries, costs, strict=True):
                best = int(np.argmin(own))
                if own[best] < cost[k]:
                    if own[best] < (1 - ENOUGH) * cost[k]:
                        running.append(k)
                    now[k], cost[k] = tries[k][best], float(own[best])
            if not running:
                break
        angles = self.replay(now, measured, self.test)
        return [
            Fit(one, float(c), self.error(angles[:, :, i], measured[one.number]))
            for i, (one, c) in enumerate(zip(now, cost, strict=True))
        ]

    def alike(self, mixtures: Sequence[Sequence[float]]) -> list[list[int]]:
        """Numbers of mixtures, those together that are alike in what replaces a part or needs smaller steps."""
        groups: dict[tuple[bool, ...], list[int]] = {}
        for k, sizes in enumerate(mixtures):
            key = tuple(
                size != 0 for effect, size in zip(self.effects, sizes, strict=True) if effect.replaces
            )
            groups.setdefault(key, []).append(k)
        return list(groups.values())

    def _moved(self, one: Simulator, step: np.ndarray) -> Simulator:
        """A simulator a step further, on logarithmic scales but for what may be negative."""
        ends = np.cumsum([len(one.values), len(one.free), len(one.free_shapes)])
        values = {
            n: v * float(np.exp(s)) for (n, v), s in zip(one.values.items(), step[: ends[0]], strict=True)
        }
        sizes, shapes = list(one.sizes), dict(one.shapes)
        for i, s in zip(one.free, step[ends[0] : ends[1]], strict=True):
            sizes[i] *= float(np.exp(s))
        for (i, key), s in zip(one.free_shapes, step[ends[1] :], strict=True):
            signed = key in self.effects[i].signed
            shapes[i, key] = shapes[i, key] + float(s) if signed else shapes[i, key] * float(np.exp(s))
        return replace(one, values=values, sizes=tuple(sizes), shapes=shapes)


def _size(one: Simulator) -> int:
    """How many numbers of a simulator are fitted."""
    return len(one.values) + len(one.free) + len(one.free_shapes)
