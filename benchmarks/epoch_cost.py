"""What one epoch of hybrid training costs, and how much memory it takes, by the length of the record.

An epoch is one gradient of a record's output error by the physical parameters and all weights of a network, four ways:

- adjoint: ours, all samples side by side, the costates by a linear recursion (`identification/costate.py`);
- backprop: the same, with backprop through the solver's steps in place of the adjoint inside each sample;
- loop, adjoint: `odeint_adjoint` sample by sample through the record, as a neural ODE is commonly trained;
- loop, backprop: backprop through all steps of the solver from the end of the record to its start.

Every figure is from a process of its own, on one thread: processor time of the gradient, how far it raised the peak of
the memory, and in brackets the peak of the whole process above what is there after the imports, from the record in
memory on. Usage: ``python -m benchmarks.epoch_cost [--lengths 1000 10000 30000] [--limit 600]``; a run
that takes longer than the limit (s) is given up, and so are longer records of its kind. Writes `epoch_cost.md`.
"""

from __future__ import annotations

import argparse
import ctypes
import gc
import json
import os
import subprocess
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
WAYS = ("adjoint", "backprop", "loop, adjoint", "loop, backprop")
STEP, NOISE, WARM = 0.002, 0.02, 64
LONGEST_LOOP = 30_000
"""Samples beyond which a loop is not tried: backprop through it would need tens of gigabytes."""


def epoch(way: str, samples: int) -> dict[str, float]:
    """Processor time [s], memory [MB] and the gradient's norm of one epoch."""
    import numpy as np
    import torch

    from hybrid_id import Record, make_batch, one_link
    from hybrid_id.components import ResidualNetwork
    from hybrid_id.identification.networks import with_scales
    from hybrid_id.simulation.rollout import simulate
    from hybrid_id.simulation.solvers import OdeEngine, extra_parameters
    from hybrid_id.simulation.step import Engine

    torch.set_num_threads(1)
    imported = _memory("VmRSS")
    physics = one_link(100.0).with_values(
        {"J": 2e-5, "P_m1": 0.019, "P_m2": 0.0254, "F_c": 0.01, "F_v": 5e-5}
    )
    network = ResidualNetwork(inputs=("speed", "sin 3", "cos 3"), hidden=(8,))
    with torch.no_grad():
        network.layers[-1].weight.copy_(0.01 * torch.sin(torch.arange(8.0)))
    time_ = STEP * np.arange(samples)
    voltage = np.zeros(samples)
    for k, tone in enumerate((0.4, 0.9, 1.7, 3.1, 5.3)):
        voltage += 2.5 * np.sin(2 * np.pi * tone * time_ + k)
    blank = Record("run", time_, {"u1": voltage}, {"q_m1": 0.0 * time_})
    motion = simulate(
        physics, Engine("smooth", 4, 1.0), make_batch(physics, [blank], noise_std={"q_m1": 1.0})
    )
    noise = NOISE * np.random.default_rng(0).standard_normal(samples)
    record = Record("run", time_, {"u1": voltage}, {"q_m1": motion.y[0, :, 0].numpy() + noise})
    del motion, noise, blank
    _fresh_peak()
    system = physics.with_values({"J": 2.1e-5}).with_component("joint1/motor", network)
    batch = make_batch(system, [record], noise_std={"q_m1": NOISE})
    system = with_scales(system, batch)
    theta = system.theta().detach()[:, None]
    engine = OdeEngine(width=1.0, fine=8, gradient=way.removeprefix("loop, "))
    engine = engine.stable(system, batch, theta)
    free = [k for k, info in enumerate(system.table) if info.spec.estimate]
    extra = extra_parameters(system)
    gradient = _by_loop if way.startswith("loop") else _side_by_side

    gradient(
        system, engine, batch.windows(WARM, samples, batch.x0_std)[0], theta, free, extra
    )  # loads what is lazy
    made = _memory("VmHWM")
    before, start = _fresh_peak(), time.process_time()
    found = gradient(system, engine, batch, theta, free, extra)
    seconds, peak = time.process_time() - start, _memory("VmHWM")
    return {
        "seconds": seconds,
        "megabytes": peak - before,
        "above_import": max(made, peak) - imported,
        "norm": float(found.norm()),
    }


def _fresh_peak() -> float:
    """Give freed memory back, let the peak begin anew, and return what is taken now [MB]; Linux only."""
    gc.collect()
    ctypes.CDLL("libc.so.6").malloc_trim(0)
    Path("/proc/self/clear_refs").write_text("5")
    return _memory("VmRSS")


def _memory(key: str) -> float:
    """A line of the process's status [MB]: VmRSS, resident now, or VmHWM, its peak."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(key)) / 1024


def _side_by_side(system, engine, batch, theta, free, extra):
    import torch

    from hybrid_id.identification.costate import gradient

    run = gradient(system, engine, batch, batch.x, theta, free, extra=extra)
    return torch.cat([run.theta[0], *(g.flatten() for g in run.extra)])


def _by_loop(system, engine, batch, theta, free, extra):
    import torch

    leaf = theta[free, 0].clone().requires_grad_()
    values = [leaf[free.index(k)].reshape(1) if k in free else theta[k] for k in range(len(theta))]
    p, state, cost = system.views(values), list(batch.x[:, 0].unbind(1)), 0.0
    for k in range(batch.x.shape[1]):
        u = {name: channel[:, k] for name, channel in batch.u.items()}
        measured = torch.stack(system.outputs(batch.outputs, state, u, p), 1)
        cost = cost + 0.5 * ((batch.y[:, k] - measured) * batch.weight[:, k]).square().sum()
        state = engine.sample(system, state, u, batch.dt[:, k], p)
    parts = torch.autograd.grad(cost, [leaf, *extra])
    return torch.cat([part.flatten() for part in parts])


def main() -> None:
    """Run all ways over all lengths and write the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--lengths", type=int, nargs="+", default=[1000, 10_000, 100_000, 1_000_000])
    parser.add_argument("--limit", type=float, default=600.0)
    parser.add_argument("--one", nargs=2, metavar=("WAY", "SAMPLES"), help=argparse.SUPPRESS)
    wish = parser.parse_args()
    if wish.one:
        print(json.dumps(epoch(wish.one[0], int(wish.one[1]))))
        return
    found: dict[str, list[dict[str, float] | None]] = {way: [] for way in WAYS}
    for way in WAYS:
        for samples in wish.lengths:
            given_up = bool(found[way]) and found[way][-1] is None
            given_up |= way.startswith("loop") and samples > LONGEST_LOOP
            found[way].append(None if given_up else _apart(way, samples, wish.limit))
            print(way, samples, found[way][-1], flush=True)
    (HERE / "epoch_cost.md").write_text(_table(wish.lengths, found), encoding="utf-8")


def _apart(way: str, samples: int, limit: float) -> dict[str, float] | None:
    """One epoch in a process of its own; None where it takes too long or too much memory."""
    command = [sys.executable, "-m", "benchmarks.epoch_cost", "--one", way, str(samples)]
    threads = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "MKL", "OPENBLAS")}
    try:
        run = subprocess.run(
            command, capture_output=True, text=True, timeout=limit, env={**os.environ, **threads}, check=True
        )
    except (subprocess.TimeoutExpired, subprocess.CalledProcessError):
        return None
    return json.loads(run.stdout.splitlines()[-1])


def _table(lengths: list[int], found: dict[str, list[dict[str, float] | None]]) -> str:
    """Seconds of processor time and rise of the peak memory, one row a way."""
    heads = " | ".join(f"{samples} samples" for samples in lengths)
    rows = [f"| one epoch by | {heads} |", f"| --- |{' --- |' * len(lengths)}"]
    for way, results in found.items():
        cells = [
            "not run"
            if r is None
            else f"{r['seconds']:.3g} s, {r['megabytes']:.0f} MB ({r['above_import']:.0f})"
            for r in results
        ]
        rows.append(f"| {way} | {' | '.join(cells)} |")
    return "\n".join(rows) + "\n"


if __name__ == "__main__":
    main()
