"""What a GPU brings: the same jobs on the CPU, by one thread and by all, and on a GPU, by their size.

- free run: rows of 500 samples side by side;
- fit, records: three Levenberg-Marquardt steps, a parameter set for each record of 500 samples;
- fit, samples: the same for one long record;
- fit, samples, smooth: the same with friction by tanh;
- epoch: one gradient of a long record by all weights of a network, by the adjoint.

All in float64; each figure is the wall time of a second run [s], and the largest difference of the GPU's result from
the CPU's relative to the largest entry. The CPU has its compiled engine, the GPU the plain one, as commands have them.

Usage: ``python -m benchmarks.device [--device cuda] [--limit 60]``; larger sizes of a job that took longer than the
limit are left out. Writes `device.md` and `device.json`, which stay where ``--out`` says.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import torch

STEP, NOISE, SHORT = 0.002, 0.02, 500
SIZES = {
    "free run": (10, 1000, 10_000, 100_000),
    "fit, records": (10, 100, 1000, 10_000),
    "fit, samples": (1000, 10_000, 100_000, 1_000_000),
    "fit, samples, smooth": (1000, 10_000, 100_000, 1_000_000),
    "epoch": (1000, 10_000, 100_000, 1_000_000),
}


def job(kind: str, size: int, device: str) -> Callable[[], torch.Tensor]:
    """What is measured, its inputs made and moved; it returns its result."""
    import numpy as np

    from hybrid_id import Record, make_batch, one_link
    from hybrid_id.components import ResidualNetwork
    from hybrid_id.identification.costate import gradient
    from hybrid_id.identification.fit import fit
    from hybrid_id.identification.least_squares import Options
    from hybrid_id.identification.networks import with_scales
    from hybrid_id.simulation.rollout import simulate
    from hybrid_id.simulation.solvers import OdeEngine, extra_parameters
    from hybrid_id.simulation.step import Engine

    many = kind in ("free run", "fit, records")
    system = one_link(100.0).with_values({"J": 2e-5, "P_m1": 0.019, "P_m2": 0.0254, "F_c": 0.01, "F_v": 5e-5})
    friction = "smooth" if kind in ("epoch", "fit, samples, smooth") else "dry"
    engine = Engine(friction, compiled=device == "cpu", width=1.0)
    time_ = STEP * np.arange(SHORT if many else size)
    tones = 2 * np.pi * np.array([0.4, 0.9, 1.7, 3.1, 5.3])[:, None]

    def record(k: int) -> Record:
        voltage = 2.5 * np.sin(tones * time_ + k + np.arange(5.0)[:, None]).sum(0)
        blank = Record(f"run_{k}", time_, {"u1": voltage}, {"q_m1": 0.0 * time_})
        batch = make_batch(system, [blank], noise_std={"q_m1": 1.0})
        run = simulate(system, Engine(friction, 4, 1.0, compiled=True), batch)
        noise = NOISE * np.random.default_rng(k).standard_normal(len(time_))
        return Record(blank.name, time_, {"u1": voltage}, {"q_m1": run.y[0, :, 0].numpy() + noise})

    batch = make_batch(
        system, [record(k) for k in range(10 if many else 1)], noise_std={"q_m1": NOISE}, signal_share=0.0
    )
    if many:
        batch = batch.take(torch.arange(size) % 10)
    start = system.with_values({"J": 2.1e-5})
    batch = batch.to(device)
    if kind == "free run":
        return lambda: simulate(start.to(device), engine, batch).y
    if kind.startswith("fit"):
        settings = {"options": Options(max_iterations=3), "warm": False, "engine": engine}
        return lambda: torch.tensor(np.stack([r.values for r in fit(start.to(device), batch, **settings)]))
    network = ResidualNetwork(inputs=("speed", "sin 3", "cos 3"), hidden=(8,))
    with torch.no_grad():
        network.layers[-1].weight.copy_(0.01 * torch.sin(torch.arange(8.0)))
    hybrid = with_scales(start.with_component("joint1/motor", network), batch.to("cpu")).to(device)
    theta = hybrid.theta().detach().to(device)[:, None]
    adjoint = OdeEngine(width=1.0, fine=8).stable(hybrid, batch, theta)
    free, extra = hybrid.estimated, extra_parameters(hybrid)

    def epoch() -> torch.Tensor:
        found = gradient(hybrid, adjoint, batch, batch.x, theta, free, extra=extra)
        return torch.cat([found.theta[0], *(g.flatten() for g in found.extra)]).detach()

    return epoch


def timed(todo: Callable[[], torch.Tensor], device: str) -> tuple[float, torch.Tensor]:
    """Wall time of a second run, and its result on the CPU."""
    for _ in range(2):
        if device != "cpu":
            torch.cuda.synchronize()
        start = time.perf_counter()
        found = todo().cpu()
        seconds = time.perf_counter() - start
    return seconds, found


def main() -> None:
    """Run every job on the CPU and on the device, and write the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--device", default="cuda")
    parser.add_argument("--limit", type=float, default=60.0)
    parser.add_argument("--out", type=Path, default=Path(__file__).resolve().parent)
    parser.add_argument("--only", nargs="+", choices=list(SIZES), default=list(SIZES))
    wish = parser.parse_args()
    threads = torch.get_num_threads()
    ways = {"cpu, 1 thread": ("cpu", 1), f"cpu, {threads} threads": ("cpu", threads)}
    ways[wish.device] = (wish.device, threads)
    found: dict[str, dict[str, dict[str, float]]] = {}
    for kind in wish.only:
        over: set[str] = set()
        for size in SIZES[kind]:
            told, results = {}, {}
            for name, (device, count) in ways.items():
                if name in over:
                    continue
                torch.set_num_threads(count)
                try:
                    told[name], results[name] = timed(job(kind, size, device), device)
                except torch.OutOfMemoryError:
                    told[name] = float("inf")
                if told[name] > wish.limit / 2:
                    over.add(name)
            if wish.device in results and "cpu, 1 thread" in results:
                one, other = results[wish.device], results["cpu, 1 thread"]
                told["difference"] = float((one - other).abs().max() / other.abs().max())
            print(kind, size, told, flush=True)
            found.setdefault(kind, {})[str(size)] = told
            (wish.out / "device.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    (wish.out / "device.md").write_text(_table(found, [*ways, "difference"]), encoding="utf-8")


def _table(found: dict[str, dict[str, dict[str, float]]], columns: list[str]) -> str:
    rows = ["| job | size | " + " | ".join(columns) + " |", "| --- | --- |" + " --- |" * len(columns)]
    for kind, sizes in found.items():
        for size, told in sizes.items():
            cells = [f"{told[name]:.2g}" if name in told else "not run" for name in columns]
            rows.append(f"| {kind} | {size} | " + " | ".join(cells) + " |")
    return "\n".join(rows) + "\n"


if __name__ == "__main__":
    main()
