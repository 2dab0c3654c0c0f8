"""What a log's columns are, with the evidence for it: time and its unit, units of angles, signs, sampling, side.

Each function looks at numbers alone and returns a :class:`Guess`: what it takes them for, why, and whether that is
sure. `hybrid-id init` writes the guesses down; nothing here reads or writes files.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import uniform_filter1d

from hybrid_id.records.measures import quantisation_step
from hybrid_id.records.units import to_si

TIME_FACTORS = {unit: to_si(unit, "t")[1] for unit in ("s", "ms", "us", "ns")}
STEPS, SPANS = (5e-5, 0.25), (0.05, 1e5)
"""Sample times [s] and lengths of records [s] that are plausible."""
USUAL_STEP = 0.004
"""Of several plausible units of time, the one whose step is nearest to this one [s] is taken."""
ANGLE_FACTORS = {unit: to_si(unit, "q_m")[1] for unit in ("rad", "deg", "rev", "mrad")}
SPEED_FACTORS = {unit: to_si(unit, "v_m")[1] for unit in ("rad/s", "deg/s", "rpm", "rev/s")}
COUNTS = 4096
"""Counts a turn of the usual 12-bit encoder."""
JITTER = 0.01
"""Share of the median step by which steps may differ before resampling is proposed."""
FAR_OFF = 1.5
"""Factor by which a speed is off the derivative of its angle for its unit not to be the one of its name."""
FASTEST = 1500.0
"""Speed [rad/s] that hardly any motor exceeds."""
RELATED = 0.9
"""Correlation from which a column is taken for another one's derivative, or for its goal."""
PARTLY = 0.5
"""Correlation of a goal's error and the speed from which a lag is read off them."""
ALIKE = 3.0
"""Times by which the spans of a goal and its angle may differ."""
HARDLY = 0.05
"""Share of a joint's range that a joint moves by at least, in the log where it moves most."""
TURNS = tuple(
    sign * turn for turn in (math.pi, 2 * math.pi, 0.5 * math.pi, 1.5 * math.pi) for sign in (1, -1)
)
"""Offsets [rad] of encoders that count from elsewhere, in the order in which they are tried."""
OPPOSED = 0.3
"""Partial correlation of a command and the acceleration from which their sign is believed."""


@dataclass(frozen=True)
class Guess:
    """One thing that was concluded.

    Attributes:
        about: what it is about, ``unit of q_m1``.
        value: what is concluded, ``deg``.
        evidence: why.
        sure: whether the evidence leaves no reasonable other way.
    """

    about: str
    value: str
    evidence: str
    sure: bool = True


@dataclass(frozen=True)
class JointFacts:
    """What is known of a robot's joint: name, least and largest position [rad or m], kind, its loop, what ties it."""

    name: str
    low: float = -math.inf
    high: float = math.inf
    slide: bool = False
    servo: bool = False
    tied: str = ""

    @property
    def range(self) -> float:
        """Largest less least position; inf where nothing limits it."""
        return self.high - self.low


@dataclass(frozen=True)
class DriveFit:
    """``dv/dt = alpha x - beta v - gamma sgn v + a sin q + b cos q + c`` of a command x, fitted to a filtered record.

    Attributes:
        alpha: [unit of acceleration per unit of x].
        beta: [1/s].
        gamma: [unit of acceleration].
        partial: correlation of x and dv/dt once speed is taken out of both, from -1 to 1.
        explained: share of the acceleration's variance.
        gravity: size of what follows sine and cosine of the angle [unit of acceleration].
        hang: angle at which that would hang [rad].
        weight: share of the acceleration's variance that nothing but it explains.
    """

    alpha: float
    beta: float
    gamma: float
    partial: float
    explained: float
    gravity: float = 0.0
    hang: float = 0.0
    weight: float = 0.0


def is_time(values: np.ndarray) -> bool:
    """Whether a column can be one of stamps: finite and increasing, in steps that hardly differ."""
    steps = np.diff(values)
    if values.size < 4 or not np.isfinite(values).all() or not (steps > 0).all():
        return False
    return bool(np.percentile(steps, 75) < 4.0 * max(np.percentile(steps, 25), 1e-300))


def time_unit(values: np.ndarray, said: str = "") -> Guess:
    """Unit of stamps by what the name says, or by plausible step and span.

    Args:
        values: stamps (T,).
        said: unit in the column's name; empty where there is none.
    """
    step, span = float(np.median(np.diff(values))), float(values[-1] - values[0])
    fits = [
        unit
        for unit, factor in TIME_FACTORS.items()
        if STEPS[0] <= step * factor <= STEPS[1] and SPANS[0] <= span * factor <= SPANS[1]
    ]
    if said in TIME_FACTORS:
        factor = TIME_FACTORS[said]
        words = f"its name says so; step {_si(step * factor, 's')}, span {span * factor:.4g} s"
        return Guess("unit of time", said, words, said in fits)
    if not fits:
        return Guess(
            "unit of time", "s", f"no unit gives a plausible step: median {step:.4g}, span {span:.4g}", False
        )
    best = min(fits, key=lambda unit: abs(math.log(step * TIME_FACTORS[unit] / USUAL_STEP)))
    factor = TIME_FACTORS[best]
    words = f"median step {step:.6g} is {_si(step * factor, 's')}, span {span * factor:.4g} s"
    others = [unit for unit in fits if unit != best]
    if others:
        words += f"; {' or '.join(others)} would be possible, too"
    return Guess("unit of time", best, words, not others)


def sampling(records: Sequence[np.ndarray]) -> Guess:
    """Whether stamps [s] are uniform over all records, or resampling is to be proposed."""
    medians = [float(np.median(np.diff(time))) for time in records]
    spread = max(
        float(np.max(np.abs(np.diff(time) / middle - 1.0)))
        for time, middle in zip(records, medians, strict=True)
    )
    rate = f"{1.0 / float(np.median(medians)):.4g} Hz (median step {_si(float(np.median(medians)), 's')})"
    if spread <= JITTER and max(medians) <= (1.0 + JITTER) * min(medians):
        return Guess("sampling", "uniform", f"{rate}, steps within {100 * spread:.2g} %")
    far = max(
        float(np.percentile(np.abs(np.diff(time) / middle - 1.0), 95))
        for time, middle in zip(records, medians, strict=True)
    )
    words = f"{rate}, steps off by up to {100 * spread:.3g} % (95 % of them within {100 * far:.2g} %)"
    return Guess("sampling", "resample", words)


def smoothed(values: np.ndarray, width: int) -> np.ndarray:
    """Two running means over ``width`` samples; values beyond the ends are those at the ends."""
    return uniform_filter1d(uniform_filter1d(values, width, mode="nearest"), width, mode="nearest")


def rate_of(time: np.ndarray, values: np.ndarray, width: int = 5) -> np.ndarray:
    """Derivative (T,) of a filtered signal."""
    return np.gradient(smoothed(values, width), time)


def correlation(one: np.ndarray, other: np.ndarray) -> float:
    """Correlation of two signals; 0 where one stands still."""
    a, b = one - one.mean(), other - other.mean()
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(a @ b) / size if size > 0.0 else 0.0


def derivative_ratio(time: np.ndarray, angle: np.ndarray, speed: np.ndarray) -> tuple[float, float]:
    """How many times the derivative of an angle is a speed, and the correlation of the two."""
    best = (0.0, 0.0)
    for width in (3, 9, 25):
        if time.size < 4 * width:
            break
        rate, slow = rate_of(time, angle, width), smoothed(speed, width)
        related = correlation(rate, slow)
        if abs(related) > abs(best[1]):
            slow = slow - slow.mean()
            best = float(slow @ (rate - rate.mean())) / max(float(slow @ slow), 1e-300), related
    return best


def follows(time: np.ndarray, goal: np.ndarray, angle: np.ndarray) -> float:
    """Correlation of a goal with the angle, at the delay up to 0.5 s where its size is largest."""
    step = float(np.median(np.diff(time)))
    most = min(int(0.5 / max(step, 1e-9)), time.size // 4)
    lags = sorted({round(k * most / 12) for k in range(13)})
    found = [correlation(goal[: goal.size - k], angle[k:]) for k in lags]
    return max(found, key=abs)


def drive_fit(
    time: np.ndarray, command: np.ndarray, angle: np.ndarray, *, speed: bool = False
) -> DriveFit | None:
    """Fit the acceleration by command, speed and dry friction, all through the same filter, the one that fits best.

    Args:
        time: stamps [s], (T,).
        command: (T,).
        angle: [rad], (T,), or the speed itself where ``speed``.
        speed: whether ``angle`` is a speed.

    Returns:
        None where the record is too short or nothing moves.
    """
    best = None
    for width in (3, 5, 9, 17, 33):
        if time.size < 12 * width:
            break
        v = smoothed(angle, width) if speed else rate_of(time, angle, width)
        x, a = smoothed(command, width), np.gradient(v, time)
        sign = smoothed(np.sign(np.where(np.abs(v) > 0.02 * np.max(np.abs(v)), v, 0.0)), width)
        inner = slice(2 * width, -2 * width)
        weight = [] if speed else [smoothed(wave(angle), width) for wave in (np.sin, np.cos)]
        columns = np.stack([x, -v, -sign, np.ones_like(x), *weight])[:, inner].T
        scale = np.linalg.norm(columns, axis=0)
        y = a[inner]
        total = float(np.sum((y - y.mean()) ** 2))
        if not scale.all() or total == 0.0:
            continue
        gains = np.linalg.lstsq(columns / scale, y, rcond=None)[0] / scale
        left_over = float(np.sum((y - columns @ gains) ** 2))
        explained = 1.0 - left_over / total
        others = columns[:, 1:]
        left = [
            signal - others @ np.linalg.lstsq(others, signal, rcond=None)[0] for signal in (columns[:, 0], y)
        ]
        alpha, beta, gamma = (float(gain) for gain in gains[:3])
        fit = DriveFit(alpha, beta, gamma, correlation(left[0], left[1]), explained)
        if weight:
            light = columns[:, :4]
            without = float(np.sum((y - light @ np.linalg.lstsq(light, y, rcond=None)[0]) ** 2))
            size, hang = float(np.hypot(*gains[4:])), float(np.arctan2(gains[5], -gains[4]))
            fit = replace(fit, gravity=size, hang=hang, weight=(without - left_over) / total)
        if best is None or fit.explained > best.explained:
            best = fit
    return best


def goal_lag(time: np.ndarray, goal: np.ndarray, angle: np.ndarray) -> float:
    """How late [s] an angle follows its goal in steady motion, a loop's damping over its stiffness; 0 where it is open.

    The error ``goal - angle`` of slow motion is ``lag v``, dry friction and weight.

    Args:
        time: stamps [s], (T,).
        goal: [rad], (T,).
        angle: [rad], (T,).
    """
    v = rate_of(time, angle)
    sign = smoothed(np.sign(np.where(np.abs(v) > 0.02 * np.max(np.abs(v)), v, 0.0)), 5)
    error = smoothed(goal - angle, 5)
    others = np.stack([sign, np.ones_like(v), np.sin(angle), np.cos(angle)], axis=1)
    v, error = (one - others @ np.linalg.lstsq(others, one, rcond=None)[0] for one in (v, error))
    lag = float(v @ error) / max(float(v @ v), 1e-300)
    return lag if correlation(v, error) > PARTLY and lag > 0.0 else 0.0


def sign_of(fit: DriveFit | None, command: str, output: str) -> Guess:
    """Whether command and response point the same way."""
    about = f"sign of {output}"
    if fit is None:
        return Guess(about, "1", f"too short to compare {command} with the change of speed", False)
    words = f"correlation of {command} with the change of speed, speed taken out: {fit.partial:+.2f}"
    if abs(fit.partial) < OPPOSED:
        return Guess(about, "1", f"{words}, too small to tell", False)
    return Guess(about, "-1" if fit.partial < 0 else "1", words)


def angle_unit(
    values: Sequence[np.ndarray],
    times: Sequence[np.ndarray],
    about: str,
    said: str = "",
    joint: JointFacts | None = None,
    ratio: float = 0.0,
    speed_unit: str = "",
    counts_per_turn: float = 0.0,
    gear: float = 1.0,
    geared: bool = False,
) -> Guess:
    """Unit of an angle: ``rad``, ``deg``, ``rev``, ``mrad``, ``counts``, or at a slide ``m`` or ``mm``.

    Args:
        values: of each record.
        times: their stamps [s].
        about: what the guess is about.
        said: unit in the column's name.
        joint: the robot's joint, where known.
        ratio: derivative of the angle over a logged speed; 0 without one.
        speed_unit: of that speed, where its name says it.
        counts_per_turn: of the encoder, where a data sheet says it.
        gear: turns of the motor for one of the joint; the angle may be that of either.
        geared: whether it may be that of a motor behind a gear that is not known.
    """
    every = np.concatenate(list(values))
    low, high = float(every.min()), float(every.max())
    span, far = high - low, max(abs(low), abs(high))
    if joint is not None and joint.slide:
        fits = [u for u, f in (("m", 1.0), ("mm", 1e-3)) if span * f <= 1.1 * joint.range]
        unit = fits[0] if fits else "mm"
        return Guess(about, unit, f"span {span:.4g} at the slide {joint.name} of range {joint.range:.4g} m")
    if said in (*ANGLE_FACTORS, "counts"):
        return Guess(about, said, "its name says so")
    near = [  # units in which its derivative is a logged speed
        (angle, speed)
        for angle, of_angle in ANGLE_FACTORS.items()
        for speed, of_speed in SPEED_FACTORS.items()
        if abs(abs(ratio) * of_angle / of_speed - 1.0) < 0.05 and speed_unit in ("", speed)
    ]
    if len({angle for angle, _ in near}) == 1:
        angle, speed = near[0]
        words = f"its derivative is {abs(ratio):.4g} times the speed column, as {angle} beside {speed}"
        return Guess(about, angle, words)
    whole = bool(np.all(every == np.round(every))) and np.unique(every).size > 8
    if counted := counted_unit(values):
        unit, step, bits = counted
        words = f"values up to {far:.4g} in steps of {step:.4g}, 2^{bits} = {2**bits} a turn"
        return Guess(about, unit, words)
    if joint is not None and math.isfinite(joint.range):
        factors = {"rad": 1.0, "deg": math.pi / 180}
        if whole:
            factors["counts"] = 2 * math.pi / (counts_per_turn or COUNTS)
        fits = [unit for unit, factor in factors.items() if span * factor <= 1.1 * joint.range]
        words = f"span {span:.4g} is {span / joint.range:.3g} times the range of {joint.name} ({joint.range:.4g} rad)"
        if "rad" in fits and not (whole and span > 2):
            return Guess(about, "rad", words, span > 0.05 * joint.range)
        motor = gear > 1.0 and not whole and span <= 1.1 * gear * joint.range
        words += f"; at the motor, behind the gear, {span / gear / joint.range:.3g} times" if motor else ""
        for unit in ("counts", "deg") if whole and span > 400 else ("deg", "counts"):
            if unit in fits:
                sure = unit == "deg" and not (motor or geared)
                words += f"; as {unit} {span * factors[unit]:.3g} rad"
                if unit == "deg" and geared:
                    words += f", but as a motor's rad it fits behind any gear from {span / joint.range / 1.1:.2g} on"
                return Guess(about, unit, words, sure)
        if motor:
            return Guess(about, "rad", words)
    if whole and span > 400:
        return Guess(about, "counts", f"whole numbers from {low:.0f} to {high:.0f}", bool(counts_per_turn))
    rates = [
        np.max(np.abs(rate_of(time, one, 9)))
        for time, one in zip(times, values, strict=True)
        if one.size > 36
    ]
    fastest = float(max(rates, default=0.0))
    if fastest > FASTEST:
        words = (
            f"as radians the speed would come to {fastest:.3g} rad/s, {fastest * 60 / 2 / math.pi:.3g} rpm"
        )
        return Guess(about, "deg", words)
    if far <= 4 * math.pi:
        return Guess(about, "rad", f"values from {low:.3g} to {high:.3g}", far > 0.2)
    words = f"values from {low:.4g} to {high:.4g}, up to {fastest:.3g} a second: degrees, or radians of many turns"
    if far <= 10 * math.pi and fastest < 100.0:
        return Guess(about, "rad", words, False)
    return Guess(about, "deg" if far <= 400 and fastest < 4000 else "rad", words, False)


def counted_unit(values: Sequence[np.ndarray]) -> tuple[str, float, int] | None:
    """Unit in which an encoder's steps divide a turn, their size, its bits; None where there are no such steps.

    Args:
        values: of each record.
    """
    for unit, turn in (("deg", 360.0), ("rad", 2 * math.pi), ("rev", 1.0)):
        if bits := encoder_bits(values, turn):
            return unit, turn / 2**bits, bits
    return None


def encoder_bits(values: Sequence[np.ndarray], turn: float) -> int:
    """Bits of an encoder that divides a turn into as many steps as the values have; 0 where they have no such steps.

    Args:
        values: of each record, in the file's unit.
        turn: in that unit.
    """
    step = max((quantisation_step(one) for one in values), default=0.0)
    bits = math.log2(turn / step) if 0.0 < step < turn else 0.0
    return round(bits) if 8 <= round(bits) <= 24 and abs(2.0 ** (bits - round(bits)) - 1.0) < 0.005 else 0


def speed_unit(ratio: float, angle_factor: float, about: str, said: str = "") -> Guess:
    """Unit of a speed by the derivative of its angle.

    Args:
        ratio: derivative of the angle, in the file's unit, over the speed.
        angle_factor: of the angle's unit to rad.
        about: what the guess is about.
        said: unit in the column's name.
    """
    factor = abs(ratio) * angle_factor
    if said in SPEED_FACTORS:
        times = factor / SPEED_FACTORS[said]
        if not ratio or 1.0 / FAR_OFF < times < FAR_OFF:
            return Guess(about, said, "its name says so")
        words = f"its name says so, yet the derivative of the angle is {times:.3g} times it"
        return Guess(about, said, words, False)
    for unit, of_unit in SPEED_FACTORS.items():
        if abs(factor / of_unit - 1.0) < 0.1:
            words = f"the derivative of the angle is {factor / of_unit:.3f} times it as {unit}"
            return Guess(about, unit, words)
    words = f"one of it is {factor:.3g} rad/s of the angle's derivative, no usual unit"
    return Guess(about, "rad/s", words, False)


def wrap_period(values: Sequence[np.ndarray], unit: str, counts_per_turn: float = 0.0) -> float:
    """Period by which an angle jumps, in the file's numbers; 0 where it never does."""
    turn = {"deg": 360.0, "rad": 2 * math.pi, "rev": 1.0, "counts": counts_per_turn or COUNTS}.get(unit, 0.0)
    jumps = [np.abs(np.diff(one)) for one in values]
    largest = max((float(jump.max()) for jump in jumps if jump.size), default=0.0)
    usual = max((float(np.percentile(jump, 95)) for jump in jumps if jump.size), default=0.0)
    span = max((float(np.ptp(one)) for one in values), default=0.0)
    within = turn > 0 and span <= 1.001 * turn
    return turn if within and largest > 0.8 * turn and usual < 0.3 * turn else 0.0


def side_and_unit(
    fit: DriveFit | None, factor: float, constant: float, ratio: float, units: Sequence[str]
) -> tuple[str, str, str] | None:
    """Side of the gear (``m`` or ``a``) and unit of an angle by a known back-EMF constant; None where not one fits.

    Damping over drive, ``beta / alpha``, is the back-EMF constant and a little friction: at the motor the sheet's
    value, at the link that times the gear ratio.

    Args:
        fit: of the acceleration, voltage in V, the angle times ``factor``.
        factor: of the angle's assumed unit to rad.
        constant: of the motor [V s/rad].
        ratio: of the gear; 1 where it is not known.
        units: of the angle that are possible.

    Returns:
        Side, unit and the evidence.
    """
    if fit is None or fit.alpha <= 0 or fit.beta <= 0:
        return None
    seen = fit.beta / fit.alpha * abs(factor)
    fits = []
    for unit in units:
        for side, expected in (("m", constant), ("a", constant * ratio)):
            times = seen / ANGLE_FACTORS[unit] / expected
            if 0.7 < times < 1.8 and (side == "m" or ratio > 1.0):
                fits.append((side, unit, times))
    if len(fits) != 1:
        return None
    side, unit, times = fits[0]
    where = "motor" if side == "m" else f"link, behind the gear of {ratio:g},"
    return (
        side,
        unit,
        f"at the {where} in {unit} the back-EMF comes to {times:.2f} times that of the motor's sheet",
    )


def side_by_range(span: float, joint: JointFacts, ratio: float) -> tuple[str, str] | None:
    """Side of the gear (``m`` or ``a``) by the range of the joint, and the evidence; None where both are possible.

    Args:
        span: of the angle, where it moves most [rad].
        joint: of the robot.
        ratio: turns of the motor for one of the joint, more than one.
    """
    if not math.isfinite(joint.range) or ratio <= 1.0:
        return None
    share = span / joint.range
    if share > 1.1:
        words = (
            f"behind the gear of {ratio:g} its span is {share / ratio:.2g} times the range of {joint.name}"
        )
        return ("m", f"{words}, and {share:.3g} times before it") if share / ratio <= 1.1 else None
    if share > HARDLY * ratio:
        return None
    words = f"its span is {share:.2g} times the range of {joint.name}; as the motor's it would be {share / ratio:.1g}"
    return "a", words


def goal_unit(span: float, moved: float, factor: float, column: str, about: str) -> Guess:
    """Unit of a goal, by how far it goes: ``same`` as the angle's, or another one in which it spans as much.

    Args:
        span: of the goal, in the file's numbers.
        moved: by the angle in the same log [rad or m].
        factor: of the angle's numbers to SI.
        column: of the angle.
        about: what the guess is about.
    """
    moved = max(moved, 1e-300)
    shares = {"same": span * factor / moved}
    shares |= {unit: span * ANGLE_FACTORS[unit] / moved for unit in ("rad", "deg", "rev")}
    shares |= {"counts": span * 2.0 * math.pi / COUNTS / moved}
    unit = next((unit for unit, share in shares.items() if 1.0 / ALIKE < share < ALIKE), "same")
    words = f"its span is {shares[unit]:.2g} of that of '{column}'"
    same = unit == "same"
    how = (
        f"the unit of '{column}'; {words}" if same else f"as {unit} {words}, in its unit {shares['same']:.2g}"
    )
    return Guess(about, unit, how, same and 1.0 / ALIKE < shares[unit] < ALIKE)


def zero_offset(values: Sequence[np.ndarray], joint: JointFacts, about: str) -> Guess | None:
    """What the robot's range says of the zero: None where the angles lie in it, or where it says nothing.

    Args:
        values: of each record, at the joint [rad or m], sign included.
        joint: of the robot.
        about: what the guess is about; its value is what the file's angle is at the robot's zero.
    """
    low, high = min(float(one.min()) for one in values), max(float(one.max()) for one in values)
    slack = 0.05 * joint.range
    if not math.isfinite(joint.range) or (low >= joint.low - slack and high <= joint.high + slack):
        return None
    words = f"{low:.3g} to {high:.3g} rad leave the range of {joint.name}, {joint.low:.3g} to {joint.high:.3g} rad"
    least, most = low - joint.low, high - joint.high
    if high - low > 1.1 * joint.range:
        return Guess(about, "0", f"{words}, and are wider than it: the unit, or another joint", False)
    middle = 0.5 * (least + most)
    near = next((turn for turn in TURNS if most - slack <= turn <= least + slack), middle)
    words += f"; offsets from {most:.4g} to {least:.4g} rad fit, {near:.4g} is taken"
    return Guess(about, f"{near:.12g}", words, False)


def zero_by_goal(
    values: Sequence[np.ndarray], goals: Sequence[np.ndarray], reach: float, about: str
) -> Guess | None:
    """The zero of an angle by the goal that it follows; None where both have the same.

    Args:
        values: of each record, at the joint [rad or m].
        goals: of each record, as `values`.
        reach: range of the joint, or what it moves by.
        about: what the guess is about; its value is what the file's angle is at the goal's zero.
    """
    beyond = float(np.median(np.concatenate([q - g for q, g in zip(values, goals, strict=True)])))
    if abs(beyond) < 0.1 * reach:
        return None
    near = next((turn for turn in TURNS if abs(turn - beyond) < 0.02 * reach), beyond)
    words = f"the angle is {beyond:.4g} rad from its goal (median), {near:.4g} is taken"
    return Guess(about, f"{near:.12g}", words, False)


def beyond_limits(values: Sequence[np.ndarray], joint: JointFacts) -> list[np.ndarray]:
    """Where each record, at the joint, is beyond the joint's limits, at which a stop would be, (T,) of bool."""
    slack = 1e-3 * joint.range
    return [(one < joint.low - slack) | (one > joint.high + slack) for one in values]


def _si(value: float, unit: str) -> str:
    """A short time in words: 0.002 s -> 2 ms."""
    if abs(value) >= 1.0:
        return f"{value:.4g} {unit}"
    return f"{1e3 * value:.4g} m{unit}" if abs(value) >= 1e-3 else f"{1e6 * value:.4g} u{unit}"
