"""Staubli TX40: the coupled wrist's drives and links fitted to free windows of 0.2 s; each third left out once."""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import run as inverse
import torch

from hybrid_id.components import BodyInertia, ConstantTorque, LoadDependent, Stribeck
from hybrid_id.identification.fit import fit
from hybrid_id.identification.least_squares import Options
from hybrid_id.parameters import Bounded
from hybrid_id.records.record import Record
from hybrid_id.robots.base_parameters import base_parameters
from hybrid_id.robots.description import load_tree
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.stability import with_substeps
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.chain import System
from hybrid_id.systems.model_file import load_model, save_model

MODEL = """robot: {{file: {file}}}
gear_ratio: [32, 32, 45, 48, 45, 32]
couplings: [{{joints: [joint_5, joint_6], matrix: [[1, 0], [1, 1]]}}]
"""
RATIO = np.abs(inverse.GEAR)
SIGN = np.sign(inverse.GEAR)
"""Motor 4 turns backwards."""
BLOCK = inverse.SHOWN
"""Samples at 5 kHz that one sample at 1 kHz holds: the torque's mean over them, the angle at their start."""
LENGTH = round(inverse.WINDOW / (inverse.STEP * BLOCK))
FOLDS = 3
ENGINE = Engine(compiled=True)
PRIORS = {"c_m": (1.0, 0.3), **dict.fromkeys(("x_c", "y_c", "z_c"), (0.0, 0.03))}
"""What the URDF is trusted with: mass and centre [m] of each link; it matters where windows say nothing."""
MASSES = ("c_m", "x_c", "y_c", "z_c")
VARIANTS: dict[str, tuple[str, ...]] = {
    "drives": (),
    "drives, load-dependent friction": ("mu",),
    "drives, Stribeck friction": ("F_drop", "v_s"),
    "drives, masses and centres": MASSES,
    "drives, masses and centres, load-dependent friction": (*MASSES, "mu"),
}


def record_of(angles: np.ndarray, torque: np.ndarray) -> tuple[Record, np.ndarray, np.ndarray]:
    """A part of the recording at 1 kHz, with its filtered motor angles and speeds, ``(T, 6)`` each.

    Args:
        angles: of the joints at 5 kHz, ``(5 T, 6)`` [rad].
        torque: of the motors at 5 kHz, ``(5 T, 6)`` [N m].
    """
    count = len(angles) // BLOCK
    q, v, _ = inverse.motion(angles)
    motors = [(rows[: count * BLOCK : BLOCK] @ inverse.MOTORS.T) * RATIO for rows in (angles, q, v)]
    held = torque[: count * BLOCK].reshape(count, BLOCK, 6).mean(1) * SIGN
    inputs = {f"tau{k + 1}": held[:, k] for k in range(6)}
    outputs = {f"q_m{k + 1}": motors[0][:, k] for k in range(6)}
    return (
        Record("tx40", inverse.STEP * BLOCK * np.arange(count), inputs, outputs), motors[1], motors[2],
    )  # fmt: skip


def model(folder: Path, out: Path, values: np.ndarray, symbols: Sequence[str]) -> System:
    """The robot with its wrist coupled, friction by inverse dynamics and some of the links' parameters as a start."""
    out.mkdir(parents=True, exist_ok=True)
    (out / "nominal.yaml").write_text(MODEL.format(file=(folder / "tx40_mdh_modified.urdf").resolve()))
    system, rest = load_model(out / "nominal.yaml"), values[-len(inverse.NAMES) :]
    start = {}
    for k in range(6):
        at, ratio = f"joint{k + 1}", float(RATIO[k])
        viscous, dry = (rest[18], rest[19]) if k == 5 else (rest[3 * k], rest[3 * k + 1])
        system = system.with_component(
            f"{at}/load", ConstantTorque(T_0=Bounded(float(rest[3 * k + 2]), -20.0, 20.0, "N m"))
        )
        start[k] = (max(float(viscous), 0.1) / ratio**2, max(float(dry), 0.1) / ratio)
        if set(symbols) & set(PRIORS):
            system = system.with_component(f"{at}/load", BodyInertia(_bodies(system)[k]))
        if "mu" in symbols:
            system = system.with_component(
                f"{at}/motor_friction", LoadDependent(mu=Bounded(0.05, 0.0, 0.6, "1"))
            )
        if "v_s" in symbols:
            system = system.with_component(
                f"{at}/motor_friction",
                Stribeck(
                    F_drop=Bounded(0.1 * start[k][1], 0.0, 2.0 * start[k][1], "N m"),
                    v_s=Bounded(0.1 * ratio, 0.01 * ratio, ratio, "rad/s"),
                ),
            )
    specs = {}
    for info in system.table:
        k = int(info.component.split("/")[0][5:]) - 1
        viscous, dry = start[k]
        if info.component.endswith("motor_friction/viscous_friction"):
            specs[info.name] = replace(info.spec, value=viscous, upper=10 * viscous)
        elif info.component.endswith("motor_friction/coulomb_friction"):
            specs[info.name] = replace(info.spec, value=dry, upper=10 * dry)
        elif info.symbol == "J_m":
            rotor = (0.3 if k < 2 else 0.05) / float(RATIO[k]) ** 2
            specs[info.name] = replace(info.spec, value=rotor, lower=1e-7, upper=20 * rotor)
        elif info.symbol in PRIORS:
            mean, std = PRIORS[info.symbol]
            free = info.symbol in symbols
            specs[info.name] = Bounded(
                mean,
                mean - 3 * std,
                mean + 3 * std,
                info.spec.unit,
                free,
                mean if free else None,
                std if free else None,
            )
    return system.with_specs(specs)


def _bodies(system: System) -> list[str]:
    """The body that each joint carries first."""
    tree = system.tree
    assert tree is not None
    return [next(b.name for b in tree.bodies if b.joint == k and b.inertia.mass) for k in range(6)]


def windows(system: System, part: tuple[Record, np.ndarray, np.ndarray], noise: np.ndarray) -> Batch:
    """Free windows from filtered angles and speeds, which are held.

    Args:
        system: the robot.
        part: see :func:`record_of`.
        noise: what each joint's angle is weighted by [rad].
    """
    record, q, v = part
    std = {f"q_m{k + 1}": float(noise[k] * RATIO[k]) for k in range(6)}
    batch = make_batch(system, [record], noise_std=std, signal_share=0.0)
    for k, joint in enumerate(system.joints):
        batch.x[0, :, joint.positions[0]] = torch.as_tensor(q[:, k].copy())
        batch.x[0, :, joint.positions[0] + 1] = torch.as_tensor(v[:, k].copy())
    found, _ = batch.windows(LENGTH, LENGTH, torch.zeros_like(batch.x0_std))
    return found


def errors(system: System, batch: Batch) -> np.ndarray:
    """Errors of the joints' angles in free windows [mrad], ``(W, T, 6)``."""
    engine = with_substeps(system, ENGINE, batch)
    off = (simulate(system, engine, batch).y - batch.y).numpy() / RATIO
    return 1e3 * np.linalg.solve(inverse.MOTORS, off.reshape(-1, 6).T).T.reshape(off.shape)


def rms(error: np.ndarray) -> np.ndarray:
    return np.sqrt((error**2).mean((0, 1)))


def fitted(system: System, batch: Batch) -> System:
    (found,) = fit(system, batch, pooled=True, engine=ENGINE, warm=False, options=Options(max_iterations=60))
    print(
        f"    {found.status} after {found.iterations} iterations, {found.engine.substeps} sub-steps",
        flush=True,
    )
    return found.system


def left_out(
    folder: Path, out: Path, name: str, train: tuple, values: list[np.ndarray], noise: np.ndarray
) -> np.ndarray:
    """RMSE by joint over windows of each third, fitted on the other two, ``(6,)`` [mrad]."""
    found = []
    for fold, start in enumerate(values):
        system = model(folder, out, start, VARIANTS[name])
        batch = windows(system, train, noise)
        here = torch.arange(batch.rows) * FOLDS // batch.rows == fold
        best = fitted(system, batch.take((~here).nonzero().flatten()))
        found.append(errors(best, batch.take(here.nonzero().flatten())))
    return rms(np.concatenate(found))


def inverse_dynamics(
    folder: Path, angles: np.ndarray, torque: np.ndarray, keep: Sequence[np.ndarray]
) -> list[np.ndarray]:
    """Least squares of inverse dynamics on several choices of the samples (5 kHz) of a part: start values."""
    tree = load_tree(folder / "tx40_mdh_modified.urdf")
    base = base_parameters(tree)
    q, v, a = inverse.motion(angles)
    w = np.concatenate([inverse.links(tree, base, q, v, a), inverse.friction(v)], 2)
    every = slice(None, None, inverse.EVERY)
    columns, measured = (
        inverse.filtered(rows, inverse.BAND)[every] for rows in (w, inverse.filtered(torque))
    )
    return [inverse.fit(columns[one[every]], measured[one[every]])[0] for one in keep]


def inverse_errors(
    folder: Path, values: np.ndarray, angles: np.ndarray, torque: np.ndarray, which: np.ndarray
) -> np.ndarray:
    """Errors of free windows by inverse dynamics' values, steps of 0.2 ms [mrad], ``(W, T, 6)``; windows by number."""
    tree = load_tree(folder / "tx40_mdh_modified.urdf")
    q, v, _ = inverse.motion(angles)
    starts = which * LENGTH * BLOCK
    at = starts[None] + np.arange(LENGTH * BLOCK)[:, None]
    free = inverse.rollout(tree, base_parameters(tree), values, (q[starts], v[starts]), torque[at])
    return 1e3 * (free - angles[at])[::BLOCK].transpose(1, 0, 2)


def table(name: str, values: np.ndarray) -> None:
    print(f"| {name} | " + " | ".join(f"{x:.1f}" for x in values) + f" | {values.mean():.1f} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--out", type=Path, default=Path("runs/19_tx40"))
    parser.add_argument("--variants", nargs="*", default=list(VARIANTS))
    parser.add_argument("--inverse", action="store_true", help="inverse dynamics beside them (minutes)")
    parser.add_argument("--final", help="variant that is fitted on all of the first two thirds and saved")
    parser.add_argument("--open", action="store_true", help="measure the saved model on the last third")
    given = parser.parse_args()
    torch.set_num_threads(1)
    angles, joint_torque = inverse.read(given.data)
    motor_torque = np.linalg.solve(inverse.MOTORS.T, joint_torque.T).T / RATIO * SIGN  # as logged
    split = round(inverse.SPLIT * len(angles))
    first = (angles[:split], joint_torque[:split])
    train = record_of(angles[:split], motor_torque[:split])
    if given.open:
        system = load_model(given.out / "model.yaml")
        batch = windows(system, record_of(angles[split:], motor_torque[split:]), np.ones(6))
        batch = batch.take(torch.arange(batch.rows - 1))  # the same 14 as at the first opening
        error, start = errors(system, batch), inverse.WINDOW * np.arange(batch.rows)
        table("last third", rms(error))
        table(
            f"{inverse.MOVING[0]}", rms(error[(start > 0.2 - 1e-9) & (start + inverse.WINDOW < 1.4 + 1e-9)])
        )
        return
    count = len(train[0].time) // LENGTH
    third = np.arange(count) * FOLDS // count
    of_sample = np.minimum(np.arange(split) // (LENGTH * BLOCK), count - 1)
    kept = [third[of_sample] != fold for fold in range(FOLDS)]
    *values, whole = inverse_dynamics(given.data, *first, [*kept, np.ones(split, bool)])
    print(
        "| left out of the first two thirds, RMSE [mrad] | 1 | 2 | 3 | 4 | 5 | 6 | mean |\n"
        + "| --- " * 8
        + "|"
    )
    start = model(given.data, given.out, whole, ())
    noise = 1e-3 * rms(errors(start, windows(start, train, np.ones(6))))
    table("the URDF's links, friction by inverse dynamics, nothing left out", 1e3 * noise)
    noise = noise * np.sqrt(
        LENGTH
    )  # what a model lacks bends a window as a whole: it counts as one measurement
    if given.inverse:
        plain = [
            inverse_errors(given.data, values[f], *first, np.flatnonzero(third == f)) for f in range(FOLDS)
        ]
        table("inverse dynamics", rms(np.concatenate(plain)))
    for name in given.variants:
        began = time.perf_counter()
        table(name, left_out(given.data, given.out, name, train, values, noise))
        print(f"    {time.perf_counter() - began:.0f} s")
    if given.final:
        system = model(given.data, given.out, whole, VARIANTS[given.final])
        best = fitted(system, windows(system, train, noise))
        table("fitted on all of it, its own windows", rms(errors(best, windows(best, train, noise))))
        save_model(best, given.out / "model.yaml")


if __name__ == "__main__":
    main()
