"""Table 12 over seeds: how well each of the three stages of link 2 tells its inertia P_2.

Usage: ``python inertia.py [seeds]``.
"""

import sys

import numpy as np

from hybrid_id.paper.comparison import PRINTED, parameter_table
from hybrid_id.paper.stages import read_plan, run_stage

STAGES = ("link1", "link2_high", "link2_low", "both_links")


def main(seeds=5):
    """Print for every seed the scatter of P_2 and the standard error of a typical record, by stage."""
    plan = read_plan(quick=False)
    found = np.full((seeds, 3, 3), np.nan)
    for seed in range(seeds):
        done = {}
        for stage in STAGES:
            done[stage] = run_stage(plan["stages"][stage], done, seed=seed)
        for k, stage in enumerate(STAGES[1:]):
            result = done[stage][0]
            column = result.names.index(PRINTED[stage].names.get("P_2", ("P_2", 1.0))[0])
            estimates, own = result.values[:, column], result.truths[:, column]
            found[seed, k] = (
                parameter_table(stage, result).percent["P_2"],
                100 * np.median(result.std_error[:, column] / estimates),
                100 * np.sqrt(np.mean((estimates / own - 1) ** 2)),
            )
            numbers = ", ".join(f"{value:.4f}" for value in found[seed, k])
            print(
                f"seed {seed} {stage}: std/mean, median standard error, RMS error [%] {numbers}; "
                f"not converged {len(result.failed)}",
                flush=True,
            )
    for k, stage in enumerate(STAGES[1:]):
        print(stage, "mean over seeds [%]:", ", ".join(f"{value:.4f}" for value in found[:, k].mean(0)))
    print("low velocity worst, seeds:", (found[:, 1] > found[:, [0, 2]].max(1)).sum(0), "of", seeds)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
