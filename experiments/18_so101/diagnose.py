"""SO-101: what the chosen model (run.py) still lacks, joint by joint; the corrected robot on motions kept away."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
import so101
import torch
from halves import diagnosed
from run import batch_of, errors
from scipy.stats import t as student

from hybrid_id.records.dataset import Dataset
from hybrid_id.systems.chain import System
from hybrid_id.systems.model_file import load_model, save_model

HELD = ("z_f", "k_f")
"""Parameters of the table, which all joints share."""


def model(folder: Path) -> System:
    """The model that run.py has chosen, the table held."""
    system = load_model(folder / "model.yaml")
    specs = {i.name: replace(i.spec, estimate=False) for i in system.table if i.symbol in HELD}
    return system.with_specs(specs)


def compare(role: str, models: dict[str, System], data: Dataset) -> None:
    """RMSE [mrad] of each model, all joints simulated from their goals, and its ratio to the first."""
    found = {name: errors(system, batch_of(system, data)) for name, system in models.items()}
    for k, record in enumerate(data.records):
        cells = "   ".join("".join(f"{e:7.2f}" for e in own[k]) for own in found.values())
        print(f"  {record.name:26}{cells}")
    first = next(iter(found.values())).mean(1)
    for name, own in found.items():
        each = "  ".join(f"{joint} {e:.2f}" for joint, e in zip(so101.JOINTS, own.mean(0), strict=True))
        ratio = np.log(own.mean(1) / first)
        half = student.ppf(0.975, len(ratio) - 1) * ratio.std(ddof=1) / np.sqrt(len(ratio))
        low, mid, high = (np.exp(ratio.mean() + s * half) for s in (-1.0, 0.0, 1.0))
        print(f"{role}, {name}: {each}; mean {own.mean():.2f} mrad")
        print(
            f"  over the chosen model's, paired over motions: {mid:.3f} ({low:.3f} to {high:.3f})", flush=True
        )


def main() -> None:
    """Diagnose the chosen model by the train motions, or score both models on motions kept away."""
    ask = argparse.ArgumentParser(description=__doc__)
    ask.add_argument("--data", type=Path, default=Path("../shared/data/so101"))
    ask.add_argument("--chosen", type=Path, default=Path("runs/18_so101"), help="folder of run.py")
    ask.add_argument("--out", type=Path, default=Path("runs/18_so101/diagnosed"))
    ask.add_argument("--open", choices=("train", "aside", "test"))
    wish = ask.parse_args()
    torch.set_num_threads(1)
    if wish.open:
        models = {"chosen": model(wish.chosen), "corrected": load_model(wish.out / "model.yaml")}
        if (file := wish.chosen / "cma" / "model.yaml").exists():
            models["CMA-ES"] = load_model(file)
        compare(wish.open, models, so101.load(wish.data, wish.open)[wish.open])
        return
    data = so101.load(wish.data, "train")["train"]
    found = diagnosed(data, model(wish.chosen), wish.out, "diagnosis.json")
    save_model(found.model, wish.out / "model.yaml")


if __name__ == "__main__":
    main()
