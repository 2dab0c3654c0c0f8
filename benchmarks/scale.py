"""Time and memory against the length of a record, the number of records, the lanes of a batch, and the links of an arm.

Every figure is from a process of its own, on one thread: processor time of the job, and how far it raised the peak of
the memory above what the inputs take. Jobs:

- read csv, read parquet: a dataset of one record of so many samples from its files;
- check: quality of that record;
- simulate: a free run by the compiled engine;
- fit: three Levenberg-Marquardt steps by the default engine, with the sensitivities at the end;
- records: the same, one parameter set for each of so many records of 500 samples;
- lanes: a free run of so many rows of 500 samples;
- one link, two links: the same fit as `fit`, of an arm.

Usage: ``python -m benchmarks.scale [--limit 120] [--gigabytes 6]``; a job that takes longer or more is given up, and so
are larger ones of its kind. Writes `scale.md` and `docs/scale.png`.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from benchmarks.epoch_cost import _fresh_peak, _memory

HERE = Path(__file__).resolve().parent
STEP, NOISE, SHORT = 0.002, 0.02, 500
DECADES = (1000, 10_000, 100_000, 1_000_000, 10_000_000)
SIZES = {
    "read csv": DECADES, "read parquet": DECADES, "check": DECADES, "simulate": DECADES, "fit": DECADES,
    "records": (1, 10, 100, 1000), "lanes": (1, 10, 100, 1000, 10_000),
    "one link": (1000, 10_000, 100_000), "two links": (1000, 10_000, 100_000),
}  # fmt: skip
PANELS = {
    "samples of one record": ("read csv", "read parquet", "check", "simulate", "fit"),
    "records or rows of 500 samples": ("records", "lanes"),
    "samples of one record of an arm": ("one link", "two links"),
}


def job(kind: str, size: int, folder: Path) -> Callable[[], object]:
    """What is measured, its inputs made."""
    import numpy as np

    from hybrid_id import Dataset, Record, make_batch, one_link, two_link
    from hybrid_id.identification.fit import fit
    from hybrid_id.identification.least_squares import Options
    from hybrid_id.records.dataset import Channel
    from hybrid_id.records.quality import check_dataset
    from hybrid_id.simulation.rollout import simulate
    from hybrid_id.simulation.step import Engine

    joints = 2 if kind == "two links" else 1
    system = one_link(100.0) if joints == 1 else two_link((100.0, 100.0))
    many = size if kind in ("records", "lanes") else 1
    time_ = STEP * np.arange(SHORT if many > 1 or kind in ("records", "lanes") else size)
    tones = 2 * np.pi * np.array([0.4, 0.9, 1.7, 3.1, 5.3])

    def record(k: int) -> Record:
        voltage = sum(2.5 * np.sin(tone * time_ + k + n) for n, tone in enumerate(tones))
        names = [f"{stem}{joint + 1}" for stem in ("u", "q_m") for joint in range(joints)]
        inputs = {name: voltage for name in names[:joints]}
        return Record(f"run_{k}", time_, inputs, {name: 0.0 * time_ for name in names[joints:]})

    def measured(one: Record) -> Record:
        if kind.startswith("read") or kind == "check":  # what the numbers are does not matter
            motion = {"q_m1": np.cumsum(one.signal("u1")) * STEP * 30.0}
        else:
            batch = make_batch(system, [one], noise_std=dict.fromkeys(one.outputs, 1.0))
            run = simulate(system, Engine("dry", compiled=True), batch)
            motion = {name: run.y[0, :, k].numpy() for k, name in enumerate(one.outputs)}
        noise = NOISE * np.random.default_rng(len(one.name)).standard_normal((joints, one.n_samples))
        motion = {name: y + noise[k] for k, (name, y) in enumerate(motion.items())}
        return Record(one.name, one.time, one.inputs, motion)

    records = [measured(record(k)) for k in range(min(many, 20))]
    records = [
        Record(f"run_{k}", r.time, r.inputs, r.outputs) for k in range(many) for r in [records[k % 20]]
    ]
    names = list(records[0].inputs), list(records[0].outputs)
    channels = [Channel(n, "V") for n in names[0]], [Channel(n, "rad", NOISE) for n in names[1]]
    data = Dataset("scale", tuple(channels[0]), tuple(channels[1]), tuple(records), STEP)
    if kind.startswith("read"):
        import pandas as pd

        table = pd.DataFrame({"t": time_, **records[0].inputs, **records[0].outputs})
        ending = kind.removeprefix("read ")
        if ending == "csv":
            import pyarrow as pa
            from pyarrow import csv

            # ten times as fast as pandas
            csv.write_csv(pa.Table.from_pandas(table.round(6)), folder / "run.csv")
        else:
            table.to_parquet(folder / "run.parquet")
        text = "name: scale\ninputs: [{name: u1, unit: V}]\noutputs: [{name: q_m1, unit: rad}]\n"
        (folder / "dataset.yaml").write_text(f"{text}records: [{{file: run.{ending}}}]\n")
        return lambda: Dataset.load(folder)
    if kind == "check":
        return lambda: check_dataset(data)
    if kind in ("simulate", "lanes"):
        batch = make_batch(system, records, noise_std=dict.fromkeys(names[1], NOISE))
        return lambda: simulate(system, Engine("dry", compiled=True), batch)
    start = system.with_values(
        {info.name: 1.05 * info.spec.value for info in system.table if info.symbol == "J"}
    )
    batch = make_batch(start, records, noise_std=dict.fromkeys(names[1], NOISE))
    return lambda: fit(start, batch, options=Options(max_iterations=3), warm=False)


def measure(kind: str, size: int, gigabytes: float) -> dict[str, float]:
    """Processor time [s] and rise of the peak memory [MB]."""
    import torch

    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        job(kind, min(SIZES[kind][0], size), _below(folder, "small"))()  # loads what is lazy
        todo = job(kind, size, _below(folder, "large"))
        limit = int(gigabytes * 2**30)
        resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
        before, start = _fresh_peak(), time.process_time()
        todo()
        return {"seconds": time.process_time() - start, "megabytes": _memory("VmHWM") - before}


def _below(folder: str, name: str) -> Path:
    path = Path(folder) / name
    path.mkdir()
    return path


def slope(sizes: list[int], values: list[float]) -> float:
    """Exponent over the upper half of the sizes, where constant costs no longer count."""
    logs = [(math.log(s), math.log(max(v, 1e-3))) for s, v in zip(sizes, values, strict=True)]
    (x0, y0), (x1, y1) = logs[len(logs) // 2 - (len(logs) < 3)], logs[-1]
    return (y1 - y0) / (x1 - x0) if x1 > x0 else math.nan


def main() -> None:
    """Run all jobs, write the table and the picture."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--limit", type=float, default=120.0)
    parser.add_argument("--gigabytes", type=float, default=6.0)
    parser.add_argument("--only", nargs="+", choices=list(SIZES), default=list(SIZES))
    parser.add_argument("--one", nargs=2, metavar=("KIND", "SIZE"), help=argparse.SUPPRESS)
    wish = parser.parse_args()
    if wish.one:
        print(json.dumps(measure(wish.one[0], int(wish.one[1]), wish.gigabytes)))
        return
    kept = HERE / "scale.json"
    found = json.loads(kept.read_text()) if kept.exists() else {}
    for kind in wish.only:
        found[kind] = {}
        for size in SIZES[kind]:
            told = _apart(kind, size, wish.limit, wish.gigabytes)
            print(kind, size, told, flush=True)
            if isinstance(told, str):
                found[kind][str(size)] = told
                break
            found[kind][str(size)] = told
        kept.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    (HERE / "scale.md").write_text(_table(found), encoding="utf-8")
    _picture(found, HERE.parent / "docs" / "scale.png")


def _apart(kind: str, size: int, limit: float, gigabytes: float) -> dict[str, float] | str:
    """One job in a process of its own; why there is no figure where it takes too long or too much memory."""
    command = [
        sys.executable,
        "-m",
        "benchmarks.scale",
        "--gigabytes",
        str(gigabytes),
        "--one",
        kind,
        str(size),
    ]
    threads = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "MKL", "OPENBLAS")}
    try:
        run = subprocess.run(
            command, capture_output=True, text=True, timeout=limit, env={**os.environ, **threads}
        )
    except subprocess.TimeoutExpired:
        return f"over {limit:g} s"
    if run.returncode:
        words = run.stderr.strip().splitlines()[-1:] or [f"exit code {run.returncode}"]
        short = any(
            word in run.stderr for word in ("MemoryError", "not enough memory", "can't allocate memory")
        )
        return f"over {gigabytes:g} GB" if short else words[0][:80]
    return json.loads(run.stdout.splitlines()[-1])


def _table(found: dict) -> str:
    """One row a job: figures by size, and the exponents of time and memory."""
    rows = ["| job | figures by size | time grows as size to the | memory |", "| --- | --- | --- | --- |"]
    for kind, figures in found.items():
        told = {int(size): v for size, v in figures.items() if not isinstance(v, str)}
        cells = [f"{s:g}: {v['seconds']:.2g} s, {v['megabytes']:.2g} MB" for s, v in told.items()]
        cells += [f"{float(size):g}: {v}" for size, v in figures.items() if isinstance(v, str)]
        powers = [slope(list(told), [v[name] for v in told.values()]) for name in ("seconds", "megabytes")]
        rows.append(f"| {kind} | {'; '.join(cells)} | " + " | ".join(f"{p:.2f}" for p in powers) + " |")
    return "\n".join(rows) + "\n"


def _picture(found: dict, path: Path) -> None:
    """Time above, memory below, on logarithmic axes, slopes in the legend."""
    from hybrid_id.reporting.style import COLOURS, journal, new_figure, save

    with journal():
        figure = new_figure(5.0)
        rows = figure.subplots(2, len(PANELS))
        for panels, name, words in zip(
            rows, ("seconds", "megabytes"), ("processor time [s]", "memory [MB]"), strict=True
        ):
            for axes, (title, kinds) in zip(panels, PANELS.items(), strict=True):
                for k, kind in enumerate(kinds):
                    told = {int(s): v[name] for s, v in found.get(kind, {}).items() if not isinstance(v, str)}
                    told = {s: v for s, v in told.items() if v > 0}
                    label = (
                        f"{kind} ({slope(list(told), list(told.values())):.2f})" if len(told) > 1 else kind
                    )
                    axes.plot(list(told), list(told.values()), "o-", ms=3, color=COLOURS[k], label=label)
                axes.set(xscale="log", yscale="log", xlabel=title)
                axes.legend(fontsize=6.5)
            panels[0].set_ylabel(words)
    save(figure, path)


if __name__ == "__main__":
    main()
