"""SO-101 in MuJoCo, its servos driven by the goals: RMSE [mrad] on the motions set aside, there (no table) and here."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import so101
from run import batch_of, errors, with_floor

from hybrid_id.export.replay import Agreement
from hybrid_id.export.target import CORRECTED, REFITTED, in_mujoco, target_errors
from hybrid_id.systems.chain import System
from hybrid_id.systems.model_file import load_model


def plain(folder: Path, out: Path) -> System:
    """Coulomb and viscous friction at every joint, which MuJoCo has, as ``run.py`` has fitted it."""
    system = so101.model(folder)
    for name in so101.JOINTS:
        found = json.loads((out / f"{name}-plain.json").read_text())["values"]
        system = system.with_values({n: v for n, v in found.items() if n.endswith(name)})
    return with_floor(system, json.loads((out / "floor.json").read_text()))


def show(title: str, found: np.ndarray | Sequence[Agreement]) -> None:
    """Print the RMSE [mrad] of each joint, means over the motions, and their mean."""
    if not isinstance(found, np.ndarray):
        rows = [[r.rmse for r in found if r.output == f"q_a{k}"] for k in range(1, len(so101.JOINTS) + 1)]
        found = 1e3 * np.array(rows).T
    values = found.mean(0)
    print(f"{title:50}" + "".join(f"{v:8.2f}" for v in (*values, values.mean())), flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=Path("../shared/data/so101"))
    parser.add_argument("--out", type=Path, default=Path("runs/18_so101"), help="what run.py has written")
    parser.add_argument("--train", type=int, default=15, help="train motions for the re-fit in MuJoCo")
    options = parser.parse_args()
    data, sheet = so101.load(options.data), so101.model(options.data, floor=False)
    aside, names = data["aside"], [record.name for record in data["train"].records]
    show("data sheet, MuJoCo", in_mujoco(sheet, aside).rows)
    bare = {}
    models = {REFITTED: plain(options.data, options.out), CORRECTED: load_model(options.out / "model.yaml")}
    for label, model in models.items():
        title = "Coulomb and viscous friction" if label == REFITTED else "identified"
        bare[label] = with_floor(model, {"k_f": 0.0})
        show(f"{title}, here", errors(model, batch_of(model, aside)))
        show(f"{title}, here without the table", errors(bare[label], batch_of(bare[label], aside)))
        show(f"{title}, MuJoCo", in_mujoco(bare[label], aside).rows)
    if options.train:
        seen = data["train"].select(names[: options.train])
        for label, found in target_errors(bare, aside, train=seen).models.items():
            show(f"{label}, fitted anew in MuJoCo where it loses", found.rows)
            for name, (before, after) in found.refitted.items():
                print(f"  {name} {before:.4g} to {after:.4g}")
