"""SO-101: drives of five joints by joint, the table by all of them, laws chosen by leaving train motions out."""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import so101
from joblib import Parallel, delayed

from hybrid_id.identification.fit import fit
from hybrid_id.identification.least_squares import Options
from hybrid_id.identification.result import FitResult
from hybrid_id.records.dataset import Dataset
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.rollout import simulate
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.by_joint import alone, with_others_measured
from hybrid_id.systems.chain import System
from hybrid_id.systems.model_file import save_model

ENGINE = Engine("dry", 1, compiled=True)
VARIANTS: tuple[tuple[str, ...], ...] = ((), ("load",), ("load", "stribeck"))
FOLDS = 3
Run = Callable[..., Any]
"""Runs delayed calls, some at once."""
REACH = so101.JOINTS[1:4]
"""Joints that a push at the gripper from below turns."""


def batch_of(system: System, dataset: Dataset) -> Batch:
    """Free runs from the first sample, every angle weighted by a count of the encoder."""
    noise = {channel.name: so101.COUNT for channel in dataset.outputs}
    return make_batch(system, dataset.records, noise_std=noise, signal_share=0.0, estimate_start=False)


def errors(system: System, batch: Batch) -> np.ndarray:
    """RMSE [mrad] of each motion and joint, ``(R, n_y)``."""
    there = batch.weight > 0
    squares = ((simulate(system, ENGINE, batch).y - batch.y) * there).square().sum(1) / there.sum(1)
    return 1e3 * squares.sqrt().numpy()


def held(system: System, keep: tuple[str, ...]) -> System:
    """The system whose estimated parameters are only those of some symbols."""
    specs = {i.name: replace(i.spec, estimate=False) for i in system.table if i.symbol not in keep}
    return system.with_specs(specs)


def found(system: System, result: FitResult) -> System:
    return system.with_values(dict(zip(result.names, map(float, result.values), strict=True)))


def fit_joint(system: System, dataset: Dataset, joint: int, *, warm: bool = True) -> tuple[System, float]:
    """The drive of a joint at its optimum, the others as measured, and the cost."""
    one = alone(system, joint)
    batch = batch_of(one, with_others_measured(dataset, system, joint))
    (result,) = fit(one, batch, pooled=True, engine=ENGINE, options=Options(max_iterations=60), warm=warm)
    return found(one, result), float(result.cost)


def carried(system: System, parts: list[System], floor: bool = True) -> System:
    """The robot with what was found joint by joint."""
    values = {
        i.name: i.spec.value for part in parts for i in part.table if floor or i.symbol not in ("z_f", "k_f")
    }
    return system.with_values(values)


def with_floor(system: System, floor: dict[str, float], *, estimate: bool = False) -> System:
    names = {i.symbol: i.name for i in system.table if i.symbol in ("z_f", "k_f")}
    return system.with_specs(
        {
            names[s]: replace(system.parameter(names[s]).spec.at(v), estimate=estimate)
            for s, v in floor.items()
        }
    )


def variant(
    folder: Path, out: Path, data: Dataset, joint: int, laws: tuple[str, ...], floor: dict[str, float]
) -> dict[str, Any]:
    """A joint's drive with further friction laws: its values on all motions, its errors on those left out; kept."""
    name = so101.JOINTS[joint]
    kept = out / f"{name}-{'-'.join(laws) or 'plain'}.json"
    if kept.exists():
        return json.loads(kept.read_text())
    system = with_floor(so101.model(folder, {name: laws}), floor)
    best, cost = fit_joint(system, data, joint)
    start = carried(system, [best])
    left_out = {}
    for fold in range(FOLDS):
        train = replace(data, records=tuple(r for i, r in enumerate(data.records) if i % FOLDS != fold))
        rest = replace(data, records=tuple(r for i, r in enumerate(data.records) if i % FOLDS == fold))
        drive, _ = fit_joint(start, train, joint, warm=False)
        scored = errors(drive, batch_of(drive, with_others_measured(rest, start, joint)))
        left_out |= {r.name: float(e) for r, e in zip(rest.records, scored[:, 0], strict=True)}
    values = {i.name: i.spec.value for i in best.table}
    found = {"joint": name, "laws": laws, "cost": cost, "left_out": left_out, "values": values}
    kept.write_text(json.dumps(found, indent=1))
    print(f"{name} {'+'.join(laws) or '-'}: {np.mean(list(left_out.values())):.2f} mrad left out", flush=True)
    return found


def floor_of(folder: Path, data: Dataset, run: Run) -> dict[str, float]:
    """Height and stiffness of the table: of each joint that it pushes, then by all joints at once."""
    system = so101.model(folder)
    first = run(delayed(fit_joint)(system, data, k) for k in range(5))
    system = carried(system, [one for one, _ in first], floor=False)
    reached = [one for (one, _), name in zip(first, so101.JOINTS, strict=True) if name in REACH]
    floor = {s: float(np.median([i.spec.value for one in reached for i in one.table if i.symbol == s]))
             for s in ("z_f", "k_f")}  # fmt: skip
    start = with_floor(held(system, ()), floor, estimate=True)
    (result,) = fit(start, batch_of(start, data), pooled=True, engine=ENGINE, warm=False,
                    options=Options(max_iterations=20))  # fmt: skip
    return {name[:3]: float(v) for name, v in zip(result.names, result.values, strict=True)}


def choose(folder: Path, out: Path, jobs: int) -> None:
    """Everything from the train motions: the table, the laws, the values."""
    began, data = time.time(), so101.load(folder)["train"]
    run = cast(Run, Parallel(n_jobs=jobs))
    out.mkdir(parents=True, exist_ok=True)
    if not (out / "floor.json").exists():
        (out / "floor.json").write_text(json.dumps(floor_of(folder, data, run)))
    floor = json.loads((out / "floor.json").read_text())
    print(f"table: {floor}, {time.time() - began:.0f} s", flush=True)
    tried: list[dict[str, Any]] = run(
        delayed(variant)(folder, out, data, k, laws, floor) for k in range(5) for laws in VARIANTS
    )
    chosen = {}
    for name in so101.JOINTS:
        own = [one for one in tried if one["joint"] == name]
        chosen[name] = min(own, key=lambda one: np.mean(list(one["left_out"].values())))
    final = with_floor(so101.model(folder, {n: tuple(c["laws"]) for n, c in chosen.items()}), floor)
    known = {i.name for i in final.table}
    for one in chosen.values():
        final = final.with_values({n: v for n, v in one["values"].items() if n in known})
    save_model(final, out / "model.yaml")
    show("train", final, data)
    print(f"{time.time() - began:.0f} s in all")


def show(role: str, system: System, data: Dataset) -> None:
    """RMSE of free runs driven by the goals alone, all joints simulated."""
    scored = errors(system, batch_of(system, data))
    for record, row in zip(data.records, scored, strict=True):
        print(f"  {record.name:26}" + "".join(f"{e:8.2f}" for e in row))
    mean = scored.mean(0)
    print(
        f"{role}, all joints simulated: "
        + "  ".join(f"{n} {e:.2f}" for n, e in zip(so101.JOINTS, mean, strict=True))
    )
    print(f"mean of the five {mean.mean():.2f} mrad", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=Path("../shared/data/so101"))
    parser.add_argument("--out", type=Path, default=Path("runs/18_so101"))
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument(
        "--open", choices=("aside", "test"), help="score the chosen model on motions kept away until now"
    )
    options = parser.parse_args()
    if options.open is None:
        choose(options.data, options.out, options.jobs)
    else:
        from hybrid_id.systems.model_file import load_model

        show(options.open, load_model(options.out / "model.yaml"), so101.load(options.data)[options.open])
