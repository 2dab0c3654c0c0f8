"""Pulses of torque that nobody commanded: at which joint, when, how large, at a rate of false alarms fixed before.

From a measured state the fitted model predicts the next one; what it misses is the torque that acted in between. A
torque pulse of Gaussian shape is fitted to that series at every instant, beside a constant and a slope, so that what
drifts slowly is no pulse; the largest fit in units of its standard error is the statistic (a bank of matched filters).
The model's parameters are first moved to where they explain most of unperturbed records. Noise level and threshold come
from those records too: median absolute deviation, and an exponential tail of the statistic's peaks.

Sources: A. S. Willsky and H. L. Jones, "A generalized likelihood ratio approach to the detection and estimation of
jumps in linear systems", IEEE Trans. Automatic Control 21 (1976), here for pulses of unknown width; J. Pickands,
"Statistical inference using extreme order statistics", Annals of Statistics 3 (1975), for peaks over a threshold.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.ndimage import correlate1d
from scipy.signal import find_peaks

from hybrid_id.components.load.constant_torque import ConstantTorque
from hybrid_id.errors import InputError
from hybrid_id.parameters import ParameterInfo
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.lifted import linearise
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.chain import System

WIDTHS = (0.05, 0.07, 0.1)
"""Standard deviations [s] of the pulses that are looked for."""
HALF_LENGTH = 4.0
"""Half-length of a filter, in widths; pulses closer than this at one joint or to a record's end are not found."""
FADE = 2.5
"""Width of the weights within a filter, in widths of the pulse."""
TAIL = 0.7
"""Quantile of the peaks of unperturbed records from which on they are taken for an exponential tail."""
GAUSSIAN = 1.4826
"""Standard deviation over median absolute deviation."""
STEPS = 4
"""Gauss-Newton steps; most parameters enter linearly."""
TINY = 1e-12
"""Least noise [N m]: that of a simulation without any."""
RANK = 1e-4
"""Directions of the model's parameters that move the torque less than this, relative to the strongest, are left."""


@dataclass(frozen=True)
class Pulse:
    """A torque that acted beside the commanded ones.

    Attributes:
        record: name of the record.
        joint: ``joint1`` ...
        time: of its middle from the record's start [s].
        size: torque in its middle [N m] at the link, positive where it drives.
        width: standard deviation of its Gaussian shape [s].
        std: standard error of the size [N m], typical of the unperturbed records; where a model errs more than it
            typically does, the size does, too. The threshold allows for this, the standard error does not.
    """

    record: str
    joint: str
    time: float
    size: float
    width: float
    std: float


@dataclass(frozen=True, eq=False)
class Detector:
    """A search for pulses, calibrated on unperturbed records.

    Attributes:
        system: the model, its parameters where they meet the unperturbed records best.
        engine: how a sample is integrated.
        widths: of the pulses [s], ``(K,)``.
        noise: standard error of a size [N m], ``(n_joints, K)``.
        threshold: of the statistic size over standard error, ``(n_joints,)``.
    """

    system: System
    engine: Engine
    widths: tuple[float, ...]
    noise: np.ndarray
    threshold: np.ndarray

    def find(self, batch: Batch) -> list[Pulse]:
        """Pulses in records prepared as those of the calibration were, by record, joint and time."""
        found = []
        for one in missing_torques(self.system, self.engine, batch):
            sizes = _sizes(one, self.widths)
            for j, joint in enumerate(self.system.joints):
                ratio = np.abs(sizes[:, :, j]) / self.noise[j][:, None]
                for k in _peaks(ratio, one.step, self.widths, self.threshold[j]):
                    best = int(ratio[:, k].argmax())
                    # the torque acts between a sample and the next
                    time = (k + _margin(one.step, self.widths) + 0.5) * one.step
                    size, width, std = sizes[best, k, j], self.widths[best], self.noise[j, best]
                    found.append(Pulse(one.record, joint.name, float(time), float(size), width, float(std)))
        return found


def calibrate(
    system: System, engine: Engine, batch: Batch, *, widths: Sequence[float] = WIDTHS, rate: float = 1e-3
) -> Detector:
    """Noise level and threshold from unperturbed records; each is judged by a correction that the others gave.

    Args:
        system: fitted model.
        engine: see :func:`missing_torques`.
        batch: unperturbed records, best of the same task.
        widths: standard deviations of the pulses that are looked for [s].
        rate: false alarms a second that are accepted at each joint.

    Raises:
        InputError: one record only, records shorter than a filter, or a width below the sample time.
    """
    if batch.rows < 2:
        raise InputError(
            "A search for pulses needs at least two unperturbed records to calibrate on; give more."
        )
    widths = tuple(widths)
    for _ in range(STEPS):
        change = _change(*_equations(missing_torques(system, engine, batch), widths))
        system = moved(system, change)
    records = missing_torques(system, engine, batch)
    rows, sides = _equations(records, widths)
    sizes = []
    for i, one in enumerate(records):
        others = [k for k in range(len(records)) if k != i]
        change = _change([rows[k] for k in others], [sides[k] for k in others])
        sizes.append(_sizes(replace(one, torque=one.torque - one.own @ change), widths))
    noise = np.maximum(_deviation(np.concatenate(sizes, 1).swapaxes(0, 1)), TINY).T
    seconds = sum(one.shape[1] * record.step for one, record in zip(sizes, records, strict=True))
    threshold = []
    for j in range(noise.shape[0]):
        ratios = [np.abs(one[:, :, j]) / noise[j][:, None] for one in sizes]
        peaks = [
            ratio.max(0)[_peaks(ratio, record.step, widths)]
            for ratio, record in zip(ratios, records, strict=True)
        ]
        threshold.append(_threshold(np.concatenate(peaks), seconds, rate))
    return Detector(system, engine, widths, noise, np.array(threshold))


def _threshold(peaks: np.ndarray, seconds: float, rate: float) -> float:
    """Height that peaks with an exponential tail exceed at that rate [1/s]."""
    start = float(np.quantile(peaks, TAIL)) if len(peaks) else 0.0
    above = peaks[peaks > start]
    if len(above) == 0:
        raise InputError(
            "The unperturbed records are too short to fix a threshold; give more or longer ones."
        )
    return start + float((above - start).mean()) * max(0.0, float(np.log(len(above) / seconds / rate)))


def _equations(
    records: Sequence[Torques], widths: Sequence[float]
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Filtered columns of the model's own parameters and filtered torques, each joint in units of its noise."""
    width = sorted(widths)[len(widths) // 2]
    sides = [_sizes(one, (width,))[0] for one in records]
    rows = [_filtered(one.own, one.step, width, _margin(one.step, (width,))) for one in records]
    level = np.maximum(_deviation(np.concatenate(sides)), TINY)
    return [row / level[:, None] for row in rows], [side / level for side in sides]


def _change(rows: Sequence[np.ndarray], sides: Sequence[np.ndarray]) -> np.ndarray:
    """Change of the model's own parameters that explains most of filtered torques."""
    if not rows[0].shape[-1]:  # none is estimated
        return np.empty(0)
    a, b = np.concatenate(rows).reshape(-1, rows[0].shape[-1]), np.concatenate(sides).reshape(-1)
    size = np.maximum(np.linalg.norm(a, axis=0), 1e-300)
    return np.linalg.lstsq(a / size, b, rcond=RANK)[0] / size


def _sizes(one: Torques, widths: Sequence[float]) -> np.ndarray:
    """Least-squares size of a pulse in the middle of each stretch, ``(K, T', n_joints)`` [N m]."""
    margin = _margin(one.step, widths)
    if len(one.torque) <= 2 * margin:
        raise InputError(
            f"Record '{one.record}' is too short to look for pulses of {max(widths):g} s in; it needs "
            f"{2 * margin * one.step:.3g} s."
        )
    return np.stack([_filtered(one.torque, one.step, width, margin) for width in widths])


def _filtered(series: np.ndarray, step: float, width: float, margin: int) -> np.ndarray:
    """Coefficient of a Gaussian pulse beside a constant and a slope, fitted around each sample but the ends'."""
    half = _margin(step, (width,))
    if half < HALF_LENGTH:
        raise InputError(f"A pulse of {width:g} s is narrower than the sample time of {step:g} s.")
    time = np.arange(-half, half + 1) * step / width
    basis = np.stack([np.exp(-0.5 * time**2), np.ones_like(time), time], 1)
    weighted = basis * np.exp(-((time / FADE) ** 2))[:, None]
    kernel = np.linalg.solve(basis.T @ weighted, weighted.T)[0]
    return correlate1d(series, kernel, axis=0, mode="nearest")[margin : len(series) - margin]


def _margin(step: float, widths: Sequence[float]) -> int:
    return round(HALF_LENGTH * max(widths) / step)


def _peaks(ratio: np.ndarray, step: float, widths: Sequence[float], least: float = 0.0) -> np.ndarray:
    """Samples at which the largest of the ratios ``(K, T')`` peaks; the higher of two peaks within a filter's reach."""
    padded = np.pad(ratio.max(0), 1)  # a peak may lie at an end
    return find_peaks(padded, height=least, distance=_margin(step, widths))[0] - 1


def _deviation(series: np.ndarray) -> np.ndarray:
    """Standard deviation along the first axis from the median absolute value; robust to pulses."""
    return GAUSSIAN * np.median(np.abs(series), axis=0)


@dataclass(frozen=True, eq=False)
class Torques:
    """What a model misses of one record between samples, as torques at the links.

    Attributes:
        record: its name.
        step: sample time [s].
        torque: ``(T, n_joints)`` [N m]; 0 where a joint sticks, which identifies nothing.
        own: what each parameter of :func:`own_parameters` takes from it per unit, ``(T, n_joints, n_p)``.
    """

    record: str
    step: float
    torque: np.ndarray
    own: np.ndarray


@torch.no_grad()
def missing_torques(system: System, engine: Engine, batch: Batch) -> list[Torques]:
    """Torques at the links that lead the model from each sample's state exactly to the next one's speeds.

    Args:
        system: fitted model.
        engine: how a sample is integrated; smooth friction identifies more, since a joint that sticks hides a torque.
        batch: records with one sample time, prepared for the model; its states ``x`` are taken as measured.
    """
    parts = [f"{joint.name}/load" for joint in system.joints]
    opened = system
    for place in parts:
        if f"{place}/{ConstantTorque.kind}" not in system.components:
            opened = opened.with_component(place, ConstantTorque(T_0=0.0))
    index = {(o.component, o.symbol): i for i, o in enumerate(opened.table)}
    loads = [index[f"{place}/{ConstantTorque.kind}", "T_0"] for place in parts]
    own = [index[o.component, o.symbol] for o in own_parameters(system)]
    theta = opened.theta().detach()[:, None].expand(-1, batch.rows)
    lin = linearise(opened, engine, batch.x, batch.u, batch.dt, theta, [*loads, *own], batch.outputs)
    speeds = [joint.positions[-1] + 1 for joint in opened.joints]
    missed = (batch.x[:, 1:] - lin.x_next[:, :-1])[:, :, speeds]
    gains = lin.b[:, :-1][:, :, speeds]
    # a load opposes; a joint that sticks has no gain, and the least torque is none
    inverse = torch.linalg.pinv(-gains[..., : len(loads)], rtol=1e-6)
    torque = (inverse @ missed[..., None])[..., 0]
    columns = inverse @ gains[..., len(loads) :]
    found = []
    for row, name in enumerate(batch.names):
        used = batch.dt[row, :-1] > 0
        step = float(batch.dt[row, :-1][used].median())
        found.append(Torques(name, step, torque[row, used].numpy(), columns[row, used].numpy()))
    return found


def own_parameters(system: System) -> list[ParameterInfo]:
    """The parameters that may explain a missing torque: those of a fit, but for constant loads, which are no pulses."""
    return [o for o in system.table if o.spec.estimate and not o.component.endswith(ConstantTorque.kind)]


def moved(system: System, change: np.ndarray) -> System:
    """The system with its own parameters moved, within their bounds."""
    values = {
        o.name: float(np.clip(o.spec.value + step, o.spec.lower, o.spec.upper))
        for o, step in zip(own_parameters(system), change, strict=True)
    }
    return system.with_values(values)
