"""One contestant in a process of its own, on one processor; `run.py` talks to it by lines of JSON.

    {"call": "prepare", "records": 10, "options": {...}}  ->  {"seconds": ...}
    {"call": "solve", "records": 10}                      ->  {"seconds": ..., "cost_ratio": ..., "z": ..., ...}
    {"call": "<function of the module>", "options": ...}  ->  {"seconds": ..., "value": ...}

The first line that it writes is {"seconds": import time}. Everything else that a contestant prints is discarded.
"""

from __future__ import annotations

import importlib
import json
import os
import resource
import sys
import time


def main() -> None:
    module_name, cpu = sys.argv[1], int(sys.argv[2])
    os.sched_setaffinity(0, {cpu})
    reply = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)

    def answer(message: dict) -> None:
        reply.write(json.dumps(message) + "\n")
        reply.flush()

    begin = time.perf_counter()
    module = importlib.import_module(module_name)
    answer({"seconds": time.perf_counter() - begin})
    from benchmarks import reference

    solve, problem = None, reference.load()
    for line in sys.stdin:
        request = json.loads(line)
        call, options = request["call"], request.get("options", {})
        part = problem.head(request.get("records", problem.n_records))
        try:
            begin, cpu_begin = time.perf_counter(), time.process_time()
            if call == "prepare":
                solve = module.prepare(part, **options)
                answer({"seconds": time.perf_counter() - begin})
            elif call == "solve":
                estimate = solve(part)
                seconds, cpu_seconds = time.perf_counter() - begin, time.process_time() - cpu_begin
                peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
                score = reference.score(part, estimate)
                answer(
                    {
                        "seconds": seconds,
                        "cpu_seconds": cpu_seconds,
                        "peak_megabytes": peak,
                        "cost_ratio": float(score.cost_ratio.max()),
                        "z": float(abs(score.z).max()),
                        "solved": score.solved,
                        "evaluations": int(estimate.iterations.sum()),
                    }
                )
            else:
                arguments = (part,) if request.get("problem", False) else ()
                value = getattr(module, call)(*arguments, **options)
                answer({"seconds": time.perf_counter() - begin, "value": value})
        except Exception as error:
            answer({"error": f"{type(error).__name__}: {error}"})


if __name__ == "__main__":
    main()
