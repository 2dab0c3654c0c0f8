"""SO-101: the rivals' parameters (stiffness, damping, armature, friction, delay) by CMA-ES, without a table."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import so101
import torch

from hybrid_id.baselines.by_joint import joined, parts_of
from hybrid_id.baselines.cma import fitted
from hybrid_id.systems.model_file import save_model


def main() -> None:
    """Fit each joint by itself to the 15 train motions, the others as measured."""
    ask = argparse.ArgumentParser(description=__doc__)
    ask.add_argument("--data", type=Path, default=Path("../shared/data/so101"))
    ask.add_argument("--out", type=Path, default=Path("runs/18_so101/cma"))
    wish = ask.parse_args()
    torch.set_num_threads(1)
    wish.out.mkdir(parents=True, exist_ok=True)
    system, train = so101.model(wish.data, floor=False), so101.load(wish.data, "train")["train"]
    began, models = time.process_time(), []
    for part in parts_of(train, system):
        model, _ = fitted(part, part.system)
        models.append(model)
        values = ", ".join(f"{i.symbol} {i.spec.value:.4g}" for i in model.table if i.spec.estimate)
        print(f"{part.joint}: {values}", flush=True)
    save_model(joined(system, models), wish.out / "model.yaml")
    print(f"{time.process_time() - began:.0f} s of processor time")


if __name__ == "__main__":
    main()
