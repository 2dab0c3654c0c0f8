"""SO-101: one parameter set a train motion and joint; their variation, cross-validation and the selected one."""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import so101

from hybrid_id.records.dataset import Dataset
from hybrid_id.study import Study, identify
from hybrid_id.systems.by_joint import alone, with_others_measured
from hybrid_id.systems.chain import System

MOVES = 0.2
"""Range of its goal [rad] from which a joint takes part in a motion: one that stands still identifies nothing."""
TABLE = {"z_f": -0.035, "k_f": 375.0}
"""Height [m] and stiffness [N/m] of the table, as all train motions gave them."""
CARRIES_NOTHING = {"shoulder_pan": 7.76, "wrist_roll": 7.76}
"""Joints whose torques have no scale, with their k_p by the servo's data sheet [N m/rad], which gives them one."""
CLIPPED = {"goal_min_wrist_roll": -1.036}
"""What one motion alone shows [rad]."""


def joint_model(folder: Path, joint: str) -> System:
    """The robot with what a single motion cannot identify held, for the fits of one joint."""
    system = so101.model(folder)
    names = {info.symbol: info.name for info in system.table if info.symbol in TABLE}
    fixed = {names[symbol]: value for symbol, value in TABLE.items()} | CLIPPED
    if joint in CARRIES_NOTHING:
        fixed[f"k_p_{joint}"] = CARRIES_NOTHING[joint]
    return system.with_specs(
        {n: replace(system.parameter(n).spec.at(v), estimate=False) for n, v in fixed.items()}
    )


def moving(data: Dataset, number: int) -> Dataset:
    """The motions in which the goal of a joint moves."""
    kept = tuple(r for r in data.records if np.ptp(r.inputs[f"goal{number + 1}"]) > MOVES)
    return replace(data, records=kept)


def study_of(folder: Path, data: Dataset, number: int, jobs: int) -> Study:
    """`identify` of one joint by itself, one set a motion."""
    system = joint_model(folder, so101.JOINTS[number])
    own = with_others_measured(moving(data, number), system, number)
    return identify(own, alone(system, number), jobs=jobs)


def summary(study: Study, seconds: float) -> dict[str, object]:
    """What is kept of a joint's study."""
    matrix = study.cross_validation.matrix(study.cross_validation.signal_names[0])
    chosen, spread = study.selection.index, study.variation
    assert spread is not None
    return {
        "seconds": seconds,
        "motions": study.cross_validation.record_names,
        "status": [one.status for one in study.sets],
        "mean": dict(zip(spread.names, spread.mean.tolist(), strict=True)),
        "percent": dict(zip(spread.names, spread.percent.tolist(), strict=True)),
        "values": {
            one.records[0]: dict(zip(one.names, one.values.tolist(), strict=True)) for one in study.sets
        },
        "fit_percent": matrix.tolist(),
        "selected": study.selection.name,
        "paper_selects": study.selection.paper_name,
        "own": float(np.median(np.diag(matrix))),
        "across": float(np.median(matrix[chosen])),
        "worst": float(matrix[chosen].min()),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=Path("../shared/data/so101"))
    parser.add_argument("--out", type=Path, default=Path("runs/18_so101"))
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    roles = so101.load(options.data)
    data = replace(roles["train"], records=roles["train"].records + roles["aside"].records)
    began, found = time.perf_counter(), {}
    for number, joint in enumerate(so101.JOINTS):
        start = time.perf_counter()
        study = study_of(options.data, data, number, options.jobs)
        found[joint] = summary(study, time.perf_counter() - start)
        print(f"{joint}: {found[joint]['seconds']:.0f} s, {len(study.sets)} motions")
        if study.variation:
            print(
                {
                    name: round(p, 1)
                    for name, p in zip(study.variation.names, study.variation.percent, strict=True)
                }
            )
        print(study.selection.summary())
        print({k: round(found[joint][k], 1) for k in ("own", "across", "worst")}, flush=True)
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "sets.json").write_text(json.dumps(found, indent=1))
    print(f"{time.perf_counter() - began:.0f} s in all, {options.jobs} processes")


if __name__ == "__main__":
    main()
