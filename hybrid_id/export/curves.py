"""A drive's laws as curves of few numbers, the ones that other simulators take, and how well these fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import torch
from scipy.optimize import least_squares, lsq_linear, nnls

from hybrid_id.components.base import Friction
from hybrid_id.components.bristle import Bristle
from hybrid_id.components.transmission.backlash import Backlash
from hybrid_id.systems.joint import Joint

Views = Mapping[str, SimpleNamespace]
Laws = Sequence[tuple[str, Friction]]

STIFF = 2.0 * np.pi * 60.0
"""Angular frequency [rad/s] of rotor against link from which on play ends in MuJoCo's limits, below in a spring."""
NARROWEST = 1e-6
"""Least half of a play [rad]: MuJoCo wants limits that differ."""
SLACK = 0.3
"""Share of a soft play's damping in contact that acts all along in MuJoCo, which has no damper with a dead band."""
WORTH_SAYING = 0.01
"""Share of a law's torque from which on its curve is said to differ."""
NEAR_REST = 0.02
"""Share of a law's largest torque that is added to it where it weighs a miss: next to nothing is no measure."""
MOST_RAMPS = 16
"""Ramps that carry one direction of a friction at most."""
SUPPLY = 24.0
"""Voltage [V] whose no-load speed bounds the speeds, and whose stall torque bounds the deflections, that are fitted."""


def noted(key: str, words: str) -> str:
    """The sentence about a component that the export does not carry as it is."""
    where, kind = key.rsplit("/", 1)
    return f"{where}: {kind} {words}"


def left_out(key: str, why: str) -> str:
    """The sentence about a component that the export does not carry."""
    return noted(key, f"is left out, {why}")


@dataclass(frozen=True)
class FrictionCurve:
    """Friction of one place: ``level(v) sgn v + a v + b v |v| + c v^3``, a bias, and ramps.

    A bias is exact for dry friction that one direction has more of: at rest it shifts the interval that holds.
    Ramps carry what the other terms cannot, in one direction each.

    Attributes:
        damping: a [N m s/rad], b [N m s^2/rad^2], c [N m s^3/rad^3].
        coulomb: level at high speed [N m].
        static: level at rest [N m]; it falls by ``exp(-(v / stribeck)^2)``.
        stribeck: Stribeck speed [rad/s].
        bristle: stiffness [N m/rad] and damping [N m s/rad] of the bristle; None for friction that is dry.
        bias: torque that opposes forward motion [N m].
        ramps: torque [N m] and speed [rad/s] of either sign: ``torque min(v / speed, 1)`` in the speed's direction.
        notes: what this leaves out, a sentence each.
    """

    damping: tuple[float, float, float]
    coulomb: float
    static: float
    stribeck: float
    bristle: tuple[float, float] | None
    bias: float
    ramps: tuple[tuple[float, float], ...]
    notes: tuple[str, ...]

    @property
    def falls(self) -> bool:
        """Whether the level depends on the speed."""
        return abs(self.static - self.coulomb) > 1e-3 * max(self.static, self.coulomb)


def friction_curve(joint: Joint, place: str, p: Views, top_speed: float) -> FrictionCurve:
    """The friction of a place over speeds up to ``top_speed`` [rad/s], both directions averaged."""
    where, laws = f"{joint.name}/{place}", joint.frictions[place]
    v = np.concatenate([[0.0], np.geomspace(1e-4, 1.0, 80)])
    speeds = torch.tensor(top_speed * v)

    def total(terms: list) -> np.ndarray:
        return sum((t for t in terms if t is not None), torch.zeros_like(speeds)).detach().numpy()

    # dry levels and smooth torques [N m], forwards and backwards
    forwards = [torch.full_like(speeds, side) for side in (1.0, 0.0)]
    levels = [total([law.dry(p[key], speeds, side) for key, law in laws]) for side in forwards]
    smooth = [side * total([law.smooth(p[key], side * speeds) for key, law in laws]) for side in (1.0, -1.0)]
    both = [dry + rest for dry, rest in zip(levels, smooth, strict=True)]
    # a miss counts as a share of the torque there: drag at top speed is no measure for a drive that starts. Where the
    # torque is next to nothing a share of what rises above the straight line from rest to top speed is added
    slow = max(float((torque - v * torque[-1]).max()) for torque in both)
    least = max(NEAR_REST * slow, 1e-9 * float(np.abs(both).max()), 1e-12)
    weights = [1.0 / (np.abs(torque) + least) for torque in both]
    features = np.stack([(v > 0).astype(float), v, v**2, v**3], 1)
    target, even = 0.5 * (smooth[0] + smooth[1]), np.sqrt(v)  # samples are dense where it is slow
    size = target.max() or 1.0  # nnls has a tolerance that knows no size
    found = size * nnls(features * even[:, None], target * even / size)[0]
    found[found < 1e-9 * size] = 0.0
    level, fall, stribeck = _gaussian(v, 0.5 * (levels[0] + levels[1]))
    curve = features @ found + level + fall * np.exp(-((v / stribeck) ** 2))
    bias, ramps = float(np.trapezoid(0.5 * (both[0] - both[1]), v)), []
    misses = [torque - side * bias - curve for torque, side in zip(both, (1, -1), strict=True)]
    bristled = any(isinstance(law, Bristle) for _, law in laws)
    if not bristled and _largest(misses, weights)[0] > WORTH_SAYING:
        found[0], level, fall = 0.0, 0.5 * (levels[0][0] + levels[1][0]), 0.0
        bias = 0.5 * (levels[0][0] - levels[1][0])
        for k, side in enumerate((1, -1)):
            forces, misses[k] = _ramps(v, both[k] - features @ found - level - side * bias, weights[k])
            ramps += [(side * force, side * top_speed * knot) for knot, force in forces.items()]
    notes, (share, miss, at) = [], _largest(misses, weights)
    if share > WORTH_SAYING:
        notes.append(
            f"{where}: MuJoCo's friction is up to {100 * share:.2g} % off the model's curve, {miss:.2g} N m at "
            f"{top_speed * v[at]:.2g} rad/s"
        )
    most = max(float(torque.max()) for torque in both)
    still_growing = max((abs(force) for force, end in ramps if abs(end) >= 0.999 * top_speed), default=0.0)
    if still_growing > WORTH_SAYING * most:
        notes.append(
            f"{where}: what grows with speed in one direction alone does so up to {top_speed:.3g} rad/s only"
        )
    bristle = None
    for key, law in laws:
        terms = law.load_factor(p[key]), law.effort_factor(p[key]), law.dry_over(p[key], torch.zeros(1))
        if any(term is not None for term in terms):
            notes.append(left_out(key, "MuJoCo's dry friction knows neither load nor angle"))
        own, missing = law.mjcf(p[key])
        if "bristle" in own:
            bristle = float(own["bristle"][0]), float(own["bristle"][1])
        if missing:
            notes.append(noted(key, missing))
    a, b, c = (float(f) / top_speed**n for n, f in enumerate(found) if n)
    coulomb = level + float(found[0])
    edges = coulomb, coulomb + fall, stribeck * top_speed
    return FrictionCurve((a, b, c), *edges, bristle, bias, tuple(ramps), tuple(notes))


def _largest(misses: list[np.ndarray], weights: list[np.ndarray]) -> tuple[float, float, int]:
    """Largest difference of two curves in motion, as a share of the torque there and in N m; number of its sample."""
    shares = [np.abs(miss[1:]) * weight[1:] for miss, weight in zip(misses, weights, strict=True)]
    side = int(shares[1].max() > shares[0].max())
    at = int(shares[side].argmax()) + 1
    return float(shares[side].max()), float(np.abs(misses[side][at])), at


def _ramps(v: np.ndarray, torque: np.ndarray, weight: np.ndarray) -> tuple[dict[float, float], np.ndarray]:
    """Torques by the speed up to which they grow, whose sum is a curve that starts at 0; and what they miss.

    Their sum is straight between those speeds; each further one is set where straight lines between the others miss
    most.
    """
    knots = [0, v.size - 1]
    while True:
        shapes = np.minimum(v[:, None] / v[knots[1:]], 1.0)
        force = lsq_linear(shapes * weight[:, None], torque * weight).x
        miss = torque - shapes @ force
        if len(knots) > MOST_RAMPS or (np.abs(miss) * weight).max() <= WORTH_SAYING:
            acts = (np.abs(shapes * force) * weight[:, None]).max(0) > 1e-3 * WORTH_SAYING
            return dict(zip(v[knots[1:]][acts].tolist(), force[acts].tolist(), strict=True)), miss
        straight = torque - np.interp(v, v[knots], torque[knots])
        knots = sorted([*knots, int((np.abs(straight) * weight).argmax())])


def _gaussian(v: np.ndarray, level: np.ndarray) -> tuple[float, float, float]:
    """Level at speed, its fall and the Stribeck speed of ``level + fall exp(-(v / v_s)^2)``."""
    if np.ptp(level) <= 1e-9 * level.max(initial=0.0):
        return float(level.max(initial=0.0)), 0.0, 1.0
    size, best = level.max(), None
    for start in (0.003, 0.03, 0.3):
        fit = least_squares(
            lambda t: (t[0] + t[1] * np.exp(-((v / t[2]) ** 2)) - level) / size,
            [level[-1], max(level[0] - level[-1], 0.0), start],
            bounds=([0.0, 0.0, 1e-5], [np.inf, np.inf, 10.0]),
            x_scale=[size, size, start],
        )
        best = fit if best is None or fit.cost < best.cost else best
    assert best is not None
    return tuple(float(x) for x in best.x)  # type: ignore[return-value]


@dataclass(frozen=True)
class Elasticity:
    """A compliant gear: ``a x + c x^3``, springs that begin at a deflection of either sign, and damping.

    Attributes:
        stiffness: a [N m/rad] and c [N m/rad^3].
        beyond: deflection [rad] -> stiffness [N m/rad] of a spring that acts beyond it.
        damping: damping everywhere [N m s/rad].
        limits: half of the play [rad], square of the angular frequency [1/s^2] and damping rate [1/s] of rotor against
            link in contact, where that is too stiff for a spring; None without.
        notes: what this leaves out.
    """

    stiffness: tuple[float, float]
    beyond: Mapping[float, float]
    damping: float
    limits: tuple[float, float, float] | None
    notes: tuple[str, ...]


def elasticity(joint: Joint, p: Views, torque: float) -> Elasticity:
    """The spring of a compliant gear up to a ``torque`` at the link [N m]."""
    key, spring = joint.gear.transmission
    view, (mass_key, mass) = p[key], joint.inertia
    sides = (
        mass.rotor(p[mass_key], joint.gear_ratio) * joint.gear_ratio**2,
        mass.link(p[mass_key], joint.gear_ratio),
    )
    series = sides[0] * sides[1] / (sides[0] + sides[1])

    def force(x: np.ndarray, rate: float = 0.0) -> np.ndarray:
        deflection = torch.tensor(x, dtype=torch.float64)
        return spring.torque(view, deflection, torch.full_like(deflection, rate), series).detach().numpy()

    loaded = spring.loaded(view)
    # where the spring carries the torque, and no less than where it is fully loaded
    deflections = np.geomspace(1e-6, 10.0, 400)
    above = force(deflections) >= torque
    reach = float(deflections[above.argmax()]) if above.any() else 1.0
    reach = max(reach, 1.5 * (1e-6 if loaded is None else float(loaded)))
    small, notes = 1e-9 * reach, []
    damping = [float((force(np.array([x]), 1e-6) - force(np.array([x])))[0]) / 1e-6 for x in (small, reach)]
    damping[1] = max(damping[1] - damping[0], 0.0)
    where = f"{joint.name}/transmission: {key.split('/')[2]}"
    if isinstance(spring, Backlash):
        half = max(0.5 * float(view.gap), NARROWEST)
        k = float(force(np.array([half + 1e-6]))[0]) / 1e-6
        if k > float(series) * STIFF**2:
            return Elasticity((0.0, 0.0), {}, 0.0, (half, k / float(series), damping[1] / float(series)), ())
        slack = SLACK * damping[1]
        note = (
            f"{where}'s damping acts in contact ({damping[1]:.2g} N m s/rad); MuJoCo's, in the play too, is "
            f"{slack:.2g}"
        )
        return Elasticity((0.0, 0.0), {half: k}, slack, None, (note,))
    if damping[1] > WORTH_SAYING * damping[0]:
        notes.append(
            f"{where}'s damping is {damping[0]:.2g} N m s/rad throughout, not {damping[1]:.2g} more "
            "under load"
        )
    x = np.concatenate([np.geomspace(1e-4, 1e-2, 60), np.linspace(1e-2, 1.0, 240)]) * reach
    target = force(x)
    shape = np.stack([x / reach, (x / reach) ** 3], 1)
    (a, c), miss = nnls(shape, target)
    if miss <= 1e-6 * np.linalg.norm(target):
        return Elasticity((float(a) / reach, float(c) / reach**3), {}, damping[0], None, tuple(notes))
    starts = np.concatenate([[0.0], np.geomspace(3e-3, 0.9, 16) * reach])
    ramps = np.maximum(x[:, None] - starts, 0.0)
    # small torques count, too: a gear is rarely wound far
    weight = 1.0 / (np.abs(target) + NEAR_REST * np.abs(target).max())
    found = lsq_linear(ramps * weight[:, None], target * weight).x
    error = float((np.abs(ramps @ found - target) * weight).max())
    springs = {float(s): float(k) for s, k in zip(starts, found, strict=True) if k != 0.0}
    notes.append(
        f"{where} is carried as {len(springs)} springs that set in one after another, within {100 * error:.1g} % of "
        f"its torque up to {reach:.2g} rad"
    )
    return Elasticity((0.0, 0.0), springs, damping[0], None, tuple(notes))
