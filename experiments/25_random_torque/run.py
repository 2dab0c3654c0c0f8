"""What records say under a likelihood with a random torque: one machine, and the causes that explain it best."""

import argparse
import time
from pathlib import Path

import torch
from search import Search

from hybrid_id.records.dataset import Dataset
from hybrid_id.systems.model_file import load_model


def main() -> None:
    """Parse, load, search; print what was tried and what is kept."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="with dataset.yaml and model.yaml")
    parser.add_argument("--model", type=Path)
    wish = parser.parse_args()
    torch.set_num_threads(1)
    dataset, begin = Dataset.load(wish.folder), time.perf_counter()
    search = Search(load_model(wish.model or wish.folder / "model.yaml"), dataset.train or dataset.records)
    best = search.run()
    for i in best.likelihood.free:
        print(f"{best.system.table[i].name}: {float(best.end.theta[i]):.5g}")
    for (name, k), value in zip(best.likelihood.entries, best.end.logs.exp().tolist(), strict=True):
        print(f"{name} {k + 1}: {value:.4g}")
    print(f"{search.fits} fits in {time.perf_counter() - begin:.0f} s")


if __name__ == "__main__":
    main()
