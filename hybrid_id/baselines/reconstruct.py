"""A joint's torque reconstructed from records, and what a library of effects would add to it.

The acceleration of each joint, which is its torque up to a factor, is a sum of what the nominal model has
(``q'' = P/J u - P_2 P/J q' - F_c/J sgn q' - ...``, gears taken as rigid) and of groups of terms, one for each effect
that has an algebraic one. Both sides are filtered alike, so that the derivatives fall on the filter (weak form: D. A.
Messenger and D. M. Bortz, Multiscale Model. Simul. 19, 2021). Play and flexibility have no terms here, what has a
memory by a proxy.

Of a robot's joint it is the torque on the links, by the description's inverse dynamics along the measured motion of all
joints: ``tau_i(q, q', q'') = k_p (goal - q_i) - J_m q_i'' - F_v q_i' - F_c sgn q_i' + ...``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.signal import lfilter

from hybrid_id.records.dataset import Dataset
from hybrid_id.records.derivatives import smooth_derivatives
from hybrid_id.records.record import Record
from hybrid_id.robots.base_parameters import inertial_parameters, whole_regressor
from hybrid_id.robots.tree import TEN, RigidBodyTree
from hybrid_id.systems.by_joint import measured_motion
from hybrid_id.systems.chain import System

WAVES = (1, 2, 3, 4, 6, 8, 12)
"""Waves of the motor's angle in a turn that the library knows."""
STILL = 0.02
"""Speed over the largest one below which a joint counts as resting; dry friction is anything there."""
EVERY = 4
"""One sample of so many is used."""
FILTER = 0.015
"""Standard deviation [s] of the Gaussian that both sides are filtered with."""
Name = tuple[str, str]
"""An effect and its place."""


@dataclass(frozen=True, eq=False)
class Torque:
    """Regression of one joint's acceleration in one record.

    Attributes:
        target: the acceleration [rad/s^2], of a robot the torque on the links [N m], ``(N,)``.
        own: columns of what the nominal model has, ``(N, m)``.
        library: columns of the effects, ``(N, k)`` each.
        signals: what acts in each place of the joint, ``(N, k)``; of a robot all of it, as ``joint``.
    """

    target: np.ndarray
    own: np.ndarray
    library: Mapping[Name, np.ndarray]
    signals: Mapping[str, np.ndarray]


def reconstructed(dataset: Dataset, record: Record, system: System, joint: int) -> Torque:
    """The acceleration of a joint and all terms, where the joint moves; of a robot's joint the torque on its links."""
    if system.tree is not None:
        return _of_robot(record, system, system.tree, joint)
    noise = {channel.name: channel.noise_std for channel in dataset.outputs}
    own, step = system.joints[joint], record.sample_time
    angles = [record.signal(f"q_m{j.number}") / j.gear_ratio for j in system.joints]
    stds = [(noise.get(f"q_m{j.number}") or 0.0) / j.gear_ratio or None for j in system.joints]
    motions = [smooth_derivatives(q, step, std) for q, std in zip(angles, stds, strict=True)]
    q, v = own.gear_ratio * motions[joint][0], own.gear_ratio * motions[joint][1]
    u = record.signal(f"u{own.number}")
    base, library = _terms(set(system.components.keys()), own.name, step, u, q, v, q / own.gear_ratio)
    if len(motions) > 1:
        coupling = _coupled(motions, u, joint)
        if any(info.symbol == "P_3" for info in system.table):
            base += coupling
        else:
            library["joint_coupling", f"{own.name}/load"] = coupling
    signals = {
        "motor_friction": [v],
        "motor": [np.sin(q), np.cos(q)],
        "load": [q / own.gear_ratio],
        "input": [u],
    }
    kept = np.flatnonzero(np.abs(v) > STILL * np.abs(v).max(initial=0.0))[::EVERY]

    def columns(terms: Sequence[np.ndarray], filtered: bool = True) -> np.ndarray:
        return np.stack([_filtered(t, step) if filtered else t for t in terms], 1)[kept]

    return Torque(
        own.gear_ratio * _filtered(angles[joint], step, 2)[kept],
        columns(base),
        {name: columns(terms) for name, terms in library.items()},
        {place: columns(terms, False) for place, terms in signals.items()},
    )


def _of_robot(record: Record, system: System, tree: RigidBodyTree, joint: int) -> Torque:
    """The torque on the links of a robot's joint [N m] and all terms, every sample where it moves."""
    step, drive, name = record.sample_time, system.joints[joint].name, tree.names[joint]
    motions = [measured_motion(record, system, k) for k in range(len(system.joints))]
    q, v, a = (np.stack(rows, 1) for rows in zip(*motions, strict=True))
    links = whole_regressor(tree, q, v, a)[:, joint]
    known = inertial_parameters(tree)
    known[len(TEN) :: len(TEN) + 1] = 0.0  # the rotors belong to the drives
    own = slice(joint * (len(TEN) + 1), joint * (len(TEN) + 1) + len(TEN))
    angle, speed = q[:, joint], v[:, joint]
    fastest = float(np.abs(speed).max())
    goal = record.inputs.get(f"goal{joint + 1}")
    kinds = (kind for kind in ("tau", "i", "u") if f"{kind}{joint + 1}" in record.inputs)
    u = goal - angle if goal is not None else record.inputs[f"{next(kinds)}{joint + 1}"]
    base, library = _terms(set(system.components.keys()), drive, step, u, angle, speed, angle)
    library["link_mass", f"{drive}/load"] = [links[:, own] @ known[own]]
    if goal is not None:
        library["delay", f"{drive}/input"] = [
            goal - np.concatenate([np.full(k, goal[0]), goal[:-k]]) for k in (2, 5)
        ]
        library["goal_rate_limit", f"{drive}/input"] = [
            goal - _limited(goal, w * fastest * step) for w in (0.8, 1.1)
        ]
    moves = np.abs(speed) > STILL * fastest

    def columns(terms: Sequence[np.ndarray], filtered: bool = True) -> np.ndarray:
        return np.stack([_filtered(t, step) if filtered else t for t in terms], 1)[moves]

    return Torque(
        _filtered(links @ known, step)[moves],
        columns([*base, a[:, joint]]),
        {(one, where.replace(f"{drive}/", f"{name}/")): columns(t) for (one, where), t in library.items()},
        {"joint": columns([angle, speed, a[:, joint], u], False)},
    )


def _limited(goal: np.ndarray, most: float) -> np.ndarray:
    """A goal that is followed by so much a sample at most."""
    found = goal.copy()
    for k in range(1, len(goal)):
        found[k] = found[k - 1] + np.clip(goal[k] - found[k - 1], -most, most)
    return found


def _terms(
    keys: set[str], where: str, step: float, u: np.ndarray, q: np.ndarray, v: np.ndarray, link: np.ndarray
) -> tuple[list[np.ndarray], dict[Name, list[np.ndarray]]]:
    """What the nominal model has of one joint, and the library by effect and place: command, rotor and link angles."""
    sign, fastest = np.sign(v), float(np.abs(v).max()) or 1.0
    sine, cosine, friction = np.sin(link), np.cos(link), f"{where}/motor_friction"
    base, library = [u, v], {
        ("stribeck_friction", friction): [sign * np.exp(-((v / s / fastest) ** 2)) for s in (0.05, 0.15)],
        ("asymmetric_friction", friction): [np.abs(sign), np.abs(v)],
        ("quadratic_drag", friction): [v * np.abs(v)],
        ("load_dependent_friction", friction): [np.abs(u) * sign],
        ("position_dependent_friction", friction): [sign * sine, sign * cosine],
        ("presliding_friction", friction): [_late(sign, 0.03 / step)],
        ("cogging", f"{where}/motor"): [f(k * q) for k in WAVES for f in (np.sin, np.cos)],
        ("electrical_lag", f"{where}/motor"): [u - _late(u, 0.005 / step)],
        ("thermal_derating", f"{where}/motor"): [u * np.cumsum(u**2) * step],
        ("delay", f"{where}/input"): [u - np.concatenate([np.zeros(k), u[:-k]]) for k in (2, 5)],
        ("voltage_deadband", f"{where}/input"): [np.sign(u)],
        ("voltage_saturation", f"{where}/input"): [u**3],
        ("spring_load", f"{where}/load"): [link],
        ("constant_torque", f"{where}/load"): [np.ones_like(q)],
        ("kinematic_error", f"{where}/transmission"): [np.sin(q) * u, np.cos(q) * u],
    }  # fmt: skip
    for own, name, place, terms in (
        ("motor_friction/coulomb_friction", "coulomb_friction", friction, [sign]),
        ("load/gravity_load", "gravity_load", f"{where}/load", [sine]),
    ):
        if f"{where}/{own}" in keys:
            base += terms
        else:
            library[name, place] = terms
    return base, library


def _filtered(signal: np.ndarray, step: float, order: int = 0) -> np.ndarray:
    """A signal, or its derivative of an order, behind the filter."""
    return gaussian_filter1d(signal, FILTER / step, order=order, mode="nearest") / step**order


def _late(signal: np.ndarray, samples: float) -> np.ndarray:
    """A signal behind a low-pass of first order."""
    keep = float(np.exp(-1.0 / samples))
    return np.asarray(lfilter([1 - keep], [1, -keep], signal))


def _coupled(motions: Sequence[tuple[np.ndarray, ...]], u: np.ndarray, joint: int) -> list[np.ndarray]:
    """Terms of a planar arm of two links that each joint feels from the other, its own inertia taken as constant."""
    (_, v1, a1), (q2, v2, a2) = motions
    if joint == 0:
        return [a2, np.cos(q2) * a2, np.cos(q2) * u, np.sin(q2) * (2 * v1 * v2 + v2**2)]
    return [a1, np.cos(q2) * a1, np.sin(q2) * v1**2]
