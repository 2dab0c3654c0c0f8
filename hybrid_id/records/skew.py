"""Skew between redundant channels: a sensor that is recorded later than others which tell the same.

Three relations hold whatever load, friction and inertia are, so that a lag in them is the recording's and no physics:

- a speed is the derivative of its angle: ``v(t) = b dq/dt(t - s)``;
- two encoders on one joint move together: ``q_a(t) = b q_m(t - s)``, with compliance and hysteresis of the gear;
- a motor's current (or torque) follows voltage and speed, ``i + T_e di/dt = a u(t - s_u) - b w(t - s_w)`` with
  ``T_e = L / R``. A late current lags behind both; behind the voltage alone it is the command that acts late, which is
  physics (the effect ``delay``); an angle that is read late lags behind both current and voltage. A threshold of the
  driver, a supply that gives way and a winding that warms up are fitted beside it: they look like a lag behind w.

Each is fitted in the frequency domain, where a lag is a slope of the phase, over Hann windows of the train records
(Pintelon and Schoukens, System Identification, 2012, ch. 2). Standard errors come from the scatter between windows.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import shift, uniform_filter1d
from scipy.optimize import least_squares

from hybrid_id.records.dataset import Dataset
from hybrid_id.records.measures import estimate_noise
from hybrid_id.records.record import Record
from hybrid_id.records.resample import find_gaps
from hybrid_id.records.units import stem

SURE = 5.0
"""Standard errors from zero from which a skew is believed; windows overlap, and a drive is never quite linear."""
MATTERS = 0.1
"""Skew in sample times below which it is left as it is."""
WINDOWS = 8
"""Windows that a record is cut into, which overlap by half."""
LEAST, FEWEST = 128, 4
"""Samples of the shortest window, and windows that a standard error needs."""
ROUNDS = 6
"""Rounds of a fit, each with the lags that the one before has found."""
HIGHEST = 0.25
"""Highest frequency used, in sampling frequencies: beyond, a held command and an interpolated one differ."""
ABOVE_NOISE = 10.0
"""Power of a signal over that of its noise from which a frequency counts."""
EXPLAINED = 0.9
"""Share of a channel's power that the relation has to explain."""
DOMINATES = 3.0
"""RMS of what a skew does to two encoders over that of compliance and hysteresis, which can look like one."""


@dataclass(frozen=True)
class Skew:
    """One channel that is recorded late (or early) against others of the same joint.

    Attributes:
        channel: Its name.
        late: How much later than the others it is recorded [s]; negative where it is early.
        std_error: Standard error of ``late`` [s].
        against: Names of the others.
    """

    channel: str
    late: float
    std_error: float
    against: tuple[str, ...]

    @property
    def message(self) -> str:
        """What was found, and the line of `dataset.yaml` that removes it."""
        way = "late" if self.late > 0 else "early"
        return (
            f"{self.channel} is recorded {1e3 * abs(self.late):.3g} ms (standard error "
            f"{1e3 * self.std_error:.1g} ms) {way} against {' and '.join(self.against)}; shift it before anything is "
            f"fitted: 'skew: {self.late:.3g}' for {self.channel} in dataset.yaml"
        )


def find_skews(dataset: Dataset) -> list[Skew]:
    """Skews between redundant channels of each joint that are surely there and matter; train records alone are read.

    The encoders come first, then the current with their skew removed: a channel is named once.
    """
    found: list[Skew] = []
    numbers = sorted({channel.name.removeprefix(stem(channel.name)) for channel in dataset.outputs})
    for number in numbers:
        for compare in (_speed_and_angle, _two_encoders, _current_and_motion):
            for side in ("m", "a"):
                skew = compare(dataset, number, side)
                if skew is not None and skew.channel not in {one.channel for one in found}:
                    found.append(skew)
                    dataset = dataset.without_skew({skew.channel: skew.late})
    return found


def _speed_and_angle(dataset: Dataset, number: str, side: str) -> Skew | None:
    """A logged speed against the derivative of the angle on the same side of the gear."""
    v, q = f"v_{side}{number}", f"q_{side}{number}"
    if not {v, q} <= {channel.name for channel in dataset.outputs}:
        return None
    fit = _fit(
        [
            _Relation(cut, cut.of(v), [cut.rates[q]], cut.loud(v) & cut.loud(q, rate=True))
            for cut in _windows(dataset)
        ],
        lagged=1,
    )
    return None if fit is None else _sure(v, q, fit.lag[0], fit.error[0], dataset)


def _two_encoders(dataset: Dataset, number: str, side: str) -> Skew | None:
    """The encoder at the link against that at the motor; beside a lag, compliance and hysteresis of the gear."""
    names = {channel.name for channel in dataset.outputs}
    kind = "q" if {f"q_m{number}", f"q_a{number}"} <= names else "v"
    motor, link = f"{kind}_m{number}", f"{kind}_a{number}"
    if side == "a" or not {motor, link} <= names:
        return None
    relations = []
    for cut in _windows(dataset):
        rate = cut.rates[motor] if kind == "q" else cut.signals[motor]
        turned = np.zeros_like(rate)
        if kind == "q":  # by the change over nine samples, where it does not drown in noise
            values = np.pad(cut.signals[motor], 4, mode="edge")
            change = values[8:] - values[:-8]
            turned = np.sign(np.where(np.abs(change) > 5.0 * estimate_noise(values), change, 0.0))
        bent = np.gradient(rate, cut.step)
        relations.append(
            _Relation(cut, cut.of(link), [cut.signals[motor], bent, turned], cut.loud(motor) & cut.loud(link))
        )
    fit = _fit(relations, lagged=1)
    if fit is None:
        return None
    late, elastic = (
        np.abs(fit.gain[0] * fit.lag[0]) * fit.rates[0],
        fit.gain[1:] @ fit.gram[1:, 1:] @ fit.gain[1:],
    )
    if late < DOMINATES * np.sqrt(elastic):
        return None
    return _sure(link, motor, fit.lag[0], fit.error[0], dataset)


def _current_and_motion(dataset: Dataset, number: str, side: str) -> Skew | None:
    """A measured current (or torque) against voltage and speed; a late current lags behind both."""
    outputs = {channel.name for channel in dataset.outputs}
    inputs = {channel.name for channel in dataset.inputs}
    current = next((name for name in (f"i{number}", f"tau{number}") if name in outputs), None)
    angle = next((name for name in (f"q_{side}{number}", f"v_{side}{number}") if name in outputs), None)
    voltage = [f"u{number}"] if f"u{number}" in inputs else [f"duty{number}", f"supply{number}"]
    voltage = voltage if set(voltage) <= inputs or voltage[0] in inputs else []
    other_side = side == "a" and any(f"{kind}_m{number}" in outputs for kind in "qv")
    if current is None or angle is None or not voltage or other_side:
        return None
    relations = []
    for cut in _windows(dataset, switch=f"enable{number}"):
        drive = np.prod([cut.signals[name] for name in voltage if name in cut.signals], axis=0)
        speed = cut.rates[angle] if angle.startswith("q") else cut.signals[angle]
        # What no driver is without: a threshold, a supply that gives way, a winding that warms up.
        smooth = uniform_filter1d(cut.signals[current], 5, mode="nearest")
        threshold = np.tanh(smooth / (0.1 * np.std(cut.signals[current]) + 1e-300))
        warming = drive * np.linspace(-1.0, 1.0, drive.size)
        signals = [drive, speed, threshold, drive * np.abs(drive), warming]
        heard = [np.ones_like(cut.omega)] * len(signals)
        heard[1] = cut.loud(angle, rate=angle[0] == "q")
        relations.append(_Relation(cut, cut.of(current), signals, cut.loud(current), heard))
    fit = _fit(relations, lagged=2, first_order=True)
    if fit is None:
        return None
    # What lags behind both alike may be the winding's time constant: its square, 3 standard errors either way. A
    # current sampled within the step of a held command has a mix of two commands, which looks like up to h / 2 of it.
    step = _step(dataset)
    low, high = (np.sqrt(max(fit.square + way * 3.0 * fit.square_error, 0.0)) for way in (-1.0, 1.0))
    winding = np.sqrt(fit.square) if low > 0.5 * step else 0.0
    behind_voltage, lag = fit.lag - winding
    error = float(np.hypot(fit.error[1], (high - winding) / 3.0))
    reach = SURE * fit.error[1] + MATTERS * step
    if not (fit.lag[1] - high > reach or fit.lag[1] - (low if winding else 0.0) < -reach):
        return None
    slack = 0.3 * step + 3.0 * error
    command = voltage[0]
    if lag > 0 and behind_voltage > lag - slack:
        return Skew(current, float(min(lag, behind_voltage)), error, (command, angle))
    if lag < 0 and behind_voltage > -slack:
        return Skew(angle, float(-lag), error, (command, current))
    if lag < 0 and behind_voltage < lag + slack:
        return Skew(current, float(lag), error, (command, angle))
    return None


def _sure(channel: str, other: str, lag: float, error: float, dataset: Dataset) -> Skew | None:
    """The skew where it is surely there and matters; of two channels, the late one is named."""
    if abs(lag) < max(SURE * error, MATTERS * _step(dataset)):
        return None
    late, prompt = (channel, other) if lag > 0 else (other, channel)
    return Skew(late, float(abs(lag)), float(error), (prompt,))


def _step(dataset: Dataset) -> float:
    """Sample time of the train records [s]."""
    return dataset.sample_time or float(np.median([record.sample_time for record in dataset.train]))


class _Windows:
    """One record on a uniform grid, cut into S Hann windows, of whose transforms F frequencies are used.

    Attributes:
        step: [s].
        signals: channel -> values (T,).
        rates: output -> derivative (T,).
        omega: frequencies [rad/s], (F,), zero and the next left out.
    """

    def __init__(self, record: Record, switch: str) -> None:
        self.step = record.sample_time
        grid = record.time[0] + self.step * np.arange(int(record.duration / self.step + 0.5) + 1)
        held = np.clip(np.searchsorted(record.time, grid + 0.01 * self.step, side="right") - 1, 0, None)
        self.signals = {name: values[held] for name, values in record.inputs.items()}
        self.signals |= {
            name: np.interp(grid, record.time, values) for name, values in record.outputs.items()
        }
        self.rates = {name: _rate(self.signals[name], self.step) for name in record.outputs}
        length = max(min(LEAST, grid.size), 2 * grid.size // (WINDOWS + 1))
        on = self.signals.get(switch, np.ones(grid.size)) > 0.5
        starts = range(0, grid.size - length + 1, max(length // 2, 1))
        self.cuts = [slice(first, first + length) for first in starts if on[first : first + length].all()]
        self.hann = np.hanning(length + 1)[:-1]
        omega = 2 * np.pi * np.fft.rfftfreq(length, self.step)
        self.kept = slice(2, int(np.searchsorted(omega, HIGHEST * 2 * np.pi / self.step)))
        self.omega = omega[self.kept]

    def of(self, values: str | np.ndarray, lag: float = 0.0) -> np.ndarray:
        """Transforms (S, F) of a channel or of values (T,), taken ``lag`` [s] earlier."""
        values = self.signals[values] if isinstance(values, str) else values
        values = shift(values, lag / self.step, order=3, mode="nearest") if lag else values
        parts = np.stack([values[cut] for cut in self.cuts])
        return np.fft.rfft(self.hann * (parts - parts.mean(axis=1, keepdims=True)))[:, self.kept]

    def loud(self, channel: str, *, rate: bool = False) -> np.ndarray:
        """Frequencies (F,) bool at which a channel, or its derivative, stands out of its noise."""
        noise = estimate_noise(self.signals[channel]) ** 2 * np.sum(self.hann**2)
        power = np.abs(self.of(self.rates[channel] if rate else channel)) ** 2
        return power.mean(axis=0) > ABOVE_NOISE * noise * (self.omega**2 if rate else 1.0)


def _rate(values: np.ndarray, step: float) -> np.ndarray:
    """Derivative (T,) of samples, by central differences of fourth order."""
    inner = (8 * (values[3:-1] - values[1:-3]) - (values[4:] - values[:-4])) / (12 * step)
    return np.concatenate([np.gradient(values[:3], step)[:2], inner, np.gradient(values[-3:], step)[1:]])


def _windows(dataset: Dataset, switch: str = "") -> Iterator[_Windows]:
    """The train records without gaps, those left out that never run long enough with the motor on."""
    for record in dataset.train:
        if record.n_samples >= LEAST and not find_gaps(record):
            cut = _Windows(record, switch)
            if cut.cuts:
                yield cut


@dataclass(frozen=True, eq=False)
class _Relation:
    """In one record, what is explained (S, F), the signals (T,) that explain it, and the frequencies used (F,).

    ``heard`` (F,) says for each signal where it counts; empty: everywhere.
    """

    cut: _Windows
    y: np.ndarray
    signals: Sequence[np.ndarray]
    used: np.ndarray
    heard: Sequence[np.ndarray] = ()

    def spectra(self, lags: Sequence[float]) -> np.ndarray:
        """Transforms of the signals, each taken so much earlier [s], at the frequencies used of all windows."""
        heard = self.heard or [np.ones_like(self.cut.omega)] * len(self.signals)
        parts = [self.cut.of(x, lag) * where for x, lag, where in zip(self.signals, lags, heard, strict=True)]
        return np.stack([part[:, self.used].ravel() for part in parts])


@dataclass(frozen=True, eq=False)
class _Fit:
    """A fitted relation.

    Attributes:
        gain: of each signal.
        lag: of the first ones [s], and ``error``, their standard errors.
        square: of the time constant [s^2], and ``square_error``, its standard error.
        gram: inner products of the signals.
        rates: norms of the derivatives of those with a lag.
    """

    gain: np.ndarray
    lag: np.ndarray
    error: np.ndarray
    square: float
    square_error: float
    gram: np.ndarray
    rates: np.ndarray


def _errors_by_window(
    jacobian: np.ndarray, residual: np.ndarray, window: np.ndarray, count: int
) -> np.ndarray:
    """Standard errors ``(p,)`` of an estimate, by the scatter of its windows' scores.

    Args:
        jacobian: ``(2 N, p)``, real parts before imaginary ones.
        residual: ``(2 N,)``.
        window: number of the window of each frequency, ``(N,)``.
        count: windows.
    """
    scores = np.zeros((count, jacobian.shape[1]))
    np.add.at(scores, np.concatenate([window, window]), jacobian * residual[:, None])
    inverse = np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)
    freedom = count / max(count - jacobian.shape[1], 1)
    return np.sqrt(np.diag(inverse @ (scores.T @ scores) @ inverse) * freedom)


def _fit(relations: Sequence[_Relation], *, lagged: int, first_order: bool = False) -> _Fit | None:
    """Least squares of ``y(t) = sum_j g_j x_j(t - s_j)``, the first ``lagged`` signals with a lag.

    With ``first_order`` all pass ``1 / (1 + i w T)`` too, and the lags include T: what is left of it,
    ``exp(i w T) / (1 + i w T)``, depends on T^2 and is smooth at zero. Lags found are applied in time and
    fitted again, since a window does not commute with a shift. None where too little is there, or is explained.
    """
    relations = [one for one in relations if one.used.any()]
    if sum(len(one.y) for one in relations) < FEWEST:
        return None
    y = np.concatenate([one.y[:, one.used].ravel() for one in relations])
    omega = np.concatenate([np.tile(one.cut.omega[one.used], len(one.y)) for one in relations])
    sizes = [int(one.used.sum()) for one in relations for _ in one.y]
    window = np.repeat(np.arange(len(sizes)), sizes)
    count = len(relations[0].signals)
    unit, size = relations[0].cut.step, float(np.linalg.norm(y))
    turn = omega * unit

    def spectra(lags: np.ndarray) -> np.ndarray:  # (n, N)
        return np.concatenate([one.spectra([*lags, *np.zeros(count - lagged)]) for one in relations], axis=1)

    scale = np.linalg.norm(spectra(np.zeros(lagged)), axis=1)
    if size == 0.0 or not scale[:lagged].all():
        return None
    scale[scale == 0.0] = 1.0

    def error(p: np.ndarray, x: np.ndarray) -> np.ndarray:
        lags = np.concatenate([p[count : count + lagged], np.zeros(count - lagged)])
        model = np.sum(p[:count, None] * x * np.exp(-1j * lags[:, None] * turn), axis=0)
        if first_order:
            constant = np.sqrt(max(p[-1], 0.0)) * turn
            model = model * np.exp(1j * (constant - np.arctan(constant)))
            model /= np.sqrt(np.maximum(1.0 + p[-1] * turn**2, 0.1))
        left = y / size - model
        return np.concatenate([np.real(left), np.imag(left)])

    applied = np.zeros(lagged)
    for _ in range(ROUNDS):
        x = spectra(applied) / scale[:, None]
        stacked = np.concatenate([np.real(x), np.imag(x)], axis=1).T
        gains = np.linalg.lstsq(stacked, np.concatenate([np.real(y), np.imag(y)]) / size, rcond=None)[0]
        start = np.concatenate([gains, np.zeros(lagged), np.full(int(first_order), 1e-6)])
        found = least_squares(error, start, x_scale="jac", max_nfev=60, args=(x,))
        more = found.x[count : count + lagged] * unit
        applied = applied + more
        if np.all(np.abs(more) < 0.01 * unit):
            break
    if np.sum(found.fun**2) > 1.0 - EXPLAINED:
        return None
    spread = _errors_by_window(found.jac, found.fun, window, len(sizes))
    original = x * scale[:, None]
    return _Fit(
        gain=found.x[:count] * size / scale,
        lag=applied,
        error=spread[count : count + lagged] * unit,
        square=float(found.x[-1]) * unit**2 if first_order else 0.0,
        square_error=float(spread[-1]) * unit**2 if first_order else 0.0,
        gram=(original @ original.conj().T).real,
        rates=np.linalg.norm(omega * original[:lagged], axis=1),
    )
