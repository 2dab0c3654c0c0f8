"""Cost of a fleet by the number of its robots, on one process, on two of joblib and on a Dask cluster of two workers.

    cost.py FOLDER [--robots 25 50 100 200]      # FOLDER as `run.py make` left it

Each figure is a whole `hybrid-id fleet`, reading and page included: processor time of all processes, and wall time. The
slope is that of the logarithms. A first run of three robots fills the compile cache.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import distributed
import numpy as np
import psutil

WAYS = ("one process", "joblib, 2 processes", "Dask, 2 workers")


def main() -> None:
    """One line a size and way, and the slopes."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--robots", type=int, nargs="+", default=[25, 50, 100, 200])
    asked = parser.parse_args()
    settings = {"n_workers": 2, "threads_per_worker": 1, "processes": True, "dashboard_address": None}
    found: dict[str, list[tuple[float, float]]] = {way: [] for way in WAYS}
    cluster = distributed.LocalCluster(**settings)
    with cluster, tempfile.TemporaryDirectory() as temporary:
        options = {
            WAYS[0]: [],
            WAYS[1]: ["--jobs", "2"],
            WAYS[2]: ["--backend", "dask", "--scheduler", cluster.scheduler_address],
        }
        for way in WAYS:
            measure(asked.folder, 3, options[way], Path(temporary))
        for robots in asked.robots:
            for way in WAYS:
                found[way].append(measure(asked.folder, robots, options[way], Path(temporary)))
                busy, wall = found[way][-1]
                print(f"{way}, {robots} robots: {busy:.1f} s of processor time, {wall:.1f} s", flush=True)
    for way, figures in found.items():
        slopes = [
            np.polyfit(np.log(asked.robots), np.log(column), 1)[0] for column in zip(*figures, strict=True)
        ]
        print(f"{way}: slope {slopes[0]:.2f} of processor time, {slopes[1]:.2f} of wall time")


def measure(folder: Path, robots: int, options: list[str], temporary: Path) -> tuple[float, float]:
    """Processor time of all processes and wall time [s] of a fleet of the first robots."""
    part, out = temporary / "robots", temporary / "out"
    for place in (part, out):
        shutil.rmtree(place, ignore_errors=True)
    for place in sorted((folder / "robots").iterdir())[:robots]:
        shutil.copytree(place, part / place.name)
    command = [sys.executable, "-m", "hybrid_id", "fleet", str(part), "--model", str(folder / "model.yaml")]
    before, start = busy_seconds(), time.perf_counter()
    subprocess.run([*command, "--out", str(out), *options], check=True, capture_output=True)
    return busy_seconds() - before, time.perf_counter() - start


def busy_seconds() -> float:
    """Of this process, of those that it has waited for, and of the workers that are running."""
    own = psutil.Process()
    times = [own.cpu_times(), *(child.cpu_times() for child in own.children(recursive=True))]
    return sum(one.user + one.system + one.children_user + one.children_system for one in times)


if __name__ == "__main__":
    main()
