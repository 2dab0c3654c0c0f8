"""Fits of the paper's Tables 3, 5, 8, 9 and 11 that the twins' true parameters reach, over seeds and sizes of drift.

No parameter is estimated here: what true parameters leave of a free run over 10 s, no estimate can be blamed for.
Usage: ``python run.py [seeds [drift [stage ...]]]``, by default 20 seeds, the twins' own drift and all stages.
"""

import sys

import numpy as np

from hybrid_id.paper.comparison import PRINTED
from hybrid_id.paper.stages import read_plan, twin_settings
from hybrid_id.paper.twin import make_campaign, replay
from hybrid_id.records.derivatives import differentiate, smooth_derivatives
from hybrid_id.statistics.fit import fit_percent

WHOSE = ("own run's", "mean machine's", "another run's", "another run's, in band")


def lowest_tone(experiment):
    """Lowest frequency of an experiment [Hz]."""
    parts = [experiment] if "band" in experiment else [experiment["u1"], experiment["u2"]]
    return min(part["band"][0] for part in parts)


def fits(measured, simulated, signal, step, lowest):
    """Fit % of a simulated signal, and of what lies above half the lowest tone (position only)."""
    if signal.startswith("v"):
        return fit_percent(smooth_derivatives(measured, step)[1], simulated), np.nan
    plain = fit_percent(measured, simulated)
    top = differentiate(measured, step).band[1]
    kept = [differentiate(y, step, band=(0.5 * lowest, top)).position for y in (measured, simulated)]
    return plain, fit_percent(*kept)


def stage_fits(config, signals, seeds):
    """Fit % by whose parameters, seed, record and signal."""
    campaigns = [make_campaign(config, seed) for seed in range(seeds)]
    records = [record for dataset, _ in campaigns for record in dataset.records]
    truths = [truth for _, runs in campaigns for truth in runs]
    starts = [{name: value for name, value in run.items() if name.startswith("q_0")} for run in truths]
    # The record that is replayed least well by chance is no matter: each seed takes the first run's parameters.
    firsts = [runs[0] for _, runs in campaigns for _ in runs]
    sets = {
        "own run's": truths,
        "mean machine's": [{**config["truth"], **start} for start in starts],
        "another run's": [{**first, **start} for first, start in zip(firsts, starts, strict=True)],
    }
    lowest = [lowest_tone(plan) for plan in config["excitation"]["experiments"]] * seeds
    found = np.empty((len(WHOSE), len(records), len(signals)))
    for row, parameters in enumerate(sets.values()):
        runs = replay(config, records, parameters)
        for i, (record, run) in enumerate(zip(records, runs, strict=True)):
            for k, signal in enumerate(signals):
                measured = record.outputs[f"q_{signal[2:]}"]
                plain, band = fits(measured, run[signal], signal, record.sample_time, lowest[i])
                found[row, i, k] = plain
                if row == len(sets) - 1:
                    found[row + 1, i, k] = band
    return found.reshape(len(WHOSE), seeds, -1, len(signals))


def main(seeds="20", drift=None, *stages):
    """Print a line for each stage, signal, and whose parameters are replayed."""
    plan = read_plan(quick=False)
    for stage in stages or PRINTED:
        table, (config, _) = PRINTED[stage], twin_settings(plan["stages"][stage], quick=False)
        signals = [table.names.get(name, (name, 1.0))[0] for name in table.fits]
        if drift is not None:
            config["disturbances"]["friction_drift"] = float(drift)
        found = stage_fits(config, signals, int(seeds))
        means = found.mean(2)
        spreads = 100 * found.std(2, ddof=1) / means
        for k, (name, (mean_fit, _, percent)) in enumerate(table.fits.items()):
            print(
                f"Table {table.numbers[1]} {name}, drift {config['disturbances']['friction_drift']:g}: "
                f"printed {mean_fit:.2f} %, std/mean {percent:.2f} %"
            )
            for row, whose in enumerate(WHOSE):
                mean, spread = means[row, :, k], spreads[row, :, k]
                if np.isnan(mean).any():
                    continue
                above, below = np.mean(mean >= mean_fit), np.mean(spread < percent)
                print(
                    f"  {whose:24s} {mean.mean():6.2f} ± {mean.std():4.2f} % ({above:4.0%} of seeds at or above), "
                    f"std/mean {spread.mean():5.2f} ± {spread.std():4.2f} % ({below:4.0%} below)",
                    flush=True,
                )


if __name__ == "__main__":
    main(*sys.argv[1:])
