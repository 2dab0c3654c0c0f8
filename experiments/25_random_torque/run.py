"""What records say under a likelihood with a random torque: one machine, and the causes that explain it best."""

import argparse
import time
from pathlib import Path

import torch
from posterior import parts_of, posterior, text

from hybrid_id.records.dataset import Dataset
from hybrid_id.systems.model_file import load_model


def main() -> None:
    """Parse, load, search; print what was tried and what is kept."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="with dataset.yaml and model.yaml")
    parser.add_argument("--model", type=Path)
    wish = parser.parse_args()
    torch.set_num_threads(1)
    begin, system = time.perf_counter(), load_model(wish.model or wish.folder / "model.yaml")
    parts = parts_of(system, Dataset.load(wish.folder))
    print(text(posterior(parts)))
    print(f"{sum(part.fits for part in parts.values())} fits in {time.perf_counter() - begin:.0f} s")


if __name__ == "__main__":
    main()
