"""Re-fits of one joint of an arm by itself, the others as they truly moved: what an effect is worth, and its rivals.

Windows of a record start from the true state. All fits, their perturbed values and all windows run side by side, by an
implicit step for dry friction; output error by Levenberg's and Marquardt's method, from values that may be true.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from hybrid_id.machines.arms.effects import SIGNED
from hybrid_id.machines.arms.motion import SAMPLE, Load, Motion
from hybrid_id.machines.arms.robot import TWIST_DAMPING, Arm, Drive

SUBSTEPS = 5
"""Steps a sample."""
SERVO_WINDOW, TORQUE_WINDOW = 2.4, 0.96
"""Longest windows [s], of goals that servos follow and of commanded torques."""
NUDGE = 0.012
"""Change of a parameter for its derivative."""
DAMPINGS = (1e-3, 0.08, 1.6, 40.0)
GAIN = 2e-4
"""Relative fall of the cost below which a fit ends."""
WIDEST = 0.65
"""Largest step of a parameter."""
TRUNCATED = 400.0
"""Error in noise standard deviations beyond which it counts no more."""
RUNAWAY = 50.0
"""Error [rad] beyond which a motion is lost."""
LANES = 6000
"""Windows that run side by side, at most."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A joint's drive with some values free, and how it errs once it is fitted.

    Attributes:
        joint: its number from 0.
        drive: start values, then the fitted ones.
        free: names of values that are fitted beside `base`.
        small: whether the small errors of the masses that the joint carries are in it.
        outside: whether what acts outside the catalogue is.
        train: mean square error on the train records over the signal's variance.
        test: the same on the test record.
    """

    joint: int
    drive: Drive
    free: tuple[str, ...] = ()
    small: bool = False
    outside: bool = False
    train: float = np.inf
    test: float = np.inf


class OneByOne:
    """Joints of an arm, each by itself.

    Args:
        arm: the arm.
        motions: its records, the last for the test.
        angles: what was measured in them, (T, n) each [rad].
        nominal: what the joints carry by the description.
        small: what they carry beyond it by small errors of masses.
        mass: what they carry beyond it for a share of 1 of `Drive.mass`.
    """

    def __init__(
        self,
        arm: Arm,
        motions: Sequence[Motion],
        angles: Sequence[np.ndarray],
        nominal: Load,
        small: Load,
        mass: Load,
    ) -> None:
        self.servo, self.noise = arm.servo, arm.noise
        self.base = ("armature", "damping", "friction", *(("gain",) if arm.servo else ()))
        samples = len(motions[0].angle)
        length = min(round((SERVO_WINDOW if arm.servo else TORQUE_WINDOW) / SAMPLE), samples - 1)
        self.begins = np.arange(0, samples - length, length)
        self.length, records = length, len(motions)
        self.train = np.repeat(np.arange(records) < records - 1, len(self.begins))

        def windows(rows: np.ndarray) -> np.ndarray:
            """(R, T, n) as (W, n, R windows)."""
            parts = np.stack([rows[:, b : b + length] for b in self.begins], axis=1)
            return parts.reshape(-1, length, rows.shape[-1]).transpose(1, 2, 0)

        def between(name: str) -> np.ndarray:
            return windows(np.stack([getattr(one, name)[:-1] for one in motions]))

        self.commands = np.repeat(np.stack([one.command for one in motions]), len(self.begins), axis=0)
        self.command, self.torque, self.factor = between("command"), between("torque"), between("factor")
        measured = np.stack(angles)
        self.measured = windows(measured[:, 1:])
        self.variance = measured[:-1].var(axis=1).mean(axis=0), measured[-1:].var(axis=1).mean(axis=0)
        self.start = between("angle")[0], between("speed")[0]
        self.nominal, self.small, self.mass = (
            Load(*(windows(getattr(load, f.name)) for f in fields(Load))) for load in (nominal, small, mass)
        )

    def fit(self, fits: Sequence[Fit], rounds: int) -> list[Fit]:
        """Fit drives to the train records, each from where it stands."""
        found: dict[int, Fit] = {}
        kinds = [
            (bool(d.twist), bool(d.delay), bool(np.isfinite(d.rate))) for d in (one.drive for one in fits)
        ]
        for kind in sorted(set(kinds)):  # each as little work as it needs
            rows = [k for k, own in enumerate(kinds) if own == kind]
            widest = max((len(fits[k].free) for k in rows), default=0) + len(self.base) + 1
            room = max(1, LANES // (widest * len(self.train)))
            for begin in range(0, len(rows), room):
                own = rows[begin : begin + room]
                found |= dict(zip(own, self._fit([fits[k] for k in own], rounds), strict=True))
        return [found[k] for k in range(len(fits))]

    def _fit(self, fits: Sequence[Fit], rounds: int) -> list[Fit]:
        names = [(*self.base, *one.free) for one in fits]
        drives, running = [one.drive for one in fits], list(range(len(fits)))
        for _ in range(rounds):
            some = [fits[k] for k in running]
            nudged = [
                [drives[k], *(_changed(drives[k], names[k], NUDGE * unit) for unit in np.eye(len(names[k])))]
                for k in running
            ]
            left, moved = self._residuals(some, nudged), []
            for own, k in zip(left, running, strict=True):
                slopes = (own[1 : 1 + len(names[k])] - own[0]) / NUDGE
                normal, right = slopes @ slopes.T, slopes @ own[0]
                size = np.diag(np.diag(normal)) + (1e-9 * np.trace(normal) + 1e-12) * np.eye(len(right))
                steps = [
                    np.clip(np.linalg.solve(normal + d * size, -right), -WIDEST, WIDEST) for d in DAMPINGS
                ]
                moved.append([drives[k], *(_changed(drives[k], names[k], step) for step in steps)])
            costs = np.mean(self._residuals(some, moved) ** 2, axis=-1)
            for own, tried, k in zip(costs, moved, running, strict=True):
                drives[k] = tried[int(np.argmin(own))]
            running = [k for k, own in zip(running, costs, strict=True) if own[0] - own.min() > GAIN * own[0]]
            if not running:
                break
        error = self._errors(fits, [[own] for own in drives])[:, :, 0]  # (W, K, N)
        result = []
        for k, (one, own) in enumerate(zip(fits, drives, strict=True)):
            squares = np.nan_to_num(np.clip(error[:, k], -RUNAWAY, RUNAWAY), nan=RUNAWAY) ** 2
            train, test = (
                float(np.mean(squares[:, rows]) / variance[one.joint])
                for rows, variance in zip((self.train, ~self.train), self.variance, strict=True)
            )
            result.append(replace(one, drive=own, train=train, test=test))
        return result

    def _residuals(self, fits: Sequence[Fit], drives: Sequence[Sequence[Drive]]) -> np.ndarray:
        """Errors (K, P, samples) on the train records in standard deviations of the noise."""
        most = TRUNCATED * self.noise
        error = self._errors(fits, drives)[..., self.train]
        error = np.clip(np.nan_to_num(error, nan=most), -most, most) / self.noise
        return np.moveaxis(error, 0, 2).reshape(*error.shape[1:3], -1)

    def _errors(self, fits: Sequence[Fit], drives: Sequence[Sequence[Drive]]) -> np.ndarray:
        """Simulated less measured angles (W, K, P, N) [rad] of drives, as many a fit."""
        widest = max(map(len, drives))
        padded = [[*own, *[own[0]] * (widest - len(own))] for own in drives]
        values = {
            f.name: np.array([[getattr(d, f.name) for d in own] for own in padded], float)[..., None]
            for f in fields(Drive)
        }
        joints = [one.joint for one in fits]
        small, outside = (
            np.array([getattr(f, n) for f in fits], float)[:, None, None] for n in ("small", "outside")
        )
        with np.errstate(all="ignore"):
            angle = self._replay(joints, Drive(**values), small, outside)
            return angle - self.measured[:, joints][:, :, None]

    def _replay(self, joints: list[int], drive: Drive, small: np.ndarray, acting: np.ndarray) -> np.ndarray:
        """Angles as they would be read (W, K, P, N) [rad]."""
        dt, soft = SAMPLE / SUBSTEPS, bool(np.any(drive.twist))
        shape = (*np.broadcast_shapes(drive.gain.shape, (1, 1, len(self.train))),)
        angle = np.broadcast_to(self.start[0][joints][:, None], shape).copy()
        speed = np.broadcast_to(self.start[1][joints][:, None], shape).copy()
        rotor, turning = angle.copy(), speed.copy()
        aims, found = self._aims(joints, drive), np.zeros((self.length, *shape))

        def of(load: Load, name: str, w: int) -> np.ndarray:
            return getattr(load, name)[w, joints][:, None]

        def both(name: str, w: int) -> np.ndarray:
            return (
                of(self.nominal, name, w)
                + small * of(self.small, name, w)
                + drive.mass * of(self.mass, name, w)
            )

        if soft:  # at rest, the gear is as far wound up as its load asks for
            rotor = angle + both("torque", 0) / drive.twist
        for w in range(self.length):
            inertia, pull, slope = (both(name, w) for name in ("inertia", "torque", "slope"))
            middle, outside = of(self.nominal, "angle", w), acting * self.torque[w, joints][:, None]
            factor = 1.0 + acting * (self.factor[w, joints][:, None] - 1.0)
            command = self.command[w, joints][:, None]
            for s in range(SUBSTEPS):
                aim = command if aims is None else aims[w * SUBSTEPS + s]
                motor = drive.gain * (aim - angle) if self.servo else np.broadcast_to(aim, shape)
                level = factor * drive.dry(angle, turning if soft else speed, motor)
                given = motor + drive.push(angle) + outside
                carried = pull + slope * (angle - middle)
                if soft:
                    wound = drive.twist * (rotor - angle) + TWIST_DAMPING * drive.twist * (turning - speed)
                    turning = _braked(turning, given - wound, drive.armature, drive.damping, level, dt)
                    speed = speed + dt * (wound - carried) / inertia
                    rotor = rotor + dt * turning
                else:
                    whole = inertia + drive.armature
                    speed = _braked(speed, given - carried, whole, drive.damping, level, dt)
                angle = angle + dt * speed
            found[w] = angle + drive.zero
        return found

    def _aims(self, joints: list[int], drive: Drive) -> np.ndarray | None:
        """What is followed of the command, (W SUBSTEPS, K, P, N); None where that is the command itself."""
        if not np.any(drive.delay) and not np.any(np.isfinite(drive.rate)):
            return None
        dt, rows = SAMPLE / SUBSTEPS, np.arange(len(self.train))
        own = self.commands[:, :, joints].transpose(2, 0, 1)  # (K, N, T)
        first = np.tile(self.begins, len(rows) // len(self.begins))
        steps = np.arange(-int(self.begins[-1]) * SUBSTEPS, self.length * SUBSTEPS)
        late, fits = drive.delay / dt, np.arange(len(joints))[:, None, None]
        whole, part = np.floor(late), late % 1.0
        followed, found = (
            None,
            np.zeros((self.length * SUBSTEPS, *np.broadcast_shapes(late.shape, (1, 1, len(rows))))),
        )
        for step in steps:  # from the record's begin, for a goal that is limited in rate knows all before
            newer, older = (
                own[fits, rows, np.maximum(np.floor((first * SUBSTEPS + step - n) / SUBSTEPS), 0).astype(int)]
                for n in (whole, whole + 1)
            )
            aim = newer + part * (older - newer)
            followed = (
                aim
                if followed is None
                else followed + np.clip(aim - followed, -drive.rate * dt, drive.rate * dt)
            )
            if step >= 0:
                found[step] = followed
        return found


def _braked(speed: Any, torque: Any, inertia: Any, damping: Any, level: Any, dt: float) -> Any:
    """Speed after a step under a torque, viscous and dry friction taken at its end."""
    free = (speed + dt * torque / inertia) / (1.0 + dt * damping / inertia)
    return np.sign(free) * np.maximum(np.abs(free) - dt * level / (inertia + dt * damping), 0.0)


def _changed(drive: Drive, names: Sequence[str], step: np.ndarray) -> Drive:
    """A drive a step further: positive values by a factor, others by what they are measured by."""
    values: dict[str, float] = {}
    for name, own in zip(names, step, strict=True):
        before = float(getattr(drive, name))
        if name in SIGNED:
            values[name] = before + SIGNED[name](drive) * float(own)
        else:
            values[name] = before * float(np.exp(own))
    return replace(drive, **values)
