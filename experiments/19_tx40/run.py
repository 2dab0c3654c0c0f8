"""Staubli TX40: base parameters and friction by inverse dynamics, beside two published sets, and free windows."""

from __future__ import annotations

import argparse
import csv
import gzip
from pathlib import Path

import numpy as np
from scipy.signal import butter, sosfiltfilt

from hybrid_id.robots.base_parameters import BaseParameters, base_parameters, whole_regressor
from hybrid_id.robots.description import load_tree
from hybrid_id.robots.tree import RigidBodyTree
from hybrid_id.statistics.uncertainty import Covariance, autocorrelation_robust

STEP = 2e-4
GEAR = np.array([32.0, 32.0, 45.0, -48.0, 45.0, 32.0])
ZERO = np.array([0.0, -np.pi / 2, np.pi / 2, 0.0, 0.0, 0.0])
"""Of the description's joints, beside the recorder's [rad]."""
MOTORS = np.vstack([np.eye(6)[:5], [0, 0, 0, 0, 1, 1]])
"""Speeds of the motors over their gear ratios, from those of the joints: motor 6 turns with joints 5 and 6."""
LOW_PASS, BAND, EVERY = 100.0, 20.0, 100
"""Of angles and torques [Hz]; of all columns and torques before every 100th sample enters the fit, as published."""
SPLIT = 2 / 3
WINDOW, SHOWN = 0.2, 5
"""Length of a free window [s], and every which sample is compared (1 kHz)."""
MOVING = ("of it from 6.2 to 7.4 s", 0.2, 1.4)
"""Without the first 0.2 s, where filters start in motion, and the end, where the arm stops; seen after the opening."""
NAMES = [f"{kind}{k}" for k in range(1, 7) for kind in ("fv", "fs", "off")] + ["fvm6", "fsm6"]


def read(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Joint angles [rad] and torques at the joints [N m], ``(T, 6)`` each."""
    with gzip.open(folder / "record.csv.gz", "rt") as file:
        table = np.loadtxt(file, delimiter=",", skiprows=1)
    angles = np.linalg.solve(MOTORS, (table[:, 1:7] / GEAR).T).T + ZERO
    return angles, (table[:, 7:13] * GEAR) @ MOTORS


def filtered(rows: np.ndarray, edge: float = LOW_PASS) -> np.ndarray:
    return sosfiltfilt(butter(4, edge, fs=1 / STEP, output="sos"), rows, axis=0)


def motion(angles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Filtered angles with central differences."""
    q = filtered(angles)
    v = np.gradient(q, STEP, axis=0)
    return q, v, np.gradient(v, STEP, axis=0)


def links(
    tree: RigidBodyTree, base: BaseParameters, q: np.ndarray, v: np.ndarray, a: np.ndarray
) -> np.ndarray:
    """Regressor of the base parameters, rotor 6 turning with motor 6."""
    w = whole_regressor(tree, q, v, a)
    rotor = base.names.index("Ia_joint_6")
    w[:, :, rotor] = (a @ MOTORS.T)[:, 5:] * MOTORS[5]
    return w[..., list(base.independent)]


def friction(v: np.ndarray) -> np.ndarray:
    """Viscous, dry and constant torque of each joint, viscous and dry friction of motor 6, ``(T, 6, 20)``."""
    own = np.stack([v, np.sign(v), np.ones_like(v)], 2)  # (T, joint, kind)
    found = (own[:, :, :, None] * np.eye(6)[:, None, :]).transpose(0, 3, 1, 2).reshape(len(v), 6, 18)
    motor = (v @ MOTORS[5])[:, None]
    return np.concatenate([found, np.stack([motor, np.sign(motor)], 2) * MOTORS[5][:, None]], 2)


def fit(columns: np.ndarray, torque: np.ndarray) -> tuple[np.ndarray, Covariance, np.ndarray]:
    """Least squares, each joint weighted by what the first pass leaves of it."""
    size = np.ones(6)
    for _ in range(2):
        w, tau = columns / size[:, None], torque / size
        values = np.linalg.lstsq(w.reshape(-1, w.shape[2]), tau.ravel(), rcond=None)[0]
        left = torque - columns @ values
        size = left.std(0)
    w = columns / size[:, None]
    return values, autocorrelation_robust([w], [left / size]), size


def published(path: Path, base: BaseParameters) -> list[tuple[str, np.ndarray, float, float]]:
    """Name, what it is in terms of our parameters, estimate and standard error of each published parameter."""
    found = []
    with path.open() as file:
        for text, estimate, percent, *_ in csv.reader(file):
            row = np.zeros(len(base.independent) + len(NAMES))
            if text in NAMES:
                named = (
                    [text, "fvm6"] if text in ("fv5", "fv6") else [text]
                )  # theirs hold motor 6's own share
                row[[len(base.independent) + NAMES.index(name) for name in named]] = 1.0
            else:
                phi = np.zeros(len(base.names))
                for term in text.replace("- ", "+ -").split(" + "):
                    factor, _, name = term.rpartition("*")
                    symbol, joint = name.strip()[:-1].replace("Iam", "Ia"), name.strip()[-1]
                    phi[base.names.index(f"{symbol}_joint_{joint}")] += float(factor or 1)
                short = phi[list(base.independent)]
                if not np.allclose(short @ base.grouping, phi, atol=1e-6):
                    print(f"not identifiable by the tree: {text}")
                row[: len(short)] = short
            found.append((text, row, float(estimate), abs(float(estimate) * float(percent)) / 100))
    return found


def rollout(
    tree: RigidBodyTree,
    base: BaseParameters,
    values: np.ndarray,
    start: tuple[np.ndarray, np.ndarray],
    torque: np.ndarray,
) -> np.ndarray:
    """Free runs ``(S, R, 6)`` [rad] from ``(R, 6)`` under torques ``(S, R, 6)``: semi-implicit steps.

    Dry friction of each step is the one that stops a joint or motor, within its level: projected Gauss-Seidel.
    """
    beta, rest = values[: len(base.independent)], values[len(base.independent) :]
    viscous, dry, bias = rest[0:18:3], rest[1:18:3], rest[2:18:3]
    along = np.vstack([np.eye(6), MOTORS[5]])
    level = STEP * np.maximum([*dry, rest[19]], 0.0)
    damping = np.diag(viscous) + rest[18] * np.outer(MOTORS[5], MOTORS[5])
    (q, v), runs = start, len(start[0])
    impulse, found = np.zeros((runs, 7)), []
    unit = np.concatenate([np.zeros((1, 6)), np.eye(6)])
    for tau in torque:
        found.append(q)
        lanes = [np.repeat(q, 7, 0), np.repeat(v, 7, 0), np.tile(unit, (runs, 1))]
        lanes[1] = lanes[1] * np.tile([1.0, *[0.0] * 6], runs)[:, None]
        each = (links(tree, base, *lanes) @ beta).reshape(runs, 7, 6)
        still = (links(tree, base, q, np.zeros_like(v), np.zeros_like(v)) @ beta)[:, None]
        mass = (each[:, 1:] - still).transpose(0, 2, 1)
        mass = 0.5 * (mass + mass.transpose(0, 2, 1)) + STEP * damping
        inverse = np.linalg.inv(mass)
        push = STEP * (tau - each[:, 0] - bias - v @ damping)
        v = v + np.einsum("rij,rj->ri", inverse, push)
        reach = np.einsum("ki,rij,lj->rkl", along, inverse, along)
        v = v - np.einsum("rij,kj,rk->ri", inverse, along, impulse)
        for _ in range(30):
            for k in range(7):
                before = impulse[:, k].copy()
                wanted = before + (v @ along[k]) / reach[:, k, k]
                impulse[:, k] = np.clip(wanted, -level[k], level[k])
                v = v - np.einsum("rij,j,r->ri", inverse, along[k], impulse[:, k] - before)
        q = q + STEP * v
    return np.stack(found)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--open", action="store_true", help="measure on the last third too")
    given = parser.parse_args()
    tree = load_tree(given.data / "tx40_mdh_modified.urdf")
    base = base_parameters(tree)
    angles, torque = read(given.data)
    split = round(SPLIT * len(angles))
    # filtered apart, so that nothing of the last third reaches the fit
    parts = [(motion(angles[part]), filtered(torque[part])) for part in (slice(0, split), slice(split, None))]
    whole = []
    for (q, v, a), tau in parts:
        w = np.concatenate([links(tree, base, q, v, a), friction(v)], 2)
        whole.append((filtered(w, BAND)[::EVERY], filtered(tau, BAND)[::EVERY]))
    columns, measured = whole[0]
    values, errors, size = fit(columns, measured)
    n = len(base.independent)
    scaled = (columns / size[:, None]).reshape(-1, columns.shape[2])
    print(f"{n} base parameters, {len(NAMES)} of friction; {len(columns)} samples; "
          f"condition number {np.linalg.cond(scaled / np.linalg.norm(scaled, axis=0)):.3g}")  # fmt: skip
    sets = {k: published(given.data / f"published_{k}_parameters.csv", base) for k in ("base", "essential")}
    essential = {text: (value, std) for text, _, value, std in sets["essential"]}
    print(
        "| parameter | this fit, 95 % interval | published base | published essential |\n| --- | --- | --- | --- |"
    )
    rows = {text: row for text, row, *_ in sets["base"]}
    others = {text: (value, std) for text, _, value, std in sets["base"]}
    inside = []
    for text, row in rows.items():
        here, half = row @ values, 1.96 * np.sqrt(row @ errors.matrix @ row)
        both = [table.get(text) for table in (others, essential)]
        inside.append([one and abs(one[0] - here) <= np.hypot(half, 1.96 * one[1]) for one in both])
        cells = [f"{one[0]:.4g} ± {1.96 * one[1]:.2g}" if one else "" for one in both]
        print(f"| {text} | {here:.4g} ± {half:.2g} | {cells[0]} | {cells[1]} |")
    for name, column in (("base", 0), ("essential", 1)):
        known = [row[column] for row in inside if row[column] is not None]
        print(f"{sum(known)} of {len(known)} published {name} parameters agree within both intervals")
    if not given.open:
        left = measured - columns @ values
        print("torque left on the first two thirds, RMSE [N m]:", np.round(left.std(0), 3))
        return
    order = list(rows)
    matrix = np.array([rows[text] for text in order])
    models = {"this fit, first two thirds": values}
    for name, table in (("base", others), ("essential", essential)):
        there = np.array([table.get(text, (0.0, 0.0))[0] for text in order])
        models[f"published {name}, whole record"] = np.linalg.solve(matrix, there)
    (q, v, _), _ = parts[1]
    columns, measured = whole[1]
    starts = np.arange(0, len(q) - round(WINDOW / STEP), round(WINDOW / STEP))
    at = starts[None] + np.arange(round(WINDOW / STEP))[:, None]
    raw_angle, raw_torque = angles[split:], torque[split:]
    free = {
        name: rollout(tree, base, one, (q[starts], v[starts]), raw_torque[at]) for name, one in models.items()
    }
    free["speed of the start kept"] = q[starts] + v[starts] * (STEP * np.arange(len(at)))[:, None, None]
    second = STEP * EVERY * np.arange(len(measured))
    for words, first, last in (("last third", 0.0, 3.0), MOVING):
        runs = (starts * STEP > first - 1e-9) & ((starts * STEP + WINDOW) < last + 1e-9)
        print(f"{words}: {runs.sum()} windows of {WINDOW} s; RMSE by joint")
        for name, angle in free.items():
            if name in models:
                left = (measured - columns @ models[name])[(second >= first) & (second < last)]
                print(f"| {name} | torque [N m] |", cells_of(left))
            error = 1e3 * (angle - raw_angle[at])[::SHOWN][:, runs]
            print(f"| {name} | angle [mrad] |", cells_of(error.reshape(-1, 6)))


def cells_of(error: np.ndarray) -> str:
    """Root mean squares by joint as cells of a table."""
    return " | ".join(f"{x:.3g}" for x in np.sqrt((error**2).mean(0))) + " |"


if __name__ == "__main__":
    main()
