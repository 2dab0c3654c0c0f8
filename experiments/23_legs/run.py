"""Fits the legs of one seed and compares with what was drawn: run.py [--seed 2301] [--all]

Prints the time of the fit with all that it needs (tracing, compiling where no cache has the code, first guesses), the
errors by kind of parameter, and every parameter that misses the target.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
import torch
from legs import NOISE, Truth, model, record

from hybrid_id.identification.fit import fit
from hybrid_id.simulation.compiled import compiled_for
from hybrid_id.simulation.prepare import make_batch
from hybrid_id.simulation.step import Engine

TARGET = 0.02
"""Error of every identifiable parameter, relative to its true value."""
SHARP = 3.0
"""Standard errors that fit into the target where a parameter counts as identifiable."""


def main() -> None:
    """One record, one fit, one table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=2301)
    parser.add_argument("--all", action="store_true", help="print every parameter")
    asked = parser.parse_args()
    torch.set_num_threads(1)
    truth = Truth.drawn(asked.seed)
    run = record(truth, asked.seed)
    start, busy = time.perf_counter(), time.process_time()
    system = model()
    noise = dict.fromkeys(run.outputs, NOISE)
    batch = make_batch(system, [run], noise_std=noise, signal_share=0.0)
    (found,) = fit(system, batch, engine=compiled_for(system, Engine()))
    wall, busy = time.perf_counter() - start, time.process_time() - busy
    print(
        f"seed {asked.seed}: {len(found.names)} parameters, {found.status} after {found.iterations} steps, "
        f"{wall:.1f} s, {busy:.1f} s of processor time; residual {found.noise_scale:.4f} of the noise"
    )
    jacobian = np.concatenate([part.reshape(-1, len(found.names)) for part in found.jacobian])
    spread = dict(zip(found.names, np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian))), strict=True))
    values, true = dict(zip(found.names, found.values, strict=True)), truth.by_name(system)
    error = {name: values[name] / value - 1.0 for name, value in true.items()}
    sharp = [name for name in true if SHARP * spread[name] <= TARGET * abs(true[name])]
    for symbol in ("J_m", "F_v", "F_c", "offset", "T_d"):
        own = [name for name in true if name.startswith(symbol)]
        told = [name for name in own if name in sharp]
        worst, all_worst = (max((abs(error[n]) for n in some), default=np.nan) for some in (told, own))
        print(
            f"  {symbol:7} {len(told):2} of {len(own):2} identifiable, worst {100 * worst:5.2f} %; "
            f"of all {100 * all_worst:5.2f} %"
        )
    for name in sorted(true, key=lambda n: -abs(error[n])):
        if asked.all or (name in sharp and abs(error[name]) > TARGET):
            print(
                f"  {name:22} true {true[name]:9.5f} found {values[name]:9.5f} "
                f"{100 * error[name]:6.2f} % (standard error {100 * spread[name] / abs(true[name]):.2f} %)"
            )
    met = sum(abs(error[name]) <= TARGET for name in sharp)
    print(f"  {met} of {len(sharp)} identifiable parameters within {100 * TARGET:g} %")


if __name__ == "__main__":
    main()
