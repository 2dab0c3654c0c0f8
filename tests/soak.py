"""`make soak`: what is killed (SIGKILL) at random moments and run again ends as if nobody had touched it.

Trainings are resumed from their checkpoint, identifications and diagnoses from their fits, ablations and blind runs
from the cells and cases that they have kept. The processes are killed between their start and the time that a whole
run takes; a run that is done before its kill counts as a trial that met none. Prints one line a trial and a summary for
each kind; exit code 1 where a result differs, or a hidden folder is left over.
"""

import argparse
import json
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

sys.path.insert(0, str(Path(__file__).parent))
from drives import make_records, multisine, rigid_drive

from hybrid_id.cli.blind_runs import make_sealed
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.record import Record
from hybrid_id.records.yaml_file import write_yaml
from hybrid_id.study import replay
from hybrid_id.systems.model_file import load_model, save_model

MOST_KILLS = 3
"""After so many a trial's run is left alone."""
SOONER = 0.8
"""Share of the whole run's time before which a kill comes: a later run finds the computer warm."""
CASES = 5
"""Of a blind run."""
REPEATS = 2
"""Of an ablation."""
SETS, LONG = 12, 60
"""Of an identification, and how many times as long its records are."""
SAMPLES = 300
"""Of a record."""
QUIET = {"report": False, "figures": False, "tensorboard": False}
"""Pages and pictures take longer than the runs."""


@dataclass(frozen=True)
class Job:
    """A command that goes on where it was killed.

    Attributes:
        command: its words after the program, for a folder of results.
        result: what has to be the same however often it was killed.
    """

    command: Callable[[Path], list[str]]
    result: Callable[[Path], Any]


def make_drive(folder: Path, records: int) -> None:
    """Short records of a rigid drive and a model whose values are off."""
    truth = rigid_drive()
    voltages = [multisine(k, samples=SAMPLES, amplitude=7.0) for k in range(records)]
    made = tuple(make_records(truth, voltages, noise={"q_m1": 0.01}))
    Dataset("soak", (Channel("u1", "V"),), (Channel("q_m1", "rad", 0.01),), made, 0.002).save(folder)
    start = truth.with_values({"J": 2.4e-5, "F_c": 0.008})
    held = {n: replace(start.parameter(n).spec, estimate=False) for n in ("P_m1", "P_m2")}
    save_model(start.with_specs(held), folder / "model.yaml")


def training(folder: Path) -> Job:
    """A training by the adjoint; the result is every identified value."""
    make_drive(folder, 2)
    study = {"dataset": ".", "model": "model.yaml", "output": QUIET,
             "training": {"width": 2.0, "fine": 4, "windows": [], "max_iterations": 12}}  # fmt: skip
    (folder / "study.yaml").write_text(yaml.safe_dump(study))

    def command(out: Path) -> list[str]:
        more = ["--resume"] if (out / "checkpoint.pt").exists() else ["--force"] if out.exists() else []
        return ["train", str(folder / "study.yaml"), "--out", str(out), *more]

    return Job(command, lambda out: json.loads((out / "result.json").read_text())["selected"]["values"])


def ablation(folder: Path) -> Job:
    """Two arms in two repeats; the result is all that `ablation.json` says, and every cell's model."""
    make_drive(folder, 4)
    study = {
        "dataset": ".", "model": "model.yaml", "output": QUIET, "training": {"width": 2.0, "fine": 4},
        "hybrid": {"networks": [{"inputs": ["speed"], "hidden": [3]}], "price": 1.0, "windows": [],
                   "max_iterations": 1},
        "ablation": {"residual": ["static"], "seeds": REPEATS},
    }  # fmt: skip
    (folder / "study.yaml").write_text(yaml.safe_dump(study))

    def result(out: Path) -> Any:
        models = {path.parent.name: path.read_text() for path in sorted(out.glob("cells/*/model.yaml"))}
        return json.loads((out / "ablation.json").read_text()), models

    return Job(lambda out: ["ablate", str(folder / "study.yaml"), "--out", str(out)], result)


def blind(folder: Path) -> Job:
    """Cases answered by a baseline; the result is every answer, the time that it took apart."""
    cases, sealed = folder / "cases", folder / "elsewhere" / "answers.tar"
    options = {"system": "one_link", "level": "strong"}
    make_sealed(cases, sealed, CASES, 3, options, 1)

    def result(out: Path) -> Any:
        found = {}
        for path in sorted(out.glob("stribeck/*/diagnosis.json")):
            said = json.loads(path.read_text())
            found[path.parent.name] = said | {
                "run": said["run"] | {"seconds": None, "processor_seconds": None}
            }
        return found

    return Job(lambda out: ["blind", "run", str(cases), "--out", str(out), "--method", "stribeck"], result)


def make_robot(folder: Path, records: int) -> None:
    """Records of a robot's joint, each of which is fitted by itself, and a model whose values are off."""
    folder.mkdir(parents=True)
    (folder / "arm.xml").write_text(
        '<mujoco><worldbody><body><joint name="tip" axis="0 1 0" armature="0.01" damping="0.1" frictionloss="0.01"/>'
        '<inertial mass="0.1" pos="0 0 -0.05" diaginertia="1e-4 1e-4 1e-4"/></body></worldbody></mujoco>'
    )
    write_yaml(folder / "model.yaml", {"robot": {"file": "arm.xml"}, "gear_ratio": [2]})
    time, noise = 0.01 * np.arange(LONG * SAMPLES), np.random.default_rng(0)
    blanks = tuple(
        Record(f"run_{k}", time, {"tau1": 0.1 * np.sin((3 + k) * time)}, {"q_m1": 0.0 * time})
        for k in range(records)
    )
    channels = (Channel("tau1", "N m"),), (Channel("q_m1", "rad", 1e-3),)
    model = load_model(folder / "model.yaml")
    runs = replay(Dataset("robot", *channels, blanks, 0.01), model)
    outputs = [{"q_m1": run.outputs["q_m1"] + 1e-3 * noise.standard_normal(len(time))} for run in runs]
    made = tuple(replace(one, outputs=y) for one, y in zip(blanks, outputs, strict=True))
    Dataset("robot", *channels, made, 0.01).save(folder / "records")
    damping = next(info for info in model.table if info.symbol == "F_v")
    save_model(model.with_values({damping.name: 1.5 * damping.spec.value}), folder / "model.yaml")


def identification(folder: Path) -> Job:
    """Sets of a robot's records; the result is `result.json` and every set's model, to the last byte."""
    make_robot(folder, SETS)
    (folder / "study.yaml").write_text(
        yaml.safe_dump({"dataset": "records", "model": "model.yaml", "output": QUIET})
    )

    def command(out: Path) -> list[str]:
        more = ["--resume"] if (out / "fits").exists() else ["--force"] if out.exists() else []
        return ["identify", str(folder / "study.yaml"), "--window", "whole", "--out", str(out), *more]

    return Job(
        command, lambda out: [p.read_bytes() for p in (out / "result.json", *sorted(out.glob("models/*")))]
    )


def diagnosis(folder: Path) -> Job:
    """A search for one effect; the result is `diagnosis.json` and both models, to the last byte."""
    make_drive(folder, 3)
    study = {"dataset": ".", "model": "model.yaml", "gap": {"max_effects": 1, "jobs": 1}, "output": QUIET}
    (folder / "study.yaml").write_text(yaml.safe_dump(study))

    def command(out: Path) -> list[str]:
        more = ["--resume"] if (out / "fits").exists() else ["--force"] if out.exists() else []
        return ["diagnose", str(folder / "study.yaml"), "--out", str(out), *more]

    return Job(
        command, lambda out: [p.read_bytes() for p in (out / "diagnosis.json", *sorted(out.glob("*.yaml")))]
    )


JOBS = {
    "train": training,
    "identify": identification,
    "diagnose": diagnosis,
    "ablate": ablation,
    "blind": blind,
}


def run(job: Job, out: Path, longest: float, draw: random.Random, most: int = MOST_KILLS) -> int:
    """Run with so many kills at most until it ends by itself; returns how many it took."""
    kills = 0
    while True:
        words = [sys.executable, "-m", "hybrid_id", *job.command(out)]
        process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        try:
            _, said = process.communicate(
                timeout=draw.uniform(0.2, SOONER * longest) if kills < most else None
            )
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            kills += 1
            continue
        if process.returncode:
            raise SystemExit(f"exit code {process.returncode} after {kills} kills: {said.decode()[-400:]}")
        return kills


def soak(name: str, trials: int, seed: int, most: int = MOST_KILLS) -> tuple[int, int]:
    """Trials of one kind; returns how many differ from a run which nobody has touched or leave folders, and kills."""
    draw, kills, failures = random.Random(seed), 0, 0
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        job = JOBS[name](home / "data")
        start = time.monotonic()
        run(job, home / "whole", 1e6, draw)
        longest, whole = time.monotonic() - start, job.result(home / "whole")
        for k in range(trials):
            out = home / f"trial_{k}"
            met = run(job, out, longest, draw, most)
            same = job.result(out) == whole
            left = sorted({path.name for path in home.rglob(".*") if path.is_dir()})
            kills, failures = kills + met, failures + (not same or bool(left))
            words = f"{met} kills, {'the same' if same else 'ANOTHER'} result, left over: {left}"
            print(f"{name} {k}: {words}", flush=True)
    print(f"{name}: {trials} trials, {kills} kills, {failures} fail; one run takes {longest:.1f} s")
    return failures, kills


def main() -> None:
    """Parse, run, compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", choices=list(JOBS), action="append", help="kinds; all by default")
    wish = parser.parse_args()
    sys.exit(bool(sum(soak(name, wish.trials, wish.seed)[0] for name in wish.only or JOBS)))


if __name__ == "__main__":
    main()
