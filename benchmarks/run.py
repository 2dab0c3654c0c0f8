"""Runs the speed comparison: `python -m benchmarks.run`, from the project's root.

Every contestant has a process of its own, pinned to one processor, with every library told to use one thread.
Contestants take turns within each repetition, so that a busy machine slows all of them alike; what counts is the
median of the ratios within repetitions. Writes `results.json` and `results.md` beside this file.

`--peers-python` names an interpreter with the peers (extra `bench`), if they are not beside the package.
`--cases` names the folder of the gap cases; without it those rows are left out.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks import reference

HERE = Path(__file__).resolve().parent
SINGLE_THREAD = {
    **{
        f"{name}_NUM_THREADS": "1"
        for name in ("OMP", "OPENBLAS", "MKL", "NUMEXPR", "NUMBA", "VECLIB_MAXIMUM")
    },
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
    "JAX_PLATFORMS": "cpu",
    "TORCHINDUCTOR_COMPILE_THREADS": "1",
}


@dataclass(frozen=True)
class Contestant:
    key: str
    label: str
    module: str
    options: dict = field(default_factory=dict)

    @property
    def is_ours(self) -> bool:
        return self.key.startswith("ours")


CONTESTANTS = (
    Contestant("ours", "hybrid_id, compiled step", "benchmarks.ours", {"compiled": True}),
    Contestant("ours_eager", "hybrid_id, eager", "benchmarks.ours"),
    Contestant("numba", "numba, written by hand for this law", "benchmarks.peers.numba_fit"),
    Contestant("casadi_c", "CasADi, C code generated", "benchmarks.peers.casadi_fit", {"generated": True}),
    Contestant("casadi", "CasADi, interpreted", "benchmarks.peers.casadi_fit"),
    Contestant(
        "casadi_c_hand",
        "CasADi, C code, sensitivity equations by hand",
        "benchmarks.peers.casadi_fit",
        {"generated": True, "sensitivities": True},
    ),
    Contestant("jax", "JAX, vmap of jacfwd", "benchmarks.peers.jax_fit"),
    Contestant("jax_hand", "JAX, lanes last by hand", "benchmarks.peers.jax_fit", {"lanes_last": True}),
)

#: (what, numerator, denominator, measure, bound): numerator's time at most bound times the denominator's.
BOUNDS = (
    ("10 records, warm, against CasADi C code", "ours", "casadi_c", "cpu_10", 0.25),
    ("10 records, warm, against JAX", "ours", "jax", "cpu_10", 0.2),
    ("10 records, warm, against numba", "ours", "numba", "cpu_10", 1.5),
    ("10 records, eager, against CasADi C code", "ours_eager", "casadi_c", "cpu_10", 0.6),
    (
        "1 record, cold, code in the cache, against CasADi interpreted with its build",
        "ours",
        "casadi",
        "cold_1",
        0.25,
    ),
    (
        "1 record, cold, empty cache, against CasADi interpreted with its build",
        "ours",
        "casadi",
        "empty_1",
        0.25,
    ),
    (
        "1 record, cold, eager, against CasADi interpreted with its build",
        "ours_eager",
        "casadi",
        "cold_1",
        None,
    ),
    ("1 record, warm, against CasADi C code", "ours", "casadi_c", "cpu_1", None),
    (
        "10 records, warm, against CasADi C code, sensitivities by hand",
        "ours",
        "casadi_c_hand",
        "cpu_10",
        None,
    ),
    ("10 records, warm, against JAX, lanes last by hand", "ours", "jax_hand", "cpu_10", None),
)
PEAK_MEGABYTES = 700.0
CASES = {"c022": 0.02796, "c008": 0.004272}  # one link, flexible link: the oracle's re-fit
SLOWER = {"c022": 2.0, "c008": 10.0, "gradient": 500.0}


class Failed(RuntimeError):
    """A contestant said why it cannot go on."""


class Worker:
    """A contestant's process."""

    def __init__(self, module: str, python: str, cpu: int, cache: str | None = None):
        self.begin = time.perf_counter()
        self.errors = tempfile.TemporaryFile("w+")  # noqa: SIM115 - lives as long as the process
        self.process = subprocess.Popen(
            [python, "-m", "benchmarks.worker", module, str(cpu)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self.errors,
            text=True,
            cwd=HERE.parent,
            env={**os.environ, **SINGLE_THREAD, **({} if cache is None else {"XDG_CACHE_HOME": cache})},
        )
        self.import_seconds = self.read()["seconds"]

    def read(self) -> dict:
        line = self.process.stdout.readline()
        if not line:
            self.close()
            self.errors.seek(0)
            said = self.errors.read().strip().splitlines()
            raise Failed(said[-1] if said else "the process ended")
        message = json.loads(line)
        if "error" in message:
            self.close()
            raise Failed(message["error"])
        return message

    def ask(self, call: str, **request) -> dict:
        self.process.stdin.write(json.dumps({"call": call, **request}) + "\n")
        self.process.stdin.flush()
        return self.read()

    def close(self) -> None:
        self.process.stdin.close()
        self.process.wait()


def fits(contestants: list[Contestant], python_of, cpu: int, repetitions: int, cold: int) -> dict[str, dict]:
    """Warm and cold times, memory and quality of every contestant that works; why it does not, of the others."""
    results: dict[str, dict] = {c.key: {"label": c.label} for c in contestants}
    workers: dict[str, Worker] = {}
    for contestant in contestants:
        row = results[contestant.key]
        try:
            worker = Worker(contestant.module, python_of(contestant), cpu)
            row["import"] = worker.import_seconds
            row["build"] = worker.ask("prepare", options=contestant.options)["seconds"]
            row |= {k: v for k, v in worker.ask("solve").items() if "seconds" not in k}
            worker.ask("solve", records=1)
            workers[contestant.key] = worker
            row |= {
                key: [] for key in ("warm_10", "warm_1", "cpu_10", "cpu_1", "cold_1", "empty_1", "process_1")
            }
            print(f"{contestant.label}: ready, ends at {row['cost_ratio']:.3f} x floor", flush=True)
        except (Failed, OSError) as error:
            row["failed"] = str(error)
            print(f"{contestant.label}: left out ({error})", flush=True)
    running = [c for c in contestants if c.key in workers]
    for repetition in range(repetitions):
        for contestant in running:
            row, worker = results[contestant.key], workers[contestant.key]
            for records in (10, 1):
                answer = worker.ask("solve", records=records)
                row[f"warm_{records}"].append(answer["seconds"])
                row[f"cpu_{records}"].append(answer["cpu_seconds"])
        print(f"warm repetition {repetition + 1} of {repetitions}", flush=True)
    for worker in workers.values():
        worker.close()
    for _ in range(cold):
        for contestant in running:
            seconds, whole = cold_start(contestant, python_of(contestant), cpu)
            results[contestant.key]["cold_1"].append(seconds)
            results[contestant.key]["process_1"].append(whole)
            if contestant.key == "ours":  # nobody else keeps compiled code for later processes
                with tempfile.TemporaryDirectory() as cache:
                    seconds, _ = cold_start(contestant, python_of(contestant), cpu, cache)
            results[contestant.key]["empty_1"].append(seconds)
    print(f"{cold} cold starts each", flush=True)
    return results


def cold_start(
    contestant: Contestant, python: str, cpu: int, cache: str | None = None
) -> tuple[float, float]:
    """Seconds of build and first fit of one record in a fresh process, and from that process's start."""
    worker = Worker(contestant.module, python, cpu, cache)
    build = worker.ask("prepare", records=1, options=contestant.options)["seconds"]
    seconds = build + worker.ask("solve", records=1)["seconds"]
    whole = time.perf_counter() - worker.begin
    worker.close()
    return seconds, whole


def others(python_of, cpu: int, repetitions: int, cases: Path | None) -> dict[str, dict]:
    """torchdiffeq's gradient and MuJoCo's fits of the gap cases, beside ours."""
    jobs: list[tuple[str, str, Contestant, str, dict]] = []
    torchdiffeq = Contestant(
        "torchdiffeq", "torchdiffeq, single shooting", "benchmarks.peers.torchdiffeq_gradient"
    )
    mujoco = Contestant("mujoco", "MuJoCo sysid", "benchmarks.peers.mujoco_sysid")
    ours = CONTESTANTS[1]
    jobs.append(("gradient", "torchdiffeq", torchdiffeq, "gradient_seconds", {}))
    jobs.append(("gradient", "ours", ours, "gradient_seconds", {}))
    for case in CASES if cases else ():
        folder = {"folder": str(cases / case)}
        jobs.append((case, "mujoco", mujoco, "fit_case", folder))
        jobs.append((case, "mujoco, stiff friction", mujoco, "fit_case", folder | {"stiff_friction": True}))
        jobs.append((case, "ours", ours, "fit_case", folder))
    results: dict[str, dict] = {}
    for repetition in range(repetitions):
        for what, who, contestant, call, options in jobs:
            row = results.setdefault(what, {}).setdefault(who, {"seconds": []})
            if "failed" in row:
                continue
            try:
                worker = Worker(contestant.module, python_of(contestant), cpu)
                if contestant.is_ours:
                    worker.ask(call, options=options, problem=call == "gradient_seconds")  # warm
                value = worker.ask(call, options=options, problem=call == "gradient_seconds")["value"]
                worker.close()
            except (Failed, OSError) as error:
                row["failed"] = str(error)
                continue
            if isinstance(value, dict):
                row["seconds"].append(value.pop("seconds"))
                row |= value
            else:
                row["seconds"].append(value)
        print(f"gradient and gap cases, repetition {repetition + 1} of {repetitions}", flush=True)
    return results


def ratio(one: list[float], other: list[float]) -> float:
    """Median of the ratios within repetitions."""
    return statistics.median(a / b for a, b in zip(one, other, strict=True))


def verdicts(results: dict[str, dict], rest: dict[str, dict]) -> list[tuple[str, float, str, bool | None]]:
    """(what, measured, bound, met) of everything that both sides have finished.

    Warm fits are compared by processor time, which on an idle machine is the wall time and on a busy one leaves out
    the others' turns.
    """
    rows = []
    for what, one, other, measure, bound in BOUNDS:
        if measure in results.get(one, {}) and measure in results.get(other, {}):
            value = ratio(results[one][measure], results[other][measure])
            rows.append((what, value, f"<= {bound} x" if bound else "-", value <= bound if bound else None))
    for what, slower in SLOWER.items():
        sides = rest.get(what, {})
        peer = next((who for who in ("torchdiffeq", "mujoco") if who in sides), None)
        if peer and all(sides.get(who, {}).get("seconds") for who in (peer, "ours")):
            value = ratio(sides[peer]["seconds"], sides["ours"]["seconds"])
            rows.append((f"{what}: {peer} slower than ours by", value, f">= {slower} x", value >= slower))
    for key in ("ours", "ours_eager"):
        if "peak_megabytes" in results.get(key, {}):
            value = results[key]["peak_megabytes"]
            rows.append(
                (
                    f"peak memory, MB, {results[key]['label']}",
                    value,
                    f"<= {PEAK_MEGABYTES:.0f}",
                    value <= PEAK_MEGABYTES,
                )
            )
    return rows


def markdown(results: dict[str, dict], rest: dict[str, dict], machine: str) -> str:
    """The tables as text."""

    def time_of(row: dict, key: str) -> str:
        return f"{statistics.median(row[key]):.3g}" if row.get(key) else "-"

    lines = [
        f"# Speed comparison\n\n{machine}\n",
        "Median seconds; one thread; see README.md for what is counted.\n",
    ]
    head = ["method", "10 records", "(processor)", "1 record", "(processor)", "build", "1 record cold"]
    head += ["with imports", "evaluations", "error / floor", "largest z", "peak MB"]
    lines += ["| " + " | ".join(head) + " |", "|" + " --- |" * len(head)]
    for row in results.values():
        if "failed" in row:
            lines.append(f"| {row['label']} | left out: {row['failed']} |" + " |" * (len(head) - 2))
            continue
        cells = [row["label"], *(time_of(row, key) for key in ("warm_10", "cpu_10", "warm_1", "cpu_1"))]
        cells.append(f"{row['build']:.3g}")
        cells += [time_of(row, "cold_1"), time_of(row, "process_1"), str(row["evaluations"])]
        cells += [f"{row['cost_ratio']:.3f}", f"{row['z']:.1f}", f"{row['peak_megabytes']:.0f}"]
        lines.append("| " + " | ".join(cells) + " |")
    lines += [
        "\n| gradient, gap case | method | seconds | free | error on the test records | oracle |",
        "|" + " --- |" * 6,
    ]
    for what, sides in rest.items():
        for who, row in sides.items():
            seconds = time_of(row, "seconds") if "failed" not in row else f"left out: {row['failed']}"
            error = f"{row['refit']:.5f}" if "refit" in row else "-"
            oracle = f"{CASES[what]:.5f}" if what in CASES else "-"
            lines.append(
                f"| {what} | {who} | {seconds} | {row.get('free_parameters', '-')} | {error} | {oracle} |"
            )
    lines += ["\n| ratio (median over repetitions) | measured | bound | met |", "|" + " --- |" * 4]
    for what, value, bound, met in verdicts(results, rest):
        lines.append(
            f"| {what} | {value:.3g} | {bound} | {'-' if met is None else 'yes' if met else 'NOT YET'} |"
        )
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repetitions", type=int, default=5)
    parser.add_argument("--cold", type=int, default=3, help="cold starts of each contestant")
    parser.add_argument(
        "--only", nargs="*", help="keys of the contestants: " + ", ".join(c.key for c in CONTESTANTS)
    )
    parser.add_argument("--no-rest", action="store_true", help="leave out the gradient and the gap cases")
    parser.add_argument("--peers-python", default=os.environ.get("BENCHMARK_PEERS_PYTHON", sys.executable))
    parser.add_argument("--cases", type=Path, default=HERE.parents[1] / "shared" / "gapcases" / "dev")
    parser.add_argument("--cpu", type=int, default=max(os.sched_getaffinity(0)))
    parser.add_argument("--out", type=Path, default=HERE, help="folder of results.json and results.md")
    arguments = parser.parse_args()

    reference.load()
    contestants = [c for c in CONTESTANTS if not arguments.only or c.key in arguments.only]
    cases = arguments.cases if arguments.cases.is_dir() else None

    def python_of(contestant: Contestant) -> str:
        return sys.executable if contestant.is_ours else arguments.peers_python

    results = fits(contestants, python_of, arguments.cpu, arguments.repetitions, arguments.cold)
    rest = {} if arguments.no_rest else others(python_of, arguments.cpu, min(3, arguments.repetitions), cases)
    load = ", ".join(f"{value:.1f}" for value in os.getloadavg())
    machine = f"{os.cpu_count()} cores, {platform.machine()}, Python {platform.python_version()}, load average {load}."
    text = markdown(results, rest, machine)
    for name, content in (
        ("results.json", json.dumps({"machine": machine, "fits": results, "rest": rest}, indent=1)),
        ("results.md", text),
    ):
        part = arguments.out / f"{name}.part"
        part.write_text(content)
        part.replace(arguments.out / name)
    print("\n" + text)


if __name__ == "__main__":
    main()
