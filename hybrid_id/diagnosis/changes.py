"""Which physical change explains the values of a re-fit: another load, friction, supply, motor, or sensor scale.

Each change is a subspace of relative parameter changes. Generalised least squares asks how much of the re-fit's change
it leaves: chi-square of ``d - D s`` with d the relative changes ``ln(fitted / nominal)``, D the columns of the change
and s their sizes, in the directions that the records identify. The covariance is that of the fit, robust against
autocorrelated residuals, and 2 % for each parameter, which no nominal value is better than. The change with the fewest
sizes that leaves nothing sure is named; where none does, several parameters have moved.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from hybrid_id.components.base import Component, Friction, Inertia
from hybrid_id.components.load.arm_gravity import ArmGravity
from hybrid_id.components.load.gravity import Gravity
from hybrid_id.components.load.two_link import JointCoupling
from hybrid_id.components.motor.current_motor import CurrentMotor
from hybrid_id.components.motor.dc_motor import DCMotor
from hybrid_id.components.motor.torque_motor import TorqueMotor
from hybrid_id.diagnosis.plausibility import as_late, joint_of, named, torque_power
from hybrid_id.identification.result import FitResult
from hybrid_id.parameters import ParameterInfo
from hybrid_id.statistics.uncertainty import covariance, robust_covariance
from hybrid_id.systems.chain import System

NOMINAL = 0.02
"""Standard deviation of a relative change that counts as none: no nominal value is known better."""
MOST = math.log(10.0)
"""Size of a physical change (logarithm) that is none: no wear, grease or load changes a value tenfold."""
LEFT = 0.02
"""Probability of a chi-square, were nothing else changed, below which something sure is left."""
HALF_WIDTH = 1.96
"""Standard errors from the middle of a 95 % interval to its ends."""
VAGUE = 1.0
"""Relative standard error from which a direction counts as not identified."""


@dataclass(frozen=True)
class ParameterChange:
    """What has changed in the machine against the nominal values.

    Attributes:
        name: ``none``, ``load``, ``friction``, ``supply``, ``torque_gain``, ``motor_constant``, ``sensor_scale`` or
            ``several``.
        joint: Number of the joint; 0 for all, and where nothing or several have changed.
        size: Relative change, 0.3 for 30 % more; 0 for ``none`` and ``several``.
        interval: Its 95 % interval.
        parameters: Names of the parameters that moved.
        words: The same in a sentence.
        together: Names of changes that explain the better part of it together, where one alone does not.
    """

    name: str
    joint: int
    size: float
    interval: tuple[float, float]
    parameters: tuple[str, ...]
    words: str
    together: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class _Hypothesis:
    """Columns (p, k) of relative changes; ``lead`` is the one that is its size, ``together``: all have one sign."""

    name: str
    joint: int
    columns: np.ndarray
    together: bool = False
    lead: int = 0


@dataclass(frozen=True, eq=False)
class _Solution:
    """A fitted hypothesis: sizes (k,) with their standard errors, chi-square left and its probability."""

    hypothesis: _Hypothesis
    sizes: np.ndarray
    errors: np.ndarray
    left: float
    probability: float


def find_change(nominal: System, fit: FitResult) -> ParameterChange:
    """The physical change that explains best how a re-fit differs from the nominal values.

    Args:
        nominal: the model before the re-fit.
        fit: its re-fit; parameters that are held or that the nominal model does not have do not count.
    """
    # which of the fit's parameters count, their relative changes (p,), and information and covariance (2, p, p)
    before = {info.name: info.spec.value for info in nominal.table}
    kept = [k for k, name in enumerate(fit.names) if before.get(name) or (name in before and fit.values[k])]
    start = np.array([before[fit.names[k]] for k in kept])
    values = fit.values[kept]
    positive = (start > 0) & (values > 1e-3 * start)
    expected = np.where(positive, np.abs(values), np.maximum(np.abs(values), np.abs(start)))
    ratio = np.where(positive, values / np.where(positive, start, 1.0), 1.0)
    change = np.where(positive, np.log(ratio), (values - start) / expected)
    # the data's own estimate: without the pull of the user's priors towards their means
    own = {info.name: info.spec.prior_mean for info in nominal.table}
    means = [v if own.get(n) is None else own[n] for n, v in zip(fit.names, fit.values, strict=True)]
    pull = fit.prior_precision * (fit.values - np.array(means))
    matched = all(len(j) == len(r) for j, r in zip(fit.jacobian, fit.residual, strict=True))
    if matched:
        uncertainty = robust_covariance(*fit.of_records())
    else:
        even = [np.full((j.shape[0], j.shape[1]), fit.noise_scale) for j in fit.jacobian]
        uncertainty = covariance(fit.jacobian, even)
    change = change + (uncertainty.inverse_hessian @ pull)[kept] / expected
    root = np.concatenate([j.reshape(-1, j.shape[-1])[:, kept] for j in fit.jacobian])
    root = root * expected
    information = root.T @ root
    cov = uncertainty.matrix[np.ix_(kept, kept)] / np.outer(expected, expected)
    names = tuple(fit.names[k] for k in kept)
    if not names:
        return _nothing()
    infos = [nominal.parameter(name) for name in names]
    # axes (p, m) of relative changes that the records identify, and the covariance along them (m, m)
    squares, vectors = np.linalg.eigh(information)
    along = np.einsum("ij,ik,kj->j", vectors, cov, vectors)
    axes = vectors[:, (squares > 1e-12 * squares[-1]) & (along < VAGUE**2)]
    spread = axes.T @ cov @ axes + NOMINAL**2 * np.eye(axes.shape[1])
    if not axes.size:
        return _nothing()
    whitener = np.linalg.inv(np.linalg.cholesky(spread))
    moved = whitener @ axes.T @ change
    total = float(moved @ moved)
    if chi2.sf(total, len(moved)) >= LEFT:
        return _nothing()
    whitened = whitener @ axes.T
    hypotheses = list(_hypotheses(nominal, infos))
    solutions = [s for s in (_solve(one, whitened, moved) for one in hypotheses) if _makes_sense(s)]
    passing = [s for s in solutions if s.probability >= LEFT]
    if passing:
        # the first of the changes that leave nothing sure; the others are indistinguishable from it
        passing.sort(key=lambda s: (len(s.sizes), s.left))
        best = passing[0]
        one, size, size_std = best.hypothesis, *(x[best.hypothesis.lead] for x in (best.sizes, best.errors))
        others = tuple(dict.fromkeys(s.hypothesis.name for s in passing if s.hypothesis.name != one.name))
        said = _capital(_words(nominal, best, names))
        if others:
            listed = ", ".join(name.replace("_", " ") for name in others)
            said += f"; indistinguishable in these records from a change of {listed}"
        return ParameterChange(
            name=one.name,
            joint=one.joint,
            size=float(np.expm1(size)),
            interval=(
                float(np.expm1(size - HALF_WIDTH * size_std)),
                float(np.expm1(size + HALF_WIDTH * size_std)),
            ),
            parameters=tuple(name for name, row in zip(names, one.columns, strict=True) if np.any(row)),
            words=said,
        )
    # where no torque is known, changes that differ by the scale of all torques are indistinguishable
    parts = [] if _scale_unseen(infos, axes) else _together(hypotheses, whitened, moved)
    # which parameters have surely moved by themselves, and how far (logarithm)
    powers = np.array([torque_power(info.spec.unit) for info in infos], float)
    seen = axes @ axes.T
    if _scale_unseen(infos, axes):
        seen = seen + np.outer(powers, powers) / float(powers @ powers)
        change = change - powers * np.median((change / np.where(powers, powers, 1.0))[powers != 0.0])
    error = np.sqrt(np.diag(axes @ spread @ axes.T))
    alone = {
        k: float(change[k])
        for k in range(len(infos))
        if seen[k, k] > 0.98 and abs(change[k]) > HALF_WIDTH * error[k]
    }
    parts = _beside(parts, alone, whitened, moved)
    # changes that act at once, and the parameters that moved beside them
    within = {k for one in parts for k in np.flatnonzero(one.hypothesis.columns.any(1))}
    changes = [(nominal.parameter(names[k]), own) for k, own in alone.items() if k not in within]
    beside = ", ".join(
        f"{named(info)} {_change_words(own, info.spec.value)}{as_late(nominal, info, own)}"
        for info, own in changes
    )
    if parts:
        words = "; ".join(_words(nominal, one, names) for one in parts)
        words += f"; beside that {beside}" if beside else ""
    else:
        words = f"several parameters moved{f': {beside}' if beside else ' together'}"
    return ParameterChange(
        name="several",
        joint=0,
        size=0.0,
        interval=(0.0, 0.0),
        parameters=tuple(names[k] for k in sorted(within | set(alone))) or names,
        words=_capital(words),
        together=tuple(one.hypothesis.name for one in parts),
    )


def _capital(words: str) -> str:
    return words[:1].upper() + words[1:]


def _nothing() -> ParameterChange:
    words = (
        "The fitted values differ from the nominal ones by no more than their uncertainty and the "
        f"±{100 * HALF_WIDTH * NOMINAL:.0f} % (95 %) to which any nominal value is known, all taken together."
    )
    return ParameterChange("none", 0, 0.0, (0.0, 0.0), (), words)


def _solve(hypothesis: _Hypothesis, whitened_axes: np.ndarray, moved: np.ndarray) -> _Solution:
    """Sizes of a change by least squares in whitened directions (m, p)."""
    design = whitened_axes @ hypothesis.columns
    covariance_of_sizes = np.linalg.pinv(design.T @ design, hermitian=True)
    sizes = covariance_of_sizes @ design.T @ moved
    left = float(np.sum((moved - design @ sizes) ** 2))
    freedom = len(moved) - np.linalg.matrix_rank(design)
    probability = float(chi2.sf(left, freedom)) if freedom > 0 else 0.0
    return _Solution(hypothesis, sizes, np.sqrt(np.diag(covariance_of_sizes)), left, probability)


def _together(hypotheses: list[_Hypothesis], whitened_axes: np.ndarray, moved: np.ndarray) -> list[_Solution]:
    """Changes that act at once, the one that explains most first; each moves several parameters as one cause does."""
    found: list[_Solution] = []
    left = float(moved @ moved)
    while True:
        taken = [one.hypothesis for one in found]
        used = np.any([one.columns.any(1) for one in taken], axis=0) if taken else False
        free = [one for one in hypotheses if not np.any(one.columns.any(1) & used)]
        tried = [
            _solve_together([*taken, one], whitened_axes, moved)
            for one in free
            if _as_one(one, taken, whitened_axes, moved)
        ]
        tried = [parts for parts in tried if all(_makes_sense(one) and _coherent(one) for one in parts)]
        best = min(tried, key=lambda parts: (parts[0].left, len(parts[-1].sizes)), default=None)
        if best is None or chi2.sf(left - best[0].left, len(best[-1].sizes)) >= LEFT:
            return found
        found, left = best, best[0].left


def _beside(
    parts: list[_Solution], alone: dict[int, float], whitened_axes: np.ndarray, moved: np.ndarray
) -> list[_Solution]:
    """The changes with all that has surely moved besides free; without those that it explains as well."""
    hypotheses = [one.hypothesis for one in parts]
    within = {k for one in hypotheses for k in np.flatnonzero(one.columns.any(1))}
    rows = [k for k in alone if k not in within]
    if not parts or not rows:
        return parts
    others = _Hypothesis("alone", 0, np.eye(whitened_axes.shape[1])[:, rows])
    found = _solve_together([*hypotheses, others], whitened_axes, moved)[:-1]
    return [one for one in found if _makes_sense(one) and _coherent(one)]


def _solve_together(
    hypotheses: list[_Hypothesis], whitened_axes: np.ndarray, moved: np.ndarray
) -> list[_Solution]:
    """Sizes of several changes by one least squares; the chi-square left is that of all."""
    every = _solve(
        _Hypothesis("several", 0, np.hstack([one.columns for one in hypotheses])), whitened_axes, moved
    )
    ends = np.cumsum([one.columns.shape[1] for one in hypotheses])[:-1]
    sizes, errors = np.split(every.sizes, ends), np.split(every.errors, ends)
    return [
        _Solution(one, size, error, every.left, every.probability)
        for one, size, error in zip(hypotheses, sizes, errors, strict=True)
    ]


def _as_one(
    change: _Hypothesis, taken: list[_Hypothesis], whitened_axes: np.ndarray, moved: np.ndarray
) -> bool:
    """Whether several parameters have moved by one size, next to which sizes of their own explain nothing sure."""
    rows, sizes = np.flatnonzero(change.columns.any(1)), change.columns.shape[1]
    if len(rows) <= sizes:
        return True
    apart = _Hypothesis(change.name, change.joint, np.eye(len(change.columns))[:, rows])
    left = [_solve_together([*taken, one], whitened_axes, moved)[0].left for one in (change, apart)]
    return float(chi2.sf(left[0] - left[1], len(rows) - sizes)) >= LEFT


def _coherent(solution: _Solution) -> bool:
    """Whether more than one parameter has surely moved as the change says: one alone may have any cause."""
    sure = np.abs(solution.sizes) > HALF_WIDTH * solution.errors
    return int(solution.hypothesis.columns[:, sure].any(1).sum()) > 1


def _makes_sense(solution: _Solution) -> bool:
    """Whether the leading size is surely not zero and no tenfold, and what must move together does not move apart."""
    sizes, errors = solution.sizes, HALF_WIDTH * solution.errors
    lead = solution.hypothesis.lead
    if not errors[lead] < abs(sizes[lead]) < MOST:
        return False
    ways = np.sign(sizes) * (np.abs(sizes) > errors)
    return not solution.hypothesis.together or not (np.any(ways > 0) and np.any(ways < 0))


def _hypotheses(system: System, infos: list[ParameterInfo]) -> Iterator[_Hypothesis]:
    """Every change that the parameters can show, one joint after the other, then all at once."""
    joints = sorted({joint_of(info) for info in infos})
    coupled = any(isinstance(part, JointCoupling) for part in system.components.values())
    for joint in [*joints, *([0] if len(joints) > 1 else [])]:
        mine = [joint in (0, joint_of(info)) for info in infos]
        loads = [m or coupled for m in mine] if joint == max(joints) else [m and not coupled for m in mine]
        # a heavier or lighter link: inertias and weights, each by its own share, for the rotor is part of an inertia
        weighs = np.array([m and _is_weight(system, info) for info, m in zip(infos, loads, strict=True)])
        inert = np.array([m and _is_inertia(system, info) for info, m in zip(infos, loads, strict=True)])
        load = weighs | inert
        if load.any():
            order = np.flatnonzero(load)
            lead = next((k for k, index in enumerate(order) if weighs[index]), 0)
            columns = np.eye(len(infos))[:, order]
            yield _Hypothesis("load", 0 if coupled else joint, columns, together=True, lead=lead)
        for name in ("friction", "supply", "torque_gain", "motor_constant", "sensor_scale"):
            powers = np.array(
                [_power(name, system, info) if m else 0.0 for info, m in zip(infos, mine, strict=True)]
            )
            if np.any(powers):
                yield _Hypothesis(name, joint, powers[:, None])
            if name == "friction" and np.count_nonzero(powers) > 1:
                yield _Hypothesis(name, joint, np.eye(len(infos))[:, powers != 0])


def _part(system: System, info: ParameterInfo) -> Component:
    part = system.components[info.component]
    assert isinstance(part, Component)
    return part


def _is_weight(system: System, info: ParameterInfo) -> bool:
    return isinstance(_part(system, info), Gravity | ArmGravity) and info.spec.unit in ("N m", "N")


def _is_inertia(system: System, info: ParameterInfo) -> bool:
    link = isinstance(_part(system, info), Inertia | JointCoupling)
    return link and "kg" in info.spec.unit and info.symbol != "J_m"


def _power(change: str, system: System, info: ParameterInfo) -> float:
    """With which power of the size of a change a parameter moves; 0 where it does not."""
    part = _part(system, info)
    match change:
        case "friction":  # dry levels and viscous coefficients, one factor
            return float(isinstance(part, Friction) and torque_power(info.spec.unit) == 1)
        case "supply":  # a gain c on the voltage: ``P_m1 (c U - P_m2 v) = c P_m1 (U - P_m2 / c v)``
            return {"P_m1": 1.0, "P_m2": -1.0}.get(info.symbol, 0.0) * isinstance(part, DCMotor)
        case "torque_gain":  # more torque per command at the same back-EMF: winding resistance, current gain
            motor = isinstance(part, DCMotor | CurrentMotor | TorqueMotor)
            return float(motor and info.symbol in ("P_m1", "k_t", "gain"))
        case "motor_constant":  # torque constant and back-EMF together: magnets
            return float(isinstance(part, DCMotor))
    # an angle read c times too large: each power of rad in a unit takes one of c; weight turns with the true angle
    if any(isinstance(part, Gravity | ArmGravity) for part in system.components.values()):
        return 0.0
    if _is_inertia(system, info) or info.symbol == "J_m":
        return -1.0
    over, _, under = info.spec.unit.partition("/")
    return float(over.startswith("rad")) - (2.0 if "rad^2" in under else float("rad" in under))


_WORDS = {
    "load": ("the load{joint} is {size} {heavier}", "heavier", "lighter"),
    "friction": ("friction{joint} is {size} {heavier} (temperature, grease or wear)", "higher", "lower"),
    "supply": ("the supply, or a gain on the command{joint}, is {size} {heavier}", "higher", "lower"),
    "torque_gain": (
        "the torque per command{joint} is {size} {heavier} (winding resistance, or a gain behind the command)",
        "higher",
        "lower",
    ),
    "motor_constant": (
        "the motor's torque and back-EMF constants{joint} are {size} {heavier} (magnets)",
        "higher",
        "lower",
    ),
    "sensor_scale": ("the angle{joint} is read {size} too {heavier}", "large", "small"),
}


def _change_words(size: float, nominal: float = 1.0) -> str:
    """A relative change, given as its logarithm: beyond a factor of ten its linearisation says no figure."""
    if nominal == 0.0:  # of which it is no share
        return "from zero"
    if abs(size) > math.log(10.0):
        return "more than tenfold" if size > 0 else "to less than a tenth"
    return f"{100 * np.expm1(size):+.0f} %"


def _words(system: System, solution: _Solution, names: tuple[str, ...]) -> str:
    """A change as a clause, with what each parameter did where they did not move as one."""
    one, lead = solution.hypothesis, solution.hypothesis.lead
    text, more, less = _WORDS[one.name]
    ends = [
        abs(100 * np.expm1(solution.sizes[lead] + way * HALF_WIDTH * solution.errors[lead]))
        for way in (-1.0, 1.0)
    ]
    size = 100 * np.expm1(solution.sizes[lead])
    moved = [name for name, row in zip(names, one.columns, strict=True) if np.any(row)]
    joint = f" of joint {one.joint}" if one.joint else " of all joints"
    if len(system.joints) == 1 or (one.name == "load" and not one.joint):
        joint = ""
    interval = f"{abs(size):.0f} % ({min(ends):.0f}-{max(ends):.0f} %)"
    if one.name == "load" and not any(_is_weight(system, system.parameter(name)) for name in moved):
        text, more, less = (
            "the inertia that the motor{joint} moves is {size} {heavier}, as of another load",
            "larger",
            "smaller",
        )
    words = text.format(joint=joint, size=interval, heavier=more if size > 0 else less)
    infos = [system.parameter(name) for name in moved]
    if one.name == "friction" and np.ptp(np.sign(solution.sizes)):
        words = f"friction{joint} has changed (temperature, grease or wear)"
    if one.columns.shape[1] > 1:
        changes = [
            f"{named(info)} {_change_words(own, info.spec.value)}{as_late(system, info, own)}"
            for info, own in zip(infos, solution.sizes, strict=True)
        ]
        return f"{words}: {', '.join(changes)}"
    if len(moved) > 1 and one.name == "friction":
        return f"{words}: {', '.join(map(named, infos))} {'rose' if size > 0 else 'fell'} together"
    return words


def _scale_unseen(infos: list[ParameterInfo], axes: np.ndarray) -> bool:
    """Whether the records say nothing of a common factor of all torques."""
    powers = np.array([torque_power(info.spec.unit) for info in infos], float)
    size = float(np.linalg.norm(powers))
    return size > 0.0 and float(np.linalg.norm(axes.T @ powers)) < 0.01 * size
