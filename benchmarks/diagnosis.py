"""What a diagnosis costs, and which stage takes how much of it.

    hybrid-id blind make --out runs/cost/cases --answers runs/cost/answers.tar --cases 12 --seed 7
    python -m benchmarks.diagnosis runs/cost/cases [CASE ...]

Every case is diagnosed by a command of its own, one thread a process; a stage has the time that no stage inside it has.
Wall time counts, so the machine has to be idle; beside it stands the processor time of the process that commands, which
is all of it without `--jobs`. Writes `diagnosis.md`; the target is 60 s for one link and 180 s for two, on two cores.
"""

from __future__ import annotations

import argparse
import functools
import json
import os
import statistics
import subprocess
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
STAGES = ("search", "freeze", "reported")
"""Functions of ``diagnosis.diagnose``, one a stage: search screens, fits and selects."""
REST = "rest"
TARGETS = {1: 60.0, 2: 180.0}
"""Seconds, by links."""


class Clock:
    """Wall time of stages: what runs inside another stage counts for the inner one."""

    def __init__(self) -> None:
        self.spent: defaultdict[str, float] = defaultdict(float)
        self._now, self._last = [REST], time.perf_counter()

    def turn(self) -> None:
        """Write the time since the last turn to the stage that runs."""
        last, self._last = self._last, time.perf_counter()
        self.spent[self._now[-1]] += self._last - last

    def of(self, stage: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """A function whose time counts for a stage."""

        @functools.wraps(function)
        def timed(*args: object, **kwargs: object) -> object:
            self.turn()
            self._now.append(stage)
            try:
                return function(*args, **kwargs)
            finally:
                self.turn()
                self._now.pop()

        return timed


def one(folder: Path, jobs: int) -> dict[str, Any]:
    """Diagnose a case: its size, its verdict and the time of each stage."""
    from hybrid_id import Dataset, load_model
    from hybrid_id.diagnosis import diagnose as whole
    from hybrid_id.diagnosis.fits import Fits

    dataset, system = Dataset.load(folder), load_model(folder / "model.yaml")
    count, run = Counter[str](), Fits.run

    def counted(self: Fits, tasks: Any, *args: Any, **kwargs: Any) -> Any:
        tasks = list(tasks)
        count["all"] += len(tasks)
        return run(self, tasks, *args, **kwargs)

    Fits.run = counted
    clock, begun = Clock(), time.process_time()
    for stage in STAGES:
        setattr(whole, stage, clock.of(stage, getattr(whole, stage)))
    found = whole.diagnose(dataset, system, jobs=jobs)
    clock.turn()
    return {
        "case": folder.name,
        "links": len({channel.name[-1] for channel in dataset.outputs}),
        "records": len(dataset.records),
        "samples": sum(record.n_samples for record in dataset.records),
        "verdict": found.verdict,
        "effects": len(found.search.chosen.effects),
        "fits": count["all"],
        "stages": dict(clock.spent),
        "processor": time.process_time() - begun,
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("cases", nargs="*")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.one:
        print(json.dumps(one(asked.folder, asked.jobs)))
        return
    cases = asked.cases or sorted(path.parent.name for path in asked.folder.glob("*/model.yaml"))
    seen = []
    for case in cases:
        command = [
            sys.executable,
            "-m",
            "benchmarks.diagnosis",
            str(asked.folder / case),
            "--one",
            "--jobs",
            str(asked.jobs),
        ]
        alone = {**os.environ, "OMP_NUM_THREADS": "1"}
        done = subprocess.run(command, cwd=HERE.parent, env=alone, capture_output=True, text=True, check=True)
        seen.append(json.loads(done.stdout.splitlines()[-1]))
        print(line(seen[-1]), flush=True)
    (HERE / "diagnosis.md").write_text(
        "\n".join([*HEAD, *map(line, seen), "", *summary(seen)]) + "\n", "utf-8"
    )


COLUMNS = (
    "case",
    "links",
    "records",
    "samples",
    "verdict",
    "effects",
    "fits",
    "wall [s]",
    "processor [s]",
    *STAGES,
    REST,
)
HEAD = (f"| {' | '.join(COLUMNS)} |", f"|{' --- |' * len(COLUMNS)}")


def line(seen: dict[str, Any]) -> str:
    """A case as a row: time, and the share of each stage."""
    whole = sum(seen["stages"].values())
    shares = [f"{seen['stages'].get(stage, 0.0) / whole:.0%}" for stage in (*STAGES, REST)]
    first = [*(str(seen[key]) for key in COLUMNS[:7]), f"{whole:.0f}", f"{seen['processor']:.0f}"]
    return f"| {' | '.join([*first, *shares])} |"


def summary(seen: list[dict[str, Any]]) -> list[str]:
    """How many of each kind keep to their target."""
    told = []
    for links, target in TARGETS.items():
        times = [sum(row["stages"].values()) for row in seen if row["links"] == links]
        if times:
            kept = sum(t <= target for t in times)
            told.append(
                f"- {links} link{'s' * (links > 1)}: median {statistics.median(times):.0f} s, most {max(times):.0f} s; "
                f"{kept} of {len(times)} within {target:.0f} s."
            )
    return told


if __name__ == "__main__":
    main()
