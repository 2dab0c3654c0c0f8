"""One joint of an arm by itself, the others as they truly moved: what an effect there is worth, and its rivals."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hybrid_id.machines.arm import Arm
from hybrid_id.machines.effects import Effect
from hybrid_id.machines.effects.arm import LinkMass
from hybrid_id.machines.effects.base import UNKNOWN
from hybrid_id.machines.physics.law import Lanes, Law, Push, Signals
from hybrid_id.machines.physics.machine import Drive, Machine, OneLink
from hybrid_id.machines.physics.mujoco import document
from hybrid_id.machines.trials import Measured, Simulator, Trials

SAMPLE = 0.01
"""Sample time of an arm's records [s]."""
SUBSTEPS = 5
"""Steps a sample."""
WINDOW = 0.96
"""Length of the pieces over which commanded torques are replayed [s]; servos are over whole records."""


@dataclass
class GivenLoad(OneLink):
    """What a joint carries while the others move as they did: inertia J and ``pull + slope q``, held over a sample."""

    J: Any = 0.0
    pull: Any = 0.0
    slope: Any = 0.0

    def bias(self, q: list[np.ndarray], v: list[np.ndarray]) -> list[Lanes]:
        """Torque that is carried."""
        return [self.pull + self.slope * q[0]]


@dataclass
class Factor(Law):
    """A factor on all dry friction."""

    factor: Any = 1.0

    def act(self, push: Push, x: Signals) -> None:
        """Scale what the laws before it have added."""
        push.plus, push.minus = push.plus * self.factor, push.minus * self.factor


class Joint(Machine):
    """A joint's drive under a load that is given."""

    def __init__(self, drive: Drive) -> None:
        self.load = GivenLoad()
        super().__init__([drive], self.load, substeps=SUBSTEPS)

    def begin_at(self, angle: np.ndarray, speed: np.ndarray, load: np.ndarray) -> None:
        """Prepare B runs from angles [rad] and speeds [rad/s] (B,) under a load (4, T, B).

        The load is inertia [kg m^2], torque at angle zero [N m], its slope [N m/rad], and factor on dry friction.
        """
        drive, (samples, lanes) = self.drives[0], load.shape[1:]
        self.factor = Factor()
        drive.rotor_laws.append(self.factor)
        drive.start(lanes, angle)
        x = drive.x
        x.v_m, x.v_a = np.array(speed), np.array(speed)
        if drive.spring is not None:  # as far wound up as its load asks for
            x.q_m = angle + (load[1][0] + load[2][0] * angle) / drive.spring.torque(
                np.ones(1), np.zeros(1), 1.0
            )
        x.history, x.sample_time = np.zeros((samples, lanes)), SAMPLE
        self.prepare(lanes, samples, SAMPLE, 6)
        self._steps.inputs[:, 2:] = load.transpose(1, 0, 2)

    def _driven(self, time: float, h: float, inputs: Sequence[np.ndarray] | np.ndarray) -> None:
        self.load.J, self.load.pull, self.load.slope, self.factor.factor = inputs[2:]
        super()._driven(time, h, inputs[:2])


@dataclass(frozen=True, eq=False)
class Moved:
    """An arm's records as it truly moved, the last for the test, with what was measured.

    Attributes:
        volts, measured: commands, and angles that the encoders read, (T, n, R).
        angle, speed: of the joints, (T, n, R) [rad, rad/s].
        trace: torque [N m] and factor on dry friction of what acts outside the catalogue, (2, T, R).
    """

    volts: np.ndarray
    measured: np.ndarray
    angle: np.ndarray
    speed: np.ndarray
    trace: np.ndarray

    def carried(self, arm: Arm, shares: Sequence[float]) -> np.ndarray:
        """Inertia, torque at angle zero and slope (3, T, n, R) that the joints carry, links heavier by shares."""
        import mujoco

        mj: Any = mujoco
        model = mj.MjModel.from_xml_string(document(arm.weighed(shares), [""] * arm.joints))
        data, whole, tilt = mj.MjData(model), np.zeros((arm.joints, arm.joints)), 1e-4
        angle, speed = (0.5 * (one[1:] + one[:-1]) for one in (self.angle, self.speed))
        faster = np.diff(self.speed, axis=0) / SAMPLE
        load = np.zeros((3, *self.angle.shape))

        def torque(q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
            data.qpos[:], data.qvel[:] = q, v
            mj.mj_fwdPosition(model, data)
            mj.mj_fwdVelocity(model, data)
            mj.mj_fullM(model, data, whole)
            return data.qfrc_bias + whole @ a - np.diag(whole) * a

        for n, r in np.ndindex(len(angle), self.angle.shape[2]):
            q, v, a = angle[n, :, r], speed[n, :, r], faster[n, :, r]
            load[1, n, :, r] = torque(q, v, a)
            load[0, n, :, r] = np.diag(whole)
            for k in range(arm.joints):
                aside = q.copy()
                aside[k] += tilt
                load[2, n, k, r] = (torque(aside, v, a)[k] - load[1, n, k, r]) / tilt
        load[1, :-1] -= load[2, :-1] * angle
        load[:, -1] = load[:, -2]
        return load


class Masses(Effect):
    """Small errors of the masses that a joint carries, all together."""

    sized = ()


class JointTrials(Trials):
    """A joint by itself with some of many effects.

    Args:
        arm: without effects.
        joint: its number.
        effects: at this joint, in their size.
        moved: the arm's records.
        loads: what the joints carry by the description, beyond it by small errors of masses, and for a share of one
            link's, see `Moved.carried`.
    """

    thin = 1
    lost = 400.0

    def __init__(
        self,
        arm: Arm,
        joint: int,
        effects: Sequence[Effect],
        moved: Moved,
        loads: tuple[np.ndarray, np.ndarray, np.ndarray],
    ) -> None:
        self.arm, self.joint, self.effects, self.moved, self.loads = arm, joint, tuple(effects), moved, loads
        self.bare = self.robot = arm  # type: ignore[assignment]
        self.true = {name: float(arm.values[name]) for name in arm.free(joint)}
        self.joints, self.noise = [joint], np.array([arm.noise])
        samples, _, records = moved.measured.shape
        self.window = samples if arm.servo else round(WINDOW / SAMPLE) + 1
        self.begins = np.arange(0, samples - self.window + 1, self.window - 1)
        pieces = len(self.begins)
        self.lengths = np.full(pieces * records, self.window)
        test = np.repeat(np.arange(records) == records - 1, pieces)
        self.train, self.test = np.flatnonzero(~test), np.flatnonzero(test)
        own = moved.measured[:, joint]
        self.variance = own[:, :-1].var(axis=0).mean(), own[:, -1].var()
        self.measured = [Measured(self._pieces(moved.volts)[:, None], self._pieces(moved.measured)[:, None])]

    def having(self, effects: Sequence[Effect]) -> "JointTrials":
        """The same records with other effects."""
        return JointTrials(self.arm, self.joint, effects, self.moved, self.loads)

    def gap(self, fit: Simulator, of: str) -> float:
        """Mean square error over the signal's variance, on the train or the test records."""
        if of == "test":
            return fit.test**2
        return fit.train * float(self.noise[0]) ** 2 / self.variance[0]

    def error(self, angles: np.ndarray, measured: Measured) -> float:
        """Normalised RMSE of angles (window, 1, pieces) on the test record."""
        errors = np.nan_to_num(angles - measured.angles[..., self.test], nan=50.0)
        return float(np.sqrt(np.mean(np.clip(errors, -50.0, 50.0) ** 2) / self.variance[1]))

    def replay(
        self, simulators: Sequence[Simulator], measured: Sequence[Measured], rows: np.ndarray, **_: Any
    ) -> np.ndarray:
        """Angles (window, 1, K, pieces) of simulators, each piece from where the joint truly was."""
        runs = len(rows)
        sizes, values, shapes = self.lanes(simulators, runs)
        arm = self.arm.with_values(values)
        machine = Joint(arm.drive(self.joint))
        small, mass, outside = (np.zeros(len(simulators) * runs) for _ in range(3))
        for i, effect in enumerate(self.effects):
            if isinstance(effect, Masses):
                small = sizes[i]
            elif isinstance(effect, LinkMass):
                mass = mass + sizes[i] * effect.values["mass"]
            elif effect.name == UNKNOWN:
                outside = np.where(sizes[i] != 0, 1.0, outside)
            elif np.any(sizes[i] != 0):
                changed = effect.with_values({key: v for (j, key), v in shapes.items() if j == i})
                changed.scaled(sizes[i]).install(machine, arm)  # type: ignore[arg-type]

        def lanes(rows_of: np.ndarray) -> np.ndarray:
            return np.tile(self._pieces(rows_of)[..., rows], len(simulators))

        load = np.zeros((3, self.window, len(simulators) * runs))
        for carried, share in zip(self.loads, (1.0, small, mass), strict=True):
            load += np.array([lanes(rows_of) for rows_of in carried]) * share
        torque, factor = (np.tile(self._windows(one)[..., rows], len(simulators)) for one in self.moved.trace)
        with np.errstate(all="ignore"):
            machine.begin_at(
                lanes(self.moved.angle)[0],
                lanes(self.moved.speed)[0],
                np.array([load[0], load[1] - outside * torque, load[2], 1.0 + outside * (factor - 1.0)]),
            )
            volts = lanes(self.moved.volts)[:, None]
            angles = machine.carry(volts)[1]
        return angles.reshape(self.window, 1, len(simulators), runs)

    def _pieces(self, rows: np.ndarray) -> np.ndarray:
        """This joint's (T, n, R) in pieces, (window, pieces of all records)."""
        return self._windows(rows[:, self.joint])

    def _windows(self, rows: np.ndarray) -> np.ndarray:
        """(T, R) in pieces, (window, pieces of all records)."""
        parts = [rows[b : b + self.window] for b in self.begins]
        return np.stack(parts, axis=-1).reshape(self.window, -1)
