"""SO-101: the rivals' parameters (stiffness, damping, armature, friction, delay) by CMA-ES, without a table.

Needs the package `cma` (pip install "hybrid-id[bench]").
"""

from __future__ import annotations

import argparse
import time
from contextlib import suppress
from pathlib import Path

import cma  # type: ignore[import-not-found]
import numpy as np
import so101
import torch

from hybrid_id.baselines.methods import joined, taken_apart
from hybrid_id.diagnosis.errors_on_test import errors
from hybrid_id.diagnosis.fits import engine
from hybrid_id.errors import InputError
from hybrid_id.records.dataset import Dataset
from hybrid_id.systems.chain import System
from hybrid_id.systems.model_file import save_model

LOST = 1e12
"""Cost of a model that cannot be simulated."""


def fitted(train: Dataset, start: System) -> System:
    """The best of 144 models: a factor e^x for each parameter, tenths of a second for a delay."""
    infos = [info for info in start.table if info.spec.estimate]

    def model(x: np.ndarray) -> System:
        values = {}
        for info, change in zip(infos, x, strict=True):
            value = (
                0.1 * abs(change)
                if info.symbol == "T_d"
                else info.spec.value * np.exp(np.clip(change, -3, 3))
            )
            values[info.name] = float(np.clip(value, info.spec.lower, info.spec.upper))
        return start.with_values(values)

    def cost(x: np.ndarray) -> float:
        with suppress(InputError, RuntimeError):
            seen = errors(train, model(x), engine(), train.train)
            return LOST if seen is None or not np.isfinite(seen.over_noise) else seen.over_noise
        return LOST

    return model(cma.fmin2(cost, np.zeros(len(infos)), 0.2, {"maxfevals": 144, "seed": 1, "verbose": -9})[0])


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
    for records, start in taken_apart(train, system):
        models.append(fitted(records, start))
        values = ", ".join(f"{i.name} {i.spec.value:.4g}" for i in models[-1].table if i.spec.estimate)
        print(values, flush=True)
    save_model(joined(system, models), wish.out / "model.yaml")
    print(f"{time.process_time() - began:.0f} s of processor time")


if __name__ == "__main__":
    main()
